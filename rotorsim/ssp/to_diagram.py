"""A system of FMUs (SSP) as a diagram: one block of type fmu for each component, wires, values of parameters.

Nested systems are flattened: component ``amb`` of system ``left`` is block ``left_amb``. Ports of FMUs are in SI
units, so that connections of other units are wires; those with a factor or an offset go through blocks that give it.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path as File
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.files import HIDDEN, sweep, temporary_prefix, write_atomically
from rotorsim.fmi.block import block_class
from rotorsim.fmi.description.archive import Archive, Limits
from rotorsim.fmi.description.attributes import Mistakes
from rotorsim.fmi.description.model import INTEGERS, Entry, FmuUnit, ModelDescription, Value
from rotorsim.fmi.ports import FmuOption
from rotorsim.model.load import load
from rotorsim.ssp.flat import Feed, Flat, Path, names_of, rescaled, value_at
from rotorsim.ssp.reader import read_structure
from rotorsim.ssp.structure import Component, Connector, Setting, Structure, same_unit
from rotorsim.ssp.wiring import At, Wiring

DIAGRAM = "diagram.json"
DEFAULT_STEPS = 1000  # of a run where no FMU proposes a step
MAX_COMPONENTS = 2000
MAX_ENTRIES = 100_000  # of an array that leaves the system
_SHOWN = 20  # values left out, and oddities of the files
_INTO = ("input", "parameter", "structuralParameter")


@dataclass(frozen=True)
class ImportedSsp:
    """What was written: the diagram's file, the diagram, how many FMUs; what is odd."""

    file: File
    diagram: Diagram
    structure: Structure
    fmus: tuple[str, ...]
    warnings: tuple[Problem, ...] = ()


