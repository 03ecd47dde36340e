"""Piecewise cubics through the points of a table, of numbers or CasADi symbols.

Source: C. de Boor, A Practical Guide to Splines (1978), ch. IV (not-a-knot end conditions).
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from rotorsim.block import maximum, minimum

Cubic = tuple[Any, Any, Any]  # coefficients of u, u^2, u^3


def curvatures(steps: Sequence[Any], slopes: Sequence[Any]) -> list[Any]:
    """Return the second derivatives at the points of the not-a-knot spline.

    It is a parabola through three points, a line through two. steps: distances between points; slopes: of the chords
    between them.
    """
    count = len(steps) + 1
    if count < 3:
        return [0.0] * count
    if count == 3:
        return [2 * (slopes[1] - slopes[0]) / (steps[0] + steps[1])] * 3
    inner = range(1, count - 1)
    below = [steps[i - 1] for i in inner]
    diagonal = [2 * (steps[i - 1] + steps[i]) for i in inner]
    above = [steps[i] for i in inner]
    right = [6 * (slopes[i] - slopes[i - 1]) for i in inner]
    # the third derivative is continuous at the first and the last inner point: it gives the values at the ends
    first, last = steps[0] / steps[1], steps[-1] / steps[-2]
    diagonal[0] = diagonal[0] + steps[0] * (1 + first)
    above[0] = above[0] - steps[0] * first
    diagonal[-1] = diagonal[-1] + steps[-1] * (1 + last)
    below[-1] = below[-1] - steps[-1] * last
    for k in range(1, len(diagonal)):
        factor = below[k] / diagonal[k - 1]
        diagonal[k] = diagonal[k] - factor * above[k - 1]
        right[k] = right[k] - factor * right[k - 1]
    found = [right[-1] / diagonal[-1]]
    for k in range(len(diagonal) - 2, -1, -1):
        found.insert(0, (right[k] - above[k] * found[0]) / diagonal[k])
    ends = (1 + first) * found[0] - first * found[1], (1 + last) * found[-1] - last * found[-2]
    return [ends[0], *found, ends[1]]


def cubics(points: Sequence[Any], values: Sequence[Any], *, linear: bool = False) -> list[Cubic]:
    """Return the cubic of every segment, in the distance from its begin, without its constant; linear: chords."""
    steps = [b - a for a, b in pairwise(points)]
    slopes = [(b - a) / step for (a, b), step in zip(pairwise(values), steps, strict=True)]
    bent = [0.0] * len(points) if linear else curvatures(steps, slopes)
    return [
        (slope - step * (2 * a + b) / 6, a / 2, (b - a) / (6 * step))
        for step, slope, (a, b) in zip(steps, slopes, pairwise(bent), strict=True)
    ]


def ways(points: Sequence[Any], at: Any) -> list[Any]:
    """Return how far ``at`` is into every segment: 0 before it, its length behind it, so that end values are held."""
    return [minimum(maximum(at - a, 0.0), b - a) for a, b in pairwise(points)]


def value(first: Any, pieces: Sequence[Cubic], into: Sequence[Any]) -> Any:
    """Return the value of the curve that begins with ``first``; into: from `ways`."""
    return first + sum((u * (b + u * (c + u * d)) for (b, c, d), u in zip(pieces, into, strict=True)), 0.0)
