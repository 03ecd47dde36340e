"""The response X = (s I - A)^-1 F of many runs at many orders, and of one with many states by its dynamic stiffness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import zgetrf, zgetrs


@dataclass(frozen=True, eq=False)
class Resolvent:
    """What forces do to states: gain (R, K+1, n, r), states by forces in rows of dx/dt at order 0 first.

    slow: of each run, dX_0 by the means of its slow states, (n, s).
    """

    gain: np.ndarray
    slow: Sequence[np.ndarray]


def resolvent_of(A: np.ndarray, s: np.ndarray, slow: Sequence[np.ndarray]) -> Resolvent:
    """Return (s I - A)^-1 for A (R, n, n) and s (R, K+1); slow states (indices of each run) rest at order 0."""
    gain = np.linalg.inv(shifted(A, s, slow))
    columns = []
    for r, states in enumerate(slow):
        gain[r, 0, states, :] = 0.0
        column = (gain[r, 0] @ A[r][:, states]).real
        column[states, np.arange(len(states))] = 1.0
        columns.append(column)
    return Resolvent(gain, columns)


def shifted(A: np.ndarray, s: np.ndarray, resting: Sequence[np.ndarray]) -> np.ndarray:
    """Return s I - A, (R, K+1, n, n), for A (R, n, n), s (R, K+1); at order 0 without the states of a run that rest."""
    matrices = np.asarray(s[:, :, None, None] * np.eye(A.shape[-1]) - A[:, None])
    for r, states in enumerate(resting):
        matrices[r, 0, states, :] = 0.0
        matrices[r, 0, :, states] = 0.0
        matrices[r, 0, states, states] = 1.0
    return matrices


@dataclass(frozen=True, eq=False)
class DynamicStiffness:
    """(s I - A) X = F of one run without its velocities: where x_i' = x_j, x_j = s x_i - F_i.

    What is left is K_0 + s K_1 + s^2 K_2 of half the states (an eighth of the work, a quarter of the memory). On fine
    meshes A is of the order of 1e16 1/s^2, and s^2 drowns in its rounding: one step of iterative refinement, on a
    residual to more than double precision (`product`), makes X right to double precision (Higham 2002, sec. 12.1).

    positions, velocities: i and j. rows, columns: of s I - A that are left. factors: of every s, in triangles.
    """

    A: np.ndarray
    s: np.ndarray
    resting: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    factors: list[tuple[np.ndarray, np.ndarray]]

    @classmethod
    def of(cls, A: np.ndarray, s: np.ndarray, resting: np.ndarray) -> DynamicStiffness:
        """Return the stiffness of A (n, n) at s (K+1,), order 0 first, where the states ``resting`` rest.

        Raises LinAlgError if a frequency is that of an undamped mode.
        """
        positions, velocities = _positions(A, resting)
        rows, columns = (np.setdiff1d(np.arange(len(A)), left) for left in (positions, velocities))
        at, unit = np.searchsorted(columns, positions), np.eye(len(A))
        K = -A[np.ix_(rows, columns)], unit[np.ix_(rows, columns)], np.zeros((len(rows), len(columns)))
        K[1][:, at] -= A[np.ix_(rows, velocities)]
        K[2][:, at] = unit[np.ix_(rows, velocities)]
        factors = []
        for k, at_order in enumerate(s):
            matrix = K[0] + at_order * K[1] + at_order**2 * K[2]
            if k == 0:
                row, column = np.searchsorted(rows, resting), np.searchsorted(columns, resting)
                matrix[row], matrix[:, column] = 0.0, 0.0
                matrix[row, column] = 1.0
            lu, pivots, info = zgetrf(matrix)
            if info > 0:
                raise np.linalg.LinAlgError("a frequency of the motion is that of an undamped mode")
            factors.append((lu, pivots))
        return cls(A, s, resting, positions, velocities, rows, columns, factors)

    @property
    def size(self) -> int:
        """Bytes of the factors."""
        return sum(lu.nbytes for lu, _ in self.factors)

    def solve(self, F: np.ndarray) -> np.ndarray:
        """Return X (q, n, c) at the first q orders for F (q, n, c); that of resting states at order 0 is zero."""
        F = F.astype(complex)
        F[0, self.resting] = 0.0
        X = self._solved(F)
        A_X = product(self.A, X.transpose(1, 0, 2).reshape(len(self.A), -1)).reshape(len(self.A), *X[:, 0].shape)
        left = F - (self.s[: len(F), None, None] * X - A_X.transpose(1, 0, 2))
        left[0, self.resting], left[:, self.positions] = 0.0, 0.0  # of these, velocities are right to rounding
        return np.asarray(X + self._solved(left))

    def _solved(self, F: np.ndarray) -> np.ndarray:
        """Return X by the triangles as they are."""
        X, right = np.zeros(F.shape, complex), F
        if F[:, self.positions].any():
            X[:, self.velocities] = F[:, self.positions]
            right = F + self.s[: len(F), None, None] * X - self.A @ X
            right[0, self.resting] = 0.0
        for k, factors in enumerate(self.factors[: len(F)]):
            X[k, self.columns] = zgetrs(*factors, right[k, self.rows])[0]
            X[k, self.velocities] = self.s[k] * X[k, self.positions] - F[k, self.positions]
        return X


def product(A: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return A X for real A (n, n), complex X (n, c), to some twenty bits more than rounding leaves of |A| |X|.

    The leading bits of both, few enough that sums of their products are exact, are multiplied apart (Ozaki et al.
    2012, Numer. Algorithms 59); of the states, each has its unit.
    """
    bits = (np.finfo(float).nmant + 1 - int(np.ceil(np.log2(len(A))))) // 2
    parts = np.ascontiguousarray(X).view(float)
    unit = np.exp2(np.frexp(np.abs(parts).max(axis=1, initial=0.0))[1])
    A, parts = A * unit, parts / unit[:, None]
    a, x = _leading(A, 1, bits), _leading(parts, 0, bits)
    return np.asarray(a @ x + (a @ (parts - x) + (A - a) @ parts)).view(complex)


def _leading(values: np.ndarray, axis: int, bits: int) -> np.ndarray:
    """Return values to so many bits of the largest along an axis."""
    largest = np.frexp(np.abs(values).max(axis=axis, keepdims=True, initial=0.0))[1]
    shift = 1.5 * np.exp2(largest + np.finfo(float).nmant - bits)
    return np.asarray((values + shift) - shift)


def _positions(A: np.ndarray, resting: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return states whose rate is exactly another state, and these, none of them resting, in both or twice."""
    found: dict[int, int] = {}
    taken = {*resting.tolist()}
    for i in np.flatnonzero(np.count_nonzero(A, axis=1) == 1).tolist():
        j = int(np.flatnonzero(A[i])[0])
        if A[i, j] == 1.0 and i != j and i not in taken and j not in taken:
            found[i] = j
            taken |= {i, j}
    return np.array([*found], int), np.array([*found.values()], int)
