"""The elements of a rotor of ROSS in SI units, with every mistake told at once, and what is not carried over said."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from rotorsim.errors import Problems, near_miss
from rotorsim.ross.source import RossFile, Table, flag, number, numbers, whole

LATERAL = ("kxx", "kxy", "kyx", "kyy", "cxx", "cxy", "cyx", "cyy")
MASSES = ("mxx", "mxy", "myx", "myy")
AXIAL = ("kzz", "czz", "mzz")
LIKE = {"kyy": "kxx", "cyy": "cxx", "myy": "mxx"}  # of an isotropic bearing only the first is given
SHAFTS = ("ShaftElement", "ShaftElement6DoF")
DISCS = ("DiskElement", "DiskElement6DoF")
POINT_MASSES = ("PointMass", "PointMass6DoF")
PLAIN = ("BearingElement", "BearingElement6DoF", "SealElement", "BallBearingElement", "RollerBearingElement")
UNSUPPORTED = {
    "CouplingElement": "a coupling joins two shafts: save each shaft as a rotor of its own",
    "GearElement": "gears join several rotors: save each as a rotor of its own",
    "GearElementTVMS": "gears join several rotors: save each as a rotor of its own",
}
OFF_TABLE = 1e-6  # of the largest coefficient: beyond it the curve of ROSS is said to leave the table
HIGHEST_POISSON = 0.5


@dataclass(frozen=True)
class ShaftElement:
    """One element: node n at its left end; diameters at both ends [m]; material; Rayleigh damping."""

    n: int
    length: float
    outer: tuple[float, float]
    inner: tuple[float, float]
    modulus: float
    density: float
    poisson: float
    flags: Mapping[str, bool]
    damping: tuple[float, float]
    table: Table

    @property
    def is_conical(self) -> bool:
        """Whether its diameters change."""
        return self.outer[0] != self.outer[1] or self.inner[0] != self.inner[1]

    @property
    def bending_stiffness(self) -> float:
        """E I in the middle [N m^2]."""
        outer, inner = (sum(ends) / 2 for ends in (self.outer, self.inner))
        return self.modulus * math.pi / 64 * (outer**4 - inner**4)


@dataclass(frozen=True)
class Disc:
    """A disc, or a mass without inertias, at a node."""

    n: int
    mass: float
    polar: float
    diametral: float
    table: Table


@dataclass(frozen=True)
class Bearing:
    """A bearing or seal at a node, to ground or to node ``link``; coefficients: a value, or one for each speed."""

    n: int
    link: int | None
    speeds: Sequence[float]
    coefficients: Mapping[str, Sequence[float]]
    mass: float
    table: Table


@dataclass(frozen=True)
class PointMass:
    """A mass [x, y] at a node."""

    n: int
    mass: tuple[float, float]
    table: Table


@dataclass
class Elements:
    """All elements of a rotor."""

    shaft: list[ShaftElement] = field(default_factory=list)
    discs: list[Disc] = field(default_factory=list)
    bearings: list[Bearing] = field(default_factory=list)
    points: list[PointMass] = field(default_factory=list)


def elements_of(file: RossFile, problems: Problems) -> Elements:
    """Return the elements of a file; mistakes and warnings go to ``problems``."""
    found = Elements()
    for table in file.tables:
        if table.kind in SHAFTS:
            found.shaft.append(_shaft(table, problems))
        elif table.kind in DISCS:
            found.discs.append(_disc(table, problems))
        elif table.kind in POINT_MASSES:
            found.points.append(_point(table, problems))
        elif table.kind in UNSUPPORTED:
            problems.error(f"class '{table.kind}' is not supported", table.name, table.place, UNSUPPORTED[table.kind])
        elif table.kind in PLAIN or {"n", "kxx", "cxx"} <= table.values.keys():
            found.bearings += _bearing(table, problems)
        else:
            what = f"class '{table.kind}' is not known, and has no coefficients kxx and cxx"
            problems.error(
                what, table.name, table.place, near_miss(table.kind, (*SHAFTS, *DISCS, *PLAIN, *POINT_MASSES))
            )
    _say_lost(file, problems)
    return found


def _shaft(table: Table, problems: Problems) -> ShaftElement:
    ends = {}
    for key, limits in (("od", {"above": 0.0}), ("id", {"low": 0.0})):
        left = number(table, f"{key}l", problems, **limits)
        ends[key] = left, number(table, f"{key}r", problems, left, **limits)
    for side, outer, inner in zip("lr", ends["od"], ends["id"], strict=True):
        if inner >= outer:
            what = f"id{side} is {inner:g}, od{side} {outer:g}"
            problems.error(what, table.name, table.locate(f"id{side}"), "the inner diameter must be the smaller one")
    method = table.values.get("shear_method_calc", "cowper")
    if method not in ("cowper", "hutchinson"):
        what = f"shear_method_calc must be cowper or hutchinson, not {str(method)[:40]!r}"
        problems.error(what, table.name, table.locate("shear_method_calc"), "cowper is the default of ROSS")
    modulus, density, poisson = _material(table, problems)
    return ShaftElement(
        n=whole(table, "n", problems),
        length=number(table, "L", problems, above=0.0),
        outer=ends["od"],
        inner=ends["id"],
        modulus=modulus,
        density=density,
        poisson=poisson,
        flags={name: flag(table, name, problems, True) for name in ("shear_effects", "rotary_inertia", "gyroscopic")},
        damping=(number(table, "alpha", problems, 0.0, low=0.0), number(table, "beta", problems, 0.0, low=0.0)),
        table=table,
    )


def _material(table: Table, problems: Problems) -> tuple[float, float, float]:
    """Return modulus, density and Poisson's ratio of the material of a shaft element."""
    given = table.values.get("material")
    if not isinstance(given, Mapping):
        what = "material is missing" if given is None else "material must be a table"
        problems.error(what, table.name, table.locate("material"), "a table with rho, E and G_s is expected")
        return math.nan, math.nan, math.nan
    inner = Table(f"{table.name}.material", "Material", "", given, lambda key: table.locate("material"))
    density = number(inner, "rho", problems, low=0.0)
    modulus = number(inner, "E", problems, above=0.0)
    if "G_s" in given or "Poisson" not in given:
        shear = number(inner, "G_s", problems, above=0.0)
        poisson = modulus / (2 * shear) - 1
    else:
        poisson = number(inner, "Poisson", problems, above=-1.0)
    if poisson > HIGHEST_POISSON:
        what = f"E and G_s give a Poisson's ratio of {poisson:g}, more than {HIGHEST_POISSON:g}"
        problems.error(what, inner.name, inner.place, "G_s must be at least E / 3")
    return modulus, density, poisson


