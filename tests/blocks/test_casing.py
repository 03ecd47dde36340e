"""The casing: two masses on springs, and a rigid body on its feet."""

from typing import Any

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.linear.eigenmodes import modes
from rotorsim.model.load import load
from tests.blocks.evaluation import prepare

M, K, D, MASS, FOOT, DAMPING = 12.0, 3e6, 900.0, 60.0, [8e6, 5e6], [400.0, 700.0]


def between() -> dict[str, Any]:
    """Return a rotor on a bearing in a casing, wired as docs/machines.md says."""
    return {
        "blocks": {
            "rotor": {"type": "rotor_2dof", "parameters": {"mass": M, "stiffness": 0.0, "viscous_damping": 0.0}},
            "bearing": {"type": "support", "parameters": {"stiffness": [K, K], "damping": [D, D]}},
            "casing": {"type": "casing", "parameters": {"mass": MASS, "stiffness": [FOOT], "damping": [DAMPING]}},
            "gap": {"type": "sum", "parameters": {"signs": "+-"}},
            "gap_rate": {"type": "sum", "parameters": {"signs": "+-"}},
            "reaction": {"type": "gain", "parameters": {"gain": -1.0}},
        },
        "wires": [
            ["rotor.displacement", "gap.input1"],
            ["casing.displacement[1]", "gap.input2"],
            ["rotor.velocity", "gap_rate.input1"],
            ["casing.velocity[1]", "gap_rate.input2"],
            ["gap.output", "bearing.displacement"],
            ["gap_rate.output", "bearing.velocity"],
            ["bearing.force", "rotor.force"],
            ["bearing.force", "reaction.input"],
            ["reaction.output", "casing.force[1]"],
        ],
        "record": ["rotor.displacement"],
    }


def test_a_rotor_in_a_casing_has_the_poles_of_two_masses_on_springs() -> None:
    """m u'' + d (u - c)' + k (u - c) = 0,  M c'' + d (c - u)' + k (c - u) + D c' + K c = 0, in x and in y."""
    expected = []
    for stiffness, damping in zip(FOOT, DAMPING, strict=True):
        mass = np.diag([M, MASS])
        k = np.array([[K, -K], [-K, K + stiffness]])
        d = np.array([[D, -D], [-D, D + damping]])
        lower = np.hstack([-np.linalg.solve(mass, k), -np.linalg.solve(mass, d)])
        expected += np.linalg.eigvals(np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), lower])).tolist()
    wanted = sorted((pole for pole in expected if pole.imag > 0), key=lambda pole: pole.imag)
    found = sorted((mode.eigenvalue for mode in modes(load(between())).modes), key=lambda pole: pole.imag)
    assert len(found) == 4
    assert np.array(found) == pytest.approx(np.array(wanted), rel=1e-9)


def test_a_casing_that_tilts_is_a_rigid_body_on_springs() -> None:
    stations, feet, centre = np.array([0.1, 0.5, 0.9]), np.array([0.0, 0.8]), 0.45
    stiffness, damping = np.array([[2e6, 3e6], [4e6, 1e6]]), np.array([[100.0, 200.0], [300.0, 50.0]])
    block = prepare(
        "casing",
        {"force": (3, 2)},
        {
            "stations": stations,
            "feet": feet,
            "mass": 40.0,
            "tilt_inertia": 7.0,
            "centre_of_gravity": centre,
            "stiffness": stiffness,
            "damping": damping,
        },
        {"tilts": True},
    )
    rng = np.random.default_rng(5)
    force, (c, b, dc, db) = rng.normal(size=(3, 2)) * 1e3, rng.normal(size=(4, 2)) * 1e-3
    found = block.evaluate({"force": force}, {"position": c, "slope": b, "velocity": dc, "slope_rate": db})
    for axis in (0, 1):
        arm, seen = feet - centre, stations - centre
        pushed = -stiffness[:, axis] * (c[axis] + arm * b[axis]) - damping[:, axis] * (dc[axis] + arm * db[axis])
        assert found.outputs["displacement"][:, axis] == pytest.approx(c[axis] + seen * b[axis], rel=1e-12)
        assert found.outputs["velocity"][:, axis] == pytest.approx(dc[axis] + seen * db[axis], rel=1e-12)
        rate = (force[:, axis].sum() + pushed.sum()) / 40.0
        assert found.derivatives["velocity"][axis] == pytest.approx(rate, rel=1e-12)
        turned = (seen @ force[:, axis] + arm @ pushed) / 7.0
        assert found.derivatives["slope_rate"][axis] == pytest.approx(turned, rel=1e-12)


def test_one_that_tilts_on_one_foot_is_refused() -> None:
    document = between()
    document["blocks"]["casing"]["parameters"]["tilts"] = True
    with pytest.raises(RotorsimError) as caught:
        load(document)
    [problem] = caught.value.problems
    assert (problem.subject, problem.what, problem.hint) == (
        "casing.tilts",
        "a casing that tilts needs feet at two positions",
        "give two positions or more in feet, or leave tilts out",
    )
