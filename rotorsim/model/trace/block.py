"""One block traced: its equations as CasADi expressions of placeholders, and what feeds through to what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca

from rotorsim.block import Block, Shape, flatten, matrix_shape, size_of, unflatten


class TraceError(Exception):
    """The equations of a block contradict its declarations; the text says how."""


@dataclass(frozen=True)
class BlockTrace:
    """Equations of one block as functions of flat columns (row-major).

    inputs, parameters, states, randoms: name -> placeholder column. time: placeholder.
    outputs, derivatives, update, events: name -> expression column.
    """

    inputs: Mapping[str, Any]
    parameters: Mapping[str, Any]
    states: Mapping[str, Any]
    randoms: Mapping[str, Any]
    time: Any
    outputs: Mapping[str, Any]
    derivatives: Mapping[str, Any]
    update: Mapping[str, Any]
    events: Mapping[str, Any]

    @cached_property
    def arguments(self) -> list[Any]:
        """The placeholders, in declared order: of inputs, parameters, states, randoms, and the time."""
        groups = (self.inputs, self.parameters, self.states, self.randoms)
        return [*(symbol for group in groups for symbol in group.values()), self.time]

    @cached_property
    def feedthrough(self) -> dict[str, tuple[str, ...]]:
        """Output port -> the input ports it depends on at the same instant (from sparsity)."""
        return {name: self._dependencies(value) for name, value in self.outputs.items()}

    @cached_property
    def hit_feedthrough(self) -> dict[str, tuple[str, ...]]:
        """Output port -> the input ports it depends on when the block's own sample hit occurs, or at any instant."""
        new, old = list(self.update.values()), [self.states[name] for name in self.update]
        values = ca.substitute(list(self.outputs.values()), old, new) if new and self.outputs else []
        updated = {name: self._dependencies(value) for name, value in zip(self.outputs, values, strict=False)}
        return {
            name: tuple(dict.fromkeys((*updated.get(name, ()), *feeding))) for name, feeding in self.feedthrough.items()
        }

    def _dependencies(self, value: Any) -> tuple[str, ...]:
        function = ca.Function("f", self.arguments, [value])
        return tuple(name for k, name in enumerate(self.inputs) if function.sparsity_jac(k, 0, True).nnz() > 0)

    def function(self, kind: str, names: tuple[str, ...]) -> ca.Function:
        """Return the CasADi function of the named outputs/derivatives/update/events of `arguments`."""
        if (kind, names) not in self._functions:
            values = [getattr(self, kind)[name] for name in names]
            self._functions[kind, names] = ca.Function("block", self.arguments, values)
        return self._functions[kind, names]

    @cached_property
    def _functions(self) -> dict[tuple[str, tuple[str, ...]], ca.Function]:
        return {}


def trace_block(
    block: Block,
    inputs: Mapping[str, Shape],
    outputs: Mapping[str, Shape],
    parameters: Mapping[str, Shape],
    states: Mapping[str, Shape],
    randoms: Mapping[str, Shape],
    *,
    called: bool = False,
) -> BlockTrace:
    """Trace the equations of a block with resolved shapes; called: as they are, though it is said to be linear.

    inputs holds only ports that are wired, additive or cut; an optional port that is missing becomes None.
    Raises TraceError when outputs, derivatives or updates are missing, unknown or of a wrong shape.
    """
    placed = [
        {name: ca.SX.sym(name, size_of(shape)) for name, shape in shapes.items()}
        for shapes in (inputs, parameters, states, randoms)
    ]
    flat_u, flat_p, flat_x, flat_r = placed
    time = ca.SX.sym("t")

    u = SimpleNamespace()
    for declaration in block.inputs.values():
        ports = block.port_names(declaration)
        values = [unflatten(flat_u[port], inputs[port]) if port in flat_u else None for port in ports]
        setattr(u, declaration.name, values if declaration.many else values[0])
    p = SimpleNamespace(**{name: unflatten(symbol, parameters[name]) for name, symbol in flat_p.items()})
    shapes = {**states, **randoms}
    x = SimpleNamespace(**{name: unflatten(symbol, shapes[name]) for name, symbol in {**flat_x, **flat_r}.items()})
    equations = (None if called else block.linear_equations(p, u, x, time)) or block.equations(p, u, x, time)

    given: dict[str, Any] = {}
    for name, output in block.outputs.items():
        if name not in equations.outputs:
            raise TraceError(f"equations give no output '{name}'")
        ports, value = block.port_names(output), equations.outputs[name]
        values = list(value) if output.many else [value]
        if len(values) != len(ports):
            raise TraceError(f"output '{name}' gives {len(values)} values for {len(ports)} ports")
        given.update(zip(ports, values, strict=True))
    _refuse_unknown("output", equations.outputs, block.outputs)

    active = block.active_states()
    discrete = {name: shape for name, shape in states.items() if active[name].discrete}
    continuous = {name: shape for name, shape in states.items() if name not in discrete}
    _refuse_unknown("derivative", equations.derivatives, continuous)
    _refuse_unknown("update", equations.update, discrete)
    _check_beginnings(block, {name: active[name].begins for name in states if active[name].begins}, inputs, states)
    return BlockTrace(
        inputs=flat_u,
        parameters=flat_p,
        states=flat_x,
        randoms=flat_r,
        time=time,
        outputs={name: _column("output", name, given[name], shape) for name, shape in outputs.items()},
        derivatives=_columns("derivative", equations.derivatives, continuous),
        update=_columns("update", equations.update, discrete),
        events={name: flatten(ca.SX(value)) for name, value in equations.events.items()},
    )


def _columns(kind: str, given: Mapping[str, Any], shapes: Mapping[str, Shape]) -> dict[str, Any]:
    for name in shapes:
        if name not in given:
            raise TraceError(f"equations give no {kind} of state '{name}'")
    return {name: _column(kind, name, given[name], shape) for name, shape in shapes.items()}


def _column(kind: str, name: str, value: Any, shape: Shape) -> Any:
    symbol = ca.SX(value)
    expected = matrix_shape(shape)
    if symbol.shape != expected and symbol.shape == (1, 1):
        symbol = ca.repmat(symbol, *expected)  # a scalar stands for every entry
    if symbol.shape != expected:
        raise TraceError(f"{kind} '{name}' has shape {symbol.shape}, declared {expected}")
    return flatten(ca.densify(symbol))


def _check_beginnings(
    block: Block, begins: Mapping[str, str], inputs: Mapping[str, Shape], states: Mapping[str, Shape]
) -> None:
    ports = {port for declaration in block.inputs.values() for port in block.port_names(declaration)}
    for name, port in begins.items():
        if port not in ports:
            raise TraceError(f"state '{name}' begins at '{port}', which is no input")
        if port in inputs and inputs[port] != states[name]:
            raise TraceError(
                f"state '{name}' has shape {states[name]}, input '{port}' that it begins at {inputs[port]}"
            )


def _refuse_unknown(kind: str, given: Mapping[str, Any], declared: Any) -> None:
    for name in given:
        if name not in declared:
            raise TraceError(f"equations give {kind} '{name}', which is not declared")
