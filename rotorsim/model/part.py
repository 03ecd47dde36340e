"""A part of a diagram as a model of its own, with inputs that its surroundings set.

What crosses the boundary into the part becomes an input. Inputs are held between two settings, as discrete states
are, and live beside them in z: compiled code, instances and the C runtime need no other kind of variable.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any

import casadi as ca

from rotorsim.block import size_of
from rotorsim.diagram.diagram import Diagram, Endpoint, Wire
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.model.compiled import Model
from rotorsim.model.trace.diagram import Signal, Trace, trace_diagram


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
    _check(diagram, chosen)
    entering: dict[str, list[Wire]] = {}
    for wire in diagram.wires:
        if wire.target.block in chosen and wire.source.block not in chosen:
            entering.setdefault(f"{wire.source.block}.{wire.source.port}", []).append(wire)

    def is_added(end: Endpoint) -> bool:
        return not by_source and diagram.nodes[end.block].inputs[end.port].additive

    targets = [wire.target for wires in entering.values() for wire in wires if is_added(wire.target)]
    added = list(dict.fromkeys([*(f"{end.block}.{end.port}" for end in targets), *inputs]))
    opaque = {name: node for name, node in diagram.nodes.items() if node.block.opaque and name not in chosen}
    theirs = [str(port) for node in opaque.values() for port in node.outputs.values()]
    given = dict.fromkeys([*entering, *theirs])
    whole = trace_diagram(diagram, inject=added, replace=given, foreign=opaque, called=True)
    names: dict[str, str] = {}  # of an input -> of the external input of the trace
    for source, wires in entering.items():
        direct = [wire for wire in wires if not is_added(wire.target)]  # others only add to an input themselves
        ports = dict.fromkeys(f"{wire.target.block}.{wire.target.port}" for wire in direct)
        is_whole = len(ports) == 1 and not any(wire.source.index or wire.target.index for wire in direct)
        if direct:
            names[source if by_source or not is_whole else next(iter(ports))] = source
    names |= {port: port for port in added}
    return _restricted(diagram, whole, chosen, {name: whole.external[of] for name, of in names.items()})


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


def _restricted(diagram: Diagram, whole: Trace, blocks: tuple[str, ...], given: Mapping[str, Signal]) -> Part:
    """Return the trace of the blocks alone: their states, and the inputs behind their discrete states."""
    inside = set(blocks)
    x = [k for k, block in enumerate(whole.state_blocks) if block in inside]
    discrete = [signal for signal in whole.discrete_states.values() if _block(signal) in inside]
    z = [k for signal in discrete for k in range(signal.part.start, signal.part.stop)]
    samplers = [s for s in whole.samplers if s.block in inside]
    draws = [k for s in samplers for k in range(s.draws.start, s.draws.stop)]
    starts = accumulate((s.draws.stop - s.draws.start for s in samplers), initial=0)
    u = ca.SX.sym("u", sum(size_of(signal.shape) for signal in given.values()))
    external = _packed((replace(signal, name=name) for name, signal in given.items()), len(z))
    values = ca.SX.zeros(*whole.v.shape)
    for signal, own in zip(given.values(), external.values(), strict=True):
        values[signal.part] = u[own.part.start - len(z) : own.part.stop - len(z)]

    def told(expression: Any) -> Any:
        return ca.substitute(expression, whole.v, values) if whole.v.numel() else expression

    signals = {name: told(value) for name, value in whole.signals.items() if name.rpartition(".")[0] in inside}
    events = [k for k, block in enumerate(whole.event_blocks) if block in inside]
    trace = replace(
        whole,
        x=_rows(whole.x, x),
        z=ca.vertcat(_rows(whole.z, z), u),
        v=ca.SX(0, 1),
        w=_rows(whole.w, draws),
        hit=_rows(whole.hit, [whole.samplers.index(s) for s in samplers]),
        xdot=told(_rows(whole.xdot, x)),
        z_next=ca.vertcat(told(_rows(whole.z_next, z)), u),
        x0=_rows(whole.x0, x),
        z0=ca.vertcat(_rows(whole.z0, z), ca.SX.zeros(u.numel())),
        signals=signals,
        events=told(_rows(whole.events, events)),
        loop_residuals=told(whole.loop_residuals),
        states=_packed(signal for signal in whole.states.values() if _block(signal) in inside),
        discrete_states=_packed(discrete),
        external={},
        ports={name: signal for name, signal in whole.ports.items() if name in signals},
        samplers=tuple(
            replace(s, draws=slice(start, start + s.draws.stop - s.draws.start))
            for s, start in zip(samplers, starts, strict=False)
        ),
        state_blocks=tuple(whole.state_blocks[k] for k in x),
        event_blocks=tuple(whole.event_blocks[k] for k in events),
    )
    known = ca.vertcat(trace.t, trace.x, trace.z, trace.p, trace.w, trace.hit)
    needed = ca.symvar(ca.vertcat(trace.xdot, *signals.values()))
    if not all(ca.depends_on(known, symbol) for symbol in needed):
        raise RotorsimError(Problem("it depends on states outside", ", ".join(blocks)))
    return Part(diagram, trace, blocks, external)


def _rows(column: Any, chosen: Sequence[int]) -> Any:
    """Return rows of a column; none of one row alone is 1 x 0 to CasADi, and counts as a row beside others."""
    return column[chosen] if chosen else ca.SX(0, 1)


def _block(signal: Signal) -> str:
    return signal.name.rpartition(".")[0]


def _packed(signals: Iterable[Signal], start: int = 0) -> dict[str, Signal]:
    """Return signals by name, laid out one behind the other from a position on."""
    packed: dict[str, Signal] = {}
    for signal in signals:
        packed[signal.name] = replace(signal, part=slice(start, start + size_of(signal.shape)))
        start += size_of(signal.shape)
    return packed
