"""Noise of an instrument has one colour in all runs; a run whose noise differs keeps its own."""

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.signals.covariance import real_vector
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.noise.colour import bands_of, common_colour, density, variance_of_mean
from rotorsim.signals.noise.noise import Noise
from tests.signals.test_asynchronous import HARMONICS, TURN, closed_form, pulses, recording
from tests.signals.test_nuisances import TIME, N, flicker

SPEEDS = TURN * np.array([2.2, 11.7, 16.9, 23.3, 37.9, 50.1])  # two turns in the first run
LEVEL, CORNER = 0.05, 40.0


def made(seed: int, corners=(CORNER,) * 6, levels=(LEVEL,) * 6):
    """Return runs with white noise and flicker noise of these corners [Hz] and standard deviations."""
    random = np.random.default_rng((9, seed))
    signals, tacho = [], []
    for r, (speed, corner, level) in enumerate(zip(SPEEDS, corners, levels, strict=True)):
        noise = random.standard_normal((N, 2)) + (flicker(random, corner) if corner else 0.0)
        signals.append(closed_form(speed * TIME + 0.7 * r, HARMONICS) + level * noise)
        tacho.append(pulses(lambda t, W=speed, r=r: W * t + 0.7 * r, TIME[-1]))
    return recording(signals, SPEEDS, tacho)


@pytest.mark.slow
def test_few_turns_have_the_noise_that_other_runs_show():
    """Harmonics 2.2 Hz apart leave few lines. 1X: 1 + 40 / 2.2 = 19 times white noise; errors are chi-squared."""
    ratio, total = [], 0.0
    for seed in range(10):
        fit = harmonics_of(made(seed))[0].fit
        ratio.append(fit.noise.at_order(1).real.trace() / 2 / LEVEL**2)
        off = real_vector(fit.values[:4] - HARMONICS)[2:]
        total += float(off @ np.linalg.solve(fit.covariance[2:14, 2:14], off))
    assert np.mean(ratio) == pytest.approx(1 + 40 / 2.2, rel=0.15)
    assert chi2.ppf(1e-4, 10 * 12) < total < chi2.isf(1e-4, 10 * 12)


def test_each_run_has_its_own_level():
    """Three times the noise in one run: nine times its power, at all orders alike."""
    runs = harmonics_of(made(1, levels=(LEVEL, LEVEL, 3 * LEVEL, LEVEL, LEVEL, LEVEL)))
    quiet, loud = (runs[r].fit.noise.colour[0] for r in (1, 2))
    np.testing.assert_allclose(loud / quiet, [9, 9, 1], rtol=0.1)


def test_a_run_with_other_noise_keeps_its_own():
    """White noise in the last of six runs: no flicker noise of the others is put into it."""
    runs = harmonics_of(made(2, corners=(CORNER,) * 5 + (0.0,)))
    assert runs[5].fit.noise.white
    assert runs[5].fit.noise.at_order(1)[0, 0].real == pytest.approx(LEVEL**2, rel=0.1)
    assert not any(item.fit.noise.white for item in runs[:5])


@pytest.mark.slow
def test_white_noise_stays_white():
    for seed in range(5):
        assert all(item.fit.noise.white for item in harmonics_of(made(seed, corners=(0.0,) * 6)))


@pytest.mark.slow
@pytest.mark.parametrize(("times", "alike"), [(0.8, True), (1.2, False)])
def test_noise_is_of_another_colour_once_in_a_thousand_recordings(times, alike):
    """Twice the likelihood's logarithm is chi-squared of two: of 31 runs each with 1e-3 / 31, 2 ln 31000 = 20.7."""
    line = np.arange(1, 1000)
    common = np.array([[1.0, 30.0, 1.0]])

    def bands(corner: float):
        colour = np.array([[1.0, corner, 1.0]])
        return bands_of(density(colour, line), line, 1.0, colour)

    def gain(corner: float) -> float:
        """Return twice what the fourth run gains by a colour of its own: expected power, so that it fits exactly."""
        told = common_colour([bands(30.0)] * 30 + [bands(corner)], [1.0] * 31)[0]
        S, own = (density(np.array([c]), line)[:, 0] for c in (told, [1.0, corner, 1.0]))
        level = np.mean(own / S)
        return float(2 * (np.log(level * S) + own / (level * S) - np.log(own) - 1).sum())

    corner = 30.0
    while gain(corner) < times * 20.7:
        corner *= 1.05
    found = common_colour([bands(30.0)] * 30 + [bands(corner)], [1.0] * 31)
    np.testing.assert_allclose(found[0], common[0], rtol=0.05)
    assert (found[30] is not None) is alike


def test_drifts_under_flicker_noise():
    """Variance of Legendre coefficients of samples over a run against what the density says, 400 draws."""
    colour = np.array([[1.0, CORNER, 1.0]] * 2)  # a run of a second: lines are hertz
    noise = Noise(variance_of_mean(colour)[:, None, None] * np.eye(2), False, 100.0, colour)
    u = 2 * TIME / TIME[-1] - 1
    shapes = np.linalg.pinv(np.column_stack([np.ones(N), u, 1.5 * u**2 - 0.5]))
    random = np.random.default_rng(6)
    found = np.array([shapes[1:] @ (random.standard_normal((N, 2)) + flicker(random, CORNER)) for _ in range(200)])
    for degree in (1, 2):
        expected = noise.of_drift(degree) / N
        assert (found[:, degree - 1] ** 2).mean() == pytest.approx(expected[0], rel=3.9 * np.sqrt(2 / 400))
        assert Noise(4.0 * np.eye(2)[None], True, 1.0).of_drift(degree).tolist() == [4.0 * (2 * degree + 1)] * 2
