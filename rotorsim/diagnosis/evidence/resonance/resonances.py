"""Resonances that recorded responses show: frequencies, shapes over the channels, and how plainly they stand out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.evidence.waveform.data import TimeRun

__all__ = ["Resonance", "resonances"]

SMOOTH = 5.0  # lines of the spectrum, standard deviation of the window
STRONG, WEAK = 0.7, 0.4  # prominence of a peak, of the logarithm of amplitude
STRONG_CHANNELS = 2  # in which a resonance stands out
SAME = 0.02  # relative distance of peaks of one resonance
DRIVEN = 1e-2  # power of the inputs, of that at a peak, below which they cease to drive
BESIDE = 0.05  # of the frequency of a peak
ORDER = {"displacement": 1.0, "velocity": 0.0, "acceleration": -1.0}  # power of frequency that makes it a velocity


@dataclass(frozen=True, eq=False)
class Resonance:
    """A peak of several channels. frequency [Hz] and its spread over channels; shape (c,), of length 1, complex.

    strong: stands out in STRONG_CHANNELS at least, and its velocity is ``resonance_level`` of the largest; the others
    are peaks that half of the channels hint at. level: velocity, of the largest.
    """

    frequency: float
    spread: float
    shape: np.ndarray
    channels: int
    level: float
    strong: bool


def resonances(runs: Sequence[TimeRun], outputs: Sequence[str], inputs: Sequence[str] = ()) -> list[Resonance]:
    """Return the resonances that the longest of some runs shows, by frequency.

    A peak of the smoothed amplitude spectrum counts by its prominence, unless the inputs cease to drive beside it: the
    end of a sweep makes a peak as well. The shape is the first singular vector of the spectra about the peak.
    """
    run = max(runs, key=lambda item: item.size)
    frequencies = np.fft.rfftfreq(run.size, run.dt)
    y = run.measured(outputs)
    Y = np.fft.rfft(y - y.mean(axis=0), axis=0)
    smooth = gaussian_filter1d(np.abs(Y) ** 2, SMOOTH, axis=0)
    to_velocity = np.maximum(frequencies, frequencies[1])[:, None] ** (2 * _order_of(outputs))
    total = np.sqrt((smooth * to_velocity).sum(axis=1))
    peaks: list[tuple[float, int, float]] = []
    for c in range(len(outputs)):
        found, about = find_peaks(0.5 * np.log(np.maximum(smooth[:, c], 1e-300)), prominence=WEAK)
        peaks += [(float(frequencies[k]), c, float(p)) for k, p in zip(found, about["prominences"], strict=True)]
    groups: list[list[tuple[float, int, float]]] = []
    for peak in sorted(peaks):
        if groups and peak[0] <= groups[-1][-1][0] * (1 + SAME):
            groups[-1].append(peak)
        else:
            groups.append([peak])
    ceases = _ends(run, inputs, frequencies)
    found_all = [item for group in groups if (item := _resonance(group, frequencies, Y, total)) is not None]
    found_all = [item for item in found_all if not ceases(item.frequency)]
    largest = max((item.level for item in found_all), default=1.0)
    every = (replace(item, level=item.level / largest) for item in found_all)
    return [replace(item, strong=item.strong and item.level >= CRITERIA.resonance_level) for item in every]


def _ends(run: TimeRun, inputs: Sequence[str], frequencies: np.ndarray) -> Callable[[float], bool]:
    """Return a function that says whether the inputs cease to drive beside a frequency."""
    u = run.measured(inputs) if inputs else np.zeros((run.size, 1))
    power = gaussian_filter1d((np.abs(np.fft.rfft(u - u.mean(axis=0), axis=0)) ** 2).sum(axis=1), SMOOTH)

    def ceases(at: float) -> bool:
        beside = np.abs(frequencies - at) <= max(BESIDE * at, SMOOTH * frequencies[1])
        here = power[int(np.argmin(np.abs(frequencies - at)))]
        return bool(power[beside].min() < DRIVEN * here)

    return ceases


def _order_of(outputs: Sequence[str]) -> np.ndarray:
    ports = [name.partition("[")[0].rpartition(".")[2] for name in outputs]
    return np.array([ORDER.get(port, 0.0) for port in ports])


def _resonance(group: Any, frequencies: np.ndarray, Y: np.ndarray, total: np.ndarray) -> Resonance | None:
    """Return what a group of peaks (frequency, channel, prominence) stands for, None if it is no resonance."""
    strong = [peak for peak in group if peak[2] >= STRONG]
    is_strong = len({c for _, c, _ in strong}) >= STRONG_CHANNELS
    counted = {c for _, c, _ in group}
    if not is_strong and 2 * len(counted) < Y.shape[1]:
        return None
    used = strong if is_strong else group
    at = float(np.median([f for f, _, _ in used]))
    spread = float(np.median([abs(f - at) for f, _, _ in used]))
    if spread > SAME * at:
        return None
    near = np.abs(frequencies - at) <= SMOOTH * frequencies[1]
    shape = np.linalg.svd(Y[near].T, full_matrices=False)[0][:, 0]
    level = float(total[near].max())
    return Resonance(at, max(spread, float(frequencies[1])), shape, len(counted), level, is_strong)
