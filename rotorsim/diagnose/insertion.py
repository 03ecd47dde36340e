"""Where physics can enter a diagram: every declared fault at every place that its ports allow."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim.block import Block, In
from rotorsim.diagram.diagram import Diagram, Endpoint, Node, Port
from rotorsim.diagram.registry import Registry
from rotorsim.fault import Fault, Lines, Of

__all__ = ["LEAST", "LINES", "Insertion", "Spot", "fixed_of", "insertions", "starts_of"]

LEAST = "least"  # before the name of a signal: its size in the run in which it is smallest
LINES = "lines"  # among the largest magnitudes of signals: the frequency of lines that do not follow the shaft


@dataclass(frozen=True)
class Spot:
    """A place in a diagram: a port of a block, and the node (from 1) where it has nodes."""

    block: str
    port: str
    node: int | None = None

    def __str__(self) -> str:
        return f"{self.block}.{self.port}" + (f"[{self.node}]" if self.node is not None else "")


@dataclass(frozen=True, eq=False)
class Insertion:
    """A fault at a spot. name: of the block that carries it. wires: added; cut: taken out (source, target).

    measured: what recordings mean with it. values: parameters and options of the block. variant: of several
    declarations for one physics.
    """

    kind: type[Block]
    fault: Fault
    spot: Spot
    name: str
    wires: tuple[tuple[str, str], ...] = ()
    cut: tuple[tuple[str, str], ...] = ()
    measured: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)
    feeds: Mapping[str, str] = field(default_factory=dict)
    variant: int = 0

    @property
    def physics(self) -> str:
        """The name of the physics."""
        return self.fault.physics

    @property
    def key(self) -> str:
        """A text that tells this insertion from all others of a diagram."""
        return f"{self.physics}/{self.variant}@{self.spot}"

    @property
    def free(self) -> tuple[str, ...]:
        """The names under which its parameters are free."""
        return tuple(f"{self.name}.{key}" for key in self.fault.free)

    @property
    def from_lines(self) -> tuple[str, ...]:
        """The parameters that take the frequency of lines that do not follow the shaft."""
        return tuple(key for key, item in self.fault.fixed.items() if isinstance(item, Lines))

    def document(self, document: Mapping[str, Any], start: Mapping[str, float] | None = None) -> dict[str, Any]:
        """Return the document with the fault in it and its parameters free, from starts {parameter: SI value}."""
        new = copy.deepcopy(dict(document))
        entered = self.fault.enters
        if entered in ("replace", "move"):
            block = new["blocks"][self.name]
            kept = {
                key: value for key, value in block.get("parameters", {}).items()
                if key in self.kind.parameters or key in self.kind.options
            }  # fmt: skip
            new["blocks"][self.name] = {"type": self.kind.type_name, "parameters": {**kept, **self.values}}
            followed = {v[1:] for v in kept.values() if isinstance(v, str) and v.startswith("$")}
            if block["type"] != self.kind.type_name:
                for name in followed & set(new.get("identify", {})):  # other bounds may hold for the new type
                    new["identify"][name] = {
                        k: v for k, v in new["identify"][name].items() if k not in ("low", "high")
                    }  # fmt: skip
        else:
            new["blocks"][self.name] = {"type": self.kind.type_name, "parameters": dict(self.values)}
        parameters = new["blocks"][self.name]["parameters"]
        for key, value in (start or {}).items():
            parameters[key] = value
        if self.cut or self.wires:
            cut = {(_plain(a), _plain(b)) for a, b in self.cut}
            new["wires"] = [w for w in new["wires"] if (_plain(w[0]), _plain(w[1])) not in cut]
            new["wires"] += [list(wire) for wire in self.wires]
        if self.measured:
            new["measured"] = {**new.get("measured", {}), **self.measured}
        new["identify"] = {**new.get("identify", {}), **{name: {} for name in self.free}}
        return new


def _plain(end: str) -> str:
    return end.replace(" ", "")


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

    def find(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        """Yield the insertions of one declaration."""
        how = {
            "force": self._forces, "wire": self._wires, "reading": self._readings, "replace": self._replaced,
            "move": self._moved,
        }[fault.enters]  # fmt: skip
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
        self, kind: type[Block], fault: Fault, variant: int, block: str, node: Node,
        pairs: list[tuple[Port, str]], place: int | None,
    ) -> Insertion | None:  # fmt: skip
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

    def _feed(self, key: str, node: Node, block: str, index: str) -> str | None:
        """Return the signal for an input: the output of that name at the place, else of the only block with one."""
        if key in node.outputs:
            shape = node.outputs[key].shape
            return f"{block}.{key}{index}" if not index or len(shape) > 1 else f"{block}.{key}"
        holders = [
            (other.block.category, name) for name, other in self.diagram.nodes.items()
            if key in other.outputs and name != block
        ]  # fmt: skip
        first = [name for category, name in holders if category in ("clock", "controller")] or [n for _, n in holders]
        return f"{first[0]}.{key}" if len(first) == 1 else None

    def _inherited(self, fault: Fault, node: Node) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for entry in fault.inherits:
            type_name, _, key = entry.rpartition(".")
            others = [other for other in self.diagram.nodes.values() if other.block.type_name == type_name]
            for holder in others if type_name else [node]:
                if key in holder.values:
                    found[key] = np.asarray(holder.values[key]).tolist()
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
        return {
            wire.source.index for wire in self.diagram.wires
            if (wire.source.block, wire.source.port) == (block, port)
            and category in ("*", self.diagram.nodes[wire.target.block].block.category)
        }  # fmt: skip

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
    ) -> Insertion | None:  # fmt: skip
        name = self._new_name(fault.physics)
        suffix = f"[{','.join(str(i + 1) for i in index)}]" if index else ""
        wires: list[tuple[str, str]] = []
        cut: list[tuple[str, str]] = []
        measured: dict[str, str] = {}
        feeds: dict[str, str] = {}
        for key, output in fault.through.items():
            if key not in node.outputs:
                if kind.inputs[key].optional:
                    continue
                return None
            if not _fits(kind.inputs[key].shape, node.outputs[key].shape[len(index) :]):
                return None
            source = Endpoint(block, key, index)
            if kind.inputs[key].optional and not self._wired(source, fault.between[1]):
                continue
            feeds[key] = str(source)
            wires.append((str(source), f"{name}.{key}"))
            for wire in self.diagram.wires:
                category = self.diagram.nodes[wire.target.block].block.category
                if wire.source == source and fault.between[1] in ("*", category):
                    cut.append((str(wire.source), str(wire.target)))
                    wires.append((f"{name}.{output}", str(wire.target)))
            if fault.recorded == "after" and f"{block}.{key}" in self.ports:
                measured[str(source)] = f"{name}.{output}"
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
        spot = Spot(block, next(iter(fault.through)), index[0] + 1 if index else None)
        values = {**dict(fault.options), **self._inherited(fault, node)}
        return Insertion(kind, fault, spot, name, tuple(wires), tuple(cut), measured, values, feeds, variant)

    def _offered(
        self, kind: type[Block], fault: Fault, name: str, wires: list[tuple[str, str]]
    ) -> list[tuple[str, str]]:  # fmt: skip
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

    def _wired(self, source: Endpoint, category: str) -> bool:
        return any(
            wire.source == source and category in ("*", self.diagram.nodes[wire.target.block].block.category)
            for wire in self.diagram.wires
        )

    def _readings(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        key, output = next(iter(fault.through.items()))
        for block, node in self.diagram.nodes.items():
            if node.block.category != fault.between[0] or key not in node.outputs:
                continue
            for index in sorted(self._recorded_places(node, key)):
                name = self._new_name(fault.physics)
                source = str(Endpoint(block, key, index))
                spot = Spot(block, key, index[0] + 1 if index else None)
                yield Insertion(
                    kind, fault, spot, name, ((source, f"{name}.{key}"),), (), {source: f"{name}.{output}"},
                    {**dict(fault.options), **self._inherited(fault, node)}, {key: source}, variant,
                )  # fmt: skip

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
            yield Insertion(kind, fault, Spot(block, output), block, (), (), {}, dict(fault.options), feeds, variant)

    def _moved(self, kind: type[Block], fault: Fault, variant: int) -> Iterator[Insertion]:
        for block, node in self.diagram.nodes.items():
            if node.block.type_name != kind.type_name:
                continue
            out = [
                wire for wire in self.diagram.wires
                if wire.source.block == block and wire.target.index
                and _is_additive(self.diagram.nodes[wire.target.block].inputs[wire.target.port])
            ]  # fmt: skip
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
                    kind, fault, Spot(target.name, port.name, place), block, tuple(wires), cut, {},
                    dict(fault.options), {}, variant,
                )  # fmt: skip


def _is_additive(port: Port) -> bool:
    return isinstance(port.declaration, In) and port.declaration.additive


def _fits(declared: Any, shape: tuple[int, ...]) -> bool:
    """Return whether a declared shape, where it is one for all diagrams, is that of a signal."""
    fixed = (declared,) if isinstance(declared, int) else declared
    return not isinstance(fixed, tuple) or fixed == shape


def _places(node: Node, port: Port) -> list[int | None]:
    """Return the nodes (from 1) of a port, or [None] where it has none."""
    return [None] if len(port.shape) < 2 else list(range(1, port.shape[0] + 1))


def starts_of(insertion: Insertion, largest: Mapping[str, float]) -> list[dict[str, float]]:
    """Return the starts of an insertion: every combination that its fault declares, {parameter: SI value}.

    largest: the largest magnitude of each input of the block at its place, for starts that follow the data.
    """
    combined: list[dict[str, float]] = [{}]
    for key, options in insertion.fault.free.items():
        values = [_number(item, largest) for item in options]
        combined = [{**start, key: value} for start in combined for value in values]
    return combined


def fixed_of(insertion: Insertion, largest: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of an insertion that are set once and not fitted."""
    return {key: _number(item, largest) for key, item in insertion.fault.fixed.items()}


def _number(item: float | Of | Lines, largest: Mapping[str, float]) -> float:
    if isinstance(item, Lines):
        return largest[LINES]
    if not isinstance(item, Of):
        return float(item)
    size = largest.get(item.input, 1.0)
    size = largest.get(f"{LEAST} {item.input}", size) if item.least else size
    return item.factor * size**item.power
