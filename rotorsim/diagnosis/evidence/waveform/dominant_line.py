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
    """Angular frequency, and power as a multiple of its median around (a mean over signals)."""

    frequency: float
    ratio: float


def dominant_line(parts: Sequence[np.ndarray], dt: float, *, mains: bool = True) -> Line:
    """Return the line that stands out most of signals (N, c) of each run; mains: or False, one that is not theirs.

    By the largest ratio of the periodograms of all runs (Hann windows) to their median over the frequencies around,
    summed over the signals. The search for a line must begin within half a cycle over a run of it. Source: D. B.
    Percival, A. T. Walden, Spectral Analysis for Physical Applications (1993), ch. 10.
    """
    size = next_fast_len(PADDED * max(map(len, parts)), real=True)
    power = np.zeros((size // 2 + 1, parts[0].shape[1]))
    for part in parts:
        window = np.hanning(len(part))[:, None]
        power += np.abs(rfft(window * np.nan_to_num(part - np.nanmean(part, axis=0)), size, axis=0)) ** 2
    around = median_filter(power, (PADDED * AROUND, 1), mode="nearest")
    ratio = (power / np.maximum(around, 1e-300 + 1e-12 * power.max(axis=0))).mean(axis=1)
    ratio[: 2 * PADDED] = 0.0  # two cycles in a run: what is slower is drift
    frequency = np.arange(len(ratio)) / (size * dt)
    for theirs in () if mains else (m * f for m in range(1, OF_MAINS + 1) for f in MAINS):
        ratio[np.abs(frequency - theirs) <= GRID_DRIFT * theirs] = 0.0
    k = int(np.argmax(ratio))
    return Line(float(2 * np.pi * frequency[k]), float(ratio[k]))


def line_beside_noise(parts: Sequence[np.ndarray], dt: float, memory: float) -> float:
    """Return the power of the line that stands out of noise (N,) of each run, 1 of what chance makes; not of the mains.

    memory: 1/e of the noise is left after this time. It is made white before: x_k - exp(-dt / memory) x_(k-1). Over R
    runs white noise makes a periodogram with a gamma distribution of shape R; chance: `Criteria.not_explained`.
    """
    white = [(part[1:] - np.exp(-dt / memory) * part[:-1])[:, None] for part in parts]
    runs, frequencies = len(parts), max(map(len, parts)) / 2
    chance = gammainccinv(runs, CRITERIA.not_explained / frequencies) / gammainccinv(runs, 0.5)
    return float(dominant_line(white, dt, mains=False).ratio / chance / SCATTER)
