"""Meshes of shafts from a drawing: ends of beams at sections, sleeves, discs and stations, and places between."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from math import ceil

ROUNDING = 1e-9  # of the length of the shaft: sums of section lengths in one place
SHORTEST, LONGEST = 1 / 200, 1 / 12  # of the length of the shaft, unless the drawing says so


@dataclass(frozen=True)
class Mesh:
    """Ends of beams along the axis [m], and the section (from 0) of every beam."""

    ends: tuple[float, ...]
    sections: tuple[int, ...]

    def place(self, z: float) -> tuple[int, float]:
        """Return an end (from 0) and 0, or a beam and the distance [m] behind its begin."""
        near = min(range(len(self.ends)), key=lambda k: abs(self.ends[k] - z))
        if abs(self.ends[near] - z) <= ROUNDING * self.ends[-1]:
            return near, 0.0
        beam = bisect_right(self.ends, z) - 1
        return beam, z - self.ends[beam]


def meshed(
    lengths: Sequence[float],
    places: Iterable[float],
    longest: float,
    shortest: float,
    subdivisions: int,
    sleeves: Iterable[float] = (),
) -> Mesh:
    """Return the mesh of a shaft of sections with these lengths [m].

    sleeves: ends of sleeves [m]. Ends of beams are those of sections and sleeves, and every place, in order, that is no
    closer than ``shortest`` to one that is there already; beams longer than ``longest`` are divided evenly (0: a share
    of the shaft), and every beam once more into ``subdivisions``. Places off the shaft are left out.
    """
    borders = [0.0, *accumulate(lengths)]
    total = borders[-1]
    shortest, longest = shortest or SHORTEST * total, longest or LONGEST * total
    points = list(borders)
    for z in sleeves:
        if 0.0 < z < total and all(abs(z - point) > ROUNDING * total for point in points):
            points.append(z)
    for z in places:
        if 0.0 <= z <= total and all(abs(z - point) >= shortest * (1 - ROUNDING) for point in points):
            points.append(z)
    points.sort()
    ends, sections = [0.0], []
    for a, b in pairwise(points):
        section = min(bisect_right(borders, (a + b) / 2) - 1, len(lengths) - 1)
        parts = max(ceil((b - a) / longest * (1 - ROUNDING)), 1) * subdivisions
        ends += [a + (b - a) * k / parts for k in range(1, parts)] + [b]
        sections += [section] * parts
    return Mesh(tuple(ends), tuple(sections))
