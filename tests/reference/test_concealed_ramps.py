"""Run-ups of the concealed machines, against another integrator, and how they are drawn and written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_limits

from benchmarks.concealed import generator
from benchmarks.concealed.core import Core
from benchmarks.concealed.generator import RATE
from benchmarks.concealed.machines import MACHINES, fe_rigid, nominal_parameters
from benchmarks.concealed.plant import switching
from benchmarks.concealed.simulate import Run, Simulation
from benchmarks.concealed.writing import write_case
from rotorsim.recordings.loading import load_recording

RAMP, GAINS = 0.04, ((12200.0, 2000.0, 3.0),)


@pytest.mark.parametrize("gyroscopic", [1.0, 20.0])
def test_a_ramp_that_ends_agrees_with_another_integrator(gyroscopic: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """By explicit Runge-Kutta steps; with a disc of twenty times its inertia, whose moments matter, too."""

    def machine(*given: object) -> object:
        plant = fe_rigid(*given, parts=1)  # type: ignore[arg-type]
        plant.gyroscopic = plant.gyroscopic * gyroscopic
        return plant

    monkeypatch.setitem(MACHINES, "fe_rigid", machine)  # type: ignore[arg-type]
    p = {**nominal_parameters("fe_rigid"), "beta": 0.4, "crack_phase": -1.0}
    run = Run(60.0, 0.3, GAINS, "A", 400, "identify", 5e3, RAMP)
    with threadpool_limits(1):
        simulation = Simulation("fe_rigid", p, [run], RATE)
        w = simulation.beginning(-simulation.sample)
        motion = simulation.follow(w)
    plant, begin = simulation.plants[0], simulation.sample
    n, inverse, [bearing] = plant.size, np.linalg.inv(plant.mass), plant.bearings
    at, unbalance = plant.displacement, plant.unbalances[0]

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        q, v, summed = y[:n], y[n : 2 * n], y[-1]
        on = min(t + begin, RAMP)
        theta = run.start + run.speed * t + run.acceleration * (on * (t + begin) - on**2 / 2)
        rate, more = run.speed + run.acceleration * on, run.acceleration * (t + begin < RAMP)
        seen, its_rate = (plant.probes[bearing.probe] @ x for x in (q, v))
        F, a = np.zeros(n, complex), theta + p["crack_phase"]
        F[at[4]] += 0.5 * switching(a) * p["dk"] * plant.crack.sag * (1 + np.exp(2j * a))
        F[at[3]] += unbalance.mass * p["e"] * (rate**2 - 1j * more) * np.exp(1j * (theta + p["beta"]))
        F[at[3]] += p["ks"] * q[at[3]] - p["ki"] * (12200.0 * seen + 2000.0 * summed + 3.0 * its_rate)
        F -= (plant.damping - 1j * rate * plant.gyroscopic) @ v + plant.stiffness @ q
        return np.concatenate([v, inverse @ F, [seen]])

    y, t, parts = Core(plant, run.speed).eigen()[1] @ w[0], np.arange(run.samples) / RATE, []
    for first, last in ((-begin, RAMP - begin), (RAMP - begin, t[-1])):  # the acceleration jumps between
        found = solve_ivp(rates, (first, last), y, "DOP853", rtol=1e-10, atol=1e-16, dense_output=True)
        y = found.y[:, -1]
        parts.append(found.sol(t[(t >= first) & (t < last + (last == t[-1]))]))
    expected = np.concatenate(parts, axis=1)
    for node in (2, 3, 4, 5):
        shown = plant.probes[node] @ expected[:n]
        np.testing.assert_allclose(motion.signals[f"p{node}"][0], shown, rtol=0, atol=1e-8 * np.abs(shown).max())


@pytest.mark.slow
def test_a_case_is_drawn_written_and_read(tmp_path: Path) -> None:
    """Up, down, up with other gains, one of which holds its speed at last; two more held out; no speed is told."""
    seed = (3, 1, 1, 0)
    case = generator.make_case("ramp", "one", "fe_rigid", seed, 0, ("seal_cross_coupling",), ramps=True)
    ups = [(run.acceleration > 0, run.label, run.use == "identify") for run in case.runs]
    assert ups == [(True, "A", True), (False, "A", True), (True, "B", True), (True, "C", False), (False, "A", False)]
    assert sum(np.isfinite(run.ramp) for run in case.runs) == 1
    assert case.visible > generator.LEAST_BEAM
    write_case(case, tmp_path, seed)
    recording = load_recording(tmp_path / "ramp")
    assert [run.id for run in recording.runs] == ["run00_up_A", "run01_down_A", "run02_up_B"]
    stated = json.loads((tmp_path / "ramp" / "recording.json").read_text())["runs"][0]
    assert "speed" not in stated
    turns = np.diff(stated["tacho"])
    assert turns[0] > 5 * turns[-1]


def test_what_holds_at_constant_speed_only_is_not_drawn_on_ramps() -> None:
    rows = {
        name for k in range(80) for name in [generator._choose((1, 2), "one", "jeffcott", k, (), True)[0].make.__name__]
    }
    assert not rows & {*generator.STEADY}
    assert {"residual_bow", "rub"} <= rows
