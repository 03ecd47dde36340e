"""The line that stands out most of what a diagram leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import median_filter

PADDED = 8  # times the samples of a run: of the frequencies of a periodogram
AROUND = 25  # of the frequencies of a run: over which the background of a line is taken


def dominant_frequency(parts: Sequence[np.ndarray], dt: float) -> float:
    """Return the angular frequency of the line that stands out most of signals (N, c) of each run.

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
    ratio = (power / np.maximum(around, 1e-300 + 1e-12 * power.max(axis=0))).sum(axis=1)
    first = 2 * PADDED  # two cycles in a run: what is slower is drift
    return float(2 * np.pi * (first + np.argmax(ratio[first:])) / (size * dt))
