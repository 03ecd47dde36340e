"""Stability of periodic motion: Floquet multipliers from the exact Jacobian along it."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from rotorsim.settled.linear_response import Setup

__all__ = ["floquet_multipliers", "is_stable"]

LEAST_STEPS = 64  # per period


def is_stable(setup: Setup, base: float, p: np.ndarray, X: np.ndarray) -> bool:
    """Return whether all Floquet multipliers of the motion X (H+1, n_x) lie in the unit circle."""
    return bool(np.abs(floquet_multipliers(setup, base, p, X)).max(initial=0.0) <= 1 + 1e-7)


def floquet_multipliers(setup: Setup, base: float, p: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return the eigenvalues of the transition matrix over one period of the motion X (H+1, n_x).

    base: 2 pi / period [rad/s]. The transition matrix is a product of exponentials of the Jacobian along the
    motion, two Gauss points a step (Magnus, order 4), exact for stiff constant parts.
    Source: Blanes et al., Physics Reports 470 (2009) 151-238, eq. (253).
    """
    H = len(X) - 1
    steps = max(LEAST_STEPS, H)
    h = 2 * np.pi / base / steps
    root = np.sqrt(3) / 6
    nodes = ((np.arange(steps)[:, None] + 0.5 + np.array([-root, root])) * h).ravel()
    wave = np.exp(1j * base * np.outer(nodes, np.arange(H + 1)))
    wave[:, 1:] *= 2
    x = (wave @ X).real
    J = setup.nonlinear(p).jacobian(nodes[None, :], x.T, setup.z, p)
    first, second = J[0::2], J[1::2]
    exponent = h / 2 * (first + second) + np.sqrt(3) / 12 * h * h * (second @ first - first @ second)
    product = np.eye(J.shape[1])
    for factor in expm(exponent):
        product = factor @ product
    return np.asarray(np.linalg.eigvals(product))
