"""One mode that turns with the shaft: amplitude over speed, critical speed, half-power speeds, separation margin.

Order k of the displacement of a mode of natural frequency w and damping ratio z, at the speed W, r = k W / w:

|X|^2 ~ r^4 / ((1 - r^2)^2 + (2 z r)^2)   of 1X, which unbalance drives;   |X|^2 ~ 1 / (...)   of others

The critical speed N_c is that of the largest amplitude, N_1 and N_2 those at which it is 1 / sqrt(2) of that, and
AF = N_c / (N_2 - N_1). A natural frequency that follows the speed (gyroscopic moments), w + b (k W - w), stretches the
peak: what is said of it is read off its own curve.

Source: API RP 684 (2005), SP6.8.2.1 and SP6.8.2.10; API 617 (8th ed., 2014), 6.8.2.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np
from scipy.optimize import brentq, minimize_scalar

RESPONSIVE = 2.5  # AF from which a separation margin is needed
MOST_BELOW, MOST_ABOVE = 16.0, 26.0  # %: largest margins that are required
IN_RANGE = 0.005  # of a speed: a machine that runs at its largest operating speed is within the range
HALF_POWER = 1 / sqrt(2)
REACH, GRID = 6.0, 60  # half widths to each side of a peak, and places there, between which it is looked for
PEAK_SEARCH = {"xatol": 1e-9}


@dataclass(frozen=True)
class Peak:
    """speed, lower, upper: N_c, N_1, N_2 [rad/s]; amplification: AF. NaN: the response does not fall so far there."""

    speed: float
    lower: float
    upper: float

    @property
    def amplification(self) -> float:
        """AF = N_c / (N_2 - N_1); NaN without both half-power speeds."""
        return self.speed / (self.upper - self.lower)


def settled_response(speed: np.ndarray, frequency: float, damping: float, order: int, slope: float) -> np.ndarray:
    """Return the settled response of one mode at speeds (n,) [rad/s], complex: g / (w^2 - k^2 W^2 + 2 i z w k W).

    g is W^2 of 1X and one of other orders; slope: b, the natural frequency is w + b (k W - w).
    """
    turning = order * speed
    own = frequency + slope * (turning - frequency)
    return np.asarray((speed**2 if order == 1 else 1.0) / (own**2 - turning**2 + 2j * damping * own * turning))


def peak_of(frequency: float, damping: float, order: int = 1, slope: float = 0.0) -> Peak:
    """Return the peak of order k of one mode, w [rad/s], z > 0; all NaN where it is damped beyond any peak."""
    if slope:
        return _peak_on(frequency, damping, order, slope)
    z2 = damping**2
    if 2 * z2 >= 1:
        return Peak(np.nan, np.nan, np.nan)
    largest = 1 / (4 * z2 * (1 - z2))
    if order == 1:  # u^2 / ((1 - u)^2 + 4 z^2 u) = P / 2, u = r^2
        top, terms = 1 / (1 - 2 * z2), (1 - largest / 2, largest * (1 - 2 * z2), -largest / 2)
    else:
        top, terms = 1 - 2 * z2, (1.0, 4 * z2 - 2, 1 - 2 / largest)
    roots = np.roots(terms)
    real = np.sort(roots.real[(np.abs(roots.imag) < 1e-12 * np.abs(roots)) & (roots.real > 0)])
    below, above = real[real < top], real[real > top]
    lower = sqrt(below[-1]) if len(below) else np.nan
    upper = sqrt(above[0]) if len(above) else np.nan
    return Peak(*(frequency / order * r for r in (sqrt(top), lower, upper)))


def _peak_on(frequency: float, damping: float, order: int, slope: float) -> Peak:
    """Return the peak of a mode whose natural frequency follows the speed, by search on its curve."""

    def size(speed: float) -> float:
        return float(np.abs(settled_response(np.array([speed]), frequency, damping, order, slope))[0])

    width = damping / (1 - slope)
    middle = frequency / order
    grid = middle * (1 + width * np.linspace(-REACH, REACH, 2 * GRID + 1))
    grid = grid[grid > 0]
    at = int(np.argmax([size(speed) for speed in grid]))
    if at in (0, len(grid) - 1):
        return Peak(np.nan, np.nan, np.nan)
    top = minimize_scalar(
        lambda v: -size(v), bounds=(grid[at - 1], grid[at + 1]), method="bounded", options=PEAK_SEARCH
    ).x
    wanted = size(top) * HALF_POWER
    sides = []
    for side in (grid[:at][::-1], grid[at + 1 :]):
        below = next((speed for speed in side if size(speed) < wanted), None)
        sides.append(np.nan if below is None else float(brentq(lambda v: size(v) - wanted, below, top)))
    return Peak(float(top), sides[0], sides[1])


def peak_in(speed: np.ndarray, size: np.ndarray, at: int) -> Peak:
    """Return the peak of a curve |X| (n,) over rising speeds (n,) [rad/s] at one of its largest places, as it is read.

    N_1 and N_2 are where the curve crosses 1 / sqrt(2) of its largest value, between two rows along a straight line.
    """
    if not size[at] > 0:
        return Peak(float("nan"), float("nan"), float("nan"))
    wanted = size[at] * HALF_POWER

    def crossing(step: int) -> float:
        k = at
        while 0 <= k + step < len(size) and isfinite(size[k + step]):
            if size[k + step] <= wanted:
                part = (size[k] - wanted) / (size[k] - size[k + step])
                return float(speed[k] + part * (speed[k + step] - speed[k]))
            k += step
        return float("nan")

    return Peak(float(speed[at]), crossing(-1), crossing(1))


@dataclass(frozen=True)
class Margin:
    """Separation of a critical speed from the operating speeds, in % of the nearer one of these; required: SM_r.

    A critical speed inside has a margin of zero.
    """

    actual: float
    required: float

    @property
    def met(self) -> bool:
        """Whether the critical speed is far enough away, or too well damped to matter."""
        return self.actual >= self.required


def unmeasured(low: float, high: float, lowest: float, highest: float) -> list[tuple[float, float]]:
    """Return the speeds at which a critical speed may be too near, and that a run from low to high has not passed.

    From the largest margin below the lowest operating speed to the largest above the highest one.
    """
    first, last = lowest * (1 - MOST_BELOW / 100), highest * (1 + MOST_ABOVE / 100)
    parts = (first, min(low, last)), (max(high, first), last)
    return [(a, b) for a, b in parts if b - a > IN_RANGE * b]


def separation_margin(critical: float, amplification: float, lowest: float, highest: float) -> Margin:
    """Return the margin between a critical speed and operating speeds from lowest to highest, all in one unit.

    SM_r = min(17 (1 - 1 / (AF - 1.5)), 16) % of the lowest where it is below, min(10 + 17 (1 - 1 / (AF - 1.5)), 26) %
    of the highest where it is above; none below AF = 2.5. An AF that is NaN counts as such: no half-power speeds.
    """
    matters = amplification >= RESPONSIVE
    more = 17 * (1 - 1 / (amplification - 1.5)) if matters else 0.0
    below, above = min(more, MOST_BELOW), min(10 + more, MOST_ABOVE)
    if critical < lowest:
        return Margin(100 * (lowest - critical) / lowest, below if matters else 0.0)
    if critical > highest:
        return Margin(100 * (critical - highest) / highest, above if matters else 0.0)
    return Margin(0.0, min(below, above) if matters else 0.0)
