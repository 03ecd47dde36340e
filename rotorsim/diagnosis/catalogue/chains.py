"""What stands in the wires of a diagram already: chains of faults between a signal, its recording, and its takers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import networkx as nx

from rotorsim.diagram.diagram import Diagram, Endpoint, Wire

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
    """Follows signals through blocks that stand in wires, as their faults declare it (`rotorsim.fault.Fault`)."""

    def __init__(self, diagram: Diagram) -> None:
        self.diagram = diagram
        self._wires: dict[Endpoint, list[Wire]] = {}
        for wire in diagram.wires:
            self._wires.setdefault(wire.source, []).append(wire)

    def of(self, start: Endpoint, category: str) -> Chain:
        """Return the chain behind a signal, as far as a recording of it reaches."""
        goal = self.diagram.measured.get(start, start)
        path = next((path for path in self._paths(start, frozenset()) if path[-1] == goal), None)
        if path is None:  # a sensor of the user's own
            in_loop = bool(self.targets(goal, category))
            return Chain(start, (), goal if in_loop else start, None if in_loop else self._toward(start, goal))
        last = max((k for k, end in enumerate(path) if self.targets(end, category)), default=len(path) - 1)
        blocks = (*(end.block for end in path[1:]), None)
        return Chain(start, tuple(end.block for end in path[1 : last + 1]), path[last], blocks[last])

    def end(self, start: Endpoint) -> Endpoint:
        """Return a signal as all blocks get it: behind those that took over every wire from it."""
        at, passed = start, {start}
        while len(self._wires.get(at, [])) == 1:
            onward = self._onward(at)
            if not onward or onward[0] in passed:
                break
            [at] = onward
            passed.add(at)
        return at

    def beside(self, start: Endpoint, blocks: Sequence[str]) -> Endpoint:
        """Return where another signal comes to that goes through the same blocks."""
        at = start
        for block in blocks:
            at = next((end for end in self._onward(at) if end.block == block), at)
        return at

    def targets(self, source: Endpoint, category: str) -> list[Wire]:
        """Return the wires from a signal that lead to a block of a category, at once or through a chain."""
        wires = self._wires.get(source, [])
        return [wire for wire in wires if any(self._is_of(category, one) for one in self._behind(wire, frozenset()))]

    def taker(self, source: Endpoint, category: str) -> Endpoint | None:
        """Return the port of a category that a signal leads to; None where any category may take it."""
        behind = (one for wire in self._wires.get(source, []) for one in self._behind(wire, frozenset()))
        return next((one.target for one in behind if category != ANY and self._is_of(category, one)), None)

    def wires_to(self, source: Endpoint, block: str | None) -> list[Wire]:
        """Return the wires from a signal to a block."""
        return [wire for wire in self._wires.get(source, []) if wire.target.block == block]

    def _is_of(self, category: str, wire: Wire) -> bool:
        return category == ANY or category in self.diagram.nodes[wire.target.block].block.roles

    def _behind(self, wire: Wire, passed: frozenset[str]) -> Iterator[Wire]:
        """Yield a wire and those that its signal goes through behind blocks in wires."""
        yield wire
        output, block = self._output(wire.target), wire.target.block
        if output is not None and block not in passed:
            for onward in self._wires.get(output, []):
                yield from self._behind(onward, passed | {block})

    def _paths(self, start: Endpoint, passed: frozenset[str]) -> Iterator[list[Endpoint]]:
        """Yield every sequence of signals from one on, each behind a block in a wire of the one before."""
        yield [start]
        for end in self._onward(start):
            if end.block not in passed:
                yield from ([start, *path] for path in self._paths(end, passed | {end.block}))

    def _toward(self, start: Endpoint, goal: Endpoint) -> str | None:
        """Return the block that takes a signal on its way to another, not through the block that gives it."""
        if goal.block == start.block:
            return None
        others = nx.subgraph_view(self.diagram.graph, filter_node=lambda block: block != start.block)
        takers = (wire.target.block for wire in self._wires.get(start, []) if wire.target.block != start.block)
        return next((block for block in takers if nx.has_path(others, block, goal.block)), None)

    def _onward(self, source: Endpoint) -> list[Endpoint]:
        """Return the signals behind the blocks that stand in the wires from a signal."""
        outputs = (self._output(wire.target) for wire in self._wires.get(source, []))
        return [output for output in outputs if output is not None]

    def _output(self, target: Endpoint) -> Endpoint | None:
        """Return what a block in a wire makes of an input, or None if it is no such block."""
        for fault in self.diagram.nodes[target.block].block.faults:
            if target.port in fault.through and not target.index:
                return Endpoint(target.block, fault.through[target.port])
        return None
