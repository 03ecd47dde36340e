"""A part of a diagram as a model of its own, with inputs that its surroundings set.

What crosses the boundary into the part becomes an input. Inputs are held between two settings, as discrete states
are, and live beside them in z: compiled code, instances and the C runtime need no other kind of variable.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca

from rotorsim.block import In, Shape, size_of
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.model.compiled import Model
from rotorsim.model.trace.diagram import Signal, Trace, trace_diagram

__all__ = ["Part", "open_part"]


class Part(Model):
    """The model of some blocks of a diagram. inputs: name -> shape, unit and place in z; blocks: what it holds.

    States, signals and discrete states are those of its blocks only; p is that of the whole diagram.
    """

    def __init__(self, diagram: Diagram, trace: Trace, blocks: tuple[str, ...], inputs: Mapping[str, Signal]) -> None:
        super().__init__(diagram, trace)
        self.blocks = blocks
        self.inputs = dict(inputs)

    @property
    def own_parameters(self) -> dict[str, slice]:
        """The parameters of its blocks: name -> place in p."""
        return {name: part for name, part in self.parameters.items() if name.rpartition(".")[0] in set(self.blocks)}


def open_part(
    diagram: Diagram, blocks: Iterable[str] | None = None, *, inputs: Iterable[str] = (), by_source: bool = False
) -> Part:
    """Return some blocks of a diagram (default: all) as a model with inputs.

    Its inputs are the input ports that blocks outside feed ("rotor.force": the sum of what comes from outside), and
    the ``inputs`` named: input ports that nothing feeds, or additive ones. by_source: name an input after the output
    port that feeds it ("controller.current") instead of the input port, one for all that it feeds.

    Raises RotorsimError for blocks and ports that do not exist.
    """
    chosen = tuple(diagram.nodes) if blocks is None else tuple(dict.fromkeys(blocks))
    inside = set(chosen)
    _check(diagram, chosen)
    crossing = [w for w in diagram.wires if w.target.block in inside and w.source.block not in inside]
    sources = list(dict.fromkeys(f"{w.source.block}.{w.source.port}" for w in crossing))
    added = [] if by_source else [f"{w.target.block}.{w.target.port}" for w in crossing if _additive(diagram, w.target)]
    added = list(dict.fromkeys([*added, *inputs]))
    foreign = [
        f"{name}.{port}"
        for name, node in diagram.nodes.items()
        if node.block.opaque and name not in inside
        for port in node.outputs
    ]
    whole = trace_diagram(diagram, inject=added, replace=list(dict.fromkeys([*sources, *foreign])))
    names: dict[str, tuple[Shape, str | None, Any]] = {}
    values = ca.SX.zeros(*whole.v.shape)
    fed: dict[str, list[Any]] = {}
    for wire in crossing:
        fed.setdefault(f"{wire.source.block}.{wire.source.port}", []).append(wire.target)
    for source in sources:
        signal = whole.external[source]
        ends = [end for end in fed[source] if by_source or not _additive(diagram, end)]
        if not ends:
            continue  # it only adds to a port that is an input itself
        ports = dict.fromkeys(f"{end.block}.{end.port}" for end in ends)
        whole_port = len(ports) == 1 and not any(w.source.index or w.target.index for w in crossing if w.target in ends)
        name = source if by_source or not whole_port else next(iter(ports))
        symbol = ca.SX.sym("u", size_of(signal.shape))
        names[name] = (signal.shape, signal.unit, symbol)
        values[signal.part] = symbol
    for port in added:
        signal = whole.external[port]
        symbol = ca.SX.sym("u", size_of(signal.shape))
        names[port] = (signal.shape, signal.unit, symbol)
        values[signal.part] = symbol
    return _restricted(diagram, whole, chosen, names, values)


def _check(diagram: Diagram, blocks: tuple[str, ...]) -> None:
    problems = [
        Problem("no such block", block, hint=near_miss(block, diagram.nodes))
        for block in blocks
        if block not in diagram.nodes
    ]
    if problems:
        raise RotorsimError(*problems)
    if not blocks:
        raise RotorsimError(Problem("the part has no blocks", diagram.name))


def _additive(diagram: Diagram, end: Any) -> bool:
    declared = diagram.nodes[end.block].inputs[end.port].declaration
    return isinstance(declared, In) and declared.additive


def _restricted(
    diagram: Diagram,
    whole: Trace,
    blocks: tuple[str, ...],
    names: Mapping[str, tuple[Shape, str | None, Any]],
    values: Any,
) -> Part:
    """Return the trace of the blocks alone: their states, and the inputs behind their discrete states."""
    inside = set(blocks)
    x = [k for k, block in enumerate(whole.state_blocks) if block in inside]
    discrete = {name: signal for name, signal in whole.discrete_states.items() if name.rpartition(".")[0] in inside}
    z = [k for signal in discrete.values() for k in range(signal.part.start, signal.part.stop)]
    samplers = [s for s in whole.samplers if s.block in inside]
    draws = [k for s in samplers for k in range(s.draws.start, s.draws.stop)]
    hits = [whole.samplers.index(s) for s in samplers]
    symbols = [symbol for _, _, symbol in names.values()]
    u = ca.vertcat(*symbols) if symbols else ca.SX(0, 1)

    def told(expression: Any) -> Any:
        return ca.substitute(expression, whole.v, values) if whole.v.numel() else expression

    signals = {name: told(value) for name, value in whole.signals.items() if name.rpartition(".")[0] in inside}
    events = [k for k, block in enumerate(whole.event_blocks) if block in inside]
    moved: list[Any] = []
    count = 0
    for sampler in samplers:
        width = sampler.draws.stop - sampler.draws.start
        moved.append(replace(sampler, draws=slice(count, count + width)))
        count += width
    external: dict[str, Signal] = {}
    start = len(z)
    for name, (shape, unit, _) in names.items():
        external[name] = Signal(name, shape, unit, slice(start, start + size_of(shape)))
        start += size_of(shape)
    trace = replace(
        whole,
        x=whole.x[x],
        z=ca.vertcat(whole.z[z], u),
        v=ca.SX(0, 1),
        w=whole.w[draws],
        hit=whole.hit[hits],
        xdot=told(whole.xdot[x]),
        z_next=ca.vertcat(told(whole.z_next[z]) if z else ca.SX(0, 1), u),
        x0=whole.x0[x],
        z0=ca.vertcat(whole.z0[z], ca.SX.zeros(u.numel())),
        signals=signals,
        events=told(whole.events[events]) if events else ca.SX(0, 1),
        loop_residuals=told(whole.loop_residuals),
        states=_packed(whole.states, inside),
        discrete_states=_packed(whole.discrete_states, inside),
        external={},
        ports={name: signal for name, signal in whole.ports.items() if name in signals},
        samplers=tuple(moved),
        state_blocks=tuple(whole.state_blocks[k] for k in x),
        event_blocks=tuple(whole.event_blocks[k] for k in events),
    )
    outside = [s for s in ca.symvar(ca.vertcat(trace.xdot, *signals.values())) if _is_foreign(s, trace)]
    if outside:
        raise RotorsimError(Problem("it depends on states outside", ", ".join(blocks)))
    return Part(diagram, trace, blocks, external)


def _packed(signals: Mapping[str, Signal], inside: set[str]) -> dict[str, Signal]:
    packed: dict[str, Signal] = {}
    count = 0
    for name, signal in signals.items():
        if name.rpartition(".")[0] in inside:
            n = signal.part.stop - signal.part.start
            packed[name] = replace(signal, part=slice(count, count + n))
            count += n
    return packed


def _is_foreign(symbol: Any, trace: Trace) -> bool:
    known = ca.vertcat(trace.t, trace.x, trace.z, trace.p, trace.w, trace.hit)
    return not ca.depends_on(known, symbol)
