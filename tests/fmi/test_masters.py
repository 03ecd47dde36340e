"""Masters on parts of a diagram whose whole is known: orders of convergence, rollback, loops, sums of wires."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim.diagram.load import load
from rotorsim.errors import RotorsimError
from rotorsim.fmi.cosimulation import cosimulate, couple
from rotorsim.fmi.masters import make_master
from rotorsim.simulate import Result, simulate

INNER = 2e-5
STOP = 0.05


@pytest.fixture(scope="module")
def whole() -> Result:
    return simulate(load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP}))


def _error(whole: Result, master: str, order: int, step: float, groups: list[list[str]]) -> float:
    diagram = load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP})
    found = cosimulate(couple(diagram, groups), diagram, step=step, master=master, order=order)
    assert found.status == "finished"
    every = round(step / INNER)
    right = whole["rotor.displacement"][::every][: len(found.time)]
    return float(np.abs(found["rotor.displacement"] - right).max() / np.abs(right).max())


@pytest.mark.parametrize(("master", "order", "expected"), [
    ("jacobi", 0, 1), ("jacobi", 1, 2), ("jacobi", 2, 3), ("gauss_seidel", 0, 1), ("gauss_seidel", 1, 2),
    ("gauss_seidel", 2, 3), ("iterative", 1, 2), ("iterative", 2, 3),
])  # fmt: skip
def test_the_error_falls_with_the_order_of_the_inputs(whole: Result, master: str, order: int, expected: int) -> None:
    """Cut at the controller. Halving the step divides the error by 2^(order + 1)."""
    coarse, fine = (_error(whole, master, order, step, [["controller"]]) for step in (4e-4, 2e-4))
    assert np.log2(coarse / fine) == pytest.approx(expected, abs=0.35)


def test_iterating_is_better_than_extrapolating(whole: Result) -> None:
    errors = [_error(whole, master, 1, 4e-4, [["controller"]]) for master in ("iterative", "jacobi")]
    assert errors[0] < errors[1] / 4


def test_three_participants(whole: Result) -> None:
    assert _error(whole, "iterative", 2, 1e-4, [["controller"], ["amb", "crack"]]) < 1e-4


def test_forces_on_one_input_are_added() -> None:
    diagram = load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP})
    coupling = couple(diagram, [["rotor"], ["crack", "unbalance", "clock"]])
    names = [name for p in coupling.participants for name in p.inputs]
    assert coupling.participants[0].inputs == (
        "crack.force[1]", "crack.force[2]", "unbalance.force[1]", "unbalance.force[2]", "amb.force[1]", "amb.force[2]",
    )  # fmt: skip
    assert coupling.L.sum() == len(names)
    assert not coupling.has_loop  # amb and controller are one participant


def test_an_algebraic_loop_across_participants_is_solved() -> None:
    document = {
        "name": "loop",
        "blocks": {
            "source": {"type": "constant", "parameters": {"value": 1.0}},
            "sum": {"type": "sum", "parameters": {"signs": "+-"}},
            "gain": {"type": "gain", "parameters": {"gain": 3.0}},
        },
        "wires": [["source.output", "sum.input1"], ["gain.output", "sum.input2"], ["sum.output", "gain.input"]],
        "algebraic_loops": "solve",
        "solver": {"step": 0.1, "stop": 0.2},
        "record": ["sum.output"],
    }
    diagram = load(document)
    coupling = couple(diagram, [["gain"]])
    assert coupling.has_loop
    found = cosimulate(coupling, diagram, step=0.1, master="jacobi")
    assert found["sum.output"] == pytest.approx(np.full(3, 0.25), rel=1e-9)


def test_adaptive_steps_keep_the_error_that_is_allowed(whole: Result) -> None:
    diagram = load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP})
    errors = []
    for allowed in (1e-3, 1e-5):
        found = cosimulate(couple(diagram, [["controller"]]), diagram, step=1e-3, order=1, adaptive=allowed)
        right = np.column_stack([np.interp(found.time, whole.time, axis) for axis in whole["rotor.displacement"].T])
        errors.append(np.abs(found["rotor.displacement"] - right).max() / np.abs(right).max())
    assert errors[1] < errors[0] / 5
    assert errors[0] < 0.05


def test_a_step_that_is_too_large_diverges_and_keeps_what_was_found() -> None:
    diagram = load("jeffcott", set={"solver.step": 1e-4, "solver.stop": 60.0})
    found = cosimulate(couple(diagram, [["controller"]]), diagram, step=3e-3, master="jacobi", order=0)
    assert found.status == "diverged"
    assert "left the finite numbers at t =" in found.message
    assert len(found.time) > 10


def test_wrong_arguments() -> None:
    diagram = load("jeffcott")
    coupling = couple(diagram, [["controller"]])
    with pytest.raises(RotorsimError, match="no master 'jacoby'"):
        make_master("jacoby", coupling)
    with pytest.raises(RotorsimError, match="extrapolation order 3"):
        make_master("jacobi", coupling, order=3)
    with pytest.raises(RotorsimError, match="communication step 0 s is not between 0 and"):
        cosimulate(coupling, diagram, step=0.0)
    with pytest.raises(RotorsimError, match="controller: is in two parts"):
        couple(diagram, [["controller"], ["controller", "amb"]])
