"""Runs whose speed changes: the angle from pulses, identification along it, and structures of slow modes only."""

from dataclasses import replace
from math import tau
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.errors import Place, RotorsimError
from rotorsim.identification.as_recorded import simulate_as_recorded
from rotorsim.identification.identification import identify
from rotorsim.identification.waveform.driven.equations import driven_equations
from rotorsim.identification.waveform.late_pulses import on_time
from rotorsim.identification.waveform.linearised import linearised, places_of
from rotorsim.identification.waveform.noise import weights_of
from rotorsim.identification.waveform.noise_model import noise_model
from rotorsim.identification.waveform.open_angle import ANGLE_ERRORS, CHANCE, OpenAngle, open_angle
from rotorsim.identification.waveform.recorded.along_angle import (
    along_angle,
    is_in_time,
    turned_later,
    unused_channels,
    with_reaction,
)
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun, channels_of
from rotorsim.identification.waveform.recorded.reading import read_runs
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.shooting import angle_starts
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.model.load import load
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.turning import turning
from tests.identification.waveform.run_up import (
    JITTER,
    RATE,
    Machine,
    drawn,
    held,
    pulses,
    ramp,
    recorded,
    recording,
    runs_of,
)

BENT = ramp(500, 5600, 3.0, 0.5)


def pulsed(angle, duration: float, seed: int = 1) -> tuple[Recording, Run]:
    time = np.arange(round(duration * 1000)) / 1000
    tacho = pulses(angle, time, np.random.default_rng(seed))
    run = Run("up", "up.npz", time, {}, None, tacho, {}, "identify", Place("recording.json", 3, 4), 1000.0)
    return recording(run), run


def test_the_angle_is_smoother_than_its_pulses():
    made, run = pulsed(BENT, 3.0)
    shaft, (theta, speed, acceleration) = turning(made, run), BENT(run.time)
    known = np.isfinite(shaft.theta)
    first, last = run.tacho[[0, -1]]
    inside = (run.time >= first) & (run.time <= last)
    assert known[inside].all()
    off = (shaft.theta - theta)[known]
    off -= tau * np.round(off.mean() / tau)
    assert np.abs(off).max() < np.radians(3.0)  # beyond the pulses it is known to one
    off = off[inside[known]]
    assert np.sqrt(np.mean(off**2)) < JITTER * speed.mean()  # less than that of a pulse
    assert np.abs(shaft.speed - speed)[known].max() < 1e-3 * speed.max()
    assert np.sqrt(np.mean((shaft.acceleration - acceleration)[known] ** 2)) < 0.02 * acceleration.max()


def test_a_constant_acceleration_holds_for_one_turn_beyond_the_pulses():
    angle = ramp(600, 3000, 2.0)
    made, run = pulsed(angle, 2.0)
    shaft = turning(made, run)
    assert np.isfinite(shaft.theta).all()  # less than a turn is missing at either end
    np.testing.assert_allclose(shaft.acceleration, 40 * np.pi, rtol=1e-3)
    cut = replace(run, tacho=run.tacho[5:])
    theta = turning(made, cut).theta
    assert np.nanmin(theta) >= -tau
    assert np.isnan(theta[:100]).all()


def test_a_recorded_angle_stays_as_it_is_and_has_smooth_derivatives():
    time = np.arange(2000) / 1000
    theta, speed, acceleration = ramp(3000, 300, 2.0, 0.3)(time)
    rough = theta + 1e-3 * np.random.default_rng(2).normal(size=2000)
    channels = {"a": Channel("a", "clock.theta", None, None, None, "rad")}
    run = Run("down", "down.npz", time, {"a": rough}, None, None, {}, "identify", Place(""), 1000.0)
    shaft = turning(Recording("rig", "", Path(), channels, (run,)), run)
    np.testing.assert_array_equal(shaft.theta, rough)
    assert np.abs(shaft.speed - speed).max() < 1e-2 * speed.max()
    assert np.sqrt(np.mean((shaft.acceleration - acceleration) ** 2)) < 0.05 * np.abs(acceleration).max()


