"""Events of FMUs for Model Exchange: of time, of state, of steps, of inputs; against formulas."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate
from tests.fmi.events import alone, events_fmu
from tests.model.documents import sampled

H = 1e-2
G, E = 9.81, 0.8
ENDLESS = "\n\nhint: events accumulate: a contact that comes to rest, or a relay without hysteresis, inside the FMU"


@pytest.fixture(params=["1.0", "2.0", "3.0"])
def fmu(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return events_fmu(tmp_path, request.param)


class Run:
    """Runs a model of the FMU alone: as a participant, or with the steps of the diagram."""

    def __init__(self, how: str) -> None:
        self.how = how
        self.short = H if how == "run" else 0.0  # the step that fails is not recorded

    def __call__(self, file: Path, model: str, stop: float, step: float = H, **values: Any) -> Result:
        diagram = alone(file, model, step=step, stop=stop, **values)
        return simulate(diagram) if self.how == "run" else cosimulate_diagram(diagram, step=step, master="jacobi")

    def stopped(self, what: str, until: float) -> str:
        """Return the message of a run that stops."""
        return f"it: {what}" + (f"; what was computed until t = {until:.6g} s is kept" if self.how == "run" else "")


@pytest.fixture(params=["cosim", "run"])
def run(request: pytest.FixtureRequest) -> Run:
    return Run(request.param)


def changes(found: Result) -> np.ndarray:
    """Return the times of the events, as the FMU saw them."""
    when = found["it.when"]
    return np.asarray(when[1:][np.diff(when) != 0])


def bounces(count: int, height: float = 1.0) -> np.ndarray:
    """Return the times at which a ball falls on the ground: flights of 2 E^k v / G."""
    first = np.sqrt(2 * height / G)
    return np.asarray(first + np.concatenate([[0.0], np.cumsum(2 * first * E ** np.arange(1, count))]))


@pytest.mark.parametrize("apart", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_bouncing_ball(fmu: Path, apart: bool, run: Run) -> None:
    """RK4 is exact on parabolas. A bounce seen d too late is g d too fast, and makes later flights 2 E^k d longer.

    With d = 1e-12 of a step that is below 6 (1 + 2 E / (1 - E)) d after six bounces.
    """
    found = run(fmu, "ball", 3.0, in_process=not apart)
    times = changes(found)
    count = len(times)
    assert count == 6
    assert np.abs(times - bounces(count)).max() < 6 * (1 + 2 * E / (1 - E)) * 1e-12 * H
    last = times[-1]
    t = found.time[found.time > last] - last
    v = G * times[0] * E**count
    assert found["it.x"][found.time > last] == pytest.approx(v * t - G / 2 * t**2, abs=1e-11)


def test_a_ball_that_starts_on_the_ground(fmu: Path, run: Run) -> None:
    """Its indicator is exactly zero and it moves up: no event there, and the first fall is not missed."""
    found = run(fmu, "ball", 0.5, x0=0.0, v0=2.0)
    assert changes(found) == pytest.approx([4 / G], abs=1e-13)
    assert found["it.count"][-1] == 1.0


@pytest.mark.slow
def test_a_ball_that_comes_to_rest_is_an_error_and_no_endless_loop(fmu: Path, run: Run) -> None:
    found = run(fmu, "ball", 6.0)
    end = bounces(1)[0] * (1 + 2 * E / (1 - E))
    assert found.status == "stopped"
    said = f"event indicator 1 crosses zero again and again (t = {end:.9g} s)"
    assert found.message == run.stopped(said, np.floor(end / H) * H) + ENDLESS
    assert found.time[-1] == pytest.approx(np.floor(end / H) * H - run.short)


def test_a_relay_without_hysteresis_is_an_error(fmu: Path, run: Run) -> None:
    found = run(fmu, "chatter", 2.0, x0=1.005)
    assert found.status == "stopped"
    said = "event indicator 1 crosses zero again and again (t = 1.005 s)"
    assert found.message == run.stopped(said, 1.0) + ENDLESS
    assert found.time[-1] == pytest.approx(1.0 - run.short)


@pytest.mark.slow
def test_a_relay_with_hysteresis(fmu: Path, run: Run) -> None:
    """x' = (2 on - x) / 1 s between 0.5 and 1.5: ln 2 to the first switching, ln 3 between others.

    RK4 errs by h^4 / 120 of the time constant in the time itself, relative (h = 1 ms: 1e-14).
    """
    times = changes(run(fmu, "relay", 3.0, step=1e-3))
    exact = np.log(2) + np.log(3) * np.arange(len(times))
    assert len(times) == 3
    assert np.abs(times - exact).max() < 1e-13
    coarse = changes(run(fmu, "relay", 3.0, step=0.1))
    finer = changes(run(fmu, "relay", 3.0, step=0.05))
    order = np.log2(np.abs(coarse - exact).max() / np.abs(finer - exact).max())
    assert order == pytest.approx(4, abs=0.2)


def test_time_events_are_met_exactly(fmu: Path, run: Run) -> None:
    """x' = number of ticks: the integral is a broken line, exact by RK4 only where every tick ends a step."""
    tick = 0.0237
    found = run(fmu, "clock", 1.0, tick=tick)
    t, n = found.time, np.floor(found.time / tick + 1e-9)
    assert np.array_equal(found["it.count"], n)
    assert found["it.x"] == pytest.approx(1 + n * t - tick * n * (n + 1) / 2, rel=1e-13)
    assert np.array_equal(np.unique(found["it.when"])[1:], [k * tick for k in range(1, int(n[-1]) + 1)])


