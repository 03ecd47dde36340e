"""What is wrong with the drawing of a rotor: each mistake where it is written, and how to cure it."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from rotorsim.blocks.common.drawing import full, sections_of, sleeve_ends
from rotorsim.blocks.common.mesh import ROUNDING

Given = Mapping[str, np.ndarray]
Mistake = tuple[str, tuple[int, ...], str, str]  # option or parameter, indices in its list, what is wrong, hint

MOST_BEAMS = 500  # that a drawing is meshed with
FITS = 0.02  # of a diameter, by which a bore may be narrower than the shaft
LOOSE = 0.2  # of a diameter, by which a bore may be wider: a hub that is not drawn, a diameter that is varied
SOFTEST = 1e8  # N/m^2, of what shafts are made of: a tenth of polymers; GPa left out make steel 210
LIGHTEST, HEAVIEST = 100.0, 3e4  # kg/m^3, of solids: less than balsa, more than osmium; steel in g/cm^3 is 7.85
MASSLESS = 0.1  # kg/m^3, and less: a shaft whose mass is left out on purpose
_PLACED = {"stations": "station", "disc_positions": "disc", "drawn_disc_positions": "disc", "sleeve_begins": "sleeve"}
_NEEDED = (  # parameter, list of what needs it, what that is, hint
    ("disc_mass", "disc_positions", "disc", "a disc given by mass and inertias needs disc_mass"),
    ("drawn_disc_outer_diameter", "drawn_disc_positions", "disc", "a disc by dimensions needs its outer diameter"),
    ("drawn_disc_width", "drawn_disc_positions", "disc", "a disc by dimensions needs its width"),
    ("end_outer_diameter", "conical_sections", "cone", "a cone needs the outer diameter of its right end"),
    ("sleeve_outer_diameter", "sleeve_begins", "sleeve", "a sleeve needs its outer diameter"),
    ("sleeve_stiffness_share", "sleeve_begins", "", "0: its mass only; 1: as stiff as of one piece with the shaft"),
)
_WALLS = (("", "section", "section_lengths"), ("end_", "cone", "conical_sections"))
_WALLS += (("sleeve_", "sleeve", "sleeve_begins"), ("drawn_disc_", "disc", "drawn_disc_positions"))


def mistakes(option: Any, given: Given) -> list[Mistake]:
    """Return the mistakes in the options of a rotor_drawing and in the parameters given to it."""
    found = [*_lists(option), *_places(option), *_cones(option, given)]
    for name, of, what, hint in _NEEDED:
        found += _needed(name, of, what, len(getattr(option, of)), given, hint)
    for prefix, what, of in _WALLS:
        found += _walls(prefix, what, len(getattr(option, of)), given)
    return [*found, *_materials(given), *_bores(option, given), *_overlaps(option, given)]


def _lists(option: Any) -> Iterator[Mistake]:
    for name in ("section_lengths", "stations"):
        if not getattr(option, name):
            yield name, (), "the list is empty", "a rotor has a section, and a station to act on"
    names, stations = len(option.station_names), len(option.stations)
    if names and names != stations:
        what = f"has {names} entries, but there are {stations} stations"
        yield "station_names", (), what, "give one name for each, or none"
    lengths, sleeves = len(option.sleeve_lengths), len(option.sleeve_begins)
    if lengths != sleeves:
        at = "sleeve_lengths" if lengths else "sleeve_begins"
        yield at, (), f"{sleeves} sleeves begin, and {lengths} have a length", "give sleeve_lengths, one for each"
    if option.longest_element and option.shortest_element > option.longest_element:
        yield "shortest_element", (), "is longer than longest_element", "or leave both out"
    total = sum(option.section_lengths)
    if option.longest_element and total / option.longest_element > MOST_BEAMS:
        what = f"makes more than {MOST_BEAMS} beams of {total * 1e3:g} mm"
        yield "longest_element", (), what, "a twelfth of the shaft is the default"


def _places(option: Any) -> Iterator[Mistake]:
    """Yield what is off the shaft."""
    total = sum(option.section_lengths)
    placed = [(name, k, what, z) for name, what in _PLACED.items() for k, z in enumerate(getattr(option, name))]
    placed += [("sleeve_lengths", k, "the end of sleeve", end) for k, (_, end) in enumerate(sleeve_ends(option))]
    for name, k, what, z in placed:
        if total and not -ROUNDING * total <= z <= total * (1 + ROUNDING):
            side = f"{z * 1e3:g} mm is {'left' if z < 0 else 'right'} of the shaft"
            yield name, (k,), f"{what} {k + 1} at {side}", f"it goes from 0 to {total * 1e3:g} mm"


def _cones(option: Any, given: Given) -> Iterator[Mistake]:
    """Yield cones of no section, and those of which it is not said where their bore leads."""
    count, bores = len(option.section_lengths), full(given.get("inner_diameter", 0.0), len(option.section_lengths))
    for k, section in enumerate(option.conical_sections):
        if section > count:
            yield ("conical_sections", (k,), f"section {section}: the shaft has {count}", "from 1 on the left")
        elif section in option.conical_sections[:k]:
            yield "conical_sections", (k,), f"section {section} is named twice", "a section has one right end"
        elif len(bores) == count and bores[section - 1] > 0 and "end_inner_diameter" not in given:
            what = f"section {section} has a bore of {bores[section - 1] * 1e3:g} mm, end_inner_diameter is not given"
            yield "conical_sections", (k,), what, "give the bore at its right end; 0: it ends in a point"


def _needed(name: str, of: str, what: str, count: int, given: Given, hint: str) -> Iterator[Mistake]:
    """Yield a parameter that is not given, or 0 where there is a word for what may not be without."""
    value = given.get(name)
    if count and value is None:
        yield of, (), f"{name} is not given", hint
    elif count and value is not None and what:
        for k, one in enumerate(full(value, count)):
            if one <= 0:
                yield name, (k,) if value.ndim else (), f"of {what} {k + 1} must be greater than 0", hint


def _walls(prefix: str, what: str, count: int, given: Given) -> Iterator[Mistake]:
    name = f"{prefix}inner_diameter"
    if name not in given or f"{prefix}outer_diameter" not in given:
        return
    inner, outer = (full(given[f"{prefix}{side}_diameter"], count) for side in ("inner", "outer"))
    if not len(outer) == len(inner) == count:  # said elsewhere
        return
    for k, (wide, bore) in enumerate(zip(outer, inner, strict=True)):
        if bore >= wide > 0:
            text = f"{bore * 1e3:g} mm of {what} {k + 1} must be smaller than its outer diameter, {wide * 1e3:g} mm"
            yield name, (k,) if given[name].ndim else (), text, "a solid one has 0"


def _materials(given: Given) -> Iterator[Mistake]:
    """Yield a modulus or a density of the shaft, a sleeve or a disc that no solid has: a unit that was left out."""
    for name in ("young_modulus", "sleeve_young_modulus", "density", "sleeve_density", "drawn_disc_density"):
        values = given.get(name)
        for k, one in enumerate(() if values is None else full(values, 1)):
            at = (k,) if values is not None and values.ndim else ()
            if name.endswith("young_modulus") and 0 < one < SOFTEST:
                yield name, at, f"{one:g} N/m^2 is softer than any shaft", 'give its unit: "210 GPa"'
            elif name.endswith("density") and (MASSLESS < one < LIGHTEST or one > HEAVIEST):
                yield name, at, f"{one:g} kg/m^3 is the density of no solid", 'give its unit: "7.85 g/cm^3"'


def _discs(option: Any, given: Given) -> list[tuple[float, float, float, float]]:
    """Return ends, bore and outer diameter of each disc by dimensions; none where it is said elsewhere what lacks."""
    count = len(option.drawn_disc_positions)
    sizes = [full(given.get(f"drawn_disc_{key}", 0.0), count) for key in ("width", "inner_diameter", "outer_diameter")]
    if any(len(size) != count for size in sizes) or not all(sizes[0]) or not all(sizes[2]):
        return []
    rows = zip(option.drawn_disc_positions, *sizes, strict=True)
    return [(z - width / 2, z + width / 2, bore, outer) for z, width, bore, outer in rows]


def _overlaps(option: Any, given: Given) -> Iterator[Mistake]:
    """Yield discs that share material with an earlier one, and those that touch neither shaft nor sleeve."""
    discs, ends = _discs(option, given), sleeve_ends(option)
    sleeves = zip(ends, full(given.get("sleeve_outer_diameter", 0.0), len(ends)), strict=False)
    carried = [(a, b, outer) for (a, b), outer in sleeves]
    carried += [
        (one.begin, one.end, max(map(one.outer_at, (one.begin, one.end)))) for one in sections_of(option, given)
    ]
    carried += [(a, b, outer) for a, b, _, outer in discs]
    for k, (begin, end, bore, outer) in enumerate(discs):
        for j, (first, last, hole, wide) in enumerate(discs[:k]):
            along, across = min(end, last) - max(begin, first), min(outer, wide) - max(bore, hole)
            if along > FITS * min(end - begin, last - first) and across > FITS * min(outer, wide):
                what = f"disc {k + 1} and disc {j + 1} share {along * 1e3:.4g} mm of the axis"
                yield "drawn_disc_positions", (k,), what, "their material would count twice"
        within = max((size for a, b, size in carried if a < end and b > begin and size < outer), default=0.0)
        if bore and bore > within * (1 + LOOSE):
            what = f"the bore of disc {k + 1} is {bore * 1e3:g} mm, and what is in it {within * 1e3:g} mm"
            yield "drawn_disc_positions", (k,), what, "nothing would carry it: give the shaft's diameter, or a sleeve"


def _bores(option: Any, given: Given) -> Iterator[Mistake]:
    """Yield discs and sleeves whose bore is narrower than the shaft within them: its material would count twice."""
    sections, ends = sections_of(option, given), sleeve_ends(option)
    bores = full(given.get("sleeve_inner_diameter", 0.0), len(ends))
    parts = [("drawn_disc_positions", "disc", k, *disc[:3]) for k, disc in enumerate(_discs(option, given))]
    pairs = zip(ends, bores, strict=False)
    parts += [("sleeve_begins", "sleeve", k, a, b, bore) for k, ((a, b), bore) in enumerate(pairs)]
    for name, what, k, a, b, bore in parts:
        inside = [one for one in sections if one.begin < b and one.end > a]
        within = [one.outer_at(min(max(z, one.begin), one.end)) for one in inside for z in (a, b)]
        if within and all(bore < outer * (1 - FITS) for outer in within):
            text = f"the bore of {what} {k + 1} is {bore * 1e3:g} mm, and the shaft in it {min(within) * 1e3:g} mm"
            yield name, (k,), text, "give the shaft's diameter: its material would count twice"
