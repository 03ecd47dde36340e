"""Inputs during a step: held, or polynomials through known points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

Point = tuple[float, np.ndarray]  # time, values


class InputHistory(Protocol):
    """Inputs during a step: u(tau) for tau = t - start of the step. is_held: they stay as they are."""

    @property
    def is_held(self) -> bool: ...

    def __call__(self, tau: float) -> np.ndarray: ...


class Held:
    """Inputs that stay as they are during a step."""

    is_held = True

    def __init__(self, value: np.ndarray) -> None:
        self.value = value

    def __call__(self, tau: float) -> np.ndarray:
        return self.value


class Polynomial:
    """u(tau) = c_0 + c_1 (tau / h) + c_2 (tau / h)^2 + ..."""

    is_held = False

    def __init__(self, coefficients: Sequence[np.ndarray], h: float) -> None:
        self.coefficients, self.h = coefficients, h

    def __call__(self, tau: float) -> np.ndarray:
        s, total = tau / self.h, self.coefficients[-1]
        for coefficient in self.coefficients[-2::-1]:
            total = total * s + coefficient
        return total


def through(points: Sequence[Point], start: float, h: float) -> list[np.ndarray]:
    """Return the coefficients, in (t - start) / h, of the polynomial through one to three points (Newton's form)."""
    y0 = points[0][1]
    if len(points) == 1:
        return [y0]
    s = [(t - start) / h for t, _ in points]
    first = (points[1][1] - y0) / (s[1] - s[0])
    if len(points) == 2:
        return [y0 - first * s[0], first]
    second = ((points[2][1] - points[1][1]) / (s[2] - s[1]) - first) / (s[2] - s[0])
    return [y0 - first * s[0] + second * (s[0] * s[1]), first - second * (s[0] + s[1]), second]


def hermite(u0: np.ndarray, r0: np.ndarray, u1: np.ndarray, r1: np.ndarray) -> list[np.ndarray]:
    """Return the coefficients of the cubic with values u0, u1 and rates r0, r1 (per step) at the ends of a step."""
    return [u0, r0, 3 * (u1 - u0) - (2 * r0 + r1), 2 * (u0 - u1) + (r0 + r1)]
