"""What stands in the wires of a diagram already: chains of faults between a signal, its recording, and its takers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import networkx as nx

from rotorsim.diagram.diagram import Diagram, Endpoint, Wire

__all__ = ["Chain", "Chains"]

ANY = "*"  # category of every block


@dataclass(frozen=True)
class Chain:
    """From a signal ``start`` through blocks to ``tap``, from where it goes to a category.

    next: of the blocks that only the recording sees, the first after the tap.
    """

    start: Endpoint
    blocks: tuple[str, ...]
    tap: Endpoint
    next: str | None = None


class Chains:
    """Looks through blocks that stand in wires, as their faults declare it (`rotorsim.fault.Fault.through`)."""

    def __init__(self, diagram: Diagram) -> None:
        self.diagram = diagram
        self._from: dict[Endpoint, list[Wire]] = {}
        for wire in diagram.wires:
            self._from.setdefault(wire.source, []).append(wire)

    def of(self, start: Endpoint, category: str) -> Chain:
        """Return the chain behind a signal, as far as a recording of it reaches."""
        goal = self.diagram.measured.get(start, start)
        path = self._path(start, goal, frozenset())
        if path is None:  # a sensor of the user's own
            in_loop = bool(self.targets(goal, category))
            return Chain(start, (), goal if in_loop else start, None if in_loop else self._toward(start, goal))
        last = max((k for k, end in enumerate(path) if self.targets(end, category)), default=len(path) - 1)
        blocks = tuple(end.block for end in path[1:])
        following = blocks[last] if last < len(blocks) else None
        return Chain(start, blocks[:last], path[last], following)

    def end(self, start: Endpoint) -> Endpoint:
        """Return a signal as all blocks get it: behind those that took over every wire from it."""
        at, passed = start, {start}
        while True:
            onward = self._onward(at)
            if len(onward) != 1 or len(self._from[at]) != 1 or onward[0] in passed:
                return at
            at = onward[0]
            passed.add(at)

    def beside(self, start: Endpoint, blocks: Sequence[str]) -> Endpoint:
        """Return where another signal comes to that goes through the same blocks."""
        at = start
        for block in blocks:
            at = next((end for end in self._onward(at) if end.block == block), at)
        return at

    def targets(self, source: Endpoint, category: str) -> list[Wire]:
        """Return the wires from a signal that lead to a block of a category, at once or through a chain."""
        return [wire for wire in self._from.get(source, []) if self._leads(wire, category, frozenset())]

    def taker(self, source: Endpoint, category: str) -> Endpoint | None:
        """Return the port of a category that a signal leads to; None where any category may take it."""
        for wire in self.targets(source, category) if category != ANY else ():
            if self.diagram.nodes[wire.target.block].block.category == category:
                return wire.target
            return self.taker(cast(Endpoint, self._output(wire.target)), category)
        return None

    def wires_to(self, source: Endpoint, block: str | None) -> list[Wire]:
        """Return the wires from a signal to a block."""
        return [wire for wire in self._from.get(source, []) if wire.target.block == block]

    def _leads(self, wire: Wire, category: str, passed: frozenset[str]) -> bool:
        block = wire.target.block
        if category in (ANY, self.diagram.nodes[block].block.category):
            return True
        output = self._output(wire.target)
        if output is None or block in passed:
            return False
        return any(self._leads(onward, category, passed | {block}) for onward in self._from.get(output, []))

    def _path(self, start: Endpoint, goal: Endpoint, passed: frozenset[str]) -> list[Endpoint] | None:
        """Return the signals from start to goal, each behind a block in a wire of the one before."""
        if start == goal:
            return [start]
        for end in self._onward(start):
            rest = None if end.block in passed else self._path(end, goal, passed | {end.block})
            if rest is not None:
                return [start, *rest]
        return None

    def _toward(self, start: Endpoint, goal: Endpoint) -> str | None:
        """Return the block that takes a signal on its way to another, not through the block that gives it."""
        if goal.block == start.block:
            return None
        others = nx.subgraph_view(self.diagram.graph, filter_node=lambda block: block != start.block)
        takers = (wire.target.block for wire in self._from.get(start, []) if wire.target.block != start.block)
        return next((block for block in takers if nx.has_path(others, block, goal.block)), None)

    def _onward(self, source: Endpoint) -> list[Endpoint]:
        """Return the signals behind the blocks that stand in the wires from a signal."""
        found = (self._output(wire.target) for wire in self._from.get(source, []))
        return [end for end in found if end is not None]

    def _output(self, target: Endpoint) -> Endpoint | None:
        """Return what a block in a wire makes of an input, or None if it is no such block."""
        for fault in self.diagram.nodes[target.block].block.faults:
            if target.port in fault.through and not target.index:
                return Endpoint(target.block, fault.through[target.port])
        return None
