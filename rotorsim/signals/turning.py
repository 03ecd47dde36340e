"""How a shaft turns through a run whose speed changes: angle, speed and angular acceleration at every sample."""

from __future__ import annotations

from dataclasses import dataclass
from math import tau

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.recording import Recording, Run
from rotorsim.signals.pulse_curve import PulseCurve, curve_through
from rotorsim.signals.shaft_angle import PHASE, TEETH, pulses_of, run_up_in_words, shaft_angle

MARKS = 4  # in a turn, between which a recorded angle is smoothed for its derivatives
LEAST_PULSES = 9  # for derivatives: fewer do not tell jitter from a change of speed
MOST_WEIGHT = 10.0  # of a pulse, of that of the fastest: slower ones tell no more where the curve bends
TURN_ROUNDING = 1e-9  # of a turn: a sample that far beyond a mark is at it
NO_ANGLE = 'give "tacho": times of a once-per-turn pulse, or a channel of clock.theta'


@dataclass(frozen=True, eq=False)
class Turning:
    """theta [rad], speed [rad/s], acceleration [rad/s^2] at every sample of a run, (n,); NaN where nothing says.

    curve: through the pulses, of which these are; None where the angle itself was recorded.
    """

    theta: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    curve: PulseCurve | None = None


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

    The curve is a smoothing spline (`rotorsim.signals.pulse_curve`): once per turn the angle is known but for jitter,
    which is of time, so that slow pulses weigh more. Its derivatives are the speed and the acceleration, of a recorded
    angle by its passages of every quarter of a turn. Beyond the pulses it holds for one turn at most, as long as it is
    known to a degree.
    Raises RotorsimError where nothing tells the angle of the shaft.
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
    theta, speed, reach = sign * curve(time), sign * curve(time, 1), (1 + TURN_ROUNDING) * tau
    outside = (time < pulses[0]) | (time > pulses[-1])
    beyond = (theta < -reach) | (theta > turns[-1] + reach) | ((time < pulses[0]) & (speed <= 0))
    near = np.flatnonzero(outside & ~beyond)
    beyond[near] = curve.std(time[near]) > PHASE
    theta, speed, acceleration = (np.where(beyond, np.nan, curve(time, order)) for order in range(3))
    return Turning(theta, speed, acceleration, curve)


def _through(times: np.ndarray, turned: np.ndarray, doubt: float, sign: float) -> PulseCurve:
    """Return the curve through angles (n,) at times (n,) [s].

    doubt: standard deviation of the times [s].
    """
    speed = np.gradient(turned, times)
    fastest = float(speed.max())
    least = max((TURN_ROUNDING * tau) ** 2, TEETH * (fastest * doubt) ** 2)
    return curve_through(times, turned, fastest / np.maximum(speed, fastest / MOST_WEIGHT), least, sign)
