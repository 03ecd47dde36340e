"""The traced equations of a linear diagram, with their exact derivatives by the free parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import Model
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.forcing import Jumps
from rotorsim.settled.ports import means_of

__all__ = ["Equations", "instants", "known_values", "reached_states", "slots_of", "suit", "with_values"]

FIRST_SAMPLES = 32
MOST_SAMPLES = 4096
RESOLVED = 1e-11


def slots_of(model: Model, free: Free) -> list[int]:
    """Return the entries of p that a free parameter sets (several when blocks share a diagram parameter)."""
    parts = model.references.get(free.base) if free.base in model.diagram.parameters else [model.parameters[free.base]]
    return [part.start + free.entry for part in parts or []]


def known_values(p: np.ndarray | None, slots: Sequence[Sequence[int]]) -> dict[int, float]:
    """Return what is the same in all runs of p (R, n_p), by its entry: but for what free parameters set."""
    if p is None:
        return {}
    same = np.flatnonzero((p == p[:1]).all(axis=0)).tolist()
    free = {slot for some in slots for slot in some}
    return {slot: float(p[0, slot]) for slot in same if slot not in free}


def suit(known: Mapping[int, float], p: np.ndarray) -> bool:
    """Return whether all runs of p (R, n_p) have the known values."""
    return all((p[:, slot] == value).all() for slot, value in known.items())


def with_values(
    model: Model, expressions: Sequence[Any], slots: Sequence[Sequence[int]], theta: Any, known: Mapping[int, float]
) -> list[Any]:
    """Return expressions with free parameters in their slots, numbers for what is known, and z as at the start."""
    trace = model.trace
    entries = ca.vertsplit(trace.p) if trace.p.numel() > 1 else [trace.p]
    for slot, value in known.items():
        entries[slot] = ca.SX(value)
    for j, own in enumerate(slots):
        for slot in own:
            entries[slot] = theta[j]
    new = [ca.vertcat(*entries), ca.SX(model.z0(model.p0))]
    return list(ca.substitute(list(expressions), [trace.p, trace.z], new))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class _Matrix:
    """A matrix of the equations and its derivatives by the free parameters, both only where they are not zero."""

    value: MatrixFunction
    derivative: MatrixFunction  # (nonzeros, m)

    def __call__(self, p: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values (R, rows, columns) and derivatives (R, rows, columns, m), for p (R, n_p), theta (R, m)."""
        values = self.value(p.T, theta.T)
        out = np.zeros((*values.shape, theta.shape[1]))
        if len(self.value.rows):
            out[:, self.value.rows, self.value.columns] = self.derivative(p.T, theta.T)
        return values, out


