"""Local polynomials against responses in closed form."""

import numpy as np
import pytest

from rotorsim.signals.injection.local_polynomial import Spectra, least_half, response, window_halves

RATE, SECONDS = 1000.0, 40.0
TIME = np.arange(int(RATE * SECONDS)) / RATE


def resonance(hz, frequency=80.0, damping=0.02):
    r = np.asarray(hz) / frequency
    return 1 / (1 - r**2 + 2j * damping * r)


def through(signal, answer):
    """Return a signal behind a response, at rest before."""
    n = len(signal)
    hz = np.fft.rfftfreq(2 * n, 1 / RATE)
    return np.fft.irfft(answer(hz) * np.fft.rfft(signal, 2 * n), 2 * n)[:n]


def spectra(noise, seed=0, answer=resonance):
    random = np.random.default_rng(seed)
    u = random.standard_normal(len(TIME))
    y = through(u, answer) + noise * random.standard_normal(len(TIME))
    return Spectra.of(u[:, None], y[:, None], RATE)


def test_windows_leave_as_many_lines_as_they_fit():
    assert (least_half(1), least_half(2)) == (6, 9)
    assert window_halves(1, 10_000) == [6, 9, 14, 21, 32, 48, 72, 108, 162]


def test_a_transient_is_no_part_of_the_response():
    hz = np.linspace(20, 200, 300)
    found = response(spectra(0.0), hz)
    np.testing.assert_allclose(found.S[:, 0, 0], resonance(hz), rtol=2e-3)
    simple = spectra(0.0)
    ratio = (simple.Y / simple.U)[np.round(hz / simple.step).astype(int), 0]
    assert np.abs(ratio / resonance(hz) - 1).max() > 0.1


@pytest.mark.parametrize("noise", [0.05, 1.0])
def test_intervals_hold_the_truth(noise):
    """90 % of independent frequencies, noise in them as it is; binomial: 200 of them, 85 to 95 %."""
    hz = np.linspace(20, 300, 10)
    inside = []
    for seed in range(20):
        found = response(spectra(noise, seed), hz)
        std = np.sqrt(found.covariance[:, 0, 0, 0].real)
        inside.append(np.abs(found.S[:, 0, 0] - resonance(hz)) < np.sqrt(np.log(10)) * std)  # circular: exp(-d^2 / s^2)
    assert 0.84 < np.mean(inside) < 0.96


def test_a_narrow_resonance_is_followed_where_noise_is_small_and_flat_parts_are_smoothed():
    """Half-power bandwidths of 38 and 19 lines of the spectrum: what a record is too short for comes out low."""
    hz = np.linspace(79, 81, 41)
    for damping, error in ((0.006, 0.005), (0.003, 0.032)):
        sharp = response(spectra(0.01, answer=lambda f, z=damping: resonance(f, damping=z)), hz)
        np.testing.assert_allclose(sharp.S[:, 0, 0], resonance(hz, damping=damping), rtol=error)
    flat = response(spectra(1.0, answer=np.ones_like), np.linspace(100, 300, 50))
    assert np.median(flat.freedom) > 100
    assert np.median(sharp.freedom) < 60


def test_coherence_is_the_share_that_the_input_explains():
    found = response(spectra(1.0, answer=np.ones_like), np.linspace(100, 300, 50))
    assert found.coherence.mean() == pytest.approx(0.5, abs=0.02)
    assert np.linalg.norm(found.noise[:, 0, 0].mean() - 1) < 0.05


def test_two_inputs_at_once_are_told_apart():
    random = np.random.default_rng(3)
    u = random.standard_normal((len(TIME), 2))
    y = through(u[:, 0], resonance) + 0.5 * u[:, 1]
    hz = np.linspace(40, 200, 100)
    found = response(Spectra.of(u, y[:, None], RATE), hz)
    np.testing.assert_allclose(found.S[:, 0, 0], resonance(hz), rtol=5e-3)
    np.testing.assert_allclose(found.S[:, 0, 1], 0.5, atol=5e-3 * np.abs(resonance(80.0)), rtol=0)


def test_nothing_is_told_where_nothing_is_injected_or_it_cannot_be_told_from_the_transient():
    silent = Spectra.of(np.zeros((len(TIME), 1)), np.ones((len(TIME), 1)) * TIME[:, None], RATE)
    assert np.isnan(response(silent, np.array([50.0])).S).all()
    short = np.where(TIME < 0.01, 1.0, 0.0)[:, None]  # over in so short a time that its spectrum is as smooth
    assert np.isnan(response(Spectra.of(short, short, RATE), np.array([50.0])).S).all()


def test_an_input_excites_what_stands_out_of_its_least_power():
    random = np.random.default_rng(1)
    tone = np.sin(2 * np.pi * 100 * TIME)[:, None]
    noisy = Spectra.of(tone + 1e-3 * random.standard_normal(tone.shape), tone, RATE)
    excited = np.flatnonzero(noisy.excited[:, 0]) * noisy.step
    excited = excited[excited > 5.0]  # below is what a parabola leaves
    assert 98 < excited.min() < 100 < excited.max() < 102
    white = Spectra.of(random.standard_normal(tone.shape), tone, RATE)
    assert white.excited.all()
