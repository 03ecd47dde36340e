"""Exact response of M r'' + (C - i W G) r' + K r + B i = sum F_k exp(i k W t) under PID feedback."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm


@dataclass(frozen=True)
class ForcedLinear:
    """A first-order linear system under harmonic forcing: y' = A y + sum b_k exp(i k W t).

    matrix: A (n, n); forcing: order -> b_k (n,); speed: W [rad/s]. All may be complex.
    """

    matrix: np.ndarray
    forcing: dict[int, np.ndarray]
    speed: float

    def settled(self) -> dict[int, np.ndarray]:
        """Return the harmonics of the settled motion: (i k W - A) Y_k = b_k."""
        eye = np.eye(len(self.matrix))
        return {k: np.linalg.solve(1j * k * self.speed * eye - self.matrix, b) for k, b in self.forcing.items()}

    def at(self, time: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return y at equally spaced times (m, n) from y(0) = start: settled motion plus exact transient."""
        settled = self.settled()
        n = len(self.matrix)
        first = start.astype(complex) - sum(settled.values())
        free = np.empty((len(time), n), dtype=complex)
        free[0] = expm(self.matrix * time[0]) @ first
        if len(time) > 1:
            step = expm(self.matrix * (time[1] - time[0]))
            for j in range(1, len(time)):
                free[j] = step @ free[j - 1]
        for k, value in settled.items():
            free += np.exp(1j * k * self.speed * time)[:, None] * value
        return free
