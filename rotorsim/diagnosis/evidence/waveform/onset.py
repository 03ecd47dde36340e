"""The times at which something begins in what a diagram leaves, alike in all runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

ONSET_SPANS = (1 / 8, 1 / 32, 1 / 128)  # of the longest run: from what drifts on to what a controller removes at once


def onset_times(parts: Sequence[np.ndarray], times: Sequence[np.ndarray]) -> list[float]:
    """Return the times [s] at which the means of signals (N, c) of each run over a span change most, span by span.

    sum_c (sum_r (mean over t to t + L - mean over t - L to t))^2 / R(t): of R runs that reach so far, which white noise
    makes as large at any time. A step whose time is searched must begin near it, since its derivative by the time is a
    short pulse. Source: M. Basseville, I. V. Nikiforov, Detection of Abrupt Changes (1993), ch. 2.
    """
    grid = max(times, key=len)
    found = []
    for span in (fraction * float(np.ptp(grid)) for fraction in ONSET_SPANS):
        change, reach = np.zeros((len(grid), parts[0].shape[1])), np.zeros(len(grid))
        for part, time in zip(parts, times, strict=True):
            total = np.zeros(part.shape)
            total[1:] = np.cumsum(np.nan_to_num(part[:-1]) * np.diff(time)[:, None], axis=0)
            there = (grid - span >= time[0]) & (grid + span <= time[-1])
            before, now, after = (
                np.column_stack([np.interp(grid[there] + late, time, own) for own in total.T])
                for late in (-span, 0.0, span)
            )
            change[there] += after - 2 * now + before
            reach[there] += 1
        found.append(float(grid[np.argmax((change**2).sum(axis=1) / np.maximum(reach, 1))]))
    return found
