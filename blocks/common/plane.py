"""Vectors [x, y] read as complex numbers z = x + i y, and lengths that have a derivative at zero."""

from typing import Any

from rotorsim.block import cos, maximum, minimum, sin, sqrt, sum_of, vec

ANGLES = (0.0, 2.1, -2.1)  # starts of an unknown angle [rad]: one of them is within 60 degrees of the truth
NEARLY_ZERO = 1e-30  # added to a square: far below what is resolved, but its root can be differentiated


def unit(angle: Any) -> Any:
    """Return e^(i angle)."""
    return vec(cos(angle), sin(angle))


def turned(z: Any, angle: Any) -> Any:
    """Return z e^(i angle)."""
    c, s = cos(angle), sin(angle)
    return vec(c * z[0] - s * z[1], s * z[0] + c * z[1])


def conjugate(z: Any) -> Any:
    """Return x - i y."""
    return vec(z[0], -z[1])


def times_i(z: Any) -> Any:
    """Return i z, z turned by a quarter forward."""
    return vec(-z[1], z[0])


def along(z: Any, direction: Any) -> Any:
    """Return the component of z in a direction of length 1, Re(z conj(direction))."""
    return z[0] * direction[0] + z[1] * direction[1]


def length(q: Any) -> Any:
    """Return |q| of any number of entries."""
    return sqrt(sum_of(q**2) + NEARLY_ZERO)


def within(value: Any, limit: Any) -> Any:
    """Return a value limited to +- limit, entry by entry."""
    return minimum(maximum(value, -limit), limit)
