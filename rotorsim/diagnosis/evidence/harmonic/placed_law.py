"""Where a law enters a diagram: what drives it, what it moves, and what recordings read of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorsim.block import In, size_of
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagram.diagram import Diagram
from rotorsim.linear.linearisation import entry_names
from rotorsim.linear.loop import part_of_port

ADDING = ("force", "shaft", "wire", "reading")  # the ways to enter by which a law adds to what is there


@dataclass(frozen=True, eq=False)
class PlacedLaw:
    """A law where it enters a diagram.

    values: of its parameters and options. inputs: of each port, the flat names of its source; shapes: of these ports.
    outputs: port and entry of all that acts somewhere. moved: of each output, the entries of inputs of the diagram that
    it moves; read: the recorded signals; taken: the flat name of the signal whose place it takes, empty where it is
    added.
    """

    item: Insertion
    values: Mapping[str, Any]
    inputs: Mapping[str, tuple[str, ...]]
    shapes: Mapping[str, tuple[int, ...]]
    outputs: tuple[tuple[str, int], ...]
    moved: tuple[tuple[str, ...], ...]
    read: tuple[tuple[str, ...], ...]
    taken: tuple[str, ...]

    @property
    def sources(self) -> list[str]:
        """The flat names of the signals that drive it, port by port, and then of others whose place it takes."""
        driving = [name for own in self.inputs.values() for name in own]
        return [*driving, *dict.fromkeys(name for name in self.taken if name and name not in driving)]

    def document(self, values: Mapping[str, float], limits: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
        """Return the document of a diagram of the law alone, driven by recorded signals; values: some parameters."""
        driving = {port: (port, shape) for port, shape in self.shapes.items()}
        return self.item.alone({**self.values, **values}, limits, driving, self.outputs[0][0])


def placed_law(diagram: Diagram, item: Insertion) -> PlacedLaw | None:
    """Return a law where it enters a diagram; None where it does not add a signal to what is there.

    An input that had no wire, an effect that moves along the shaft, and a shaft that turns otherwise are more.
    """
    if item.fault.enters == "replace":
        return _in_place(diagram, item)
    turned = any(diagram.nodes[source.partition(".")[0]].block.category == "clock" for source, _ in item.cut)
    if item.fault.enters not in ADDING or turned:
        return None
    own, cut = f"{item.name}.", {target for _, target in item.cut}
    ends: dict[str, tuple[list[list[str]], list[list[str]]]] = {}  # of each output: what it moves, what reads it
    for source, target in item.wires:
        if source.startswith(own):
            declared = _port(diagram, target).declaration
            if target not in cut and not (isinstance(declared, In) and declared.additive):
                return None
            ends.setdefault(source.removeprefix(own), ([], []))[0].append(entries_of(diagram, target))
    for said, output in item.measured.items():
        ends.setdefault(output.removeprefix(own), ([], []))[1].append(entries_of(diagram, said))
    wires = {target.removeprefix(own): source for source, target in item.wires if target.startswith(own)}
    inputs = {key: tuple(entries_of(diagram, source)) for key, source in wires.items()}
    shapes = {key: _port(diagram, source).shape[_depth(source) :] for key, source in wires.items()}
    through = {output: key for key, output in item.fault.through.items()}
    outputs, moved, read, taken = [], [], [], []
    for port, (targets, channels) in ends.items():
        count = len((*targets, *channels)[0])
        replaced = inputs.get(through[port], ()) if port in through else ("",) * count
        if any(len(one) != count for one in (*targets, *channels, replaced)):
            return None
        for k in range(count):
            outputs.append((port, k))
            moved.append(tuple(one[k] for one in targets))
            read.append(tuple(one[k] for one in channels))
            taken.append(replaced[k])
    return PlacedLaw(item, item.values, inputs, shapes, tuple(outputs), tuple(moved), tuple(read), tuple(taken))


def _in_place(diagram: Diagram, item: Insertion) -> PlacedLaw | None:
    """Return a law that takes the place of a block; None where an input of that has no wire of its own, or several."""
    node, kind = diagram.nodes[item.name], item.kind
    values = {key: np.asarray(value).tolist() for key, value in node.values.items() if key in kind.parameters}
    values |= {key: value for key, value in vars(node.block.option).items() if key in kind.options}
    wires: dict[str, str] = {}
    for wire in diagram.wires:
        if wire.target.block == item.name:
            if wire.target.port in wires or wire.target.index or wire.target.port not in kind.inputs:
                return None
            wires[wire.target.port] = str(wire.source)
    moved: dict[str, list[str]] = {}  # of each entry of the outputs
    for wire in diagram.wires:
        if wire.source.block == item.name:
            pairs = zip(entries_of(diagram, str(wire.source)), entries_of(diagram, str(wire.target)), strict=True)
            for name, target in pairs:
                moved.setdefault(name, []).append(target)
    ports = [port for port in node.outputs if port in kind.outputs]
    taken = [name for port in ports for name in entries_of(diagram, f"{item.name}.{port}")]
    outputs = [(port, k) for port in ports for k in range(size_of(node.outputs[port].shape))]
    inputs = {key: tuple(entries_of(diagram, source)) for key, source in wires.items()}
    shapes = {key: _port(diagram, source).shape[_depth(source) :] for key, source in wires.items()}
    targets = tuple(tuple(moved.get(name, ())) for name in taken)
    read = tuple((name,) for name in taken)
    return PlacedLaw(item, {**values, **item.values}, inputs, shapes, tuple(outputs), targets, read, tuple(taken))


def entries_of(diagram: Diagram, end: str) -> list[str]:
    """Return the flat names of the entries of a port, or of a part of it ("rotor.force[3]")."""
    base, places = part_of_port(diagram, end.replace(" ", ""))
    names = entry_names(base, _port(diagram, base).shape)
    return [names[k] for k in places]


def _depth(end: str) -> int:
    """Return how many dimensions of a port an end of a wire picks an entry of."""
    return end.count(",") + 1 if "[" in end else 0


def _port(diagram: Diagram, end: str) -> Any:
    block, _, port = end.replace(" ", "").partition("[")[0].rpartition(".")
    node = diagram.nodes[block]
    return node.outputs[port] if port in node.outputs else node.inputs[port]
