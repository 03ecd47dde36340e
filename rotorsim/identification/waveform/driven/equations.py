"""The traced equations of a diagram driven by recorded signals, with their exact Jacobians."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.driven.domain import AT_ZERO, continued
from rotorsim.identification.waveform.driven.slow_modes import Structure, structure_of
from rotorsim.linear import linearisation as linear
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.model.linearity import is_affine, jacobian, pattern
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.equations import reached_states, slots_of

RATES = {"acceleration": "velocity", "velocity": "displacement"}  # recorded, but no port: the rate of this one
OF_THE_ANGLE = ("theta", "speed", "acceleration")  # of a shaft: outputs of a clock that its angle tells
POWERS = tuple((order - j, j) for order in (0, 2, 3, 4, 5) for j in range(order + 1))
WIDTHS = (0.02, 0.2)  # over which friction changes its sign, of the largest velocity


@dataclass(frozen=True)
class ForceMap:
    """A force at an additive port of a scalar block that may be any smooth law of displacement and velocity there.

    f = sum c_ij (q / q0)^i (q' / v0)^j + sum d_k tanh(q' / (w_k v0)),   i + j = 0, 2, 3, 4, 5

    port: takes the force; displacement, velocity: signals q and q'; sizes: q0 and v0.
    """

    port: str
    displacement: str
    velocity: str
    sizes: tuple[float, float]

    @property
    def count(self) -> int:
        """The number of coefficients."""
        return len(POWERS) + len(WIDTHS)

    def force(self, q: Any, v: Any, c: Any) -> Any:
        """Return the force as an expression."""
        a, b = q / self.sizes[0], v / self.sizes[1]
        terms = [a**i * b**j for i, j in POWERS] + [ca.tanh(b / width) for width in WIDTHS]
        return sum((c[k] * term for k, term in enumerate(terms)), ca.SX(0))


def driven_parameters(diagram: Diagram) -> dict[str, str]:
    """Return signal -> parameter for the blocks of category input: what a recording gives takes its place."""
    return {
        f"{name}.{port}": f"{name}.value"
        for name, node in diagram.nodes.items()
        if node.block.category == "input" and "value" in node.values
        for port in node.outputs
    }


def clock_ports(diagram: Diagram) -> tuple[str, ...]:
    """Return the outputs of clocks that the recorded angle of a shaft tells."""
    clocks = ((name, node) for name, node in diagram.nodes.items() if node.block.category == "clock")
    return tuple(f"{name}.{port}" for name, node in clocks for port in node.outputs if port in OF_THE_ANGLE)


def measured_expression(model: Model, name: str) -> Any:
    """Return a recorded signal as an expression: a port, or the rate of one (the acceleration of a block).

    Raises RotorsimError when the diagram has no such signal.
    """
    meant = model.diagram.as_measured(name)
    base, bracket, inside = meant.partition("[")
    block, _, port = base.rpartition(".")
    if base in model.signals or f"{block}.{RATES.get(port)}" not in model.signals:
        return model.expression(meant)
    return rate_of(model, measured_expression(model, f"{block}.{RATES[port]}{bracket}{inside}"))


def rate_of(model: Model, of: Any) -> Any:
    """Return the time derivative of an expression of the states."""
    trace = model.trace
    return ca.jtimes(of, trace.x, trace.xdot) + ca.jtimes(of, trace.t, ca.SX(1))


@dataclass(frozen=True, eq=False)
class DrivenEquations:
    """dx/dt = f(t, x, v; p), y = g(t, x, v; p): n states that the outputs depend on, m free parameters.

    kept (n,): of the states of the model, with names. inputs: flat names of what v holds. p: parameters of the model,
    then the coefficients of a `ForceMap`; slots: the entries of p that each of the m parameters sets. arguments: t, x,
    v, p. f (n,), g (c,). fastest: frequency [rad/s] of modes beyond which only their flexibility stays
    (`rotorsim.identification.waveform.driven.slow_modes`); None: all stay. begun: expressions of where states begin,
    {state: of the arguments} (`State.begins`). limited: whether p has a last entry, the least argument of laws that are
    not defined below zero (`rotorsim.identification.waveform.driven.domain`). structure: what they are of without the
    modes that do not stay.
    """

    model: Model
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    free: tuple[Free, ...]
    kept: np.ndarray
    state_names: tuple[str, ...]
    slots: Sequence[Sequence[int]]
    arguments: tuple[Any, Any, Any, Any]
    f: Any
    g: Any
    fastest: float | None = None
    begun: Mapping[int, Any] = field(default_factory=dict)
    limited: bool = False
    structure: Structure | None = None

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.kept)

    @property
    def m(self) -> int:
        """The number of free parameters, with the coefficients of a `ForceMap`."""
        return len(self.slots)

    @cached_property
    def calls(self) -> bool:
        """Whether they call functions without an expression (`rotorsim.model.called`)."""
        return bool(ca.Function("f", [*self.arguments], [self.f, self.g]).get_function())

    @cached_property
    def measured_states(self) -> Mapping[int, tuple[str, float]]:
        """State -> output and factor, where an output is a constant times one state and nothing else."""
        x, measured = self.arguments[1], {}
        counts = np.bincount(pattern(self.g, x).get_triplet()[0], minlength=len(self.outputs))
        for output, y, count in zip(self.outputs, ca.vertsplit(self.g), counts, strict=True):
            if count != 1:
                continue
            row = ca.sparsify(jacobian(y, x))
            if row.nnz() == 1 and row.nz[0].is_constant() and output not in self.inputs:
                [k], factor = row.sparsity().get_triplet()[1], float(row.nz[0])
                if (y - factor * x[k]).is_zero():
                    measured[k] = output, factor
        return measured

    def beginning(
        self, t: float, x: np.ndarray, v: np.ndarray, p: np.ndarray, known: Collection[int] = ()
    ) -> np.ndarray:
        """Return the states x (n,) at the first sample, those of `begun` that are not known as the others say."""
        x, wanted = np.array(x, float), [k for k in self.begun if k not in known]
        for _ in wanted:  # one may begin where another does
            found = dict(zip(self.begun, self._beginnings(t, x, v, p)[0, :, 0].tolist(), strict=True))
            x[wanted] = [found[k] if np.isfinite(found[k]) else x[k] for k in wanted]
        return x

    @cached_property
    def _beginnings(self) -> MatrixFunction:
        return MatrixFunction(self.arguments, ca.vertcat(*self.begun.values()))

    def with_states(self, outputs: Sequence[str]) -> DrivenEquations:
        """Return equations with some of the outputs, then the states that stay."""
        g = [self.g[self.outputs.index(name)] for name in outputs]
        names, g = (*outputs, *self.state_names), ca.vertcat(*g, self.arguments[1])
        return replace(self, outputs=names, g=g, structure=None)  # as they stay, they are no outputs of the whole

    @cached_property
    def matrices(self) -> tuple[MatrixFunction, MatrixFunction]:
        """The Jacobians of f and g by x, (1, n, n) and (1, c, n), as functions of t, x, v, p."""
        given, x = self.arguments, self.arguments[1]
        return MatrixFunction(given, jacobian(self.f, x)), MatrixFunction(given, jacobian(self.g, x))

    @cached_property
    def linear(self) -> MatrixFunction | None:
        """The matrix L of [f; g] = L [x; v; 1], then its derivatives by each of the m parameters, of p alone.

        (1, n + c, (n + n_v + 1) (1 + m)); None where f or g is not linear in x and v, or changes with time.
        """
        t, x, v, p = self.arguments
        of, by = ca.vertcat(self.f, self.g), ca.vertcat(x, v)
        if not is_affine(of, by):
            return None
        L = ca.horzcat(jacobian(of, by), ca.substitute(of, by, ca.SX.zeros(by.numel())))
        if ca.depends_on(L, ca.vertcat(by, t)):
            return None
        slopes = [sum((jacobian(ca.vec(L), p[slot]) for slot in own), ca.SX(L.numel(), 1)) for own in self.slots]
        return MatrixFunction([p], ca.horzcat(L, *(ca.reshape(one, *L.shape) for one in slopes)))

    def jacobian(self, of: Any, x: Any = None) -> Any:
        """Return the sparse Jacobian of an expression (k,) by x (default: the states), then by the m parameters."""
        p, x = self.arguments[3], self.arguments[1] if x is None else x
        by_slots = [sum((jacobian(of, p[slot]) for slot in own), ca.SX(*of.shape)) for own in self.slots]
        return ca.sparsify(ca.horzcat(jacobian(of, x), *by_slots))

    def parameters(self, p: np.ndarray, theta: np.ndarray, *, continued: bool = False) -> np.ndarray:
        """Return p of the equations from p (n_p,) of the model and the m free parameters.

        continued: laws go on beyond where they are defined.
        """
        out = np.concatenate([p, np.zeros(self.arguments[3].numel() - len(p))])
        if self.limited:
            out[-1] = AT_ZERO if continued else -np.inf
        for value, slots in zip(theta, self.slots, strict=True):
            out[slots] = value
        return out


def driven_equations(
    diagram: Diagram,
    outputs: Sequence[str],
    inputs: Sequence[str],
    free: Sequence[Free],
    *,
    cut: Mapping[str, Sequence[str]] | None = None,
    force: ForceMap | None = None,
    added: Sequence[str] = (),
    fastest: float | None = None,
) -> DrivenEquations:
    """Return the equations of a diagram between recorded inputs and outputs (flat names).

    inputs: recorded values of input blocks, what clocks give, and entries of ``cut`` (output port -> names of its
    entries in v), whose consumers see v instead. added: scalar ports to which a signal is added, for an output's
    consumers or for an input alone; these follow the inputs in v. fastest: see `DrivenEquations`.
    Raises RotorsimError for diagrams with sampled blocks and unknown signals.
    """
    cut = {**{port: [port] for port in clock_ports(diagram) if port in inputs}, **(cut or {})}
    model = compile_diagram(diagram, inject=[*([force.port] if force else []), *added], replace=list(cut))
    linear.refuse_sampled(model, "a comparison in time")
    trace = model.trace
    v = ca.SX.sym("v", len(inputs) + len(added))
    coefficients = ca.SX.sym("c", force.count if force else 0)
    external = ca.SX.zeros(*trace.v.shape)
    for port, names in cut.items():
        external[trace.external[port].part] = v[[inputs.index(name) for name in names]]
    for k, port in enumerate(added, len(inputs)):
        external[trace.external[port].part] = v[k]
    if force:
        q, rate = (measured_expression(model, name) for name in (force.displacement, force.velocity))
        part = trace.external[force.port].part
        if ca.depends_on(ca.vertcat(q, rate), trace.v[part]):
            raise RotorsimError(Problem("the force acts on the displacement at once", force.port))
        external[part] = force.force(q, rate, coefficients)
    driven = ca.SX(trace.p)
    for port, parameter in driven_parameters(diagram).items():
        for k, name in enumerate(linear.entry_names(port, model.signals[port].shape)):
            if name in inputs:
                driven[model.parameters[parameter].start + k] = v[inputs.index(name)]
    y = ca.vertcat(*[measured_expression(model, name) for name in outputs])
    xdot, y = ca.substitute([trace.xdot, y], [trace.v], [external])
    kept = reached_states(pattern(xdot, trace.x), pattern(y, trace.x))
    keep = kept.tolist()
    begins = {keep.index(k): value for k, value in _beginnings(model).items() if k in keep}
    x = ca.SX.sym("x", len(keep))
    states = ca.SX.zeros(*trace.x.shape)
    states[keep] = x
    *values, f, g = ca.substitute(
        [*ca.substitute([*begins.values()], [trace.v], [external]), xdot[keep], y], [trace.p, trace.x], [driven, states]
    )
    begun = dict(zip(begins, values, strict=True))
    known = tuple(item for item in free if slots_of(model, item))
    slots = [slots_of(model, item) for item in known] + [[model.n_p + k] for k in range(coefficients.numel())]
    every = linear.state_names(model)
    names = tuple(every[k] for k in keep)
    arguments, p0 = (trace.t, x, v, ca.vertcat(trace.p, coefficients)), model.parameter_vector()
    p0 = np.concatenate([p0, np.zeros(coefficients.numel())])
    least = ca.SX.sym("least")
    if (beyond := continued(arguments, (f, g, *begun.values()), least)) is not None:
        (f, g, *values), arguments = beyond, (*arguments[:3], ca.vertcat(arguments[3], least))
        begun, p0 = dict(zip(begun, values, strict=True)), np.append(p0, -np.inf)
    structure = None
    if fastest is not None:
        structure = structure_of(arguments, f, g, p0, _rates(diagram, inputs, v), fastest)
    if structure is not None:
        z, f, g = structure.reduced()
        arguments, begun = (trace.t, z, v, arguments[3]), {}
        kept, names = kept[structure.kept], tuple(names[k] for k in structure.kept)
    given = model, tuple(outputs), tuple(inputs), known, kept, names, slots, arguments, f, g, fastest, begun
    return DrivenEquations(*given, limited=beyond is not None, structure=structure)


def _beginnings(model: Model) -> dict[int, Any]:
    """Return where states begin, as they declare it, {state: expression of the trace}."""
    found: dict[int, Any] = {}
    wires = {(wire.target.block, wire.target.port): wire for wire in model.diagram.wires if not wire.target.index}
    for name, node in model.diagram.nodes.items():
        for key, state in node.block.active_states().items():
            wire = wires.get((name, state.begins))
            given = node.values.get(state.init, 0.0) if isinstance(state.init, str) else state.init
            if wire is None or np.any(given) or node.inputs[state.begins].additive:
                continue
            value, part = model.expression(str(wire.source)), model.states[f"{name}.{key}"].part
            found |= zip(range(part.start, part.stop), ca.vertsplit(value), strict=True)
    return found


def _rates(diagram: Diagram, inputs: Sequence[str], v: Any) -> Any:
    """Return the time derivatives of what drives a diagram: of the angle and the speed of a shaft, else zero."""
    rates = ca.SX.zeros(v.numel())
    for port in clock_ports(diagram):
        block, _, name = port.rpartition(".")
        follows = f"{block}.{dict(pairwise(OF_THE_ANGLE)).get(name)}"
        if port in inputs and follows in inputs:
            rates[inputs.index(port)] = v[inputs.index(follows)]
    return rates
