"""Where physics can enter a diagram: every declared fault at every place that its ports allow."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from rotorsim.block import Block, In
from rotorsim.diagnosis.catalogue.chains import Chain, Chains
from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot
from rotorsim.diagram.diagram import Diagram, Endpoint, Node, Port
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.fault import Fault

__all__ = ["insertions"]


def insertions(diagram: Diagram, recorded: Iterable[str], registry: Registry | None = None) -> list[Insertion]:
    """Return every declared fault at every place of a diagram where its ports fit.

    recorded: flat names of the recorded signals ("rotor.displacement[3,1]"): a sensor stands only in front of them.
    """
    registry = registry or Registry()
    finder = _Finder(diagram, frozenset(recorded))
    found: list[Insertion] = []
    for kind in registry.all_types().values():
        counted: dict[str, int] = {}
        for fault in kind.faults:
            variant = counted.get(fault.physics, 0)
            counted[fault.physics] = variant + 1
            found += finder.find(kind, fault, variant)
    return found


class _Finder:
    def __init__(self, diagram: Diagram, recorded: frozenset[str]) -> None:
        self.diagram, self.recorded = diagram, recorded
        self.ports = {name.partition("[")[0] for name in recorded}
        self.chains = Chains(diagram)

    def find(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        """Yield the insertions of one declaration."""
        how = {
            "force": self._forces,
            "shaft": self._shafts,
            "wire": self._wires,
            "reading": self._readings,
            "replace": self._replaced,
            "move": self._moved,
        }[fault.enters]
        yield from how(kind, fault, variant)

    def _new_name(self, physics: str) -> str:
        name, number = physics, 2
        while name in self.diagram.nodes:
            name, number = f"{physics}{number}", number + 1
        return name

    # -- forces ----------------------------------------------------------------------------------------------------

    def _forces(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        for block, node in self.diagram.nodes.items():
            ports = [port for port in node.inputs.values() if _is_additive(port)]
            outputs = {d.name: d for d in kind.outputs.values()}
            pairs = [(port, port.name) for port in ports if port.name in outputs]
            if not pairs or not all(_fits(outputs[name].shape, port.shape[-1:]) for port, name in pairs):
                continue
            for place in _places(node, pairs[0][0]):
                pinned = getattr(node.block.option, "pinned_nodes", ()) or ()
                if place in pinned and pairs[0][0].name == "force":
                    continue
                made = self._force(kind, fault, variant, block, node, pairs, place)
                if made is not None:
                    yield made

    def _force(
        self,
        kind: type[Block],
        fault: Fault,
        variant: int,
        block: str,
        node: Node,
        pairs: list[tuple[Port, str]],
        place: int | None,
    ) -> Insertion | None:
        name = self._new_name(fault.physics)
        index = "" if place is None else f"[{place}]"
        feeds: dict[str, str] = {}
        for key, declared in kind.inputs.items():
            source = self._feed(key, node, block, index)
            if source is None:
                if declared.optional:
                    continue
                return None
            feeds[key] = source
        wires = [(source, f"{name}.{key}") for key, source in feeds.items()]
        wires += [(f"{name}.{output}", f"{block}.{port.name}{index}") for port, output in pairs]
        spot = Spot(block, pairs[0][0].name, place)
        values = {**dict(fault.options), **self._inherited(fault, node)}
        return Insertion(kind, fault, spot, name, tuple(wires), (), {}, values, feeds, variant)

    def _shafts(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        for block, node in self.diagram.nodes.items():
            pairs = [(node.inputs[key], key) for key in kind.outputs if key in node.inputs]
            if len(pairs) < len(kind.outputs) or not all(_is_additive(port) for port, _ in pairs):
                continue
            if not all(key in node.values or key in node.block.options for key in fault.inherits):
                continue
            made = self._force(kind, fault, variant, block, node, pairs, None)
            if made is not None:
                yield made

    def _feed(self, key: str, node: Node, block: str, index: str) -> str | None:
        """Return the signal for an input: the output of that name at the place, else of the only block with one."""
        if key in node.outputs:
            shape = node.outputs[key].shape
            return f"{block}.{key}{index}" if not index or len(shape) > 1 else f"{block}.{key}"
        holders = [
            (other.block.category, name)
            for name, other in self.diagram.nodes.items()
            if key in other.outputs and name != block
        ]
        first = [name for category, name in holders if category in ("clock", "controller")] or [n for _, n in holders]
        return str(self.chains.end(Endpoint(first[0], key))) if len(first) == 1 else None

    def _inherited(self, fault: Fault, node: Node) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for entry in fault.inherits:
            type_name, _, key = entry.rpartition(".")
            others = [other for other in self.diagram.nodes.values() if other.block.type_name == type_name]
            for holder in others if type_name else [node]:
                if key in holder.values:
                    found[key] = np.asarray(holder.values[key]).tolist()
                    break
                if key in holder.block.options:
                    found[key] = getattr(holder.block.option, key)
                    break
        return found

    # -- in wires --------------------------------------------------------------------------------------------------

    def _wires(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        first = next(iter(fault.through))
        for block, node in self.diagram.nodes.items():
            if node.block.category != fault.between[0] or first not in node.outputs:
                continue
            places = self._taken(block, first, fault.between[1])
            if fault.recorded == "after":
                places |= self._recorded_places(node, first)
            for index in sorted(places):
                made = self._in_wire(kind, fault, variant, block, node, index)
                if made is not None:
                    yield made

    def _taken(self, block: str, port: str, category: str) -> set[tuple[int, ...]]:
        """Return the indices under which blocks of a category take a port."""
        ends = {wire.source for wire in self.diagram.wires if (wire.source.block, wire.source.port) == (block, port)}
        return {end.index for end in ends if self.chains.targets(end, category)}

    def _recorded_places(self, node: Node, port: str) -> set[tuple[int, ...]]:
        shape = node.outputs[port].shape
        prefix = f"{node.name}.{port}"
        if prefix not in self.ports:
            return set()
        if len(shape) < 2:
            return {()}
        numbers = {int(n.partition("[")[2].split(",")[0]) for n in self.recorded if n.startswith(prefix + "[")}
        return {(number - 1,) for number in numbers}

    def _in_wire(
        self, kind: type[Block], fault: Fault, variant: int, block: str, node: Node, index: tuple[int, ...]
    ) -> Insertion | None:
        name = self._new_name(fault.physics)
        suffix = f"[{','.join(str(i + 1) for i in index)}]" if index else ""
        wires: list[tuple[str, str]] = []
        cut: list[tuple[str, str]] = []
        measured: dict[str, str] = {}
        feeds: dict[str, str] = {}
        after = fault.recorded == "after"
        chain = self.chains.of(Endpoint(block, next(iter(fault.through)), index), fault.between[1])
        for key, output in fault.through.items():
            if key not in node.outputs:
                if kind.inputs[key].optional:
                    continue
                return None
            if not _fits(kind.inputs[key].shape, node.outputs[key].shape[len(index) :]):
                return None
            start = Endpoint(block, key, index)
            source = chain.tap if start == chain.start else self.chains.beside(start, chain.blocks)
            taken = self.chains.targets(source, fault.between[1])
            if kind.inputs[key].optional and not taken:
                continue
            if after and start == chain.start:
                taken += [wire for wire in self.chains.wires_to(source, chain.next) if wire not in taken]
            feeds[key] = str(start)
            wires.append((str(source), f"{name}.{key}"))
            cut += [(str(wire.source), str(wire.target)) for wire in taken]
            wires += [(f"{name}.{output}", str(wire.target)) for wire in taken]
            if after and f"{block}.{key}" in self.ports and self.diagram.measured.get(start, start) == source:
                measured[str(start)] = f"{name}.{output}"
        wires += self._offered(kind, fault, name, wires)
        if not cut and not measured:
            return None
        for key, declared in kind.inputs.items():
            if key in fault.through:
                continue
            found = self._feed(key, node, block, suffix)
            if found is not None:
                feeds[key] = found
                wires.append((found, f"{name}.{key}"))
            elif not declared.optional:
                return None
        values = {**dict(fault.options), **self._inherited(fault, node)}
        spot = self._spot(fault, chain, index)
        return Insertion(kind, fault, spot, name, tuple(wires), tuple(cut), measured, values, feeds, variant)

    def _spot(self, fault: Fault, chain: Chain, index: tuple[int, ...]) -> Spot:
        """Return where a fault in a wire acts: at what is recorded, or, behind the recording, at what takes it."""
        behind = None if fault.recorded == "after" else self.chains.taker(chain.tap, fault.between[1])
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

    def _offered(
        self, kind: type[Block], fault: Fault, name: str, wires: list[tuple[str, str]]
    ) -> list[tuple[str, str]]:
        """Return wires of further outputs to optional inputs of that name, of blocks that the new block feeds."""
        fed = dict.fromkeys(target.partition(".")[0] for source, target in wires if source.startswith(f"{name}."))
        more = [output.name for key, output in kind.outputs.items() if key not in fault.through.values()]
        found = []
        for block in fed:
            node = self.diagram.nodes[block]
            for port in node.inputs.values():
                wanted = isinstance(port.declaration, In) and port.declaration.optional and port.name in more
                if wanted and not any(
                    (w.target.block, w.target.port) == (block, port.name) for w in self.diagram.wires
                ):
                    found.append((f"{name}.{port.name}", f"{block}.{port.name}"))
        return found

    def _readings(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        key, output = next(iter(fault.through.items()))
        for block, node in self.diagram.nodes.items():
            if node.block.category != fault.between[0] or key not in node.outputs:
                continue
            for index in sorted(self._recorded_places(node, key)):
                if not _fits(kind.inputs[key].shape, node.outputs[key].shape[len(index) :]):
                    continue
                name, start = self._new_name(fault.physics), Endpoint(block, key, index)
                read = str(self.diagram.measured.get(start, start))
                spot = self._spot(fault, self.chains.of(start, fault.between[1]), index)
                yield Insertion(
                    kind,
                    fault,
                    spot,
                    name,
                    ((read, f"{name}.{key}"),),
                    (),
                    {str(start): f"{name}.{output}"},
                    {**dict(fault.options), **self._inherited(fault, node)},
                    {key: str(start)},
                    variant,
                )

    # -- changes of a block ------------------------------------------------------------------------------------------

    def _replaced(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        for block, node in self.diagram.nodes.items():
            same = node.block.type_name == kind.type_name
            if node.block.type_name not in fault.of:
                continue
            if same and all(getattr(node.block.option, k, None) == v for k, v in fault.options.items()):
                continue
            output = next(iter(node.outputs), "")
            feeds = {w.target.port: str(w.source) for w in self.diagram.wires if w.target.block == block}
            spot = Spot(block, output, beside=self._beside(block))
            yield Insertion(kind, fault, spot, block, (), (), {}, dict(fault.options), feeds, variant)

    def _moved(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        for block, node in self.diagram.nodes.items():
            if node.block.type_name != kind.type_name:
                continue
            out = [
                wire
                for wire in self.diagram.wires
                if wire.source.block == block
                and wire.target.index
                and _is_additive(self.diagram.nodes[wire.target.block].inputs[wire.target.port])
            ]
            if len({(w.target.block, w.target.index[0]) for w in out}) != 1:
                continue
            target = self.diagram.nodes[out[0].target.block]
            port = target.inputs[out[0].target.port]
            pinned = set(getattr(target.block.option, "pinned_nodes", ()) or ())
            for place in range(1, port.shape[0] + 1):
                if place in pinned or place == out[0].target.index[0] + 1:
                    continue
                wires = [
                    (str(w.source), str(Endpoint(w.target.block, w.target.port, (place - 1, *w.target.index[1:]))))
                    for w in out
                ]
                cut = tuple((str(w.source), str(w.target)) for w in out)
                yield Insertion(
                    kind,
                    fault,
                    Spot(target.name, port.name, place),
                    block,
                    tuple(wires),
                    cut,
                    {},
                    dict(fault.options),
                    {},
                    variant,
                )


def _is_additive(port: Port) -> bool:
    return isinstance(port.declaration, In) and port.declaration.additive


def _fits(declared: Any, shape: tuple[int, ...]) -> bool:
    """Return whether a declared shape, where it is one for all diagrams, is that of a signal."""
    fixed = (declared,) if isinstance(declared, int) else declared
    return not isinstance(fixed, tuple) or fixed == shape


def _places(node: Node, port: Port) -> list[int | None]:
    """Return the nodes (from 1) of a port, or [None] where it has none."""
    return [None] if len(port.shape) < 2 else list(range(1, port.shape[0] + 1))
