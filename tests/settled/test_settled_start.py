"""A run from the settled motion has no transient."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rotorsim import RotorsimError, load, periodic, settled_start, simulate
from tests.acceptance.machines import jeffcott


@pytest.mark.parametrize("name", ["jeffcott", "offset_disc", "fe_flexible"])
def test_the_first_turn_is_the_settled_one(name: str) -> None:
    diagram = load(name)
    found = periodic(diagram, signals=["rotor.displacement"])
    pair = found.two_axis[-1]
    turn = 2 * np.pi / found.speeds[0]
    run = simulate(diagram, initial=settled_start(diagram), stop=2 * turn, record=[pair])
    motion = run[pair] @ np.array([1, 1j])
    orders = np.exp(1j * np.outer(run.time, found.orders * found.speeds[0]))
    settled = orders @ found.harmonics[pair][0]
    assert np.abs(motion - settled).max() < 2e-6 * np.abs(settled).max()


def test_a_disc_in_closed_form() -> None:
    """x = Re X, v = Re i W X, X = u W^2 / (k - m W^2 + i d W)."""
    W = 300.0
    X = 2e-5 * W**2 / (1.4e6 - 2 * W**2 + 150j * W)
    assert settled_start(load(jeffcott(4e5, 150.0)))[:4] == pytest.approx(
        [X.real, (-1j * X).real, (1j * W * X).real, (W * X).real], rel=1e-9
    )


def test_parameters_are_heard() -> None:
    one = settled_start(load("jeffcott"), parameters={"speed": 200.0})
    assert one == pytest.approx(settled_start(load("jeffcott", set={"speed": 200.0})), rel=1e-12)


def with_integrators() -> dict[str, Any]:
    """A disc with its shaft angle as a state, and integrals of speed and place of the disc that nothing reads."""
    machine = jeffcott(4e5, 150.0)
    for name, start, source in (
        ("angle", 0.3, "clock.speed"),
        ("path", [5e-3, 0.0], "rotor.velocity"),
        ("area", [0.0, 1e-6], "rotor.displacement"),
    ):
        machine["blocks"][name] = {"type": "integrator", "parameters": {"initial": start}}
        machine["wires"].append([source, f"{name}.input"])
    return machine


def test_what_nothing_returns_is_where_a_run_would_have_brought_it() -> None:
    """FAULT of an earlier version: angle and integrals began at zero mean, whatever the diagram starts them with."""
    diagram = load(with_integrators())
    turn = 2 * np.pi / 300.0
    turns = round(2.0 / turn)  # e^-75 of the transient is left
    signals = ["angle.output", "path.output", "area.output", "rotor.displacement"]
    run = simulate(diagram, stop=turns * turn, step=turn / 400, record=signals)
    start = simulate(diagram, initial=settled_start(diagram), stop=turn, step=turn / 400, record=signals)
    for name in signals[1:]:
        assert start[name][0] == pytest.approx(run[name][-1], rel=1e-7, abs=1e-14)
    assert start["angle.output"][0] == pytest.approx(0.3, rel=1e-12)  # less the turns that the run has made


def test_a_free_disc_stays_about_its_start_without_its_drift() -> None:
    """m x'' = F: a run from rest would drift; its settled motion has neither mean velocity nor mean displacement."""
    machine = jeffcott(4e5, 150.0)
    machine["blocks"] = {name: machine["blocks"][name] for name in ("clock", "unbalance")}
    machine["blocks"] |= {"speed": {"type": "integrator"}, "place": {"type": "integrator"}}
    machine["wires"] = [
        wire for wire in machine["wires"] if {one.split(".")[0] for one in wire} <= {"clock", "unbalance"}
    ]
    machine["wires"] += [["unbalance.force", "speed.input"], ["speed.output", "place.input"]]
    machine["record"] = ["place.output"]
    start = settled_start(load(machine))
    turn = 2 * np.pi / 300.0
    run = simulate(load(machine), initial=start, stop=turn, step=turn / 400, record=["place.output"])
    assert np.abs(run["place.output"][:-1].mean(axis=0)).max() < 1e-9 * np.abs(run["place.output"]).max()


SAMPLED = {"type": "discrete_pid", "parameters": {"KP": 12500.0, "KI": 3e5, "KD": 3.75}}


def sampled(sample_time: float, samples: float) -> tuple[dict[str, Any], float]:
    """Return a disc under gravity that turns in so many samples of its controller, and the time of a turn [s]."""
    controller = {"type": "discrete_pid", "parameters": {**SAMPLED["parameters"], "sample_time": sample_time}}
    machine = jeffcott(4e5, 150.0, controller)
    machine["parameters"]["speed"] = 2 * np.pi / (samples * sample_time)
    machine["blocks"]["weight"] = {"type": "constant", "parameters": {"value": [0.0, -19.62]}}
    machine["wires"].append(["weight.output", "rotor.force"])
    machine["solver"]["step"] = 1e-5
    return machine, samples * sample_time


def sampled_apart() -> tuple[dict[str, Any], float]:
    """Return one whose sensor is sampled at another rate, and whose velocity the controller makes itself."""
    machine, turn = sampled(1e-4, 130.0)
    machine["blocks"]["sensor"] = {"type": "sample_hold", "parameters": {"sample_time": 5e-5}}
    machine["wires"].remove(["rotor.displacement", "controller.displacement"])
    machine["wires"].remove(["rotor.velocity", "controller.velocity"])
    machine["wires"] += [["rotor.displacement", "sensor.input"], ["sensor.output", "controller.displacement"]]
    return machine, turn


def nonlinear() -> dict[str, Any]:
    machine = sampled(1e-4, 130.0)[0]
    machine["blocks"]["amb"] = {"type": "amb_nonlinear"}
    return machine


def falling() -> dict[str, Any]:
    """Return a disc, and a free body that gravity moves."""
    machine = sampled(1e-4, 130.0)[0]
    machine["blocks"] |= {name: {"type": "integrator", "parameters": {"initial": [0.0, 0.0]}} for name in ("v", "s")}
    machine["wires"] += [["weight.output", "v.input"], ["v.output", "s.input"]]
    return machine


@pytest.mark.parametrize(
    ("machine", "turn", "turns"),
    [
        (*sampled(1e-4, 130.0), 1),
        (*sampled(1.2e-4, 108.25), 4),  # images fall between the orders: it returns after four turns
        (*sampled_apart(), 1),
    ],
)
def test_a_sampled_run_returns_from_its_first_sample(machine: dict[str, Any], turn: float, turns: int) -> None:
    """It is what a run from rest comes to: with its samples and what is held at the same angle of the shaft."""
    signals = ["rotor.displacement", "rotor.velocity", "controller.current"]
    again = turns * turn
    whole = int(np.ceil(3.0 / again)) * again
    n = round(again / 1e-5)
    long = simulate(load(machine), stop=whole, record=signals)
    start = simulate(load(machine), initial=settled_start(load(machine)), stop=2 * again, record=signals)
    for name in signals:
        size = np.ptp(start[name], axis=0).max()
        assert np.abs(start[name][n:-1] - start[name][:n]).max() < 1e-9 * size, name
        assert np.abs(start[name][:n] - long[name][-n - 1 : -1]).max() < 1e-7 * size, name


def test_what_nothing_returns_is_where_a_sampled_run_would_have_brought_it() -> None:
    """Beside the samplers: an angle that grows, integrals of speed and of place."""
    machine, turn = sampled(1e-4, 130.0)
    machine["blocks"] |= {
        name: block for name, block in with_integrators()["blocks"].items() if block["type"] == "integrator"
    }
    machine["wires"] += with_integrators()["wires"][-3:]
    turns = round(2.0 / turn)
    signals = ["angle.output", "path.output", "area.output", "rotor.displacement"]
    run = simulate(load(machine), stop=turns * turn, record=signals)
    start = simulate(load(machine), initial=settled_start(load(machine)), stop=turn, record=signals)
    for name in signals[1:]:
        np.testing.assert_allclose(start[name][0], run[name][-1], rtol=1e-6, atol=1e-12)
    assert start["angle.output"][0] == pytest.approx(0.3, rel=1e-12)
    assert start["angle.output"][-1] == pytest.approx(0.3 + 2 * np.pi, rel=1e-12)


@pytest.mark.parametrize(
    ("machine", "text"),
    [
        (
            jeffcott(4e5, -10.0),
            "error: disc: its settled motion is not stable: no run stays there\n\n"
            "hint: `rotorsim modes` shows what grows",
        ),
        (
            jeffcott(4e5, 1.0, {"type": "discrete_pid", "parameters": {"KP": 12500.0, "KI": 0.0, "KD": 0.0}}),
            "error: disc: its settled motion is not stable: no run stays there\n\n"
            "hint: `rotorsim modes` shows what grows",
        ),
        (
            nonlinear(),
            "error: rotor: with sampled blocks a diagram must be linear, with constant coefficients\n\n"
            "hint: take the linear block ('amb' for 'amb_nonlinear'), or `rotorsim swap` a continuous controller in",
        ),
        (
            falling(),
            "error: disc: no settled motion: constant forcing drives what nothing returns, faster from turn to turn\n\n"
            "hint: `rotorsim run` it without a settled start",
        ),
        (
            {**jeffcott(4e5, 1.0), "parameters": {"speed": "0 rad/s"}},
            "error: speed: its speed is zero: there is no turn to be periodic in\n\n"
            "hint: give a speed, and a clock that does not accelerate",
        ),
    ],
)
def test_where_there_is_none(machine, text: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        settled_start(load(machine))
    assert str(caught.value) == text


@pytest.mark.parametrize("shape", [(1,), (7,), (6, 2)])
def test_states_that_are_none_of_the_diagram_are_refused(shape: tuple[int, ...]) -> None:
    """FAULT: one state too many was given to every sampled block, one alone to every other."""
    model = load(sampled(1e-4, 130.0)[0])
    count = len(settled_start(model))
    for diagram, known in ((load("jeffcott"), "6"), (model, f"4, or {count} with those of its sampled blocks behind")):
        with pytest.raises(RotorsimError) as caught:
            simulate(diagram, initial=np.zeros(shape), stop=0.01)
        assert [problem.what for problem in caught.value.problems] == [
            f"states of shape {shape}: the diagram has {known}"
        ]
        assert caught.value.problems[0].subject == "initial"
