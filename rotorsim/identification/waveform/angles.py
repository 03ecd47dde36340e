"""Starts of free angles: where the effect of an angle may be anything, a search from the wrong side ends there."""

from __future__ import annotations

from math import tau

import numpy as np

from rotorsim.identification.waveform.search import OutputErrorSearch

PARTS = 4  # of a turn: the best is within 45 deg, where the effect has still 71 % of its projection
PASSES = 2  # through all angles, for the best of one depends on the others


def with_best_angles(search: OutputErrorSearch, start: np.ndarray) -> np.ndarray:
    """Return a start whose free angles are turned, one by one, to where a simulation leaves least.

    Angles that are bounded stay as they are.
    """
    best, least, sub = start, np.inf, search.substeps(start)
    for _ in range(PASSES if len(search.angles) > 1 else 1):
        for j in search.angles:
            first = best[j]
            for part in range(int(np.isfinite(least)), PARTS):
                trial = best.copy()
                trial[j] = (first + part * tau / PARTS + tau / 2) % tau - tau / 2 if part else first
                if (cost := search.evaluate(trial, sub, sensitivities=False).cost) < least:
                    best, least = trial, cost
    return best
