"""Ordinary defects of a measuring chain: flicker noise, held samples, mains hum; harmonics are as uncertain as said."""

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.signals import pickup
from rotorsim.signals.covariance import real_vector
from rotorsim.signals.dropped_samples import dropped_samples, fill_dropped
from rotorsim.signals.harmonic_basis import harmonic_basis
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.noise.colour import colour_of, density, variance_of_mean
from rotorsim.signals.noise.lines import Spectrum
from rotorsim.signals.pickup import find_mains, with_pickups
from rotorsim.signals.stretches import smallest_step
from tests.signals.test_asynchronous import HARMONICS, TURN, closed_form, pulses, recording
from tests.signals.test_harmonic_fit import fitted, harmonics, signal, std_of

RATE, N, K = 2000.0, 2000, 4
TIME = np.arange(N) / RATE
GAPS = (301, 302, 1100, 1101, 1700, 1701)  # samples that repeat 300, 1099, 1699


def flicker(random: np.random.Generator, corner: float) -> np.ndarray:
    """Return noise (N, 2) of density corner / f where white noise of variance one has density one."""
    long = 16 * N
    f = np.fft.rfftfreq(long, 1 / RATE)
    wave = (random.standard_normal((len(f), 2)) + 1j * random.standard_normal((len(f), 2))).T
    wave[:, 1:] *= np.sqrt(corner / f[1:])
    wave[:, [0, -1]] = 0
    return np.fft.irfft(wave, long).T[:N] * np.sqrt(long / 2)


def held(y: np.ndarray) -> np.ndarray:
    y = y.copy()
    for at in GAPS:
        y[at] = y[at - 1]
    return y


@pytest.mark.parametrize(
    "kind", [*(pytest.param(k, marks=pytest.mark.slow) for k in ("flicker", "held", "drift")), "all"]
)
def test_whitened_errors_of_harmonics_are_chi_squared(kind):
    """40 draws of 16 real harmonics: 640 rows, whose sum of squares is within five standard deviations of 640."""
    theta, c = TURN * 12.3 * TIME + 0.4, harmonics(K)
    total = mean = 0.0
    for seed in range(40):
        random = np.random.default_rng((3, seed))
        y = signal(c, theta) + 0.05 * random.standard_normal((N, 2))
        if kind in ("flicker", "all"):
            y += 0.05 * flicker(random, 40.0)
        if kind in ("drift", "all"):
            y += 0.05 * np.outer(TIME, [2.0, -1.0])
        share = 0.0
        if kind in ("held", "all"):
            y, lost = fill_dropped(harmonic_basis("", TIME, theta, orders=K), held(y))
            share = lost[:, 0].mean()
            assert share == pytest.approx(6 / 2000)
        found = fitted(TIME, theta, y, orders=K, lost=share)
        off = real_vector(found.values - c)
        e = np.linalg.solve(np.linalg.cholesky(found.covariance[2:, 2:]), off[2:])
        total += float(e @ e)
        mean += float(off[:2] @ np.linalg.solve(found.covariance[:2, :2], off[:2]))
    assert abs(total - 640) < 5 * np.sqrt(2 * 640)
    if kind == "flicker":  # the mean wanders at frequencies that were not measured: never more than is said
        assert mean < chi2.isf(1e-4, 80)


def test_flicker_noise_is_not_white_for_a_slow_shaft():
    """1X of a shaft at 3 Hz under noise with a corner at 40 Hz: power 1 + 40 / 3 = 14 times that of white noise."""
    theta, found = TURN * 3.0 * TIME, []
    for seed in range(20):
        random = np.random.default_rng((4, seed))
        y = 0.1 * (random.standard_normal((N, 2)) + flicker(random, 40.0)) + np.cos(theta)[:, None]
        fit = fitted(TIME, theta, y, orders=K)
        assert not fit.noise.white
        found.append(fit.noise.at_order(1)[0, 0].real / 0.01)
    assert np.mean(found) == pytest.approx(1 + 40 / 3, rel=0.15)


def test_density_of_white_and_flicker_noise():
    random = np.random.default_rng(0)
    line = np.arange(1, 3000)
    true = np.array([[2.0, 100.0, 1.0], [3.0, 0.0, 1.0]])
    found = colour_of(random.exponential(size=(2999, 40)) * density(true[[0, 1] * 20], line), line)
    for at, level in ((10, 12.0), (50, 4.0), (2000, 2.05)):
        assert density(found, np.array([at]))[0, ::2].mean() == pytest.approx(level, rel=0.06)
    assert found[1::2, 0] == pytest.approx(np.full(20, 3.0), rel=0.1)
    assert (found[1::2, 1] > 0).sum() <= 1  # the criterion lets one in some thousand through
    assert density(true, np.array([1, 50])).tolist() == [[102.0, 3.0], [4.0, 3.0]]


