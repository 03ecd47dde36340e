"""Sub-diagrams as one block each: their ports, and the wires outside of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from rotorsim.diagram.diagram import Diagram, Endpoint, Port
from rotorsim.diagram.parse.document import endpoint

Exposed = dict[tuple[str, str, str], list[tuple[str, str]]]


@dataclass(frozen=True)
class Part:
    """A sub-diagram as a block: its flat name, what it is, and its ports, with shapes and units as inside."""

    name: str
    kind: str
    inputs: Mapping[str, Port]
    outputs: Mapping[str, Port]


def closed_parts(diagram: Diagram, opened: Collection[str]) -> dict[str, Part]:
    """Return the outermost sub-diagrams that are not opened."""
    shut = [name for name in diagram.sub_ports if name not in opened]
    outermost = [name for name in shut if not any(name.startswith(f"{other}/") for other in shut)]
    return {name: _part(diagram, name) for name in outermost}


def _part(diagram: Diagram, name: str) -> Part:
    ports = diagram.sub_ports[name]
    inputs = {port: _port(diagram, name, port, ends[0], True) for port, ends in ports.inputs.items() if ends}
    outputs = {port: _port(diagram, name, port, end, False) for port, end in ports.outputs.items()}
    entry = diagram.document.get("blocks", {}).get(name, {})
    kind = f"diagram: {entry['file']}" if isinstance(entry.get("file"), str) else "diagram"
    return Part(name, kind, _there(inputs), _there(outputs))


def _there(ports: Mapping[str, Port | None]) -> dict[str, Port]:
    return {name: port for name, port in ports.items() if port is not None}


def _port(diagram: Diagram, part: str, name: str, end: Endpoint, is_input: bool) -> Port | None:
    node = diagram.nodes.get(end.block)
    inner = None if node is None else (node.inputs if is_input else node.outputs).get(end.port)
    return inner and Port(part, name, inner.shape[len(end.index) :], inner.unit, inner.declaration)


def exposed_ports(document: Mapping[str, Any]) -> Exposed:
    """Return the ports of a diagram by what they lead to: (side, block, port) -> names, and ends as written."""
    found: Exposed = {}
    for side, ends in document.get("ports", {}).items():
        for name, written in ends.items():
            for text in written if isinstance(written, list) else [written]:
                end = endpoint(text)
                if end is not None:
                    found.setdefault((side, end.block, end.port), []).append((name, text))
    return found


def inside(block: str, parts: Collection[str]) -> str:
    """Return the closed sub-diagram that a block is in, "" for none."""
    return next((part for part in parts if block.startswith(f"{part}/")), "")


def wires_outside(diagram: Diagram, parts: Mapping[str, Part]) -> list[tuple[Endpoint, Endpoint]]:
    """Return source and target of every wire that is seen: as written where both ends are blocks of the document.

    Ends inside a closed sub-diagram of an opened one are those of its ports.
    """
    found: list[tuple[Endpoint, Endpoint]] = []
    shown = {*parts, *diagram.nodes}
    for first, last in diagram.document.get("wires", []):
        source, target = endpoint(first), endpoint(last)
        if source is not None and target is not None and source.block in shown and target.block in shown:
            found.append((source, target))
    as_written = {name for name in parts if "/" not in name} | {name for name in diagram.nodes if "/" not in name}
    for wire in diagram.wires:
        if {wire.source.block.partition("/")[0], wire.target.block.partition("/")[0]} <= as_written:
            continue
        within = inside(wire.source.block, parts), inside(wire.target.block, parts)
        if within[0] and within[0] == within[1]:
            continue
        source = _outer(diagram, within[0], wire.source, is_input=False)
        target = _outer(diagram, within[1], wire.target, is_input=True)
        if source is not None and target is not None:
            found.append((source, target))
    return list(dict.fromkeys(found))


def _outer(diagram: Diagram, part: str, end: Endpoint, *, is_input: bool) -> Endpoint | None:
    """Return an end as it is seen from outside of a sub-diagram; None where no port leads there."""
    if not part:
        return end
    ports = diagram.sub_ports[part]
    named = [*ports.inputs.items()] if is_input else [(name, [one]) for name, one in ports.outputs.items()]
    for name, ends in named:
        for one in ends:
            if (one.block, one.port) == (end.block, end.port) and end.index[: len(one.index)] == one.index:
                return Endpoint(part, name, end.index[len(one.index) :])
    return None
