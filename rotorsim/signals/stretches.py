"""Stretches of equal samples: of a clipped signal or a stuck converter, and not of coarse resolution.

A smooth signal in coarse steps stands still where it turns, too. While m samples stay within one step q around the
top of a parabola, the samples m further out are at most r^2 q below it, r = (3 m - 1) / (m - 1) or about 3; and r^4 q
at the flattest top that two harmonics make. What jumps away faster was cut off.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

Stretch = tuple[int, int]  # first sample, one past the last
_SHORTEST = 3  # equal samples at an extreme
_SEVERAL = 3  # stretches at the extremes, to be no accident
_SWITCH = 0.95  # of the samples at the extremes: a signal of two states
_STUCK = 20  # equal samples elsewhere
_ROUNDING = 2  # steps, one at either end
_AWAY = 83  # steps; as for the extremes
_WRITTEN = 1e-6  # of the range of a signal: closer values differ by how they were written, in single precision or with
# seven digits; no converter has 20 bits


def clipped_stretches(values: np.ndarray) -> list[Stretch]:
    """Return the stretches at the largest and the smallest value that resolution does not explain.

    values: (n,), finite. Empty unless there are several; a signal that is always at its extremes is a switch.
    """
    low, high = values.min(), values.max()
    if np.mean((values == low) | (values == high)) > _SWITCH:
        return []
    cut = []
    for first, last in _stretches(values, _SHORTEST):
        m, level = last - first, values[first]
        if level in (low, high):
            sides = [side for side in (values[max(first - m, 0) : first], values[last : last + m]) if len(side)]
            natural = (((3 * m - 1) / (m - 1)) ** 4 + _ROUNDING) * _resolution(values, level)
            if min(float(np.abs(side - level).max()) for side in sides) > natural:
                cut.append((first, last))
    return cut if len(cut) >= _SEVERAL else []


def flat_stretches(values: np.ndarray) -> list[Stretch]:
    """Return long stretches of equal samples, away from the extremes and the ends, that resolution does not explain.

    values: (n,), finite. The signal must go far within as many samples before and after.
    """
    stuck, low, high = [], values.min(), values.max()
    for first, last in _stretches(values, _STUCK):
        m, level = last - first, values[first]
        if first > 0 and last < len(values) and low < level < high:
            sides = (values[max(first - m, 0) : first + 1], values[last - 1 : last + m])
            if min(float(np.ptp(side)) for side in sides) > _AWAY * _resolution(values, level):
                stuck.append((first, last))
    return stuck


def _stretches(values: np.ndarray, shortest: int) -> Iterator[Stretch]:
    """Yield the stretches of so many equal samples, or more."""
    ends = np.concatenate(([0], np.flatnonzero(np.diff(values)) + 1, [len(values)]))
    long = np.flatnonzero(np.diff(ends) >= shortest)
    return zip(ends[long].tolist(), ends[long + 1].tolist(), strict=True)


def _resolution(values: np.ndarray, level: float) -> float:
    """Return the resolution near a level: the smallest difference of values within a tenth of the range."""
    near = np.unique(values[np.abs(values - level) <= 0.1 * float(np.ptp(values))])
    return float(np.diff(near if len(near) > 1 else np.unique(values)).min())


def smallest_step(values: np.ndarray) -> float:
    """Return the least distance of two values of a signal (n,), rounding left out; zero for none.

    It is the quantisation step of a converter, or next to nothing.
    """
    gaps = np.diff(np.unique(values))
    return float(min(gaps[gaps > _WRITTEN * np.ptp(values)], default=0.0))
