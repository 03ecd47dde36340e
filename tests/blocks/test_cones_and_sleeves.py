"""Rotors whose elements and sections taper, have materials of their own, and carry sleeves."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import pytest
from rotorsim.blocks.common.shaft import Beam, Shaft, divided

from tests.blocks.evaluation import Prepared, prepare
from tests.blocks.shafts import cone_misfit, cowper, drawn, linear, matrices, roots, taper_misfit

E, NU, RHO = 2e11, 0.3, 7850.0
ALL = {"theory": "timoshenko", "rotary_inertia": True, "shaft_gyroscopic": True}
BASE = {"element_length": [0.1, 0.2, 0.15], "outer_diameter": [0.05, 0.06, 0.05], "inner_diameter": [0.0, 0.02, 0.0]}


def rotor(parameters: dict[str, Any], **options: Any) -> Prepared:
    count = options.setdefault("elements", 3)
    inputs = {"force": (count + 1, 2), "moment": (count + 1, 2), "speed": ()}
    return prepare("rotor_fe", inputs, {**BASE, **parameters}, {**ALL, "disc_nodes": [2], **options})


def a_matrix(block: Prepared) -> np.ndarray:
    return linear(block, 300.0)[0]


def dense(banded: Any) -> np.ndarray:
    found = np.zeros((banded.size,) * 2)
    for i, row in enumerate(banded.rows):
        for k, value in enumerate(row):
            found[i, i - k] = found[i - k, i] = value
    return found


def same(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.abs(one - other).max() < 1e-11 * np.abs(one).max())


@pytest.mark.parametrize("phi", [0.0, 0.3])
def test_a_cone_of_equal_ends_is_a_cylinder(phi: float) -> None:
    cylinder = Beam(0.2, 0.06, 0.02, E, RHO, NU)
    cone = Beam(0.2, 0.06, 0.02, E, RHO, NU, 0.06, 0.02)
    for one, other in zip(cone.tables(phi), cylinder.tables(phi), strict=True):
        assert np.array(one) == pytest.approx(np.array(other), rel=1e-12, abs=1e-12 * np.abs(other).max())


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_conical_sleeve_is_the_rest_of_a_cone() -> None:
    """Without shear, a cylinder with a sleeve around it that tapers is a cone with a bore of the cylinder, filled."""
    sizes = {"outer_diameter": [0.05, 0.03, 0.05], "inner_diameter": [0.0, 0.02, 0.0]}
    sleeve = {"outer_diameter": 0.06, "inner_diameter": 0.03, "end_outer_diameter": 0.08, "end_inner_diameter": 0.03}
    options = {"theory": "euler_bernoulli", "subdivisions": 2}
    both = rotor(
        {**sizes, "young_modulus": E, "density": RHO, "poisson_ratio": NU,
         **{f"sleeve_{key}": value for key, value in sleeve.items()}, "sleeve_young_modulus": E},
        sleeve_elements=[2], conical_sleeves=[1], **options,
    )  # fmt: skip
    cone = rotor(
        {**sizes, "outer_diameter": [0.05, 0.06, 0.05], "young_modulus": E, "density": RHO, "poisson_ratio": NU,
         "end_outer_diameter": 0.08, "end_inner_diameter": 0.02},
        conical_elements=[2], **options,
    )  # fmt: skip
    assert same(a_matrix(both), a_matrix(cone))


def test_elements_that_do_not_exist_and_walls_of_no_thickness_are_refused() -> None:
    block = rotor({}, conical_elements=[2], sleeve_elements=[1], conical_sleeves=[1]).block
    block.option.conical_elements, block.option.sleeve_elements = [4, 2, 2], [0]
    block.option.conical_sleeves = [2, 1, 1]
    sides = {"inner": 0.1, "outer": 0.1}
    values = {
        f"{kind}{side}_diameter": np.array([d])
        for kind in ("end_", "sleeve_", "sleeve_end_")
        for side, d in sides.items()
    }
    values |= {"inner_diameter": np.array([0.0]), "outer_diameter": np.array([0.1])}
    assert block.check(values) == [
        "conical_elements has element 4; the rotor has elements 1 to 3",
        "sleeve_elements has element 0; the rotor has elements 1 to 3",
        "conical_sleeves has sleeve 2; the rotor has sleeves 1 to 1",
        "conical_elements names an element twice",
        "conical_sleeves names a sleeve twice",
        "end_inner_diameter must be smaller than end_outer_diameter",
        "sleeve_inner_diameter must be smaller than sleeve_outer_diameter",
        "sleeve_end_inner_diameter must be smaller than sleeve_end_outer_diameter",
    ]


# --- cones and sleeves of a drawing -----------------------------------------------------------------------------------

L, D, END, BORE, BORE_END = 0.4, 0.09, 0.05, 0.03, 0.01
STEEL = {"young_modulus": 2.1e11, "density": RHO, "poisson_ratio": NU, "gravity": 0.0}
STEEL_OF_NODES = {key: value for key, value in STEEL.items() if key != "gravity"}
SLEEVE = {
    "outer_diameter": 0.12,
    "inner_diameter": 0.08,
    "young_modulus": 1e11,
    "density": 8000.0,
    "poisson_ratio": 0.2,
}


def cone(beams: int, **more: Any) -> Prepared:
    """Return a conical shaft of so many beams, with a station at the end of each."""
    sizes = {"outer_diameter": D, "inner_diameter": BORE, "end_outer_diameter": END, "end_inner_diameter": BORE_END}
    values = {key: more.pop(key) for key in list(more) if key in sizes}
    stations = np.linspace(0.0, L, beams + 1).tolist()
    return drawn([L], stations, {**STEEL, **sizes, **values}, conical_sections=[1], longest_element=L, **more)


def shaft(beams: int, bore: float = 0.0, end: float = END, bore_end: float = 0.0, *, slender: bool = False) -> Shaft:
    """Return the same in numbers, solid unless a bore is given."""
    one = Beam(L / beams, D, bore, 2.1e11, RHO, NU, end, bore_end)
    theory = "euler_bernoulli" if slender else "timoshenko"
    return Shaft(divided(one, beams), theory=theory, rotary_inertia=not slender, gyroscopic=not slender)


def natural(one: Shaft, speed: float = 0.0, held: int = 0) -> np.ndarray:
    """Return the natural frequencies [rad/s] above 100, both whirls, without the first degrees of freedom."""
    M, G, K = (dense(banded)[held:, held:] for banded in (one.mass, one.gyroscopic, one.stiffness))
    n = len(M)
    upper = np.hstack([np.zeros((n, n)), np.eye(n)])
    A = np.vstack([upper, np.linalg.solve(M, np.hstack([-K, 1j * speed * G]))])
    found = np.sort(np.abs(np.linalg.eigvals(A).imag))
    return np.asarray(found[found > 100.0])


@pytest.mark.parametrize("beams", [1, 3])
def test_a_cone_has_the_mass_and_the_inertias_of_a_truncated_cone(beams: int) -> None:
    """m = pi rho L (D^2 + D d + d^2) / 12, I_p = pi rho L (D^5 - d^5) / (160 (D - d)), less those of the bore."""
    M, G, K = matrices(cone(beams), 200.0)
    z = np.linspace(0.0, L, beams + 1)
    mass = moment = second = polar = 0.0
    for sign, a, b in ((1, D, END), (-1, BORE, BORE_END)):
        m = pi * RHO * L / 12 * (a**2 + a * b + b**2)
        mass += sign * m
        moment += sign * m * L * (a**2 + 2 * a * b + 3 * b**2) / (4 * (a**2 + a * b + b**2))
        own = pi * RHO * L * (a**5 - b**5) / (160 * (a - b))
        polar += sign * own
        # int rho A z^2 dz, A = pi/4 (a + (b - a) z / L)^2, and half of I_p
        second += sign * (pi * RHO / 4 * L**3 * (a**2 / 3 + a * (b - a) / 2 + (b - a) ** 2 / 5) + own / 2)
    shift = np.ravel([np.ones_like(z), np.zeros_like(z)], "F")
    turn = np.ravel([z, np.ones_like(z)], "F")
    found = [shift @ M @ shift, shift @ M @ turn, turn @ M @ turn, turn @ G @ turn]
    assert found == pytest.approx([mass, moment, second, polar], rel=1e-9)
    size = np.abs(K).max()
    assert np.array([K @ shift, K @ turn]) == pytest.approx(np.zeros((2, len(K))), abs=1e-9 * size)
    assert pytest.approx(K, abs=1e-9 * size) == K.T


def test_a_conical_cantilever_bends_and_shears_as_its_closed_form_says() -> None:
    """Tip under F: 64 F L^3 / (3 pi E d D^3), and by shear 4 F L / (pi kappa G d D) more."""
    bent = 64 * L**3 / (3 * pi * 2.1e11 * END * D**3)
    sheared = 4 * L / (pi * cowper(0.0, 1.0) * 2.1e11 / 2.6 * END * D)
    for slender, exact, most, order in ((True, bent, (16, 32), 4), (False, bent + sheared, (32, 64), 2)):
        errors = []
        for beams in most:
            K = dense(shaft(beams, slender=slender).stiffness)
            load = np.zeros(len(K) - 2)
            load[-2] = 1.0
            errors.append(1 - np.linalg.solve(K[2:, 2:], load)[-2] / exact)
        assert min(errors) > 0  # too stiff
        assert errors[0] < 1e-3
        assert errors[0] / errors[1] == pytest.approx(2**order, rel=0.05)


def test_a_free_slender_cone_has_the_frequencies_of_bessel_functions() -> None:
    taper = (D - END) / L
    z = (END / taper, D / taper)
    exactly = roots(lambda w: cone_misfit(w, z, taper, 2.1e11, RHO), 3e3, 1e5)[:3]
    errors = [natural(shaft(n, slender=True))[:6:2] / exactly - 1 for n in (24, 48)]
    assert np.min(errors) > 0  # consistent masses: from above
    assert errors[0].max() < 1e-3
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.05)


def test_a_cantilever_that_ends_in_a_point_has_the_published_frequencies() -> None:
    """w L^2 sqrt(rho A / (E I)) at the root: 8.719, 21.146, 38.454 (Kirchhoff 1879; Naguleswaran 1994)."""
    left_out = 1e-3  # of the cone, at its point
    found = natural(shaft(32, end=left_out * D, slender=True), held=2)[:6:2]
    found *= (L / (1 - left_out)) ** 2 * np.sqrt(RHO * 16 / (2.1e11 * D**2))
    assert found == pytest.approx([8.719, 21.146, 38.454], abs=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.0, 1200.0])
def test_a_free_hollow_taper_has_the_frequencies_of_its_integrated_equations(speed: float) -> None:
    """Timoshenko, rotary inertia and gyroscopic moments: the error falls with the square of the length of the beams."""

    def sizes(z: float) -> tuple[float, float]:
        return D + (END - D) * z / L, BORE + (BORE_END - BORE) * z / L

    forward = roots(lambda f: taper_misfit(f, sizes, L, speed), 1500.0, 5500.0, 24)
    backward = roots(lambda f: taper_misfit(f, sizes, L, -speed), 1500.0, 5500.0, 24)
    exactly = np.sort(np.concatenate([forward, backward]))
    errors = [natural(shaft(n, BORE, END, BORE_END), speed)[:4] / (2 * pi * exactly) - 1 for n in (24, 48)]
    assert errors[0].max() < 2e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


def test_steps_of_cylinders_become_the_cone() -> None:
    """Cylinders with the diameters of the middle: what they miss falls with the square of their length."""
    exactly, missed = natural(shaft(24, BORE, END, BORE_END))[:6:2], []
    for steps in (6, 12):
        middle = (np.arange(steps) + 0.5) / steps
        sizes = zip(D + (END - D) * middle, BORE + (BORE_END - BORE) * middle, strict=True)
        pieces = [Beam(L / 24, outer, inner, 2.1e11, RHO, NU) for outer, inner in sizes for _ in range(24 // steps)]
        stepped = Shaft(pieces, theory="timoshenko", rotary_inertia=True, gyroscopic=True)
        missed.append(natural(stepped)[:6:2] - exactly)
    assert missed[0] / missed[1] == pytest.approx(4.0, rel=0.15)


@pytest.mark.slow
def test_cones_and_sleeves_of_a_drawing_are_those_of_the_rotor_of_nodes() -> None:
    lengths, ends = [0.1, 0.2, 0.15], [0.0, 0.1, 0.3, 0.45]
    shape = {"end_outer_diameter": [0.08, 0.05], "end_inner_diameter": [0.03, 0.0]}
    both = {"sleeve_" + key: value for key, value in SLEEVE.items()}
    nodes = rotor({**STEEL_OF_NODES, **shape, **both}, conical_elements=[2, 3], sleeve_elements=[1, 2], disc_nodes=[])
    values = {**BASE, **STEEL, **shape, **both, "sleeve_stiffness_share": 1.0}
    values.pop("element_length")
    sleeve = {"sleeve_begins": [0.0], "sleeve_lengths": [0.3]}
    stations = drawn(lengths, ends, values, conical_sections=[2, 3], longest_element=1.0, **sleeve)
    assert same(a_matrix(nodes), a_matrix(stations))


def sleeved(share: float | None, theory: str = "timoshenko", **sleeve: float) -> Prepared:
    """Return a shaft of 400 mm with a sleeve from 120 to 250 mm, stations at the ends of all beams."""
    values = {**STEEL, "outer_diameter": 0.08, "inner_diameter": 0.02}
    given: dict[str, Any] = {}
    if share is not None:
        given = {"sleeve_begins": [0.12], "sleeve_lengths": [0.13]}
        values |= {"sleeve_" + key: value for key, value in {**SLEEVE, **sleeve}.items()}
        values["sleeve_stiffness_share"] = share
    return drawn([L], [0.0, 0.12, 0.25, L], values, longest_element=L, theory=theory, **given)


def test_a_sleeve_adds_its_mass_and_a_share_of_its_stiffness() -> None:
    bare, none, half, one = (matrices(sleeved(share), 300.0) for share in (None, 0.0, 0.5, 1.0))
    for whole, part in zip(none[:2], one[:2], strict=True):
        assert same(whole, part)
    assert same(bare[2], none[2])
    assert same(half[2], (none[2] + one[2]) / 2)
    assert not same(one[2], none[2])
    shift = np.tile([1.0, 0.0], 4)
    turn = np.ravel([[-0.185, -0.065, 0.065, 0.215], np.ones(4)], "F")  # about the middle of the sleeve
    m, i_p, i_d = ring(8000.0, 0.12, 0.08, 0.13)
    added = [none[k] - bare[k] for k in (0, 1)]
    assert shift @ added[0] @ shift == pytest.approx(m, rel=1e-9)
    assert turn @ added[0] @ turn == pytest.approx(i_d, rel=1e-9)
    assert turn @ added[1] @ turn == pytest.approx(i_p, rel=1e-9)


def ring(density: float, outer: float, inner: float, width: float) -> tuple[float, float, float]:
    """Return mass, I_p and I_d of a hollow cylinder by its radii."""
    m = density * pi * ((outer / 2) ** 2 - (inner / 2) ** 2) * width
    squares = (outer / 2) ** 2 + (inner / 2) ** 2
    return m, m * squares / 2, m * (3 * squares + width**2) / 12


def test_a_sleeve_of_one_piece_is_a_thicker_section() -> None:
    """Without shear: E I and rho A of the same material add up."""
    same_steel = {"young_modulus": 2.1e11, "density": RHO, "poisson_ratio": NU}
    one = sleeved(1.0, "euler_bernoulli", **same_steel)
    sizes = {"outer_diameter": [0.08, 0.12, 0.08], "inner_diameter": 0.02}
    thicker = drawn([0.12, 0.13, 0.15], [0.0, 0.12, 0.25, L], {**STEEL, **sizes}, longest_element=L,
                    theory="euler_bernoulli")  # fmt: skip
    assert same(a_matrix(one), a_matrix(thicker))
