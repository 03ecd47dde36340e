"""Participants that exchange at rates of their own: order of accuracy, stability, and what is refused."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate, couple
from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.stability import coupling_stability
from rotorsim.diagram.edit import swap
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

INNER, STOP = 2e-6, 0.0048
PARTS = [["controller"], ["rotor"]]


@pytest.fixture(scope="module")
def whole() -> Result:
    return simulate(load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP}))


def run(step: float, rates: Mapping[str, int], master: str, order: int) -> Result:
    diagram = load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP})
    return cosimulate(couple(diagram, PARTS), diagram, step=step, master=master, order=order, rates=rates)


@pytest.mark.parametrize("master", ["jacobi", "gauss_seidel"])
@pytest.mark.parametrize("order", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 2))])
@pytest.mark.parametrize(
    "rates",
    [
        *(pytest.param(r, marks=pytest.mark.slow) for r in ({"controller": 4}, {"rotor": 4})),
        {"rotor": 2, "controller": 3},
    ],
)
def test_the_order_is_kept(whole: Result, master: str, order: int, rates: dict[str, int]) -> None:
    """Halving the base step divides the error by 2^(order + 1), also where no rate divides the other."""
    errors = []
    period = np.lcm.reduce(list(rates.values()))
    for step in (1.6e-5, 8e-6):
        found = run(step, rates, master, order)
        right = whole["rotor.displacement"][:: round(step / INNER)]
        errors.append(np.abs(found["rotor.displacement"] - right)[::period].max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.08)


def test_who_takes_how_many_steps() -> None:
    """The others go on with what they last knew; the result between is what they saw."""
    found = run(1e-4, {"controller": 4}, "gauss_seidel", 0)
    steps = 48
    assert found.counters["steps"] == steps
    assert found.counters["participant_steps"] == 2 * steps + steps / 4
    current = found["controller.current"]
    assert np.array_equal(current[4:8], np.tile(current[4], (4, 1)))
    assert not np.array_equal(current[8], current[4])
    linear = run(1e-4, {"controller": 4}, "gauss_seidel", 1)["controller.current"]
    assert linear[9:12] - linear[8] == pytest.approx(np.outer([0.25, 0.5, 0.75], linear[8] - linear[4]), rel=1e-9)
    assert found.provenance["rates"] == {"controller": 4}


def test_the_last_step_is_everybodys(whole: Result) -> None:
    """After 24 steps of which a participant takes 7 at once, it is at the end all the same."""
    found = run(2e-4, {"controller": 7}, "gauss_seidel", 1)
    assert found.time[-1] == pytest.approx(STOP)
    assert found.counters["participant_steps"] == 2 * 24 + 4


ALONE, BOTH = ({"controller": 3}, PARTS[:1]), ({"rotor": 2, "controller": 3}, PARTS)


@pytest.mark.parametrize(
    ("master", "order", "rates", "parts"),
    [
        ("gauss_seidel", 2, *ALONE),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (
                ("jacobi", 0, *ALONE),
                ("jacobi", 0, *BOTH),
                ("jacobi", 1, *ALONE),
                ("jacobi", 1, *BOTH),
                ("gauss_seidel", 1, *ALONE),
                ("gauss_seidel", 1, *BOTH),
                ("gauss_seidel", 2, *BOTH),
            )
        ),
    ],
)
@pytest.mark.slow
def test_the_growth_told_is_that_of_a_run(
    master: str, order: int, rates: dict[str, int], parts: list[list[str]]
) -> None:
    """A linear rotor is struck and left alone: 5 % below the limit it comes to rest, 5 % above it the motion grows.

    In the end a pair of modes that grow is left, and the slow one of the integral: x[n] obeys a recurrence of order 3,
    whose largest root is the eigenvalue over one period.
    """
    struck = {"unbalance.eccentricity": 0.0, "crack.stiffness": 0.0, "rotor.initial_velocity": [0.01, 0.0]}
    diagram = load("jeffcott", set={"solver.step": 2e-5, "solver.stop": 0.4, **struck})
    period = int(np.lcm.reduce(list(rates.values())))

    def motion(step: float) -> np.ndarray:
        found = cosimulate(couple(diagram, parts), diagram, step=step, master=master, order=order, rates=rates)
        return found["rotor.displacement"][::period, 0]

    coupling = couple(diagram, parts)
    every = coupling.rates_of(rates)
    told = coupling_stability(coupling, 1e-4, master=master, order=order, rates=every)
    assert told is not None
    below = motion(0.95 * told.largest_step)
    assert np.abs(below[-50:]).max() < np.abs(below[:50]).max() / 2
    step = 1.05 * told.largest_step
    above = coupling_stability(coupling, step, master=master, order=order, rates=every, limit=False)
    assert above is not None
    x = motion(step)[-61:-1]
    fitted = np.linalg.lstsq(np.column_stack([x[2:-1], x[1:-2], x[:-3]]), x[3:])[0]
    grows = np.abs(np.roots([1.0, *-fitted])).max()
    assert np.log(grows) / period == pytest.approx(np.log(above.radius), rel=2e-3)


def sampled(period: float) -> Coupling:
    document = swap(load("jeffcott").document, "controller", "discrete_pid")
    document["blocks"]["controller"]["parameters"]["sample_time"] = period
    document["solver"] = {"step": 2e-5, "stop": 0.02}
    return couple(load(document), [["controller"]])


def test_a_sampled_controller_at_its_own_rate() -> None:
    """Steps of 20 us, samples every fifth: Gauss-Seidel gives the run of the whole diagram."""
    coupling = sampled(1e-4)
    assert coupling.held is not None
    diagram = coupling.participants[0].part.diagram  # type: ignore[attr-defined]
    right = simulate(diagram)["rotor.displacement"]
    found = cosimulate(coupling, diagram, step=2e-5, order=1, rates={"controller": 5})
    assert np.abs(found["rotor.displacement"] - right).max() < 1e-13 * np.abs(right).max()
    assert found.counters["participant_steps"] == 1000 + 200
    told = coupling_stability(
        coupling, 2e-5, master="gauss_seidel", order=1, rates=coupling.rates_of({"controller": 5})
    )
    assert told is not None
    assert told.kept == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"master": "iterative"}, "iterative master: takes all participants at one rate"),
        ({"master": "waveform"}, "master waveform: takes all participants at one rate"),
        ({"adaptive": 1e-3}, "adaptive steps: takes all participants at one rate"),
        ({"fast": True}, "the fast loop: takes all participants at one rate"),
        ({"rates": {"controler": 2}}, "controler: no such participant"),
        ({"rates": {"controller": 0}}, "controller: rate 0: not a whole number of base steps"),
        ({"rates": {"controller": 1.5}}, "controller: rate 1.5: not a whole number of base steps"),
        ({"rates": {"amb": 2, "crack": 3}}, "crack: rates 2 and 3 for one participant"),
    ],
)
def test_what_is_refused(settings: dict[str, object], what: str) -> None:
    diagram = load("jeffcott")
    given = {"rates": {"controller": 2}, **settings}
    with pytest.raises(RotorsimError) as caught:
        cosimulate(couple(diagram, PARTS), diagram, step=1e-4, stop=0.01, **given)  # type: ignore[arg-type]
    assert str(caught.value).startswith(f"error: {what}")
