"""A smooth curve through the pulses of a shaft: a smoothing spline, with what it leaves open.

Between pulses nothing is known but that the shaft has inertia: its acceleration wanders, dW'/dt is white. The angle is
then the smoothing spline of penalty lambda int (d^3 theta / dt^3)^2 dt, beside pulses of variance s^2; lambda and s^2
are those of the greatest restricted likelihood, and the covariance of the spline holds its bias, too. A drive that ends
a ramp changes its acceleration at once: where a jump shows (Wald test), the spline is free to have one.
Sources: G. Wahba, J. R. Stat. Soc. B 45 (1983) 133-150; P. Eilers, B. Marx, Stat. Sci. 11 (1996) 89-121.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded, solve_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, diags_array
from scipy.stats import chi2

DEGREE = 5  # of the spline: its acceleration is as smooth as a cubic spline
WANDERING = 3  # derivative that is white: acceleration by time
PULSES_A_KNOT = 2  # a step of the acceleration is followed as closely as pulses show it
MOST_KNOTS = 1000  # the covariance of their coefficients is a matrix
ROUGHEST = 1e-4  # of the penalty that halves the roughest parts: none
SMOOTHEST = 10.0  # times the weights: a parabola is followed to 1e-4 of itself
MOST_CONDITION = 1e13  # of what is inverted, at most: of 1000 knots, 7 parts are as smooth as can be
LEAST_SMOOTHED = 5  # pulses: fewer do not tell jitter from a change of speed, and a line is drawn
PRINCIPAL = 0.95  # of the variance of the angle that principal errors make
ERROR_NUMBERS = 1 << 22  # numbers of errors at a time, 32 MB
MOST_JUMPS = 6  # of the acceleration
JUMP_PULSES, JUMP_KNOTS = 8, 4  # between two jumps, and from a jump to an end, at least
JUMP_LEVEL = 1e-3  # of the test of a jump, for all places together
ABOUT_JUMP = 16  # pulses before and after the roughest place, among which a jump is sought
JUMP_SWEEPS = 5  # of all jumps, each in turn, while the likelihood rises
MOST_PLACES = 12  # at which a jump is tried, between pulses and at them
GAUSS = np.polynomial.legendre.leggauss(4)  # exact for squares of second and third derivatives, of degree 6 and 4


@dataclass(frozen=True, eq=False)
class PulseCurve:
    """An angle over time, sign (trend(u) + sum_k a_k b_k(u)), u = (t - centre) / half; b_k: B-splines, a (q,).

    root (q, d): R R^T is the covariance of a, trend and all, of independent errors of one standard deviation. spline:
    of which it is made, by which it is made anew with jumps elsewhere.
    """

    trend: Polynomial
    knots: np.ndarray
    a: np.ndarray
    root: np.ndarray
    centre: float
    half: float
    sign: float
    spline: _Spline

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
        each = max(ERROR_NUMBERS // self.root.shape[1], 1)
        parts = [self.errors(time[a : a + each]) for a in range(0, len(time), each)]
        return np.concatenate([np.linalg.norm(part, axis=1) for part in parts]) if parts else np.zeros(0)

    def principal(self, time: np.ndarray) -> PulseCurve:
        """Return the curve with the fewest errors that make ``PRINCIPAL`` of the variance of the angle at any instant.

        Of an average those about a jump of the acceleration are no part.
        """
        own = self.errors(time[:: max(len(time) // (4 * len(self.a)), 1)])
        own /= np.linalg.norm(own, axis=1)[:, None]
        squares, turned = np.linalg.eigh(own.T @ own)
        share = np.cumsum((own @ turned[:, ::-1]) ** 2, axis=1).min(axis=0)
        count = min(int(np.searchsorted(share, PRINCIPAL)) + 1, len(squares))
        return replace(self, root=self.root @ turned[:, ::-1][:, :count])

    def with_corners(self, errors: np.ndarray) -> PulseCurve | None:
        """Return it with jumps where the speed would not jump, with errors (q,) of the coefficients; None without any.

        Left and right of a jump of W by w and of W' by b are straight: they meet w / b before it.
        """
        jumps = np.array(self.spline.jumps)
        if not len(jumps):
            return None
        sides = np.nextafter(jumps, np.array([[-2.0], [2.0]]))
        w, b = (np.diff(BSpline(self.knots, self.a + errors, DEGREE)(sides, k), axis=0)[0] for k in (1, 2))
        return self.spline.moved(-w / b).curve(self.trend, self.centre, self.half, self.sign)


def curve_through(
    times: np.ndarray, turned: np.ndarray, weight: np.ndarray, least: float, sign: float = 1.0
) -> PulseCurve:
    """Return the curve through angles (n,) [rad] at times (n,) [s], good for the time of one pulse beyond them.

    weight (n,): of residuals. least: variance of a weighted angle, at least [rad^2].
    """
    half, centre = float(times[-1] - times[0]) / 2, float(times[-1] + times[0]) / 2
    u, order = (times - centre) / half, WANDERING if len(times) >= LEAST_SMOOTHED else 2
    trend = Polynomial.fit(u, turned, order - 1, domain=(-1, 1), w=weight)
    spline = _Spline(u, (turned - trend(u)) * weight, weight, order, least).with_jumps()
    return spline.curve(trend, centre, half, sign)


@dataclass(frozen=True, eq=False)
class _Spline:
    """The smoothing spline of the greatest restricted likelihood through weighted angles y (n,) at u (n,), -1 to 1.

    order: of the derivative that is penalised. jumps: where that below it, and the speed, may jump: the speed, too,
    since the place is known to some pulses only, and one that is off by d leaves d times the jump in it.
    """

    u: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    order: int
    least: float
    jumps: tuple[float, ...] = ()

    @property
    def _each(self) -> float:
        """How many pulses there are to a knot."""
        n = len(self.u)
        return (n - 1) / max(min((n - 1) // PULSES_A_KNOT, MOST_KNOTS), 1)

    @cached_property
    def knots(self) -> np.ndarray:
        """Knots at every second pulse, or so, and a pulse beyond either end; DEGREE where the speed may jump."""
        u, n = self.u, len(self.u)
        at = np.linspace(0, n - 1, round((n - 1) / self._each) + 1).astype(int)[1:-1]
        for jump in self.jumps:
            at = at[np.abs(at - np.searchsorted(u, jump)) > self._each / 2]
        inner = np.sort(np.concatenate([u[at], np.repeat(self.jumps, DEGREE)]))
        ends = np.full(DEGREE + 1, 2 * u[0] - u[1]), np.full(DEGREE + 1, 2 * u[-1] - u[-2])
        return np.concatenate([ends[0], inner, ends[1]])

    @cached_property
    def _equations(self) -> tuple[csr_array, csr_array, np.ndarray, np.ndarray, np.ndarray]:
        B, G = diags_array(self.weight) @ _basis(self.u, self.knots), _roughness(self.knots, self.order)
        return B, G, _bands(B), _bands(G), B.T @ self.y

    def _fitted(self, log: float) -> tuple[float, float, np.ndarray, np.ndarray]:
        """Return -2 times the logarithm of the restricted likelihood, s^2, the coefficients and what is inverted."""
        B, G, A, S, b = self._equations
        smooth = self.order + 2 * len(self.jumps)  # functions that are not penalised
        freedom = max(len(self.u) - smooth, 1)
        U = cholesky_banded(A + np.exp(log) * S)
        a = cho_solve_banded((U, False), b)
        left = float(np.sum((self.y - B @ a) ** 2) + np.exp(log) * np.sum((G @ a) ** 2))
        variance = max(left / freedom, self.least)
        inverted = 2 * float(np.log(U[-1]).sum()) - (A.shape[1] - smooth) * log
        return freedom * float(np.log(variance)) + left / variance + inverted, variance, a, U

    @cached_property
    def _limits(self) -> tuple[float, float]:
        _, _, A, S, _ = self._equations
        halved = float(A[-1].sum() / S[-1].sum())
        return np.log(halved * ROUGHEST), np.log(min(halved * MOST_CONDITION, SMOOTHEST * float(A[-1].sum())))

    @cached_property
    def _best(self) -> float:
        """The logarithm of lambda."""
        low, high = self._limits
        if len(self.u) < LEAST_SMOOTHED or high <= low:
            return high
        grid = np.linspace(low, high, int(high - low) + 2)
        at = int(np.argmin([self._fitted(log)[0] for log in grid]))
        ends = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
        return float(minimize_scalar(lambda log: self._fitted(log)[0], bounds=ends, method="bounded").x)

    @property
    def a(self) -> np.ndarray:
        """The coefficients, (q,)."""
        return self._fitted(self._best)[2]

    @cached_property
    def root(self) -> np.ndarray:
        """R (q, q), R R^T the covariance of the coefficients."""
        _, variance, a, U = self._fitted(self._best)
        return np.asarray(np.sqrt(variance) * solve_banded((0, len(U) - 1), U, np.eye(len(a))))

    def with_jumps(self) -> _Spline:
        """Return it with as many jumps as show: one alone may hide beside the next."""
        found, more = self, self if len(self.u) >= LEAST_SMOOTHED else None
        while more is not None and more._rough and len(more.jumps) < MOST_JUMPS:
            more = more._with_one_more()
            found = more if more is not None and more._shown else found
        for _ in range(JUMP_SWEEPS if len(found.jumps) > 1 else 0):
            before = found.cost
            for k, place in enumerate(found.jumps):
                others = found.jumps[:k] + found.jumps[k + 1 :]
                found = found._jumping(others, int(np.searchsorted(self.u, place)), JUMP_PULSES)
            if found.cost > before - 1:
                break
        return found

    def curve(self, trend: Polynomial, centre: float, half: float, sign: float) -> PulseCurve:
        """Return the angle over time of which it is what differs from a trend."""
        return PulseCurve(trend, self.knots, self.a, self.root, centre, half, sign, self)

    def moved(self, by: np.ndarray) -> _Spline:
        """Return it with its jumps elsewhere, within JUMP_PULSES pulses of where they are and away from the others."""
        jumps = list(self.jumps)
        for k, far in enumerate(by):
            at = int(np.searchsorted(self.u, jumps[k]))
            apart = self._apart(jumps[:k] + jumps[k + 1 :])
            place = float(
                np.clip(jumps[k] + far, *self.u[np.clip([at - JUMP_PULSES, at + JUMP_PULSES], 0, len(self.u) - 1)])
            )
            jumps[k] = place if apart[min(int(np.searchsorted(self.u, place)), len(apart) - 1)] else jumps[k]
        return replace(self, jumps=tuple(sorted(jumps)))

    @property
    def _rough(self) -> bool:
        """Whether it is not as smooth as can be."""
        return self._best < self._limits[1] - 1

    def _with_one_more(self) -> _Spline | None:
        """Return it with one more jump, about where it is roughest; None without a place."""
        apart = self._apart(self.jumps)
        if not apart.any():
            return None
        roughness = np.abs(BSpline(self.knots, self.a, DEGREE)(self.u, self.order))
        return self._jumping(self.jumps, int(np.argmax(np.where(apart, roughness, -1.0))), ABOUT_JUMP)

    def _apart(self, jumps: Sequence[float]) -> np.ndarray:
        """Return which pulses are far enough from both ends and from jumps, (n,)."""
        apart = np.ones(len(self.u), bool)
        for place in (self.u[0], self.u[-1], *jumps):
            at, reach = int(np.searchsorted(self.u, place)), max(JUMP_PULSES, int(JUMP_KNOTS * self._each))
            apart[max(at - reach, 0) : at + reach] = False
        return apart

    def _jumping(self, others: tuple[float, ...], middle: int, reach: int) -> _Spline:
        """Return it with a jump within so many pulses of one, where it is likeliest, beside others."""

        def at(place: float) -> _Spline:
            return replace(self, jumps=tuple(sorted((*others, float(place)))))

        apart = np.flatnonzero(self._apart(others))
        places = apart[np.abs(apart - middle) <= reach]
        if not len(places):
            places = apart[[np.argmin(np.abs(apart - middle))]]
        places = places[:: 1 + (len(places) > MOST_PLACES)]
        best = int(places[np.argmin([at(self.u[k]).cost for k in places])])
        found = minimize_scalar(
            lambda place: at(place).cost,
            bounds=(self.u[best - 2], self.u[best + 2]),
            method="bounded",
            options={"maxiter": MOST_PLACES},
        )
        return at(float(found.x))

    @property
    def cost(self) -> float:
        """-2 times the logarithm of the restricted likelihood."""
        return self._fitted(self._best)[0]

    @property
    def _shown(self) -> bool:
        """Whether the derivative below that penalised jumps wherever it may, by more than chance at any place."""
        sides = np.nextafter(self.jumps, np.array([[-2.0], [2.0]]))
        size, root = (
            np.diff(BSpline(self.knots, c, DEGREE)(sides, self.order - 1), axis=0)[0] for c in (self.a, self.root)
        )
        least = chi2.isf(JUMP_LEVEL / len(self.u), 1)
        return bool(((size / np.linalg.norm(root, axis=1)) ** 2 > least).all())


def _basis(u: np.ndarray, knots: np.ndarray, degree: int = DEGREE) -> csr_array:
    """Return the B-splines of some knots, (n, q), zero beyond them."""
    return csr_array(BSpline.design_matrix(np.clip(u, knots[0], knots[-1]), knots, degree))


def _roughness(knots: np.ndarray, order: int) -> csr_array:
    """Return G (p, q) with |G a|^2 = int (d^m / du^m sum_k a_k b_k)^2 du, m = order."""
    D = csr_array(diags_array(np.ones(len(knots) - DEGREE - 1)))
    inner = knots
    for degree in range(DEGREE, DEGREE - order, -1):
        inner = inner[1:-1]
        width = inner[degree:] - inner[:-degree]
        step = np.where(width > 0, degree / np.where(width > 0, width, 1.0), 0.0)  # a jump is no roughness
        D = diags_array(step) @ (D[1:] - D[:-1])
    ends = np.unique(knots)
    halves = np.diff(ends)[:, None] / 2
    points, weights = ends[:-1, None] + halves * (1 + GAUSS[0]), halves * GAUSS[1]
    return csr_array(diags_array(np.sqrt(weights.ravel())) @ _basis(points.ravel(), inner, DEGREE - order) @ D)


def _bands(M: csr_array) -> np.ndarray:
    """Return M^T M as its upper bands, the diagonal last, (DEGREE + 1, q)."""
    square = M.T @ M
    bands = np.zeros((DEGREE + 1, square.shape[0]))
    for k in range(DEGREE + 1):
        bands[DEGREE - k, k:] = square.diagonal(k)
    return bands
