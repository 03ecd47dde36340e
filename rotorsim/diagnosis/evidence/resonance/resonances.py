"""Resonances that recorded responses show: frequencies, shapes over the channels, and how plainly they stand out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from rotorsim.criteria import CRITERIA
from rotorsim.identification.waveform.recorded.data import SampledRun

SMOOTH = 5.0  # lines of the spectrum, standard deviation of the window
STRONG, WEAK = 0.7, 0.4  # prominence of a peak, of the logarithm of amplitude
STRONG_CHANNELS = 2  # in which a resonance stands out
PEAK_DISTANCE = 0.02  # relative distance of peaks of one resonance
DRIVEN = 1e-2  # power of the inputs, of that at a peak, below which they cease to drive
PEAK_HALF_WIDTH = 0.05  # of the frequency of a peak
FREQUENCY_POWER = {
    "displacement": 1.0,
    "velocity": 0.0,
    "acceleration": -1.0,
}  # power of frequency that makes it a velocity


@dataclass(frozen=True, eq=False)
class Resonance:
    """A peak of several channels. frequency [Hz] and its spread over channels; shape (c,), of length 1, complex.

    strong: stands out in STRONG_CHANNELS at least, and its velocity is ``resonance_level`` of the largest; the others
    are peaks that half of the channels hint at. level: velocity, of the largest.
    """

    frequency: float
    spread: float
    shape: np.ndarray
    level: float
    strong: bool


def resonances(runs: Sequence[SampledRun], outputs: Sequence[str], inputs: Sequence[str] = ()) -> list[Resonance]:
    """Return the resonances that the longest of some runs shows, by frequency.

    A peak of the smoothed amplitude spectrum counts by its prominence, unless the inputs cease to drive beside it: the
    end of a sweep makes a peak as well. The shape is the first singular vector of the spectra about the peak.
    """
    run = max(runs, key=lambda item: item.size)
    frequencies = np.fft.rfftfreq(run.size, run.dt)
    y = run.measured(outputs)
    Y = np.fft.rfft(y - y.mean(axis=0), axis=0)
    smooth = gaussian_filter1d(np.abs(Y) ** 2, SMOOTH, axis=0)
    ports = [name.partition("[")[0].rpartition(".")[2] for name in outputs]
    orders = np.array([FREQUENCY_POWER.get(port, 0.0) for port in ports])
    to_velocity = np.maximum(frequencies, frequencies[1])[:, None] ** (2 * orders)
    total = np.sqrt((smooth * to_velocity).sum(axis=1))
    peaks: list[tuple[float, int, float]] = []
    for c in range(len(outputs)):
        at, about = find_peaks(0.5 * np.log(np.maximum(smooth[:, c], 1e-300)), prominence=WEAK)
        peaks += zip(frequencies[at], [c] * len(at), about["prominences"], strict=True)
    sorted_peaks = np.array(sorted(peaks)).reshape(-1, 3)
    apart = np.flatnonzero(sorted_peaks[1:, 0] > (1 + PEAK_DISTANCE) * sorted_peaks[:-1, 0]) + 1
    u = run.measured(inputs) if inputs else np.zeros((run.size, 1))
    power = gaussian_filter1d((np.abs(np.fft.rfft(u - u.mean(axis=0), axis=0)) ** 2).sum(axis=1), SMOOTH)
    groups = (_resonance(group, frequencies, Y, total) for group in np.split(sorted_peaks, apart))
    every = [item for item in groups if item is not None and not _ceases(item.frequency, frequencies, power)]
    largest = max((item.level for item in every), default=1.0)
    return [
        replace(item, level=level, strong=item.strong and level >= CRITERIA.resonance_level)
        for item in every
        for level in [item.level / largest]
    ]


def _ceases(at: float, frequencies: np.ndarray, power: np.ndarray) -> bool:
    """Return whether the inputs cease to drive beside a frequency; power: theirs by frequency."""
    beside = np.abs(frequencies - at) <= max(PEAK_HALF_WIDTH * at, SMOOTH * frequencies[1])
    return bool(power[beside].min() < DRIVEN * power[np.abs(frequencies - at).argmin()])


def _resonance(peaks: np.ndarray, frequencies: np.ndarray, Y: np.ndarray, total: np.ndarray) -> Resonance | None:
    """Return what a group of peaks (frequency, channel, prominence), (n, 3), stands for, None if it is no resonance."""
    strong = peaks[peaks[:, 2] >= STRONG]
    is_strong = len(np.unique(strong[:, 1])) >= STRONG_CHANNELS
    if not is_strong and 2 * len(np.unique(peaks[:, 1])) < Y.shape[1]:
        return None
    used = (strong if is_strong else peaks)[:, 0]
    at = float(np.median(used))
    spread = float(np.median(np.abs(used - at)))
    if spread > PEAK_DISTANCE * at:
        return None
    near = np.abs(frequencies - at) <= SMOOTH * frequencies[1]
    shape = np.linalg.svd(Y[near].T, full_matrices=False)[0][:, 0]
    return Resonance(at, max(spread, float(frequencies[1])), shape, float(total[near].max()), is_strong)
