"""Settled motion with the shaft and one asynchronous frequency: the lines beside the harmonics."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve

FREQUENCY_TOLERANCE = 1e-6  # relative difference of asynchronous frequencies that are one
POINTS, TURNS = 3, 50.0  # samples for each coefficient on a torus, over so many turns of the slowest of all
SINGULAR_COMBINATION = (
    1e-12  # part of the largest eigenvalue: combinations too near to each other for the samples to separate
)
SEPARATED = 5.0  # largest logarithm between diagonal entries of a Cholesky factor of combinations that are separate
SWINGS = 3  # multiples of an asynchronous frequency that are kept: an angle that swings by m makes J_n(k m) of order k


class Torus:
    """Combinations k W + nu of the shaft with an asynchronous frequency, beside the harmonics of R runs.

    orders (L,): k. frequencies (R, L) [rad/s]. forced: whether the diagram moves there; then projection
    (R, K+1+L, N) gives the coefficients at harmonics and combinations of samples at times (R, N).
    """

    def __init__(self, speeds: np.ndarray, K: int, second: np.ndarray, orders: np.ndarray, forced: bool) -> None:
        self.orders, self.forced = orders, forced
        self.K, self.speeds, self.second = K, speeds, second
        self.frequencies = orders * speeds[:, None] + second[:, None]
        if not forced:
            return
        ways = tuple(int(order) for order in orders)
        runs = [_projection(float(W), float(nu), K, ways) for W, nu in zip(speeds, second, strict=True)]
        self.times, self.projection = (np.array(parts) for parts in zip(*runs, strict=True))

    def at(self, speeds: np.ndarray) -> Torus:
        """Return the combinations at other speeds: the asynchronous frequency is constant, or a part of the speed."""
        parts = self.second / np.abs(self.speeds)
        same = np.ptp(self.second) <= FREQUENCY_TOLERANCE * self.second.max()
        second = np.full(len(speeds), self.second.mean()) if same else parts.mean() * np.abs(speeds)
        return Torus(speeds, self.K, second, self.orders, self.forced)


@lru_cache(maxsize=64)
def _projection(speed: float, nu: float, K: int, orders: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return random times (N,), and what gives harmonics and combinations of samples at these, (K+1+L, N)."""
    k, multiples = np.arange(-K, K + 1), np.arange(-SWINGS, SWINGS + 1)
    every = np.array([(order, multiple) for multiple in multiples for order in k])
    zero, first = SWINGS * len(k) + K, (SWINGS + 1) * len(k) + K
    rows = [zero + order for order in range(K + 1)] + [first + int(np.sign(speed)) * order for order in orders]
    speed = abs(speed)
    slowest = min(speed, nu, *np.abs(speed * np.arange(1, 4) - nu))
    longest = 2 * np.pi * TURNS / max(slowest, 1e-3 * speed)
    times = np.random.default_rng(0).uniform(0, longest, POINTS * len(every))
    waves = np.exp(1j * times[:, None] * (every @ (speed, nu)))
    normal = waves.conj().T @ waves
    try:
        factor = cho_factor(normal)
        if np.ptp(np.log(np.abs(np.diag(factor[0])))) < SEPARATED:
            return times, cho_solve(factor, waves.conj().T)[rows]
    except np.linalg.LinAlgError:
        pass
    return times, np.linalg.pinv(normal, rcond=SINGULAR_COMBINATION, hermitian=True)[rows] @ waves.conj().T
