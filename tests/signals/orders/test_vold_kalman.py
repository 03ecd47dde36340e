"""The Vold-Kalman filter against closed forms: passband, chirps whose amplitude changes slowly, crossing orders."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim import RotorsimError
from rotorsim.signals.orders.vold_kalman import vold_kalman

DT = 1e-3


@pytest.mark.parametrize(("poles", "bandwidth"), [(1, 4.0), (2, 4.0), (2, 20.0), (3, 20.0)])
def test_the_passband_is_3_db_wide_as_stated(poles: int, bandwidth: float) -> None:
    """A line beside the order by half of the bandwidth passes by 1 / sqrt 2, others by the formula."""
    t = np.arange(6000) * DT
    angle = 2 * np.pi * 100.0 * t
    r = np.sqrt((np.sqrt(2) - 1) / 2) / (2 * np.sin(np.pi * bandwidth * DT / 2)) ** poles
    for share in (0.0, 0.5, 1.0):
        beside = share * bandwidth
        y = np.cos(angle + 2 * np.pi * beside * t)[:, None]
        found = vold_kalman(y, angle[None], np.full((1, len(t)), bandwidth), DT, poles=poles)[0, 2000:4000, 0]
        passed = np.mean(found * np.exp(-2j * np.pi * beside * t[2000:4000]))
        truth = 1 / (1 + 2 * r**2 * (2 * np.sin(np.pi * beside * DT)) ** (2 * poles))
        assert abs(passed - truth) < 2e-3
        if share == 0.5:
            assert truth == pytest.approx(1 / np.sqrt(2), rel=1e-12)


def test_amplitude_and_phase_of_a_chirp_that_grows_slowly() -> None:
    """Two orders of a run-up from 10 to 60 Hz in 8 s; envelopes as smooth as a second of time."""
    t = np.arange(8000) * DT
    theta = 2 * np.pi * (10.0 * t + 50.0 / 16.0 * t**2)
    truth = np.stack([(1 + 0.3 * np.sin(0.8 * t)) * np.exp(0.5j * np.sin(0.6 * t)), 0.4 * np.exp(1j - 0.2 * t)])
    y = (truth * np.exp(1j * np.outer([1, 2], theta))).real.sum(axis=0)[:, None]
    speed = (10.0 + 50.0 / 8.0 * t)[None].repeat(2, 0)
    found = vold_kalman(y, np.outer([1, 2], theta), 0.2 * speed, DT)[:, :, 0]
    middle = slice(800, -800)
    assert np.abs(found - truth)[:, middle].max() < 2e-3
    assert np.abs(found - truth).max() < 0.05  # at the ends


def test_orders_that_cross_are_told_apart() -> None:
    """An order of a chirp crosses a line of 30 Hz: alone each takes the other in, together they do not."""
    t = np.arange(8000) * DT
    theta, line = 2 * np.pi * (10.0 * t + 40.0 / 16.0 * t**2), 2 * np.pi * 30.0 * t
    y = (1.0 * np.exp(1j * (theta + 0.3)) + 0.7 * np.exp(1j * (line - 1.0))).real[:, None]
    bandwidths = np.full((2, len(t)), 2.0)
    both = vold_kalman(y, np.stack([theta, line]), bandwidths, DT)[:, :, 0]
    alone = vold_kalman(y, theta[None], bandwidths[:1], DT)[0, :, 0]
    middle = slice(1000, -1000)
    assert np.abs(both[0] - np.exp(0.3j))[middle].max() < 5e-3
    assert np.abs(both[1] - 0.7 * np.exp(-1j))[middle].max() < 5e-3
    assert np.abs(alone - np.exp(0.3j))[middle].max() > 0.3


def test_missing_samples_are_bridged() -> None:
    t = np.arange(4000) * DT
    angle = 2 * np.pi * 40.0 * t
    y = np.stack([np.cos(angle + 0.2), np.cos(angle - 1.0)], axis=1)
    y[1500:1520, 0] = np.nan
    found = vold_kalman(y, angle[None], np.full((1, len(t)), 2.0), DT)[0]
    assert np.abs(found - np.exp([0.2j, -1j]))[500:-500].max() < 1e-6


def test_it_is_as_exact_as_rounding_lets_it_be_at_the_narrowest() -> None:
    t = np.arange(20_000) * DT
    angle = 2 * np.pi * 40.0 * t
    found = vold_kalman(np.cos(angle + 0.2)[:, None], angle[None], np.full((1, len(t)), 0.2), DT)[0, :, 0]
    assert np.abs(found - np.exp(0.2j)).max() < 1e-3


@pytest.mark.parametrize(("bandwidth", "said"), [(0.1, "too narrow for samples of 1000 Hz"), (5.0, "too many at once")])
def test_what_cannot_be_filtered_is_refused(bandwidth: float, said: str) -> None:
    n = 2_000_000 if bandwidth == 5.0 else 100
    with pytest.raises(RotorsimError, match=said):
        vold_kalman(np.zeros((n, 1)), np.zeros((2, n)), np.broadcast_to(bandwidth, (2, n)), DT)
