"""Crack opening, crack force, unbalance and shaft angle, written out from the thesis."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

RPM = 2 * math.pi / 60


def switching(theta: float, terms: int = 5) -> float:
    """Return the opening of a switching crack as a finite Fourier series.

    s = 1/2 + 2/pi (cos th - cos 3th / 3 + cos 5th / 5 - ...), `terms` cosines      thesis eq. (2.11)
    """
    total = 0.5
    for order, share in _cosines(terms):
        total += share * math.cos(order * theta)
    return total


@cache
def _cosines(terms: int) -> tuple[tuple[int, float], ...]:
    return tuple((2 * k + 1, (-1) ** k * 2.0 / (math.pi * (2 * k + 1))) for k in range(terms))


def crack_force(theta: float, stiffness: float, sag: float, terms: int = 5) -> complex:
    """Return the crack force f_x + i f_y [N] of a weight-dominated crack.

    f = s(th) dk delta_x (1 + exp(2 i th)) / 2                                    thesis eq. (2.28)
    """
    return 0.5 * switching(theta, terms) * stiffness * sag * (1.0 + complex(math.cos(2 * theta), math.sin(2 * theta)))


def unbalance_force(theta: float, speed: float, mass: float, eccentricity: float, phase: float) -> complex:
    """Return the unbalance force m e W^2 exp(i (th + beta)) [N]                    thesis eq. (2.28)."""
    return mass * eccentricity * speed**2 * complex(math.cos(theta + phase), math.sin(theta + phase))


def participation(terms: int = 5) -> dict[int, float]:
    """Return the participation factors p_i of the switching crack, f = dk delta_x sum p_i exp(i k th).

    With s = sum s_k exp(i k th): p_i = (s_i + s_{i-2}) / 2                          thesis eq. (2.29)
    """
    series = {0: 0.5}
    for k in range(terms):
        order = 2 * k + 1
        series[order] = series[-order] = (-1) ** k / (math.pi * order)
    orders = set(series) | {order + 2 for order in series}
    found = {i: 0.5 * (series.get(i, 0.0) + series.get(i - 2, 0.0)) for i in sorted(orders)}
    return {i: p for i, p in found.items() if p != 0.0}


def harmonics(time: np.ndarray, signal: np.ndarray, speed: float, orders: list[int]) -> dict[int, complex]:
    """Return R_i = mean(r exp(-i k W t)) over a window of whole turns."""
    return {i: complex(np.mean(signal * np.exp(-1j * i * speed * time))) for i in orders}
