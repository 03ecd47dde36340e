"""Beam finite elements of the generator: one complex plane, u = u_x + i u_y and slope du/ds."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def hermite(length: float, bending: float, line_mass: float) -> tuple[Array, Array]:
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
    lengths: ArrayLike, outer: ArrayLike, inner: ArrayLike, young: float, density: float, parts: int = 1
) -> tuple[Array, Array]:
    """Return assembled mass and stiffness (2 nodes, 2 nodes) of a stepped, partly hollow shaft without supports.

    lengths (E,) of the elements, each made of `parts` beams; outer, inner: diameters (E,) or one for all [m].
    """
    lengths, outer, inner = np.broadcast_arrays(np.asarray(lengths, float), outer, inner)
    size = 2 * (len(lengths) * parts + 1)
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    for e, (length, a, b) in enumerate(zip(lengths, outer, inner, strict=True)):
        area, second = np.pi * (a**2 - b**2) / 4, np.pi * (a**4 - b**4) / 64
        m, k = hermite(length / parts, young * second, density * area)
        for part in range(e * parts, (e + 1) * parts):
            here = slice(2 * part, 2 * part + 4)
            mass[here, here] += m
            stiffness[here, here] += k
    return mass, stiffness


def pinned(matrix: Array, held: list[int]) -> Array:
    """Return the matrix without the held degrees of freedom."""
    keep = np.setdiff1d(np.arange(len(matrix)), held)
    return np.asarray(matrix[np.ix_(keep, keep)])


def bare_frequencies(elements: int, length: float, diameter: float, young: float, density: float) -> Array:
    """Return the natural frequencies [rad/s] of a uniform shaft on pins at both ends, ascending."""
    from scipy.linalg import eigh

    mass, stiffness = beam(np.full(elements, length / elements), diameter, 0.0, young, density)
    held = [0, 2 * elements]
    return np.asarray(np.sqrt(eigh(pinned(stiffness, held), pinned(mass, held), eigvals_only=True)))
