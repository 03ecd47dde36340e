"""A smooth curve through the pulses of a shaft: a smoothing spline, with what it leaves open.

Between pulses nothing is known but that the shaft has inertia: its acceleration wanders, dW'/dt is white. The angle is
then the smoothing spline of penalty lambda int (d^3 theta / dt^3)^2 dt, beside pulses of variance s^2; lambda and s^2
are those of the greatest restricted likelihood, and the covariance of the spline holds its bias, too.
Sources: G. Wahba, J. R. Stat. Soc. B 45 (1983) 133-150; P. Eilers, B. Marx, Stat. Sci. 11 (1996) 89-121.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded, solve_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, diags_array

DEGREE = 5  # of the spline: its acceleration is as smooth as a cubic spline
WANDERING = 3  # derivative that is white: acceleration by time
PULSES_A_KNOT = 2  # a step of the acceleration is followed as closely as pulses show it
MOST_KNOTS = 1000  # the covariance of their coefficients is a matrix
ROUGHEST = 1e-4  # of the penalty that halves the roughest parts: none
SMOOTHEST = 10.0  # times the weights: a parabola is followed to 1e-4 of itself
CONDITION = 1e13  # of what is inverted, at most: of 1000 knots, 7 parts are as smooth as can be
LEAST_SMOOTHED = 5  # pulses: fewer do not tell jitter from a change of speed, and a line is drawn
PRINCIPAL = 0.95  # of the variance of the angle that principal errors make
BLOCK = 1 << 22  # numbers of errors at a time, 32 MB
GAUSS = np.polynomial.legendre.leggauss(4)  # exact for squares of second and third derivatives, of degree 6 and 4


@dataclass(frozen=True, eq=False)
class PulseCurve:
    """An angle over time, sign (trend(u) + sum_k a_k b_k(u)), u = (t - centre) / half; b_k: B-splines, a (q,).

    root (q, d): R R^T is the covariance of a, trend and all, of independent errors of one standard deviation.
    """

    trend: Polynomial
    knots: np.ndarray
    a: np.ndarray
    root: np.ndarray
    centre: float
    half: float
    sign: float = 1.0

    def __call__(self, time: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the angle or a derivative by time at instants, (n,) [rad / s^order]."""
        u = (time - self.centre) / self.half
        trend = self.trend.deriv(order)(u) if order else self.trend(u)
        return np.asarray(self.sign * (trend + BSpline(self.knots, self.a, DEGREE)(u, order)) / self.half**order)

    def errors(self, time: np.ndarray, order: int = 0) -> np.ndarray:
        """Return by how much independent errors of one standard deviation change it at instants, (n, d)."""
        u = (time - self.centre) / self.half
        return np.asarray(self.sign * BSpline(self.knots, self.root, DEGREE)(u, order) / self.half**order)

    def std(self, time: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the angle at instants, (n,) [rad]."""
        each = max(BLOCK // self.root.shape[1], 1)
        parts = [self.errors(time[a : a + each]) for a in range(0, len(time), each)]
        return np.concatenate([np.linalg.norm(part, axis=1) for part in parts]) if parts else np.zeros(0)

    def principal(self, time: np.ndarray) -> PulseCurve:
        """Return the curve with the fewest errors that make ``PRINCIPAL`` of the variance of the angle at instants.

        On average over the instants, each in units of its own.
        """
        own = self.errors(time[:: max(len(time) // (4 * len(self.a)), 1)])
        own /= np.linalg.norm(own, axis=1)[:, None]
        squares, turned = np.linalg.eigh(own.T @ own)
        share = np.cumsum(squares[::-1]) / len(own)
        count = min(int(np.searchsorted(share, PRINCIPAL)) + 1, len(squares))
        return replace(self, root=self.root @ turned[:, ::-1][:, :count])


def curve_through(
    times: np.ndarray, turned: np.ndarray, weight: np.ndarray, least: float, sign: float = 1.0
) -> PulseCurve:
    """Return the curve through angles (n,) [rad] at times (n,) [s], good for the time of one pulse beyond them.

    weight (n,): of residuals. least: variance of a weighted angle, at least [rad^2].
    """
    n, half, centre = len(times), float(times[-1] - times[0]) / 2, float(times[-1] + times[0]) / 2
    u, order = (times - centre) / half, WANDERING if len(times) >= LEAST_SMOOTHED else 2
    trend = Polynomial.fit(u, turned, order - 1, domain=(-1, 1), w=weight)
    knots, y = _knots(u), (turned - trend(u)) * weight
    B, G = diags_array(weight) @ _basis(u, knots), _roughness(knots, order)
    A, S, b = _bands(B), _bands(G), B.T @ y
    k, freedom = A.shape[1], max(n - order, 1)

    def fitted(log: float) -> tuple[float, float, np.ndarray, np.ndarray]:
        """Return -2 times the logarithm of the restricted likelihood, s^2, the coefficients and what is inverted."""
        U = cholesky_banded(A + np.exp(log) * S)
        a = cho_solve_banded((U, False), b)
        left = float(np.sum((y - B @ a) ** 2) + np.exp(log) * np.sum((G @ a) ** 2))
        variance = max(left / freedom, least)
        inverted = 2 * float(np.log(U[-1]).sum()) - (k - order) * log
        return freedom * float(np.log(variance)) + left / variance + inverted, variance, a, U

    halved = float(A[-1].sum() / S[-1].sum())
    low, high = np.log(halved * ROUGHEST), np.log(min(halved * CONDITION, SMOOTHEST * float(A[-1].sum())))
    best = high
    if n >= LEAST_SMOOTHED and high > low:
        grid = np.linspace(low, high, int(high - low) + 2)
        at = int(np.argmin([fitted(log)[0] for log in grid]))
        ends = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
        best = float(minimize_scalar(lambda log: fitted(log)[0], bounds=ends, method="bounded").x)
    _, variance, a, U = fitted(best)
    root = np.sqrt(variance) * solve_banded((0, len(U) - 1), U, np.eye(k))
    return PulseCurve(trend, knots, a, root, centre, half, sign)


def _knots(u: np.ndarray) -> np.ndarray:
    """Return knots at every second pulse, or so, and a pulse beyond either end."""
    n = len(u)
    count = min((n - 1) // PULSES_A_KNOT, MOST_KNOTS)
    inner = u[np.linspace(0, n - 1, count + 1).astype(int)[1:-1]]
    ends = np.full(DEGREE + 1, 2 * u[0] - u[1]), np.full(DEGREE + 1, 2 * u[-1] - u[-2])
    return np.concatenate([ends[0], inner, ends[1]])


def _basis(u: np.ndarray, knots: np.ndarray, degree: int = DEGREE) -> csr_array:
    """Return the B-splines of some knots, (n, q), zero beyond them."""
    return csr_array(BSpline.design_matrix(np.clip(u, knots[0], knots[-1]), knots, degree))


def _roughness(knots: np.ndarray, order: int) -> csr_array:
    """Return G (p, q) with |G a|^2 = int (d^m / du^m sum_k a_k b_k)^2 du, m = order."""
    D = csr_array(diags_array(np.ones(len(knots) - DEGREE - 1)))
    inner = knots
    for degree in range(DEGREE, DEGREE - order, -1):
        inner = inner[1:-1]
        step = degree / (inner[degree:] - inner[:-degree])
        D = diags_array(step) @ (D[1:] - D[:-1])
    ends = np.unique(knots)
    width = np.diff(ends)[:, None] / 2
    points, weights = ends[:-1, None] + width * (1 + GAUSS[0]), width * GAUSS[1]
    return csr_array(diags_array(np.sqrt(weights.ravel())) @ _basis(points.ravel(), inner, DEGREE - order) @ D)


def _bands(M: csr_array) -> np.ndarray:
    """Return M^T M as its upper bands, the diagonal last, (DEGREE + 1, q)."""
    square = M.T @ M
    bands = np.zeros((DEGREE + 1, square.shape[0]))
    for k in range(DEGREE + 1):
        bands[DEGREE - k, k:] = square.diagonal(k)
    return bands
