"""Runs side by side are what single runs are, to the last bit, whatever runs beside them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rotorsim.diagram.diagram import Diagram
from rotorsim.model.emit.toolchain import find_compiler
from rotorsim.model.load import load
from rotorsim.simulation.ensemble.many import simulate_many
from rotorsim.simulation.ensemble.result import Ensemble
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate
from tests.systems.shipped import DIAGRAMS, document, load_document, variant

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

STEPS = 400
LONG = ("fe_flexible", "fe_flexible_runup", "fe_rigid_runup", "rk4", "tum_amb_rotor", "two_amb_rotor")  # to compile
SHIPPED = sorted(file.stem for file in DIAGRAMS.glob("*.json") if file.stem != "diagram.schema")
SAMPLED = {"type": "discrete_pid", "parameters": {"KP": "12200 A/m", "KI": "2000 A/(m s)", "KD": "3 A s/m"}}


def whole(diagram: Diagram, parameters: dict[str, Any], **options: Any) -> Ensemble:
    """Return all rows of runs side by side."""
    options = {"stop": STEPS * diagram.solver.step, "workers": 1, **options}
    return simulate_many(diagram, parameters, reduce=["history"], window=(0.0, options["stop"]), **options)


def assert_same_verdicts(diagram: Diagram, parameters: dict[str, Any], found: Ensemble, **options: Any) -> list[Result]:
    """Compare what is said of every run with what is said of it by itself; return those."""
    options = {"stop": STEPS * diagram.solver.step, **options}
    alone = [
        simulate(diagram, parameters={name: values[k] for name, values in parameters.items()}, **options)
        for k in range(len(found))
    ]
    assert [(one.status, one.message) for one in alone] == list(zip(found.status, found.message, strict=True))
    return alone


def assert_same(diagram: Diagram, parameters: dict[str, Any], found: Ensemble, **options: Any) -> None:
    """Compare every run with one that runs by itself."""
    for k, alone in enumerate(assert_same_verdicts(diagram, parameters, found, **options)):
        for name, values in alone.signals.items():
            assert np.array_equal(values, found["history", name][k]), (name, k)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in SHIPPED]
)
def test_shipped_diagrams(name: str) -> None:
    diagram = load(name)
    speeds = [f"{800 + 137 * k} rpm" for k in range(5)]
    parameters = {"speed": speeds} if "speed" in diagram.parameters else {}
    assert_same(diagram, parameters, whole(diagram, parameters))


def test_a_sampled_controller_with_noise() -> None:
    diagram = variant("jeffcott", {"controller": SAMPLED})
    parameters = {"speed": [150.0, 200.0, 250.0, 300.0, 350.0], "controller.KP": [1e4, 1.1e4, 1.2e4, 1.3e4, 1.4e4]}
    found = whole(diagram, parameters)
    assert found.provenance["path"].split(",")[0] != "one by one"
    assert_same(diagram, parameters, found)


def test_samplers_of_different_periods_run_alone() -> None:
    diagram = variant("jeffcott", {"controller": SAMPLED})
    parameters = {"controller.sample_time": [1e-4, 1e-4, 2e-4, 2e-4, 3e-4]}
    found = whole(diagram, parameters)
    assert_same(diagram, parameters, found)


def test_ramps_that_end_at_different_times() -> None:
    """Angles turn evenly in some lanes while the corner of the ramp is in others."""
    clock = {"type": "clock", "parameters": {"profile": "ramp", "speed": 10.0, "acceleration": 50.0, "speed_limit": 20}}
    diagram = variant("jeffcott", {"clock": clock})
    parameters = {"clock.acceleration": [50.0, 400.0, 0.0, -70.0, 900.0, 120.0], "clock.speed_limit": [12.0] * 6}
    assert_same(diagram, parameters, whole(diagram, parameters, stop=0.2), stop=0.2)


def test_steps_of_different_lengths() -> None:
    """Each shaft turns as often: each run has a step of its own."""
    diagram = load("jeffcott")
    speeds = [100.0, 141.4, 200.0, 314.15, 500.0]
    found = simulate_many(
        diagram, {"speed": speeds}, turns=5, step=1e-3, reduce=["history"], window=(0, 5), record=["rotor.displacement"]
    )
    assert np.allclose(found.stop, 2 * np.pi * 5 / np.array(speeds), rtol=1e-12)
    in_turn = found.counters["steps"] // 5
    assert in_turn == np.ceil(2 * np.pi / 100.0 / 1e-3)
    for k, speed in enumerate(speeds):
        step = float(found.step[k])
        alone = simulate(diagram, parameters={"speed": speed}, stop=5 * in_turn * step, step=step)
        assert np.array_equal(alone["rotor.displacement"], found["history", "rotor.displacement"][k])


def test_a_run_that_diverges_stops_no_other() -> None:
    """An unstable bearing reaches 1e290 beside three that run on; what is said of it is what a run by itself says."""
    diagram = load("jeffcott")
    parameters = {"controller.KP": [12200.0, -1e9, 14000.0, 16000.0]}
    found = whole(diagram, parameters, stop=0.5)
    assert found.status.tolist() == ["finished", "diverged", "finished", "finished"]
    alone = simulate(diagram, parameters={"controller.KP": -1e9}, stop=0.5)
    assert (alone.status, alone.message) == (found.status[1], found.message[1])
    assert np.isnan(found["history", "rotor.displacement"][1]).all()
    calm = {"controller.KP": [12200.0, 14000.0, 16000.0]}
    beside = whole(diagram, calm, stop=0.5)["history", "rotor.displacement"]
    assert np.array_equal(found["history", "rotor.displacement"][[0, 2, 3]], beside)


def test_all_runs_diverge() -> None:
    found = whole(load("jeffcott"), {"controller.KP": [-1e9, -1.1e9]}, stop=0.5)
    assert found.status.tolist() == ["diverged", "diverged"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "status"), [("jeffcott", "unstable"), ("jeffcott_rub", "diverged")])
def test_unstable_machines_are_said_to_be(name: str, status: str) -> None:
    """A linear one by its poles; a nonlinear one, which leaves the air gap, as a run by itself is judged."""
    content = document(name)
    content["blocks"].pop("rub", None)
    content["wires"] = [wire for wire in content["wires"] if not any(end.startswith("rub.") for end in wire)]
    content["layout"].pop("rub", None)
    diagram = load_document(content)
    parameters = {"controller.KP": [-16000.0, 12200.0], "controller.KD": [0.0, 3.0]}
    found = whole(diagram, parameters, stop=0.05, step=1e-4)
    assert found.status.tolist() == [status, "finished"]
    assert_same_verdicts(diagram, parameters, found, stop=0.05, step=1e-4)


def test_a_step_that_is_too_large_is_said() -> None:
    diagram = load("jeffcott")
    parameters = {"rotor.stiffness": [7.6e5, 7.6e9]}
    found = whole(diagram, parameters, stop=0.2)
    assert_same_verdicts(diagram, parameters, found, stop=0.2)
    assert "too large" in found.message[1]


def test_initial_states() -> None:
    diagram = load("jeffcott")
    states = np.random.default_rng(3).normal(size=(5, 6)) * 1e-6
    found = simulate_many(diagram, initial=states, stop=0.04, reduce=["history"], window=(0, 0.04), workers=1)
    for k, state in enumerate(states):
        alone = simulate(diagram, initial=state, stop=0.04)
        assert np.array_equal(alone["rotor.displacement"], found["history", "rotor.displacement"][k])


def test_results_depend_on_neither_order_nor_neighbours_nor_processes() -> None:
    diagram = load("jeffcott_rub")
    speeds = np.linspace(700.0, 900.0, 11)
    options: dict[str, Any] = {"stop": 0.05, "reduce": ["peak", "rms", "last"]}
    first = simulate_many(diagram, {"speed": speeds}, workers=1, **options)
    order = np.random.default_rng(1).permutation(11)
    second = simulate_many(diagram, {"speed": speeds[order]}, workers=1, **options)
    for kind in options["reduce"]:
        assert np.array_equal(first[kind, "rotor.displacement"][order], second[kind, "rotor.displacement"])


@pytest.mark.parametrize("options", [{"use_compiler": False}, {"method": "dop853"}])
def test_one_by_one(options: dict[str, Any]) -> None:
    """Without a compiler the numbers are the same; adaptive methods run by themselves."""
    diagram = load("jeffcott")
    kinds = ["peak", "rms", "mean", "radius", "last", "harmonics=2", "poincare", "envelope=7"]
    parameters = {"speed": [200.0, 300.0]}
    beside = simulate_many(diagram, parameters, stop=0.1, reduce=kinds)
    alone = simulate_many(diagram, parameters, stop=0.1, reduce=kinds, **options)
    assert alone.provenance["path"].startswith("one by one")
    assert alone.counters["alone"] == 2
    for kind in beside.values:
        for name, values in beside.values[kind].items():
            tolerance = 1e-12 if "use_compiler" in options else 1e-4
            scale = tolerance * np.nanmax(np.abs(values))
            assert np.allclose(alone[kind, name], values, rtol=tolerance, atol=scale, equal_nan=True)
