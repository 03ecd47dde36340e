"""Write a diagram as a system of FMUs: SSP 1.0, and SSP 2.0 where FMUs are of FMI 3.0.

The diagram is cut into parts; each becomes an FMU. SSP allows one connection to an input, so a part takes the forces
on a rotor one by one, as an input for each output that feeds it, and adds them up inside.
"""

from __future__ import annotations

import re
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.cosim.cosimulation import sources_of
from rotorsim.diagram.diagram import Diagram, Node
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.files import atomic_target, sweep, temporary_prefix
from rotorsim.fmi.description.model import FmuUnit, FmuVariable, ModelDescription
from rotorsim.fmi.export.export import export_fmu
from rotorsim.fmi.export.variables import INPUT, OUTPUT, PARAMETER, Interface, Variable
from rotorsim.fmi.ports import FmuPort
from rotorsim.linear.linearisation import entry_names
from rotorsim.ssp.structure import STRUCTURE_FILE, Component, Connection, Connector, End, Setting, Structure, System
from rotorsim.ssp.writer import system_description, values_description
from rotorsim.units import BASES, parse_unit

REST = "rest"
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_DATE = (1980, 1, 1, 0, 0, 0)  # of files in the archive: the same export gives the same bytes


@dataclass(frozen=True)
class ExportedSsp:
    """What was written: the file, its structure, the blocks of every component; what is odd."""

    file: Path
    structure: Structure
    blocks: dict[str, tuple[str, ...]]
    warnings: tuple[Problem, ...] = ()


def export_ssp(
    diagram: Diagram,
    file: str | Path,
    parts: Mapping[str, Sequence[str]] | None = None,
    *,
    version: str = "2.0",
    platforms: Sequence[str] | None = None,
) -> ExportedSsp:
    """Write a diagram as a system of FMUs.

    parts: name -> blocks; blocks that no part names make one more, "rest"; a block of type fmu goes as it is.
    version: of FMI, "2.0" or "3.0". platforms: as for `export_fmu`.

    Raises RotorsimError with every mistake.
    """
    cut = _cut(diagram, parts or {})
    foreign = _foreign(diagram, cut)
    warnings: dict[str, Problem] = {}
    sweep(tempfile.gettempdir(), "rotorsim-ssp-")
    with tempfile.TemporaryDirectory(prefix=temporary_prefix("rotorsim-ssp-")) as folder:
        files: dict[str, Path] = {}
        interfaces = {}
        for name, blocks in cut.items():
            files[name] = Path(folder) / f"{name}.fmu"
            made = export_fmu(diagram, files[name], blocks=blocks, version=version, platforms=platforms, by_source=True)
            interfaces[name] = made.interface
            warnings.update((problem.what, problem) for problem in made.warnings)
        wiring = _Wiring(diagram, cut, foreign)
        connections = [c for name, interface in interfaces.items() for c in wiring.into_part(name, interface)]
        connections += [c for block in foreign for c in wiring.into_fmu(block)]
        if wiring.problems:
            raise RotorsimError(*wiring.problems)
        components = [
            Component(name, f"resources/{name}.fmu", _connectors(interface), _settings(interface))
            for name, interface in interfaces.items()
        ]
        for block, name in foreign.items():
            files[name] = _fmu(diagram.nodes[block]).fmu_path
            components.append(_foreign_component(name, diagram, block))
        three = bool(cut) and version == "3.0"
        three = three or any(_fmu(diagram.nodes[block]).fmu_description.version == "3.0" for block in foreign)
        words = diagram.document.get("description")
        system = System(diagram.name or "diagram", components=tuple(components), connections=tuple(connections))
        structure = Structure(
            system.name,
            "2.0" if three else "1.0",
            system,
            0.0,
            diagram.solver.stop,
            words if isinstance(words, str) else "",
        )
        write_ssp(structure, files, file)
    held = {name: tuple(inside) for name, inside in cut.items()} | {name: (block,) for block, name in foreign.items()}
    return ExportedSsp(Path(file), structure, held, tuple(warnings.values()))


