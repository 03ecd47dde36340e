"""Least squares on cosines and sines of the shaft angle, a slow drift, and lines of fixed frequency beside them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import tau
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from rotorsim.errors import Problem, RotorsimError

MOST_ORDERS = 16
DRIFT = 2  # degree of the drift of the mean
LEAST_TOLD = 1e-6  # of the best known combination of coefficients: information of one that samples tell nothing of


@dataclass(frozen=True, eq=False)
class Basis:
    """Columns (n, m) of a harmonic fit with the factor of their normal matrix: the same for all signals of a run.

    orders: K. drift: degree of the drift. turns: of the shaft. Raises RotorsimError when the columns are not
    independent.
    """

    run: str
    columns: np.ndarray
    orders: int
    drift: int
    turns: float

    def __post_init__(self) -> None:
        _ = self._factor

    @cached_property
    def _size(self) -> np.ndarray:
        return np.asarray(np.sqrt(np.einsum("ij,ij->j", self.columns, self.columns)))

    @cached_property
    def _scaled(self) -> np.ndarray:
        return np.asarray(self.columns / self._size)

    @cached_property
    def _factor(self) -> tuple[Any, bool]:
        try:
            factor: tuple[Any, bool] = cho_factor(self._scaled.T @ self._scaled, lower=True)
            if np.diag(factor[0]).min() < 1e-5:
                raise np.linalg.LinAlgError
        except np.linalg.LinAlgError:
            what = f"{self.columns.shape[1]} harmonics and drifts cannot be separated in {self.turns:.3g} turns"
            raise RotorsimError(Problem(what, f"run {self.run}", hint="a longer run, or fewer orders")) from None
        return factor

    def with_waves(self, phases: Iterable[np.ndarray]) -> Basis:
        """Return a basis with `wave_columns` of further phases (n,)."""
        more = [wave_columns(phase) for phase in phases]
        return replace(self, columns=np.column_stack([self.columns, *more])) if more else self

    def with_lines(self, time: np.ndarray, frequencies: Iterable[float]) -> Basis:
        """Return a basis with columns of lines of fixed frequencies [Hz] at times (n,)."""
        return self.with_waves(tau * frequency * time for frequency in frequencies)

    def solve(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least-squares coefficients (m, C) of signals (n, C), and the residual (n, C)."""
        coefficients = cho_solve(self._factor, self._scaled.T @ y)
        coefficients += cho_solve(self._factor, self._scaled.T @ (y - self._scaled @ coefficients))  # to rounding
        coefficients /= self._size[:, None]
        return coefficients, y - self.columns @ coefficients

    def left_of(self, more: np.ndarray) -> np.ndarray:
        """Return the products (j, j) of what the fit leaves of further columns (n, j)."""
        taken = solve_triangular(self._factor[0], self._scaled.T @ more, lower=True)
        return np.asarray(more.T @ more - taken.T @ taken)

    @cached_property
    def inverse(self) -> np.ndarray:
        """Inverse of the normal matrix (m, m) (of scaled columns: well conditioned)."""
        root = solve_triangular(self._factor[0], np.diag(1 / self._size), lower=True)
        return np.asarray(root.T @ root)

    @cached_property
    def kept(self) -> np.ndarray:
        """Share of white noise that the fit leaves of each line of the spectrum, (n // 2 + 1,)."""
        base = solve_triangular(self._factor[0], self._scaled.T, lower=True)
        taken = (np.abs(np.fft.rfft(base, axis=1)) ** 2).sum(axis=0) / base.shape[1]
        return np.asarray(np.maximum(1 - taken, 0.0))

    def covariance(self, weights: np.ndarray) -> np.ndarray:
        """Return the covariance (m, m) of the coefficients where each sample (n,) has an information of its own."""
        values, vectors = np.linalg.eigh(self._scaled.T @ (self._scaled * weights[:, None]))
        kept = np.maximum(values, LEAST_TOLD * values[-1])
        return np.asarray((vectors / kept) @ vectors.T / np.outer(self._size, self._size))


def wave_columns(phase: np.ndarray) -> np.ndarray:
    """Return the columns (n, 2) of 2 Re c e^{i phase} = 2 Re c cos(phase) - 2 Im c sin(phase)."""
    return np.column_stack([2 * np.cos(phase), -2 * np.sin(phase)])


def harmonic_basis(run: str, time: np.ndarray, theta: np.ndarray, *, orders: int | None = None) -> Basis:
    """Return the columns 1, 2 cos k theta, -2 sin k theta and Legendre polynomials of time, at (n,) samples.

    orders: highest order K; default as many as the window and the sampling carry, at most 16.
    Raises RotorsimError for no room for one harmonic, or for those that are wanted.
    """
    n = len(theta)
    turns = float(abs(theta[-1] - theta[0]) / tau) * n / max(n - 1, 1)
    room = min(int(0.45 * n / turns), (n - DRIFT - 8) // 4)
    if room < 1:
        what = f"{n} samples over {turns:.3g} turns cannot carry a harmonic"
        raise RotorsimError(Problem(what, f"run {run}", hint="sample more often"))
    if orders is not None and orders > room:
        what = f"order {orders} cannot be told from {n} samples over {turns:.3g} turns; at most {room}"
        raise RotorsimError(Problem(what, f"run {run}", hint="fewer orders, or sample more often"))
    K = min(room, MOST_ORDERS) if orders is None else orders
    drift = DRIFT if turns >= 1.5 else 0
    columns = np.empty((n, 2 * K + 1 + drift))
    columns[:, 0] = 1.0
    first = np.exp(1j * theta)
    power = np.ones_like(first)
    for k in range(1, K + 1):
        power = power * first
        columns[:, 2 * k - 1], columns[:, 2 * k] = 2 * power.real, -2 * power.imag
    if drift:
        u = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
        columns[:, 2 * K + 1 :] = np.column_stack([u, 1.5 * u**2 - 0.5])
    return Basis(run, columns, K, drift, turns)


def check_samples(run: str, names: Iterable[str], y: np.ndarray, theta: np.ndarray) -> None:
    """Raise RotorsimError for samples (n, C) that are too few, or not finite, or less than a turn of the shaft."""
    n = len(theta)
    if n < 4:
        raise RotorsimError(Problem(f"only {n} samples", f"run {run}", hint="harmonics need a turn of the shaft"))
    problems = []
    for name, bad in zip(names, ~np.isfinite(y).T, strict=True):
        count = int(bad.sum())
        if count:
            what = f"{count} sample{' is' if count == 1 else 's are'} not finite, first at sample {bad.argmax() + 1}"
            problems.append(Problem(what, f"run {run}: {name}"))
    turned = abs(float(theta[-1] - theta[0])) / tau
    if not turned >= 1 - 1e-6 * max(turned, 1) - 2 / n:
        what = f"only {turned:.3g} turns of the shaft were recorded"
        problems.append(Problem(what, f"run {run}", hint="harmonics need at least one turn"))
    if problems:
        raise RotorsimError(*problems)
