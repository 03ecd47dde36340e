"""The response (s I - A)^-1 of many runs at many orders to a few right-hand sides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["Resolvent"]

DENSE = 24  # states up to which the inverses themselves are as fast
CONDITION = 1e7  # of the eigenvectors, up to which they are used


class Resolvent:
    """(s I - A)^-1 for A (R, n, n) and s (R, K+1), order 0 first; slow states (indices of each run) rest at order 0.

    Large systems are solved in their eigenvectors, so that an order costs n^2; at order 0 by the inverse.
    """

    def __init__(self, A: np.ndarray, s: np.ndarray, slow: Sequence[np.ndarray]) -> None:
        n = A.shape[1]
        self.s = s
        self.eigen: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        if n > DENSE:
            values, vectors = np.linalg.eig(A)
            if np.linalg.cond(vectors).max() < CONDITION:
                self.eigen = values, vectors, np.linalg.inv(vectors)
        orders = 1 if self.eigen else s.shape[1]
        matrices = s[:, :orders, None, None] * np.eye(n) - A[:, None]
        for r, states in enumerate(slow):
            matrices[r, 0, states, :] = 0.0
            matrices[r, 0, :, states] = 0.0
            matrices[r, 0, states, states] = 1.0
        self.inverse = np.linalg.inv(matrices)
        for r, states in enumerate(slow):
            self.inverse[r, 0, states, :] = 0.0

    def apply(self, right: np.ndarray) -> np.ndarray:
        """Return the responses to right-hand sides (R, K+1, n, j) or (R, 1, n, j), the same at all orders."""
        if self.eigen is None:
            return np.asarray(self.inverse @ right)
        values, vectors, inverse = self.eigen
        parts = (inverse[:, None] @ right) / (self.s[:, :, None] - values[:, None])[..., None]
        found = vectors[:, None] @ parts
        found[:, 0] = self.inverse[:, 0] @ right[:, 0]
        return np.asarray(found)

    def apply_to_run(self, r: int, right: np.ndarray) -> np.ndarray:
        """Return the responses of one run to right-hand sides (K+1, n)."""
        if self.eigen is None:
            return np.asarray(np.einsum("kij,kj->ki", self.inverse[r], right))
        values, vectors, inverse = (part[r] for part in self.eigen)
        found = (right @ inverse.T / (self.s[r][:, None] - values)) @ vectors.T
        found[0] = self.inverse[r, 0] @ right[0]
        return np.asarray(found)

    @property
    def at_zero(self) -> np.ndarray:
        """The inverses at order 0, (R, n, n)."""
        return np.asarray(self.inverse[:, 0])
