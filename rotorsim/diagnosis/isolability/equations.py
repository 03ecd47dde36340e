"""The equations of a diagram: which unknowns stand in which equation of its blocks, wires and sensors."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import casadi as ca
import networkx as nx
import numpy as np

from rotorsim.block import Shape
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.isolability.structure import Equation, Signal, Structure
from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.diagram.parse.document import endpoint
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.linear.linearisation import entry_names
from rotorsim.model.trace.block import BlockTrace
from rotorsim.model.trace.diagram import flat_indices
from rotorsim.model.trace.order import block_traces

LISTED_SIGNALS = 8  # signals that a hint lists
UNMEASURED = ("excitation", "clock")  # categories of blocks whose outputs nobody measures
T = TypeVar("T")


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
    shapes = {f"{b}.{port}": p.shape for b, node in diagram.nodes.items() for port, p in node.outputs.items()}
    entries: dict[str, None] = {}
    problems: list[Problem] = []
    for name in sensors:
        try:
            entries |= dict.fromkeys(_entries(name, shapes))
        except RotorsimError as error:
            problems += error.problems
    if not sensors:
        blocks = {name: diagram.nodes[name.rpartition(".")[0]].block for name in shapes}
        usual = [name for name in shapes if blocks[name].category not in UNMEASURED]
        usual.sort(key=lambda name: not blocks[name].roles & {"rotor", "controller"})
        problems.append(Problem("no sensors", diagram.name, hint=f"signals: {', '.join(usual[:LISTED_SIGNALS])}"))
    if problems:
        raise RotorsimError(*problems)
    return list(entries)


def _entries(name: str, shapes: Mapping[str, Shape]) -> list[str]:
    end = endpoint(name)
    if end is None:
        plain = name.partition("[")[0]
        near = [known for known in shapes if known.partition(".")[0] == plain.partition(".")[0]]
        near = near or [known for known in shapes if known.endswith(f".{plain}")] or list(shapes)[:LISTED_SIGNALS]
        hint = f"write block.port, with [node] or [node,axis] counted from 1; signals: {', '.join(near)}"
        raise RotorsimError(Problem("is not a signal", f"sensor {name}", hint=hint))
    port = f"{end.block}.{end.port}"
    if port not in shapes:
        raise RotorsimError(Problem("the diagram has no such output", f"sensor {name}", hint=near_miss(port, shapes)))
    shape = shapes[port]
    if len(end.index) > len(shape) or any(i >= n for i, n in zip(end.index, shape, strict=False)):
        what = f"no such entry: the signal is {' x '.join(map(str, shape)) or 'a single number'}"
        raise RotorsimError(Problem(what, f"sensor {name}", hint="counted from 1"))
    names = entry_names(port, shape)
    return [names[k] for k in flat_indices(shape, end.index)]


class _Builder:
    def __init__(self, diagram: Diagram) -> None:
        self.diagram = diagram
        self.same: dict[str, str] = {}  # unknown -> the one that it is, or is the derivative of
        equations: dict[Equation, set[str]] = {}
        for block, trace in block_traces(diagram).items():
            for own, unknowns, is_same in _dependencies(trace, diagram.nodes[block].values):
                name, others = f"{block}.{own}", [f"{block}.{unknown}" for unknown in unknowns]
                if is_same:
                    self.same[name] = others[0]
                else:
                    equations[name] = {name, *others}
            for port, symbol in trace.inputs.items():
                equations |= {name: {name} for name in (f"{block}.in {port}#{k}" for k in range(symbol.numel()))}
        for wire in diagram.wires:  # an input is the sum of what is wired to it
            targets = self._inputs(wire.target)
            for target, source in zip(targets, _spread(self._outputs(wire.source), len(targets)), strict=True):
                equations[target].add(source)
        self.equations = {name: frozenset(map(self.unknown, some)) for name, some in equations.items()}

    def unknown(self, name: str) -> str:
        """Return the unknown that stands for another in the equations."""
        while name in self.same:
            name = self.same[name]
        return name

    def _inputs(self, end: Endpoint) -> list[Equation]:
        shape = self.diagram.nodes[end.block].inputs[end.port].shape
        return [f"{end.block}.in {end.port}#{k}" for k in flat_indices(shape, end.index)]

    def _outputs(self, end: Endpoint) -> list[str]:
        shape = self.diagram.nodes[end.block].outputs[end.port].shape
        return [f"{end.block}.out {end.port}#{k}" for k in flat_indices(shape, end.index)]

    def outputs(self, name: str) -> list[str]:
        """Return the unknowns of a signal."""
        return [self.unknown(one) for one in self._outputs(_end(name))]

    def measure(self, name: str) -> tuple[Equation, ...]:
        """Add the equations of a sensor."""
        entries = entries_of(self.diagram, [name])
        added = {f"sensor {entry}": frozenset(self.outputs(self.diagram.as_measured(entry))) for entry in entries}
        self.equations |= added
        return tuple(added)

    def extra(self, measured: Sequence[Equation]) -> dict[str, tuple[str, ...]]:
        """Return sensors that could be added, of measured ports first: what acts on the measured, or a second one."""
        taken = frozenset().union(*(self.equations[name] for name in measured))
        ports = {name.removeprefix("sensor ").partition("[")[0] for name in measured}
        blocks = {port.partition(".")[0] for port in ports}
        acting = blocks.union(*(nx.ancestors(self.diagram.graph, block) for block in blocks))
        names: dict[tuple[str, ...], str] = {}
        for block, node in self.diagram.nodes.items():
            if block not in acting or node.block.category in UNMEASURED:
                continue
            for port, declared in node.outputs.items():
                rows = [()] if len(declared.shape) < 2 else [(k,) for k in range(declared.shape[0])]
                for end in (Endpoint(block, port, row) for row in rows):
                    unknowns = tuple(self.outputs(str(end)))
                    names.setdefault(unknowns, f"second {end}" if taken.issuperset(unknowns) else str(end))
        unknowns_of = {name: unknowns for unknowns, name in names.items()}
        return dict(sorted(unknowns_of.items(), key=lambda item: item[0].partition("[")[0] not in ports))

    def signals(self, item: Insertion) -> tuple[Signal, ...]:
        """Return the equations in which each signal of a fault stands."""
        if item.fault.enters == "replace":
            own = (f"{item.name}.out ", f"{item.name}.state ")
            return tuple(frozenset({name}) for name in self.equations if name.startswith(own))
        moves = item.fault.enters == "move"
        wires = [(_end(source), _end(target)) for source, target in (*item.wires, *(item.cut if moves else ()))]
        touched = [
            (start.port, self._inputs(end))
            for start, end in wires
            if end.block != item.name or moves  # else it is what the block of the fault takes
        ]
        for said, meant in item.measured.items():
            touched.append((_end(meant).port, [f"sensor {entry}" for entry in entries_of(self.diagram, [said])]))
        came_from = {output: item.feeds[key] for key, output in item.fault.through.items() if key in item.feeds}
        signals: dict[Hashable, set[Equation]] = {}
        for port, names in touched:  # a sensor is wrong in a rate as in the value, which are one unknown
            known = port in came_from
            keys: list[Hashable] = [*self.outputs(came_from[port])] if known else [(port, k) for k in range(len(names))]
            for key, name in zip(_spread(keys, len(names)), names, strict=True):
                if name in self.equations:  # an input that was not wired before comes with others that were
                    signals.setdefault(key, set()).add(name)
        return tuple(map(frozenset, signals.values()))

    def joined(self, faults: Mapping[str, tuple[Signal, ...]]) -> dict[str, tuple[Signal, ...]]:
        """Return the faults with every signal in one equation: one that several blocks take is made before it parts.

        Else the equations would not know that they all have the same signal.
        """
        parts = {signal for signals in faults.values() for signal in signals if len(signal) > 1}
        made: dict[Signal, Signal] = {}
        for signal in sorted(parts, key=lambda some: (-len(some), sorted(some))):
            common = frozenset.intersection(*(self.equations[name] for name in signal))
            overlaps = any(o & signal and not (o <= signal or signal <= o) for o in parts)
            if len(common) != 1 or overlaps:
                continue
            name = f"node {len(made) + 1}"
            self.equations |= {equation: self.equations[equation] - common | {name} for equation in signal}
            self.equations[name] = common | {name}
            made[signal] = frozenset({name})
        return {key: tuple(made.get(signal, signal) for signal in signals) for key, signals in faults.items()}


def _end(name: str) -> Endpoint:
    """Return the end of a wire of a diagram that is right."""
    end = endpoint(name)
    assert end is not None
    return end


def _spread(values: list[T], count: int) -> list[T]:
    """Return a single value so often, as a wire from a scalar to all entries of a port does; else the values."""
    return values * count if len(values) == 1 else values


def _dependencies(trace: BlockTrace, values: Mapping[str, np.ndarray]) -> Iterator[tuple[str, list[str], bool]]:
    """Yield every output, derivative and update entry of a block, and the inputs and states that stand in it.

    Parameters have their values, so that a coupling of zero is none. Beside it stands whether the entry is a state, or
    its derivative is one: they are one unknown.
    """
    columns = {f"in {name}": symbol for name, symbol in trace.inputs.items()}
    columns |= {f"state {name}": symbol for name, symbol in trace.states.items()}
    labels = [f"{name}#{k}" for name, symbol in columns.items() for k in range(symbol.numel())]
    by = ca.vertcat(ca.SX(0, 1), *columns.values())
    known: list[Any] = [ca.SX(np.ravel(values[name])) for name in trace.parameters]
    for kind, expressions in (("out", trace.outputs), ("state", trace.derivatives), ("update", trace.update)):
        for name, expression in expressions.items():
            [entries] = ca.substitute([expression], list(trace.parameters.values()), known)
            pattern = ca.sparsify(ca.jacobian(entries, by)).T.sparsity()  # a column for each entry
            ends, places = pattern.colind(), pattern.row()
            for k in range(entries.numel()):
                own, row = f"{'out' if kind == 'out' else 'state'} {name}#{k}", places[ends[k] : ends[k + 1]]
                unknowns = [labels[j] for j in row]
                single = kind != "update" and len(row) == 1 and unknowns[0].startswith("state ") and unknowns[0] != own
                yield own, unknowns, single and ca.is_equal(entries[k], by[row[0]])