def _disc(table: Table, problems: Problems) -> Disc:
    mass, polar, diametral = (number(table, key, problems, low=0.0) for key in ("m", "Ip", "Id"))
    return Disc(whole(table, "n", problems), mass, polar, diametral, table)


def _point(table: Table, problems: Problems) -> PointMass:
    keys = ("mx", "my") if any(table.values.get(key) is not None for key in ("mx", "my", "mz")) else ("m", "m")
    masses = [number(table, key, problems, low=0.0) for key in dict.fromkeys(keys)]
    return PointMass(whole(table, "n", problems), (masses[0], masses[-1]), table)


def _bearing(table: Table, problems: Problems) -> list[Bearing]:
    """Return a bearing, or nothing where it acts along the axis only."""
    before = len(problems)
    speeds = numbers(table, "frequency", problems, low=0.0) or [0.0]
    for early, late in pairwise(speeds):
        if late <= early:
            what = f"frequency must increase, but {late:g} rad/s follows {early:g} rad/s"
            problems.error(what, table.name, table.locate("frequency"), "sort the table by speed, each speed once")
            break
    given = {key: numbers(table, key, problems) for key in (*LATERAL, *MASSES)}
    for key in ("kxx", "cxx"):
        if given[key] is None and table.values.get(key) is None:
            problems.error(f"{key} is missing", table.name, table.place, "a number or a list of numbers is expected")
    coefficients = {key: values or given[LIKE.get(key, key)] or [0.0] for key, values in given.items()}
    for key, values in coefficients.items():
        if given[key] is not None and len(values) not in (1, len(speeds)):
            what = f"{key} has {len(values)} values, frequency {len(speeds)}"
            problems.error(what, table.name, table.locate(key), "one value for each frequency is expected")
    link = None if table.values.get("n_link") is None else whole(table, "n_link", problems)
    n = whole(table, "n", problems)
    if len(problems) > before:
        return []
    mass = _mass(table, {key: coefficients[key] for key in MASSES}, link, problems)
    lateral = {key: values if len(set(values)) > 1 else values[:1] for key, values in coefficients.items()}
    lateral = {key: lateral[key] for key in LATERAL}
    if mass == 0.0 and not any(map(any, lateral.values())):
        problems.warning("acts along the axis only: left out", table.name, table.place)
        return []
    if all(len(values) == 1 for values in lateral.values()):
        speeds = [0.0]
    _say_smoothed(table, speeds, lateral, problems)
    return [Bearing(n, link, speeds, lateral, mass, table)]


