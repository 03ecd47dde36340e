"""How a shaft turns through a run whose speed changes: angle, speed and angular acceleration at every sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import tau

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.interpolate import BSpline

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.recording import Recording, Run
from rotorsim.signals.shaft_angle import TEETH, best_polynomial, pulses_of, run_up_in_words, shaft_angle

MARKS = 4  # in a turn, between which a recorded angle is smoothed for its derivatives
LEAST_PULSES = 9  # for derivatives: fewer do not tell jitter from a change of speed
DEGREE = 5  # of a spline: its acceleration is as smooth as a cubic spline
MOST_WEIGHT = 10.0  # of a pulse, of that of the fastest: slower ones tell no more where the curve bends
TURN_ROUNDING = 1e-9  # of a turn: a sample that far beyond a mark is at it
DETERMINED = 1e-6  # of a coefficient of unit size: what pulses tell of it beside the others, at least
NO_ANGLE = 'give "tacho": times of a once-per-turn pulse, or a channel of clock.theta'


@dataclass(frozen=True, eq=False)
class Turning:
    """theta [rad], speed [rad/s], acceleration [rad/s^2] at every sample of a run, (n,); NaN where nothing says.

    curve: through the pulses, of which these are; None where the angle itself was recorded.
    """

    theta: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    curve: Curve | None = None


@dataclass(frozen=True, eq=False)
class Curve:
    """An angle over time, sign sum_k a_k b_k(u), u = (t - centre) / half; by least squares, a (q,).

    basis: u, order of the derivative -> (n, q). root (q, q): R R^T is the covariance of a, as the pulses scatter; the
    bias of the least number of parts that the pulses allow is not in it.
    reach: how far beyond the pulses it holds [rad].
    """

    basis: Callable[[np.ndarray, int], np.ndarray]
    a: np.ndarray
    root: np.ndarray
    centre: float
    half: float
    reach: float
    sign: float = 1.0

    def __call__(self, time: np.ndarray, order: int = 0) -> np.ndarray:
        """Return the angle or a derivative by time at instants, (n,) [rad / s^order]."""
        return np.asarray(self._at(time, order) @ self.a)

    def errors(self, time: np.ndarray, order: int = 0) -> np.ndarray:
        """Return by how much independent errors of one standard deviation change it at instants, (n, q)."""
        return np.asarray(self._at(time, order) @ self.root)

    def _at(self, time: np.ndarray, order: int) -> np.ndarray:
        return self.sign * self.basis((time - self.centre) / self.half, order) / self.half**order


def is_run_up(recording: Recording, run: Run) -> bool:
    """Return whether the speed of a run changes by so much that its orders are not those of one speed.

    False where nothing tells its angle, too.
    """
    try:
        angle = shaft_angle(recording, run)
    except RotorsimError:
        return False
    return angle.phase_known and bool(run_up_in_words(run.time, angle.theta))


def turning(recording: Recording, run: Run) -> Turning:
    """Return how the shaft turns through a run: a recorded angle as it is, else a smooth curve through the pulses.

    The curve is the polynomial, or the quintic spline of 2, 4, 8, ... parts by least squares, that leaves least by the
    Bayesian information criterion: once per turn the angle is known but for jitter, which is of time, so that slow
    pulses weigh more. Its derivatives are the speed and the acceleration, of a recorded angle by its passages of every
    quarter of a turn. Beyond the pulses a polynomial holds for one turn, a spline not at all.
    Raises RotorsimError where nothing tells the angle of the shaft.
    Source: G. Schwarz, Ann. Stat. 6 (1978) 461-464.
    """
    angle = shaft_angle(recording, run)
    if not angle.phase_known:
        what = "its shaft angle was not recorded"
        raise RotorsimError(Problem(what, f"run {run.id}", run.place, NO_ANGLE))
    time, sign = np.asarray(run.time), np.sign(angle.speed) or 1.0
    if angle.source == "channel":
        turned = np.maximum.accumulate(sign * (angle.theta - angle.theta[0]))
        marks = np.arange(np.floor(turned[-1] / tau * MARKS) + 1) * tau / MARKS
        if len(marks) < LEAST_PULSES:
            what = f"its shaft turns by {turned[-1] / tau:.2g} turns only: its speed cannot be told"
            raise RotorsimError(Problem(what, f"run {run.id}", run.place, "record two turns at least"))
        after = np.clip(np.searchsorted(turned, marks), 1, len(turned) - 1)
        step = turned[after] - turned[after - 1]
        part = np.clip((marks - turned[after - 1]) / np.where(step > 0, step, 1.0), 0.0, 1.0)
        curve = _through(time[after - 1] + part * (time[after] - time[after - 1]), marks, 0.0, 1.0)
        return Turning(angle.theta, sign * curve(time, 1), sign * curve(time, 2))
    pulses, doubt, _ = pulses_of(recording, run)
    turns = tau * np.arange(len(pulses))
    curve = _through(pulses, turns, doubt, sign)
    theta, speed, reach = sign * curve(time), sign * curve(time, 1), curve.reach + TURN_ROUNDING * tau
    beyond = (theta < -reach) | (theta > turns[-1] + reach) | ((time < pulses[0]) & (speed <= 0))
    beyond |= ((time < pulses[0]) | (time > pulses[-1])) & (curve.reach == 0)
    theta, speed, acceleration = (np.where(beyond, np.nan, curve(time, order)) for order in range(3))
    return Turning(theta, speed, acceleration, curve)


def _through(times: np.ndarray, turned: np.ndarray, doubt: float, sign: float) -> Curve:
    """Return the curve through angles (n,) at times (n,) [s].

    doubt: standard deviation of the times [s].
    """
    n, centre, half = len(times), float(times[-1] + times[0]) / 2, float(times[-1] - times[0]) / 2
    u = np.clip((times - centre) / half, -1.0, 1.0)  # rounding
    speed = np.gradient(turned, times)
    weight = float(speed.max()) / np.maximum(speed, speed.max() / MOST_WEIGHT)
    least = max((TURN_ROUNDING * tau) ** 2, TEETH * (float(speed.max()) * doubt) ** 2)

    def fitted(basis: Callable[[np.ndarray, int], np.ndarray]) -> tuple[float, Curve]:
        B = basis(u, 0) * weight[:, None]
        norm = np.linalg.norm(B, axis=0)
        if not norm.all():
            raise np.linalg.LinAlgError
        Q, R = np.linalg.qr(B / norm)
        if np.abs(np.diag(R)).min() < DETERMINED:
            raise np.linalg.LinAlgError
        a = np.linalg.solve(R, Q.T @ (turned * weight)) / norm
        square = float(np.sum((turned * weight - B @ a) ** 2))
        std = np.sqrt(max(square / max(n - len(a), 1), least))
        curve = Curve(basis, a, std * np.linalg.inv(R) / norm[:, None], centre, half, 0.0, sign)
        return n * float(np.log(max(square / n, least))) + len(a) * float(np.log(n)), curve

    degree = best_polynomial(u, turned, least).degree()
    best, curve = fitted(partial(_chebyshev, degree))
    curve, parts = replace(curve, reach=tau), 2
    while parts + DEGREE <= n // 2:
        knots = np.concatenate([np.full(DEGREE, -1.0), np.linspace(-1, 1, parts + 1), np.full(DEGREE, 1.0)])
        try:
            value, trial = fitted(partial(_splines, knots))
        except np.linalg.LinAlgError:  # a part without pulses: the speed is near zero there
            break
        if not np.isfinite(value):
            break
        if value < best:
            best, curve = value, trial
        parts *= 2
    return curve


def _chebyshev(degree: int, u: np.ndarray, order: int) -> np.ndarray:
    """Return derivatives of the Chebyshev polynomials up to a degree, (n, degree + 1)."""
    return np.stack([Chebyshev.basis(k).deriv(order)(u) for k in range(degree + 1)], axis=1)


def _splines(knots: np.ndarray, u: np.ndarray, order: int) -> np.ndarray:
    """Return derivatives of the B-splines of some knots, (n, k); what is beyond the knots goes on."""
    count = len(knots) - DEGREE - 1
    return np.asarray(BSpline(knots, np.eye(count), DEGREE)(u, order))
