"""Jitter of pulses is one of the instrument: angle zero is as uncertain as it scatters, with few pulses too."""

from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import Place
from rotorsim.recordings.recording import Recording, Run
from rotorsim.signals.harmonic_fit import HarmonicFit
from rotorsim.signals.harmonics import with_one_jitter
from rotorsim.signals.noise.noise import Noise
from rotorsim.signals.shaft_angle import ShaftAngle, shaft_angle

TURN, RATE = 2 * np.pi, 2000.0
TIME = np.arange(2000) / RATE
EMPTY = Recording("", "", Path(), {}, ())
HERTZ = (2, 15, 20, 30, 55, 70)


def measured(seed: int, hertz: float, jitter: float, swing: float = 0.0) -> tuple[ShaftAngle, float]:
    """Return the angle from pulses with jitter [s], and what it is off from the true one over the run [rad]."""
    random = np.random.default_rng((int(hertz), seed))
    pulses = (np.arange(hertz) + random.uniform(0.1, 0.9)) / hertz
    noisy = pulses + jitter * random.standard_normal(len(pulses)) + swing * np.sin(TURN * 3 * pulses)
    run = Run("r", "", TIME, {}, None, np.sort(noisy), {}, "identify", Place("", 1, 1), RATE)
    angle = shaft_angle(EMPTY, run)
    return angle, float(np.mean(angle.theta - TURN * hertz * (TIME - pulses[0])))


@pytest.mark.slow
def test_angle_zero_is_as_uncertain_as_said():
    """60 sets of six runs with 5 us: the mean square of errors over said deviations is one, to 4 sqrt(2 / 360)."""
    squares, alone = [], []
    for seed in range(60):
        angles, off = zip(*(measured(seed, hertz, 5e-6) for hertz in HERTZ), strict=True)
        squares += [(e / angle.std) ** 2 for e, angle in zip(off, with_one_jitter(angles), strict=True)]
        alone.append(angles[0].std)
    assert max(alone) < 1e-12  # two pulses are met by a line: they say nothing of their jitter
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)


def test_a_run_whose_speed_wanders_keeps_its_own():
    angles = [measured(0, hertz, 5e-6)[0] for hertz in HERTZ[1:]] + [measured(0, 40, 5e-6, swing=2e-3)[0]]
    found = with_one_jitter(angles)
    assert found[-1] is angles[-1]
    times = [angle.jitter / angle.speed for angle in found[:-1]]
    assert times == pytest.approx([times[0]] * 5)
    assert times[0] == pytest.approx(5e-6, rel=0.2)


def test_without_pulses_nothing_changes():
    angle = ShaftAngle(TIME, 1.0, 0.0, 0.0, "channel", True)
    assert with_one_jitter([angle, angle]) == [angle, angle]
    assert with_one_jitter([]) == []


def one_harmonic(c: complex, std: float, k: int = 1) -> HarmonicFit:
    """Return a fit that found harmonic k alone, of noise of variance 1e-4 in its real and in its imaginary part."""
    values = np.zeros((k + 1, 1), complex)
    values[k] = c
    return HarmonicFit(
        run="a",
        speed=9.0,
        names=("x",),
        units=("m",),
        orders=np.arange(k + 1),
        values=values,
        rms=np.ones(1),
        residual=np.ones(1),
        noise=Noise(np.array([[[0.2]]]), True, 9.0),
        gram=5e-4 * np.eye(2 * k + 1),
        angle_std=std,
        turns=9.0,
        samples=100,
    )


@pytest.mark.parametrize(("std", "k"), [(0.05, 1), (0.05, 3), (0.3, 1)])
def test_a_turned_harmonic_is_as_uncertain_as_its_series_in_a_uniform_error(std, k):
    """(-i k d)^n / n! of it at the rms of d^n, those after the first three times as large; d by quadrature."""
    d = np.sqrt(3) * std * (2 * (np.arange(20000) + 0.5) / 20000 - 1)
    assert np.sqrt(np.mean(d**2)) == pytest.approx(std)
    sizes = [np.sqrt(np.mean((k * d) ** (2 * n))) / factorial for n, factorial in ((1, 1), (2, 2), (3, 6), (4, 24))]
    turned = one_harmonic(2.0, std, k).turned[-2:]  # real part, imaginary part
    along, across = [0.0, 6 * sizes[1], 0.0, 6 * sizes[3]], [2 * sizes[0], 0.0, 6 * sizes[2], 0.0]
    np.testing.assert_allclose(np.abs(turned), [along, across], rtol=1e-6, atol=1e-15)


def test_the_curvature_of_a_turn_tells_a_quarter_of_what_is_known_of_the_angle():
    """Of d alone, d^2 / 2 beside the first term would tell d at d = s: its slope s over its deviation, squared."""
    std = 0.1
    first, second = np.abs(one_harmonic(1.0, std).turned[-2:]).max(axis=0)[:2]
    assert (std / second) ** 2 / first**-2 == pytest.approx(20 / 9 / 3**2, rel=1e-6)


@pytest.mark.parametrize(("times", "is_turned"), [(6.90, False), (6.92, True)])
def test_a_harmonic_that_noise_makes_once_in_a_thousand_is_turned_with_the_angle(times, is_turned):
    """P(|c|^2 > x) = exp(-x / 2 v), v = 1e-4 of each part: x = 2 v ln 1000 = 6.908 * 2 v."""
    assert one_harmonic(np.sqrt(times * 2e-4), 0.1).turned.any() == is_turned
