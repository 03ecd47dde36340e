"""A line too faint to stand out of one run: its frequency, from the spectra of all runs together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2

from rotorsim.signals.colour import density

__all__ = ["Spectrum", "faint_line", "spectrum_of"]

TURN = 2 * np.pi
LEAST = 64  # samples of a run
FINE = 4  # places in which a line of the spectrum is looked at
BESIDE = 4  # lines of the spectrum on each side, that hold less than a line
APART = 1.5  # lines of the spectrum beside a harmonic that belong to it
SLOWEST = 2.5  # periods in a run
MOST = 1e-6  # probability of the largest power that counts: a strong line of one run is not all runs'
FALSE_ALARM = 1e-6  # noise that has steps is not quite chi-squared
SHARE = 0.5  # of the runs, in which a line must not be too near to a harmonic
SAME = 1e-9  # of the variance of channels: what is less carries the noise of others


@dataclass(frozen=True, eq=False)
class Spectrum:
    """What harmonics leave over in a run: power (n,) in parts of the noise's, not a number where it is not told.

    Noise makes it chi-squared with ``freedom``. step: from one to the next [Hz]; speed [Hz].
    """

    power: np.ndarray
    step: float
    speed: float
    freedom: int

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """Return the power at frequencies [Hz]."""
        place = np.round(np.abs(frequency) / self.step).astype(int)
        return np.asarray(np.where(place < len(self.power), self.power[np.minimum(place, len(self.power) - 1)], np.nan))


def spectrum_of(
    time: np.ndarray, left: np.ndarray, speed: float, K: int, colour: np.ndarray | None = None
) -> Spectrum | None:
    """Return the spectrum of the residual (n, C) of harmonics up to order K; None where nothing is left over.

    colour (C, 3): of noise that grows towards low frequencies (`rotorsim.signals.colour.density`).

    Channels are made independent, and weighed against what is on either side of a line where that is more than
    elsewhere: skirts of harmonics that grow are no lines.
    """
    n = len(time)
    if colour is not None:
        shape = np.sqrt(density(colour, np.arange(n // 2 + 1)))
        left = np.fft.irfft(np.fft.rfft(left, axis=0) / np.where(shape > 0, shape, 1.0), n, axis=0)
    size = np.sqrt(np.mean(left**2, axis=0))
    scaled = left[:, size > 0] / size[size > 0]
    values, vectors = np.linalg.eigh(scaled.T @ scaled / n)
    kept = values > SAME
    if n < LEAST or not kept.any():
        return None
    white = scaled @ (vectors[:, kept] / np.sqrt(values[kept]))
    power = 2 / n * np.abs(np.fft.rfft(white, FINE * n, axis=0)) ** 2
    power = power.sum(axis=1)
    freedom = 2 * int(kept.sum())
    away = FINE * (1 + BESIDE // 2)
    mean = np.pad(uniform_filter1d(power, FINE * BESIDE, mode="nearest") / freedom, away, mode="edge")
    level = np.maximum(mean[: len(power)], mean[2 * away :])
    total = np.minimum(power / np.maximum(level, 1.0), chi2.isf(MOST, freedom))
    resolution = (n - 1) / n / (time[-1] - time[0])
    at, turns = np.arange(len(total)) * resolution / FINE, abs(speed) / TURN
    order = np.round(at / turns)
    harmonic = (np.abs(at - order * turns) < APART * resolution) & (order <= K)
    outside = (at < SLOWEST * resolution) | (at > at[-1] - SLOWEST * resolution)
    return Spectrum(np.where(harmonic | outside, np.nan, total), resolution / FINE, turns, freedom)


def faint_line(spectra: Sequence[Spectrum], K: int) -> tuple[float, bool, tuple[int, ...]] | None:
    """Return a frequency [Hz] at which all runs together hold more than noise, or its ratio to the speed.

    With whether it is the latter, and the orders k of the combinations with the speed: itself, or both sidebands of it.
    """
    if len(spectra) < 2:
        return None
    step, fastest = min(item.step for item in spectra), max(item.speed for item in spectra)
    top = min(len(item.power) * item.step for item in spectra)
    constant = step * np.arange(1, int(top / step))
    ratio = step / fastest * np.arange(1, int(min(K * fastest, top) / step))
    found = []
    looked = 0
    for follows, orders, grid in ((False, (0,), constant), (False, (-1, 1), constant), (True, (0,), ratio)):
        places = [(item, k * item.speed + grid * (item.speed if follows else 1.0)) for item in spectra for k in orders]
        power = np.array([item.at(place) for item, place in places])
        told = np.isfinite(power)
        freedom = told.T @ np.array([item.freedom for item, _ in places])
        enough = told.sum(axis=0) >= max(2, SHARE * len(places))
        chance = np.where(enough, chi2.logsf(np.nansum(power, axis=0), np.maximum(freedom, 1)), 0.0)
        best = int(np.argmin(chance))
        found.append((float(chance[best]), float(grid[best]), follows, orders))
        looked += int(enough.sum())
    least, value, follows, orders = min(found)
    return (value, follows, orders) if looked and least < np.log(FALSE_ALARM / looked) else None
