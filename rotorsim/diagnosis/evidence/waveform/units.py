"""Which recorded units stand for those that a block declares, where a recording is in other ones (volts for metres)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rotorsim.diagram.diagram import Diagram, Port
from rotorsim.units import compatible


def stand_ins(diagram: Diagram, inserted: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """Return sentences about blocks that were put in; units: of recorded signals."""
    text = []
    for block in inserted:
        stands = {
            port.unit: f"{port.unit} stands for the {units[signal]} of {signal}"
            for port, signal in _neighbours(diagram, block)
            if port.unit and signal in units and compatible(units[signal], port.unit) not in ("same", "scaled")
        }
        text += [f"{block} has the units of a machine: {' and '.join(stands.values())}."] if stands else []
    return text


def _neighbours(diagram: Diagram, name: str) -> list[tuple[Port, str]]:
    """Return each port of a block with the signals that it takes, or that act where its output acts."""
    nodes, wires = diagram.nodes, diagram.wires
    taken = [(nodes[name].inputs[wire.target.port], wire.source) for wire in wires if wire.target.block == name]
    own = [wire for wire in wires if wire.source.block == name]
    beside = [(wire, other.source) for wire in own for other in wires if other.target == wire.target]
    acting = [(nodes[name].outputs[wire.source.port], end) for wire, end in beside if end.block != name]
    return [(port, f"{end.block}.{end.port}") for port, end in taken + acting]
