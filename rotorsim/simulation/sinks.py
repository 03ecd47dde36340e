"""Write the files that ``to_file`` blocks of a diagram ask for."""

from __future__ import annotations

from pathlib import Path

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.simulation.files import save
from rotorsim.simulation.result import Result


def check_sinks(diagram: Diagram) -> list[tuple[str, Path]]:
    """Return block and file of every ``to_file`` block. Raises RotorsimError where a file cannot be written there.

    A file lies inside the folder of the diagram (a diagram in memory: the current folder). A name that leaves it is
    refused when the diagram is loaded; a link of the disk that leaves it is refused here, before the run and after.
    """
    folder = Path(diagram.file).parent if diagram.file else Path()
    found: list[tuple[str, Path]] = []
    problems: list[Problem] = []
    for name, node in diagram.nodes.items():
        if node.block.type_name != "to_file":
            continue
        path = folder / str(node.block.option.file)
        found.append((name, path))
        real, inside = path.parent.resolve(), folder.resolve()
        if real != inside and inside not in real.parents:
            what = f"file {path} lies outside the folder of the diagram: a link leads to {real}"
            problems.append(Problem(what, name, hint="name a folder that is no link, or copy the file afterwards"))
        elif not real.is_dir():
            problems.append(Problem(f"folder {path.parent} does not exist", name, hint="create it first"))
    if problems:
        raise RotorsimError(*problems)
    return found


def write_sinks(diagram: Diagram, result: Result) -> list[Path]:
    """Write the signals wired to every ``to_file`` block into its file; return the files. Raises RotorsimError."""
    written = []
    for name, path in check_sinks(diagram):
        sources = {wire.target.port: str(wire.source) for wire in diagram.wires if wire.target.block == name}
        signals = {port: result[source] for port, source in sources.items() if source in result}
        units = {port: result.units.get(sources[port], "") for port in signals}
        part = Result(result.time, signals, units, result.status, result.message, result.counters, result.provenance)
        save(part, path)
        written.append(path)
    return written
