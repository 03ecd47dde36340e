"""A system of FMUs without its hierarchy: what feeds each input of a component, and with which factor."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import count, islice

import numpy as np

from rotorsim.errors import Problem, near_miss
from rotorsim.fmi.description.model import FLOATS, FmuUnit, Value
from rotorsim.ssp.structure import Component, Connection, Connector, Setting, Structure, System, same_unit

Path = tuple[str, ...]  # names from the root system (which is ()) down to an element
Point = tuple[Path, str]  # a connector of an element
Indices = tuple[int, ...]

_SOURCES = ("output", "calculatedParameter", "constant", "local")
_SINKS = ("input", "parameter", "structuralParameter")


@dataclass(frozen=True)
class Feed:
    """What feeds an entry: factor * source + offset. The source is an output, or a connector of a system.

    setting: the value that is given to the connector of a system. unit: in which it arrives. table: what becomes of
    some whole numbers, or names of items, on the way; then factor and offset are 1 and 0.
    """

    path: Path
    connector: str
    indices: Indices
    factor: float
    offset: float
    setting: Setting | None = None
    unit: FmuUnit | None = None
    table: Mapping[Value, Value] | None = None


@dataclass(frozen=True)
class _Driver:
    """A connection into a point: from where, and the entry there that it is restricted to."""

    source: Point
    start: Indices | None
    connection: Connection


class Flat:
    """The components of all levels, what drives what, and the values given to parameters; mistakes in ``problems``.

    settings: full name ("left.amb.gain") -> value; those of outer systems win, and of one system the later ones.
    """

    def __init__(self, structure: Structure) -> None:
        self.problems: list[Problem] = []
        self.components: dict[Path, Component] = {}
        self.connectors: dict[Point, Connector] = {}
        self.drivers: dict[Point, dict[Indices | None, _Driver]] = {}  # by the entry that is driven; None: all
        self.settings: dict[str, Setting] = {}
        self.systems: dict[Path, System] = {}
        self._system((), structure.system)

    def _system(self, path: Path, system: System) -> None:
        self.systems[path] = system
        self._connectors(path, system)
        for inner in system.systems:
            self._system((*path, inner.name), inner)
        for component in system.components:
            own = (*path, component.name)
            self.components[own] = component
            self._connectors(own, component)
            self._settings(own, component)
        self._settings(path, system)
        for connection in system.connections:
            self._connection(path, connection)

    def _connectors(self, path: Path, element: Component | System) -> None:
        self.connectors.update(((path, connector.name), connector) for connector in element.connectors)

    def _settings(self, path: Path, element: Component | System) -> None:
        self.settings.update((".".join((*path, setting.name)), setting) for setting in element.settings)

    def _connection(self, path: Path, connection: Connection) -> None:
        """Note a connection as driver of the end that takes the value: which one follows from the kinds."""
        ends = []
        for end in (connection.start, connection.end):
            point = ((*path, end.element) if end.element is not None else path, end.connector)
            connector = self.connectors.get(point)
            where = f"element '{end.element}'" if end.element is not None else "the system"
            wrong = f"{where} has no connector '{end.connector}'"
            if connector is not None:
                wrong = f"connectors of kind {connector.kind} are not supported"
            if connector is None or connector.kind not in _SOURCES + _SINKS:
                hint = "inputs, outputs, parameters and constants are" if connector else self._near(point)
                self._wrong(wrong, _ends(path, connection), connection, hint)
                return
            if connection.types and connector.type not in ("", *connection.types):
                kind = "whole numbers" if len(connection.types) > 1 else connection.types[0]
                kind = FLOATS[0] if FLOATS[0] in connection.types else kind
                what = f"a transformation of {kind}, and '{end.connector}' is of type {connector.type}"
                self._wrong(what, _ends(path, connection), connection)
                return
            outward = connector.kind in _SOURCES
            ends.append((point, end.indices, outward if end.element is not None else not outward))
        if ends[0][2] == ends[1][2]:
            what = "two sources are connected" if ends[0][2] else "two connectors that take a value are connected"
            self._wrong(what, _ends(path, connection), connection)
            return
        source, sink = ends if ends[0][2] else ends[::-1]
        drivers = self.drivers.setdefault(sink[0], {})
        if None in drivers or sink[1] in drivers or (sink[1] is None and drivers):
            hint = "one is allowed; a component that adds up can take both"
            self._wrong("is fed by two connections", _text(sink[0]), connection, hint)
        else:
            drivers[sink[1]] = _Driver(source[0], source[1], connection)

    def _wrong(self, what: str, subject: str, connection: Connection, hint: str = "") -> None:
        self.problems.append(Problem(what, subject[:200], connection.place, hint))

    def _near(self, point: Point) -> str:
        """Return a hint for a connector that is not there: only for what is shown of many mistakes."""
        own = (name for path, name in self.connectors if path == point[0])
        return near_miss(point[1][:80], islice(own, 1000)) if len(self.problems) < 50 else ""

    def feed(self, sink: Point, indices: Indices, unit_of: Callable[[Point], FmuUnit | None]) -> Feed | None:
        """Return what feeds an entry of a connector, or None. unit_of: the unit of a connector where it is known."""
        hops: list[tuple[Point, Connection]] = []  # from the sink back to the source
        point, seen = sink, set()
        while point in self.drivers and point not in seen:
            seen.add(point)
            drivers = self.drivers[point]
            restricted = indices in drivers
            driver = drivers.get(indices, drivers.get(None))
            if driver is None:
                break
            hops.append((point, driver.connection))
            if driver.start is not None:
                if indices and not restricted:
                    self._wrong("an entry is connected to a whole array", _text(point), driver.connection)
                indices = driver.start
            elif restricted:
                indices = ()
            point = driver.source
            if point[0] in self.components:
                break
            if point in seen:
                self._wrong("connectors of systems feed each other in a circle", _text(point), driver.connection)
        if not hops:
            return None
        setting = None if point[0] in self.components else self.settings.get(_text(point))
        steps: list[tuple[Point, Setting | Connection]] = [(point, setting)] if setting else []
        steps += reversed(hops)
        units = self._units(point, [target for target, _ in steps], unit_of)
        unit, factor, offset = units[0] if setting is None else setting.unit, 1.0, 0.0
        table: Mapping[Value, Value] | None = None
        for (target, step), own in zip(steps, units[len(units) - len(steps) :], strict=True):
            fit = rescaled(unit, own) if unit and own and not step.suppress else (1.0, 0.0)
            if fit is None and unit and own:
                what = f"units do not fit: {unit.name} into {own.name}"
                hint = 'suppressUnitConversion="true" hands the number over as it is'
                self.problems.append(Problem(what, f"{_text(point)} -> {_text(target)}"[:200], step.place, hint))
            unit = own or unit
            for a, b in (fit or (1.0, 0.0), (step.factor, step.offset)):
                factor, offset = a * factor, a * offset + b
            own_table = step.table if isinstance(step, Connection) else None
            table = own_table if table is None else _one_behind_another(table, own_table or {})
            if table is not None and (factor, offset) != (1.0, 0.0):
                what = "a mapping of values and a factor or offset are on one way, which is not supported"
                self.problems.append(Problem(what, f"{_text(point)} -> {_text(target)}"[:200], step.place))
        return Feed(point[0], point[1], indices, factor, offset, setting, unit, table)

    def _units(
        self, source: Point, targets: list[Point], unit_of: Callable[[Point], FmuUnit | None]
    ) -> list[FmuUnit | None]:
        """Return the units along a feed, of its source first unless a value is given to that.

        A way into a system that has none has that of what it feeds (SSP 2.0, "Real"); one that leads out keeps what
        comes.
        """
        points = targets if targets[0] == source else [source, *targets]
        units = [unit_of(point) for point in points]
        for k in reversed(range(len(points) - 1)):
            path, name = points[k]
            if units[k] is None and path not in self.components and self.connectors[path, name].kind in _SINKS:
                units[k] = units[k + 1]
        return units


def _one_behind_another(first: Mapping[Value, Value], then: Mapping[Value, Value]) -> dict[Value, Value]:
    """Return the table of two, of which each leaves what it has not."""
    return {value: then.get(first.get(value, value), first.get(value, value)) for value in (*first, *then)}


def rescaled(given: FmuUnit, wanted: FmuUnit) -> tuple[float, float] | None:
    """Return (a, b) with value in the wanted unit = a * value + b, or None where the units do not fit.

    Without a definition on one side, a unit means what its name says.
    """
    if same_unit(given, wanted):
        return 1.0, 0.0
    given, wanted = given.known or given, wanted.known or wanted
    bases = given.powers.keys() | wanted.powers.keys()
    if any(given.powers.get(base, 0) != wanted.powers.get(base, 0) for base in bases):
        return None
    return given.factor / wanted.factor, (given.offset - wanted.offset) / wanted.factor


def value_at(setting: Setting, indices: Indices, dimensions: Indices) -> Value | None:
    """Return the entry of a value that indices (from 1) pick, or None where the shapes differ."""
    sizes = setting.dimensions or dimensions
    if len(indices) != len(sizes) or any(not 1 <= i <= n for i, n in zip(indices, sizes, strict=False)):
        return None if indices or len(setting.values) != 1 else setting.values[0]
    place = int(np.ravel_multi_index([i - 1 for i in indices], sizes)) if sizes else 0
    return setting.values[place] if place < len(setting.values) else None


def _text(point: Point) -> str:
    return ".".join((*point[0], point[1]))


def _ends(path: Path, connection: Connection) -> str:
    """Return both ends of a connection in a system."""
    ends = (connection.start, connection.end)
    return " -> ".join(".".join((*path, *filter(None, (end.element,)), end.connector)) for end in ends)


def names_of(paths: Iterable[Path]) -> dict[Path, str]:
    """Return a name of a block for every path: letters, digits and _, each once."""
    found: dict[Path, str] = {}
    taken: set[str] = set()
    for path in paths:
        name = re.sub(r"\W", "_", "_".join(path), flags=re.ASCII)[:80]
        name = name if re.match(r"[A-Za-z_]", name) else f"_{name}"
        candidates = (name if k == 1 else f"{name}_{k}" for k in count(1))
        found[path] = next(candidate for candidate in candidates if candidate not in taken)
        taken.add(found[path])
    return found