def _mass(table: Table, masses: Mapping[str, Sequence[float]], link: int | None, problems: Problems) -> float:
    """Return the one mass of a bearing; what is no point of mass on the shaft is refused."""
    mass = masses["mxx"][0]
    cross = any(masses["mxy"]) or any(masses["myx"])
    if not cross and {*masses["mxx"], *masses["myy"]} == {mass} and (link is None or mass == 0.0) and mass >= 0.0:
        return mass
    hint = "only one mass, the same in x and y and at all speeds, to ground, can be; set them to 0 to leave them out"
    problems.error("mxx, mxy, myx, myy cannot be carried over", table.name, table.locate("mxx"), hint)
    return 0.0


# -- what is said ------------------------------------------------------------------------------------------------------


def _say_smoothed(
    table: Table, speeds: Sequence[float], coefficients: Mapping[str, Sequence[float]], problems: Problems
) -> None:
    """Warn where ROSS does not go through the points of a table.

    ROSS fits ``UnivariateSpline`` with its default smoothing: the sum of squares of the misses may be as large as the
    number of points, in SI units, which is little of a stiffness and much of a small damping.
    """
    if len(speeds) < 4:  # ROSS interpolates: a line or a parabola
        return
    import warnings

    import numpy as np
    from scipy.interpolate import CubicSpline, UnivariateSpline

    x = np.array(speeds)
    at = np.unique(np.concatenate([x, (x[1:] + x[:-1]) / 2]))
    worst = (0.0, "", 0.0, 0.0, 0.0)
    for key, values in coefficients.items():
        if len(values) > 1:
            y = np.array(values)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                theirs, here = UnivariateSpline(x, y)(at), CubicSpline(x, y)(at)
            miss = np.abs(theirs - here) / np.abs(y).max()
            k = int(miss.argmax())
            worst = (miss[k], key, at[k], theirs[k], here[k]) if miss[k] > worst[0] else worst
    share, key, speed, *both = worst
    if share > OFF_TABLE:
        what = "ROSS smooths this table: its {} at {:.4g} rad/s is {:.6g}, here {:.6g}".format(key, speed, *both)
        problems.warning(what, table.name, table.locate(key), "here the curve goes through every point of the table")


def _say_lost(file: RossFile, problems: Problems) -> None:
    """Warn of what no lateral model has, once for each kind."""
    kinds = {table.kind for table in file.tables}
    axial = any(key in table.values for table in file.tables for key in AXIAL)
    if file.version or axial or any(kind.endswith("6DoF") for kind in kinds):
        problems.warning("axial and torsional motion are not carried over", place=file.place)
    for key, what in (("axial_force", "axial_force"), ("torque", "torque")):
        _say(
            file,
            [table for table in file.tables if _acts(table, key)],
            f"{what} is not carried over, which changes the modes",
            key,
            problems,
        )
    for table in file.tables:
        given = [key for key in AXIAL if _acts(table, key)]
        if given:
            problems.warning(
                f"{', '.join(given)} {'is' if len(given) == 1 else 'are'} not carried over",
                table.name,
                table.locate(given[0]),
            )
    hutchinson = [table for table in file.tables if table.values.get("shear_method_calc") == "hutchinson"]
    what = "shear coefficient 'hutchinson' is not carried over: Cowper's is used"
    _say(file, hutchinson, what, "shear_method_calc", problems)
    for table in file.tables:
        if table.kind == "MagneticBearingElement":
            what = "is read as stiffness and damping over the speed: its controller is not carried over"
            problems.warning(what, table.name, table.place, "put blocks amb and pid in its place")
        elif table.kind not in (*SHAFTS, *DISCS, *POINT_MASSES, *PLAIN, *UNSUPPORTED) and "kxx" in table.values:
            problems.warning(f"class '{table.kind}' is read by its coefficients alone", table.name, table.place)
    lost = sorted(set(file.parameters) - {"min_w", "max_w", "rated_w"})
    if lost:
        problems.warning(f"not carried over: {', '.join(lost)}", "parameters", file.place)


def _acts(table: Table, key: str) -> bool:
    value: Any = table.values.get(key)
    return any(value) if isinstance(value, list) else bool(value)


def _say(file: RossFile, tables: Sequence[Table], what: str, key: str, problems: Problems) -> None:
    """Warn once of what many elements have."""
    if tables:
        more = f" (and {len(tables) - 1} more)" if len(tables) > 1 else ""
        problems.warning(what, f"{tables[0].name}{more}", tables[0].locate(key))
