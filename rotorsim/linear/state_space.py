"""Linear systems as matrices: response, systems of equations at many frequencies, what drives what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

POINTS_A_DECADE = 150
AROUND_A_POLE = np.linspace(-3, 3, 13)  # half widths
SAME_POLE = 0.01  # half widths between poles that need no points of their own
MANY = 40  # frequencies from which on a Schur decomposition takes less time than solving at each


@dataclass(frozen=True)
class StateSpace:
    """d x/dt = A x + B u, y = C x + D u; A (n, n), B (n, m), C (k, n), D (k, m), SI units."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray

    def poles(self) -> np.ndarray:
        """Return the eigenvalues of A [1/s], shape (n,)."""
        return np.asarray(np.linalg.eigvals(self.A))

    def connected(self) -> StateSpace:
        """Return it without the states that no input drives, or that no output sees."""
        pattern = self.A != 0
        kept = reached(pattern, (self.B != 0).any(axis=1)) & reached(pattern.T, (self.C != 0).any(axis=0))
        return StateSpace(self.A[np.ix_(kept, kept)], self.B[kept], self.C[:, kept], self.D)

    def with_inputs(self, places: Sequence[int]) -> StateSpace:
        """Return it with some of its inputs."""
        return StateSpace(self.A, self.B[:, places], self.C, self.D[:, places])

    def with_outputs(self, places: Sequence[int]) -> StateSpace:
        """Return it with some of its outputs."""
        return StateSpace(self.A, self.B, self.C[places], self.D[places])

    def opened(self) -> StateSpace:
        """Return it with u + y of the first outputs replaced by new inputs: their loops are open there.

        u = r - y: u = (I + D_1)^-1 (r - C_1 x) of the first m outputs.
        """
        F, G = self.opening()
        return StateSpace(self.A + self.B @ F, self.B @ G, self.C + self.D @ F, self.D @ G)

    def opening(self) -> tuple[np.ndarray, np.ndarray]:
        """Return F (m, n) and G (m, m) of u = F x + G r that opens the loops of the first m outputs."""
        m = self.B.shape[1]
        G = np.linalg.inv(np.eye(m) + self.D[:m])
        return -G @ self.C[:m], G

    def amplified(self, gain: float, wires: Sequence[int]) -> StateSpace:
        """Return it with u_k = (gain - 1) y_k of some wires k, without inputs: what arrives there is amplified."""
        return StateSpace(self.A + self.B @ self.amplification(gain, wires), self.B[:, :0], self.C, self.D[:, :0])

    def amplification(self, gain: float, wires: Sequence[int]) -> np.ndarray:
        """Return F (m, n) of the inputs u = F x that amplify wires."""
        F = np.zeros(self.D.T.shape)
        F[wires, wires] = gain - 1
        return np.asarray(np.linalg.solve(np.eye(len(F)) - F @ self.D, F @ self.C))

    def response(self, frequencies: Any) -> np.ndarray:
        """Return C (i 2 pi f I - A)^-1 B + D at frequencies f [Hz], shape (len(f), k, m); inf on a pole."""
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequencies, float))
        n = len(self.A)
        if n == 0 or 0 in self.B.shape or 0 in self.C.shape:
            return np.repeat(self.D[None].astype(complex), len(s), 0)
        if len(s) < MANY:
            made = [self.C @ solved(s[:, None, None] * np.eye(n) - self.A, self.B)]
        else:
            resolvent, chunks = Resolvent(self.A), np.array_split(s, 1 + len(s) * self.B.size // 2_000_000)
            made = [self.C @ resolvent.times(self.B, part) for part in chunks]
        response = np.concatenate(made) + self.D
        response[np.isnan(response).any(axis=(1, 2))] = np.inf
        return np.asarray(response)


class Resolvent:
    """(s I - A)^-1 at many s: triangular systems of one Schur decomposition A = Q T Q^H of the balanced matrix.

    Each solution is refined once by what it leaves of the equations of A itself: it is then as exact as Gaussian
    elimination at each s, where Q and T alone lose what is small beside the fastest poles.
    Source: Laub, IEEE Trans. Autom. Control 26 (1981) 407-408; Higham, Accuracy and Stability (2002), ch. 12.
    """

    def __init__(self, A: np.ndarray) -> None:
        from scipy.linalg import matrix_balance, schur  # as long to load as a short run takes

        self._A, (self._scale, _) = matrix_balance(A, permute=False, separate=True)
        T, self._Q = schur(self._A, output="complex")
        self._poles, self._triangle = np.diag(T).copy(), np.asfortranarray(-T)
        self._conjugate = self._Q.conj()

    def times(self, B: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Return the solutions X (len(s), n, m) of (s I - A) X = B, B (n, m) or (len(s), n, m); NaN on a pole."""
        right = np.swapaxes(B, -1, -2).astype(complex, copy=False) / self._scale  # rows are columns of B
        found = self._solved(s, right)
        left = right - s[:, None, None] * found
        for part in ("real", "imag"):  # as real products: half of the work
            getattr(left, part)[:] += _times(np.ascontiguousarray(getattr(found, part)), self._A.T)
        return np.swapaxes((found + self._solved(s, left)) * self._scale, 1, 2)

    def _solved(self, s: np.ndarray, rows: np.ndarray) -> np.ndarray:
        from scipy.linalg.lapack import ztrtrs

        found = _times(rows, self._conjugate)
        if rows.ndim == 2:
            found = np.repeat(found[None], len(s), 0)
        diagonal = self._triangle.reshape(-1, order="F")[:: len(self._poles) + 1]  # a view
        for k, at in enumerate(s):
            diagonal[:] = at - self._poles
            _, info = ztrtrs(self._triangle, found[k].T, overwrite_b=1)  # in place
            if info:
                found[k] = np.nan
        return _times(found, self._Q.T)


def _times(rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return rows (.., m, n) times a matrix (n, n), as one product."""
    return np.asarray(rows.reshape(-1, len(matrix)) @ matrix).reshape(rows.shape)


def solved(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solutions X of systems (..., n, n) with right-hand sides (..., n, j); NaN where one is singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, right))
    except np.linalg.LinAlgError:
        right = np.broadcast_to(right, (*matrices.shape[:-1], right.shape[-1]))
        if matrices.ndim == 2:
            return np.full(right.shape, np.nan, np.result_type(matrices, right))
        return np.array([solved(*pair) for pair in zip(matrices, right, strict=True)])


def reached(pattern: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return which states (n,) are driven by those at the start (n,) bool, also through others.

    pattern (n, n): whether the rate of a state depends on another.
    """
    while True:
        more = start | pattern[:, start].any(axis=1)
        if (more == start).all():
            return np.asarray(start)
        start = more


def frequencies_near(poles: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return frequencies [Hz] from low to high, logarithmic, and dense at the poles [1/s] in between."""
    told: list[complex] = []
    for pole in sorted(np.unique(poles[poles.imag >= 0]).tolist(), key=lambda one: one.imag):
        if np.abs(np.array(told) - pole).min(initial=np.inf) > SAME_POLE * abs(pole.real):
            told.append(pole)
    kept = np.array(told, complex)
    width = np.abs(kept.real) / (2 * np.pi)
    near = ((kept.imag / (2 * np.pi))[:, None] + width[:, None] * AROUND_A_POLE).ravel()
    count = max(round(POINTS_A_DECADE * np.log10(high / low)), 2)
    return np.unique(np.concatenate([np.geomspace(low, high, count), near[(near > low) & (near < high)]]))
