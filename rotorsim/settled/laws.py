"""What moves a diagram apart from what it moves: laws of time and states, and the matrices that they enter by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.model.linearity import jacobian, semi_linear
from rotorsim.model.matrix_function import MatrixFunction

Pair = tuple[np.ndarray, np.ndarray]  # values (R, rows, columns) and their derivatives (R, rows, columns, m)


@dataclass(frozen=True, eq=False)
class Matrix:
    """A matrix of the equations and its derivatives by the free parameters, both only where they are not zero."""

    value: MatrixFunction
    derivative: MatrixFunction  # (nonzeros, m)

    @classmethod
    def of(cls, matrix: Any, p: Any, theta: Any) -> Matrix:
        """Return a matrix as a function of p and theta."""
        sparse = ca.sparsify(matrix)
        nonzeros = sparse.nz[:] if sparse.nnz() else ca.SX(0, 1)
        return cls(MatrixFunction([p, theta], sparse), MatrixFunction([p, theta], lambda: jacobian(nonzeros, theta)))

    def __call__(self, p: np.ndarray, theta: np.ndarray) -> Pair:
        """Return values (R, rows, columns) and derivatives (R, rows, columns, m), for p (R, n_p), theta (R, m)."""
        values = self.value(p.T, theta.T)
        out = np.zeros((*values.shape, theta.shape[1]))
        if len(self.value.rows):
            out[:, self.value.rows, self.value.columns] = self.derivative(p.T, theta.T)
        return values, out

    def slopes(self, p: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of columns that are not zero, each by one parameter, (R, rows, N), and whose, (N,)."""
        rows, m = self.derivative.rows, theta.shape[1]
        pairs, at = np.unique(self.value.columns[rows] * m + self.derivative.columns, return_inverse=True)
        out = np.zeros((len(p), self.value.shape[0], len(pairs)))
        out[:, self.value.rows[rows], at] = self.derivative.entries(p.T, theta.T)
        moving = np.any(out, axis=(0, 1))
        return out[:, :, moving], pairs[moving] // max(m, 1)


class Together:
    """Several matrices, evaluated in one call: they have most of their terms in common."""

    def __init__(self, matrices: Mapping[str, Matrix]) -> None:
        self.matrices = matrices
        parts = [part for matrix in matrices.values() for part in (matrix.value, matrix.derivative)]
        arguments = parts[0].arguments
        self.column = MatrixFunction(arguments, ca.vertcat(*[part.nonzeros for part in parts]))
        self.ends = np.cumsum([len(part.rows) for part in parts])

    def __call__(self, p: np.ndarray, theta: np.ndarray) -> dict[str, Pair]:
        """Return values and derivatives of each, see `Matrix`."""
        found = np.split(self.column(p.T, theta.T)[:, :, 0], self.ends[:-1], axis=1)
        every = {}
        for (key, matrix), own, slopes in zip(self.matrices.items(), found[::2], found[1::2], strict=True):
            rows, columns, entries = matrix.value.rows, matrix.value.columns, matrix.derivative.rows
            value = np.zeros((len(own), *matrix.value.shape))
            value[:, rows, columns] = own
            derivative = np.zeros((*value.shape, theta.shape[1]))
            derivative[:, rows[entries], columns[entries], matrix.derivative.columns] = slopes
            every[key] = value, derivative
        return every


class Laws:
    """A column of expressions as L w(t): laws of time w (q,), the first of them one; L (rows, q) follows p and theta.

    One force moves many rows of a coupled mass matrix; it is followed in time once.
    """

    def __init__(self, symbols: tuple[Any, Any, Any], L: Any, w: Any) -> None:
        t, p, theta = self.symbols = symbols
        self._L, self._w = ca.sparsify(L), w
        self.L = Matrix.of(self._L, p, theta)
        self.w = MatrixFunction([t, p, theta], w)
        self.w_theta = MatrixFunction([t, p, theta], lambda: jacobian(w, theta))

    @classmethod
    def of(cls, column: Any, symbols: tuple[Any, Any, Any]) -> Laws:
        """Return the laws of a column of expressions of (t, p, theta)."""
        nothing = ca.SX(0, 1)
        found = semi_linear(column, nothing, symbols[0], nothing)
        constant = ca.substitute(found.of, found.w, ca.SX.zeros(*found.w.shape))
        L = ca.horzcat(constant, jacobian(found.of, found.w))
        return cls(symbols, L, ca.vertcat(1, found.phi))

    def of_rows(self, rows: Sequence[int]) -> Laws:
        """Return the laws of some rows."""
        return Laws(self.symbols, self._L[list(rows), :], self._w)

    def at(self, p: np.ndarray, theta: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return w (R, N, q) and its derivatives (R, N, q, m) at times (R, N), for p (R, n_p), theta (R, m)."""
        points, shape = points_of(p, theta, times), times.shape
        w, w_theta = (function(*points) for function in (self.w, self.w_theta))
        return w.reshape(*shape, -1), w_theta.reshape(*shape, -1, theta.shape[1])


class Split:
    """f as a + A x + B w(t, x): laws w (q,), the first of them one; A and [a, B] follow p and theta alone.

    moving: which laws follow the states.
    """

    def __init__(self, symbols: tuple[Any, Any, Any], x: Any, f: Any) -> None:
        t, p, theta = symbols
        found = semi_linear(f, x, t, ca.SX(0, 1))
        nothing = [ca.SX.zeros(*part.shape) for part in (x, found.w)]
        constant = ca.substitute([found.of], [x, found.w], nothing)[0]
        laws = ca.vertcat(1, found.phi)
        self.moving = np.array([k for k in range(laws.numel()) if ca.depends_on(laws[k], x)], int)
        A = Matrix.of(jacobian(found.of, x), p, theta)
        B = Matrix.of(ca.horzcat(constant, jacobian(found.of, found.w)), p, theta)
        self.steady = Together({"A": A, "B": B})
        points, moving = [t, x, p, theta], laws[self.moving.tolist()]
        self.w, self.w_theta = MatrixFunction(points, laws), MatrixFunction(points, lambda: jacobian(laws, theta))
        self.w_moving = MatrixFunction(points, moving)
        self.w_x = MatrixFunction(points, lambda: jacobian(moving, x))


def column_of(L: Pair, w: np.ndarray, w_theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return L w (R, N, rows) and its derivatives (R, N, rows, m), for w (R, N, q) and derivatives (R, N, q, m)."""
    return w @ L[0].swapaxes(1, 2), by_parameters(L[1], w) + L[0][:, None] @ w_theta


def points_of(p: np.ndarray, theta: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return (times, p, theta) as columns for times (R, N), one run after the other."""
    n = times.shape[1]
    return times.reshape(1, -1), np.repeat(p, n, 0).T, np.repeat(theta, n, 0).T


def by_parameters(derivatives: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return sum over j of derivatives (R, i, j, m) values (R, k, j), as (R, k, i, m)."""
    R, rows, columns, m = derivatives.shape
    flat = derivatives.transpose(0, 1, 3, 2).reshape(R, rows * m, columns)
    return np.asarray((values @ flat.transpose(0, 2, 1)).reshape(R, values.shape[1], rows, m))
