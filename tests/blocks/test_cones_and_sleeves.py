"""Finite-element rotors whose elements taper, have materials of their own, and carry sleeves."""

from __future__ import annotations

from itertools import pairwise
from math import pi
from typing import Any

import numpy as np
import pytest
from rotorsim.blocks.common import beam
from rotorsim.blocks.common.shaft import Beam, Shaft

from tests.blocks.evaluation import Prepared, prepare
from tests.blocks.shafts import linear

E, NU, RHO = 2e11, 0.3, 7850.0
ALL = {"theory": "timoshenko", "rotary_inertia": True, "shaft_gyroscopic": True}
BASE = {"element_length": [0.1, 0.2, 0.15], "outer_diameter": [0.05, 0.06, 0.05], "inner_diameter": [0.0, 0.02, 0.0]}


def rotor(parameters: dict[str, Any], **options: Any) -> Prepared:
    count = options.setdefault("elements", 3)
    inputs = {"force": (count + 1, 2), "moment": (count + 1, 2), "speed": ()}
    return prepare("rotor_fe", inputs, {**BASE, **parameters}, {**ALL, "disc_nodes": [2], **options})


def a_matrix(block: Prepared) -> np.ndarray:
    return linear(block, 300.0)[0]


def same(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.abs(one - other).max() < 1e-11 * np.abs(one).max())


@pytest.mark.parametrize("phi", [0.0, 0.3])
def test_a_cone_of_equal_ends_is_a_cylinder(phi: float) -> None:
    cylinder = Beam(0.2, 0.06, 0.02, E, RHO, NU)
    cone = Beam(0.2, 0.06, 0.02, E, RHO, NU, 0.06, 0.02)
    for one, other in zip(cone.tables(phi), cylinder.tables(phi), strict=True):
        assert np.array(one) == pytest.approx(np.array(other), rel=1e-12, abs=1e-12 * np.abs(other).max())


def test_a_conical_cantilever_bends_as_its_closed_form_says() -> None:
    """Tip of a solid cone from D to d under F: 64 F L^3 / (3 pi E d D^3); the error falls as the fourth power."""
    L, D, d = 1.0, 0.08, 0.04
    exact = 64 * L**3 / (3 * pi * E * d * D**3)
    errors = []
    for count in (16, 32):
        ends = np.linspace(D, d, count + 1)
        beams = [Beam(L / count, a, 0.0, E, RHO, NU, b, 0.0) for a, b in pairwise(ends)]
        shaft = Shaft(beams, theory="euler_bernoulli", rotary_inertia=False, gyroscopic=False)
        rows = shaft.stiffness.rows
        size = shaft.stiffness.size
        K = np.array(
            [
                [rows[max(i, j)][abs(i - j)] if abs(i - j) <= beam.BAND else 0.0 for j in range(size)]
                for i in range(size)
            ]
        )
        load = np.zeros(size - 2)
        load[-2] = 1.0
        errors.append(abs(np.linalg.solve(K[2:, 2:], load)[-2] / exact - 1))
    assert errors[0] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.05)


def test_a_cone_in_parts_tapers_over_all_of_them() -> None:
    cone = {"conical_elements": [2], "subdivisions": 2}
    ends = {"end_outer_diameter": [0.08], "end_inner_diameter": [0.03]}
    divided = rotor(ends, **cone)
    sizes = {
        "element_length": [0.05, 0.05, 0.1, 0.1, 0.075, 0.075],
        "outer_diameter": [0.05, 0.05, 0.06, 0.07, 0.05, 0.05],
        "inner_diameter": [0.0, 0.0, 0.02, 0.025, 0.0, 0.0],
        "end_outer_diameter": [0.07, 0.08],
        "end_inner_diameter": [0.025, 0.03],
    }
    by_hand = rotor(sizes, elements=6, conical_elements=[3, 4], disc_nodes=[3])
    assert same(a_matrix(divided), a_matrix(by_hand))


def test_one_material_for_all_is_the_same_as_for_each() -> None:
    one = rotor({"young_modulus": E, "density": RHO, "poisson_ratio": NU})
    each = rotor({"young_modulus": [E] * 3, "density": [RHO] * 3, "poisson_ratio": [NU] * 3})
    softer = rotor({"young_modulus": [E, E / 2, E], "density": [RHO] * 3, "poisson_ratio": [NU] * 3})
    assert same(a_matrix(one), a_matrix(each))
    assert not same(a_matrix(one), a_matrix(softer))


def test_two_halves_of_a_material_are_the_whole() -> None:
    """A sleeve of the same section and half of modulus and density on a shaft of the other half."""
    whole = rotor({"young_modulus": E, "density": RHO, "poisson_ratio": NU})
    sleeve = {"outer_diameter": 0.06, "inner_diameter": 0.02, "young_modulus": E / 4, "density": RHO / 4}
    halves = rotor(
        {
            "young_modulus": [E, E / 2, E],
            "density": [RHO, RHO / 2, RHO],
            "poisson_ratio": NU,
            **{f"sleeve_{key}": [value, value] for key, value in {**sleeve, "poisson_ratio": NU}.items()},
        },
        sleeve_elements=[2, 2],
    )
    assert same(a_matrix(whole), a_matrix(halves))


def test_elements_that_do_not_exist_and_walls_of_no_thickness_are_refused() -> None:
    block = rotor({}, conical_elements=[2], sleeve_elements=[1]).block
    block.option.conical_elements, block.option.sleeve_elements = [4, 2, 2], [0]
    values = {
        "inner_diameter": np.array([0.0]),
        "outer_diameter": np.array([0.1]),
        "end_inner_diameter": np.array([0.2]),
        "end_outer_diameter": np.array([0.1]),
        "sleeve_inner_diameter": np.array([0.1]),
        "sleeve_outer_diameter": np.array([0.1]),
    }
    assert block.check(values) == [
        "conical_elements has element 4; the rotor has elements 1 to 3",
        "sleeve_elements has element 0; the rotor has elements 1 to 3",
        "conical_elements names an element twice",
        "end_inner_diameter must be smaller than end_outer_diameter",
        "sleeve_inner_diameter must be smaller than sleeve_outer_diameter",
    ]