def test_only_speeds_that_change_make_a_recording_one_in_time():
    steady = recording(recorded("steady", Machine(), ramp(3000, 3003, 0.4), 0.4, 1))
    up = recorded("up", Machine(), ramp(1000, 3000, 0.4), 0.4, 1)
    jeffcott = load("jeffcott")
    assert not is_in_time(jeffcott, steady)
    assert is_in_time(jeffcott, recording(up))
    assert is_in_time(jeffcott, recording(*steady.runs, up))


def test_unbalances_are_wired_to_the_acceleration_once():
    wired = with_reaction(load("jeffcott"))
    assert ["clock.acceleration", "unbalance.acceleration"] in wired.document["wires"]
    assert with_reaction(wired) is wired
    assert [str(one) for one in wired.warnings] == [
        "warning: jeffcott: unbalance.acceleration is wired to clock.acceleration: the speed changes in these runs"
    ]
    cut = load("jeffcott", without=["unbalance"])
    assert with_reaction(cut) is cut


@pytest.mark.slow
def test_the_right_diagram_leaves_the_noise_of_a_run_up():
    """Pulses jitter by 1.5 us, 0.9 mrad at 5600 rpm; once smoothed, that is not seen any more."""
    machine = Machine()
    run = recorded("up", machine, ramp(500, 5600, 2.0, 0.5), 2.0, 7)
    found = simulate_as_recorded(load("jeffcott", set=machine.parameters), recording(run))
    white = {"rotor.displacement[1]": 3e-8, "controller.current[2]": 5e-4}
    for name, rms in white.items():
        assert rms < found.errors.rms[name] < 1.15 * rms  # with a third of slow noise and of pick-up: 1.106
    assert "clock.acceleration" in found.result.signals


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_parameters_come_back_from_run_ups(seed):
    machine = drawn(seed)  # its angles are anywhere, its gains differ from run to run
    found = identify(load("jeffcott"), runs_of(machine, seed, 2.0))
    assert found.adequate
    for name, truth in machine.parameters.items():
        one = found.parameters[name]
        most = np.radians(0.5) if one.unit == "rad" else truth * (0.03 if "displacement" in name else 0.01)
        assert abs(one.value - truth) < most, name
        assert abs(one.value - truth) < 4 * one.std, name


@pytest.mark.slow
def test_parameters_come_back_from_a_ramp_that_ends_in_a_hold():
    """FAULT: angles were off by radians, and the right diagram left 38 times the variance of the noise."""
    machine = Machine()
    up, down = held(ramp(500, 5600, 2.0), 1.5), held(ramp(5600, 800, 2.0), 1.7)
    made = recording(recorded("up", machine, up, 2.0, 1), recorded("down", machine, down, 2.0, 2))
    found = identify(load("jeffcott"), made)
    assert found.adequate
    for name, truth in machine.parameters.items():
        one = found.parameters[name]
        most = np.radians(0.5) if one.unit == "rad" else truth * (0.03 if "displacement" in name else 0.01)
        assert abs(one.value - truth) < min(most, 4 * one.std), name


@pytest.mark.slow
@pytest.mark.parametrize("stamped", [np.ceil, np.floor])
def test_sampled_pulses_are_late_alike(stamped):
    """FAULT: angles were 12 standard deviations off, and nothing said so: half a sample is 3.4 deg at the end."""
    machine = Machine()
    fine = runs_of(machine, 3, 3.0)
    runs = tuple(replace(run, tacho=stamped(run.tacho * RATE) / RATE) for run in fine.runs)
    found = identify(load("jeffcott"), replace(fine, runs=runs))
    for name, truth in machine.parameters.items():
        one = found.parameters[name]
        assert abs(one.value - truth) < 3 * one.std, name
        assert one.unit != "rad" or abs(one.value - truth) < np.radians(0.5), name


