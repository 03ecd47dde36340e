"""Write the files that ``to_file`` blocks of a diagram ask for."""

from __future__ import annotations

from pathlib import Path

from rotorsim.diagram.diagram import Diagram
from rotorsim.simulate.files import save
from rotorsim.simulate.result import Result

__all__ = ["write_sinks"]


def write_sinks(diagram: Diagram, result: Result) -> list[Path]:
    """Write the signals wired to every ``to_file`` block into its file; return the files.

    They lie in the folder of the diagram (a diagram in memory: the current folder); a name that leaves it
    is refused when the diagram is loaded.
    """
    folder = Path(diagram.file).parent if diagram.file else Path()
    written = []
    for name, node in diagram.nodes.items():
        if node.block.type_name != "to_file":
            continue
        sources = {wire.target.port: str(wire.source) for wire in diagram.wires if wire.target.block == name}
        signals = {port: result[source] for port, source in sources.items() if source in result}
        units = {port: result.units.get(sources[port], "") for port in signals}
        part = Result(result.time, signals, units, result.status, result.message, result.counters, result.provenance)
        path = folder / str(node.block.option.file)
        save(part, path)
        written.append(path)
    return written
