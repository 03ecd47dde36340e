"""Stretches of equal samples: told apart are a clipped signal, a stuck converter and coarse resolution.

A smooth signal in coarse steps stands still where it turns, too. While m samples stay within one step q around the
top of a parabola, the samples m further out are at most r^2 q below it, r = (3 m - 1) / (m - 1) or about 3; and r^4 q
at the flattest top that two harmonics make. What jumps away faster was cut off.
"""

from __future__ import annotations

import numpy as np

__all__ = ["clipped", "flat"]

Stretch = tuple[int, int]  # first sample, one past the last
_SHORTEST = 3  # equal samples at an extreme
_SEVERAL = 3  # stretches at the extremes, to be no accident
_SWITCH = 0.95  # of the samples at the extremes: a signal of two states
_STUCK = 20  # equal samples elsewhere
_ROUNDING = 2  # steps, one at either end
_AWAY = 83  # steps; as for the extremes


def clipped(values: np.ndarray) -> list[Stretch]:
    """Return the stretches at the largest and the smallest value that resolution does not explain.

    values: (n,), finite. Empty unless there are several; a signal that is always at its extremes is a switch.
    """
    low, high = values.min(), values.max()
    if np.mean((values == low) | (values == high)) > _SWITCH:
        return []
    found: list[Stretch] = []
    starts, stops = _stretches(values)
    for extreme in (low, high):
        step = _step(values, extreme)
        at = (values[starts] == extreme) & (stops - starts >= _SHORTEST)
        for first, last in zip(starts[at].tolist(), stops[at].tolist(), strict=True):
            m = last - first
            sides = [side for side in (values[max(first - m, 0) : first], values[last : last + m]) if len(side)]
            natural = (((3 * m - 1) / (m - 1)) ** 4 + _ROUNDING) * step
            if min(float(np.abs(side - extreme).max()) for side in sides) > natural:
                found.append((first, last))
    return sorted(found) if len(found) >= _SEVERAL else []


def flat(values: np.ndarray) -> list[Stretch]:
    """Return long stretches of equal samples, away from the extremes and the ends, that resolution does not explain.

    values: (n,), finite. The signal must go far within as many samples before and after.
    """
    found: list[Stretch] = []
    starts, stops = _stretches(values)
    lengths = stops - starts
    inside = (lengths >= _STUCK) & (starts > 0) & (stops < len(values))
    inside &= (values[starts] != values.min()) & (values[starts] != values.max())
    for first, last in zip(starts[inside].tolist(), stops[inside].tolist(), strict=True):
        m = last - first
        enough = _AWAY * _step(values, values[first])
        sides = (values[max(first - m, 0) : first + 1], values[last - 1 : last + m])
        if min(float(np.ptp(side)) for side in sides) > enough:
            found.append((first, last))
    return found


def _stretches(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where stretches of equal samples start, and one past where they stop."""
    ends = np.flatnonzero(np.diff(values)) + 1
    return np.concatenate(([0], ends)), np.concatenate((ends, [len(values)]))


def _step(values: np.ndarray, level: float) -> float:
    """Return the resolution near a level: the smallest difference of values within a tenth of the range."""
    near = np.unique(values[np.abs(values - level) <= 0.1 * float(np.ptp(values))])
    if len(near) < 2:
        near = np.unique(values)
    return float(np.diff(near).min())
