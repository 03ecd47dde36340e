"""Samples that a recorder dropped and filled with the one before: detected, and taken out of what is fitted."""

from __future__ import annotations

import numpy as np
from scipy.stats import poisson

from rotorsim.signals.harmonic_basis import Basis
from rotorsim.signals.noise.whitening import FALSE_ALARM
from rotorsim.signals.stretches import smallest_step

AWAY = 6.0  # standard deviations of the noise: a repeated value so far off is the one before (2e-9 by chance)
BY_CHANCE = 0.1  # of the instants at which all channels repeat, at most
MOST_DROPPED = 0.05  # of the samples: what repeats more often has another rate, or a coarse converter
MAD_TO_STD = 1.4826  # standard deviations in a median absolute deviation


def dropped_samples(y: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return which samples (n, C) repeat the one before because they were dropped.

    y: samples. residual: of their harmonics. Either all channels repeat at once, more often than chance makes them;
    or a channel repeats far away from where it should be, not at its extremes, where it may be clipped: by more than
    the noise and a quantisation step, which repeats readings of its own.
    """
    n, C = y.shape
    repeats = np.zeros((n, C), bool)
    repeats[1:] = y[1:] == y[:-1]
    moving = np.ptp(y, axis=0) > 0
    noise = MAD_TO_STD * np.median(np.abs(residual), axis=0)
    away = np.where(noise > 0, AWAY * noise + [smallest_step(column) for column in y.T], np.inf)
    inside = (y > y.min(axis=0)) & (y < y.max(axis=0))
    dropped = repeats & inside & (np.abs(residual) > away) & moving
    together = repeats[:, moving].all(axis=1)
    count = int(together.sum())
    if moving.sum() > 1 and count:
        alone = np.maximum(repeats[:, moving].sum(axis=0) - count, 1) / n
        chance = n * float(np.prod(alone))
        if chance < BY_CHANCE * count and poisson.sf(count - 1, chance) < FALSE_ALARM:
            dropped |= np.outer(together, moving)
    return np.asarray(dropped & (dropped.mean(axis=0) <= MOST_DROPPED))


def fill_dropped(basis: Basis, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return samples (n, C) with those that were dropped as harmonics and their neighbours say, and which they are.

    What is filled in is the harmonic fit and, between the neighbours, a straight line of its residual.
    """
    residual = basis.solve(y)[1]
    dropped = dropped_samples(y, residual)
    if not dropped.any():
        return y, dropped
    y = y.copy()
    at = np.arange(len(y))
    for _ in range(3):
        for c in np.flatnonzero(dropped.any(axis=0)):
            lost = dropped[:, c]
            y[lost, c] += np.interp(at[lost], at[~lost], residual[~lost, c]) - residual[lost, c]
        residual = basis.solve(y)[1]
    return y, dropped
