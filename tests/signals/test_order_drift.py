"""The drift of 1X within a run: values, covariance, and what counts for nothing."""

from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import Place
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.order_drift import drift_of_order

SPEED, COUNT, STEP = 150.0, 3000, 4e-4
DRIFT = np.array([[3e-6 - 1e-6j, 2e-6j], [-4e-7 + 2e-7j, 5e-7]])  # of x and y, degrees 1 and 2


def recorded(drift, noise=0.0, seed=0):
    """Return the recording of a shaft whose 1X drifts, and the harmonics of its run."""
    t = STEP * np.arange(COUNT)
    theta = SPEED * t + 0.3
    legendre = np.polynomial.legendre.legvander(2 * t / t[-1] - 1, 2)[:, 1:]
    vector = np.array([5e-5 + 1e-5j, 2e-5 - 4e-5j]) + legendre @ drift
    second = 2 * np.real(1e-6 * np.exp(2j * theta))
    rng = np.random.default_rng(seed)
    y = 2 * np.real(vector * np.exp(1j * theta)[:, None]) + second[:, None] + noise * rng.standard_normal((COUNT, 2))
    channels = {axis: Channel(axis, "rotor.displacement", axis, None, None, "m") for axis in "xy"}
    channels["angle"] = Channel("angle", "clock.theta", None, None, None, "rad")
    values = {"x": y[:, 0], "y": y[:, 1], "angle": theta}
    run = Run("a", "", t, values, None, None, {}, "identify", Place())
    recording = Recording("drift", "written down", Path(), channels, (run,))
    return recording, harmonics_of(recording)[0]


def test_a_drift_is_found_exactly_beside_other_orders():
    recording, item = recorded(DRIFT)
    found = drift_of_order(item, recording)
    np.testing.assert_allclose(found.values, DRIFT, atol=1e-12)
    steady = np.zeros_like(found.leaked)
    steady[1], steady[2] = [5e-5 + 1e-5j, 2e-5 - 4e-5j], 1e-6
    np.testing.assert_allclose(item.fit.values - found.leaked, steady, atol=1e-11)


def test_the_covariance_is_that_of_repeated_measurements():
    """Of 200, the mean of chi-squared of 8 numbers is known to 2 sqrt(8 / 200) = 0.3 in two of three."""
    total = 0.0
    for seed in range(200):
        recording, item = recorded(0 * DRIFT, 1e-6, seed)
        found = drift_of_order(item, recording)
        for degree in (1, 2):
            values = found.values[degree - 1]
            covariance = found.covariance(item, np.arange(2), degree, 0.0)
            first = 1j * item.fit.values[1]
            turned = np.concatenate([first.real, first.imag])
            covariance -= np.outer(turned, turned)
            real = np.concatenate([values.real, values.imag])
            total += real @ np.linalg.solve(covariance, real)
    assert total / 200 == pytest.approx(8, abs=0.9)


def test_what_turns_all_channels_alike_counts_for_nothing():
    """It is an error of the shaft angle."""
    recording, item = recorded(0 * DRIFT, 1e-6)
    found = drift_of_order(item, recording)
    covariance = found.covariance(item, np.arange(2), 1, 0.0)
    for direction, least, most in ((1j, 0.0, 0.1), (1.0, 1e3, np.inf)):
        turned = 0.1 * direction * item.fit.values[1]
        real = np.concatenate([turned.real, turned.imag])
        assert least <= real @ np.linalg.solve(covariance, real) <= most
