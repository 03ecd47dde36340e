"""One mode that turns with the shaft: amplitude over speed, critical speed, half-power speeds, separation margin.

Order k of the displacement of a mode of natural frequency w and damping ratio z, at the speed W, r = k W / w:

|X|^2 ~ r^4 / ((1 - r^2)^2 + (2 z r)^2)   of 1X, which unbalance drives;   |X|^2 ~ 1 / (...)   of others

The critical speed N_c is that of the largest amplitude, N_1 and N_2 those at which it is 1 / sqrt(2) of that, and
AF = N_c / (N_2 - N_1). Source: API RP 684 (2005), SP6.8.2.1 and SP6.8.2.10; API 617 (8th ed., 2014), 6.8.2.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np

RESPONSIVE = 2.5  # AF from which a separation margin is needed
MOST_BELOW, MOST_ABOVE = 16.0, 26.0  # %: largest margins that are required
HALF_POWER = 1 / sqrt(2)


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


def peak_of(frequency: float, damping: float, order: int = 1) -> Peak:
    """Return the peak of order k of one mode, w [rad/s], z > 0; all NaN where it is damped beyond any peak."""
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


def peak_in(speed: np.ndarray, size: np.ndarray, at: int) -> Peak:
    """Return the peak of a curve |X| (n,) over rising speeds (n,) [rad/s] at one of its largest places, as it is read.

    N_1 and N_2 are where the curve crosses 1 / sqrt(2) of its largest value, between two rows along a straight line.
    """
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
