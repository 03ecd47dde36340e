"""Kalman filters and smoothers of several systems at once that differ in one unknown input.

x_(k+1) = F_k x_k + G_k d_k + w,   d_(k+1) = pole d_k + w,   y_k = H_k x_k + D_k d_k + v,   v of unit variance

Source: Durbin & Koopman, Time Series Analysis by State Space Methods (2012), 4.3, 4.4; the variance in the form of
Joseph, in which a sum of squares stays one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rotorsim.linear import kalman_in_c
from rotorsim.linear.sampled import outputs
from rotorsim.linear.state_space import solved

DOUBLINGS = 30  # of the samples that a steady filter has seen: 1e9. From 40 on rounding decides where there is none
CONVERGED = 1e-12  # relative change from which on there is one


class Gains(NamedTuple):
    """Filters of B systems along N samples (or 1): of the predicted states, gain (N, B, n + 1, c), root (N, B, c, c),
    the inverse Cholesky factor of the variance of innovations, and log_det (B,), the sum of the logarithms of these.
    """

    gain: np.ndarray
    root: np.ndarray
    log_det: np.ndarray


@dataclass(frozen=True, eq=False)
class Systems:
    """B systems of n states: F (N or 1, n, n), G (N or 1, n, B), H (N or 1, c, n), D (N or 1, c, B), pole (B,).

    Q (B, n + 1): the variance of what enters x and d at every sample.
    """

    F: np.ndarray
    G: np.ndarray
    H: np.ndarray
    D: np.ndarray
    pole: np.ndarray
    Q: np.ndarray

    @property
    def _arrays(self) -> kalman_in_c.Given:
        return self.F, self.G, self.H, self.D, self.pole, self.Q

    def of(self, which: np.ndarray) -> Systems:
        """Return some of the systems; which: a mask or a slice of them."""
        G, D = self.G[:, :, which], self.D[:, :, which]
        return replace(self, G=G, D=D, pole=self.pole[which], Q=self.Q[which])

    def augmented(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return F (B, n + 1, n + 1) and H (B, c, n + 1) of x and d at sample k."""
        k = k if len(self.F) > 1 else 0
        (_, c, n), B = self.H.shape, len(self.pole)
        F, H = np.zeros((B, n + 1, n + 1)), np.zeros((B, c, n + 1))
        F[:, :n, :n], F[:, :n, n], F[:, n, n] = self.F[k], self.G[k].T, self.pole
        H[:, :, :n], H[:, :, n] = self.H[k], self.D[k].T
        return F, H

    def steady(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the variances P of x and d, as steady filters predict them at the first sample, and which have one."""
        return steady_variance(*self.augmented(0), self.Q[:, :, None] * np.eye(self.Q.shape[1]))

    def products(self, P: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the products (B, K, K) of the innovations of signals y (N, c, K), and the logarithms of variances.

        P (B, n + 1, n + 1): the variance at the first sample. These are infinite where a filter diverges.
        """
        if (found := kalman_in_c.products(self._arrays, P, y)) is not None:
            return found
        total, log_det = np.zeros((len(P), y.shape[2], y.shape[2])), np.zeros(len(P))
        for one, _, v in self._filtered(P, y):
            total, log_det = total + v.swapaxes(1, 2) @ v, log_det + one.log_det
        return total, log_det

    def gains(self, P: np.ndarray, samples: int) -> Gains:
        """Return the filters along a run of so many samples, one where they do not change."""
        if (found := kalman_in_c.gains(self._arrays, P, samples)) is not None:
            return Gains(*found)
        varying = len(self.F) > 1
        every = [one for one, *_ in self._filtered(P, np.zeros((samples if varying else 1, self.H.shape[1], 0)))]
        log_det = np.sum([one.log_det for one in every], axis=0) * (1 if varying else samples)
        return Gains(np.stack([one.gain for one in every]), np.stack([one.root for one in every]), log_det)

    def smoothed(self, P: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x and d (N, B, n + 1, K) given all samples of signals y (N, c, K), and the variance of d (N, B)."""
        if (found := kalman_in_c.smoothed(self._arrays, P, y)) is not None:
            return found
        every = [*self._filtered(P, y)]
        states, spread = np.empty((len(y), *every[0][1].shape)), np.empty((len(y), len(P)))
        r, N = np.zeros_like(every[0][1]), np.zeros_like(P)
        for k in range(len(y) - 1, -1, -1):
            one, x, v = every[k]
            rest, seen = one.F - one.gain @ one.H, (one.root @ one.H).swapaxes(1, 2)
            back = rest.swapaxes(1, 2)
            r, N = back @ r + seen @ v, back @ N @ rest + seen @ seen.swapaxes(1, 2)
            states[k], last = x + one.P @ r, one.P[:, -1:]
            spread[k] = (last[:, :, -1:] - last @ N @ last.swapaxes(1, 2))[:, 0, 0]
        return states, spread

    def _filtered(self, P: np.ndarray, y: np.ndarray) -> Iterator[tuple[Filters, np.ndarray, np.ndarray]]:
        """Yield the filters at each sample, predicted x and d (B, n + 1, K), and innovations (B, c, K)."""
        one = Filters.of(*self.augmented(0), P)
        Q, x = self.Q[:, :, None] * np.eye(P.shape[1]), np.zeros((*P.shape[:2], y.shape[2]))
        for k, row in enumerate(y):
            one = one.advanced(*self.augmented(k), Q) if k and len(self.F) > 1 else one
            difference = row - one.H @ x
            yield one, x, one.root @ difference
            x = one.F @ x + one.gain @ difference


@dataclass(frozen=True, eq=False)
class Filters:
    """Filters of B systems at one sample: F (B, n, n), H (B, c, n), P (B, n, n), noise of unit variance.

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

    def advanced(self, F: np.ndarray, H: np.ndarray, Q: np.ndarray) -> Filters:
        """Return the filters of the next sample; Q (B, n, n): the variance of what enters."""
        rest = self.F - self.gain @ self.H
        P = rest @ self.P @ rest.swapaxes(1, 2) + self.gain @ self.gain.swapaxes(1, 2) + Q
        return Filters.of(F, H, (P + P.swapaxes(1, 2)) / 2)


def _factor(V: np.ndarray) -> np.ndarray | None:
    """Return the Cholesky factor of a variance of innovations (c, c), 1 at least; None where rounding made it less."""
    if not np.isfinite(V).all() or np.linalg.eigvalsh(V).min() < 0.5:
        return None
    try:
        return np.asarray(np.linalg.cholesky(V))
    except np.linalg.LinAlgError:
        return None


def steady_variance(F: np.ndarray, H: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return P of P = F (P - P H^T (H P H^T + I)^-1 H P) F^T + Q for B systems, and which have one, (B,).

    By doubling: after k steps it is that of 2^k samples. Source: E. K.-W. Chu et al., Int. J. Control 77 (2004) 767.
    """
    A, G, P = F.swapaxes(1, 2), H.swapaxes(1, 2) @ H, Q
    one, done = np.eye(F.shape[1]), np.zeros(len(F), bool)
    with np.errstate(all="ignore"):
        for _ in range(DOUBLINGS):
            W = np.where(np.isfinite(G).all(axis=(1, 2))[:, None, None], one + G @ P, one)
            WA, WG = solved(W, A), solved(W, G)
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
    """The steady or varying filter of one system along a run: signals (N, c, K) to innovations of unit variance.

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
