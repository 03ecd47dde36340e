"""What a rotor looks like from the side: sections, discs and the places where something can be wired."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from math import pi, sqrt
from typing import Any


@dataclass(frozen=True)
class Section:
    """A piece of shaft between two axial positions [m]; diameters [m]; density [kg/m^3].

    outer_end, inner_end: diameters at its end, of a cone; None: a cylinder.
    """

    begin: float
    end: float
    outer: float
    inner: float
    density: float
    outer_end: float | None = None
    inner_end: float | None = None

    @property
    def diameters(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Outer diameters at both ends, and inner ones [m]."""
        ends = (self.outer_end, self.outer), (self.inner_end, self.inner)
        outer, inner = (begin if end is None else end for end, begin in ends)
        return (self.outer, outer), (self.inner, inner)

    def outer_at(self, z: float) -> float:
        """Return the outer diameter [m] at an axial position."""
        (begin, end), _ = self.diameters
        return begin + (end - begin) * (z - self.begin) / (self.end - self.begin)

    @property
    def mass(self) -> float:
        """Mass [kg]; of a truncated cone pi l (D^2 + D d + d^2) / 12 times the density."""
        solid = [(a * a + a * b + b * b) / 12 for a, b in self.diameters]
        return pi * (solid[0] - solid[1]) * (self.end - self.begin) * self.density

    @property
    def centre(self) -> float:
        """Axial position of the centre of gravity [m]."""
        first = [(a * a + 2 * a * b + 3 * b * b) / 48 for a, b in self.diameters]  # moment / (pi rho l^2)
        length = self.end - self.begin
        return self.begin + pi * (first[0] - first[1]) * length**2 * self.density / self.mass


@dataclass(frozen=True)
class DrawnDisc:
    """A disc at an axial position [m]; mass [kg]; diameters and width [m]; drawn: they are from the drawing."""

    position: float
    mass: float
    outer: float
    inner: float
    width: float
    drawn: bool


@dataclass(frozen=True)
class Drawing:
    """A rotor from the side; stations: axial positions [m] of the rows of its ports; names: of them, or none.

    station: what a row of its ports is called. pinned: axial positions [m] that are held. sleeves: on top of sections.
    """

    sections: tuple[Section, ...]
    discs: tuple[DrawnDisc, ...]
    stations: tuple[float, ...]
    names: tuple[str, ...]
    station: str = "station"
    pinned: tuple[float, ...] = ()
    sleeves: tuple[Section, ...] = ()

    @property
    def length(self) -> float:
        """Length of the shaft [m]."""
        return self.sections[-1].end

    @property
    def mass(self) -> float:
        """Mass of all [kg]."""
        return sum(part.mass for part in (*self.sections, *self.sleeves, *self.discs))

    @property
    def centre_of_gravity(self) -> float:
        """Axial position of the centre of gravity [m]."""
        moments = [one.mass * one.centre for one in (*self.sections, *self.sleeves) if one.mass]
        return (sum(moments) + sum(disc.mass * disc.position for disc in self.discs)) / self.mass


def equivalent_disc(position: float, mass: float, polar: float, diametral: float) -> DrawnDisc:
    """Return the solid cylinder of the same mass and inertias, as far as there is one (else of no width or size).

    I_p = m R^2 / 2,   I_d = m (3 R^2 + h^2) / 12
    """
    radius = sqrt(2 * polar / mass) if mass > 0 else 0.0
    width = sqrt(max(12 * diametral / mass - 3 * radius**2, 0.0)) if radius > 0 else 0.0
    return DrawnDisc(position, mass, 2 * radius, 0.0, width, drawn=False)


def cylinder(mass_density: float, outer: float, inner: float, width: float) -> tuple[float, float, float]:
    """Return mass [kg], I_p and I_d [kg m^2] about the centre of a hollow cylinder; arithmetic on numbers or symbols.

    m = rho pi (D^2 - d^2) b / 4,   I_p = m (D^2 + d^2) / 8,   I_d = I_p / 2 + m b^2 / 12
    """
    mass = mass_density * pi / 4 * (outer**2 - inner**2) * width
    polar = mass * (outer**2 + inner**2) / 8
    return mass, polar, polar / 2 + mass * width**2 / 12


def sections_of(option: Any, values: Mapping[str, Any]) -> list[Section]:
    """Return the sections of a rotor_drawing; values: parameters as SI arrays. None where these do not fit."""
    count, borders = len(option.section_lengths), [0.0, *accumulate(option.section_lengths)]
    straight = [full(values.get(key, 0.0), count) for key in ("outer_diameter", "inner_diameter", "density")]
    cones = option.conical_sections
    ends = [full(values.get(f"end_{side}_diameter", 0.0), len(cones)) for side in ("outer", "inner")]
    if (
        {len(one) for one in straight} != {count}
        or {len(one) for one in ends} != {len(cones)}
        or max((0, *cones)) > count
    ):
        return []
    sections = [Section(*both, *row) for both, *row in zip(pairwise(borders), *straight, strict=True)]
    return tapered(sections, cones, zip(*ends, strict=True))


def tapered(pieces: Sequence[Any], numbers: Sequence[int], ends: Iterable[tuple[Any, Any]]) -> list[Any]:
    """Return sections or beams, those of some numbers (from 1) with outer and inner diameters at their other ends."""
    found = list(pieces)
    for k, (outer, inner) in zip(numbers, ends, strict=True):
        found[k - 1] = replace(found[k - 1], outer_end=outer, inner_end=inner)
    return found


def sleeve_ends(option: Any) -> list[tuple[float, float]]:
    """Return where the sleeves of a rotor_drawing begin and end [m]."""
    return [(z, z + length) for z, length in zip(option.sleeve_begins, option.sleeve_lengths, strict=False)]


def full(values: Sequence[float] | float, count: int) -> list[float]:
    """Return one value for each of ``count``, from a list of them or from one for all."""
    found = [float(value) for value in getattr(values, "flat", [values])]
    return found * count if len(found) == 1 else found
