"""The shaft angle from tacho pulses, an angle channel or the speed, with what the jitter of pulses costs."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom, chi2

from rotorsim.errors import Place, RotorsimError
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.covariance import real_vector
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.shaft_angle import ShaftAngle, pulse_edges, shaft_angle
from tests.signals.test_harmonic_fit import harmonics, same_covariance, signal

RATE = 5000.0
TURN = 2 * np.pi
SPEED = TURN * 24.7
TIME = np.arange(5000) / RATE
LEVEL = 1e-4


def turned(coefficients: list[float], time: np.ndarray = TIME) -> np.ndarray:
    """Return theta = c0 + c1 t + c2 t^2 / 2 + ..., (n,) [rad]."""
    powers = np.array([time**k / max(k, 1) for k in range(len(coefficients))])
    return np.asarray(np.array(coefficients) @ powers)


def pulses_of(theta: np.ndarray, time: np.ndarray = TIME) -> np.ndarray:
    """Return the times at which theta is a multiple of a turn, by inverse interpolation of dense samples."""
    dense = np.linspace(time[0], time[-1], 200_001)
    angle = np.interp(dense, time, theta) if len(time) < 3 else _cubic(time, theta, dense)
    way = 1 if theta[-1] > theta[0] else -1
    first, last = np.ceil(way * angle[0] / TURN), np.floor(way * angle[-1] / TURN)
    return np.interp(np.arange(first, last + 1) * TURN, way * angle, dense)


def _cubic(time: np.ndarray, theta: np.ndarray, at: np.ndarray) -> np.ndarray:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(time, theta)(at))


def found(
    tacho: np.ndarray | None = None,
    speed: float | None = SPEED,
    channel: np.ndarray | None = None,
    voltage: np.ndarray | None = None,
    time: np.ndarray = TIME,
) -> ShaftAngle:
    recording = recorded(tacho, speed, channel, voltage, time)
    return shaft_angle(recording, recording.runs[0])


def recorded(
    tacho: np.ndarray | None = None,
    speed: float | None = SPEED,
    channel: np.ndarray | None = None,
    voltage: np.ndarray | None = None,
    time: np.ndarray = TIME,
    **signals: np.ndarray,
) -> Recording:
    channels = {name: Channel(name, f"rotor.{name}", None, None, None, "m") for name in signals}
    values = dict(signals)
    if channel is not None:
        channels["theta"] = Channel("theta", "clock.theta", None, None, None, "rad")
        values["theta"] = channel
    if voltage is not None:
        channels["pulse"] = Channel("pulse", "tacho", None, None, None, "V")
        values["pulse"] = voltage
    run = Run("run1", "run1.npz", time, values, speed, tacho, {}, "identify", Place("recording.json", 7, 3))
    return Recording("made", "made", Path(), channels, (run,))


def off(theta: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the difference of angles, whole turns apart from each other counted as the same."""
    whole = np.round((theta - expected).mean() / TURN) * TURN
    return np.asarray(theta - expected - whole)


# --- pulses -----------------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.floats(-4, 4), st.floats(11, 120), st.floats(-0.03, 0.03), st.booleans())
def test_pulses_of_a_steady_or_drifting_shaft(start, hertz, drift, backward):
    way = -1 if backward else 1
    theta = way * turned([start, TURN * hertz, TURN * hertz * drift])
    angle = found(pulses_of(theta), way * TURN * hertz)
    assert np.abs(off(angle.theta, theta)).max() < 2e-5  # of the pulses: dense samples interpolated linearly
    assert (angle.source, angle.phase_known) == ("tacho", True)
    assert angle.speed == pytest.approx(float(theta[-1] - theta[0]) / TIME[-1], rel=1e-6)
    assert angle.drift == pytest.approx(way * TURN * hertz * drift, abs=1e-3 * TURN * hertz * max(abs(drift), 1e-3))
    assert angle.jitter < 1e-5


def test_a_wobbling_speed_is_followed():
    """A quarter of a wave over the run: no low polynomial is exact, the best one is good to its own jitter."""
    theta = turned([0.3, SPEED]) + 0.8 * np.sin(4 * TIME)
    pulses = pulses_of(theta)
    angle = found(pulses)
    between = (pulses[0] <= TIME) & (pulses[-1] >= TIME)
    assert angle.jitter < 1e-4
    assert np.abs(off(angle.theta, theta)[between]).max() < 5 * angle.jitter


