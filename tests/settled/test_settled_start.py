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


@pytest.mark.parametrize(
    ("machine", "text"),
    [
        (
            jeffcott(4e5, -10.0),
            "error: disc: its settled motion is not stable: no run stays there\n\n"
            "hint: `rotorsim modes` shows what grows",
        ),
        (
            jeffcott(4e5, 1.0, {"type": "discrete_pid"}),
            "error: controller: a settled start needs continuous blocks; this one has a sample time\n\n"
            "hint: `rotorsim swap` a continuous controller in, or use `rotorsim run`",
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
