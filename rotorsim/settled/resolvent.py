"""The response (s I - A)^-1 of many runs at many orders to a few right-hand sides."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from rotorsim.settled.ports import Ports

__all__ = ["PortResolvent", "Resolvent"]


class Resolvent:
    """(s I - A)^-1 for A (R, n, n) and s (R, K+1), order 0 first; slow states (indices of each run) rest at order 0."""

    def __init__(self, A: np.ndarray, s: np.ndarray, slow: Sequence[np.ndarray]) -> None:
        self.A, self.s, self.slow = A, s, slow

    @cached_property
    def inverse(self) -> np.ndarray:
        """(s I - A)^-1, (R, K+1, n, n)."""
        matrices = self.s[:, :, None, None] * np.eye(self.A.shape[1]) - self.A[:, None]
        for r, states in enumerate(self.slow):
            matrices[r, 0, states, :] = 0.0
            matrices[r, 0, :, states] = 0.0
            matrices[r, 0, states, states] = 1.0
        found: np.ndarray = np.linalg.inv(matrices)
        for r, states in enumerate(self.slow):
            found[r, 0, states, :] = 0.0
        return found

    def apply(self, right: np.ndarray) -> np.ndarray:
        """Return the responses to right-hand sides (R, K+1, n, j) or (R, 1, n, j), the same at all orders."""
        return np.asarray(self.inverse @ right)

    def apply_to_run(self, r: int, right: np.ndarray) -> np.ndarray:
        """Return the responses of one run to right-hand sides (K+1, n)."""
        return np.asarray(np.einsum("kij,kj->ki", self.inverse[r], right))

    def slow_columns(self, r: int) -> np.ndarray:
        """Return dX_0 by the means of the slow states of run r, (n, s)."""
        slow = self.slow[r] if len(self.slow) else np.zeros(0, int)
        columns = (self.inverse[r, 0] @ self.A[r][:, slow]).real
        columns[slow, np.arange(len(slow))] = 1.0
        return np.asarray(columns)


class PortResolvent:
    """The same from the ports (R, K+1, r, j) to the states that matter; change: A less the reference, (R, r, n')."""

    def __init__(self, ports: Ports, change: np.ndarray) -> None:
        self.ports, self.change = ports, change
        self.closed = ports.closed(change)

    def apply(self, right: np.ndarray) -> np.ndarray:
        """Return the responses (R, K+1, n', j) to right-hand sides (R, K+1, r, j) or (R, 1, r, j)."""
        return np.asarray(self.closed @ right)

    def apply_to_run(self, r: int, right: np.ndarray) -> np.ndarray:
        """Return the responses of one run to right-hand sides (K+1, r)."""
        return np.asarray(np.einsum("kij,kj->ki", self.closed[r], right))

    def slow_columns(self, r: int) -> np.ndarray:
        """Return dX_0 by the means of the slow states of run r, (n', s)."""
        own = self.ports.slow[r]
        return np.asarray(own + (self.closed[r, 0] @ (self.change[r] @ own)).real)
