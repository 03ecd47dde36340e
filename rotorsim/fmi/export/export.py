"""Export a diagram or some of its blocks as an FMU: model exchange and co-simulation in one file."""

from __future__ import annotations

import uuid
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, escape, near_miss
from rotorsim.files import atomic_target
from rotorsim.fmi.description.platforms import library_folder
from rotorsim.fmi.export.build import build_library, find_platforms, suffix_of
from rotorsim.fmi.export.nested import carried_files, check_platforms, interface_of, why_not_nested
from rotorsim.fmi.export.sources import make_sources, with_token
from rotorsim.fmi.export.stepped import with_steps
from rotorsim.fmi.export.variables import Interface, make_interface
from rotorsim.fmi.export.writer import build_description, model_description
from rotorsim.model.emit.toolchain import FLAGS
from rotorsim.model.part import open_part

VERSIONS = ("2.0", "3.0")
_NAMESPACE = uuid.UUID("6c0b7b0e-7f55-4d0c-9a53-0f0a2f6e4c11")  # of the tokens: one content, one token
_DATE = (1980, 1, 1, 0, 0, 0)  # of files in the archive: the same export gives the same bytes


@dataclass(frozen=True)
class Exported:
    """What was written: the file, its interface, the size of the library of every platform [bytes]; what is odd."""

    file: Path
    version: str
    token: str
    interface: Interface
    libraries: dict[str, int]
    warnings: tuple[Problem, ...] = ()


def export_fmu(
    diagram: Diagram,
    file: str | Path,
    *,
    blocks: Iterable[str] | None = None,
    version: str = "2.0",
    platforms: Sequence[str] | None = None,
    arrays: bool = False,
    inputs: Iterable[str] = (),
    outputs: Sequence[str] | None = None,
    fixed: bool = False,
    by_source: bool = False,
) -> Exported:
    """Write a diagram, or some of its blocks, as an FMU for model exchange and co-simulation.

    blocks: default all; what crosses their boundary becomes an input. inputs: further input ports, unwired or
    additive ones. outputs: signals; default: what the diagram records, or every output port of the blocks.
    version: "2.0" or "3.0". platforms: "x86_64-linux", "win64", ...; default this one; () for sources only.
    arrays: array variables (3.0). fixed: parameters cannot change after initialisation. by_source: one input for each
    output port outside that feeds the blocks, under its name, instead of the sum of what an additive port gets.

    Co-simulation takes the diagram's own step, Runge-Kutta of order 4. The same diagram gives the same bytes.
    FMUs among the blocks go along in the resources, and their code runs where the export does; those for
    Co-Simulation step with the diagram.
    Raises RotorsimError.
    """
    wanted_inputs = list(dict.fromkeys(inputs))
    chosen = list(diagram.nodes) if blocks is None else list(dict.fromkeys(blocks))
    _check(diagram, chosen, version, arrays, wanted_inputs)
    wanted = find_platforms(platforms)
    opaque = [name for name in chosen if diagram.nodes[name].block.opaque]
    hidden = [name for name in opaque if interface_of(diagram.nodes[name].block) == "cs"]
    part = open_part(with_steps(diagram, hidden), chosen, inputs=wanted_inputs, by_source=by_source)
    interface = make_interface(part, outputs=outputs, arrays=arrays, fixed=fixed)
    check_platforms(interface.nested, wanted)
    draft, optimise = make_sources(interface, version)
    main = next(iter(draft))
    content = b"".join([*draft.values(), model_description(interface, version, "", [main])])
    token = "{" + str(uuid.uuid5(_NAMESPACE, content.hex())) + "}"
    sources = with_token(draft, token)
    files = {"modelDescription.xml": model_description(interface, version, token, [main])}
    libraries = {}
    for platform in wanted:
        library = build_library(sources, platform, optimise)
        folder = library_folder(platform, version)
        libraries[folder] = len(library)
        files[f"binaries/{folder}/{interface.identifier}{suffix_of(platform)}"] = library
    files |= {f"sources/{name}": text for name, text in sources.items()}
    if version == "3.0":
        options = " ".join([optimise, *(flag for flag in FLAGS if flag.startswith("-f") and flag != "-fPIC")])
        files["sources/buildDescription.xml"] = build_description(interface, [main], options)
    files |= carried_files(interface.nested)
    files["documentation/index.html"] = _documentation(interface, main, optimise).encode()
    path = Path(file)
    size = sum(map(len, files.values()))
    with atomic_target(path, size=size) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return Exported(path, version, token, interface, libraries, _oddities(diagram, hidden))