def import_ssp(
    file: str | File, folder: str | File, *, limits: Limits | None = None, trust_blocks: bool = False
) -> ImportedSsp:
    """Unpack a system of FMUs into a new folder, and write it as diagram.json there.

    folder: must not exist, or be empty; it stays as it is when something is wrong. trust_blocks: as for `load`.
    Raises RotorsimError with every mistake and everything that is not supported.
    """
    target = File(folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        what = "the folder is not empty" if target.is_dir() else "is a file"
        raise RotorsimError(Problem(what, place=Place(str(folder)), hint="give the name of a new folder"))
    target.parent.mkdir(parents=True, exist_ok=True)
    with Archive(file, limits) as archive:
        structure = read_structure(archive)
        flat = Flat(structure)
        if not flat.components:
            raise RotorsimError(Problem("there are no components in it", structure.name, archive.place))
        if len(flat.components) > MAX_COMPONENTS:
            what = f"{len(flat.components)} components; {MAX_COMPONENTS} are allowed"
            raise RotorsimError(Problem(what, structure.name, archive.place))
        _refuse(flat.problems)
        sources = {component.source for component in flat.components.values()}
        sweep(target.parent, HIDDEN)
        temporary = File(tempfile.mkdtemp(prefix=temporary_prefix(HIDDEN), dir=target.parent))
        try:
            archive.unpack(temporary, lambda name: name in sources)
            writer = _Writer(structure, flat, temporary)
            document = writer.document()
            _refuse(writer.problems)
            write_atomically(temporary / DIAGRAM, format_document(document))
            load(document, folder=temporary)
            _share(temporary)
            if target.exists():
                target.rmdir()
            os.replace(temporary, target)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    diagram = load(document, folder=target, trust_blocks=trust_blocks)  # its FMUs are where they stay
    warnings = (*archive.warnings, *_first(structure.warnings, "oddities"), *writer.warnings, *diagram.warnings)
    return ImportedSsp(target / DIAGRAM, diagram, structure, tuple(sorted(sources)), warnings)


def _share(folder: File) -> None:
    """Let others read what was unpacked for us alone, as far as the umask of this process lets files be read."""
    mask = os.umask(0o077)
    os.umask(mask)
    for path in (folder, *folder.rglob("*")):
        path.chmod((0o777 if path.is_dir() else 0o666) & ~mask)


def _first(problems: Sequence[Problem], what: str) -> list[Problem]:
    """Return the first problems, and how many more there are."""
    more = len(problems) - _SHOWN
    return [*problems[:_SHOWN], *([Problem(f"... and {more} more {what}", severity="warning")] if more > 0 else [])]


def _refuse(problems: Sequence[Problem]) -> None:
    Mistakes("", list(dict.fromkeys(problems))).refuse(50, Place())


class _Writer:
    """Makes the document; mistakes go to ``problems``, oddities to ``warnings``."""

    def __init__(self, structure: Structure, flat: Flat, folder: File) -> None:
        self.structure, self.flat = structure, flat
        self.problems: list[Problem] = flat.problems
        self.warnings: list[Problem] = []
        self.names = names_of(flat.components)
        self.classes: dict[Path, Any] = {}
        for path, component in flat.components.items():
            try:
                self.classes[path] = block_class(folder.joinpath(*component.source.split("/")))
            except RotorsimError as error:
                self.problems += [Problem(p.what, ".".join(path), component.place, p.hint) for p in error.problems]
        _refuse(self.problems)
        self.ports = {  # FMU's own name of an entry -> port of the block
            (path, own): At(self.names[path], port, k)
            for path, found in self.classes.items()
            for port in (*found.fmu_inputs.values(), *found.fmu_outputs.values())
            for k, own in enumerate(port.entries)
        }
        # settings that count: of a connector that something feeds, the value only stands in until that comes
        self.used = {".".join((*path, name)) for path, name in flat.drivers if path not in flat.components}
        self.free: dict[str, list[str]] = {}  # inputs of the whole system that nothing feeds -> ports

    def document(self) -> dict[str, Any]:
        """Return the diagram."""
        structure = self.structure
        feeds: list[tuple[Feed, At, At]] = []
        blocks: dict[str, Any] = {}
        for path, component in self.flat.components.items():
            values, fed = self._inputs(path, component)
            feeds += [(feed, source, at) for feed, at in fed if (source := self._source(feed)) is not None]
            parameters = self._parameters(path, values, {at.port.name for _, at in fed})
            if component.interface:
                parameters = {"interface": component.interface, **parameters}
            blocks[self.names[path]] = {"type": "fmu", "file": component.source, "parameters": parameters}
        wiring = Wiring(blocks)
        wiring.join(feeds)
        record = self._record(wiring)
        left = [(name, setting) for name, setting in self.flat.settings.items() if name not in self.used]
        what = "nothing takes this value: left out"  # as SSP has it
        odd = [Problem(what, name[:200], setting.place, severity="warning") for name, setting in left]
        self.warnings += _first(odd, "values left out")
        document: dict[str, Any] = {"schema_version": 1, "name": structure.name or "system"}
        if structure.description:
            document["description"] = structure.description
        return document | {"blocks": blocks, "wires": wiring.wires, "solver": self._solver(), "record": record}

    def _description(self, path: Path) -> ModelDescription:
        description: ModelDescription = self.classes[path].fmu_description
        return description

    def _wrong(self, path: Path, name: str, what: str, hint: str = "") -> None:
        self.problems.append(Problem(what, ".".join((*path, name))[:200], self.flat.components[path].place, hint))

    # -- what feeds the inputs -----------------------------------------------------------------------------------------

    def _unit(self, point: tuple[Path, str]) -> FmuUnit | None:
        """Return the unit of a connector: as the variable of the FMU says, or as it does."""
        own = _unit_of(self._description(point[0]), point[1]) if point[0] in self.classes else None
        connector = self.flat.connectors.get(point)
        return own or (connector.unit if connector else None)

    def _inputs(self, path: Path, component: Component) -> tuple[dict[str, Value], list[tuple[Feed, At]]]:
        """Return the values that connectors of systems give to entries, and the entries that outputs feed."""
        values: dict[str, Value] = {}
        fed: list[tuple[Feed, At]] = []
        for connector in component.connectors:
            entries = self._description(path).entries(connector.name)
            if why := self._mismatch(path, connector, entries):
                self._wrong(path, connector.name, why)
            for entry in entries if connector.kind in _INTO and not why else ():
                feed = self.flat.feed((path, connector.name), entry.indices, self._unit)
                at = self.ports.get((path, entry.name))
                if feed is None:
                    continue
                if feed.path in self.flat.components:
                    if connector.kind != "input" or at is None:
                        hint = "a parameter is given by a value, or by a connector of a system"
                        self._wrong(path, entry.name, "an output feeds it, and it is no numeric input", hint)
                    else:
                        fed.append((self._in_numbers(feed, path, entry), at))
                elif feed.setting is not None:
                    self.used.add(".".join((*feed.path, feed.connector)))
                    source = self.flat.connectors.get((feed.path, feed.connector))
                    value = value_at(feed.setting, feed.indices, source.dimensions if source else ())
                    if value is None or (isinstance(value, str) and (feed.factor, feed.offset) != (1.0, 0.0)):
                        self._wrong(path, entry.name, f"no value of {feed.connector} fits it")
                    else:
                        value = (feed.table or {}).get(value, value)
                        values[entry.name] = _line(value, feed.factor, feed.offset)
                elif not feed.path and connector.kind == "input" and at is not None:
                    self.free.setdefault(feed.connector, []).append(at.end())
        return values, fed

    def _in_numbers(self, feed: Feed, path: Path, entry: Entry) -> Feed:
        """Return a feed of an entry whose table is of numbers: names of items are those of both FMUs."""
        source = next(iter(self._description(feed.path).entries(feed.connector)), None)
        if feed.table is None or source is None:
            return feed
        for end in (source.variable, entry.variable):
            if end.type not in INTEGERS:
                self._wrong(path, entry.name, f"whole numbers are mapped, and {end.name} is of type {end.type}")
                return feed
        if not any(isinstance(value, str) for value in feed.table):
            return feed
        given = self._description(feed.path).items.get(source.variable.declared_type, {})
        wanted = self._description(path).items.get(entry.variable.declared_type, {})
        numbers: dict[Value, Value] = {}
        for name, number in given.items():
            item = str(feed.table.get(name, name))
            if item not in wanted:
                what = f"item '{name[:80]}' comes as '{item[:80]}', which is none of its items"
                self._wrong(path, entry.name, what, near_miss(item[:80], wanted))
            else:
                numbers[number] = wanted[item]
        return replace(feed, table=numbers)

    def _mismatch(self, path: Path, connector: Connector, entries: Sequence[Entry]) -> str:
        """Return why the FMU has no variable of the name, kind and unit that a connector stands for, or ""."""
        if not entries:
            return "the FMU has no variable of this name"
        causality, own = entries[0].variable.causality, _unit_of(self._description(path), connector.name)
        if causality != connector.kind:
            return f"the connector is of kind {connector.kind}, the variable of the FMU {causality}"
        if connector.unit is not None and own is not None and not same_unit(connector.unit, own):
            return f"the connector is in {connector.unit.name}, the variable of the FMU in {own.name}"
        return ""

    # -- parameters ----------------------------------------------------------------------------------------------------

    def _parameters(self, path: Path, values: dict[str, Value], wired: set[str]) -> dict[str, Any]:
        """Return the parameters of a block: the values of all bindings and connectors, in the FMU's units."""
        found, description = self.classes[path], self._description(path)
        given = dict(values)
        for name in description.variables:
            full = ".".join((*path, name))
            if full in self.flat.settings:
                self.used.add(full)
                given = {**self._entries(full, description, name, self.flat.settings[full]), **given}
        free = {key: port for key, port in found.fmu_inputs.items() if port.start is not None}
        parameters: dict[str, Any] = {}
        for key, option in found.fmu_options.items():
            entries = description.entries(option.variable.name)
            chosen = {entry.name: given.pop(entry.name) for entry in entries if entry.name in given}
            if chosen and key not in wired:
                whole = isinstance(option.default, list)
                start = {entry.name: entry.start if whole else option.default for entry in entries}
                parameters |= self._chosen(path, key, option, start, {**start, **chosen})
        for key, port in {**free, **found.fmu_parameters}.items():
            mine = {k: given.pop(own) for k, own in enumerate(port.entries) if own in given}
            if not mine or key in wired:
                continue
            array = np.array(port.start, float)
            for k, value in mine.items():
                factor, offset = port.scales[k]
                if isinstance(value, str):
                    self._wrong(path, port.entries[k], f"is a number; '{value[:80]}' is given")
                else:
                    array.flat[k] = factor * float(value) + offset
            if not np.array_equal(array, port.start):
                parameters[key] = array.tolist()
        for name, value in given.items():
            if description.entries(name)[0].start != value:
                what = "cannot be set: it is no parameter with a start value, and no input"
                self._wrong(path, name, what)
        return parameters

    def _chosen(
        self, path: Path, key: str, option: FmuOption, start: dict[str, Any], given: dict[str, Any]
    ) -> dict[str, Any]:
        """Return the parameter that sets what is no number, nothing where that is as it was."""
        variable, whole = option.variable, list(given.values())
        if given == start:
            return {}
        fits = {
            "Boolean": all(value in (0, 1) for value in whole),
            "String": all(isinstance(value, str) for value in whole),
        }
        if variable.causality == "structuralParameter":
            self._wrong(path, variable.name, "the size of arrays is not set by systems", "set it in the diagram")
        elif option.items and whole[0] not in (*option.items, *option.items.values()):
            hint = near_miss(str(whole[0])[:80], option.items)
            self._wrong(path, variable.name, f"'{str(whole[0])[:80]}' is none of its items", hint)
        elif not fits.get(variable.type, True):
            self._wrong(path, variable.name, f"is of type {variable.type}; '{str(whole[0])[:80]}' is given")
        else:
            whole = [bool(value) for value in whole] if variable.type == "Boolean" else whole
            return {key: whole if isinstance(option.default, list) else whole[0]}
        return {}

    def _entries(self, full: str, description: ModelDescription, name: str, setting: Setting) -> dict[str, Value]:
        """Return the entries of a variable and their values, in the unit of the FMU."""
        entries, own = description.entries(name), _unit_of(description, name)
        given = setting.unit if own is not None and not setting.suppress else None
        fit = rescaled(given, own) if given and own else (1.0, 0.0)
        if fit is None and given and own:
            what = f"is given in {given.name}, but the FMU has it in {own.name}"
        elif len(setting.values) != len(entries):
            what = f"{len(setting.values)} values are given, {len(entries)} expected"
        else:
            a, b = fit or (1.0, 0.0)
            factor, offset = setting.factor * a, setting.factor * b + setting.offset
            pairs = zip(entries, setting.values, strict=True)
            return {entry.name: _line(value, factor, offset) for entry, value in pairs}
        self.problems.append(Problem(what, full, setting.place))
        return {}

    # -- wires ---------------------------------------------------------------------------------------------------------

    def _source(self, feed: Feed) -> At | None:
        """Return the output that feeds something."""
        entries = self._description(feed.path).entries(feed.connector)
        entry = next((e for e in entries if e.indices == feed.indices), None)
        if entry is None:
            self._wrong(feed.path, feed.connector, "the shapes of connected connectors differ")
            return None
        at = self.ports.get((feed.path, entry.name))
        if at is None:
            self._wrong(feed.path, entry.name, f"a connection of type {entry.variable.type} is not supported")
        return at

    # -- run -----------------------------------------------------------------------------------------------------------

    def _record(self, wiring: Wiring) -> list[str]:
        """Return what leaves the whole system, or else every output of its components."""
        found: list[str] = []
        lost: list[str] = []
        for connector in self.structure.system.connectors:
            if connector.kind not in ("output", "calculatedParameter"):
                continue
            if prod(connector.dimensions) > MAX_ENTRIES:
                self.problems.append(Problem(f"has more than {MAX_ENTRIES} entries", connector.name))
                continue
            lost += [connector.name] if 0 in connector.dimensions else []
            for numbers in np.ndindex(connector.dimensions):
                indices = tuple(i + 1 for i in numbers)
                feed = self.flat.feed(((), connector.name), indices, self._unit)
                at = self._source(feed) if feed and feed.path in self.classes else None
                if feed and feed.table is not None:
                    what = "values are mapped on their way out of the whole system, which is not supported"
                    hint = "wire the output by itself, and map what is recorded"
                    self.problems.append(Problem(what, connector.name, hint=hint))
                elif feed and at:
                    name = names_of([(connector.name, *map(str, indices))])
                    found.append(wiring.shown(feed, at, next(iter(name.values()))))
                else:
                    lost.append(connector.name)
        if lost:
            shown = ", ".join(dict.fromkeys(lost))[:200]
            what = f"outputs of the whole system that no component feeds, or whose size is not said: {shown}"
            hint = "they are not recorded; record what feeds them in the diagram"
            self.warnings.append(Problem(what, self.structure.name, hint=hint, severity="warning"))
        if self.free:
            shown = ", ".join(f"{name} ({', '.join(ports)})" for name, ports in self.free.items())
            what = f"inputs of the whole system, which nothing feeds: {shown[:200]}"
            hint = "what they feed keeps its start value; wire a source in the diagram"
            self.warnings.append(Problem(what, self.structure.name, hint=hint, severity="warning"))
        ports = [f"{self.names[path]}.{port}" for path, made in self.classes.items() for port in made.fmu_outputs]
        return list(dict.fromkeys(found)) or ports

    def _solver(self) -> dict[str, Any]:
        experiments = [self._description(path).experiment for path in self.classes]
        stop = self.structure.stop or max((e.stop for e in experiments if e.stop), default=1.0)
        step = min((e.step for e in experiments if e.step), default=stop / DEFAULT_STEPS)
        if self.structure.start:
            what = f"begins at {self.structure.start:g} s; the diagram begins at 0"
            self.warnings.append(Problem(what, self.structure.name, severity="warning"))
        return {"method": "rk4", "step": min(step, stop), "stop": stop}


def _line(value: Value, factor: float, offset: float) -> Value:
    """Return factor * value + offset, and the value itself where that is the same."""
    return value if (factor, offset) == (1.0, 0.0) or isinstance(value, str) else factor * value + offset


def _unit_of(description: ModelDescription, name: str) -> FmuUnit | None:
    """Return the unit of a variable where the FMU defines it, or its name is known."""
    variable = next((entry.variable for entry in description.entries(name)), None)
    found = description.unit_of(variable) if variable else None
    declared = description.units.get(variable.unit) if variable and found else None
    return replace(found, defined=declared is not None and declared.defined) if found else None