def write_ssp(structure: Structure, files: Mapping[str, Path], file: str | Path) -> None:
    """Write a system of FMUs. files: component -> its FMU. Raises RotorsimError where a file cannot be written."""
    held: dict[str, bytes | Path] = {STRUCTURE_FILE: system_description(structure)}
    for component in structure.system.components:
        held[component.source] = files[component.name]
        if component.settings:
            held[f"resources/{component.name}.ssv"] = values_description(component, structure.version)
    with atomic_target(file) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, content in held.items():
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED if isinstance(content, bytes) else zipfile.ZIP_STORED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content if isinstance(content, bytes) else content.read_bytes())


# ---- parts ----


def _cut(diagram: Diagram, parts: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Return the blocks of every part and of the rest."""
    hint = "letters, digits and _, not a digit first"
    problems = [Problem("is not a name", name, hint=hint) for name in parts if not _NAME.fullmatch(name)]
    taken = [block for blocks in parts.values() for block in blocks]
    for block in dict.fromkeys(taken):
        if block not in diagram.nodes:
            problems.append(Problem("no such block", block, hint=near_miss(block, diagram.nodes)))
        elif taken.count(block) > 1:
            problems.append(Problem("is in the parts twice", block))
        elif diagram.nodes[block].block.opaque:
            problems.append(Problem("is an FMU, and goes into the archive as it is", block, hint="name it in no part"))
    problems += [Problem("the part has no blocks", name) for name, blocks in parts.items() if not blocks]
    rest = [name for name, node in diagram.nodes.items() if name not in taken and not node.block.opaque]
    if rest and REST in parts:
        problems.append(Problem(f"the blocks that no part names are called '{REST}'", REST, hint="take another name"))
    if problems:
        raise RotorsimError(*problems)
    return {name: list(blocks) for name, blocks in parts.items()} | ({REST: rest} if rest else {})


def _foreign(diagram: Diagram, cut: Mapping[str, Any]) -> dict[str, str]:
    """Return the component of every block of type fmu."""
    found: dict[str, str] = {}
    for block, node in diagram.nodes.items():
        if node.block.opaque:
            name = re.sub(r"\W", "_", block)
            while name in cut or name in found.values():
                name += "_"
            found[block] = name
    return found


def _fmu(node: Node) -> Any:
    """Return the block of an FMU, with the attributes that `rotorsim.fmi.block` gives it."""
    return node.block


class _Wiring:
    """Finds the connection to every input entry; what SSP cannot say goes to ``problems``."""

    def __init__(self, diagram: Diagram, cut: Mapping[str, Sequence[str]], foreign: Mapping[str, str]) -> None:
        self.diagram, self.foreign = diagram, foreign
        self.owners = {block: name for name, blocks in cut.items() for block in blocks} | dict(foreign)
        self.problems: list[Problem] = []
        self.entries: dict[str, str] = {}  # flat name of an output entry of an FMU -> its own name
        for block in foreign:
            for port in _fmu(diagram.nodes[block]).fmu_outputs.values():
                self.entries.update(zip(entry_names(f"{block}.{port.name}", port.shape), port.entries, strict=True))

    def into_part(self, name: str, interface: Interface) -> Iterator[Connection]:
        """Yield the connections to a part: its inputs have the names of the outputs that feed them."""
        for port, signal in interface.part.inputs.items():
            for entry in entry_names(port, signal.shape):
                yield Connection(self._source(entry), End(name, _shown(entry)))

    def into_fmu(self, block: str) -> Iterator[Connection]:
        """Yield the connections to an FMU of the diagram."""
        found = _fmu(self.diagram.nodes[block])
        wired = {wire.target.port for wire in self.diagram.wires if wire.target.block == block}
        for port in found.fmu_inputs.values():
            if port.name not in wired:
                continue
            for entry, own in zip(entry_names(f"{block}.{port.name}", port.shape), port.entries, strict=True):
                sources = sources_of(self.diagram, entry)
                if len(sources) > 1:
                    what = f"{len(sources)} outputs add up here, and SSP allows one connection to an input"
                    self.problems.append(Problem(what, entry, hint="add them up in a sum block"))
                elif sources:
                    yield Connection(self._source(sources[0]), _end(self.foreign[block], found.fmu_description, own))

    def _source(self, entry: str) -> End:
        block = entry.partition("[")[0].rpartition(".")[0]
        if block in self.foreign:
            return _end(self.foreign[block], _fmu(self.diagram.nodes[block]).fmu_description, self.entries[entry])
        return End(self.owners[block], _shown(entry))


def _shown(entry: str) -> str:
    """Return the name of an entry in an exported FMU: blocks of sub-diagrams are levels of it."""
    return entry.replace("/", ".")


def _end(component: str, description: ModelDescription, own: str) -> End:
    """Return an end at an entry of an FMU: a scalar, or an entry of an array."""
    entry = description.resolve([own])[0]
    return End(component, entry.variable.name, entry.indices or None)


# ---- components ----


def _connectors(interface: Interface) -> tuple[Connector, ...]:
    return tuple(
        Connector(name, "input" if variable.role == INPUT else "output", "Float64", _unit(variable))
        for variable in interface.of_role(INPUT, OUTPUT)
        for name, _, _ in variable.entries()
    )


def _settings(interface: Interface) -> tuple[Setting, ...]:
    return tuple(
        Setting(name, "Float64", (float(variable.start[k]),), _unit(variable))
        for variable in interface.of_role(PARAMETER)
        if variable.start is not None
        for name, _, k in variable.entries()
    )


def _unit(variable: Variable) -> FmuUnit | None:
    if not variable.unit:
        return None
    unit = parse_unit(variable.unit)
    powers = {base: power for base, power in zip(BASES, unit.dimension, strict=True) if power}
    return FmuUnit(variable.unit, unit.factor, powers=powers)


def _foreign_component(name: str, diagram: Diagram, block: str) -> Component:
    """Return the component of a block of type fmu: its ports, and what differs from the FMU's start values."""
    node = diagram.nodes[block]
    found = _fmu(node)
    description: ModelDescription = found.fmu_description
    wired = {wire.target.port for wire in diagram.wires if wire.target.block == block}
    connectors: dict[str, Connector] = {}
    for kind, ports in (("input", found.fmu_inputs), ("output", found.fmu_outputs)):
        for port in ports.values():
            for entry in description.resolve(port.entries):
                v = entry.variable
                connectors[v.name] = Connector(v.name, kind, v.type, description.unit_of(v), v.dimensions)
    free = {key: port for key, port in found.fmu_inputs.items() if key not in wired}
    settings: dict[str, Setting] = {}
    for key, port in {**found.fmu_parameters, **free}.items():
        if key in node.values and port.start is not None:
            settings.update(_changed(description, port, np.ravel(node.values[key])))
    interface = "" if found.option.interface == "any" else str(found.option.interface)
    return Component(name, f"resources/{name}.fmu", tuple(connectors.values()), tuple(settings.values()), interface)


def _changed(description: ModelDescription, port: FmuPort, values: np.ndarray) -> Iterator[tuple[str, Setting]]:
    """Yield the variables of a port that differ from their start: arrays as a whole."""
    if port.start is None or np.array_equal(values, np.ravel(port.start)):
        return
    given: dict[str, dict[int, float]] = {}
    variables: dict[str, FmuVariable] = {}
    for entry, value in zip(description.resolve(port.entries), port.of_fmu(values), strict=True):
        variables[entry.variable.name] = entry.variable
        given.setdefault(entry.variable.name, {})[entry.index] = float(value)
    for name, entries in given.items():
        v = variables[name]
        numbers = tuple(entries[k] for k in range(v.size))
        whole = numbers if v.type.startswith("Float") else tuple(int(number) for number in numbers)
        yield name, Setting(name, v.type, whole, description.unit_of(v), v.dimensions)
