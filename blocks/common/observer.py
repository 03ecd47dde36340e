"""Acceleration from a velocity, for forces that need it where feeding it back at once would be an algebraic loop.

v' = a + sqrt(2) w (u - v), a' = w^2 (u - v) with u the velocity: v' = G u', G = (1 + sqrt(2) s / w) / D,
D = 1 + sqrt(2) s / w + (s / w)^2. The error is 1 - G = (s / w)^2 / D: (f / f_w)^2 of the acceleration, and in phase
with it, for frequencies f well below f_w = w / (2 pi).
"""

from math import sqrt
from typing import Any

from rotorsim.block import Param

BANDWIDTH: Any = Param(1e5, unit="rad/s", above=0.0, doc="frequency w of the observer of the acceleration")


def acceleration(velocity: Any, estimate: Any, trend: Any, bandwidth: Any) -> tuple[Any, dict[str, Any]]:
    """Return the acceleration and the rates of the states `estimate` (v) and `trend` (a)."""
    behind = velocity - estimate
    rate = trend + sqrt(2) * bandwidth * behind
    return rate, {"estimate": rate, "trend": bandwidth**2 * behind}
