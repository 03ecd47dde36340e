"""Plain NumPy for the same work: harmonics by lstsq, and the regression of thesis eq. (2.64) written out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

ORDERS = (0, 1, 2, 3, 5, 7, -1, -3, -5)
MASS, STIFFNESS, SAG = 2.0, 7.6e5, 26e-6


def harmonics(theta: np.ndarray, signals: np.ndarray, orders: int) -> np.ndarray:
    """Return least-squares coefficients (2 orders + 1, channels) of cosines and sines of multiples of theta."""
    k = np.arange(1, orders + 1)
    angles = np.outer(theta, k)
    basis = np.column_stack([np.ones(len(theta)), np.cos(angles), np.sin(angles)])
    return np.asarray(np.linalg.lstsq(basis, signals, rcond=None)[0])


def two_axis(coefficients: np.ndarray, orders: int, x: int, y: int) -> dict[int, complex]:
    """Return R_k of x + i y for the orders of the thesis."""
    found = {}
    for order in ORDERS:
        k = abs(order)
        c = [
            coefficients[0, j] if k == 0 else (coefficients[k, j] - 1j * coefficients[orders + k, j]) / 2
            for j in (x, y)
        ]
        found[order] = complex(c[0] + 1j * c[1]) if order >= 0 else complex(np.conj(c[0]) + 1j * np.conj(c[1]))
    return found


def participation(order: int) -> float:
    """Return p_i of the switching crack with five cosines."""
    series = {0: 0.5}
    for k in range(5):
        n = 2 * k + 1
        series[n] = series[-n] = (-1) ** k / (np.pi * n)
    return 0.5 * (series.get(order, 0.0) + series.get(order - 2, 0.0))


def identify(runs: Sequence[tuple[float, dict[int, complex], dict[int, complex]]]) -> np.ndarray:
    """Return c, dk, e cos b, e sin b, k_s, k_i from (speed, R, I) of every run, thesis eq. (2.64)-(2.66)."""
    rows, right = [], []
    for speed, R, current in runs:
        for i in ORDERS:
            r, force = R[i], participation(i) * SAG
            turn = MASS * speed**2 if i == 1 else 0.0
            row = np.array([1j * i * speed * r, -force, -turn, -1j * turn, -r, current[i]])
            b = ((i * speed) ** 2 * MASS - STIFFNESS) * r
            rows += [row.real, row.imag]
            right += [b.real, b.imag]
    return np.asarray(np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0])