@pytest.mark.slow
def test_more_time_events_than_steps(fmu: Path, run: Run) -> None:
    found = run(fmu, "clock", 1.0, tick=H / 7.3)
    n = np.floor(found.time / (H / 7.3) + 1e-9)
    assert np.array_equal(found["it.count"], n)


def test_an_event_is_iterated_until_its_discrete_states_are_settled(fmu: Path, run: Run) -> None:
    found = run(fmu, "stages", 0.5)
    assert found["it.count"][[24, 25]].tolist() == [0.0, 3.0]
    assert found["it.x"][-1] == pytest.approx(1 + 3 * 0.25, rel=1e-13)


def test_step_events_come_at_the_end_of_the_step(fmu: Path, run: Run) -> None:
    """A saw tooth that the FMU cuts when it is told of a completed step: at most one step too late."""
    found = run(fmu, "late", 2.0, x0=0.0, high=0.7031)
    assert changes(found) == pytest.approx([0.71, 1.41], abs=1e-12)
    assert found["it.x"][-1] == pytest.approx(2.0 - 2 * 0.7031, rel=1e-12)


def test_who_needs_no_reports_gets_none(tmp_path: Path, run: Run) -> None:
    found = run(events_fmu(tmp_path, reports=False), "late", 2.0, x0=0.0, high=0.7031)
    assert found["it.count"][-1] == 0.0


def test_an_indicator_that_comes_back_within_a_step_is_not_seen(fmu: Path, run: Run) -> None:
    """x = cos t is below -0.999 for 0.09 s around pi: seen with steps of 0.05 s, not with one of 0.5 s."""
    values = {"low": -0.999}
    assert run(fmu, "two", 4.0, step=0.05, **values)["it.count"][-1] == 2.0
    assert run(fmu, "two", 4.0, step=0.5, **values)["it.count"][-1] == 0.0


STEP_UP = {"source": {"type": "step", "parameters": {"time": 0.5, "final": 2.0}}}


def test_inputs_that_jump_across_zero_are_events(fmu: Path) -> None:
    """The input passes the level between two communication points: the event is at the point where it is told."""
    diagram = alone(fmu, "signal", step=H, stop=1.0, blocks=STEP_UP, wires=[["source.output", "it.u"]], x0=0.0)
    found = cosimulate_diagram(diagram, step=2 * H, master="gauss_seidel")
    assert changes(found) == pytest.approx([0.5], abs=1e-12)
    assert found["it.x"][-1] == pytest.approx(0.5, abs=1e-12)


def test_inputs_that_cross_within_a_step_are_located(fmu: Path) -> None:
    """u = 3 t is linear: what linear extrapolation gives is exact, and u = 1.5 at 0.5 s, within a step of 0.3 s."""
    ramp = {"source": {"type": "ramp", "parameters": {"slope": 3.0}}}
    diagram = alone(fmu, "signal", step=0.1, stop=1.2, blocks=ramp, wires=[["source.output", "it.u"]], x0=0.0)
    found = cosimulate_diagram(diagram, step=0.3, master="gauss_seidel", order=1)
    assert changes(found) == pytest.approx([0.5], abs=1e-12)
    assert found["it.x"][-1] == pytest.approx(0.7, abs=1e-12)


