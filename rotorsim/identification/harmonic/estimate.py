"""The most likely parameters: starts, search within bounds, covariance."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT, Coordinates, coordinates_of
from rotorsim.identification.harmonic.experiment import Experiment
from rotorsim.identification.harmonic.likelihood import Evaluation
from rotorsim.model.heard import BARRED, barred, gives_up, surviving

TURN = 2 * np.pi
STARTS = 12  # values over a turn of an angle that enters in several harmonics
# probability of a larger misfit by noise alone, from which on no other start is followed: one right fit in ten follows
# them for nothing, and what ends 1.3 standard deviations of chi-squared above its minimum does not end there
LEAST_LEVEL = 0.1
COST_TOLERANCE = 1e-10
EQUAL = 1e-6  # relative difference of two solutions that the data cannot separate
AT_BOUND = 1e-6
MOST_EVALUATIONS = 60
SEARCH_METHODS = ("trf", "dogbox")  # the first creeps in curved valleys near a bound: the second goes on from there
PASSES = 3  # of both, where neither has converged
GAIN = 1e-4  # of the misfit, that a pass must gain for another to follow
BOUNDED_STEPS = 8  # right digits double with each, from one to sixteen in four; twice that
FLAT = 1e-9  # of the largest singular value: below, derivatives by differences (4e-11) say nothing of a step
ZERO_DERIVATIVE = 1e-11  # of the largest derivative: rounding
SINGULAR_INFORMATION = (
    1e-13  # smallest eigenvalue of the information, each parameter's own being one: below, it is rounding
)
PART = 0.01  # of a direction that the data say nothing about: who takes part by more is not determined


class Residuals(Protocol):
    """What is minimised: the equations that data and parameters are to satisfy.

    absolute: whether the residual is in units of its standard deviation, so that bounds and priors count.
    """

    experiment: Experiment
    absolute: bool

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Return the residual and its derivatives at theta (m,)."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """The most likely parameters theta (m,) [SI], and what the data say about them.

    information (m, m): J^T J of the whitened equations and priors, in the coordinates q. misfit: |r|^2 of the data;
    freedom: equations less parameters. at_bound (m,): the search ended at a bound there. scatter: the covariance of
    theta (m, m) where it does not follow from the information.
    """

    free: tuple[Free, ...]
    theta: np.ndarray
    coordinates: Coordinates
    evaluation: Evaluation
    information: np.ndarray
    at_bound: np.ndarray
    misfit: float
    freedom: int
    scatter: np.ndarray | None = None

    @property
    def goodness(self) -> float:
        """Probability of a misfit at least so large if the model and the noise are right."""
        return float(chi2.sf(self.misfit, max(self.freedom, 1)))

    @property
    def excess(self) -> float:
        """Variance of the residual over what the noise explains; about 1 for a right model."""
        return self.misfit / max(self.freedom, 1)

    @property
    def adequate(self) -> bool:
        """Whether noise can make the residual."""
        return self.goodness >= CRITERIA.not_explained

    @property
    def widening(self) -> float:
        """The factor on standard deviations where the model does not explain the data."""
        return 1.0 if self.adequate else float(np.sqrt(self.excess))

    @cached_property
    def _in_q(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Covariance of q (m, m), directions that the data say nothing about (m, d), and units (m,).

        Parameters at bounds are left out. Each counts in units of what the data say about it alone, so that none is
        small beside others.
        """
        information = self.information.copy()
        information[self.at_bound], information[:, self.at_bound] = 0.0, 0.0
        size = np.sqrt(np.maximum(np.diag(information), 0.0))
        idle = size <= ZERO_DERIVATIVE * size.max(initial=0.0)
        size = np.where(idle, max(ZERO_DERIVATIVE * size.max(initial=0.0), 1e-100), size)
        values, vectors = np.linalg.eigh(information / np.outer(size, size))
        covariance = (vectors / np.maximum(values, SINGULAR_INFORMATION)) @ vectors.T / np.outer(size, size)
        covariance[self.at_bound], covariance[:, self.at_bound] = 0.0, 0.0
        nothing = np.hstack([vectors[:, values <= SINGULAR_INFORMATION], np.eye(len(size))[:, idle]])
        nothing[self.at_bound] = 0.0
        return covariance, nothing, 1 / size

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of theta (m, m), very large where `undetermined`; zero at bounds."""
        if self.scatter is not None:
            return self.scatter
        J = self.coordinates.jacobian(self.theta)
        return np.asarray(J @ self._in_q[0] @ J.T)

    @cached_property
    def undetermined(self) -> np.ndarray:
        """Which of theta (m,) the data say nothing about, alone or beside the others: their variance is infinite."""
        _, nothing, unit = self._in_q
        J = self.coordinates.jacobian(self.theta) * unit
        return np.asarray((np.abs(J @ nothing) > PART * np.linalg.norm(J, axis=1)[:, None]).any(axis=1))

    def conditional(self, j: int) -> float:
        """Return the standard deviation of parameter j if all others were known."""
        jacobian = np.linalg.inv(self.coordinates.jacobian(self.theta))
        information = float(jacobian[:, j] @ self.information @ jacobian[:, j])
        return 1 / float(np.sqrt(information)) if information > 0 else np.inf

    @property
    def std(self) -> np.ndarray:
        """Standard deviations of theta (m,)."""
        return np.where(self.undetermined, np.inf, np.sqrt(np.maximum(np.diag(self.covariance), 0)))


class Search:
    """The residuals of data and priors in the coordinates of the search, with some parameters held."""

    def __init__(self, likelihood: Residuals) -> None:
        experiment = likelihood.experiment
        self.likelihood, self.free = likelihood, experiment.free
        motion = experiment.motion
        bounded = likelihood.absolute
        self.coordinates = coordinates_of(self.free, motion.equations, motion.p, motion.speeds, bounded=bounded)
        self.prior = [j for j, item in enumerate(self.free) if item.prior_std is not None and bounded]
        start = experiment.theta0
        # the equations are linear in forces, not in stiffness: no step of that is to be trusted from afar
        self.bends = motion.equations.moved_by(motion.p[:1], start)
        self._known: tuple[bytes, tuple[Evaluation, np.ndarray, np.ndarray]] | None = None

    def again(self, likelihood: Residuals) -> Search:
        """Return the search for the same parameters with other data."""
        other = copy(self)
        other.likelihood, other._known = likelihood, None
        return other

    def in_coordinates(self, coordinates: Coordinates) -> Search:
        """Return the search in other coordinates."""
        other = copy(self)
        other.coordinates, other._known = coordinates, None
        return other

    def residual(self, q: np.ndarray) -> np.ndarray:
        """Return whitened residuals of data and priors, (n,)."""
        return self._at(q)[1]

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the derivatives of `residual` by q, (n, m)."""
        return self._at(q)[2]

    def evaluation(self, q: np.ndarray) -> Evaluation:
        """Return the evaluation of the data at q."""
        return self._at(q)[0]

    def _at(self, q: np.ndarray) -> tuple[Evaluation, np.ndarray, np.ndarray]:
        key = q.tobytes()
        if self._known is None or self._known[0] != key:
            theta = self.coordinates.outside(q)
            found = self.likelihood.evaluate(theta)
            residual, jacobian = found.residual, found.jacobian
            if self.prior:
                means = [self.free[j].prior_mean for j in self.prior]
                stds = np.array([self.free[j].prior_std for j in self.prior])
                residual = np.append(residual, (theta[self.prior] - means) / stds)
                rows = np.zeros((len(self.prior), len(theta)))
                rows[np.arange(len(self.prior)), self.prior] = 1 / stds
                jacobian = np.vstack([jacobian, rows])
            self._known = (key, (found, residual, jacobian @ self.coordinates.jacobian(theta)))
        return self._known[1]

    def starts(self) -> list[np.ndarray]:
        """Return where to search from, best first: angles that are not part of a pair are tried all around.

        At each of them the forces take one Gauss-Newton step, which is exact for them.
        """
        start = self.likelihood.experiment.theta0
        paired = {j for pair in self.coordinates.pairs for j in pair}
        angles = [
            j
            for j, item in enumerate(self.free)
            if item.unit == ANGLE_UNIT and j not in paired and item.prior_std is None
        ]
        q0 = self.coordinates.inside(start)
        if not angles:
            return [q0]
        candidates = [q0]
        for j in angles:
            grid = start[j] + np.arange(STARTS) * TURN / STARTS
            ranked = []
            for base in candidates:
                for value in grid:
                    if not self.free[j].low <= value <= self.free[j].high:
                        continue
                    q = base.copy()
                    q[j] = value / self.coordinates.scale[j]
                    ranked.append(self.force_step(q, angles))
            ranked.sort(key=lambda pair: pair[0])
            candidates = [q for _, q in ranked[:3]]
        return candidates

    def force_step(self, q: np.ndarray, held: list[int]) -> tuple[float, np.ndarray]:
        """Return the misfit that linear theory promises after one step of the forces, and where that leads."""
        others = [j for j in range(len(q)) if j not in held and not self.bends[j]]
        if not others:
            r = self.residual(q)
            return float(r @ r), q
        J = self.jacobian(q)[:, others]
        r = self.residual(q)
        if not (np.isfinite(r).all() and np.isfinite(J).all()):
            return np.inf, q
        norm = np.linalg.norm(J, axis=0)
        norm[norm <= ZERO_DERIVATIVE * norm.max(initial=0.0)] = np.inf
        scaled = J / norm
        values, vectors = np.linalg.eigh(scaled.T @ scaled)
        good = values > 1e-9 * values[-1]
        step = -(vectors[:, good] / values[good]) @ (vectors[:, good].T @ (scaled.T @ r)) / norm
        promised = r + J @ step
        moved = q.copy()
        moved[others] += step
        low, high = self.coordinates.bounds
        return float(promised @ promised) * self.preference(moved), np.clip(moved, low, high)

    def promise(self, q: np.ndarray) -> float:
        """Return the misfit that linear theory promises after one step of all parameters."""
        r, J = self.residual(q), self.jacobian(q)
        if not (np.isfinite(r).all() and np.isfinite(J).all()):
            return np.inf
        norm = np.linalg.norm(J, axis=0)
        used = norm > ZERO_DERIVATIVE * norm.max(initial=0.0)
        base, _ = np.linalg.qr(J[:, used] / norm[used])
        left = r - base @ (base.T @ r)
        return float(left @ left)

    def preference(self, q: np.ndarray) -> float:
        """Return 1 for physical values, a little more for others: of two equal solutions the physical one is taken."""
        theta = self.coordinates.outside(q)
        outside = any(not item.low <= value <= item.high for item, value in zip(self.free, theta, strict=True))
        return 1 + EQUAL if outside else 1.0

    def minimise(self, q: np.ndarray, held: tuple[int, ...] = (), *, most: int = MOST_EVALUATIONS) -> np.ndarray:
        """Return q of least residual from a start, within bounds, some entries held, after ``most`` evaluations.

        From MOST_EVALUATIONS on, methods follow one another with as many each, as long as a pass of them gains. Where a
        part whose equations are elsewhere fails at a trial, a shorter step is tried. Raises RotorsimError where it
        fails at the start, or the search would go on beyond where it fails.
        """
        low, high = self.coordinates.bounds
        if not np.isfinite(self.residual(q)).all():
            hint = "start from other values, or leave out the runs nearest to the limit of stability"
            raise RotorsimError(Problem("no settled motion is found at the start", "identify", hint=hint))
        failed: list[RotorsimError] = []
        rows, size = len(self.residual(q)), np.linalg.norm(self.jacobian(q), axis=0)
        idle = size <= ZERO_DERIVATIVE * size.max(initial=0.0)  # nothing depends on it: it stays where it is
        moving = [j for j in range(len(q)) if j not in held and not idle[j]]
        if not moving:
            return q

        def full(part: np.ndarray) -> np.ndarray:
            whole = q.copy()
            whole[moving] = part
            return whole

        def tried(part: np.ndarray) -> np.ndarray:
            try:
                return self.residual(full(part))
            except RotorsimError as error:
                if gives_up(error):
                    raise
                failed.append(error)
                return np.full(rows, np.inf)

        def slopes(part: np.ndarray) -> np.ndarray:
            return self.jacobian(full(part))[:, moving]

        width = np.where(np.isfinite(high - low), high - low, 1.0)
        inside = np.clip(q, low + 1e-9 * width, high - 1e-9 * width)
        part, least = inside[moving], np.inf
        passes = PASSES * SEARCH_METHODS if most >= MOST_EVALUATIONS else SEARCH_METHODS[:1]
        for k, method in enumerate(passes):
            found = least_squares(
                tried,
                part,
                slopes,
                bounds=(low[moving], high[moving]),
                method=method,
                x_scale="jac",
                ftol=COST_TOLERANCE,
                xtol=COST_TOLERANCE,
                gtol=1e-12,
                max_nfev=most,
            )
            part = found.x
            if found.status == 0 and len(passes) > 1:
                part = _bounded_steps(tried, slopes, part, low[moving], high[moving])
            over = (k + 1) % len(SEARCH_METHODS) == 0
            if found.status > 0 or (over and found.cost > (1 - GAIN) * least):
                break
            least = found.cost if over else least
        q = full(part)
        if failed:
            inner = found.active_mask == 0
            r, J = self.residual(q), self.jacobian(q)[:, moving][:, inner]
            step = np.linalg.lstsq(J, -r, rcond=FLAT)[0]
            beyond, before = part.copy(), len(failed)
            beyond[inner] += step
            left = r + J @ step
            tried(np.clip(beyond, low[moving], high[moving]))
            if r @ r - left @ left > BARRED and len(failed) > before:
                raise barred(failed[-1])
        return q