def test_errors_of_an_angle_are_those_of_its_speed_and_acceleration():
    made, run = pulsed(BENT, 3.0)
    own = along_angle(load("jeffcott"), made).runs[0]
    known = np.isfinite(own.values["clock.theta"])
    sampled = SampledRun("up", own.values, {}, run.time, {}).part(np.flatnonzero(known))
    inside = (sampled.time > run.tacho[0]) & (sampled.time < run.tacho[-1])
    curve = turning(made, run).curve
    angle = open_angle(load("jeffcott"), made, [sampled])
    off = [angle.turned(sampled, one) for one in np.eye(len(angle.errors))]
    assert len(off) == min(curve.principal(run.time).root.shape[1], ANGLE_ERRORS)
    for other in off[:: len(off) // 3]:
        theta, speed = (other.values[name] - sampled.values[name] for name in ("clock.theta", "clock.speed"))
        assert 0 < np.abs(theta)[inside].max() < 3 * JITTER * 600
        np.testing.assert_allclose(np.gradient(theta, 1e-3)[2:-2], speed[2:-2], atol=2e-2 * np.abs(speed).max())


@pytest.mark.slow
def test_an_angle_that_is_off_throughout_counts_as_late_pulses_do():
    diagram, made = with_reaction(load("jeffcott")), recording(recorded("up", Machine(), ramp(600, 5000, 1.5), 1.5, 3))
    made = along_angle(diagram, made)
    channels = channels_of(diagram, made)
    runs = read_runs(diagram, made.runs, channels)
    noise = noise_model(diagram, channels, runs)
    weights = weights_of(noise.variance, runs, noise.rows)
    search = OutputErrorSearch(subsystems_of(diagram, channels), runs, weights, noise.least)
    start = search.first(noise.starts)
    start[: search.m] = noise.theta
    found = search.minimise(start)
    later = [turned_later(run, diagram, 1e-6) for run in runs]
    own = replace(search, runs=later).evaluate(found.unknowns, found.sub).gradient - found.gradient
    [other] = OpenAngle(diagram, 1e-6)._changes(search, found).gradients.T
    np.testing.assert_allclose(other[: search.m], own[: search.m], rtol=0.05, atol=0.02 * np.abs(own).max())


def rough_up(machine: Machine):
    """Return a diagram, channels, runs and recording of a ramp and a hold whose pulses scatter by 50 us."""
    angle = held(ramp(500, 5600, 3.0), 2.2)
    run = recorded("up", machine, angle, 3.0, 3)
    rough = run.tacho + 50e-6 * np.random.default_rng(5).standard_normal(len(run.tacho))
    diagram, made = with_reaction(load("jeffcott")), recording(replace(run, tacho=np.sort(rough)))
    along = along_angle(diagram, made)
    channels = channels_of(diagram, along)
    return diagram, channels, read_runs(diagram, along.runs, channels), made, angle


@pytest.mark.slow
def test_the_motion_tells_the_angle_between_pulses():
    """FAULT: a healthy machine left 12 times its noise where a ramp ended: all that pulses left open was missing."""
    diagram, channels, runs, made, angle = rough_up(Machine())
    timed = on_time(diagram, channels, runs, made)

    def off(run: SampledRun) -> np.ndarray:
        error = run.values["clock.theta"] - angle(run.time)[0]
        return error - error.mean()  # what is left is a phase

    before, after = off(runs[0]), off(timed.runs[0])
    assert np.std(before) > 2e-3
    assert np.std(after) < np.std(before) / 3
    [curve] = timed.angle.curves.values()
    corner = curve.centre + curve.half * curve.spline.jumps[0]
    assert corner == pytest.approx(2.2, abs=1e-3)  # by pulses to 4 ms
    said = np.linalg.norm(curve.errors(runs[0].time) @ timed.angle.factor, axis=1)
    assert np.mean(after**2) < 2 * np.mean(said**2)
    assert timed.noise.variance["", "rotor.displacement[1]"] < 1.2 * (3e-8) ** 2 * 11 / 9
    found = identify(load("jeffcott"), made)
    assert found.adequate
    for name, truth in Machine().parameters.items():
        assert abs(found.parameters[name].value - truth) < 3 * found.parameters[name].std, name


@pytest.mark.slow
def test_errors_that_pulses_exclude_are_not_made():
    """Of a shaft with a bow that the diagram has not, what is missing is no error of the angle."""
    diagram, channels, runs, made, _ = rough_up(Machine(bow=6e-6, stiffness_y=5e4))
    timed = on_time(diagram, channels, runs, made)
    off = timed.runs[0].values["clock.theta"] - runs[0].values["clock.theta"]
    angle = open_angle(diagram, made, runs)
    assert np.sqrt(np.mean((off / angle.std(runs[0])) ** 2)) < np.sqrt(chi2.isf(CHANCE, len(angle.errors)))


def test_a_measured_speed_beside_the_angle_is_said_not_to_be_used():
    [run] = runs_of(Machine(), 1, 1.0).runs[:1]
    made = recording(run)
    assert unused_channels(load("jeffcott"), made) == []
    channels = {**made.channels, "n": Channel("n", "clock.speed", None, None, None, "rad/s")}
    [said] = unused_channels(load("jeffcott"), replace(made, channels=channels))
    assert said.what == "is not used: the speed of the shaft is taken from its angle"
    assert said.subject == "channel n"


def test_a_shaft_is_later_by_its_speed():
    [run] = runs_of(Machine(), 1, 1.0).runs[:1]
    values = {"clock.theta": 3.0 * run.time, "clock.speed": np.full(len(run.time), 3.0), "clock.acceleration": run.time}
    later = turned_later(SampledRun("up", values, {}, run.time, {}), load("jeffcott"), 0.1)
    np.testing.assert_allclose(later.values["clock.theta"], 3.0 * (run.time + 0.1), rtol=1e-12)
    np.testing.assert_allclose(later.values["clock.speed"], 3.0 + 0.1 * run.time, rtol=1e-12)


def test_several_starts_of_free_angles_are_followed_the_best_first():
    """FAULT: a crack ended on the far side of the shaft, since magnitudes that are off turn the best angle.

    The six best of a grid of 60 deg, with bounded angles as they are.
    """
    best = np.radians([60.0, -120.0])
    costs = []

    def evaluate(x: np.ndarray, sub: int, sensitivities: bool) -> SimpleNamespace:
        costs.append(float((1 - np.cos(x[:2] - best)) @ [1.0, 0.3]))
        return SimpleNamespace(cost=costs[-1])

    search = SimpleNamespace(angles=np.array([0, 1]), substeps=lambda x: 1, evaluate=evaluate)
    starts = angle_starts(search, np.array([0.0, 0.0, 0.7]))
    assert len(costs) == 36
    assert len(starts) == 6
    np.testing.assert_allclose(starts[0], [*best, 0.7], atol=1e-12)
    follow = [float((1 - np.cos(x[:2] - best)) @ [1.0, 0.3]) for x in starts]
    np.testing.assert_allclose(follow, sorted(costs)[:6], atol=1e-12)
    [only] = angle_starts(SimpleNamespace(angles=[], substeps=lambda x: 1), best)
    assert only is best


def test_fast_modes_leave_their_flexibility_and_slow_ones_as_they_are():
    diagram = load("fe_rigid")
    names = ["rotor.displacement[2,1]", "rotor.displacement[4,2]", "controller.current[1]"]
    given = ("clock.theta", "clock.speed")
    whole = driven_equations(diagram, names, given, ())
    less = driven_equations(diagram, names, given, (), fastest=1e4)
    assert (whole.n, less.n) == (42, 18)  # four modes of each plane are slower, and two integrals
    assert set(less.state_names) < set(whole.state_names)
    p, v = whole.model.parameter_vector(), np.array([0.3, 300.0])

    def modes(equations):
        values = np.linalg.eigvals(equations.matrices[0](0.0, np.zeros(equations.n), v, p)[0])
        return np.sort(np.abs(values))[:18]

    np.testing.assert_allclose(modes(less), modes(whole), rtol=1e-4)

    def static(equations):
        x = np.zeros(equations.n)
        A, C = (matrix(0.0, x, v, p)[0] for matrix in equations.matrices)
        f, g = _values(equations, x, v, p)
        return g - C @ np.linalg.solve(A, f)

    np.testing.assert_allclose(static(less)[:2], static(whole)[:2], rtol=1e-9)


def test_a_signal_added_to_a_beam_moves_it_beside_the_modes_that_stay_as_beside_all():
    """FAULT: along a run-up it was linearised with all modes, about a motion of those that stay: an internal error.

    A force at 120 Hz for 20 ms: what is faster than 1e4 rad/s adds its flexibility, good to (w / W)^2.
    """
    given = load("fe_rigid").document
    push = {"type": "constant", "parameters": {"value": 0.0}}
    wires = [*given["wires"], ["push.output", "rotor.force[4,1]"]]
    diagram = load({**given, "blocks": {**given["blocks"], "push": push}, "wires": wires})
    names = ("rotor.displacement[2,1]", "rotor.displacement[4,1]", "controller.current[1]")
    t = np.arange(400) / 2e4
    speed = 300.0 + 500.0 * t
    angle = {
        "clock.theta": 300.0 * t + 250.0 * t**2,
        "clock.speed": speed,
        "clock.acceleration": np.full_like(t, 500.0),
    }
    kinds = dict.fromkeys(angle, "smooth")
    run = SampledRun("up", {**angle, **dict.fromkeys(names, 0 * t)}, kinds, t, {})
    force = np.sin(tau * 120.0 * t) * np.hanning(len(t))
    moved = []
    for fastest, states in ((None, 42), (1e4, 18)):
        [whole, *_] = subsystems_of(diagram, Channels((*kinds,), names, {}, kinds, fastest=fastest))
        search = OutputErrorSearch([whole], [run], dict.fromkeys(whole.signals, 1.0), hold="theta")
        evaluation = search.evaluate(search.first(), search.substeps(search.first()))
        places = places_of(diagram, names)
        [along] = linearised(diagram, search, evaluation, places)
        assert along.F.shape == (len(t), states, states)
        [at] = [k for k, place in enumerate(places) if place.port == "push.output"]
        moved.append(along.responses(at, force[:, None])[:, :, 0])
    size = np.abs(moved[0]).max(axis=0)
    assert (size[:2] > 1e-6).all()
    np.testing.assert_array_less(np.abs(moved[1] - moved[0]).max(axis=0) / size, (tau * 120.0 / 1e4) ** 2)


def _values(equations, x, v, p):
    import casadi as ca

    function = ca.Function("fg", list(equations.arguments), [equations.f, equations.g])
    return (np.array(part).ravel() for part in function(0.0, x, v, p))


def test_what_cannot_turn_as_recorded_is_said_at_once():
    made, run = pulsed(ramp(600, 3000, 1.0), 1.0)
    blind = replace(run, id="blind", tacho=None, speed=100.0, place=Place("recording.json", 9, 5))
    with pytest.raises(RotorsimError) as caught:
        along_angle(load("silverbox"), replace(made, runs=(run, blind)))
    assert str(caught.value) == (
        "error: silverbox: has no clock: which one turns as recorded is not known\n\n"
        "hint: one block 'clock' gives the angle of the shaft\n"
        "recording.json:9:5: error: run blind: its shaft angle was not recorded\n\n"
        'hint: give "tacho": times of a once-per-turn pulse, or a channel of clock.theta'
    )