@pytest.mark.slow
def test_jitter_of_pulses_is_estimated_and_smoothed():
    """The angle is that of a straight line through the pulses: chi-squared of the jitter, sigma / sqrt(n) of zero."""
    theta = turned([0.4, SPEED])
    exact = pulses_of(theta)
    sigma, draws = 2e-5, 300
    rest, zero, said = [], [], []
    for seed in range(draws):
        random = np.random.default_rng((1, seed))
        angle = found(exact + sigma * random.standard_normal(len(exact)))
        rest.append((angle.jitter / (sigma * SPEED)) ** 2)
        zero.append(off(angle.theta, theta).mean())
        said.append(angle.std)
    freedom = draws * (len(exact) - 2)
    assert chi2.ppf(LEVEL, freedom) / freedom < np.mean(rest) < chi2.isf(LEVEL, freedom) / freedom * 1.02
    spread = np.var(zero) / np.mean(np.square(said))
    assert chi2.ppf(LEVEL, draws - 1) / draws < spread < chi2.isf(LEVEL, draws - 1) / draws


@pytest.mark.parametrize("draws", [60, pytest.param(300, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_jitter_and_noise_together_make_the_covariance_of_harmonics(draws):
    """Pulses with jitter, a drifting mean, a window that is not whole turns; both matter alike."""
    time = np.arange(2000) / RATE
    theta = turned([0.4, TURN * 61.3], time)
    u = 2 * time / time[-1] - 1
    exact, c = pulses_of(theta, time), harmonics(2)
    clean = signal(c, theta) + np.outer(u, [0.5, -1])
    errors, said = [], []
    for seed in range(draws):
        random = np.random.default_rng((2, seed))
        x, y = (clean + 0.2 * random.standard_normal((2000, 2))).T
        tacho = exact + 2e-5 * random.standard_normal(len(exact))
        (item,) = harmonics_of(recorded(tacho, TURN * 61.3, time=time, x=x, y=y), orders=2)
        errors.append(real_vector(item.fit.values - c))
        said.append(item.fit.covariance)
    assert same_covariance(np.array(errors), np.mean(said, axis=0)) > LEVEL


@pytest.mark.slow
def test_jitter_of_pulses_makes_no_lines():
    """An error of the speed turns harmonics while the run lasts; these sides of a harmonic are no lines.

    30 runs; the stated chance of a false line is one in a thousand.
    """
    theta = turned([0.4, SPEED])
    exact, clean = pulses_of(theta), signal(harmonics(2), theta)
    false = 0
    for seed in range(30):
        random = np.random.default_rng((3, seed))
        x, y = (clean + 0.02 * random.standard_normal((5000, 2))).T
        tacho = exact + 5e-5 * random.standard_normal(len(exact))
        (item,) = harmonics_of(recorded(tacho, x=x, y=y), orders=2)
        false += bool(item.fit.lines)
    assert false <= binom.isf(LEVEL, 30, 1e-3)


def test_large_jitter_is_not_called_exact():
    """Jitter above 2 % of a turn is not a wandering speed that is known exactly."""
    exact = pulses_of(turned([0.4, SPEED]))
    angle = found(exact + 0.03 / 24.7 * np.random.default_rng(0).standard_normal(len(exact)))
    assert angle.std > 0


def test_two_pulses_make_a_line():
    theta = turned([0.3, SPEED])
    angle = found(pulses_of(theta)[3:5])
    assert np.abs(off(angle.theta, theta)).max() < 1e-3
    assert angle.phase_known


def test_one_pulse_takes_the_nominal_speed():
    theta = turned([0.3, SPEED])
    angle = found(pulses_of(theta)[:1])
    assert np.abs(off(angle.theta, theta)).max() < 1e-6
    assert (angle.source, angle.phase_known) == ("speed", True)


def test_a_stated_speed_below_zero_turns_the_angle_back():
    pulses = pulses_of(turned([0.0, SPEED]))
    forward, backward = found(pulses, SPEED), found(pulses, -SPEED)
    np.testing.assert_allclose(backward.theta, -forward.theta)
    assert backward.speed == -forward.speed


def test_pulses_that_do_not_rise():
    for bad in ([0.1, 0.3, 0.2], [0.1, 0.1], [0.1, np.nan, 0.3], [0.1, np.inf]):
        with pytest.raises(RotorsimError, match=r"run1: tacho: the pulse times must be finite and rise"):
            found(np.array(bad))


# --- without pulses ---------------------------------------------------------------------------------------------------


def test_speed_alone_has_no_phase():
    angle = found()
    np.testing.assert_allclose(angle.theta, SPEED * TIME)
    assert (angle.source, angle.phase_known, angle.std) == ("speed", False, 0.0)


def test_nothing_at_all():
    with pytest.raises(RotorsimError) as error:
        found(speed=None)
    (problem,) = error.value.problems
    assert str(problem) == (
        "recording.json:7:3: error: run run1: no shaft angle: no tacho, no angle channel, no speed\n\n"
        'hint: add "tacho": [times of a once-per-rev pulse], a channel "clock.theta", or at least "speed"'
    )


@settings(max_examples=30, deadline=None)
@given(st.floats(-10, 10), st.floats(5, 400), st.floats(-0.05, 0.05), st.booleans(), st.booleans())
def test_an_angle_channel_whole_or_wrapped(start, hertz, drift, backward, wrapped):
    theta = (-1 if backward else 1) * turned([start, TURN * hertz, TURN * hertz * drift])
    angle = found(channel=theta % TURN if wrapped else theta)
    assert np.abs(off(angle.theta, theta)).max() < 1e-9
    assert angle.speed == pytest.approx((theta[-1] - theta[0]) / TIME[-1])
    assert (angle.source, angle.phase_known) == ("channel", True)


def test_an_angle_that_stands_still_or_is_not_finite():
    with pytest.raises(RotorsimError, match="the shaft angle does not change"):
        found(channel=np.full(len(TIME), 0.3))
    with pytest.raises(RotorsimError, match="not finite"):
        found(channel=np.where(TIME > 0.5, np.nan, TIME))


def test_the_channel_comes_before_the_pulses():
    theta = turned([1.0, SPEED])
    angle = found(pulses_of(turned([0.0, 2 * SPEED])), channel=theta)
    assert np.abs(off(angle.theta, theta)).max() < 1e-9


# --- pulse signals ----------------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(
    hertz=st.floats(8, 100),
    width=st.floats(0.05, 0.5),
    low=st.floats(-5, 5),
    height=st.floats(0.1, 24),
    noisy=st.booleans(),
    seed=st.integers(0, 99),
)
def test_pulses_from_a_voltage(hertz, width, low, height, noisy, seed):
    """Rising edges within a sample of where they are, noise of 5 % of the height does not double them."""
    time = np.arange(20_000) / 20_000
    phase = (hertz * time + 0.31) % 1
    voltage = low + height * (phase < width)
    if noisy:
        voltage = voltage + 0.01 * height * np.random.default_rng(seed).standard_normal(len(time))
    pulses, _ = pulse_edges(time, voltage)
    expected = (np.arange(1, int(hertz + 0.31) + 2) - 0.31) / hertz
    expected = expected[expected <= time[-1]]
    assert abs(len(pulses) - len(expected)) <= (expected[-1] > time[-2])
    both = min(len(pulses), len(expected))
    np.testing.assert_allclose(pulses[:both], expected[:both], atol=1.01 / 20_000)


def test_slow_edges_with_noise_make_one_pulse_each():
    time = np.arange(20_000) / 20_000
    voltage = 5 * np.clip(3 * np.cos(TURN * 20 * time), -1, 1)
    voltage = voltage + 0.2 * np.random.default_rng(0).standard_normal(len(time))
    pulses, _ = pulse_edges(time, voltage)
    assert len(pulses) == 20
    assert np.std(np.diff(pulses)) < 2e-4


def test_a_dip_of_a_pulse_makes_no_other_one():
    """To 40 and 46 % of its height, and up again; one to 30 % is another pulse."""
    for dip, expected in ((2.0, 1), (1.5, 2)):
        voltage = np.zeros(400)
        voltage[100:200] = 5.0
        voltage[120:122] = dip, 2.3
        assert len(pulse_edges(np.arange(400.0), voltage)[0]) == expected


def test_a_voltage_is_used_when_pulses_are_not_given():
    theta = turned([0.3, SPEED])
    voltage = np.where(theta % TURN < 1.0, 5.0, 0.0)
    angle = found(voltage=voltage, speed=None)
    assert np.abs(off(angle.theta, theta)).max() < SPEED / RATE
    given_pulses = found(pulses_of(turned([0.0, SPEED])), voltage=voltage)
    assert np.abs(off(given_pulses.theta, turned([0.0, SPEED]))).max() < 1e-5


def test_a_voltage_without_pulses():
    for voltage in (np.zeros(100), np.full(100, 5.0)):
        with pytest.raises(RotorsimError, match="tacho: the pulse signal is constant"):
            pulse_edges(np.arange(100.0), voltage)
