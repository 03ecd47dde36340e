"""A shaft of beam elements with rigid discs, in two planes: what rotors of nodes and of drawings share.

M q'' + (C + W G J) q' + K q = f,   C = a0 M_shaft + a1 K,   G J (q_1, q_2) = (G q_2, -G q_1)

q: displacement u and slope of the ends of all beams, end by end, in the planes of x and y. Whatever is on the shaft,
at an end or within a beam, is on it by two rows: its displacement and its slope as sums of coefficients times q. A
force there enters by the same coefficients, so that the flexibility between any two places is symmetric.
Source: Friswell, Penny, Garvey & Lees, Dynamics of Rotating Machines (2010), ch. 5.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from math import pi
from typing import Any

from rotorsim.blocks.common import beam
from rotorsim.blocks.common.beam import Banded, solve_factored

from rotorsim.block import Equations, matrix

Row = list[tuple[int, Any]]  # number of a free degree of freedom, coefficient
SIZES = ("outer_diameter", "inner_diameter", "young_modulus", "density", "poisson_ratio")  # of a Beam, as parameters


@dataclass(frozen=True)
class Beam:
    """One beam of the chain: sizes [m], material; numbers or symbols.

    outer_end, inner_end: diameters at its second end, of a cone; None: a cylinder.
    """

    length: Any
    outer: Any
    inner: Any
    young_modulus: Any
    density: Any
    poisson_ratio: Any
    outer_end: Any = None
    inner_end: Any = None

    def diameters(self, fraction: float) -> tuple[Any, Any]:
        """Return outer and inner diameter [m] at a fraction of the length."""
        if self.outer_end is None:
            return self.outer, self.inner
        return (
            self.outer + fraction * (self.outer_end - self.outer),
            self.inner + fraction * (self.inner_end - self.inner),
        )

    def section(self, fraction: float) -> tuple[Any, Any]:
        """Return cross-section [m^2] and second moment of area [m^4] at a fraction of the length."""
        outer, inner = self.diameters(fraction)
        return pi / 4 * (outer**2 - inner**2), pi / 64 * (outer**4 - inner**4)

    @cached_property
    def area(self) -> Any:
        """Cross-section in the middle [m^2]."""
        return self.section(0.5)[0]

    @cached_property
    def second_moment(self) -> Any:
        """Second moment of area in the middle [m^4]."""
        return self.section(0.5)[1]

    def tables(self, phi: Any) -> tuple[beam.Table, beam.Table, beam.Table]:
        """Return the matrices of stiffness, of translation and of rotary inertia, one plane."""
        if self.outer_end is not None:
            middle = self.area, self.second_moment
            return beam.conical(self.young_modulus, self.density, self.length, phi, middle, self.section)
        return (
            beam.stiffness(self.young_modulus * self.second_moment, self.length, phi),
            beam.translation_mass(self.density * self.area * self.length, self.length, phi),
            beam.rotary_mass(self.density * self.second_moment, self.length, phi),
        )

    @cached_property
    def phi(self) -> Any:
        """Shear parameter 12 E I / (kappa G A l^2)."""
        shear = self.young_modulus / (2 * (1 + self.poisson_ratio))
        outer, inner = self.diameters(0.5)
        kappa = beam.shear_coefficient(self.poisson_ratio, inner, outer)
        return 12 * self.young_modulus * self.second_moment / (kappa * shear * self.area * self.length**2)


def piece(one: Beam, begin: float, end: float, length: Any) -> Beam:
    """Return the piece of a beam between two fractions of its length, which is so long [m]; of a cone a cone."""
    if one.outer_end is None:
        return replace(one, length=length)
    (outer, inner), (outer_end, inner_end) = one.diameters(begin), one.diameters(end)
    return replace(one, length=length, outer=outer, inner=inner, outer_end=outer_end, inner_end=inner_end)


def divided(one: Beam, parts: int) -> list[Beam]:
    """Return a beam whose length is that of a part, as these parts: a cone tapers over all of them."""
    if one.outer_end is None:
        return [one] * parts
    return [piece(one, k / parts, (k + 1) / parts, one.length) for k in range(parts)]


@dataclass(frozen=True)
class Place:
    """A place on the shaft: the rows of its displacement and of its slope (empty: held)."""

    across: Row
    slope: Row


@dataclass(frozen=True)
class _Disc:
    place: Place
    damping: Any


class Shaft:
    """A chain of beams, what is on it, and how it moves.

    theory: "euler_bernoulli" or "timoshenko". rotary_inertia, gyroscopic: of the shaft itself. pinned: ends (from 0)
    whose displacement is held at zero.
    """

    def __init__(
        self, beams: Sequence[Beam], *, theory: str, rotary_inertia: bool, gyroscopic: bool, pinned: Iterable[int] = ()
    ) -> None:
        at = set(pinned)
        held = [end in at and not is_slope for end in range(len(beams) + 1) for is_slope in (False, True)]
        self.free = [None if h else n - 1 for h, n in zip(held, accumulate(not h for h in held), strict=True)]
        size = len(held) - sum(held)
        self.mass, self.gyroscopic, self.stiffness, self.disc = (Banded(size) for _ in range(4))
        self._lengths = [one.length for one in beams]
        self._phi: list[Any] = [one.phi if theory == "timoshenko" else 0.0 for one in beams]
        self._weights: list[Any] = [0.0] * size
        self._discs: list[_Disc] = []
        self._timoshenko, self._rotary_inertia, self._gyroscopic = theory == "timoshenko", rotary_inertia, gyroscopic
        for e, one in enumerate(beams):
            self.add_beam(e, one)

    def add_beam(self, e: int, one: Beam, share: Any = 1.0) -> None:
        """Put a beam at place e (from 0) of the chain; a second one there is a sleeve, with the same ends.

        share: of its stiffness that counts; its mass and inertias count in full.
        """
        phi = one.phi if self._timoshenko else 0.0
        bending, translation, rotary = one.tables(phi)
        parts = [(self.stiffness, bending, share), (self.mass, translation, 1.0)]
        if self._rotary_inertia:
            parts.append((self.mass, rotary, 1.0))
        if self._gyroscopic:
            parts.append((self.gyroscopic, rotary, 2.0))
        numbers = self.free[2 * e : 2 * e + 4]
        for target, table, factor in parts:
            for i, row in zip(numbers, table, strict=True):
                for j, value in zip(numbers, row, strict=True):
                    if i is not None and j is not None:
                        target.add(i, j, factor * value)
        for i, row in zip(numbers, translation, strict=True):
            if i is not None:
                self._weights[i] = self._weights[i] + row[0] + row[2]  # M times a displacement of 1

    def at(self, end: int) -> Place:
        """Return the place of the end (from 0) of a beam."""
        across, slope = ([] if n is None else [(n, 1.0)] for n in self.free[2 * end : 2 * end + 2])
        return Place(across, slope)

    def within(self, e: int, distance: Any) -> Place:
        """Return the place at a distance [m] behind the begin of beam e (from 0), by the shapes of the element."""
        numbers = self.free[2 * e : 2 * e + 4]
        both = beam.shapes(self._lengths[e], self._phi[e], distance)
        across, slope = (
            [(n, value) for n, value in zip(numbers, values, strict=True) if n is not None] for values in both
        )
        return Place(across, slope)

    def add_disc(self, place: Place, mass: Any, polar: Any, diametral: Any, damping: Any) -> None:
        """Put a rigid disc on the shaft; damping: viscous, on its displacement. polar None: a point without inertias.

        It does not stiffen the shaft.
        """
        self._discs.append(_Disc(place, damping))
        for row, inertia in ((place.across, mass), (place.slope, diametral)):
            if polar is None and row is place.slope:
                continue
            for i, a in row:
                for j, b in row:
                    self.disc.add(i, j, a * b * inertia)
        for i, a in place.slope if polar is not None else []:
            for j, b in place.slope:
                self.gyroscopic.add(i, j, a * b * polar)
        for i, a in place.across:
            self._weights[i] = self._weights[i] + a * mass

    def loads(self, places: Sequence[Place], forces: Sequence[Any], moments: Sequence[Any]) -> list[Any]:
        """Return the forces of one plane on the free degrees of freedom."""
        found: list[Any] = [0.0] * self.mass.size
        for place, *pair in zip(places, forces, moments, strict=True):
            for row, value in zip((place.across, place.slope), pair, strict=True):
                for n, coefficient in row:
                    found[n] = found[n] + coefficient * value
        return found

    def weights(self, acceleration: Any) -> list[Any]:
        """Return the consistent load of an acceleration [m/s^2] of all mass, M 1 g, one plane."""
        return [weight * acceleration for weight in self._weights]

    def motion(self, places: Sequence[Place], p: Any, u: Any, x: Any, gravity: Any = None) -> Equations:
        """Return the equations of a rotor with forces, moments and outputs at places; gravity [m/s^2], in -y."""
        q = [x.position[:, plane].elements() for plane in (0, 1)]
        v = [x.velocity[:, plane].elements() for plane in (0, 1)]
        loads = [self.loads(places, u.force[:, plane].elements(), u.moment[:, plane].elements()) for plane in (0, 1)]
        if gravity is not None:
            loads[1] = [load - weight for load, weight in zip(loads[1], self.weights(gravity), strict=True)]
        rates = self.accelerations(q, v, u.speed, loads, p.mass_damping, p.stiffness_damping)
        return Equations(
            outputs=outputs_of(places, q, v),
            derivatives={"position": x.velocity, "velocity": matrix(list(zip(*rates, strict=True)))},
        )

    def accelerations(
        self, q: list[list[Any]], v: list[list[Any]], speed: Any, loads: list[list[Any]], a0: Any, a1: Any
    ) -> list[list[Any]]:
        """Return q'' of both planes; a0, a1: Rayleigh damping of the shaft. M is factored once (banded L D L^T)."""
        total = self.mass.plus(self.disc)
        lower, inverse_d = total.factor()
        spin = [[speed * g for g in self.gyroscopic.times(v[1])], [-speed * g for g in self.gyroscopic.times(v[0])]]
        found = []
        for plane in (0, 1):
            # M^-1 a0 M_shaft v = a0 v - M^-1 a0 M_disc v, so that damping costs next to nothing
            bent = self.stiffness.times([a + a1 * b for a, b in zip(q[plane], v[plane], strict=True)])
            rest = [f - k - g for f, k, g in zip(loads[plane], bent, spin[plane], strict=True)]
            rest = [r + d for r, d in zip(rest, self.disc.scaled(a0).times(v[plane]), strict=True)]
            for disc in self._discs:
                drag = disc.damping * seen(disc.place.across, v[plane])
                for n, coefficient in disc.place.across:
                    rest[n] = rest[n] - coefficient * drag
            solved = solve_factored(lower, inverse_d, rest)
            found.append([a - a0 * b for a, b in zip(solved, v[plane], strict=True)])
        return found


def seen(row: Row, values: Sequence[Any]) -> Any:
    """Return what a row makes of the values of the free degrees of freedom."""
    return sum((coefficient * values[n] for n, coefficient in row), 0.0)


def outputs_of(places: Sequence[Place], q: list[list[Any]], v: list[list[Any]]) -> dict[str, Any]:
    """Return the outputs of a rotor: displacement, tilt and their rates, each (places, 2)."""

    def table(rows: list[Row], values: list[list[Any]]) -> Any:
        return matrix([[seen(row, plane) for plane in values] for row in rows])

    across, slope = [place.across for place in places], [place.slope for place in places]
    return {
        "displacement": table(across, q),
        "tilt": table(slope, q),
        "velocity": table(across, v),
        "tilt_velocity": table(slope, v),
    }
