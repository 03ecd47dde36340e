"""Evaluate one block with numbers, without the diagram, the compiler and the solvers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.block import Block, DiscreteState, Shape
from rotorsim.diagram.resolve.registry import find
from rotorsim.model.trace.block import BlockTrace, trace_block

Values = Mapping[str, Any]


@dataclass
class Words:
    """The words of shape declarations, and what they stand for."""

    shapes: dict[str, Shape] = field(default_factory=dict)
    dimensions: dict[str, int] = field(default_factory=dict)

    def learn(self, declared: Any, shape: Shape) -> None:
        if isinstance(declared, str):
            self.shapes.setdefault(declared, shape)
            assert self.shapes[declared] == shape
            return
        assert len(declared) == len(shape), (declared, shape)
        for entry, number in zip(declared, shape, strict=True):
            known = self.dimensions.setdefault(entry, number) if isinstance(entry, str) else entry
            assert known == number, (declared, shape)

    def shape(self, declared: Any) -> Shape:
        if isinstance(declared, str):
            return self.shapes.get(declared, ())
        return tuple(self.dimensions.get(entry, 1) if isinstance(entry, str) else entry for entry in declared)


KINDS = ("outputs", "derivatives", "update", "events")


@dataclass
class Prepared:
    """A block whose shapes are known: its trace and start values."""

    block: Block
    trace: BlockTrace
    shapes: dict[str, Shape]  # of inputs, outputs and random draws
    state_shapes: dict[str, Shape]
    parameters: dict[str, np.ndarray]
    initial: dict[str, np.ndarray]

    @cached_property
    def function(self) -> ca.Function:
        symbols = [*self.trace.inputs.values(), *self.trace.parameters.values()]
        symbols += [*self.trace.states.values(), *self.trace.randoms.values(), self.trace.time]
        return ca.Function("f", symbols, [value for kind in KINDS for value in getattr(self.trace, kind).values()])

    def evaluate(
        self, inputs: Values | None = None, states: Values | None = None, time: float = 0.0
    ) -> SimpleNamespace:
        """Return outputs, derivatives, update and events; states not given are at their start."""
        zeros = {name: np.zeros(self.shapes[name]) for name in (*self.trace.inputs, *self.trace.randoms)}
        at_ports = {name: zeros[name] for name in self.trace.inputs} | dict(inputs or {})
        draws = {name: zeros[name] for name in self.trace.randoms}
        inside = {**self.initial, **draws, **(states or {})}
        assert at_ports.keys() == self.trace.inputs.keys()
        assert inside.keys() == self.trace.states.keys() | self.trace.randoms.keys()
        arguments = [np.broadcast_to(at_ports[name], self.shapes[name]).ravel() for name in self.trace.inputs]
        arguments += [self.parameters[name].ravel() for name in self.trace.parameters]
        arguments += [np.broadcast_to(inside[name], self.state_shapes[name]).ravel() for name in self.trace.states]
        arguments += [np.broadcast_to(inside[name], self.shapes[name]).ravel() for name in self.trace.randoms]
        shapes = {"outputs": self.shapes, "derivatives": self.state_shapes, "update": self.state_shapes, "events": {}}
        values = iter(self.function.call([*map(ca.DM, arguments), ca.DM(time)]))
        return SimpleNamespace(
            **{
                kind: {
                    name: next(values).toarray().ravel().reshape(shapes[kind].get(name, (-1,)))
                    for name in getattr(self.trace, kind)
                }
                for kind in KINDS
            }
        )


def prepare(
    type_name: str,
    inputs: Mapping[str, Shape] | None = None,
    parameters: Values | None = None,
    options: Values | None = None,
    outputs: Mapping[str, Shape] | None = None,
) -> Prepared:
    """Trace a block with the shapes of its wired inputs (and outputs); parameters as in a diagram, SI."""
    block_class = find(type_name)
    assert block_class is not None, type_name
    return prepare_class(block_class, inputs, parameters, options, outputs)


def prepare_class(
    block_class: type[Block],
    inputs: Mapping[str, Shape] | None = None,
    parameters: Values | None = None,
    options: Values | None = None,
    outputs: Mapping[str, Shape] | None = None,
) -> Prepared:
    """Trace a block class; see `prepare`."""
    wired = dict(inputs or {})
    block = block_class(options, frozenset(wired))
    words = Words()
    declared_inputs = {
        port: (block.declared_shape(d, port), d) for d in block.inputs.values() for port in block.port_names(d)
    }
    declared_outputs = {
        port: block.declared_shape(d, port) for d in block.outputs.values() for port in block.port_names(d)
    }
    given = {name: np.asarray(value, dtype=float) for name, value in (parameters or {}).items()}
    assert given.keys() <= block.parameters.keys()
    for port, shape in wired.items():
        words.learn(declared_inputs[port][0], shape)
    for port, shape in [*(outputs or {}).items(), *block.output_shapes(wired).items()]:
        words.learn(declared_outputs[port], shape)
    for name, declaration in block.parameters.items():
        value = given.get(
            name, np.asarray(declaration.default, dtype=float) if declaration.default is not None else None
        )
        assert value is not None, f"{block.type_name}.{name} must be given"
        if value.shape:  # a number fits every shape
            words.learn(block.declared_shape(declaration), value.shape)
        given[name] = value
    present = {
        port: words.shape(declared)
        for port, (declared, d) in declared_inputs.items()
        if port in wired or not d.optional
    }
    out_shapes = {port: words.shape(declared) for port, declared in declared_outputs.items()}
    parameter_shapes = {n: words.shape(block.declared_shape(d)) for n, d in block.parameters.items()}
    state_shapes = {name: words.shape(block.declared_shape(d)) for name, d in block.active_states().items()}
    random_shapes = {name: words.shape(block.declared_shape(d)) for name, d in block.randoms.items()}
    values = {name: np.broadcast_to(given[name], shape) for name, shape in parameter_shapes.items()}
    assert block.check(values) == []
    initial = {
        name: np.broadcast_to(values[state.init] if isinstance(state.init, str) else state.init, state_shapes[name])
        for name, state in block.active_states().items()
    }
    trace = trace_block(block, present, out_shapes, parameter_shapes, state_shapes, random_shapes)
    return Prepared(block, trace, present | out_shapes | random_shapes, state_shapes, values, initial)


def state_space_of(prepared: Prepared, port: str, output: str) -> tuple[np.ndarray, ...]:
    """Return A, B, C, D of a linear block from one input port to one output port, by superposition."""
    names = list(prepared.initial)
    sizes = [prepared.initial[name].size for name in names]
    n, m = sum(sizes), int(np.prod(prepared.shapes[port], dtype=int))
    zero = {name: np.zeros_like(prepared.initial[name]) for name in names}

    def respond(state: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = np.split(state, np.cumsum(sizes)[:-1]) if names else []
        states = {name: part.reshape(zero[name].shape) for name, part in zip(names, parts, strict=True)}
        result = prepared.evaluate({port: value.reshape(prepared.shapes[port])}, states)
        rates = [result.derivatives[name].ravel() for name in names]
        return np.concatenate([*rates, np.empty(0)]), result.outputs[output].ravel()

    from_states = [respond(unit, np.zeros(m)) for unit in np.eye(n)]
    from_inputs = [respond(np.zeros(n), unit) for unit in np.eye(m)]
    outputs = int(np.prod(prepared.shapes[output], dtype=int))
    A = np.array([rate for rate, _ in from_states]).reshape(n, n).T
    C = np.array([value for _, value in from_states]).reshape(n, outputs).T
    B = np.array([rate for rate, _ in from_inputs]).reshape(m, n).T
    D = np.array([value for _, value in from_inputs]).reshape(m, outputs).T
    return A, B, C, D


def response_at(system: tuple[np.ndarray, ...], frequency: float) -> np.ndarray:
    """Return C (j w - A)^-1 B + D at the angular frequency w."""
    A, B, C, D = system
    return C @ np.linalg.solve(1j * frequency * np.eye(len(A)) - A, B) + D if len(A) else D.astype(complex)


def run_hits(prepared: Prepared, inputs: list[Values]) -> list[dict[str, np.ndarray]]:
    """Return the outputs after each sample hit, for the inputs at the hits."""
    assert all(isinstance(s, DiscreteState) for s in prepared.block.active_states().values())
    states: dict[str, np.ndarray] = dict(prepared.initial)
    outputs = []
    for given in inputs:
        draws = {name: value for name, value in given.items() if name in prepared.trace.randoms}
        at_ports = {name: value for name, value in given.items() if name not in draws}
        states = prepared.evaluate(at_ports, {**states, **draws}).update
        outputs.append(prepared.evaluate(at_ports, states).outputs)
    return outputs
