"""Pulses that were sampled: what the angle says of its error against the error made, and what is said of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.errors import Place, RotorsimError
from rotorsim.identification.identification import identify
from rotorsim.measure.checks import check_signals
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.covariance import real_vector
from rotorsim.signals.harmonic_fit import Samples, fit_harmonics
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.shaft_angle import ShaftAngle, pulse_edges, pulse_resolution, shaft_angle, steady_limit
from tests.reference.jeffcott import Jeffcott

RATE, N = 5000.0, 5000
TIME = np.arange(N) / RATE
TURN, RPM = 2 * np.pi, np.pi / 30
PERIOD = 2e-4  # s


def recorded(kind: str, speed: float, start: float, **signals: np.ndarray) -> Recording:
    """Return one run whose pulse, at whole turns of start + speed t, was sampled: as a signal, or as times."""
    theta = speed * TIME + start
    pulses = (TURN * np.arange(np.ceil(start / TURN), np.floor(theta[-1] / TURN) + 1) - start) / speed
    channels = {name: Channel(name, f"rotor.{name}", None, None, None, "m") for name in signals}
    values, tacho = dict(signals), None
    if kind == "after":  # the first sample that sees the pulse
        tacho = np.ceil(pulses * RATE) / RATE
    elif kind == "nearest":
        tacho = np.round(pulses * RATE) / RATE
    elif kind == "timed":
        tacho = pulses
    else:  # an edge of so many samples
        phase = (theta + 1) % TURN - 1
        channels["key"] = Channel("key", "tacho", None, None, None, "V")
        long = max(float(kind), 1e-9) * PERIOD * speed
        values["key"] = 5 * np.clip(0.5 + phase / long, 0, 1) * (phase < 0.6)
    run = Run("run1", "a.npz", TIME, values, speed, tacho, {}, "identify", Place("recording.json", 7, 3), RATE)
    return Recording("made", "made", Path(), channels, (run,))


def angle_of(kind: str, speed: float, start: float) -> tuple[ShaftAngle, float]:
    """Return the angle, and by how much its zero is wrong [rad]."""
    recording = recorded(kind, speed, start)
    found = shaft_angle(recording, recording.runs[0])
    off = found.theta - speed * TIME - start
    return found, float(np.mean(off - np.round(off.mean() / TURN) * TURN))


@pytest.mark.slow
@pytest.mark.parametrize("speed", [600 * RPM, 1500 * RPM, 2400 * RPM])
def test_a_pulse_of_two_levels_has_the_uncertainty_of_its_period(speed):
    """Whole samples in a turn: all pulses err alike, uniformly over a period. 200 starts; variance 1 / 12."""
    draws = np.random.default_rng(1).uniform(0, TURN, 200)
    found = [angle_of("0", speed, start) for start in draws]
    for angle, _ in found[:5]:
        assert angle.std == pytest.approx(speed * PERIOD / np.sqrt(12), rel=1e-6)
        assert angle.jitter < 1e-9
    z = np.array([error / angle.std for angle, error in found])
    assert abs(z).max() < np.sqrt(3) * 1.001  # half a period
    # z^2 of a uniform variable has mean 1 and variance 4 / 5
    assert abs(np.mean(z**2) - 1) < 3.9 * np.sqrt(0.8 / 200)


def test_a_pulse_of_two_levels_at_any_speed_is_no_worse_than_stated():
    """What is seen as scatter is averaged: chi-squared of the errors stays below its upper 0.01 % point."""
    random = np.random.default_rng(2)
    found = [angle_of("0", random.uniform(600, 2400) * RPM, random.uniform(0, TURN)) for _ in range(100)]
    z = np.array([error / angle.std for angle, error in found])
    assert float(z @ z) < chi2.isf(1e-4, 100)
    assert np.median([angle.std for angle, _ in found]) < 0.5 * 1500 * RPM * PERIOD / np.sqrt(12)


@pytest.mark.parametrize("kind", ["after", "nearest"])
def test_times_on_samples_do_not_say_on_which_side_the_edge_was(kind):
    """At, before or after the sample: variance (1 / 12 + 1 / 6) of a period squared, half a period in all."""
    random = np.random.default_rng(3)
    z = []
    for k in range(150):
        speed = [600, 1500, 2400][k % 3] * RPM
        angle, error = angle_of(kind, speed, random.uniform(0, TURN))
        assert angle.std == pytest.approx(speed * PERIOD / 2, rel=1e-6)
        z.append(error / angle.std)
    # "after": errors uniform in (0, 2 std): mean square 4 / 3, never above 2; "nearest": 1 / 3, never above 1
    assert np.abs(z).max() < (2.001 if kind == "after" else 1.001)
    assert np.mean(np.square(z)) == pytest.approx(4 / 3 if kind == "after" else 1 / 3, rel=0.3)


def test_an_edge_that_was_seen_is_interpolated():
    for start in np.linspace(0.1, 6.1, 40):
        angle, error = angle_of("3", 2400 * RPM, start)
        assert abs(error) < 1e-9
        assert angle.std < 1e-9


def test_where_an_edge_can_be():
    """Shares of a period: both samples on a level: anywhere; one on the edge: from the straight line to its end."""
    time = np.array([0.0, 1.0, 2.0, 3.0])
    for edge, first, last in (
        ([0, 0, 5, 5], 1.0, 2.0),
        ([0, 0, 4, 5], 1 + 2.5 / 4, 2.0),
        ([0, 1, 5, 5], 1.0, 1 + 1.5 / 4),
        ([0, 1, 4, 5], 1.5, 1.5),
    ):
        (at,), (std,) = pulse_edges(time, np.array(edge, float))
        assert at == pytest.approx((first + last) / 2, abs=5e-3)  # levels are percentiles
        assert std == pytest.approx((last - first) / np.sqrt(12), abs=5e-3)


def test_the_resolution_of_pulse_times():
    speed = 1500 * RPM
    for kind, resolution in (("nearest", PERIOD), ("timed", 0.0)):
        one = recorded(kind, speed, 1.0)
        assert pulse_resolution(one, one.runs[0]) == pytest.approx(resolution)
    # pulses that happen to be at samples in one run are not sampled where those of another run are not
    both = (recorded("timed", speed, 0.0).runs[0], recorded("timed", 1.03 * speed, 1.0).runs[0])
    assert pulse_resolution(Recording("made", "made", Path(), {}, both[:1]), both[0]) == pytest.approx(PERIOD)
    assert pulse_resolution(Recording("made", "made", Path(), {}, both), both[0]) == 0.0
    # few digits are a resolution; what was stated counts
    rounded = np.round(both[1].tacho, 3)
    coarse = Run("run1", "a.npz", TIME, {}, speed, rounded, {}, "identify", Place())
    assert pulse_resolution(Recording("made", "made", Path(), {}, (coarse,)), coarse) == pytest.approx(1e-3)
    said = Run("run1", "a.npz", TIME, {}, speed, rounded, {}, "identify", Place(), tacho_resolution=0.0)
    assert pulse_resolution(Recording("made", "made", Path(), {}, (said,)), said) == 0.0


@pytest.mark.parametrize(("count", "resolution"), [(6, 1e-4), (7, 1e-3)])
def test_pulses_on_samples_are_sampled_unless_chance_puts_them_there_once_in_a_million(count, resolution):
    """Times of four digits are near one of the samples, 1 ms apart, for a tenth of all that can be: 0.1^6 is chance."""
    time = 4e-4 + np.arange(1000) / 1000
    tacho = time[np.array([3, 140, 281, 420, 563, 702, 845])[:count]]
    run = Run("run1", "a.npz", time, {}, None, np.round(tacho, 4), {}, "identify", Place("recording.json", 7, 3), 1000)
    assert pulse_resolution(Recording("made", "made", Path(), {}, (run,)), run) == pytest.approx(resolution)


def test_check_says_that_pulses_are_sampled():
    for kind, words in (
        ("0", "sample the pulse so fast that its edge shows, or time the edges and give them as tacho"),
        (
            "nearest",
            'sample the pulse so fast that its edge shows, or time the edges; "tacho_resolution": 0 says they were',
        ),
    ):
        (problem,) = check_signals(recorded(kind, 2400 * RPM, 1.0))
        size = {"0": "0.83", "nearest": "1.4"}[kind]
        assert problem.severity == "warning"
        assert problem.what == (
            f"sampled pulses: they lie on samples, so that shaft angle zero is uncertain by {size} deg at 2400 rpm"
        )
        assert problem.hint == words
    assert check_signals(recorded("timed", 2400 * RPM, 1.0)) == []
    assert check_signals(recorded("3", 2400 * RPM, 1.0)) == []


def test_a_pulse_signal_that_contradicts_the_speed():
    recording = recorded("3", 2400 * RPM, 1.0)
    run = recording.runs[0]
    wrong = Run("run1", "a.npz", TIME, run.values, 2600 * RPM, None, {}, "identify", run.place, RATE)
    (problem,) = check_signals(Recording("made", "made", Path(), recording.channels, (wrong,)))
    assert str(problem) == (
        "recording.json:7:3: error: run1: tacho: the pulse signal says 2400 rpm, the stated speed is 2600 rpm\n\n"
        "hint: correct the speed or sample_rate in recording.json"
    )
    slow = Run("run1", "a.npz", TIME * 10, run.values, 2400 * RPM, None, {}, "identify", run.place, RATE / 10)
    (problem,) = check_signals(Recording("made", "made", Path(), recording.channels, (slow,)))
    assert problem.what == "tacho: the pulse signal says 240 rpm, the stated speed is 2400 rpm"
    assert problem.hint == "sample_rate may be 10 times too low"


def test_pulses_that_end_before_the_samples():
    run = recorded("timed", 2400 * RPM, 1.0).runs[0]
    slow = Run("run1", "a.npz", TIME * 10, {}, 2400 * RPM, run.tacho, {}, "identify", run.place, RATE / 10)
    (problem,) = check_signals(Recording("made", "made", Path(), {}, (slow,)))
    assert str(problem) == (
        "recording.json:7:3: error: run1: tacho: pulses from 0.0210211 to 0.996021 s in a run from 0 to 9.998 s, "
        "which lacks 360 at an end\n\nhint: sample_rate may be wrong; pulses and samples need one clock"
    )


# --- what it makes of harmonics ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("std", [0.02, 0.1])
def test_a_turned_harmonic_is_as_far_from_the_truth_as_stated(std):
    """chi^2 of all harmonics; along the tangent alone, 1 - cos of the error is 3 (0.02) and 1200 (0.1) times noise."""
    c = np.array([[0.3, -0.2], [2.0 + 1.0j, 1.0 - 2.0j], [0.3j, 0.2]])
    theta = TURN * 30 * TIME[:1000] + 0.4
    random = np.random.default_rng(4)
    total = 0.0
    for _ in range(50):
        error = np.sqrt(3) * std * random.uniform(-1, 1)
        wave = np.exp(1j * np.outer(theta + error, [0, 1, 2]))
        y = c[0].real + 2 * (wave[:, 1:] @ c[1:]).real + 0.02 * random.standard_normal((1000, 2))
        signals = dict(zip("xy", y.T, strict=True))
        fit = fit_harmonics(Samples("run1", TIME[:1000], theta, signals, angle_std=std), orders=2)
        off = real_vector(fit.values - c)
        total += float(off @ np.linalg.solve(fit.covariance, off))
    assert chi2.ppf(1e-4, 500 * 0.7) < total < chi2.isf(1e-4, 500)


@pytest.mark.parametrize("sign", [1, -1])
def test_what_a_late_stamp_changes(sign):
    """Pulses stamped late by sqrt(1/6) of a period turn c_k by k W of it; the angle of one run is as uncertain."""
    speed, late = sign * 1500 * RPM, PERIOD / np.sqrt(6)
    made = recorded("after", 1500 * RPM, 1.0, x=np.cos(1500 * RPM * TIME) + 0.3 * np.sin(3000 * RPM * TIME))
    fit = harmonics_of(replace(made, runs=(replace(made.runs[0], speed=speed),)))[0].fit
    assert fit.stamp == pytest.approx(late)
    # whole samples in a turn: of the pulse itself T / sqrt(12) more
    assert fit.angle_std == pytest.approx(np.hypot(late, PERIOD / np.sqrt(12)) * 1500 * RPM)
    np.testing.assert_allclose(fit.stamped[1:3], 1j * np.array([[1], [2]]) * speed * late * fit.values[1:3])
    assert not fit.stamped[[0, *range(3, len(fit.orders))]].any()  # the mean, and what noise alone makes
    whole, part = (fit.covariance_at(np.array([0]), [1, 2], 0.0, stamp=told) for told in (True, False))
    together = real_vector(fit.stamped)[1:5]
    np.testing.assert_allclose(whole - part, np.outer(together, together), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["0", "after"])
def test_a_healthy_rotor_with_sampled_pulses_is_identified(kind):
    """600, 1500, 2400 rpm at 5 kHz, two sets of gains: no misfit, and intervals that hold the truth."""
    from rotorsim.model.load import load

    random = np.random.default_rng(5)
    truth = {
        "viscous_damping": 57.0,
        "crack_stiffness": 1.5e5,
        "crack_phase": 0.0,
        "eccentricity": 25e-6,
        "unbalance_phase": -2.4,
        "force_displacement_factor": 103940.0,
        "force_current_factor": 40.86,
    }
    machine = {
        "damping": 57.0,
        "crack_stiffness": 1.5e5,
        "eccentricity": 25e-6,
        "phase": -2.4,
        "force_displacement": 103940.0,
        "force_current": 40.86,
    }
    channels = {
        name: Channel(name, signal, axis, None, None, unit)
        for name, signal, axis, unit in (
            ("x", "rotor.displacement", "x", "m"),
            ("y", "rotor.displacement", "y", "m"),
            ("ix", "controller.current", "x", "A"),
            ("iy", "controller.current", "y", "A"),
        )
    }
    runs = []
    for kp, kd in ((12200.0, 3.0), (9500.0, 4.2)):
        for rpm in (600, 1500, 2400):
            start = random.uniform(0, TURN)
            theta = rpm * RPM * TIME + start
            motion = [
                sum(value * np.exp(1j * k * theta) for k, value in harmonics.items())
                for harmonics in Jeffcott(**machine, kp=kp, kd=kd, speed=rpm * RPM).settled()
            ]
            noise = 3e-8 * random.standard_normal((4, N)) * np.array([[1], [1], [1.2e4], [1.2e4]])
            one = recorded(kind, rpm * RPM, start)
            parts = (motion[0].real, motion[0].imag, motion[1].real, motion[1].imag)
            values = dict(zip(("x", "y", "ix", "iy"), np.array(parts) + noise, strict=True))
            channels |= one.channels
            runs.append(
                Run(
                    f"run{len(runs)}",
                    f"{len(runs)}.npz",
                    TIME,
                    {**values, **one.runs[0].values},
                    rpm * RPM,
                    one.runs[0].tacho,
                    {"controller.KP": kp, "controller.KD": kd},
                    "identify",
                    Place(),
                )
            )
    found = identify(load("jeffcott"), Recording("made", "made", Path(), channels, tuple(runs)), profile=False)
    assert found.adequate
    for name, item in found.parameters.items():
        assert abs(item.value - truth[name]) < 3.3 * item.std, name
    # 0.21 deg at 600 rpm alone, and with a stamp that may be late by another 0.29 deg; timed pulses: 0.002
    assert 0.05 < np.degrees(found.parameters["unbalance_phase"].std) < 0.4


# --- steady runs ------------------------------------------------------------------------------------------------------


def test_the_limit_of_a_steady_run():
    """A degree at a damping ratio of 0.1: 1.1e-3 a turn, between 1 % and 4.58 %."""
    assert steady_limit(25) == pytest.approx(0.0274, abs=5e-5)
    assert steady_limit(3) == 0.01
    assert steady_limit(1000) == pytest.approx(0.0458, abs=5e-5)


@pytest.mark.parametrize(("change", "turns"), [(0.02, 25), (-0.04, 60), (0.02, 8)])
def test_the_response_to_a_drifting_speed_errs_as_stated(change, turns):
    """A mode at resonance, damping ratio 0.1, integrated in steps: lag e / (2 pi N z^2), size (e / z)^2 / 12."""
    z, n = 0.1, 40_000
    duration = TURN * turns  # of a mode of unit frequency
    time = np.linspace(-0.5, 0.5, n) * duration
    # slow envelope of x'' + 2 z x' + x = e^{i theta} about e^{i theta}: A' = 1 - (z + i (W - 1)) A
    detuned = change / duration * time
    A = np.empty(n, complex)
    A[0] = 1 / (z + 1j * detuned[0])
    for k in range(n - 1):
        rate = z + 1j * (detuned[k] + detuned[k + 1]) / 2
        step = np.exp(-rate * (time[1] - time[0]))
        A[k + 1] = A[k] * step + (1 - step) / rate
    lag = abs(np.angle(A[n // 2] * z))
    assert lag == pytest.approx(abs(change) / (TURN * turns * z**2), rel=0.1)
    steady = np.mean(1 / (z + 1j * detuned)) * z
    assert abs(steady - 1) == pytest.approx((change / z) ** 2 / 12, rel=0.1)


def test_run_ups_are_refused_with_the_reason():
    speed = 1500 * RPM
    theta = speed * (0.4 * TIME + 0.6 * TIME**2)
    channels = {
        "x": Channel("x", "rotor.x", None, None, None, "m"),
        "a": Channel("a", "clock.theta", None, None, None, "rad"),
    }
    for path, word in ((theta, "run-up from 617.8 to 2382 rpm"), (theta[-1] - theta[::-1], "coast-down")):
        values = {"x": np.cos(path), "a": path}
        run = Run("run1", "a.npz", TIME, values, None, None, {}, "identify", Place("recording.json", 7, 3))
        recording = Recording("made", "made", Path(), channels, (run,))
        with pytest.raises(RotorsimError) as error:
            harmonics_of(recording)
        text = str(error.value.problems[0])
        assert text.startswith(f"recording.json:7:3: error: run run1: {word}")
        assert text.endswith(
            ": its orders are not those of one speed\n\n"
            "hint: cut out a part in which it changes by less than 2.7 %, or record runs at steady speeds"
        )
