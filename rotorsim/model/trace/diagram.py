"""Trace a whole diagram: its state derivative, its signals and its sample hits as expressions of symbols.

Every block is traced once for its class, options and shapes (`rotorsim.model.trace.block`); here the
blocks are put together along the wires, in evaluation order. Algebraic loops are solved by Newton's
method, traced like everything else: one step where the loop is linear, a fixed number otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import networkx as nx
import numpy as np

from rotorsim.block import DiscreteState, In, Shape, size_of
from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.trace.block import BlockTrace
from rotorsim.model.trace.order import block_traces, evaluation_order

__all__ = ["Sampler", "Signal", "Trace", "flat_indices", "trace_diagram"]

NEWTON_STEPS = 12
Key = tuple[str, str]  # (block, port)


@dataclass(frozen=True)
class Signal:
    """A named quantity: shape, unit, and where its row-major entries lie in the vector it belongs to."""

    name: str
    shape: Shape
    unit: str | None
    part: slice


@dataclass(frozen=True)
class Sampler:
    """A block with a sample time: where its period lies in p, its random draws in w and their seed in p."""

    block: str
    period: int
    draws: slice
    seed: int | None


@dataclass(frozen=True)
class Trace:
    """The diagram as expressions.

    t: time; x: continuous states; z: discrete states; p: parameters; v: external inputs (`inject`,
    `replace`); w: random draws; hit: one flag per sampler. xdot, z_next, x0, z0: columns.
    signals: port -> column. events: zero crossings. loop_residuals: must vanish (nonlinear loops).
    """

    t: Any
    x: Any
    z: Any
    p: Any
    v: Any
    w: Any
    hit: Any
    xdot: Any
    z_next: Any
    x0: Any
    z0: Any
    signals: Mapping[str, Any]
    events: Any
    loop_residuals: Any
    states: Mapping[str, Signal]
    discrete_states: Mapping[str, Signal]
    parameters: Mapping[str, Signal]
    external: Mapping[str, Signal]
    ports: Mapping[str, Signal]
    samplers: tuple[Sampler, ...]
    state_blocks: tuple[str, ...] = ()
    event_blocks: tuple[str, ...] = ()


def flat_indices(shape: Shape, index: tuple[int, ...]) -> np.ndarray:
    """Return the row-major positions that an index (counted from 0) selects."""
    return np.arange(size_of(shape)).reshape(shape)[index].ravel() if shape else np.arange(1)


@dataclass
class _Layout:
    """Collects named columns into one vector."""

    symbols: list[Any] = field(default_factory=list)
    parts: dict[str, Signal] = field(default_factory=dict)
    size: int = 0

    def add(self, name: str, symbol: Any, shape: Shape, unit: str | None) -> None:
        n = size_of(shape)
        self.parts[name] = Signal(name, shape, unit, slice(self.size, self.size + n))
        self.symbols.append(symbol)
        self.size += n

    def column(self) -> Any:
        return ca.vertcat(*self.symbols) if self.symbols else ca.SX(0, 1)


class _Tracer:
    """Puts block traces together along the wires of one diagram."""

    def __init__(self, diagram: Diagram, inject: Iterable[str], replace: Iterable[str]) -> None:
        self.diagram = diagram
        self.traces: Mapping[str, BlockTrace] = block_traces(diagram)
        self.t = ca.SX.sym("t")
        self.p, self.x, self.z, self.w, self.v = _Layout(), _Layout(), _Layout(), _Layout(), _Layout()
        self.arguments: dict[str, dict[str, Any]] = {}
        self.wires_into: dict[Key, list[tuple[Endpoint, Endpoint]]] = {}
        for wire in diagram.wires:
            self.wires_into.setdefault((wire.target.block, wire.target.port), []).append((wire.source, wire.target))
        self.inject = {self._port_key(name, additive=True): name for name in inject}
        self.replace = {self._port_key(name): name for name in replace}
        self.external: dict[Key, Any] = {}
        for key, name in {**self.inject, **self.replace}.items():
            node = diagram.nodes[key[0]]
            port = node.outputs.get(key[1]) or node.inputs[key[1]]
            self.external[key] = ca.SX.sym("v", size_of(port.shape))
            self.v.add(name, self.external[key], port.shape, port.unit)
        self.samplers: list[Sampler] = []
        self.state_blocks: list[str] = []
        self._declare()
        self.hit = ca.SX.sym("hit", len(self.samplers))

    def _port_key(self, name: str, additive: bool = False) -> Key:
        block, _, port = name.rpartition(".")
        node = self.diagram.nodes.get(block)
        if node is None or not (port in node.outputs or (additive and self._is_additive(block, port))):
            ports = "output port or additive input" if additive else "output port"
            raise RotorsimError(Problem(what=f"no such {ports}", subject=name))
        return block, port

    def _is_additive(self, block: str, port: str) -> bool:
        declared = self.diagram.nodes[block].inputs.get(port)
        return declared is not None and isinstance(declared.declaration, In) and declared.declaration.additive

    def _declare(self) -> None:
        for name, node in self.diagram.nodes.items():
            block = node.block
            symbols: dict[str, Any] = {}
            for key, value in node.values.items():
                symbols[key] = ca.SX.sym(key, int(np.size(value)))
                self.p.add(f"{name}.{key}", symbols[key], np.shape(value), block.parameters[key].unit)
            active = block.active_states()
            for key, shape in node.state_shapes.items():
                symbols[key] = ca.SX.sym(key, size_of(shape))
                layout = self.z if isinstance(active[key], DiscreteState) else self.x
                layout.add(f"{name}.{key}", symbols[key], shape, active[key].unit)
                if layout is self.x:
                    self.state_blocks += [name] * size_of(shape)
            start = self.w.size
            for key, shape in node.random_shapes.items():
                symbols[key] = ca.SX.sym(key, size_of(shape))
                self.w.add(f"{name}.{key}", symbols[key], shape, "1")
            if block.sample_time is not None:
                seeds = [self.p.parts[f"{name}.{block.randoms[key].seed}"].part.start for key in node.random_shapes]
                period = self.p.parts[f"{name}.{block.sample_time}"].part.start
                draws = slice(start, self.w.size)
                self.samplers.append(Sampler(name, period, draws, seeds[0] if seeds else None))
            self.arguments[name] = symbols

    def block_arguments(
        self, name: str, inputs: Mapping[str, Any], states: Mapping[str, Any] | None = None
    ) -> list[Any]:
        """Return the arguments of the functions of a block; inputs not yet known are zero."""
        trace = self.traces[name]
        own = self.arguments[name]
        given = [inputs[port] if port in inputs else ca.SX(*symbol.shape) for port, symbol in trace.inputs.items()]
        state = [(states or {}).get(key, own[key]) for key in trace.states]
        return [*given, *(own[key] for key in trace.parameters), *state, *(own[key] for key in trace.randoms), self.t]

    def input_value(self, block: str, port: str, signals: Mapping[Key, Any]) -> Any:
        """Return the value of an input port: its wire, the sum of its wires, or zero when it is cut."""
        declared = self.diagram.nodes[block].inputs[port]
        wires = self.wires_into.get((block, port), [])
        if not self._is_additive(block, port) and len(wires) == 1 and not wires[0][1].index:
            return self._taken(wires[0][0], signals)
        total = ca.SX.zeros(size_of(declared.shape))
        entries = ca.vertsplit(total) if declared.shape else [total]
        for source, target in wires:
            value = self._taken(source, signals)
            parts = ca.vertsplit(value) if value.shape[0] > 1 else [value]
            where = flat_indices(declared.shape, target.index)
            if len(parts) == 1 and len(where) > 1:
                parts = parts * len(where)
            for position, part in zip(where, parts, strict=True):
                entries[position] = entries[position] + part
        column = ca.vertcat(*entries)
        return column + self.external[block, port] if (block, port) in self.inject else column

    def _taken(self, source: Endpoint, signals: Mapping[Key, Any]) -> Any:
        key = (source.block, source.port)
        value = signals[key]
        if key in self.replace:
            value = self.external[key]
        elif key in self.inject:
            value = value + self.external[key]
        if source.index:
            shape = self.diagram.nodes[source.block].outputs[source.port].shape
            return value[flat_indices(shape, source.index).tolist()]
        return value

    def known_inputs(self, block: str, ports: Iterable[str], signals: Mapping[Key, Any]) -> dict[str, Any]:
        return {port: self.input_value(block, port, signals) for port in ports}

    def output(self, key: Key, signals: Mapping[Key, Any]) -> Any:
        block, port = key
        trace = self.traces[block]
        inputs = self.known_inputs(block, trace.feedthrough[port], signals)
        return trace.function("outputs", (port,)).call(self.block_arguments(block, inputs))[0]

    def propagate(
        self, groups: Iterable[tuple[Key, ...]], output: Callable[..., Any], residuals: list[Any]
    ) -> dict[Key, Any]:
        """Evaluate every output port in order; solve the groups that are loops."""
        signals: dict[Key, Any] = {}
        for group in groups:
            if len(group) == 1 and not self._self_loop(group[0]):
                signals[group[0]] = output(group[0], signals)
            else:
                self._solve_loop(group, signals, output, residuals)
        return signals

    def _self_loop(self, key: Key) -> bool:
        feeding = self.traces[key[0]].feedthrough[key[1]]
        sources = {(s.block, s.port) for port in feeding for s, _ in self.wires_into.get((key[0], port), ())}
        return key in sources and key not in self.replace

    def _solve_loop(
        self, group: tuple[Key, ...], signals: dict[Key, Any], output: Callable[..., Any], residuals: list[Any]
    ) -> None:
        """Solve r(v) = F(v) - v = 0 for the torn signals v of one loop by Newton's method.

        Every signal of the group is torn that no later one can be computed without; the rest follow.
        """
        torn, order = self._tear(group)
        guess = {key: ca.SX.sym("loop", size_of(self._shape(key))) for key in torn}

        def sweep(values: Mapping[Key, Any]) -> dict[Key, Any]:
            known = {**signals, **values}
            for key in order:
                known[key] = output(key, known)
            return {key: output(key, known) if key in torn else known[key] for key in group}

        unknown = ca.vertcat(*guess.values())
        computed = sweep(guess)
        residual = ca.vertcat(*[computed[key] for key in torn]) - unknown
        jacobian = ca.jacobian(residual, unknown)
        others = [s for s in ca.symvar(ca.vertcat(residual, ca.vec(jacobian))) if not _is_in(s, unknown)]
        newton = ca.Function("newton", [unknown, *others], [unknown - ca.solve(jacobian, residual), residual])
        linear = not ca.depends_on(jacobian, unknown)
        value = ca.SX.zeros(unknown.shape[0])
        for _ in range(1 if linear else NEWTON_STEPS):
            value = newton.call([value, *others])[0]
        if not linear:
            residuals.append(newton.call([value, *others])[1] / (1 + ca.fabs(value)))
        found = dict(
            zip(torn, ca.vertsplit(value, np.cumsum([0, *(g.shape[0] for g in guess.values())]).tolist()), strict=True)
        )
        known = {**signals, **found}
        for key in order:
            known[key] = output(key, known)
        signals.update({key: known[key] for key in group})

    def _shape(self, key: Key) -> Shape:
        return self.diagram.nodes[key[0]].outputs[key[1]].shape

    def _tear(self, group: tuple[Key, ...]) -> tuple[list[Key], list[Key]]:
        graph = nx.DiGraph()
        graph.add_nodes_from(group)
        members = set(group)
        for key in group:
            for port in self.traces[key[0]].feedthrough[key[1]]:
                for source, _ in self.wires_into.get((key[0], port), ()):
                    if (source.block, source.port) in members:
                        graph.add_edge((source.block, source.port), key)
        torn: list[Key] = []
        while True:
            cycle = next((c for c in nx.strongly_connected_components(graph) if len(c) > 1), None)
            loops = list(nx.nodes_with_selfloops(graph))
            if cycle is None and not loops:
                break
            best = loops[0] if loops else min(cycle or (), key=lambda k: (size_of(self._shape(k)), -graph.degree(k), k))
            torn.append(best)
            graph.remove_node(best)
        return torn, list(nx.topological_sort(graph))


def _is_in(symbol: Any, column: Any) -> bool:
    return bool(ca.depends_on(column, symbol))


def trace_diagram(diagram: Diagram, inject: Iterable[str] = (), replace: Iterable[str] = ()) -> Trace:
    """Trace a diagram.

    inject, replace: output ports ("controller.current") whose consumers see the port's value plus an
    external input, or only the external input (the loop is opened there). An additive input ("rotor.force")
    can be injected into as well. Raises RotorsimError.
    """
    replace = tuple(replace)
    _refuse_opaque(diagram, set(replace))
    tracer = _Tracer(diagram, inject, replace)
    residuals: list[Any] = []
    signals = tracer.propagate(evaluation_order(diagram), tracer.output, residuals)

    xdot, events, event_blocks = _Layout(), [], []
    shown = {f"{block}.{port}": value for (block, port), value in signals.items()}
    ports = {
        f"{block}.{port}": Signal(f"{block}.{port}", declared.shape, declared.unit, slice(0, size_of(declared.shape)))
        for block, node in diagram.nodes.items()
        for port, declared in node.outputs.items()
    }
    for name in diagram.nodes:
        trace = tracer.traces[name]
        inputs = tracer.known_inputs(name, trace.inputs, signals)
        for port, declared in diagram.nodes[name].inputs.items():
            if port in inputs and getattr(declared.declaration, "additive", False):
                shown[f"{name}.{port}"] = inputs[port]
                part = slice(0, size_of(declared.shape))
                ports[f"{name}.{port}"] = Signal(f"{name}.{port}", declared.shape, declared.unit, part)
        arguments = tracer.block_arguments(name, inputs)
        if trace.derivatives:
            values = trace.function("derivatives", tuple(trace.derivatives)).call(arguments)
            xdot.symbols += values
        if trace.events:
            crossing = trace.function("events", tuple(trace.events)).call(arguments)
            events += crossing
            event_blocks += [name] * sum(e.shape[0] for e in crossing)
    z_next = _hits(tracer) if tracer.z.size else ca.SX(0, 1)
    return Trace(
        t=tracer.t,
        x=tracer.x.column(),
        z=tracer.z.column(),
        p=tracer.p.column(),
        v=tracer.v.column(),
        w=tracer.w.column(),
        hit=tracer.hit,
        xdot=xdot.column(),
        z_next=z_next,
        x0=_initial(tracer, tracer.x),
        z0=_initial(tracer, tracer.z),
        signals=shown,
        events=ca.vertcat(*events) if events else ca.SX(0, 1),
        loop_residuals=ca.vertcat(*residuals) if residuals else ca.SX(0, 1),
        states=tracer.x.parts,
        discrete_states=tracer.z.parts,
        parameters=tracer.p.parts,
        external=tracer.v.parts,
        ports=ports,
        samplers=tuple(tracer.samplers),
        state_blocks=tuple(tracer.state_blocks),
        event_blocks=tuple(event_blocks),
    )


def _refuse_opaque(diagram: Diagram, replaced: set[str]) -> None:
    """Raise RotorsimError for blocks without equations of their own whose outputs somebody needs."""
    problems = []
    for name, node in diagram.nodes.items():
        if node.block.opaque:
            needed = {f"{w.source.block}.{w.source.port}" for w in diagram.wires if w.source.block == name}
            if needed - replaced:
                hint = "`rotorsim cosim` runs diagrams with FMUs"
                problems.append(Problem("is an FMU: its equations are not at hand", name, node.place, hint))
    if problems:
        raise RotorsimError(*problems)


def _hits(tracer: _Tracer) -> Any:
    """Return the discrete states after a hit, upstream blocks first.

    At a hit a block's outputs follow its new states, and whatever is downstream sees them.
    """
    flags = {sampler.block: k for k, sampler in enumerate(tracer.samplers)}

    def new_states(block: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
        trace = tracer.traces[block]
        if not trace.update:
            return {}
        values = trace.function("update", tuple(trace.update)).call(tracer.block_arguments(block, inputs))
        flag = tracer.hit[flags[block]]
        old = tracer.arguments[block]
        return {key: ca.if_else(flag, v, old[key]) for key, v in zip(trace.update, values, strict=True)}

    def output(key: Key, signals: Mapping[Key, Any]) -> Any:
        block, port = key
        trace = tracer.traces[block]
        needed = dict.fromkeys((*trace.feedthrough[port], *trace.update_feedthrough[port]))
        inputs = tracer.known_inputs(block, needed, signals)
        states = new_states(block, inputs)
        return trace.function("outputs", (port,)).call(tracer.block_arguments(block, inputs, states))[0]

    graph = nx.DiGraph()
    for name, trace in tracer.traces.items():
        for port, feeding in trace.update_feedthrough.items():
            graph.add_node((name, port))
            for fed in dict.fromkeys((*feeding, *trace.feedthrough[port])):
                for source, _ in tracer.wires_into.get((name, fed), ()):
                    graph.add_edge((source.block, source.port), (name, port))
    condensed = nx.condensation(graph)
    groups = [tuple(sorted(condensed.nodes[k]["members"])) for k in nx.topological_sort(condensed)]
    signals = tracer.propagate(groups, output, [])
    values: list[Any] = []
    for name in tracer.diagram.nodes:
        trace = tracer.traces[name]
        if trace.update:
            values += new_states(name, tracer.known_inputs(name, trace.inputs, signals)).values()
    return ca.vertcat(*values)


def _initial(tracer: _Tracer, layout: _Layout) -> Any:
    """Return the initial states as expressions of p."""
    values = []
    for full_name, signal in layout.parts.items():
        block, _, state = full_name.rpartition(".")
        init = tracer.diagram.nodes[block].block.states[state].init
        n = size_of(signal.shape)
        value = tracer.arguments[block][init] if isinstance(init, str) else ca.SX(float(init))
        values.append(value if value.shape[0] == n else ca.repmat(value, n, 1))
    return ca.vertcat(*values) if values else ca.SX(0, 1)
