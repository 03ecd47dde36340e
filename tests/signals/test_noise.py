"""Noise of harmonic fits: the sign of its cross-spectrum, when it counts as white, and what stands out of it."""

import numpy as np
import pytest
from scipy.stats import chi2, f

from rotorsim.signals.harmonic_fit import Beside, HarmonicFit
from rotorsim.signals.noise.lines import find_lines
from rotorsim.signals.noise.noise import Noise, noise_of
from rotorsim.signals.noise.whitening import is_white

TURN = 2 * np.pi
N, STEP = 8000, 1e-3
TIME = np.arange(N) * STEP
SPEED = TURN * 25.0  # 200 lines of the spectrum
LATE = 3  # samples that the second channel comes later: y = x(t - 3), so that X Y* turns by +3 w


def late(echo: float) -> np.ndarray:
    """Return noise (N, 2), late in the second channel, beside a little of its own; with an echo after 30 samples."""
    random = np.random.default_rng(4)
    white = random.standard_normal(N + 100)
    x = white + echo * np.roll(white, 30)
    return np.column_stack([x, np.roll(x, LATE)])[100:] + 0.05 * random.standard_normal((N, 2))


@pytest.mark.parametrize(("echo", "freedom"), [(0.0, N), (0.9, 400)])
def test_the_phase_of_a_cross_spectrum_is_that_of_a_channel_that_is_late(echo, freedom):
    """By an autoregression of up to eight lags; and by the mean of 201 lines, to some sqrt(1 / 200) of the size."""
    found = noise_of(late(echo), TIME, SPEED, 3, N, np.zeros(2), [])
    assert found.freedom == freedom
    for k in (1, 2, 3):
        line = k * 200 + (np.arange(-100, 101) if echo else np.zeros(1))
        w = TURN * line / N
        expected = np.mean(np.abs(1 + echo * np.exp(-30j * w)) ** 2 * np.exp(1j * LATE * w))
        assert abs(found.at_order(k)[0, 1] - expected) < 4 / np.sqrt(200) * (1 + echo**2)
        np.testing.assert_allclose(found.at_order(k)[1, 0], found.at_order(k)[0, 1].conj())


def test_covariances_have_the_sign_of_a_channel_that_is_late():
    """A quarter of a period: c_y = -i c_x, so that Re c_y = Im c_x and Im c_y = -Re c_x, but for a hundredth."""
    spectrum = np.array([np.eye(2), [[1.0, 0.99j], [-0.99j, 1.0]]])
    beside = Beside(SPEED / 2, np.array([1]), np.zeros((1, 2), complex), np.array([0.5]), np.ones(1, bool))
    found = HarmonicFit(
        run="a",
        speed=SPEED,
        names=("x", "y"),
        units=("m", "m"),
        orders=np.arange(2),
        values=np.zeros((2, 2), complex),
        rms=np.ones(2),
        residual=np.ones(2),
        noise=Noise(spectrum, False, 100.0),
        gram=0.5 * np.eye(3),
        angle_std=0.0,
        turns=9.0,
        samples=100,
        beside=beside,
    )
    rows = np.array([[1, 0, 0, -0.99], [0, 1, 0.99, 0], [0, 0.99, 1, 0], [-0.99, 0, 0, 1]])  # Re x, Re y, Im x, Im y
    np.testing.assert_allclose(found.covariance[2:, 2:], 0.5 * rows, atol=1e-12)
    np.testing.assert_allclose(found.covariance_beside(np.arange(2), 0.0), 0.5 * rows, atol=1e-12)


@pytest.mark.parametrize(("times", "white"), [(0.99, True), (1.01, False)])
def test_noise_is_called_coloured_where_it_is_white_once_in_ten_thousand(times, white):
    """Of 1600 lines 16 bands of 100, the lowest divided at 12, 25 and 50: chi-squared of 18, one channel."""
    wanted = times * chi2.isf(1e-4, 18)
    a = np.linspace(0, 2, 20001)
    overall = 1 + a / 16
    statistic = 100 * ((1 + a) / overall - 1) ** 2 + 1500 * (1 / overall - 1) ** 2
    power = np.ones((1600, 1))
    power[1500:] += np.interp(wanted, statistic, a)
    assert is_white(power) is white


@pytest.mark.parametrize(("times", "found"), [(0.99, 0), (1.01, 1)])
def test_a_line_stands_out_of_noise_by_chance_once_in_a_thousand_runs(times, found):
    """Its power over the mean of 24 others has an F distribution with 2 and 48 degrees; 499 lines are looked at."""
    phases = np.exp(1j * np.random.default_rng(6).uniform(0, TURN, 501))
    phases[[0, -1]] = 0.0
    phases[200] *= np.sqrt(times * f.isf(1e-3 / 499, 2, 48))
    left = np.fft.irfft(phases * np.sqrt(1000), 1000)[:, None]
    time = TIME[:1000]
    lines = find_lines(time, left, TURN * 27.3, 3, np.zeros(1))
    assert [round(line.frequency, 0) for line in lines] == [200.0] * found
