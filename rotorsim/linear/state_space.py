"""Linear systems as matrices: response, systems of equations at many frequencies, what drives what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

POINTS_A_DECADE = 150
AROUND_A_POLE = np.linspace(-3, 3, 13)  # half widths


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
        chunks = np.array_split(s, 1 + len(s) * n * n // 2_000_000)
        states = [solved(part[:, None, None] * np.eye(n) - self.A, self.B) for part in chunks]
        response = self.C @ np.concatenate(states) + self.D
        response[np.isnan(response).any(axis=(1, 2))] = np.inf
        return np.asarray(response)


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
    width = np.abs(poles.real) / (2 * np.pi)
    near = ((np.abs(poles.imag) / (2 * np.pi))[:, None] + width[:, None] * AROUND_A_POLE).ravel()
    count = max(round(POINTS_A_DECADE * np.log10(high / low)), 2)
    return np.unique(np.concatenate([np.geomspace(low, high, count), near[(near > low) & (near < high)]]))
