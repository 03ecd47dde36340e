"""The line that stands out most of what a diagram leaves, or of the signal that is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import median_filter
from scipy.special import gammainccinv

from rotorsim.criteria import CRITERIA
from rotorsim.signals.pickup import GRID_DRIFT, MAINS

PADDED = 8  # times the samples of a run: of the frequencies of a periodogram
AROUND = 25  # of the frequencies of a run: over which the background of a line is taken
SCATTER = 1.4  # of such a median of noise: how far below its mean it is at one of some thousand frequencies
OF_MAINS = 5  # multiples: beyond, a hundredth of them either way leaves little


class Line(NamedTuple):
    """Angular frequency, and power as a multiple of its median around, in the signal where it stands out most."""

    frequency: float
    ratio: float


def dominant_line(parts: Sequence[np.ndarray], dt: float, *, mains: bool = True) -> Line:
    """Return the line that stands out most of signals (N, c) of each run; mains: or False, one that is not theirs.

    By the largest ratio of the periodograms of all runs (Hann windows) to their median over the frequencies around,
    summed over the signals; each run counts alike. The search for a line must begin within half a cycle over a run of
    it. Source: D. B. Percival, A. T. Walden, Spectral Analysis for Physical Applications (1993), ch. 10.
    """
    size = next_fast_len(PADDED * max(map(len, parts)), real=True)
    power = np.zeros((size // 2 + 1, parts[0].shape[1]))
    for part in parts:
        values = np.hanning(len(part))[:, None] * np.nan_to_num(part - np.nanmean(part, axis=0))
        power += np.abs(rfft(values, size, axis=0)) ** 2 / np.maximum((values**2).sum(axis=0), 1e-300)
    around = median_filter(power, (PADDED * AROUND, 1), mode="nearest")
    ratios = power / np.maximum(around, 1e-300 + 1e-12 * power.max(axis=0))
    ratios[: 2 * PADDED] = 0.0  # two cycles in a run: what is slower is drift
    frequency = np.arange(len(ratios)) / (size * dt)
    width = 2 / (min(map(len, parts)) * dt)  # of a line through such a window, either way
    for theirs in () if mains else (m * f for m in range(1, OF_MAINS + 1) for f in MAINS):
        ratios[np.abs(frequency - theirs) <= GRID_DRIFT * theirs + width] = 0.0
    k = int(np.argmax(ratios.sum(axis=1)))
    return Line(float(2 * np.pi * frequency[k]), float(ratios[k].max()))


def white(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return signals (N,) of each run as columns (N - 1, 1), without what each sample keeps of the one before."""
    centred = [part - part.mean() for part in parts]
    square = sum(float(part[:-1] @ part[:-1]) for part in centred)
    kept = sum(float(part[1:] @ part[:-1]) for part in centred) / square if square > 0 else 0.0
    return [(part[1:] - kept * part[:-1])[:, None] for part in centred]


def line_beside_noise(parts: Sequence[np.ndarray], dt: float) -> float:
    """Return the power of the line that stands out of noise (N,) of each run, 1 of what chance makes; not of the mains.

    The noise is made white before. Over R runs white noise makes a periodogram with a gamma distribution of shape R;
    chance: `Criteria.not_explained`.
    """
    runs, frequencies = len(parts), max(map(len, parts)) / 2
    chance = gammainccinv(runs, CRITERIA.not_explained / frequencies) / gammainccinv(runs, 0.5)
    return float(dominant_line(white(parts), dt, mains=False).ratio / chance / SCATTER)