def test_discrete_inputs_are_set_by_events(fmu: Path) -> None:
    """x' = level, which may change in event mode only."""
    diagram = alone(fmu, "signal", step=H, stop=1.0, blocks=STEP_UP, wires=[["source.output", "it.level"]], x0=0.0)
    found = cosimulate_diagram(diagram, step=H, master="gauss_seidel")
    assert found["it.x"][-1] == pytest.approx(2.0 * 0.5, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "values", "time"),
    [("clock", {"stop_at": 3.0}, 0.75), ("ball", {"stop_at": 2.0}, bounces(2)[1]), ("late", {"stop_at": 0.355}, 0.36)],
)
def test_the_end_that_an_fmu_asks_for(fmu: Path, model: str, values: dict[str, float], time: float, run: Run) -> None:
    """In an event of time or state, or at a completed step: the run ends there, with a message, and is kept."""
    found = run(fmu, model, 3.0, **values)
    assert found.status == "stopped"
    until = np.floor(time / H + 1e-9) * H
    assert found.message == run.stopped(f"asks for the end of the simulation (t = {time:.9g} s)", until)
    if run.how == "cosim":
        assert found.time[-1] == pytest.approx(time, rel=1e-12)  # the last sample is there


# ---- steps that are taken back ----


def behind(file: Path, model: str, **values: Any) -> Any:
    """Return a diagram: the events, and an integrator of x behind them, which also feeds them (with no effect)."""
    blocks = {"sum": {"type": "integrator"}, "none": {"type": "gain", "parameters": {"gain": 1e-3}}}
    wires = [["it.x", "sum.input"], ["sum.output", "none.input"], ["none.output", "it.u"]]
    return alone(file, model, step=H, stop=1.0, blocks=blocks, wires=wires, **values)


@pytest.mark.slow
@pytest.mark.parametrize("reports", [False, True])
@pytest.mark.parametrize("model", ["clock", "ball"])
@pytest.mark.parametrize("how", [{"master": "iterative"}, {"adaptive": 1e-4, "order": 1}])
def test_discrete_states_are_taken_back_too(tmp_path: Path, reports: bool, model: str, how: dict[str, Any]) -> None:
    """Repeated steps go over the same event again and again: it must count once."""
    for version in ("2.0", "3.0"):
        diagram = behind(events_fmu(tmp_path, version, reports=reports), model)
        found = cosimulate_diagram(diagram, step=0.04, **how)
        assert found.status == "finished"
        assert found.counters["iterations" if "master" in how else "rejected"] > 0 or model == "ball"
        if model == "clock":
            assert np.array_equal(found["it.count"], np.floor(found.time / 0.25 + 1e-9))
            assert found["it.x"][-1] == pytest.approx(1 + 0.25 * (1 + 2 + 3), rel=1e-12)
        else:
            assert changes(found) == pytest.approx(bounces(1), abs=1e-12)


def test_who_cannot_be_set_back_is_refused(tmp_path: Path) -> None:
    diagram = behind(events_fmu(tmp_path, saves=False), "clock")
    with pytest.raises(RotorsimError, match="iterative master: cannot take a step back: it"):
        cosimulate_diagram(diagram, step=0.04, master="iterative")
    with pytest.raises(RotorsimError, match="adaptive steps: cannot take a step back: it"):
        cosimulate_diagram(diagram, step=0.04, adaptive=1e-4)


# ---- sampled blocks, exported as Model Exchange ----


@pytest.mark.parametrize(
    ("version", "period"),
    [
        ("2.0", 3.3e-3),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("2.0", 5e-3), ("3.0", 5e-3), ("3.0", 3.3e-3))),
    ],
)
def test_sampled_blocks_as_model_exchange(tmp_path: Path, version: str, period: float) -> None:
    """Noise, sample and hold, an integrator: their hits are time events; the same numbers as the diagram itself."""
    document = sampled(period, 2e-3)
    whole = simulate(load(document), stop=0.1)
    export_fmu(load(document), tmp_path / "s.fmu", version=version)
    block = {"type": "fmu", "file": "s.fmu", "parameters": {"interface": "me", "in_process": True}}
    text = {"name": "s", "blocks": {"s": block}, "wires": [], "solver": {"step": 1e-3, "stop": 0.1}, "record": []}
    made = load(json.loads(json.dumps(text)), folder=tmp_path, trust_blocks=True)
    found = cosimulate_diagram(made, step=1e-3, master="jacobi")
    for name in ("hold.output", "noise.output", "state.output"):
        mine = found[f"s.{name.replace('.', '_')}"]
        assert mine == pytest.approx(whole[name][: len(mine)], rel=1e-12, abs=1e-14), name