def _bounded_steps(
    residual: Callable[[np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """Return where Gauss-Newton steps lead, each the solution of the linear problem within bounds, while they gain.

    Beside a bound both methods shorten every step to the distance from it.
    """
    r = residual(x)
    for _ in range(BOUNDED_STEPS):
        J = jacobian(x)
        size = np.linalg.norm(J, axis=0)
        if not (np.isfinite(J).all() and size.all()):
            break
        step = lsq_linear(J / size, -r, ((low - x) * size, (high - x) * size), method="bvls").x / size
        there = np.clip(x + step, low, high)
        left = residual(there)
        if not left @ left < (1 - COST_TOLERANCE) * (r @ r):
            break
        x, r = there, left
    return x


def estimate(search: Search, start: np.ndarray | None = None, *, tries: int = 3) -> Estimate:
    """Return the most likely parameters from one start, or from the best few where an angle is unknown."""
    starts = search.starts()[:tries] if start is None else [search.coordinates.inside(start)]
    best: np.ndarray | None = None
    least = np.inf
    for found in surviving(search.minimise, starts):
        cost = float(search.residual(found) @ search.residual(found)) * search.preference(found)
        if cost < least * (1 - 1e-9):
            best, least = found, cost
        if search.likelihood.absolute and is_least(search.evaluation(found)):
            break
    assert best is not None
    return summary(search, best)


def is_least(found: Evaluation) -> bool:
    """Return whether noise alone leaves as much as a minimum does, so that there is hardly a lower one."""
    return float(chi2.sf(found.misfit.sum(), max(found.rows, 1))) > LEAST_LEVEL


def summary(search: Search, q: np.ndarray) -> Estimate:
    """Return the estimate at q: information, bounds, misfit."""
    coordinates, free = search.coordinates, search.free
    theta = coordinates.outside(q, search.likelihood.experiment.theta0)
    for j, item in enumerate(free):
        if item.unit == ANGLE_UNIT and item.low == -np.inf and item.high == np.inf:
            theta[j] = np.angle(np.exp(1j * theta[j]))
    evaluation = search.evaluation(q)
    J = search.jacobian(q)
    at_bound = coordinates.at_bound(q, AT_BOUND)
    freedom = evaluation.rows - len(free)
    return Estimate(free, theta, coordinates, evaluation, J.T @ J, at_bound, float(evaluation.misfit.sum()), freedom)