class Equations:
    """dx/dt = A x + f(t) + B v, y = C x + g(t) + D v of a linear diagram, as functions of p and the free parameters.

    Only the states that the outputs depend on are kept: ``kept`` (n,). v: external inputs of the model
    (`inject`, `replace`). p (R, n_p): what is the same in all runs becomes a number, and all that follows from it; for
    other runs see `at`. Raises RotorsimError for diagrams that are not linear in their states.
    """

    def __init__(self, model: Model, outputs: Sequence[str], free: Sequence[Free], p: np.ndarray | None = None) -> None:
        self.model, self.outputs, self.free = model, tuple(outputs), tuple(free)
        trace = model.trace
        self.slots = [slots_of(model, item) for item in free]
        theta = ca.SX.sym("theta", len(free))
        self.known = known_values(p, self.slots)
        y = ca.vertcat(*[model.expression(model.diagram.as_measured(name)) for name in outputs])
        xdot, y = with_values(model, [trace.xdot, y], self.slots, theta, self.known)

        def alone(expression: Any, at_rest: bool = True) -> Any:
            old = [trace.v, *([trace.x] if at_rest else [])]
            return ca.substitute([expression], old, [ca.SX.zeros(*symbol.shape) for symbol in old])[0]

        columns = {"A": (xdot, trace.x), "B": (xdot, trace.v), "C": (y, trace.x), "D": (y, trace.v)}
        jacobians = {key: ca.jacobian(of, by) for key, (of, by) in columns.items()}
        varying = ca.vertcat(trace.x, trace.t, trace.v)
        if any(ca.depends_on(jacobian, varying) for jacobian in jacobians.values()):
            raise RotorsimError(Problem("the diagram is not linear in its states", model.diagram.name))
        self.kept = reached_states(jacobians["A"].sparsity(), jacobians["C"].sparsity())
        keep = self.kept.tolist()
        self.means = means_of(model)[keep]
        jacobians["A"], jacobians["B"] = jacobians["A"][keep, keep], jacobians["B"][keep, :]
        jacobians["C"] = jacobians["C"][:, keep]
        self._symbols, self._jacobians = (trace.t, trace.p, theta), jacobians
        self._at_rest = (alone(xdot)[keep], alone(y))
        self.n = len(keep)
        self.n_v = trace.v.numel()
        self._compile()
        self.samples = FIRST_SAMPLES
        self.jumps = Jumps(model)
        self.theta0 = np.array([item.value for item in free])

    def at(self, p: np.ndarray) -> Equations:
        """Return the equations for known parameters p (R, n_p), of which others may be the same in all runs."""
        return self if suit(self.known, p) else self._general

    @cached_property
    def _general(self) -> Equations:
        return Equations(self.model, self.outputs, self.free)

    def _compile(self) -> None:
        _, p, theta = self._symbols
        self.matrices = {key: _matrix(p, theta, jacobian) for key, jacobian in self._jacobians.items()}
        self._forcing = [
            tuple(MatrixFunction(self._symbols, e) for e in (at_rest, ca.jacobian(at_rest, theta)))
            for at_rest in self._at_rest
        ]

    def at_ports(self, rows: np.ndarray, columns: np.ndarray) -> Equations:
        """Return some rows of x' as functions of some states; the others must not matter to them."""
        part = copy(self)
        r, c = rows.tolist(), columns.tolist()
        own = self._jacobians
        part._jacobians = {"A": own["A"][r, c], "B": own["B"][r, :], "C": own["C"][:, c], "D": own["D"]}
        part._at_rest = (self._at_rest[0][r], self._at_rest[1])
        part.n = len(c)
        part._compile()
        return part

    def forcing(self, p: np.ndarray, theta: np.ndarray, speeds: np.ndarray, K: int) -> tuple[np.ndarray, np.ndarray]:
        """Return Fourier coefficients of [f; g] and their derivatives, orders 0..K.

        p (R, n_p), theta (R, m), speeds (R,) [rad/s] -> (R, K+1, n + C) and (R, K+1, n + C, m), complex.
        """
        n = max(self.samples, 1 << (2 * K + 2).bit_length())
        while True:
            values, derivatives = self.sampled(p, theta, speeds, n)
            coefficients = np.fft.rfft(values, axis=1) / n
            size = np.abs(coefficients)
            tail = size[:, -n // 8 :].max(initial=0.0)
            if n >= MOST_SAMPLES or tail <= RESOLVED * size.max(initial=0.0):
                break
            n *= 2
        self.samples = n
        slopes = np.fft.rfft(derivatives, axis=1)[:, : K + 1] / n
        return coefficients[:, : K + 1], slopes

    def forcing_beside(
        self, p: np.ndarray, theta: np.ndarray, projection: np.ndarray, times: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return coefficients of [f; g] and their derivatives at the frequencies of a projection.

        projection (R, frequencies, N) of samples at times (R, N) -> (R, frequencies, n + C), (..., m).
        """
        values, slopes = self._at(p, theta, times)
        R, _, width, m = slopes.shape
        found = projection @ values
        return found, (projection @ slopes.reshape(R, slopes.shape[1], -1)).reshape(R, -1, width, m)

    def at_rest(self, p: np.ndarray, theta: np.ndarray, speeds: np.ndarray, n: int) -> np.ndarray:
        """Return [f; g] at rest at n instants of a turn, (R, n, states + outputs)."""
        times, many_p, many_theta = self._columns(p, theta, instants(speeds, n))
        parts = [value(times, many_p, many_theta) for value, _ in self._forcing]
        return np.concatenate(parts, axis=1).reshape(len(p), n, -1)

    def sampled(self, p: np.ndarray, theta: np.ndarray, speeds: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Return [f; g] at rest at n instants of a turn, (R, n, states + outputs), and its derivatives (..., m)."""
        return self._at(p, theta, instants(speeds, n))

    def _at(self, p: np.ndarray, theta: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (R, m), n = theta.shape, at.shape[1]
        times, many_p, many_theta = self._columns(p, theta, at)
        values, derivatives = [], []
        for value, derivative in self._forcing:
            values.append(value(times, many_p, many_theta).reshape(R, n, -1))
            derivatives.append(derivative(times, many_p, many_theta).reshape(R, n, -1, m))
        return np.concatenate(values, axis=2), np.concatenate(derivatives, axis=2)

    def _columns(self, p: np.ndarray, theta: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, ...]:
        n = at.shape[1]
        return at.reshape(1, -1), np.repeat(p, n, 0).T, np.repeat(theta, n, 0).T


def instants(speeds: np.ndarray, n: int) -> np.ndarray:
    """Return n instants of a turn at each speed, (R, n)."""
    return np.asarray(2 * np.pi / np.abs(speeds)[:, None] * np.arange(n) / n)


def _matrix(p: ca.SX, theta: ca.SX, expression: ca.SX) -> _Matrix:
    expression = ca.sparsify(expression)
    nonzeros = expression.nz[:] if expression.nnz() else ca.SX(0, 1)
    return _Matrix(MatrixFunction([p, theta], expression), MatrixFunction([p, theta], ca.jacobian(nonzeros, theta)))


def reached_states(A: ca.Sparsity, C: ca.Sparsity) -> np.ndarray:
    """Return the states that the outputs depend on, directly or through others."""
    n = A.size1()
    pattern = np.zeros((n, n), bool)
    pattern[np.array(A.row(), int), np.array(A.get_triplet()[1], int)] = True
    reached = np.zeros(n, bool)
    reached[np.array(C.get_triplet()[1], int)] = True
    while True:
        more = reached | pattern[reached].any(axis=0)
        if (more == reached).all():
            return np.flatnonzero(reached)
        reached = more
