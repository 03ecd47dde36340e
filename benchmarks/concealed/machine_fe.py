"""Beam finite elements of the generator: one complex plane, u = u_x + i u_y and slope du/ds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def hermite(length: float, bending: float, line_mass: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mass and stiffness (4, 4) of a Bernoulli beam element, from its cubic shape functions.

    M = int rho A N^T N ds,   K = int E I N''^T N'' ds,   q = (u_1, u_1', u_2, u_2')

    The integrals are of polynomials of degree 6 and 2: four Gauss points are exact.
    """
    points, weights = np.polynomial.legendre.leggauss(4)
    s = (points + 1) / 2
    N = np.array([1 - 3 * s**2 + 2 * s**3, length * (s - 2 * s**2 + s**3), 3 * s**2 - 2 * s**3, length * (s**3 - s**2)])
    curvature = np.array([-6 + 12 * s, length * (6 * s - 4), 6 - 12 * s, length * (6 * s - 2)]) / length**2
    w = weights * length / 2
    return line_mass * (N * w) @ N.T, bending * (curvature * w) @ curvature.T


def beam(
    elements: int, length: float, diameter: float, young: float, density: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return assembled mass and stiffness (2 nodes, 2 nodes) of a uniform shaft without supports."""
    area, second = np.pi * diameter**2 / 4, np.pi * diameter**4 / 64
    m, k = hermite(length / elements, young * second, density * area)
    size = 2 * (elements + 1)
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    for e in range(elements):
        here = slice(2 * e, 2 * e + 4)
        mass[here, here] += m
        stiffness[here, here] += k
    return mass, stiffness


def pinned(matrix: NDArray[np.float64], held: list[int]) -> NDArray[np.float64]:
    """Return the matrix without the held degrees of freedom."""
    keep = np.setdiff1d(np.arange(len(matrix)), held)
    return np.asarray(matrix[np.ix_(keep, keep)])


def bare_frequencies(
    elements: int, length: float, diameter: float, young: float, density: float
) -> NDArray[np.float64]:
    """Return the natural frequencies [rad/s] of a shaft on pins at both ends, ascending."""
    from scipy.linalg import eigh

    mass, stiffness = beam(elements, length, diameter, young, density)
    held = [0, 2 * elements]
    return np.asarray(np.sqrt(eigh(pinned(stiffness, held), pinned(mass, held), eigvals_only=True)))
