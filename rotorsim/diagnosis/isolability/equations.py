"""The structure of a diagram: which unknowns stand in which equation of its blocks, wires and sensors."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

import casadi as ca
import networkx as nx
import numpy as np

from rotorsim.block import size_of
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.isolability.structure import Equation, Signal, Structure
from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.diagram.parse.document import endpoint
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.linear.linearisation import entry_names
from rotorsim.model.trace.block import BlockTrace
from rotorsim.model.trace.diagram import flat_indices
from rotorsim.model.trace.order import block_traces

__all__ = ["entries_of", "structure_of"]

SHOWN = 8  # signals that a hint lists
UNSEEN = ("excitation", "clock")  # categories of blocks whose outputs nobody measures
_Pattern = dict[tuple[str, tuple[str, ...]], str | None]


def structure_of(diagram: Diagram, sensors: Sequence[str], faults: Iterable[Insertion] = ()) -> Structure:
    """Return the structure of a diagram: what stands in its equations, from the sparsity of their traces.

    sensors: signals that are measured ("rotor.displacement", "rotor.displacement[3]", "controller.current[1]").
    The unknowns are the entries of ports and states; parameters and time are known.
    Raises RotorsimError with everything that is wrong with the sensors.
    """
    entries_of(diagram, sensors)
    builder = _Builder(diagram)
    measured = {name: builder.measure(name) for name in sensors}
    extra = builder.extra([name for some in measured.values() for name in some])
    signals = builder.joined({item.key: builder.signals(item) for item in faults})
    return Structure(builder.equations, signals, measured, extra)


def entries_of(diagram: Diagram, sensors: Sequence[str]) -> list[str]:
    """Return the flat names of the entries of signals: "rotor.displacement[3]" -> [3,1], [3,2].

    Raises RotorsimError with every signal that the diagram does not have.
    """
    problems: list[Problem] = []
    found: list[str] = []
    for name in sensors:
        found += [entry for entry in _entries(diagram, name, problems) if entry not in found]
    if not sensors:
        first = ("rotor", "controller")
        seen = [name for name in signals_of(diagram) if _category(diagram, name) not in UNSEEN]
        some = sorted(seen, key=lambda name: _category(diagram, name) not in first)[:SHOWN]
        problems.append(Problem("no sensors", diagram.name, hint=f"signals: {', '.join(some)}"))
    if problems:
        raise RotorsimError(*problems)
    return found


def _entries(diagram: Diagram, name: str, problems: list[Problem]) -> list[str]:
    end = endpoint(name)
    signals = signals_of(diagram)
    if end is None:
        ports = [known for known in signals if known.partition(".")[0] == name.partition(".")[0].partition("[")[0]]
        ports = ports or [known for known in signals if known.endswith(f".{name.partition('[')[0]}")]
        known = ", ".join(ports or list(signals)[:SHOWN])
        hint = f"write block.port, with [node] or [node,axis] counted from 1; signals: {known}"
        problems.append(Problem("is not a signal", f"sensor {name}", hint=hint))
        return []
    shape = signals.get(f"{end.block}.{end.port}")
    if shape is None:
        hint = near_miss(f"{end.block}.{end.port}", signals)
        problems.append(Problem("the diagram has no such output", f"sensor {name}", hint=hint))
        return []
    if len(end.index) > len(shape) or any(i >= n for i, n in zip(end.index, shape, strict=False)):
        size = " x ".join(map(str, shape)) or "a single number"
        problems.append(Problem(f"no such entry: the signal is {size}", f"sensor {name}", hint="counted from 1"))
        return []
    names = entry_names(f"{end.block}.{end.port}", shape)
    return [names[k] for k in flat_indices(shape, end.index)]


def _category(diagram: Diagram, signal: str) -> str:
    return diagram.nodes[signal.rpartition(".")[0]].block.category


def signals_of(diagram: Diagram) -> dict[str, tuple[int, ...]]:
    """Return the shape of every output port by its name."""
    return {f"{b}.{port}": p.shape for b, node in diagram.nodes.items() for port, p in node.outputs.items()}


class _Builder:
    def __init__(self, diagram: Diagram) -> None:
        self.diagram = diagram
        self.equations: dict[Equation, frozenset[str]] = {}
        self.same: dict[str, str] = {}  # unknown -> the one that it is, or is the derivative of
        patterns: dict[int, _Pattern] = {}
        for block, node in diagram.nodes.items():
            pattern = patterns.setdefault(id(node), _pattern(block_traces(diagram)[block], node.values))
            for (own, rest), only in pattern.items():
                if only is not None:
                    self.same[f"{block}.{own}"] = f"{block}.{only}"
                else:
                    self.equations[f"{block}.{own}"] = frozenset({f"{block}.{own}", *(f"{block}.{u}" for u in rest)})
            self._inputs(block, block_traces(diagram)[block])
        self.equations = {name: frozenset(map(self.unknown, some)) for name, some in self.equations.items()}

    def unknown(self, name: str) -> str:
        """Return the unknown that stands for another in the equations."""
        while name in self.same:
            name = self.same[name]
        return name

    def _inputs(self, block: str, trace: BlockTrace) -> None:
        """Add the equations of the wires into a block: input = sum of what is wired to it."""
        wires = [wire for wire in self.diagram.wires if wire.target.block == block]
        for port in trace.inputs:
            shape = self.diagram.nodes[block].inputs[port].shape
            unknowns: list[set[str]] = [set() for _ in range(size_of(shape))]
            for wire in wires:
                if wire.target.port == port:
                    to, what = flat_indices(shape, wire.target.index).tolist(), self._outputs(wire.source)
                    for own, source in zip(to, what * len(to) if len(what) == 1 else what, strict=True):
                        unknowns[own].add(source)
            for k, some in enumerate(unknowns):
                own = f"{block}.in {port}#{k}"
                self.equations[own] = frozenset({own, *some})

    def _outputs(self, source: Endpoint) -> list[str]:
        shape = self.diagram.nodes[source.block].outputs[source.port].shape
        return [f"{source.block}.out {source.port}#{k}" for k in flat_indices(shape, source.index)]

    def outputs(self, name: str) -> list[str]:
        """Return the unknowns of a signal."""
        end = endpoint(name)
        assert end is not None
        return [self.unknown(one) for one in self._outputs(end)]

    def measure(self, name: str) -> tuple[Equation, ...]:
        """Add the equations of a sensor."""
        made = []
        for entry in entries_of(self.diagram, [name]):
            self.equations[f"sensor {entry}"] = frozenset(self.outputs(self.diagram.as_measured(entry)))
            made.append(f"sensor {entry}")
        return tuple(made)

    def extra(self, measured: Sequence[Equation]) -> dict[str, tuple[str, ...]]:
        """Return sensors that could be added, of measured ports first: what acts on the measured, or a second one."""
        taken = frozenset().union(*(self.equations[name] for name in measured))
        blocks = {name.removeprefix("sensor ").partition(".")[0] for name in measured}
        graph = nx.DiGraph(self.diagram.graph)
        acting = blocks.union(*(nx.ancestors(graph, block) for block in blocks))
        found: dict[tuple[str, ...], str] = {}
        for block, node in self.diagram.nodes.items():
            if block not in acting or node.block.category in UNSEEN:
                continue
            for port, declared in node.outputs.items():
                rows = [()] if len(declared.shape) < 2 else [(k,) for k in range(declared.shape[0])]
                for end in (Endpoint(block, port, row) for row in rows):
                    unknowns = tuple(self.outputs(str(end)))
                    found.setdefault(unknowns, f"second {end}" if taken.issuperset(unknowns) else str(end))
        ports = {name.removeprefix("sensor ").partition("[")[0] for name in measured}
        names = {name: unknowns for unknowns, name in found.items()}
        return dict(sorted(names.items(), key=lambda item: item[0].partition("[")[0] not in ports))

    def signals(self, item: Insertion) -> tuple[Signal, ...]:
        """Return the equations in which each signal of a fault stands."""
        if item.fault.enters == "replace":
            own = [name for name in self.equations if name.startswith((f"{item.name}.out ", f"{item.name}.state "))]
            return tuple(frozenset({name}) for name in own)
        found: dict[Hashable, set[Equation]] = {}
        came_from = {output: item.feeds[key] for key, output in item.fault.through.items() if key in item.feeds}
        moves = item.fault.enters == "move"
        for source, target in (*item.wires, *(item.cut if moves else ())):
            start, end = endpoint(source), endpoint(target)
            assert start is not None
            assert end is not None
            if end.block == item.name and not moves:
                continue  # what the block of the fault takes
            entries = flat_indices(self.diagram.nodes[end.block].inputs[end.port].shape, end.index).tolist()
            for key, entry in zip(self._keys(start.port, len(entries), came_from), entries, strict=True):
                name = f"{end.block}.in {end.port}#{entry}"
                if name in self.equations:  # an input that was not wired before comes with others that were
                    found.setdefault(key, set()).add(name)
        for said, meant in item.measured.items():
            start = endpoint(meant)
            assert start is not None
            names = [f"sensor {entry}" for entry in entries_of(self.diagram, [said])]
            for key, name in zip(self._keys(start.port, len(names), came_from), names, strict=True):
                if name in self.equations:
                    found.setdefault(key, set()).add(name)
        return tuple(frozenset(some) for some in found.values())

    def _keys(self, output: str, count: int, came_from: Mapping[str, str]) -> list[Hashable]:
        """Return what tells the signals of an output of a fault apart: a sensor is wrong in a rate as in the value."""
        if output not in came_from:
            return [(output, k) for k in range(count)]
        sources = self.outputs(came_from[output])
        return [*(sources * count if len(sources) == 1 else sources)]

    def joined(self, faults: Mapping[str, tuple[Signal, ...]]) -> dict[str, tuple[Signal, ...]]:
        """Return the faults with every signal in one equation: one that several blocks take is made before it parts.

        Else the equations would not know that they all have the same signal.
        """
        parts = {signal for signals in faults.values() for signal in signals if len(signal) > 1}
        made: dict[Signal, Signal] = {}
        for signal in sorted(parts, key=lambda some: (-len(some), sorted(some))):
            common = frozenset.intersection(*(self.equations[name] for name in signal))
            others = [o for o in parts if o & signal and not (o <= signal or signal <= o)]
            if len(common) != 1 or others:
                continue
            name = f"node {len(made) + 1}"
            self.equations[name] = common | {name}
            for equation in signal:
                self.equations[equation] = self.equations[equation] - common | {name}
            made[signal] = frozenset({name})
        return {key: tuple(made.get(signal, signal) for signal in signals) for key, signals in faults.items()}


def _pattern(trace: BlockTrace, values: Mapping[str, np.ndarray]) -> _Pattern:
    """Return, for every output, derivative and update entry of a block, the inputs and states that stand in it.

    Parameters have their values, so that a coupling of zero is none. Beside it stands the state that an output is, or
    that is the derivative of a state: they are one unknown.
    """
    columns = [(f"in {name}", symbol) for name, symbol in trace.inputs.items()]
    columns += [(f"state {name}", symbol) for name, symbol in trace.states.items()]
    labels = [f"{name}#{k}" for name, symbol in columns for k in range(symbol.numel())]
    by = ca.vertcat(*[symbol for _, symbol in columns]) if columns else ca.SX(0, 1)
    old = list(trace.parameters.values())
    new = [ca.SX(np.ravel(values[name])) for name in trace.parameters]
    found: _Pattern = {}
    for kind, expressions in (("out", trace.outputs), ("state", trace.derivatives), ("update", trace.update)):
        for name, expression in expressions.items():
            told: Any = ca.substitute([expression], old, new)[0] if old else expression
            rows: list[list[int]] = [[] for _ in range(told.numel())]
            if by.numel():
                for i, j in zip(*ca.sparsify(ca.jacobian(told, by)).sparsity().get_triplet(), strict=True):
                    rows[i].append(j)
            for k, row in enumerate(rows):
                own = f"{'out' if kind == 'out' else 'state'} {name}#{k}"
                unknowns = tuple(labels[j] for j in row)
                is_state = len(row) == 1 and kind != "update" and labels[row[0]].startswith("state ")
                only = unknowns[0] if is_state and unknowns[0] != own and ca.is_equal(told[k], by[row[0]]) else None
                found[own, unknowns] = only
    return found
