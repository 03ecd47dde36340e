"""Masters on parts of a diagram whose whole is known: orders of convergence, rollback, loops, sums of wires."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from rotorsim.cosim.cosimulation import cosimulate, cosimulate_diagram, couple
from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.linear import LinearParticipant
from rotorsim.cosim.masters.choice import make_master, make_stepping_master
from rotorsim.cosim.masters.master import Settings
from rotorsim.errors import RotorsimError
from rotorsim.fmi.export.export import export_fmu
from rotorsim.linear.linear_model import LinearModel
from rotorsim.model.load import load
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

INNER = 2e-6
STOP = 0.008


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


@pytest.mark.parametrize(
    ("master", "order", "expected"),
    [
        ("jacobi", 0, 1),
        ("jacobi", 1, 2),
        ("jacobi", 2, 3),
        ("gauss_seidel", 0, 1),
        ("gauss_seidel", 1, 2),
        ("gauss_seidel", 2, 3),
        ("iterative", 1, 2),
        pytest.param("iterative", 2, 3, marks=pytest.mark.slow),
    ],
)
def test_the_error_falls_with_the_order_of_the_inputs(whole: Result, master: str, order: int, expected: int) -> None:
    """Cut at the controller. Halving the step divides the error by 2^(order + 1)."""
    coarse, fine = (_error(whole, master, order, step, [["controller"]]) for step in (8e-5, 4e-5))
    assert np.log2(coarse / fine) == pytest.approx(expected, abs=0.05)


class Started(LinearParticipant):
    """A linear participant that starts from a state of its own."""

    first: np.ndarray

    def initialise(self, t: float, u: np.ndarray) -> None:
        self.x = self.first.copy()


@pytest.mark.parametrize(
    ("master", "order", "expected"),
    [
        ("jacobi", 0, 1),
        ("jacobi", 1, 2),
        ("jacobi", 2, 3),
        ("gauss_seidel", 0, 1),
        ("gauss_seidel", 1, 2),
        ("gauss_seidel", 2, 3),
        ("iterative", 1, 2),
        *(pytest.param("iterative", n, n + 1, marks=pytest.mark.slow) for n in (2, 3)),
    ],
)
def test_orders_against_the_matrix_exponential(master: str, order: int, expected: int) -> None:
    """Three masses in a row, each a participant that is advanced exactly; y = position, u = those of the neighbours."""
    k, c, n = 900.0, 1.0, 3
    A = np.array([[0.0, 1.0], [-2 * k, -c]])
    made = []
    for i in range(n):
        neighbours = [j for j in (i - 1, i + 1) if 0 <= j < n]
        B = np.array([[0.0] * len(neighbours), [k] * len(neighbours)])
        model = LinearModel(A, B, np.array([[1.0, 0.0]]), np.zeros((1, len(neighbours))))
        mass = Started(f"{i}", [f"{j}.x" for j in neighbours], [f"{i}.x"], model)
        mass.first = np.array([1.0, 0.0]) if i == 0 else np.zeros(2)
        made.append(mass)
    L = np.array([[float(name == f"{j}.x") for j in range(n)] for mass in made for name in mass.inputs])
    coupling = Coupling(tuple(made), L, np.zeros(len(L)))
    whole = np.kron(np.eye(n), A) + np.kron(np.eye(n, k=1) + np.eye(n, k=-1), np.array([[0.0, 0.0], [k, 0.0]]))
    errors = []
    for h in (1e-3, 5e-4):
        worker = make_stepping_master(master, coupling, Settings(order, 1e-13))
        worker.start(0.0)
        exact, once, far = np.array([1.0, 0, 0, 0, 0, 0]), expm(whole * h), 0.0
        for m in range(round(0.1 / h)):
            exact, (_, y) = once @ exact, worker.advance(m * h, (m + 1) * h)
            far = max(far, np.abs(y - exact[::2]).max())
        errors.append(far)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(expected, abs=0.05)


def test_iterating_is_better_than_extrapolating(whole: Result) -> None:
    errors = [_error(whole, master, 1, 4e-4, [["controller"]]) for master in ("iterative", "jacobi")]
    assert errors[0] < errors[1] / 4


@pytest.mark.slow
def test_three_participants(whole: Result) -> None:
    assert _error(whole, "iterative", 2, 1e-4, [["controller"], ["amb", "crack"]]) < 1e-4


def test_forces_on_one_input_are_added() -> None:
    diagram = load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP})
    coupling = couple(diagram, [["rotor"], ["crack", "unbalance", "clock"]])
    names = [name for p in coupling.participants for name in p.inputs]
    assert coupling.participants[0].inputs == (
        "crack.force[1]",
        "crack.force[2]",
        "unbalance.force[1]",
        "unbalance.force[2]",
        "amb.force[1]",
        "amb.force[2]",
    )
    assert coupling.L.sum() == len(names)
    assert not coupling.has_loop  # amb and controller are one participant


@pytest.mark.parametrize("master", [pytest.param("jacobi", marks=pytest.mark.slow), "gauss_seidel"])
@pytest.mark.slow
def test_a_sum_of_which_one_part_is_known_already(whole: Result, tmp_path: Path, master: str) -> None:
    """Forces of three participants add up at a rotor that is an FMU; it comes between them."""
    settings = {"solver.step": INNER, "solver.stop": STOP}
    diagram = load("jeffcott", set=settings)
    export_fmu(diagram, tmp_path / "rotor.fmu", blocks=["rotor"])
    document = json.loads(json.dumps(diagram.document))
    document.pop("identify")
    document["blocks"]["rotor"] = {"type": "fmu", "file": "rotor.fmu", "parameters": {"in_process": True}}
    cut = load(document, folder=tmp_path, trust_blocks=True)
    errors = []
    for step in (8e-5, 4e-5):
        found = cosimulate_diagram(cut, [["amb"], ["crack"], ["unbalance"]], step=step, master=master, order=1)
        right = whole["rotor.displacement"][:: round(step / INNER)][: len(found.time)]
        errors.append(np.abs(found["rotor.displacement"] - right).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.05)


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


@pytest.mark.parametrize(
    ("master", "order"),
    [("gauss_seidel", 1), *(pytest.param(*e, marks=pytest.mark.slow) for e in (("gauss_seidel", 0), ("iterative", 2)))],
)
def test_adaptive_steps_keep_the_error_that_is_allowed(master: str, order: int) -> None:
    """The errors of the steps add up: the whole error stays below their sum, and falls in proportion to it."""
    diagram = load("jeffcott", set={"solver.step": 1e-5, "solver.stop": STOP})
    whole = simulate(diagram)
    shares = []
    for allowed in (1e-4, 1e-6):
        coupling = couple(diagram, [["controller"]])
        found = cosimulate(coupling, diagram, step=1e-3, master=master, order=order, adaptive=allowed)
        spline = CubicSpline(whole.time, whole["rotor.displacement"])
        right = spline(found.time)
        error = np.abs(found["rotor.displacement"] - right).max() / np.abs(right).max()
        shares.append(error / (allowed * (len(found.time) - 1)))
    assert max(shares) < 1
    assert shares[1] / shares[0] == pytest.approx(1, abs=0.15)


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
        make_master("jacoby", coupling, Settings())
    with pytest.raises(RotorsimError, match="extrapolation order 3"):
        make_master("jacobi", coupling, Settings(3))
    with pytest.raises(RotorsimError, match="communication step 0 s is not between 0 and"):
        cosimulate(coupling, diagram, step=0.0)
    with pytest.raises(RotorsimError, match="controller: is in two parts"):
        couple(diagram, [["controller"], ["controller", "amb"]])
