"""The traced equations of a diagram driven by recorded signals, with their exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear import linearisation as linear
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.settled.equations import reached_states, slots_of

__all__ = ["ForceMap", "TimeEquations", "driven_parameters", "measured_expression"]

INPUT = "input"  # category of blocks whose parameter `value` a recording gives
RATES = {"acceleration": "velocity", "velocity": "displacement"}  # recorded, but no port: the rate of this one
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
    """Return signal -> parameter for the blocks of category `INPUT`: what a recording gives takes its place."""
    return {
        f"{name}.{port}": f"{name}.value"
        for name, node in diagram.nodes.items()
        if node.block.category == INPUT and "value" in node.values
        for port in node.outputs
    }


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


class TimeEquations:
    """dx/dt = f(t, x, v; p), y = g(t, x, v; p) with the derivatives by x and by the free parameters.

    Only states that the outputs depend on are kept: ``kept`` (n,). inputs: flat names of what v holds: recorded values
    of input blocks, and entries of ``cut`` (output port -> names of its entries in v), whose consumers see v instead.
    p: parameters of the model, then the coefficients of a `ForceMap`; ``slots``: entries of p that each of the m free
    parameters sets. f_nonzeros, g_nonzeros: (rows, columns) of the sparse derivatives, columns 0..n-1 by x, n.. by the
    parameters. Raises RotorsimError for diagrams with sampled blocks and unknown signals.
    """

    def __init__(
        self,
        diagram: Diagram,
        outputs: Sequence[str],
        inputs: Sequence[str],
        free: Sequence[Free],
        *,
        cut: Mapping[str, Sequence[str]] | None = None,
        force: ForceMap | None = None,
    ) -> None:
        cut = cut or {}
        model = compile_diagram(diagram, inject=[force.port] if force else [], replace=list(cut))
        linear.refuse_sampled(model, "a diagnosis in time")
        self.model, self.outputs, self.inputs = model, tuple(outputs), tuple(inputs)
        trace = model.trace
        self.free = tuple(item for item in free if slots_of(model, item))
        v = ca.SX.sym("v", len(inputs))
        extra = ca.SX.sym("c", force.count if force else 0)
        y = ca.vertcat(*[measured_expression(model, name) for name in outputs])
        xdot = trace.xdot
        external = [ca.SX(0)] * trace.v.numel()
        for port, names in cut.items():
            for k, name in enumerate(names):
                external[trace.external[port].part.start + k] = v[self.inputs.index(name)]
        if force:
            q, rate = (measured_expression(model, name) for name in (force.displacement, force.velocity))
            part = trace.external[force.port].part
            if ca.depends_on(ca.vertcat(q, rate), trace.v[part]):
                raise RotorsimError(Problem("the force acts on the displacement at once", force.port))
            external[part.start] = force.force(q, rate, extra)
        entries = ca.vertsplit(trace.p) if trace.p.numel() > 1 else [trace.p]
        for name, slot in _driven_slots(model).items():
            if name in self.inputs:
                entries[slot] = v[self.inputs.index(name)]
        new = [ca.vertcat(*external) if external else trace.v]
        xdot, y = ca.substitute([xdot, y], [trace.v], new)
        xdot, y = ca.substitute([xdot, y], [trace.p], [ca.vertcat(*entries)])
        pattern = ca.jacobian(xdot, trace.x).sparsity()
        self.kept = reached_states(pattern, ca.jacobian(y, trace.x).sparsity())
        keep = self.kept.tolist()
        x = ca.SX.sym("x", len(keep))
        whole: Any = ca.SX.zeros(*trace.x.shape)
        whole[keep] = x
        f, g = ca.substitute([xdot[keep], y], [trace.x], [whole])
        self.slots = [slots_of(model, item) for item in self.free]
        self.slots += [[model.n_p + k] for k in range(extra.numel())]
        self.arguments = {"t": trace.t, "x": x, "v": v, "p": ca.vertcat(trace.p, extra)}
        self.f, self.g = ca.densify(f), ca.densify(g)
        self.f_slopes, self.f_nonzeros = self._slopes(f, x)
        self.g_slopes, self.g_nonzeros = self._slopes(g, x)
        self.n, self.c, self.m, self.n_v = len(keep), len(outputs), len(self.slots), len(inputs)
        self.state_names = tuple(linear.state_names(model)[k] for k in keep)

    def _slopes(self, of: Any, x: Any) -> tuple[Any, tuple[np.ndarray, np.ndarray]]:
        p = self.arguments["p"]
        columns = [ca.jacobian(of, x)]
        for slots in self.slots:
            columns.append(sum((ca.jacobian(of, p[slot]) for slot in slots), ca.SX(of.shape[0], 1)))
        whole = ca.sparsify(ca.horzcat(*columns))
        rows, cols = (np.array(places, int) for places in whole.sparsity().get_triplet())
        return whole.nz[:] if len(rows) else ca.SX(0, 1), (rows, cols)

    def parameters(self, p: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return p of the equations from p (n_p,) of the model and the m free parameters."""
        out = np.concatenate([p, np.zeros(self.arguments["p"].numel() - len(p))])
        for value, slots in zip(theta, self.slots, strict=True):
            out[slots] = value
        return out


def _driven_slots(model: Model) -> dict[str, int]:
    """Return flat name -> entry of p for every signal that a recording may give."""
    found: dict[str, int] = {}
    for port, parameter in driven_parameters(model.diagram).items():
        part = model.parameters[parameter]
        for k, name in enumerate(linear.entry_names(port, model.signals[port].shape)):
            found[name] = part.start + k
    return found
