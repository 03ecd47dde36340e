"""Kalman filters of several hypotheses at once: one step of each, and the steady ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorsim.linear.sampled import outputs

DOUBLINGS = 30  # of the samples that a steady filter has seen: 1e9. From 40 on rounding decides where there is none
CONVERGED = 1e-12  # relative change from which on there is one


@dataclass(frozen=True, eq=False)
class Filters:
    """Filters of B hypotheses (place, strength): F (B, n, n), H (B, c, n), P (B, n, n), noise of unit variance.

    gain (B, n, c), root (B, c, c): inverse Cholesky factor of the variance of innovations; log_det (B,).
    """

    F: np.ndarray
    H: np.ndarray
    P: np.ndarray
    gain: np.ndarray
    root: np.ndarray
    log_det: np.ndarray

    @classmethod
    def of(cls, F: np.ndarray, H: np.ndarray, P: np.ndarray) -> Filters:
        """Return the filters with prediction variances P; log_det is infinite where they are none (they diverged)."""
        PH, one, lost = P @ H.swapaxes(1, 2), np.eye(H.shape[1]), np.zeros(len(P), bool)
        try:
            factor = np.linalg.cholesky(H @ PH + one)
        except np.linalg.LinAlgError:
            factors = [_factor(V) for V in H @ PH + one]
            lost = np.array([found is None for found in factors])
            factor = np.stack([one if found is None else found for found in factors])
            P, PH = (np.where(lost[:, None, None], 0.0, M) for M in (P, PH))
        root = np.linalg.inv(factor)
        gain = F @ PH @ root.swapaxes(1, 2) @ root
        log_det = np.where(lost, np.inf, -2 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1))
        return cls(F, H, P, gain, root, log_det)


def _factor(V: np.ndarray) -> np.ndarray | None:
    """Return the Cholesky factor of a variance of innovations (c, c), 1 at least; None where rounding made it less."""
    if not np.isfinite(V).all() or np.linalg.eigvalsh(V).min() < 0.5:
        return None
    try:
        return np.asarray(np.linalg.cholesky(V))
    except np.linalg.LinAlgError:
        return None


def steady_variance(F: np.ndarray, H: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return P of P = F (P - P H^T (H P H^T + I)^-1 H P) F^T + Q for B hypotheses, and which have one, (B,).

    By doubling: after k steps it is that of 2^k samples. Source: E. K.-W. Chu et al., Int. J. Control 77 (2004) 767.
    """
    A, G, P = F.swapaxes(1, 2), H.swapaxes(1, 2) @ H, Q
    one, done = np.eye(F.shape[1]), np.zeros(len(F), bool)
    with np.errstate(all="ignore"):
        for _ in range(DOUBLINGS):
            W = np.where(np.isfinite(G).all(axis=(1, 2))[:, None, None], one + G @ P, one)
            WA, WG = np.linalg.solve(W, A), np.linalg.solve(W, G)
            more = A.swapaxes(1, 2) @ P @ WA
            A, G, P = A @ WA, G + A @ WG @ A.swapaxes(1, 2), P + (more + more.swapaxes(1, 2)) / 2
            done = np.abs(more).max(axis=(1, 2)) <= CONVERGED * np.abs(P).max(axis=(1, 2))
            if done.all():
                break
    found = done & np.isfinite(P).all(axis=(1, 2))
    V = H @ np.where(found[:, None, None], P, 0.0) @ H.swapaxes(1, 2) + np.eye(H.shape[1])
    return P, found & (np.linalg.eigvalsh(V).min(axis=1) > 0.5)  # 1 at least, but for rounding


@dataclass(frozen=True, eq=False)
class Whitening:
    """The steady or varying filter of one hypothesis along a run: signals (N, c, K) to innovations of unit variance.

    F (N or 1, n, n): of the predicted states, gain (N or 1, n, c), H (N or 1, c, n), root (N or 1, c, c). log_det: sum
    of the logarithms of their variances. noise (c,): of the outputs.
    """

    F: np.ndarray
    gain: np.ndarray
    H: np.ndarray
    root: np.ndarray
    log_det: float
    noise: np.ndarray

    def innovations(self, y: np.ndarray) -> np.ndarray:
        """Return the innovations (N, c, K) of signals at the outputs."""
        return outputs(self.F, self.gain, self._predicting, self.root, y / self.noise[:, None])

    @cached_property
    def _predicting(self) -> np.ndarray:
        """What takes predicted states to the innovations, (N or 1, c, n)."""
        return np.asarray(-self.root @ self.H)
