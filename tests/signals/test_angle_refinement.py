"""The speed of a run by its own harmonics, where pulses leave it open."""

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.errors import Place
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.angle_refinement import refined_angle
from rotorsim.signals.harmonic_basis import harmonic_basis
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.shaft_angle import ShaftAngle, shaft_angle

TURN = 2 * np.pi
RATE, COUNT = 5000.0, 5000
TIME = np.arange(COUNT) / RATE
TRUE = {1: 8e-6 - 3e-6j, 2: 3e-6j, 3: 1e-6}  # m


def recorded(theta, pulses, *, speed=None, noise=1e-8, seed=0, slow=0.0) -> Recording:
    """Return one probe at shaft angles theta (n,); slow: by how much its first harmonic alone turns over the run."""
    random = np.random.default_rng(seed)
    drift = np.exp(1j * slow * (TIME / TIME[-1] - 0.5))
    y = sum(2 * np.real(c * (drift if k == 1 else 1) * np.exp(1j * k * theta)) for k, c in TRUE.items())
    values = {"x": y + noise * random.standard_normal(COUNT)}
    run = Run("run0", "a.csv", TIME, values, speed, pulses, {}, "identify", Place("a"), RATE)
    return Recording("bench", "", None, {"x": Channel("x", "rotor.displacement", "x", None, None, "m")}, (run,))


def sampled(theta: np.ndarray) -> np.ndarray:
    """Return the samples at or after which the angle, rising or falling, passes a multiple of a turn."""
    turns = np.floor(np.abs(theta) / TURN)
    return TIME[1:][np.diff(turns) != 0]


@pytest.mark.parametrize("hertz", [14.9, 39.83, -54.91, 70.31])
def test_sampled_pulses_leave_the_speed_to_the_harmonics(hertz):
    """Noise of 10 nm is left, and of the speed sqrt(12) 10 nm / (rms(dy/dtheta) sqrt(n)) a second: 3.18e-5 rad/s."""
    for seed in range(4):
        theta = TURN * hertz * TIME + np.sign(hertz) * (0.3 + seed)
        recording = recorded(theta, sampled(theta), speed=TURN * hertz, seed=seed)
        [found] = harmonics_of(recording)
        assert found.fit.residual[0] == pytest.approx(1e-8, rel=0.03)
        assert abs(found.angle.speed - TURN * hertz) < 4 * 3.18e-5
        plain = shaft_angle(recording, recording.runs[0])
        offset = (plain.theta - found.angle.theta)[np.abs(plain.theta % TURN) < 0.05]
        assert abs(offset.mean()) < 3 * plain.smooth / np.sqrt(len(offset))


def test_a_drift_of_the_speed_is_followed():
    theta = TURN * (40.0 * TIME + 0.002 * TIME**2) + 0.3  # 0.2 rad/s, of a period of 0.05 rad a sample
    [found] = harmonics_of(recorded(theta, sampled(theta)))
    assert found.angle.drift == pytest.approx(4e-3 * TURN * TIME[-1], rel=0.02)
    assert found.fit.residual[0] == pytest.approx(1e-8, rel=0.03)


def test_a_speed_stated_in_rpm_with_one_pulse():
    """Stated are 115 rpm of 115.39: angle zero stays at the pulse."""
    speed, pulse = 115.39 * TURN / 60, 0.4288
    theta = speed * (TIME - pulse)
    [found] = harmonics_of(recorded(theta, np.array([pulse]), speed=115 * TURN / 60), orders=3)
    assert found.angle.source == "speed"
    assert found.angle.speed == pytest.approx(speed, rel=1e-5)
    assert found.fit.values[1:, 0] == pytest.approx(np.array(list(TRUE.values())), abs=5e-9)


def test_what_one_harmonic_does_is_not_put_down_to_the_angle():
    """Pulses to 1e-9 s say that the shaft turns evenly: a first harmonic that turns slowly is the machine's."""
    theta = TURN * 40 * TIME
    pulses = np.arange(40) / 40.0 + 1e-9 * np.random.default_rng(1).standard_normal(40)
    recording = recorded(theta, pulses, slow=0.02)
    angle = shaft_angle(recording, recording.runs[0])
    y = recording.runs[0].values["x"][:, None]
    basis = harmonic_basis("run0", TIME, angle.theta, orders=3)
    now, same = refined_angle(TIME, angle, y, basis)
    assert same is basis
    assert (now.theta == angle.theta).all()


@pytest.mark.parametrize(("times", "followed"), [(3.9, True), (4.1, False)])
def test_four_standard_deviations_are_the_most_that_harmonics_may_ask_for(times, followed):
    """Pulses that leave the ends open by s, and a shaft that is there by `times` s from where they put it."""
    theta, off = TURN * 40 * TIME, 1e-2
    y = recorded(theta + off * (2 * TIME / TIME[-1] - 1), None, noise=1e-10).runs[0].values["x"][:, None]
    angle = ShaftAngle(theta, TURN * 40, 0.0, 0.0, "tacho", True, 40, smooth=off / times)
    now, _ = refined_angle(TIME, angle, y, harmonic_basis("run0", TIME, theta, orders=3))
    assert now.contradicted is not followed
    assert np.ptp(now.theta - theta) == pytest.approx(2 * off if followed else 0.0, rel=0.01)


@pytest.mark.parametrize(("turns", "open_by"), [(3, 0.01 * 3 * np.pi), (4, 0.1)])
def test_a_stated_speed_is_one_percent_uncertain(turns, open_by):
    """Of the angle at either end of the run, but no more than 0.1 rad are followed."""
    speed = TURN * turns / TIME[-1]
    recording = recorded(speed * TIME, np.array([0.001]), speed=speed)
    assert shaft_angle(recording, recording.runs[0]).smooth == pytest.approx(open_by, rel=1e-3)


@pytest.mark.parametrize(("times", "drift"), [(1.55, False), (1.65, True)])
def test_a_drift_is_told_from_saw_teeth_above_one_and_a_half_times_their_variance(times, drift):
    """Of 60 pulses each in a period T: T^2 / 12; a parabola costs ln 60 of 60 ln(v / 1.5), so that v > 1.606."""
    period, u = 2e-4, np.linspace(-1, 1, 60)
    bend = u**2 - np.mean(u**2)
    bend *= period * np.sqrt(times / 12 / np.mean(bend**2))
    run = recorded(TURN * 60 * TIME, np.arange(60) / 60 + 0.005 + bend).runs[0]
    made = recorded(TURN * 60 * TIME, None)
    run = replace(run, tacho_resolution=period)
    assert (abs(shaft_angle(replace(made, runs=(run,)), run).drift) > 1e-9) is drift


def test_an_angle_that_pulses_tell_is_left_alone():
    """Nothing to see in noise alone: the prior of the pulses holds."""
    theta = TURN * 40 * TIME + 0.3
    recording = recorded(theta, sampled(theta), noise=1e-3)
    angle = shaft_angle(recording, recording.runs[0])
    y = recording.runs[0].values["x"][:, None]
    now, _ = refined_angle(TIME, angle, y, harmonic_basis("run0", TIME, angle.theta, orders=3))
    assert np.abs(now.theta - angle.theta).max() < 3 * angle.smooth
