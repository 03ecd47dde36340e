"""A system of FMUs as SSP describes it: components, connectors, connections, values of parameters, units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rotorsim.errors import Place, Problem
from rotorsim.fmi.description.model import FmuUnit, Value

STRUCTURE_FILE = "SystemStructure.ssd"
FMU = "application/x-fmu-sharedlibrary"  # type of a component
INTERFACES = {"cs": "CoSimulation", "me": "ModelExchange"}
_BASE = "http://ssp-standard.org/SSP1/SystemStructure"  # also in SSP 2.0
NAMESPACES = {
    "ssd": f"{_BASE}Description",
    "ssc": f"{_BASE}Common",
    "ssv": f"{_BASE}ParameterValues",
    "ssm": f"{_BASE}ParameterMapping",
    "ssb": f"{_BASE}SignalDictionary",
}


@dataclass(frozen=True)
class Connector:
    """A variable of a component, or a way into or out of a system.

    kind: "input", "output", "parameter", ... type: "Float64", "Int32", ... as in FMI 3.0, "" where it is not said.
    unit: None where it is not said: that of the variable. dimensions: () for a scalar; 0 for a size that is not said.
    """

    name: str
    kind: str
    type: str = ""
    unit: FmuUnit | None = None
    dimensions: tuple[int, ...] = ()


@dataclass(frozen=True)
class Setting:
    """The value of a parameter or the start value of a variable: one value for each entry, row-major.

    What takes it gets factor * value + offset, after units are converted (unless ``suppress``): a parameter mapping.
    """

    name: str
    type: str
    values: tuple[Value, ...]
    unit: FmuUnit | None = None
    dimensions: tuple[int, ...] = ()
    place: Place = field(default_factory=Place)
    factor: float = 1.0
    offset: float = 0.0
    suppress: bool = False


@dataclass(frozen=True)
class End:
    """An end of a connection. element: None for the system itself. indices: from 1; None for the whole connector."""

    element: str | None
    connector: str
    indices: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Connection:
    """A connection: end = factor * start + offset, after units are converted (unless ``suppress``).

    types: of the connectors that it may join, where its transformation is for some types only. table: what whole
    numbers, or names of items, become; others stay.
    """

    start: End
    end: End
    factor: float = 1.0
    offset: float = 0.0
    suppress: bool = False
    place: Place = field(default_factory=Place)
    types: tuple[str, ...] = ()
    table: Mapping[Value, Value] | None = None


@dataclass(frozen=True)
class Component:
    """An FMU in a system. source: its name inside the archive; interface: "cs", "me" or "" (as it offers)."""

    name: str
    source: str
    connectors: tuple[Connector, ...] = ()
    settings: tuple[Setting, ...] = ()
    interface: str = ""
    place: Place = field(default_factory=Place)


@dataclass(frozen=True)
class System:
    """Components and systems, and the connections between them; settings may name what is deeper: "rotor.mass"."""

    name: str
    connectors: tuple[Connector, ...] = ()
    settings: tuple[Setting, ...] = ()
    components: tuple[Component, ...] = ()
    systems: tuple[System, ...] = ()
    connections: tuple[Connection, ...] = ()
    place: Place = field(default_factory=Place)


@dataclass(frozen=True)
class Structure:
    """A system structure description; start and stop of its default experiment [s]; warnings: what is odd in it."""

    name: str
    version: str
    system: System
    start: float | None = None
    stop: float | None = None
    description: str = ""
    warnings: tuple[Problem, ...] = ()


def same_unit(a: FmuUnit, b: FmuUnit) -> bool:
    """Return whether two units mean the same, whatever they are called; angles may be left out of definitions.

    Of one name, they do unless both are defined: what only one file defines has no second meaning.
    """
    if a.name == b.name and not (a.defined and b.defined):
        return True
    a, b = a.known or a, b.known or b
    return (a.factor, a.offset, _powers(a)) == (b.factor, b.offset, _powers(b))


def _powers(unit: FmuUnit) -> dict[str, int]:
    return {base: power for base, power in unit.powers.items() if power}
