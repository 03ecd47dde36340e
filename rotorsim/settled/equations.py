"""The traced equations of a nonlinear diagram, with their exact derivatives by states and free parameters."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Free
from rotorsim.model.compiled import Model
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.linear_equations import instants, known_values, reached_states, slots_of, suit, with_values
from rotorsim.settled.ports import means_of

__all__ = ["NonlinearEquations", "PortEquations", "is_linear"]


def is_linear(model: Model, outputs: Sequence[str]) -> bool:
    """Return whether dx/dt and the outputs (flat names as recorded) are linear in states with constant factors."""
    trace = model.trace
    y = ca.vertcat(*[model.expression(model.diagram.as_measured(name)) for name in outputs])
    varying = ca.vertcat(trace.x, trace.t, trace.v)
    pairs = ((trace.xdot, trace.x), (trace.xdot, trace.v), (y, trace.x), (y, trace.v))
    return not any(ca.depends_on(ca.jacobian(of, by), varying) for of, by in pairs)


class NonlinearEquations:
    """dx/dt = f(t, x; p, theta), y = g(t, x; p, theta) of a diagram with periodic forcing, theta the free parameters.

    p (R, n_p): what is the same in all runs becomes a number, and all that follows from it; for other runs see `at`.
    kept (n,): the states that the outputs depend on. changing: those that the outputs, or entries of df/dx that are
    not constant, stand for.
    """

    def __init__(self, model: Model, outputs: Sequence[str], free: Sequence[Free], p: np.ndarray | None = None) -> None:
        self.model, self.outputs, self.free = model, tuple(outputs), tuple(free)
        trace = model.trace
        self.slots = [slots_of(model, item) for item in free]
        theta = ca.SX.sym("theta", len(free))
        self.known = known_values(p, self.slots)
        y = ca.vertcat(*[model.expression(model.diagram.as_measured(name)) for name in outputs])
        f, g = with_values(model, [trace.xdot, y], self.slots, theta, self.known)
        f, g = ca.substitute([f, g], [trace.v], [ca.SX.zeros(*trace.v.shape)])
        pattern = ca.jacobian(f, trace.x).sparsity()
        self.kept = reached_states(pattern, ca.jacobian(g, trace.x).sparsity())
        keep = self.kept.tolist()
        self.means = means_of(model)[keep]
        x = ca.SX.sym("x", len(keep))
        whole: Any = ca.SX(model.x0(model.p0))
        whole[keep] = x
        f, g = ca.substitute([f[keep], g], [trace.x], [whole])
        self._symbols, self._x, self._f, self._g = (trace.t, trace.p, theta), x, f, g
        J, C = ca.jacobian(f, x), ca.jacobian(g, x)
        _, changing = _varying(J, ca.vertcat(x, trace.t, theta))
        self.changing = np.union1d(changing, _columns(C))
        self.n, self.c, self.m = len(keep), len(self.outputs), len(free)
        bends = [bool(ca.depends_on(ca.vertcat(ca.vec(J), ca.vec(C)), theta[j])) for j in range(self.m)]
        self.matrices = {"J": _Dependence(np.array(bends, float))}
        self.theta0 = np.array([item.value for item in free])

    def at(self, p: np.ndarray) -> NonlinearEquations:
        """Return the equations for known parameters p (R, n_p), of which others may be the same in all runs."""
        return self if suit(self.known, p) else self._general

    @cached_property
    def _general(self) -> NonlinearEquations:
        return NonlinearEquations(self.model, self.outputs, self.free)

    @cached_property
    def whole(self) -> PortEquations:
        """The equations with every state in its place."""
        everything = np.arange(self.n)
        return self.at_ports(everything, everything)

    def at_ports(self, rows: np.ndarray, columns: np.ndarray) -> PortEquations:
        """Return some rows of f as functions of some states, the others at zero."""
        x = ca.SX.sym("x", len(columns))
        full: Any = ca.SX.zeros(self.n)
        full[columns.tolist()] = x
        f, g = ca.substitute([self._f[rows.tolist()], self._g], [self._x], [full])
        return PortEquations(*self._symbols, x, f, g)

    def at_rest(self, p: np.ndarray, theta: np.ndarray, speeds: np.ndarray, n: int) -> np.ndarray:
        """Return [f; g] at rest at n instants of a turn, as `functions.Equations.at_rest`."""
        R = len(p)
        times = instants(speeds, n).reshape(1, -1)
        points = (times, np.zeros((self.n, R * n)), np.repeat(p, n, 0).T, np.repeat(theta, n, 0).T)
        return np.concatenate([self.whole.f(*points), self.whole.g(*points)], axis=1).reshape(R, n, -1)


class PortEquations:
    """Rows of f (r,) and outputs g (c,) as functions of states x (n,), with their derivatives.

    E, S: places in r and n where df/dx varies with x or t. Every function takes (times, x, p, theta) as columns, one
    for each of N points.
    """

    def __init__(self, t: Any, p: Any, theta: Any, x: Any, f: Any, g: Any) -> None:
        arguments = [t, x, p, theta]
        J = ca.jacobian(f, x)
        self.E, self.S = _varying(J, ca.vertcat(x, t))
        rows, columns = self.E.tolist(), self.S.tolist()
        self.f = MatrixFunction(arguments, f)
        self.f_rows = MatrixFunction(arguments, f[rows] if rows else ca.SX(0, 1))
        self.J = MatrixFunction(arguments, J)
        self.J_part = MatrixFunction(arguments, J[rows, columns] if rows else ca.SX(0, 0))
        self.f_theta = MatrixFunction(arguments, ca.jacobian(f, theta))
        self.g = MatrixFunction(arguments, g)
        self.C = MatrixFunction(arguments, ca.jacobian(g, x))
        self.g_theta = MatrixFunction(arguments, ca.jacobian(g, theta))
        self.r, self.n, self.c, self.m = f.numel(), x.numel(), g.numel(), theta.numel()


class _Dependence:
    """Says by derivatives of one which parameters the Jacobian depends on, as a matrix of linear equations does."""

    def __init__(self, bends: np.ndarray) -> None:
        self.bends = bends

    def __call__(self, p: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((len(p), 1, 1)), np.tile(self.bends, (len(p), 1, 1, 1))


def _columns(matrix: Any) -> np.ndarray:
    """Return the columns of a sparse matrix that are not empty."""
    return np.unique(np.array(matrix.sparsity().get_triplet()[1], int))


def _varying(jacobian: Any, variables: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows and columns of the entries of a sparse Jacobian that depend on the variables."""
    if not jacobian.nnz():
        return np.zeros(0, int), np.zeros(0, int)
    depends = ca.Function("d", [variables], [jacobian.nz[:]], {"allow_free": True})
    entries = np.unique(np.array(depends.sparsity_jac(0, 0).row(), int))
    rows, columns = (np.array(places, int) for places in jacobian.sparsity().get_triplet())
    return np.unique(rows[entries]), np.unique(columns[entries])