def test_the_mean_of_flicker_noise():
    """2 int_{1/1000}^inf sinc(j)^2 / j dj = 2 (ln 1000 + 3/2 - gamma - ln 2 pi) but for 1e-5; white noise: one."""
    exact = 2 * (np.log(1000) + 1.5 - 0.5772156649 - np.log(2 * np.pi))
    assert variance_of_mean(np.array([[0.0, 1.0, 1.0]]))[0] == pytest.approx(exact, rel=2e-3)
    assert variance_of_mean(np.array([[1.7, 0.0, 1.0]]))[0] == 1.7


def wave(random: np.random.Generator, step: float = 0.001, C: int = 4) -> np.ndarray:
    """Return readings (N, C) of a wave of amplitude one with noise of 0.01, in steps of a converter."""
    y = np.cos(TURN * 20 * TIME[:, None] + np.arange(C)) + 0.01 * random.standard_normal((N, C))
    return np.round(y / step) * step


def rest(y: np.ndarray) -> np.ndarray:
    return harmonic_basis("", TIME, TURN * 20 * TIME, orders=K).solve(y)[1]


def test_lost_samples_that_repeat_the_one_before_are_found():
    for seed in range(10):
        y = held(wave(np.random.default_rng(seed)))
        found = dropped_samples(y, rest(y))
        together = np.flatnonzero(found.all(axis=1)).tolist()
        assert together == list(GAPS)
        assert not found[[k for k in range(N) if k not in GAPS]].any()


def test_a_channel_that_alone_holds_a_sample():
    y = wave(np.random.default_rng(1))
    y[507, 2] = y[506, 2]  # cos(20 * 2 pi 507/2000 + 2) falls by 0.06 a sample there: six deviations
    y[508, 2] = y[506, 2]
    found = np.argwhere(dropped_samples(y, rest(y))).tolist()
    assert [508, 2] in found
    assert all(at in ([507, 2], [508, 2]) for at in found)


def test_nothing_is_held_where_nothing_was_lost():
    """Noise, steps of 2 and 40 times the noise, a clipped wave, half the rate, a channel that stands still."""
    for seed in range(10):
        for step, C in ((0.001, 4), (0.02, 4), (0.4, 1), (0.8, 1)):
            y = wave(np.random.default_rng(seed), step, C)
            assert not dropped_samples(y, rest(y)).any()
    y = np.clip(wave(np.random.default_rng(0)), -0.8, 0.8)
    assert not dropped_samples(y, rest(y)).any()
    y = np.repeat(wave(np.random.default_rng(0))[::2], 2, axis=0)
    assert not dropped_samples(y, rest(y)).any()
    y = wave(np.random.default_rng(0)) * [1, 1, 1, 0]
    assert not dropped_samples(y, rest(y)).any()


@pytest.mark.parametrize(("times", "lost"), [(5.9, False), (6.1, True)])
def test_a_repeated_sample_six_deviations_away_is_lost(times, lost):
    """The deviation is that of a normal distribution with the median of |left|: Phi^-1(3/4) = 0.6745."""
    y = 1e-6 * np.random.default_rng(3).standard_normal((1000, 1))
    y[500] = y[499] = 0.0
    left = np.where(np.arange(1000) % 2, 0.67449, -0.67449)[:, None]
    left[500] = times
    assert np.flatnonzero(dropped_samples(y, left)).tolist() == ([500] if lost else [])


@pytest.mark.parametrize(("apart", "step"), [(0.9e-6, 0.25), (1.1e-6, 1.1e-6)])
def test_values_a_millionth_of_the_range_apart_differ_by_how_they_were_written(apart, step):
    assert smallest_step(np.array([0.0, 0.25, 0.25 + apart, 0.5, 1.0])) == pytest.approx(step, rel=1e-5)


@pytest.mark.parametrize(("alone", "lost"), [(6, True), (7, False)])
def test_two_repeats_of_all_channels_are_lost_samples_unless_chance_makes_them_in_a_thousand(alone, lost):
    """Each channel repeats `alone` times of 1000 by itself: both do c = alone^2 / 1000 times, twice with c^2 / 2."""
    y = np.random.default_rng(3).standard_normal((1000, 2))
    for c in (0, 1):
        for at in (400, 800, *range(10 + 5 * c, 10 + 5 * c + 20 * alone, 20)):
            y[at, c] = y[at - 1, c]
    found = dropped_samples(y, np.zeros((1000, 2)))
    assert np.flatnonzero(found.any(axis=1)).tolist() == ([400, 800] if lost else [])


