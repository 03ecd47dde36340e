"""Where physics can enter a diagram: every declared fault at every place that its ports allow."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from rotorsim.block import Block, In
from rotorsim.diagnosis.catalogue.chains import ANY, Chain, Chains
from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot
from rotorsim.diagnosis.catalogue.others import OtherSignals
from rotorsim.diagram.diagram import Diagram, Endpoint, Node, Port, Wire
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.fault import Fault
from rotorsim.identification.waveform.linearised import branches_of

Wires = list[tuple[str, str]]


def insertions(diagram: Diagram, recorded: Iterable[str], registry: Registry | None = None) -> list[Insertion]:
    """Return every declared fault at every place of a diagram where its ports fit.

    recorded: flat names of the recorded signals ("rotor.displacement[3,1]"): a sensor stands only in front of them.
    """
    chains, others, names = Chains(diagram), OtherSignals(diagram, recorded), frozenset(recorded)
    branches = branches_of(diagram)
    candidates: list[Insertion] = []
    for kind in (registry or Registry()).all_types().values():
        counted: Counter[str] = Counter()
        for fault in kind.faults:
            candidates += _Finder(
                diagram, names, chains, others, branches, kind, fault, counted[fault.physics]
            ).insertions()
            counted[fault.physics] += 1
    return candidates


@dataclass(frozen=True, eq=False)
class _Finder:
    """Finds the places of one declaration, a variant of its physics."""

    diagram: Diagram
    recorded: frozenset[str]
    chains: Chains
    others: OtherSignals
    branches: Mapping[str, Sequence[Wire]]
    kind: type[Block]
    fault: Fault
    variant: int

    def insertions(self) -> Iterator[Insertion]:
        """Yield the insertions."""
        how = {
            "force": self._forces,
            "shaft": self._shafts,
            "wire": self._wires,
            "reading": self._readings,
            "signal": self._signals,
            "replace": self._replaced,
            "move": self._moved,
        }
        for node in self.diagram.nodes.values():
            yield from how[self.fault.enters](node)

    def _insertion(
        self,
        spot: Spot,
        name: str,
        wires: Wires,
        *,
        of: Node | None = None,
        cut: Iterable[tuple[str, str]] = (),
        measured: Mapping[str, str] | None = None,
        feeds: Mapping[str, str] | None = None,
    ) -> Insertion:
        """Return an insertion; of: the block whose values it inherits."""
        return Insertion(
            self.kind,
            self.fault,
            spot,
            name,
            wires=tuple(wires),
            cut=tuple(cut),
            measured=measured or {},
            values={**self.fault.options, **({} if of is None else self._inherited(of))},
            feeds=feeds or {},
            variant=self.variant,
        )

    def _new_name(self) -> str:
        name, number = self.fault.physics, 2
        while name in self.diagram.nodes:
            name, number = f"{self.fault.physics}{number}", number + 1
        return name

    # -- forces ----------------------------------------------------------------------------------------------------

    def _forces(self, node: Node) -> Iterator[Insertion]:
        outputs = {declared.name: declared for declared in self.kind.outputs.values()}
        ports = [port for port in node.inputs.values() if _declared(port).additive and port.name in outputs]
        if not ports or not all(_fits(outputs[port.name].shape, port.shape[-1:]) for port in ports):
            return
        nodes = [None] if len(ports[0].shape) < 2 else range(1, ports[0].shape[0] + 1)
        for place in nodes:
            if ports[0].name != "force" or place not in _pinned(node):
                yield from self._force(node, ports, place)

    def _shafts(self, node: Node) -> Iterator[Insertion]:
        ports = [node.inputs[key] for key in self.kind.outputs if key in node.inputs]
        fits = len(ports) == len(self.kind.outputs) and all(_declared(port).additive for port in ports)
        if fits and all(key in node.values or key in node.block.options for key in self.fault.inherits):
            yield from self._force(node, ports, None)

    def _force(self, node: Node, ports: list[Port], place: int | None) -> Iterator[Insertion]:
        name = self._new_name()
        index = "" if place is None else f"[{place}]"
        feeds = self._feeds(node, index)
        if feeds is not None:
            wires = [(source, f"{name}.{key}") for key, source in feeds.items()]
            wires += [(f"{name}.{port.name}", f"{node.name}.{port.name}{index}") for port in ports]
            yield self._insertion(Spot(node.name, ports[0].name, place), name, wires, of=node, feeds=feeds)

    def _feeds(self, node: Node, index: str) -> dict[str, str] | None:
        """Return the signals for inputs that no wire goes through; None where one that is needed has none."""
        inputs = {key: declared for key, declared in self.kind.inputs.items() if key not in self.fault.through}
        sources = {key: self._feed(key, node, index) for key in inputs}
        if any(source is None and not inputs[key].optional for key, source in sources.items()):
            return None
        return {key: source for key, source in sources.items() if source is not None}

    def _feed(self, key: str, node: Node, index: str) -> str | None:
        """Return the signal for an input: the output of that name at the place, else of the only block with one."""
        if key in node.outputs:
            return f"{node.name}.{key}{index if len(node.outputs[key].shape) > 1 else ''}"
        holders = [other for other in self.diagram.nodes.values() if key in other.outputs and other is not node]
        first = [other for other in holders if other.block.roles & {"clock", "controller"}] or holders
        return str(self.chains.end(Endpoint(first[0].name, key))) if len(first) == 1 else None

    def _inherited(self, node: Node) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for entry in self.fault.inherits:
            type_name, _, key = entry.rpartition(".")
            others = (other for other in self.diagram.nodes.values() if other.block.type_name == type_name)
            for holder in others if type_name else [node]:
                if key in holder.values:
                    values.setdefault(key, np.asarray(holder.values[key]).tolist())
                elif key in holder.block.options:
                    values.setdefault(key, vars(holder.block.option)[key])
        return values

    # -- in wires --------------------------------------------------------------------------------------------------

    def _wires(self, node: Node) -> Iterator[Insertion]:
        first = next(iter(self.fault.through))
        if self.fault.between[0] not in node.block.roles or first not in node.outputs:
            return
        ends = {w.source for w in self.diagram.wires if (w.source.block, w.source.port) == (node.name, first)}
        places = {end.index for end in ends if self.chains.targets(end, self.fault.between[1])}
        if self.fault.recorded == "after":
            places |= self._recorded_places(node, first)
        for index in sorted(places):
            yield from self._in_wire(node, index)

    def _recorded_places(self, node: Node, port: str) -> set[tuple[int, ...]]:
        prefix = f"{node.name}.{port}"
        names = [name for name in self.recorded if name.partition("[")[0] == prefix]
        if len(node.outputs[port].shape) < 2:
            return {()} if names else set()
        return {(int(name.partition("[")[2].split(",")[0]) - 1,) for name in names}

    def _in_wire(self, node: Node, index: tuple[int, ...]) -> Iterator[Insertion]:
        kind, fault, name = self.kind, self.fault, self._new_name()
        wires: Wires = []
        cut: Wires = []
        measured: dict[str, str] = {}
        feeds: dict[str, str] = {}
        first: set[str] = set()  # blocks that take the first of the signals
        after = fault.recorded == "after"
        chain = self.chains.of(Endpoint(node.name, next(iter(fault.through)), index), fault.between[1])
        for key, output in fault.through.items():
            declared, start = kind.inputs[key], Endpoint(node.name, key, index)
            if declared.optional and key not in node.outputs:
                continue
            if key not in node.outputs or not _fits(declared.shape, node.outputs[key].shape[len(index) :]):
                return
            source = chain.tap if start == chain.start else self.chains.beside(start, chain.blocks)
            taken = self.chains.targets(source, fault.between[1])
            if declared.optional and not taken and fault.between[1] != ANY:  # which has blocks that are to come
                continue
            if fault.joined and wires:
                taken = [wire for wire in taken if wire.target.block in first]
            if after and start == chain.start:
                taken += [wire for wire in self.chains.wires_to(source, chain.next) if wire not in taken]
            feeds[key] = str(start)
            wires.append((str(source), f"{name}.{key}"))
            cut += [(str(wire.source), str(wire.target)) for wire in taken]
            wires += [(f"{name}.{output}", str(wire.target)) for wire in taken]
            first = first or {wire.target.block for wire in taken}
            if after and self._recorded_places(node, key) and self.diagram.measured.get(start, start) == source:
                measured[str(start)] = f"{name}.{output}"
        wires += self._offered(name, wires)
        more = self._feeds(node, f"[{','.join(str(i + 1) for i in index)}]" if index else "")
        if more is not None and (cut or measured):
            feeds |= more
            wires += [(source, f"{name}.{key}") for key, source in more.items()]
            spot = self._spot(chain, index)
            yield self._insertion(spot, name, wires, of=node, cut=cut, measured=measured, feeds=feeds)

    def _spot(self, chain: Chain, index: tuple[int, ...]) -> Spot:
        """Return where a fault in a wire acts: at what is recorded, or, behind the recording, at what takes it."""
        behind = None if self.fault.recorded == "after" else self.chains.taker(chain.tap, self.fault.between[1])
        if behind is not None:
            return Spot(behind.block, behind.port, beside=self._beside(behind.block))
        node = index[0] + 1 if index else None
        block, port = chain.start.block, chain.start.port
        return Spot(block, port, node, None if node is not None else self._beside(block))

    def _beside(self, block: str) -> int | None:
        """Return the only node that a block is wired to."""
        nodes = {
            end.index[0] + 1
            for wire in self.diagram.wires
            for end, other in ((wire.source, wire.target), (wire.target, wire.source))
            if other.block == block and end.index and len(self._port(end).shape) > 1
        }
        return nodes.pop() if len(nodes) == 1 else None

    def _port(self, end: Endpoint) -> Port:
        node = self.diagram.nodes[end.block]
        return node.outputs[end.port] if end.port in node.outputs else node.inputs[end.port]

    def _offered(self, name: str, wires: Wires) -> Wires:
        """Return wires of further outputs to optional inputs of that name, of blocks that the new block feeds."""
        fed = dict.fromkeys(target.partition(".")[0] for source, target in wires if source.startswith(f"{name}."))
        passed = {output: key for key, output in self.fault.through.items()}
        more = {passed.get(key, key): key for key in self.kind.outputs}
        wired = {(wire.target.block, wire.target.port) for wire in self.diagram.wires}
        return [
            (f"{name}.{more[port.name]}", str(port))
            for block in fed
            for port in self.diagram.nodes[block].inputs.values()
            if _declared(port).optional and port.name in more and (block, port.name) not in wired
        ]

    def _readings(self, node: Node) -> Iterator[Insertion]:
        [(key, output), *_] = self.fault.through.items()
        if self.fault.between[0] not in node.block.roles or key not in node.outputs:
            return
        for index in sorted(self._recorded_places(node, key)):
            if _fits(self.kind.inputs[key].shape, node.outputs[key].shape[len(index) :]):
                name, start = self._new_name(), Endpoint(node.name, key, index)
                wires = [(str(self.diagram.measured.get(start, start)), f"{name}.{key}")]
                spot = self._spot(self.chains.of(start, self.fault.between[1]), index)
                measured = {str(start): f"{name}.{output}"}
                yield self._insertion(spot, name, wires, of=node, measured=measured, feeds={key: str(start)})

    def _signals(self, node: Node) -> Iterator[Insertion]:
        """Yield the block behind every scalar signal: for all or one that take it, for its recording, or for both."""
        if self.diagram.turns:
            return  # of what turns, the physics are declared
        [(key, output)] = self.fault.through.items()
        for port in (port for port in node.outputs.values() if port.shape == ()):
            start = Endpoint(node.name, port.name)
            taken = [wire for wire in self.diagram.wires if wire.source == start]
            recorded = str(start) in self.recorded and node.block.category != "input"
            shown = self.diagram.measured.get(start, start)
            cut = [(str(wire.source), str(wire.target)) for wire in taken]
            sides = ("", *(("reading", "both") if recorded else ()))
            for side, other in product(sides, self.others.of(start) if self.fault.argument else (None,)):
                if (side != "reading" and not taken) or (side == "both" and shown != start):
                    continue
                if other is not None and side != "reading" and self.others.follows(other, start):
                    continue  # an algebraic loop
                if other is not None and side == "" and self.fault.own and self.others.meets(other, start, self._joint):
                    continue
                named = self._by_name(other, taken) if side == "" else self
                name = named._new_name()
                onward = [(f"{name}.{output}", str(wire.target)) for wire in taken]
                source = shown if side == "reading" else start
                feeds = {key: str(start), **({} if other is None else {self.fault.argument: str(other)})}
                taps = {key: str(source), **({} if other is None else {self.fault.argument: str(other)})}
                yield named._insertion(
                    Spot(node.name, port.name, side=side),
                    name,
                    [*((tap, f"{name}.{k}") for k, tap in taps.items()), *(onward if side != "reading" else ())],
                    cut=cut if side != "reading" else (),
                    measured={str(start): f"{name}.{output}"} if side else None,
                    feeds=feeds,
                )
            for wire in self.branches.get(str(start), ()):
                yield from self._branch(start, wire)

    def _branch(self, start: Endpoint, wire: Wire) -> Iterator[Insertion]:
        """Yield the block in one wire of a signal that several take; in front of a sum no law that only adds to it."""
        target = self.diagram.nodes[wire.target.block]
        if self.fault.adds and target.block.type_name == "sum":
            return  # it is the same behind the sum
        [(key, output)] = self.fault.through.items()
        ends = [Endpoint(target.name, port) for port in target.outputs]
        for other in self.others.of(start) if self.fault.argument else (None,):
            if other is not None and any(self.others.follows(other, end) for end in ends):
                continue  # an algebraic loop
            named = self._by_name(other, [wire])
            name = named._new_name()
            feeds = {key: str(start), **({} if other is None else {self.fault.argument: str(other)})}
            wires = [(source, f"{name}.{k}") for k, source in feeds.items()]
            yield named._insertion(
                Spot(target.name, wire.target.port, side="branch"),
                name,
                [*wires, (f"{name}.{output}", str(wire.target))],
                cut=[(str(wire.source), str(wire.target))],
                feeds=feeds,
            )

    @property
    def _joint(self) -> str:
        """The type of block behind which a law of two signals is one of the other signal: as it adds, or multiplies."""
        return "sum" if self.fault.adds else "product"

    def _by_name(self, other: Endpoint | None, taken: Sequence[Wire]) -> _Finder:
        """Return the finder under the name that the law has where the other signal is the integral of that in wires."""
        if other is None or not self.fault.of_integral or not self.others.integrates(other, taken):
            return self
        return replace(self, fault=replace(self.fault, physics=self.fault.of_integral))

    # -- changes of a block ------------------------------------------------------------------------------------------

    def _replaced(self, node: Node) -> Iterator[Insertion]:
        if node.block.type_name not in self.fault.of:
            return
        options = vars(node.block.option)
        same = all(options.get(key) == value for key, value in self.fault.options.items())
        if node.block.type_name != self.kind.type_name or not same:
            feeds = {w.target.port: str(w.source) for w in self.diagram.wires if w.target.block == node.name}
            spot = Spot(node.name, next(iter(node.outputs), ""), beside=self._beside(node.name))
            yield self._insertion(spot, node.name, [], feeds=feeds)

    def _moved(self, node: Node) -> Iterator[Insertion]:
        if node.block.type_name != self.kind.type_name:
            return
        out = [w for w in self.diagram.wires if w.source.block == node.name and w.target.index]
        out = [w for w in out if _declared(self.diagram.nodes[w.target.block].inputs[w.target.port]).additive]
        if len({(w.target.block, w.target.index[0]) for w in out}) != 1:
            return
        cut = [(str(w.source), str(w.target)) for w in out]
        block, port, index = out[0].target.block, out[0].target.port, out[0].target.index
        target = self.diagram.nodes[block]
        for place in range(target.inputs[port].shape[0]):
            if place != index[0] and place + 1 not in _pinned(target):
                ends = (Endpoint(block, w.target.port, (place, *w.target.index[1:])) for w in out)
                wires = [(str(w.source), str(end)) for w, end in zip(out, ends, strict=True)]
                yield self._insertion(Spot(block, port, place + 1), node.name, wires, cut=cut)


def _declared(port: Port) -> In:
    """Return the declaration of an input."""
    assert isinstance(port.declaration, In)
    return port.declaration


def _pinned(node: Node) -> tuple[int, ...]:
    """Return the nodes (from 1) that do not move."""
    return tuple(vars(node.block.option).get("pinned_nodes") or ())


def _fits(declared: Any, shape: tuple[int, ...]) -> bool:
    """Return whether a declared shape, where it is one for all diagrams, is that of a signal."""
    fixed = (declared,) if isinstance(declared, int) else declared
    return not isinstance(fixed, tuple) or fixed == shape
