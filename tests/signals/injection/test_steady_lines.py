"""Lines beside a response: found where they are, and nothing where there is none."""

import numpy as np
import pytest

from rotorsim.signals.injection.local_polynomial import Spectra
from rotorsim.signals.injection.steady_lines import CLEAN, LEFT_OVER, THRESHOLD, without_lines, without_shapes
from tests.signals.injection.test_local_polynomial import RATE, TIME, resonance, through


def made(line, noise=0.05, seed=0):
    random = np.random.default_rng(seed)
    u = random.standard_normal(len(TIME))
    y = through(u, resonance) + noise * random.standard_normal(len(TIME)) + line
    return Spectra.of(u[:, None], y[:, None], RATE)


def test_a_line_is_found_with_its_frequency_and_amplitude_and_taken_out():
    line = 3.0 * np.cos(2 * np.pi * 81.2345 * TIME + 0.4) + 0.2 * np.cos(2 * np.pi * 50.0 * TIME)
    cleaned, found, rest = without_lines(made(line), 300.0)
    assert not rest.any()
    assert [one.frequency for one in found] == pytest.approx([81.2345, 50.0], abs=1e-3)
    assert [one.amplitude[0] for one in found] == pytest.approx([3.0, 0.2], rel=0.02)
    rest = np.abs(cleaned.Y - made(0.0).Y)[:, 0]
    assert rest.max() < 0.01 * np.abs(made(line).Y).max()


@pytest.mark.slow
def test_no_line_is_found_in_noise_and_resonances():
    assert (THRESHOLD, CLEAN, LEFT_OVER) == (30.0, 4.0, 0.01)
    assert [without_lines(made(0.0, seed=seed), 400.0)[1] for seed in range(8)] == [[]] * 8
    assert without_lines(made(0.0, noise=0.0), 400.0)[1] == []


def test_orders_of_a_shaft_whose_speed_drifts_are_taken_out_by_its_angle():
    theta = 2 * np.pi * (60 * TIME + 0.002 * TIME**2)  # 3 lines of the spectrum wide
    dirty = made(2.0 * np.cos(theta + 0.3))
    shape = np.fft.rfft(np.exp(1j * theta).real) / np.sqrt(len(TIME))
    shape += 1j * np.fft.rfft(np.exp(1j * theta).imag) / np.sqrt(len(TIME))  # of exp(i theta) alone
    cleaned = without_shapes(dirty, [shape])
    assert np.abs(cleaned.Y - made(0.0).Y).max() < 0.02 * np.abs(dirty.Y).max()
    assert without_lines(cleaned, 300.0)[1] == []


@pytest.mark.slow
def test_a_narrow_resonance_is_no_line():
    """FAULT of an earlier version: 50 lines were taken out of a resonance, and its peak came out 15 % too low."""
    random = np.random.default_rng(0)
    u = random.standard_normal(len(TIME))
    for noise in (0.0, 1e-4):
        y = through(u, lambda hz: resonance(hz, damping=0.0005)) + noise * random.standard_normal(len(TIME))
        assert without_lines(Spectra.of(u[:, None], y[:, None], RATE), 300.0)[1] == []


def test_a_line_whose_frequency_wanders_is_left_where_it_is():
    wandering = np.cos(2 * np.pi * 90 * TIME + 4 * np.sin(2 * np.pi * 0.1 * TIME))
    dirty = made(3.0 * wandering)
    cleaned, found, rest = without_lines(dirty, 300.0)
    assert (found, rest.any()) == ([], False)
    np.testing.assert_array_equal(cleaned.Y, dirty.Y)
