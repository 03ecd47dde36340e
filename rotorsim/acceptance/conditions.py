"""What a machine is judged at: operating speeds, trip speed, clearances, planes of unbalance, its mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import speed_of
from rotorsim.linear.loop import SENSOR, arriving
from rotorsim.linear.modes.campbell import Campbell, campbell
from rotorsim.linear.modes.collocation import controlled
from rotorsim.linear.modes.unbalance_response import plane_entries, planes_of
from rotorsim.model.compiled import Model

HIGHEST_SHARE = 1.5  # of the trip speed, up to which modes and responses are looked at
CAMPBELL_SPEEDS = 41
TRIP = 1.05  # times the largest operating speed, API 617 for drives of variable speed
ACCEPTED_ZONES = ("A", "B")


@dataclass(frozen=True)
class Conditions:
    """lowest, highest, trip [rad/s]: operating speeds and trip speed.

    probes: two-axis signals. clearance: two-axis signal -> radial clearance [m] there. planes: of unbalance. mass [kg]:
    of the rotor; None: from the diagram. zone: the worst zone of ISO 14839 that is accepted. cross_coupling: plane ->
    anticipated cross-coupled stiffness [N/m].
    """

    lowest: float
    highest: float
    trip: float
    probes: tuple[str, ...] = ()
    clearance: Mapping[str, float] = field(default_factory=dict)
    planes: tuple[str, ...] = ()
    mass: float | None = None
    zone: str = "A"
    cross_coupling: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def conditions_of(
    model: Model | None,
    *,
    operating: tuple[float, float] | None = None,
    trip: float | None = None,
    clearance: float | Mapping[str, float] | None = None,
    planes: Sequence[str] = (),
    mass: float | None = None,
    zone: str = "A",
    cross_coupling: Mapping[str, float] | None = None,
) -> Conditions:
    """Return the conditions; what is not given is that of the diagram, and said.

    Raises RotorsimError for every value that is impossible: speeds that do not rise, planes and probes not there.
    """
    problems: list[Problem] = []
    notes: list[str] = []
    own = None if model is None else speed_of(model, model.p0)
    if operating is None and own:
        operating = (abs(own), abs(own))
        notes.append(f"operating speed: {abs(own) * 30 / np.pi:.6g} rpm, the diagram's own")
    lowest, highest = operating or (np.nan, np.nan)
    if operating is not None and not 0 < lowest <= highest:
        problems.append(Problem("operating speeds must be positive, the lowest first", "operating"))
    if trip is None:
        trip = TRIP * highest
        if np.isfinite(trip):
            notes.append(f"trip speed: {trip * 30 / np.pi:.6g} rpm, {TRIP:g} times the largest operating speed")
    elif trip < highest:
        problems.append(Problem("the trip speed is below the largest operating speed", "trip"))
    if mass is not None and not mass > 0:
        problems.append(Problem("the mass of the rotor must be positive [kg]", "mass"))
    if zone not in ACCEPTED_ZONES:
        problems.append(Problem(f"zone {zone} accepts nothing: A or B", "zone"))
    diagram = None if model is None else model.diagram
    probes = () if diagram is None else probes_of(diagram)
    other = [name for name in probes if model is not None and not is_length(model, name)]
    probes = tuple(name for name in probes if name not in other)
    notes += [f"{name} is no displacement in m: it is not judged" for name in other]
    wanted = tuple(planes) or (() if diagram is None else planes_of(diagram))
    coupled = dict(cross_coupling or {})
    if diagram is not None:
        problems += _wrong_planes(diagram, [*planes, *coupled])
    limits = _clearances(model, probes, clearance, problems)
    problems += [Problem("not a positive stiffness [N/m]", name) for name, value in coupled.items() if not value > 0]
    if problems:
        raise RotorsimError(*problems)
    return Conditions(lowest, highest, trip, probes, limits, wanted, mass, zone, coupled, tuple(notes))


_CAMPBELLS: WeakKeyDictionary[Model, dict[float, Campbell]] = WeakKeyDictionary()


def campbell_of(model: Model, given: Conditions) -> Campbell:
    """Return the Campbell diagram to 1.5 times the trip speed; it is kept as long as the model lives."""
    known = _CAMPBELLS.setdefault(model, {})
    if given.trip not in known:
        known[given.trip] = campbell(model, speeds=np.linspace(0.0, HIGHEST_SHARE * given.trip, CAMPBELL_SPEEDS))
    return known[given.trip]


def probes_of(diagram: Diagram) -> tuple[str, ...]:
    """Return the two-axis signals that the probes of the controllers see, such as ``rotor.displacement[3]``."""
    seen = [signals for _, signals, _ in controlled(diagram)]
    for name, node in diagram.nodes.items():
        if node.block.category == "controller" and SENSOR in node.inputs:
            entries = arriving(diagram, name, SENSOR) or []
            seen += [(entries[k], entries[k + 1]) for k in range(0, len(entries) - 1, 2)]
    found = [_pair(*both) for both in seen]
    return tuple(dict.fromkeys(name for name in found if name))


def is_length(model: Model, name: str) -> bool:
    """Return whether a signal is a length [m]: as it says, or the sum of such."""
    base = name.partition("[")[0]
    unit = model.select(name)[0].unit
    block, _, _ = base.rpartition(".")
    node = model.diagram.nodes[block]
    if unit == "m":
        return True
    if node.block.type_name != "sum":
        return False
    sources = [wire.source for wire in model.diagram.wires if wire.target.block == block]
    return bool(sources) and all(is_length(model, f"{end.block}.{end.port}") for end in sources)


def _pair(x: str, y: str) -> str:
    """Return the two-axis signal of two entries, "" where they are not one: rotor.displacement[3,1] and [3,2]."""
    one, two = x.removesuffix("1]"), y.removesuffix("2]")
    if one != two or one == x:
        return ""
    return one.removesuffix("[") if one.endswith("[") else f"{one.removesuffix(',')}]"


def _wrong_planes(diagram: Diagram, planes: Sequence[str]) -> list[Problem]:
    problems: list[Problem] = []
    for plane in dict.fromkeys(planes):
        try:
            plane_entries(diagram, plane)
        except RotorsimError as error:
            problems += error.problems
    return problems


def _clearances(
    model: Model | None, probes: Sequence[str], clearance: float | Mapping[str, float] | None, problems: list[Problem]
) -> dict[str, float]:
    """Return place -> radial clearance; one number is that of all probes ("" without a diagram)."""
    given = clearance if isinstance(clearance, Mapping) else {} if clearance is None else {"": clearance}
    made: dict[str, float] = {}
    for place, value in sorted(given.items()):  # "", of all probes, first: a place of its own is heard
        if not (np.isfinite(value) and value > 0):
            problems.append(Problem("a clearance must be positive [m]", place or "clearance"))
        elif not place:
            made |= dict.fromkeys(probes or ("",), float(value))
        else:
            made[place] = float(value)
            if model is not None:
                problems += _wrong_signal(model, place)
    return made


def _wrong_signal(model: Model, name: str) -> list[Problem]:
    try:
        _, entries = model.select(name)
    except RotorsimError as error:
        return list(error.problems)
    if len(entries) == 2 and is_length(model, name):
        return []
    hint = "a clearance belongs to one place, such as rotor.displacement[3]"
    return [Problem(f"not a displacement with two axes: {len(entries)} entries", name, hint=hint)]