SPEEDS = TURN * np.array([7.3, 11.7, 16.9, 23.3, 50.1, 37.9])


def humming(seed: int, lines: dict[float, float], noise: float = 0.01):
    """Return a recording in whose first channel (of x, y) are lines {frequency: amplitude} of any phase."""
    random = np.random.default_rng((5, seed))
    signals, tacho = [], []
    for r, speed in enumerate(SPEEDS):
        y = closed_form(speed * TIME + 0.7 * r, HARMONICS) + noise * random.standard_normal((N, 2))
        for frequency, size in lines.items():
            y[:, 0] += size * np.cos(TURN * frequency * TIME + random.uniform(0, TURN))
        signals.append(y)
        tacho.append(pulses(lambda t, W=speed, r=r: W * t + 0.7 * r, TIME[-1]))
    return recording(signals, SPEEDS, tacho)


@pytest.mark.parametrize(
    "lines",
    [
        *(pytest.param(f, marks=pytest.mark.slow) for f in ({50.03: 0.002}, {59.95: 0.002}, {100.0: 0.002})),
        {50.0: 0.002, 150.0: 0.002},
    ],
)
def test_hum_of_a_fifth_of_the_noise_is_found_and_measured(lines):
    """One channel; amplitude 0.002 beside noise of 0.01: each line holds 2000 / 2 * 0.04 = 40 of its variances."""
    data = humming(1, lines)
    runs = harmonics_of(data)
    found = find_mains(data, runs)
    assert found == pytest.approx(list(lines), abs=0.1)
    again, sizes = with_pickups(data, runs, found)
    for item in sizes:
        assert item.amplitude["rotor.displacement[1]"] == pytest.approx(0.002, rel=0.2)
        assert item.amplitude["rotor.displacement[2]"] == 0.0
    near = [(name, order) for item in sizes for name, order in item.near]
    assert near == [("run4", round(at / 50)) for at in lines if at % 50 < 1]  # 50.1 Hz, twice and three times it
    assert all(len(item.fit.pickups) == len(lines) for k, item in enumerate(again) if k != 4)


@pytest.mark.slow
def test_no_hum_where_there_is_none():
    for seed in range(6):
        data = humming(seed, {})
        assert find_mains(data, harmonics_of(data)) == []
    data = humming(0, {53.0: 0.005})  # a line elsewhere is none of the mains
    assert find_mains(data, harmonics_of(data)) == []


@pytest.mark.parametrize(("power", "found"), [(27.1, []), (27.3, [50.0])])
def test_noise_shows_mains_once_in_a_thousand_recordings(monkeypatch, power, found):
    """The 20th multiple may be anywhere in 20 Hz, which are 20 of 1 Hz; of 20 multiples of two mains: 800 looks.

    Power of one channel is chi-squared of two: 2 ln(800 / 0.001) = 27.18.
    """
    spectrum = Spectrum(np.zeros(8000), 0.25, 9.0, 2)  # a quarter of the resolution from one to the next
    spectrum.power[200] = power
    monkeypatch.setattr(pickup, "spectra_of", lambda *_: [spectrum])
    monkeypatch.setattr(pickup, "_refined", lambda recording, runs, at: round(at, 0))
    assert find_mains(None, ()) == found


def test_an_order_under_hum_is_as_uncertain_as_the_hum_is_large():
    """50.0 Hz under 1X of 50.1 Hz: A = 0.03 in all other runs; of A / 2 e^{i phi} each part has variance A^2 / 8."""
    data = humming(2, {50.0: 0.03})
    runs = harmonics_of(data)
    again, [found] = with_pickups(data, runs, [50.0])
    assert found.near == ((data.runs[4].id, 1),)
    std = std_of(again[4].fit)[1, 0]
    expected = np.sqrt(0.03**2 / 8) * np.sinc(0.1 * TIME[-1])
    assert std.real == pytest.approx(expected, rel=0.03)
    assert std.imag == pytest.approx(expected, rel=0.03)
    assert std_of(again[4].fit)[1, 1].real < 0.001  # the other channel has none
    assert std_of(again[3].fit)[1, 0].real < 0.001  # nor has another run
    off = np.abs(again[4].fit.values[1, 0] - HARMONICS[1, 0])
    assert 0.005 < off < 0.02  # A / 2 = 0.015
