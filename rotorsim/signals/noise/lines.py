"""Asynchronous lines: those that stand out of the residual of one run, and those that all runs show together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import tau

import numpy as np
from scipy.ndimage import correlate1d, uniform_filter1d
from scipy.stats import chi2

from rotorsim.signals.noise.colour import colour_of, density
from rotorsim.signals.noise.whitening import FALSE_ALARM, independent, is_white

MOST_LINES = 20
GAP, NEIGHBOURS = 3, 24  # the level of the noise at a line: the mean of so many others, these next to it left out
LEAST_KEPT = 0.3  # of the noise that a fit leaves of a line: below, the line says little of the noise
FEWEST_SAMPLES = 64  # samples of a run in which lines are looked for
FINE = 4  # places in which a line of the spectrum is looked at
FLOOR_LINES = 4  # lines of the spectrum on each side, that hold less than a line
APART = 1.5  # lines of the spectrum beside a harmonic that belong to it
FEWEST_PERIODS = 2.5  # periods in a run
LEAST_CHANCE = 1e-6  # probability of the largest power that counts: a strong line of one run is not all runs'
FAINT_ALARM = 1e-6  # chance of a false alarm of all runs: quantised noise is not quite chi-squared
CLEAR = 0.5  # of the runs, in which a line must not be too near to a harmonic


@dataclass(frozen=True)
class Line:
    """A spectral line beside the fitted harmonics: frequency [Hz], in orders of the speed, amplitude (C,) 0-peak."""

    frequency: float
    order: float
    amplitude: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Periodogram of the whitened residual of a run: power (n,) in parts of the noise's, NaN where it is not told.

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


def find_lines(
    time: np.ndarray,
    left: np.ndarray,
    speed: float,
    K: int,
    floor: np.ndarray,
    near: float = 1.5,
    kept: np.ndarray | None = None,
) -> list[Line]:
    """Return the lines that stand out of the residual (n, C) of a harmonic fit, largest first (of the residual's rms).

    Noise alone shows one in a thousand runs: power over the mean of its neighbours has an F distribution with 2 and
    2 NEIGHBOURS degrees of freedom. floor: (C,) amplitudes below which nothing counts. near: so many lines of the
    spectrum beside a fitted harmonic belong to it and are not reported. kept: see
    `rotorsim.signals.noise.noise.noise_of`.
    """
    n = len(left)
    if n < FEWEST_SAMPLES:
        return []
    power = np.abs(np.fft.rfft(left, axis=0)[1:-1]) ** 2 / n
    threshold = np.log(power.size / FALSE_ALARM)
    share = np.ones(len(power)) if kept is None else kept[1 : len(power) + 1]
    usable = share > LEAST_KEPT
    flat = power[usable] / share[usable, None]
    if not (power > threshold * power.mean(axis=0)).any() and is_white(flat):
        return []
    at_line = np.arange(1, len(power) + 1)
    shape = density(colour_of(flat, at_line[usable]), at_line)
    shape = np.where(shape > 0, shape, 1.0)  # a level that falls within the neighbours is no line of its upper end
    neighbours = np.repeat([1.0, 0.0, 1.0], [NEIGHBOURS // 2, 2 * GAP + 1, NEIGHBOURS // 2]) / NEIGHBOURS
    level = np.maximum(correlate1d(power / shape, neighbours, axis=0, mode="mirror") * shape, floor**2)
    threshold = NEIGHBOURS * np.expm1(threshold / NEIGHBOURS)
    ratio = np.divide(power, level, out=np.zeros_like(power), where=level > 0)
    lines: list[Line] = []
    running, resolution = abs(speed) / tau, (n - 1) / n / (time[-1] - time[0])
    for _ in range(MOST_LINES):
        at, channel = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        if ratio[at, channel] <= threshold:
            break
        frequency = (at + 1) * resolution
        for reach in (0.75, 0.1125):  # where the signal's Fourier integral is largest
            trial = frequency + np.linspace(-reach, reach, 13) * resolution
            sizes = np.abs(np.exp(-1j * tau * np.outer(trial, time)) @ left[:, channel])
            frequency = float(trial[int(np.argmax(sizes))])
        order = frequency / running if running else np.inf
        nearest = np.round(order)
        if nearest > K or abs(order - nearest) * running > near * resolution:
            amplitude = 2 * np.abs(np.exp(-1j * tau * frequency * time) @ left) / n
            lines.append(Line(frequency, float(order), tuple(amplitude.tolist())))
        skirts = 4 if ratio[at, channel] < 1e4 else 40
        ratio[max(0, at - skirts) : at + skirts + 1] = 0.0
    rms = np.maximum(np.sqrt(np.mean(left**2, axis=0)), np.maximum(floor, 1e-300))
    return sorted(lines, key=lambda line: -float((np.array(line.amplitude) / rms).max()))


def spectrum_of(
    time: np.ndarray, left: np.ndarray, speed: float, K: int, colour: np.ndarray | None = None
) -> Spectrum | None:
    """Return the spectrum of the residual (n, C) of harmonics up to order K; None where the residual is zero.

    colour (C, 3): of noise that grows towards low frequencies (`rotorsim.signals.noise.colour.density`).

    Channels are made independent, and weighed against what is on either side of a line where that is more than
    elsewhere: skirts of harmonics that grow are no lines.
    """
    n = len(time)
    if colour is not None:
        shape = np.sqrt(density(colour, np.arange(n // 2 + 1)))
        left = np.fft.irfft(np.fft.rfft(left, axis=0) / np.where(shape > 0, shape, 1.0), n, axis=0)
    white = independent(left)
    if n < FEWEST_SAMPLES or not white.shape[1]:
        return None
    power = (2 / n * np.abs(np.fft.rfft(white, FINE * n, axis=0)) ** 2).sum(axis=1)
    freedom = 2 * white.shape[1]
    away = FINE * (1 + FLOOR_LINES // 2)
    mean = np.pad(uniform_filter1d(power, FINE * FLOOR_LINES, mode="nearest") / freedom, away, mode="edge")
    level = np.maximum(mean[: len(power)], mean[2 * away :])
    total = np.minimum(power / np.maximum(level, 1.0), chi2.isf(LEAST_CHANCE, freedom))
    resolution = (n - 1) / n / (time[-1] - time[0])
    at, turns = np.arange(len(total)) * resolution / FINE, abs(speed) / tau
    order = np.round(at / turns)
    harmonic = (np.abs(at - order * turns) < APART * resolution) & (order <= K)
    outside = (at < FEWEST_PERIODS * resolution) | (at > at[-1] - FEWEST_PERIODS * resolution)
    return Spectrum(np.where(harmonic | outside, np.nan, total), resolution / FINE, turns, freedom)


def log_chance(spectra: Sequence[Spectrum], places: Sequence[np.ndarray], least: float = 0) -> np.ndarray:
    """Return the logarithm of the probability that noise makes as much power in all spectra together, (...).

    places (...) [Hz]: where each spectrum is looked at. Zero where fewer than ``least`` of them tell anything.
    """
    power = np.array([item.at(place) for item, place in zip(spectra, places, strict=True)])
    told = np.isfinite(power)
    freedom = np.tensordot([item.freedom for item in spectra], told, axes=1)
    enough = (told.sum(axis=0) >= least) & (freedom > 0)
    return np.where(enough, chi2.logsf(np.nansum(power, axis=0), np.maximum(freedom, 1)), 0.0)


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
    best = []
    looked = 0
    for follows, orders, grid in ((False, (0,), constant), (False, (-1, 1), constant), (True, (0,), ratio)):
        pairs = [(item, k * item.speed + grid * (item.speed if follows else 1.0)) for item in spectra for k in orders]
        chance = log_chance([item for item, _ in pairs], [at for _, at in pairs], max(2, CLEAR * len(pairs)))
        at = int(np.argmin(chance))
        best.append((float(chance[at]), float(grid[at]), follows, orders))
        looked += int((chance < 0).sum())
    least, value, follows, orders = min(best)
    return (value, follows, orders) if looked and least < np.log(FAINT_ALARM / looked) else None
