"""How a shaft turns through a run whose speed changes: angle, speed and angular acceleration at every sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import tau

import numpy as np
from scipy.interpolate import make_lsq_spline

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.recording import Recording, Run
from rotorsim.signals.shaft_angle import TEETH, best_polynomial, pulses_of, run_up_in_words, shaft_angle

MARKS = 4  # in a turn, between which a recorded angle is smoothed for its derivatives
LEAST_PULSES = 9  # for derivatives: fewer do not tell jitter from a change of speed
DEGREE = 5  # of a spline: its acceleration is as smooth as a cubic spline
NO_ANGLE = 'give "tacho": times of a once-per-turn pulse, or a channel of clock.theta'

_Curve = Callable[[np.ndarray, int], np.ndarray]  # of times (n,) [s] and the order of the derivative


@dataclass(frozen=True, eq=False)
class Turning:
    """theta [rad], speed [rad/s], acceleration [rad/s^2] at every sample of a run, (n,); NaN where nothing says."""

    theta: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray


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
    Bayesian information criterion: once per turn the angle is known but for jitter. Its derivatives are the speed and
    the acceleration, of a recorded angle by its passages of every quarter of a turn. Beyond the pulses a polynomial
    holds for one turn, a spline not at all.
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
        curve, _ = _through(time[after - 1] + part * (time[after] - time[after - 1]), marks, 0.0)
        return Turning(angle.theta, sign * curve(time, 1), sign * curve(time, 2))
    pulses, doubt, _ = pulses_of(recording, run)
    turns = tau * np.arange(len(pulses))
    curve, reach = _through(pulses, turns, doubt)
    theta = curve(time, 0)
    beyond = (theta < -reach) | (theta > turns[-1] + reach) | ((time < pulses[0]) & (curve(time, 1) <= 0))
    beyond |= (time < pulses[0]) & (reach == 0) | (time > pulses[-1]) & (reach == 0)
    parts = (np.where(beyond, np.nan, sign * part) for part in (theta, curve(time, 1), curve(time, 2)))
    return Turning(*parts)


def _through(times: np.ndarray, turned: np.ndarray, doubt: float) -> tuple[_Curve, float]:
    """Return the curve through angles (n,) at times (n,) [s], and how far beyond them it holds [rad].

    doubt: standard deviation of the times [s].
    """
    n, centre, half = len(times), (times[-1] + times[0]) / 2, (times[-1] - times[0]) / 2
    u = np.clip((times - centre) / half, -1.0, 1.0)  # rounding
    each = float(np.max(np.diff(turned) / np.diff(times))) * doubt
    least = max((1e-9 * tau) ** 2, TEETH * each**2)
    polynomial = best_polynomial(u, turned, least)

    def criterion(curve: Callable[[np.ndarray], np.ndarray], coefficients: int) -> float:
        variance = max(float(np.mean((turned - curve(u)) ** 2)), least)
        return n * float(np.log(variance)) + coefficients * float(np.log(n))

    best, spline, parts = criterion(polynomial, polynomial.degree() + 1), None, 2
    while parts + DEGREE <= n // 2:
        knots = np.concatenate([np.full(DEGREE, -1.0), np.linspace(-1, 1, parts + 1), np.full(DEGREE, 1.0)])
        try:
            trial = make_lsq_spline(u, turned, knots, DEGREE)
        except ValueError:  # a part without pulses: the speed is near zero there
            break
        if (value := criterion(trial, parts + DEGREE)) < best:
            best, spline = value, trial
        parts *= 2
    if spline is None:
        return lambda t, order: polynomial.deriv(order)((t - centre) / half) / half**order, tau
    return lambda t, order: np.asarray(spline((t - centre) / half, order)) / half**order, 0.0
