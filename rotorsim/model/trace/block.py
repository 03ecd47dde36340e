"""One block traced: its equations as CasADi expressions of placeholders, and what feeds through to what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca

from rotorsim.block import Block, Shape, flatten, matrix_shape, size_of, unflatten

__all__ = ["BlockTrace", "TraceError", "trace_block"]


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
        names = list(self.inputs)
        if not names:
            return ()
        function = ca.Function("f", [*self.inputs.values(), *self._others()], [value])
        return tuple(name for k, name in enumerate(names) if function.sparsity_jac(k, 0, True).nnz() > 0)

    def _others(self) -> list[Any]:
        return [*self.parameters.values(), *self.states.values(), *self.randoms.values(), self.time]

    def function(self, kind: str, names: tuple[str, ...]) -> ca.Function:
        """Return the CasADi function of the named outputs/derivatives/update/events.

        Its arguments are all inputs, parameters, states, randoms and the time, in declared order.
        """
        cache: dict[Any, ca.Function] = self.__dict__.setdefault("_functions", {})
        if (kind, names) not in cache:
            values = [getattr(self, kind)[name] for name in names]
            cache[kind, names] = ca.Function("block", [*self.inputs.values(), *self._others()], values)
        return cache[kind, names]


def trace_block(
    block: Block,
    inputs: Mapping[str, Shape],
    outputs: Mapping[str, Shape],
    parameters: Mapping[str, Shape],
    states: Mapping[str, Shape],
    randoms: Mapping[str, Shape],
) -> BlockTrace:
    """Trace the equations of a block with resolved shapes.

    inputs holds only ports that are wired, additive or cut; an optional port that is missing becomes None.
    Raises TraceError when outputs, derivatives or updates are missing, unknown or of a wrong shape.
    """
    flat_u = {name: ca.SX.sym(name, size_of(shape)) for name, shape in inputs.items()}
    flat_p = {name: ca.SX.sym(name, size_of(shape)) for name, shape in parameters.items()}
    flat_x = {name: ca.SX.sym(name, size_of(shape)) for name, shape in states.items()}
    flat_r = {name: ca.SX.sym(name, size_of(shape)) for name, shape in randoms.items()}
    time = ca.SX.sym("t")

    u = SimpleNamespace()
    for declaration in block.inputs.values():
        values = [
            unflatten(flat_u[port], inputs[port]) if port in flat_u else None for port in block.port_names(declaration)
        ]
        setattr(u, declaration.name, values if declaration.many else values[0])
    p = SimpleNamespace(**{name: unflatten(flat_p[name], parameters[name]) for name in parameters})
    x = SimpleNamespace(
        **{name: unflatten(flat_x[name], states[name]) for name in states},
        **{name: unflatten(flat_r[name], randoms[name]) for name in randoms},
    )
    equations = block.equations(p, u, x, time)

    given: dict[str, Any] = {}
    for port_declaration in block.outputs.values():
        if port_declaration.name not in equations.outputs:
            raise TraceError(f"equations give no output '{port_declaration.name}'")
        value = equations.outputs[port_declaration.name]
        ports = block.port_names(port_declaration)
        values = list(value) if port_declaration.many else [value]
        if len(values) != len(ports):
            raise TraceError(f"output '{port_declaration.name}' gives {len(values)} values for {len(ports)} ports")
        given.update(zip(ports, values, strict=True))
    _refuse_unknown("output", equations.outputs, block.outputs)

    discrete = {name for name, state in block.active_states().items() if type(state).__name__ == "DiscreteState"}
    continuous = {name: shape for name, shape in states.items() if name not in discrete}
    _refuse_unknown("derivative", equations.derivatives, continuous)
    _refuse_unknown("update", equations.update, discrete)
    return BlockTrace(
        inputs=flat_u,
        parameters=flat_p,
        states=flat_x,
        randoms=flat_r,
        time=time,
        outputs={name: _column("output", name, given[name], shape) for name, shape in outputs.items()},
        derivatives=_columns("derivative", equations.derivatives, continuous),
        update=_columns("update", equations.update, {name: states[name] for name in states if name in discrete}),
        events={name: flatten(ca.SX(value)) for name, value in equations.events.items()},
    )


def _columns(kind: str, given: Mapping[str, Any], shapes: Mapping[str, Shape]) -> dict[str, Any]:
    missing = [name for name in shapes if name not in given]
    if missing:
        raise TraceError(f"equations give no {kind} of state '{missing[0]}'")
    return {name: _column(kind, name, given[name], shape) for name, shape in shapes.items()}


def _column(kind: str, name: str, value: Any, shape: Shape) -> Any:
    symbol = ca.SX(value)
    expected = matrix_shape(shape)
    if symbol.shape != expected and symbol.shape == (1, 1):
        symbol = ca.repmat(symbol, *expected)  # a scalar stands for every entry
    if symbol.shape != expected:
        raise TraceError(f"{kind} '{name}' has shape {symbol.shape}, declared {expected}")
    return flatten(ca.densify(symbol))


def _refuse_unknown(kind: str, given: Mapping[str, Any], declared: Any) -> None:
    for name in given:
        if name not in declared:
            raise TraceError(f"equations give {kind} '{name}', which is not declared")
