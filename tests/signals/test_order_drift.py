"""The drift of 1X within a run: values, covariance, and what counts for nothing."""

from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import Place
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.order_drift import drift_of_order

SPEED, COUNT, STEP = 150.0, 3000, 4e-4
DRIFT = np.array([[3e-6 - 1e-6j, 2e-6j], [-4e-7 + 2e-7j, 5e-7], [1e-7, 0], [0, -3e-8j]])  # of x and y, by degrees


def recorded(drift, noise=0.0, seed=0, beside=lambda t: 0 * t):
    """Return the recording of a shaft whose 1X drifts, with something beside it, and the harmonics of its run."""
    t = STEP * np.arange(COUNT)
    theta = SPEED * t + 0.3
    legendre = np.polynomial.legendre.legvander(2 * t / t[-1] - 1, 4)[:, 1:]
    vector = np.array([5e-5 + 1e-5j, 2e-5 - 4e-5j]) + legendre @ drift
    second = 2 * np.real(1e-6 * np.exp(2j * theta))
    rng = np.random.default_rng(seed)
    other = (second + beside(t))[:, None]
    y = 2 * np.real(vector * np.exp(1j * theta)[:, None]) + other + noise * rng.standard_normal((COUNT, 2))
    channels = {axis: Channel(axis, "rotor.displacement", axis, None, None, "m") for axis in "xy"}
    channels["angle"] = Channel("angle", "clock.theta", None, None, None, "rad")
    values = {"x": y[:, 0], "y": y[:, 1], "angle": theta}
    run = Run("a", "", t, values, None, None, {}, "identify", Place())
    recording = Recording("drift", "written down", Path(), channels, (run,))
    return recording, harmonics_of(recording)[0]


def significance(found, item):
    """Return chi-squared of the drift of two channels, 16 numbers, an error of the angle not counted."""
    total = 0.0
    for degree, values in enumerate(found.values, 1):
        first = 1j * item.fit.values[1]
        turned = np.concatenate([first.real, first.imag])
        covariance = found.covariance(item, np.arange(2), degree, 0.0) - np.outer(turned, turned)
        real = np.concatenate([values.real, values.imag])
        total += real @ np.linalg.solve(covariance, real)
    return total


def test_a_drift_is_found_exactly_beside_other_orders():
    recording, item = recorded(DRIFT)
    found = drift_of_order(item, recording)
    np.testing.assert_allclose(found.values, DRIFT, atol=1e-12)
    steady = np.zeros_like(found.leaked)
    steady[1], steady[2] = [5e-5 + 1e-5j, 2e-5 - 4e-5j], 1e-6
    np.testing.assert_allclose(item.fit.values - found.leaked, steady, atol=1e-11)


@pytest.mark.slow
def test_the_covariance_is_that_of_repeated_measurements():
    """Of 50, the mean of chi-squared of 16 numbers has a standard deviation of sqrt(2 * 16 / 50) = 0.8."""
    total = 0.0
    for seed in range(50):
        recording, item = recorded(0 * DRIFT, 1e-6, seed)
        total += significance(drift_of_order(item, recording), item)
    assert total / 50 == pytest.approx(16, abs=2.4)


@pytest.mark.parametrize("bins", [5.5, 7.8, -8.2, 20.2])
def test_a_steady_line_beside_1x_is_no_drift(bins):
    """FAULT: a line that was fitted beside the harmonics, but not beside the drift, was one of a tenth of 1X."""
    at = SPEED + 2 * np.pi * bins / (STEP * COUNT)
    recording, item = recorded(0 * DRIFT, 1e-7, 1, beside=lambda t: 5e-6 * np.cos(at * t + 0.3))
    assert len(item.fit.lines) == 1
    found = drift_of_order(item, recording)
    assert found.told
    assert significance(found, item) < 57  # with a probability of 1e-6 more


def test_what_turns_all_channels_alike_counts_for_nothing():
    """It is an error of the shaft angle."""
    recording, item = recorded(0 * DRIFT, 1e-6)
    found = drift_of_order(item, recording)
    covariance = found.covariance(item, np.arange(2), 1, 0.0)
    for direction, least, most in ((1j, 0.0, 0.1), (1.0, 1e3, np.inf)):
        turned = 0.1 * direction * item.fit.values[1]
        real = np.concatenate([turned.real, turned.imag])
        assert least <= real @ np.linalg.solve(covariance, real) <= most


@pytest.mark.parametrize("size", [1.0, 5.0])
def test_a_drift_is_no_noise_of_itself(size):
    """FAULT: the residual of the harmonics holds it, so that a drift of any size was a few times its own noise.

    A spectrum averaged over 24 lines has a standard deviation of 1 / sqrt(24) = 0.2 of itself.
    """
    spread = []
    for drift in (0 * DRIFT, size * DRIFT):
        recording, item = recorded(drift, 1e-6, 3)
        found = drift_of_order(item, recording)
        first = 1j * item.fit.values[1]
        turned = np.concatenate([first.real, first.imag])
        spread.append(np.diag(found.covariance(item, np.arange(2), 1, 0.0) - np.outer(turned, turned)))
    np.testing.assert_allclose(spread[1], spread[0], rtol=0.4)
    assert item.fit.noise.at_order(1)[0, 0] > 20 * item.fit.noise.at_order(12)[0, 0]
