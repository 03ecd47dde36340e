"""Stability of periodic motion: Floquet multipliers from the exact Jacobian along it."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from rotorsim.settled.balance import samples_of
from rotorsim.settled.equations import PortEquations

LEAST_STEPS = 64  # per period
STABLE_MULTIPLIER = 1 + 1e-7  # largest multiplier of a stable motion: 1 but for rounding


def largest_multiplier(equations: PortEquations, base: float, p: np.ndarray, X: np.ndarray) -> float:
    """Return the largest magnitude of a Floquet multiplier of the motion X (H+1, n), see `growth_rate`."""
    return float(np.exp(min(growth_rate(equations, base, p, X, np.zeros(0)) * 2 * np.pi / base, 700.0)))


def growth_rate(
    equations: PortEquations, base: float, p: np.ndarray, X: np.ndarray, theta: np.ndarray, start: float = 0.0
) -> float:
    """Return ln |mu| / T [1/s] of the largest eigenvalue mu of the transition matrix over one period of X (H+1, n).

    base: 2 pi / T [rad/s]; start: time at which X counts from zero. The transition matrix is a product of
    exponentials of the Jacobian along the motion, two Gauss points a step (Magnus, order 4), exact for stiff constant
    parts; -inf where there is no state or the Jacobian is not finite.
    Source: Blanes et al., Physics Reports 470 (2009) 151-238, eq. (253); Nayfeh & Balachandran, Applied Nonlinear
    Dynamics (1995), ch. 3.
    """
    H, n = len(X) - 1, X.shape[1]
    steps = max(LEAST_STEPS, H)
    h = 2 * np.pi / base / steps
    root = np.sqrt(3) / 6
    first, second = (
        equations.J((start + (np.arange(steps) + node) * h)[None], _motion_at(X, steps, node).T, p, theta)
        for node in (0.5 - root, 0.5 + root)
    )
    exponents = h / 2 * (first + second) + np.sqrt(3) / 12 * h * h * (second @ first - first @ second)
    if not n or not np.isfinite(exponents).all():
        return -np.inf
    product, scale = np.eye(n), 0.0
    for factor in expm(exponents):
        product = factor @ product
        size = float(np.abs(product).max())
        product, scale = product / size, scale + float(np.log(size))
    largest = float(np.abs(np.linalg.eigvals(product)).max())
    return (float(np.log(max(largest, 1e-300))) + scale) * base / (2 * np.pi)


def _motion_at(X: np.ndarray, steps: int, node: float) -> np.ndarray:
    """Return the states (steps, n) at a place, 0..1, within every step of a period."""
    count = steps * (1 + (len(X) - 1) * 2 // steps)  # so many samples that no order is folded
    turned = X * np.exp(2j * np.pi * node / steps * np.arange(len(X)))[:, None]
    return samples_of(turned[None], count)[0, :: count // steps]
