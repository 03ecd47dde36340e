"""The covariance of measured harmonics, and what whitens it: real equations in units of their standard deviation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from rotorsim.signals.covariance import scaled_cholesky
from rotorsim.signals.harmonic_fit import RESOLUTION, HarmonicFit


@dataclass(frozen=True, eq=False)
class Whitener:
    """The inverse of the Cholesky factor of the covariance of the rows ``keep`` of a run's harmonics."""

    matrix: np.ndarray
    keep: np.ndarray

    def apply(self, rows: np.ndarray) -> np.ndarray:
        """Return whitened rows of a vector (all,) or of columns (all, j)."""
        return self.apply_kept(rows[self.keep])

    def apply_kept(self, rows: np.ndarray) -> np.ndarray:
        """Return whitened columns (n, j), of which the last rows may be left out where they are zero."""
        last, half = len(rows), len(self.keep) // 2
        upper = self.matrix[:half, : min(half, last)] @ rows[:half]  # nothing is right of the diagonal
        return np.concatenate([upper, self.matrix[half:, :last] @ rows])


def whitener_of(fit: HarmonicFit, columns: np.ndarray, K: int, keep: np.ndarray, *, beside: bool) -> Whitener:
    """Return what whitens harmonics 0..K of some channels, as harmonics of time, and lines beside; known delay."""
    return Whitener(_inverse_root(fit, tuple(columns.tolist()), K, tuple(keep.tolist()), beside), keep)


@lru_cache(maxsize=64)
def _inverse_root(
    fit: HarmonicFit, columns: tuple[int, ...], K: int, keep: tuple[int, ...], beside: bool
) -> np.ndarray:
    covariance = fit.covariance_at(np.array(columns), range(K + 1), RESOLUTION, stamp=False)
    if fit.speed < 0:
        sign = np.ones((2 * K + 1, len(columns)))
        sign[2::2] = -1
        covariance = covariance * np.outer(sign.ravel(), sign.ravel())
    if beside:
        covariance = block_diag(covariance, fit.covariance_beside(np.array(columns), RESOLUTION))
    kept = np.array(keep)
    return _whitened(covariance[np.ix_(kept, kept)], np.eye(len(kept)))


def whitened_at(fit: HarmonicFit, columns: np.ndarray, K: int, order: int, values: np.ndarray) -> np.ndarray:
    """Return complex columns (c, m) at one order as whitened real rows (2 c, m), other orders ignored.

    order: from K + 1 on the lines beside the harmonics.
    """
    if order > K:
        size = 2 * len(columns)
        part = slice(size * (order - K - 1), size * (order - K))
        covariance = fit.covariance_beside(columns, RESOLUTION)[part, part]
    else:
        covariance = fit.covariance_at(columns, [order], RESOLUTION)
    return _whitened(covariance, np.concatenate([values.real, values.imag]))


def noise_root(fit: HarmonicFit, columns: np.ndarray, K: int) -> np.ndarray:
    """Return a root of the covariance of the real harmonics 0..K of some channels."""
    scale, factor = scaled_cholesky(fit.covariance_at(columns, range(K + 1), RESOLUTION))
    return np.asarray(scale[:, None] * factor)


def _whitened(covariance: np.ndarray, rows: np.ndarray) -> np.ndarray:
    scale, factor = scaled_cholesky(covariance)
    return np.asarray(solve_triangular(factor, rows / scale[:, None], lower=True))


def harmonics_of_time(values: np.ndarray, speed: float) -> np.ndarray:
    """Return harmonics of time, from harmonics of the angle: a shaft that turns back counts them the other way."""
    return values if speed > 0 else values.conj()
