"""Rows of order vectors in time: when each begins and ends, how fast the shaft turns meanwhile, and their noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb, pi

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from rotorsim.recordings.orders import OrderRun

DIFFERENCES = 6  # order of the differences between rows that noise is seen in: of what lasts 8 rows they keep 0.7 %
MOST_CORRELATED = 0.98  # of what is left, from row to row: a hundred rows count as one
SOLVING_STEPS = 4  # each doubles the digits
_TURN = 2 * pi
_BEHIND = 1.05  # of the half row behind the last middle: the speed there is extrapolated


@dataclass(frozen=True, eq=False)
class RowTimes:
    """speed, angle: of the time [s], in rad/s and rad. begin, end [s]; middles (n,) [s] and starts (n,) [rad]: of rows.

    The angle counts from begin as ``angle(t) - angle(begin)``, and so do the starts.
    """

    speed: Callable[[np.ndarray | float], np.ndarray]
    angle: Callable[[np.ndarray | float], np.ndarray]
    begin: float
    end: float
    middles: np.ndarray
    starts: np.ndarray


def row_times(run: OrderRun) -> RowTimes:
    """Return when the rows of a run were taken: at their times, or turn after turn."""
    if run.time is None:  # successive turns: the ends of rows are passages of the mark
        ends = np.append(0.0, np.cumsum(_TURN * run.turns / run.speed))
        turned = CubicSpline(ends, _TURN * run.turns * np.arange(len(ends)))
        starts = _TURN * run.turns * np.arange(len(run.speed))
        speed = turned.derivative()
        return RowTimes(speed, speed.antiderivative(), 0.0, float(ends[-1]), (ends[1:] + ends[:-1]) / 2, starts)
    middles = run.time
    speed = PchipInterpolator(middles, run.speed, extrapolate=True)
    angle = speed.antiderivative()

    def near(k: int, turned: float) -> float:
        """Return when the shaft is by an angle further than in the middle of row k, its speed going on as there."""
        at = float(middles[k] + turned / run.speed[k])
        for _ in range(SOLVING_STEPS):
            if speed(at) > run.speed[k] / 2:
                at += float((angle(middles[k]) + turned - angle(at)) / speed(at))
        return at

    half = pi * run.turns
    begin, end = near(0, -half), near(-1, _BEHIND * half)
    return RowTimes(speed, angle, begin, end, middles, angle(middles) - half - angle(begin))


def row_noise(runs: Sequence[np.ndarray]) -> float | None:
    """Return the variance of the real parts of order vectors (n,) of runs, as sixth differences between rows show it.

    sum |d^6 Y|^2 / (2 C(12, 6) n): white noise gives its variance, smooth motion next to nothing. None where nowhere
    are as many rows without a gap.
    Source: J. von Neumann, Ann. Math. Stat. 12 (1941) 367, of higher order.
    """
    changes = np.concatenate([np.diff(y, DIFFERENCES) for y in runs]) if len(runs) else np.empty(0)
    changes = changes[np.isfinite(changes)]
    if not len(changes):
        return None
    return max(float((np.abs(changes) ** 2).sum()) / (2 * comb(2 * DIFFERENCES, DIFFERENCES) * len(changes)), 1e-300)


def row_floor(runs: Sequence[np.ndarray], least: float) -> float:
    """Return the variance of the real parts whose root is a share ``least`` of the rms of what varies in the runs."""
    there = [y[np.isfinite(y)] for y in runs]
    moved = sum(float((np.abs(y - y.mean()) ** 2).sum()) for y in there if len(y))
    return least**2 * moved / max(2 * sum(map(len, runs)), 1)


def slowness(left: Sequence[np.ndarray]) -> float:
    """Return (1 + r) / (1 - r), r the correlation of what is left from row to row: the rows that count as one.

    left: (n,) of each channel, NaN where nothing was measured. Of a mean of noise that forgets a share r a row.
    Source: G. E. P. Box et al., Time Series Analysis (2015), ch. 2.
    """
    products = sum(float(np.nansum(e[1:] * e[:-1].conj()).real) for e in left)
    squares = sum(float(np.nansum(np.abs(e) ** 2)) for e in left)
    share = min(max(products / squares, 0.0), MOST_CORRELATED) if squares else 0.0
    return (1 + share) / (1 - share)
