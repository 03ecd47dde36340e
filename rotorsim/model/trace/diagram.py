"""Trace a whole diagram: its state derivative, its signals and its sample hits as expressions of symbols.

Every block is traced once for its class, options and shapes (`rotorsim.model.trace.block`); here the
blocks are put together along the wires, in evaluation order. Algebraic loops are solved (`model.trace.loops`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.block import Shape, flatten, size_of, unflatten
from rotorsim.diagram.diagram import Diagram, Endpoint, wrong_port
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.trace.block import BlockTrace
from rotorsim.model.trace.loops import solve_loop
from rotorsim.model.trace.order import Key, block_traces, evaluation_groups, evaluation_order, feedthrough_graph

FOREIGN_CODE = (
    "FMUs are programs; they are not run unless you say so",
    "if you trust where they come from, add --trust-blocks (trust_blocks=True)",
)


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


def _column(parts: Iterable[Any]) -> Any:
    """Stack columns, also none."""
    return ca.vertcat(ca.SX(0, 1), *parts)


@dataclass
class _Layout:
    """Named columns of symbols, stacked to one vector."""

    symbols: list[Any] = field(default_factory=list)
    parts: dict[str, Signal] = field(default_factory=dict)
    size: int = 0

    def add(self, name: str, shape: Shape, unit: str | None) -> Any:
        """Return the symbols of one more quantity."""
        self.symbols.append(ca.SX.sym(name, size_of(shape)))
        self.parts[name] = _signal(name, shape, unit, self.size)
        self.size += size_of(shape)
        return self.symbols[-1]

    def column(self) -> Any:
        return _column(self.symbols)


def _signal(name: str, shape: Shape, unit: str | None, start: int = 0) -> Signal:
    return Signal(name, shape, unit, slice(start, start + size_of(shape)))


class _Tracer:
    """Puts block traces together along the wires of one diagram."""

    def __init__(self, diagram: Diagram, inject: Iterable[str], replace: Iterable[str], called: bool) -> None:
        self.diagram = diagram
        self.traces: Mapping[str, BlockTrace] = block_traces(diagram, called=called)
        self.t = ca.SX.sym("t")
        self.p, self.x, self.z, self.w, self.v = _Layout(), _Layout(), _Layout(), _Layout(), _Layout()
        self.arguments: dict[str, dict[str, Any]] = {}
        self.wires_into: dict[Key, list[tuple[Endpoint, Endpoint]]] = {}
        for wire in diagram.wires:
            self.wires_into.setdefault((wire.target.block, wire.target.port), []).append((wire.source, wire.target))
        self.inject = {self._port_key(name, taken=True): name for name in inject}
        self.replace = {self._port_key(name): name for name in replace}
        self.external: dict[Key, Any] = {}
        for (block, port), name in {**self.inject, **self.replace}.items():
            node = diagram.nodes[block]
            declared = node.outputs.get(port) or node.inputs[port]
            self.external[block, port] = self.v.add(name, declared.shape, declared.unit)
        self.samplers: list[Sampler] = []
        self.state_blocks: list[str] = []
        self._declare()
        self.hit = ca.SX.sym("hit", len(self.samplers))

    def _port_key(self, name: str, taken: bool = False) -> Key:
        block, _, port = name.rpartition(".")
        node = self.diagram.nodes.get(block)
        known = () if node is None else (*node.outputs, *(node.inputs if taken else ()))
        if port not in known:
            raise RotorsimError(wrong_port(self.diagram, name, inputs=taken))
        return block, port

    def _is_additive(self, block: str, port: str) -> bool:
        declared = self.diagram.nodes[block].inputs.get(port)
        return declared is not None and declared.additive

    def _declare(self) -> None:
        for name, node in self.diagram.nodes.items():
            block = node.block
            symbols: dict[str, Any] = {}
            for key, value in node.values.items():
                symbols[key] = self.p.add(f"{name}.{key}", np.shape(value), block.parameters[key].unit)
            active = block.active_states()
            for key, shape in node.state_shapes.items():
                discrete = active[key].discrete
                symbols[key] = (self.z if discrete else self.x).add(f"{name}.{key}", shape, active[key].unit)
                self.state_blocks += [] if discrete else [name] * size_of(shape)
            start = self.w.size
            for key, shape in node.random_shapes.items():
                symbols[key] = self.w.add(f"{name}.{key}", shape, "1")
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
            value = self._taken(wires[0][0], signals)
            return value + self.external[block, port] if (block, port) in self.inject else value
        column = ca.SX.zeros(size_of(declared.shape))
        for source, target in wires:
            column[flat_indices(declared.shape, target.index).tolist()] += self._taken(source, signals)
        return column + self.external[block, port] if (block, port) in self.inject else column

    def _taken(self, source: Endpoint, signals: Mapping[Key, Any]) -> Any:
        key = (source.block, source.port)
        value = self.external[key] if key in self.replace else signals[key]
        if key in self.inject:
            value = value + self.external[key]
        shape = self.diagram.nodes[source.block].outputs[source.port].shape
        return value[flat_indices(shape, source.index).tolist()] if source.index else value

    def known_inputs(self, block: str, ports: Iterable[str], signals: Mapping[Key, Any]) -> dict[str, Any]:
        return {port: self.input_value(block, port, signals) for port in ports}

    def output(self, key: Key, signals: Mapping[Key, Any]) -> Any:
        block, port = key
        trace = self.traces[block]
        inputs = self.known_inputs(block, trace.feedthrough[port], signals)
        return trace.function("outputs", (port,)).call(self.block_arguments(block, inputs))[0]

    def propagate(
        self, groups: Iterable[tuple[Key, ...]], output: Callable[[Key, Mapping[Key, Any]], Any]
    ) -> tuple[dict[Key, Any], list[Any]]:
        """Return every output port, evaluated in order, and what is left of the nonlinear loops among them."""
        signals: dict[Key, Any] = {}
        residuals: list[Any] = []
        for group in groups:
            key = group[0]
            if len(group) == 1 and (key in self.replace or key not in self._feeding(key)):
                signals[key] = output(key, signals)
                continue
            sizes = {key: size_of(self.diagram.nodes[key[0]].outputs[key[1]].shape) for key in group}
            solved, residual = solve_loop(group, self._feeding, output, signals, sizes)
            signals.update(solved)
            residuals += [] if residual is None else [residual]
        return signals, residuals

    def _feeding(self, key: Key) -> dict[Key, None]:
        """Return the outputs that one needs at the same instant, in order."""
        block, port = key
        ends = (end for fed in self.traces[block].feedthrough[port] for end in self.wires_into.get((block, fed), ()))
        return dict.fromkeys((source.block, source.port) for source, _ in ends)

    def _starts(self, name: str) -> Mapping[str, Any]:
        """Return where states of a block begin that says it itself."""
        node = self.diagram.nodes[name]
        values = {key: unflatten(self.arguments[name][key], np.shape(value)) for key, value in node.values.items()}
        return node.block.starts(SimpleNamespace(**values))

    def start(self, layout: _Layout) -> Any:
        """Return the initial states as expressions of p."""
        values = []
        for full_name, signal in layout.parts.items():
            block, _, state = full_name.rpartition(".")
            n = size_of(signal.shape)
            if state in (own := self._starts(block)):
                values.append(flatten(ca.SX(own[state])))
                continue
            init = self.diagram.nodes[block].block.states[state].init
            value = self.arguments[block][init] if isinstance(init, str) else ca.SX(float(init))
            values.append(value if value.shape[0] == n else ca.repmat(value, n, 1))
        return _column(values)


def trace_diagram(
    diagram: Diagram,
    inject: Iterable[str] = (),
    replace: Iterable[str] = (),
    foreign: Iterable[str] = (),
    *,
    called: bool = False,
) -> Trace:
    """Trace a diagram.

    inject, replace: output ports ("controller.current") whose consumers see the port's value plus an
    external input, or only the external input (the loop is opened there). An input ("rotor.force") can be injected
    into as well, unless an output of the block has its name. foreign: opaque blocks that are run elsewhere.
    called: opaque blocks as they are, though they are said to be linear. Raises RotorsimError.
    """
    replace = tuple(replace)
    _refuse_opaque(diagram, set(foreign))
    tracer = _Tracer(diagram, inject, replace, called)
    signals, residuals = tracer.propagate(evaluation_order(diagram, tracer.replace), tracer.output)

    shown = {f"{block}.{port}": value for (block, port), value in signals.items()}
    ports = {str(port): port for node in diagram.nodes.values() for port in node.outputs.values()}
    xdot, events, event_blocks = [], [], []
    for name, trace in tracer.traces.items():
        inputs = tracer.known_inputs(name, trace.inputs, signals)
        declared = [diagram.nodes[name].inputs[port] for port in inputs]
        sums = {str(port): port for port in declared if port.additive}
        shown |= {flat: inputs[port.name] for flat, port in sums.items()}
        ports |= sums
        arguments = tracer.block_arguments(name, inputs)
        xdot += trace.function("derivatives", tuple(trace.derivatives)).call(arguments)
        crossing = trace.function("events", tuple(trace.events)).call(arguments)
        events += crossing
        event_blocks += [name] * sum(e.shape[0] for e in crossing)
    return Trace(
        t=tracer.t,
        x=tracer.x.column(),
        z=tracer.z.column(),
        p=tracer.p.column(),
        v=tracer.v.column(),
        w=tracer.w.column(),
        hit=tracer.hit,
        xdot=_column(xdot),
        z_next=_hits(tracer) if tracer.z.size else ca.SX(0, 1),
        x0=tracer.start(tracer.x),
        z0=tracer.start(tracer.z),
        signals=shown,
        events=_column(events),
        loop_residuals=_column(residuals),
        states=tracer.x.parts,
        discrete_states=tracer.z.parts,
        parameters=tracer.p.parts,
        external=tracer.v.parts,
        ports={name: _signal(name, port.shape, port.unit) for name, port in ports.items()},
        samplers=tuple(tracer.samplers),
        state_blocks=tuple(tracer.state_blocks),
        event_blocks=tuple(event_blocks),
    )


def _refuse_opaque(diagram: Diagram, foreign: set[str]) -> None:
    """Raise RotorsimError for opaque blocks without equations to call, or not trusted, but for those run elsewhere."""
    problems = []
    for name, node in diagram.nodes.items():
        if not node.block.opaque or name in foreign:
            continue
        what, hint = node.block.untraced()
        if not what and not diagram.trusted:
            what, hint = FOREIGN_CODE
        problems += [Problem(what, name, node.place, hint)] if what else []
    if problems:
        raise RotorsimError(*problems)


def _hits(tracer: _Tracer) -> Any:
    """Return the discrete states after a hit, upstream blocks first.

    At a hit a block's outputs follow its new states, and whatever is downstream sees them.
    """
    flags = {sampler.block: tracer.hit[k] for k, sampler in enumerate(tracer.samplers)}

    def new_states(block: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
        update = tracer.traces[block].update
        values = tracer.traces[block].function("update", tuple(update)).call(tracer.block_arguments(block, inputs))
        old = tracer.arguments[block]
        return {key: ca.if_else(flags[block], v, old[key]) for key, v in zip(update, values, strict=True)}

    def output(key: Key, signals: Mapping[Key, Any]) -> Any:
        block, port = key
        trace = tracer.traces[block]
        inputs = tracer.known_inputs(block, trace.hit_feedthrough[port], signals)
        arguments = tracer.block_arguments(block, inputs, new_states(block, inputs))
        return trace.function("outputs", (port,)).call(arguments)[0]

    graph = feedthrough_graph(tracer.diagram, {name: trace.hit_feedthrough for name, trace in tracer.traces.items()})
    signals, _ = tracer.propagate(evaluation_groups(graph), output)
    return _column(
        value
        for name, trace in tracer.traces.items()
        for value in new_states(name, tracer.known_inputs(name, trace.inputs, signals)).values()
    )
