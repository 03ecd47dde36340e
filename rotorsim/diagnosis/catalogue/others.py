"""The signals of a diagram that what is missing at a place may depend on: one of those that differ by a factor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import networkx as nx

from rotorsim.diagram.diagram import Diagram, Endpoint, Wire
from rotorsim.model.trace.order import block_traces, feedthrough_graph


class OtherSignals:
    """Scalar signals of a diagram that are taken or recorded, and what follows from them at once.

    A gain only changes the size: behind it is the same signal.
    """

    def __init__(self, diagram: Diagram, recorded: Iterable[str]) -> None:
        self.diagram, self.recorded = diagram, frozenset(recorded)
        self._into = {(wire.target.block, wire.target.port): wire.source for wire in diagram.wires}

    @cached_property
    def _signals(self) -> list[Endpoint]:
        sources = {wire.source for wire in self.diagram.wires}
        ports = (port for node in self.diagram.nodes.values() for port in node.outputs.values() if port.shape == ())
        ends = (Endpoint(port.block, port.name) for port in ports)
        return [end for end in ends if (end in sources or str(end) in self.recorded) and self._origin(end) == end]

    @cached_property
    def _at_once(self) -> nx.DiGraph:
        traces = block_traces(self.diagram)
        return feedthrough_graph(self.diagram, {name: trace.feedthrough for name, trace in traces.items()})

    def _origin(self, end: Endpoint) -> Endpoint:
        """Return the signal that gains make another one of."""
        passed = {end}
        while (before := self._before(end)) is not None:
            if before.index or before in passed:
                break
            end = before
            passed.add(end)
        return end

    def of(self, place: Endpoint) -> list[Endpoint]:
        """Return the signals that differ from that of a place by more than a factor."""
        own = self._origin(place)
        return [end for end in self._signals if end != own]

    def follows(self, end: Endpoint, place: Endpoint) -> bool:
        """Return whether a signal depends on that of a place at the same instant."""
        graph, (a, b) = self._at_once, ((place.block, place.port), (end.block, end.port))
        return a in graph and b in graph and nx.has_path(graph, a, b)

    def meets(self, end: Endpoint, place: Endpoint, joint: str) -> bool:
        """Return whether a signal, behind gains, enters a sum or a product that gives, or takes, that of a place.

        joint: "sum", or "product" of factors alone. Gains between it and the place are passed where nothing else takes
        or records what is between them.
        """
        giving, taking = [place], [place]
        while (before := self._before(giving[-1])) is not None and self._passed_on(before):
            giving.append(before)
        while (after := self._after(taking[-1])) is not None and self._passed_on(after):
            taking.append(after)
        ends = {wire.target.block for one in taking for wire in self._takers(one)}
        ends = ends if joint == "sum" or len(self._takers(place)) == 1 else set()
        joints = {name for name in {giving[-1].block, *ends} if self._is_joint(name, joint)}
        entering = (wire.source for wire in self.diagram.wires if wire.target.block in joints)
        return any(self._origin(source) == end for source in entering)

    def integrates(self, end: Endpoint, wires: Sequence[Wire]) -> bool:
        """Return whether a signal is what an integrator gives, to which alone a wire leads, by gains and sums."""
        passed: set[str] = set()
        while len(wires) == 1 and wires[0].target.block not in passed:
            node = self.diagram.nodes[wires[0].target.block]
            out = Endpoint(node.name, "output")
            if node.block.type_name == "integrator":
                return out == end
            if node.block.type_name not in ("gain", "sum") or str(out) in self.recorded:
                return False
            passed.add(node.name)
            wires = self._takers(out)
        return False

    def _is_joint(self, name: str, joint: str) -> bool:
        """Return whether a block is a sum, or a product that divides by nothing."""
        block = self.diagram.nodes[name].block
        return block.type_name == joint and (joint == "sum" or "/" not in block.option.operations)

    def _before(self, end: Endpoint) -> Endpoint | None:
        """Return the signal that a gain makes this one of."""
        is_gain = self.diagram.nodes[end.block].block.type_name == "gain"
        return self._into.get((end.block, "input")) if is_gain else None

    def _after(self, end: Endpoint) -> Endpoint | None:
        """Return what the only gain that takes a signal makes of it."""
        blocks = [self.diagram.nodes[wire.target.block] for wire in self._takers(end)]
        return Endpoint(blocks[0].name, "output") if [one.block.type_name for one in blocks] == ["gain"] else None

    def _passed_on(self, end: Endpoint) -> bool:
        """Return whether a signal is one number that goes to one block and nowhere else."""
        return not end.index and len(self._takers(end)) == 1 and str(end) not in self.recorded

    def _takers(self, end: Endpoint) -> list[Wire]:
        return [wire for wire in self.diagram.wires if wire.source == end]
