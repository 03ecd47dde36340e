"""Samples that a recorder lost and filled with the one before: found, and taken out of what is fitted."""

from __future__ import annotations

import numpy as np
from scipy.stats import poisson

from rotorsim.signals.harmonic_fit import Basis

__all__ = ["find_held", "without_held"]

AWAY = 6.0  # standard deviations of the noise: a repeated value so far off is the one before (2e-9 by chance)
FALSE_ALARM = 1e-3  # in a run, of values that repeat by chance in all channels at once
BY_CHANCE = 0.1  # of the instants at which all channels repeat, at most
MOST = 0.05  # of the samples: what repeats more often has another rate, or a coarse converter
ROUNDS = 3
WRITTEN = 1e-6  # of the range of a channel: closer values differ by how they were written, in single precision or with
# seven digits; no converter has 20 bits
NORMAL = 1.4826  # standard deviations in a median absolute deviation


def find_held(y: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Return which samples (n, C) repeat the one before because they were lost.

    y: samples. left: what harmonics leave over of them. Either all channels repeat at once, more often than chance
    makes them; or a channel repeats far away from where it should be, not at its extremes, where it may be clipped:
    by more than the noise and a step of its converter, which repeats readings of its own.
    """
    n, C = y.shape
    repeats = np.zeros((n, C), bool)
    repeats[1:] = y[1:] == y[:-1]
    moving = np.flatnonzero(np.ptp(y, axis=0) > 0)
    held = np.zeros((n, C), bool)
    if len(moving) == 0:
        return held
    noise = NORMAL * np.median(np.abs(left), axis=0)
    away = np.where(noise > 0, AWAY * noise + [_step(column) for column in y.T], np.inf)
    inside = (y > y.min(axis=0)) & (y < y.max(axis=0))
    held[:, moving] = (repeats & inside & (np.abs(left) > away))[:, moving]
    together = repeats[:, moving].all(axis=1)
    count = int(together.sum())
    if len(moving) > 1 and count:
        alone = np.maximum(repeats[:, moving].sum(axis=0) - count, 1) / n
        chance = n * float(np.prod(alone))
        if chance < BY_CHANCE * count and poisson.sf(count - 1, chance) < FALSE_ALARM:
            held[np.ix_(together, moving)] = True
    held[:, held.mean(axis=0) > MOST] = False
    return held


def _step(y: np.ndarray) -> float:
    """Return the least distance of two values of a channel (n,): the step of its converter, or next to nothing."""
    gaps = np.diff(np.unique(y))
    return float(min(gaps[gaps > WRITTEN * np.ptp(y)], default=0.0))


def without_held(basis: Basis, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return samples (n, C) with those that were lost as harmonics and their neighbours say, and which they are.

    What is put in is the harmonic fit and, between the neighbours, a straight line of what that leaves over.
    """
    left = basis.solve(y)[1]
    held = find_held(y, left)
    if not held.any():
        return y, held
    y = y.copy()
    at = np.arange(len(y))
    for _ in range(ROUNDS):
        for c in np.flatnonzero(held.any(axis=0)):
            lost = held[:, c]
            y[lost, c] += np.interp(at[lost], at[~lost], left[~lost, c]) - left[lost, c]
        left = basis.solve(y)[1]
    return y, held