def _check(diagram: Diagram, blocks: Sequence[str], version: str, arrays: bool, inputs: Sequence[str]) -> None:
    unknown = [block for block in blocks if block not in diagram.nodes]
    ports = {f"{b}.{name}": port for b in blocks if b not in unknown for name, port in diagram.nodes[b].inputs.items()}
    additive = [name for name, port in ports.items() if getattr(port.declaration, "additive", False)]
    problems = [
        *(
            []
            if version in VERSIONS
            else [Problem(f"unknown version of FMI '{version}'", hint=f"one of {', '.join(VERSIONS)}")]
        ),
        *(
            [Problem("FMI 2.0 has no arrays", hint="export as FMI 3.0, or without arrays")]
            if arrays and version == "2.0"
            else []
        ),
        *(Problem("no such block", block, hint=near_miss(block, diagram.nodes)) for block in unknown),
        *why_not_nested(diagram, [block for block in blocks if block not in unknown]),
    ]
    for name in (name for name in inputs if name not in additive):
        feeding = [w.source.block for w in diagram.wires if f"{w.target.block}.{w.target.port}" == name]
        hint = f"leave out block {feeding[0]}, and it becomes an input" if feeding else "wire it"
        if name in ports:
            problems.append(Problem("no value can be added to this input port", name, hint=hint))
        else:
            problems.append(Problem("no such additive input port", name, hint=near_miss(name, additive)))
    if problems:
        raise RotorsimError(*problems)


def _oddities(diagram: Diagram, hidden: Sequence[str]) -> tuple[Problem, ...]:
    solver = diagram.solver
    costs = f"is stepped by {solver.step:g} s with held inputs, which costs accuracy"
    hint = "`rotorsim run` of the diagram tells how much; a smaller step of the diagram costs less"
    found = tuple(Problem(costs, name, hint=hint, severity="warning") for name in hidden)
    if solver.method == "rk4":
        return found
    what = f"co-simulation steps by Runge-Kutta of order 4 and {solver.step:g} s, not by {solver.method}"
    hint = "check that this step is small enough, or use model exchange"
    return (*found, Problem(what, diagram.name, hint=hint, severity="warning"))


def _documentation(interface: Interface, main: str, optimise: str) -> str:
    """Return documentation/index.html."""
    diagram = interface.part.diagram
    words = diagram.document.get("description")
    what = escape(words) if isinstance(words, str) else ""
    libraries = "-lm -ldl" if interface.nested else "-lm"
    command = f"cc {' '.join(FLAGS)} {optimise} sources/{main} -o {interface.identifier}.so {libraries}"
    inside = [f"{one.block}: {one.kind.identifier} (FMI {one.description.version})" for one in interface.nested]
    held = f"<p>FMUs inside, in resources: {escape(', '.join(inside))}.</p>\n" if inside else ""
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(diagram.name)}</title></head><body>
<h1>{escape(diagram.name)}</h1>
<p>{what}</p>
<p>Blocks: {escape(", ".join(interface.part.blocks))}. All quantities are in SI units.</p>
{held}<p>Co-simulation steps by {diagram.solver.step!r} s (Runge-Kutta of order 4), inputs held unless their derivatives
are set; a communication step that is no multiple of it is cut into equal steps not above it. Sampled blocks act at
their hits exactly, those at the end of a step with the inputs of that step.</p>
<p>Library from the sources: <code>{escape(command)}</code></p>
</body></html>
"""
