"""A system of FMUs (SSP) as a diagram: one block of type fmu for each component, wires, values of parameters.

Nested systems are flattened: component ``amb`` of system ``left`` is block ``left_amb``. Ports of FMUs are in SI
units, so that connections of other units are wires; those with a factor go through a gain block.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path as File
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.files import HIDDEN, sweep, temporary_prefix, write_atomically
from rotorsim.fmi.block import FmuPort, block_class
from rotorsim.fmi.description.archive import Archive, Limits
from rotorsim.fmi.description.attributes import Mistakes
from rotorsim.fmi.description.model import Entry, FmuUnit, ModelDescription, Value
from rotorsim.model.load import load
from rotorsim.ssp.flat import Feed, Flat, Path, names_of, rescaled, value_at
from rotorsim.ssp.reader import read_structure
from rotorsim.ssp.structure import Component, Connector, Setting, Structure, same_unit
from rotorsim.units import compatible

DIAGRAM = "diagram.json"
DEFAULT_STEPS = 1000  # of a run where no FMU proposes a step
MAX_COMPONENTS = 2000
MAX_ENTRIES = 100_000  # of an array that leaves the system
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
    warnings = (*archive.warnings, *writer.warnings, *diagram.warnings)
    return ImportedSsp(target / DIAGRAM, diagram, structure, tuple(sorted(sources)), warnings)


def _share(folder: File) -> None:
    """Let others read what was unpacked for us alone, as far as the umask of this process lets files be read."""
    mask = os.umask(0o077)
    os.umask(mask)
    for path in (folder, *folder.rglob("*")):
        path.chmod((0o777 if path.is_dir() else 0o666) & ~mask)


def _refuse(problems: Sequence[Problem]) -> None:
    Mistakes("", list(dict.fromkeys(problems))).refuse(50, Place())


@dataclass(frozen=True)
class _At:
    """An entry of a port of a block: the k-th, row-major."""

    block: str
    port: FmuPort
    k: int

    def end(self) -> str:
        inside = ",".join(str(i + 1) for i in np.unravel_index(self.k, self.port.shape)) if self.port.shape else ""
        return f"{self.block}.{self.port.name}" + (f"[{inside}]" if inside else "")


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
            (path, own): _At(self.names[path], port, k)
            for path, found in self.classes.items()
            for port in (*found.fmu_inputs.values(), *found.fmu_outputs.values())
            for k, own in enumerate(port.entries)
        }
        self.used: set[str] = set()  # settings

    def document(self) -> dict[str, Any]:
        """Return the diagram."""
        structure = self.structure
        feeds: list[tuple[Feed, _At]] = []
        blocks: dict[str, Any] = {}
        for path, component in self.flat.components.items():
            values, fed = self._inputs(path, component)
            feeds += fed
            parameters = self._parameters(path, values, {at.port.name for _, at in fed})
            if component.interface:
                parameters = {"interface": component.interface, **parameters}
            blocks[self.names[path]] = {"type": "fmu", "file": component.source, "parameters": parameters}
        wires = self._wires(feeds, blocks)
        left = [name for name in self.flat.settings if name not in self.used]  # SSP leaves them out
        for name in left[:20]:
            place = self.flat.settings[name].place
            self.warnings.append(Problem("is no parameter of a component: left out", name[:200], place, "", "warning"))
        if len(left) > 20:
            self.warnings.append(Problem(f"... and {len(left) - 20} more values left out", severity="warning"))
        document: dict[str, Any] = {"schema_version": 1, "name": structure.name or "system"}
        if structure.description:
            document["description"] = structure.description
        return document | {"blocks": blocks, "wires": wires, "solver": self._solver(), "record": self._record()}

    def _description(self, path: Path) -> ModelDescription:
        description: ModelDescription = self.classes[path].fmu_description
        return description

    def _wrong(self, path: Path, name: str, what: str) -> None:
        self.problems.append(Problem(what, ".".join((*path, name))[:200], self.flat.components[path].place))

    # -- what feeds the inputs -----------------------------------------------------------------------------------------

    def _unit(self, point: tuple[Path, str]) -> FmuUnit | None:
        """Return the unit of a connector: as it says, or as the variable of the FMU does."""
        connector = self.flat.connectors.get(point)
        if connector is not None and connector.unit is not None:
            return connector.unit
        return _unit_of(self._description(point[0]), point[1]) if point[0] in self.classes else None

    def _inputs(self, path: Path, component: Component) -> tuple[dict[str, Value], list[tuple[Feed, _At]]]:
        """Return the values that connectors of systems give to entries, and the entries that outputs feed."""
        values: dict[str, Value] = {}
        fed: list[tuple[Feed, _At]] = []
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
                        self._wrong(path, entry.name, "an output feeds it, and it is no numeric input")
                    else:
                        fed.append((feed, at))
                elif feed.setting is not None:
                    self.used.add(".".join((*feed.path, feed.connector)))
                    source = self.flat.connectors.get((feed.path, feed.connector))
                    value = value_at(feed.setting, feed.indices, source.dimensions if source else ())
                    if value is None or isinstance(value, str):
                        self._wrong(path, entry.name, f"no value of {feed.connector} fits it")
                    else:
                        values[entry.name] = feed.factor * value + feed.offset
        return values, fed

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
        for key, port in {**free, **found.fmu_parameters}.items():
            mine = {k: given.pop(own) for k, own in enumerate(port.entries) if own in given}
            if not mine or key in wired:
                continue
            array = np.array(port.start, float)
            for k, value in mine.items():
                factor, offset = port.scales[k]
                array.flat[k] = factor * float(value) + offset
            if not np.array_equal(array, port.start):
                parameters[key] = array.tolist()
        for name, value in given.items():
            if description.entries(name)[0].start != value:
                what = "cannot be set: it is no numeric parameter with a start value, and no input"
                self._wrong(path, name, what)
        return parameters

    def _entries(self, full: str, description: ModelDescription, name: str, setting: Setting) -> dict[str, Value]:
        """Return the entries of a variable and their values, in the unit of the FMU."""
        entries, own = description.entries(name), _unit_of(description, name)
        fit = rescaled(setting.unit, own) if setting.unit is not None and own is not None else (1.0, 0.0)
        if fit is None and setting.unit is not None and own is not None:
            what = f"is given in {setting.unit.name}, but the FMU has it in {own.name}"
        elif len(setting.values) != len(entries):
            what = f"{len(setting.values)} values are given, {len(entries)} expected"
        elif fit == (1.0, 0.0) or fit is None:
            return {entry.name: value for entry, value in zip(entries, setting.values, strict=True)}
        else:
            pairs = zip(entries, setting.values, strict=True)
            plain = str | bool
            return {e.name: v if isinstance(v, plain) else fit[0] * float(v) + fit[1] for e, v in pairs}
        self.problems.append(Problem(what, full, setting.place))
        return {}

    # -- wires ---------------------------------------------------------------------------------------------------------

    def _source(self, feed: Feed) -> _At | None:
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

    def _wires(self, feeds: Sequence[tuple[Feed, _At]], blocks: dict[str, Any]) -> list[list[str]]:
        """Return the wires: of whole ports where every entry goes to its own."""
        groups: dict[tuple[str, str, str, str, float, bool], list[tuple[_At, _At]]] = {}
        for feed, target in feeds:
            source = self._source(feed)
            if source is None:
                continue
            factor, offset = _between(source, target, feed)
            if offset:
                what = f"connections with an offset ({offset:g}) are not supported"
                self.problems.append(Problem(what, f"{source.end()} -> {target.end()}"))
            same = compatible(source.port.unit, target.port.unit) == "same"
            fits = factor == 1.0 and (same or not feed.converted)
            key = source.block, source.port.name, target.block, target.port.name, factor, fits
            groups.setdefault(key, []).append((source, target))
        wires: list[list[str]] = []
        for (block, port, other, into, factor, fits), pairs in groups.items():
            given, wanted = pairs[0][0].port, pairs[0][1].port
            straight = [(a.k, b.k) for a, b in pairs] == [(k, k) for k in range(len(wanted.entries))]
            ends = [[a.end(), b.end()] for a, b in pairs]
            if given.shape == wanted.shape and straight:
                ends = [[f"{block}.{port}", f"{other}.{into}"]]
            for start, end in ends:
                if fits:
                    wires.append([start, end])
                    continue
                name = f"{other}_{into}_gain"
                while name in blocks:
                    name += "_"
                blocks[name] = {"type": "gain", "parameters": {"gain": factor}}
                wires += [[start, f"{name}.input"], [f"{name}.output", end]]
        return wires

    # -- run -----------------------------------------------------------------------------------------------------------

    def _record(self) -> list[str]:
        """Return what leaves the whole system, or else every output of its components."""
        found: list[str] = []
        silent: list[str] = []
        for connector in self.structure.system.connectors:
            if prod(connector.dimensions) > MAX_ENTRIES:
                self.problems.append(Problem(f"has more than {MAX_ENTRIES} entries", connector.name))
            elif connector.kind in ("output", "calculatedParameter"):
                for indices in np.ndindex(connector.dimensions):
                    feed = self.flat.feed(((), connector.name), tuple(i + 1 for i in indices), self._unit)
                    at = self._source(feed) if feed and feed.path in self.classes else None
                    found += [at.end()] if at else []
            elif connector.name not in self.used:
                silent.append(connector.name)
        if silent:
            what = f"inputs of the whole system, which nothing feeds: {', '.join(silent)[:200]}"
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


def _between(source: _At, target: _At, feed: Feed) -> tuple[float, float]:
    """Return (a, b): what a feed makes of a signal in the diagram, where both ends are in SI units."""
    (f, o), (into, at) = source.port.scales[source.k], target.port.scales[target.k]
    factor = feed.factor * into / f
    offset = into * (feed.offset - feed.factor * o / f) + at
    nothing = 1e-12 * max(abs(into * feed.offset), abs(factor * o), abs(at))
    exact = abs(factor - 1.0) < 1e-12
    return 1.0 if exact else float(factor), 0.0 if abs(offset) <= nothing else float(offset)


def _unit_of(description: ModelDescription, name: str) -> FmuUnit | None:
    """Return the unit of a variable where the FMU defines it, or its name is known."""
    entries = description.entries(name)
    return description.unit_of(entries[0].variable) if entries else None
