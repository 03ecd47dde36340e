"""The shaft angle of a run: from its angle channel, from tacho pulses, or from a steady nominal speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.recording import Recording, Run

__all__ = ["ShaftAngle", "at_equal_angles", "pulse_times", "shaft_angle"]

TURN = 2 * np.pi
MOST_COEFFICIENTS = 8  # of the polynomial through the pulses
WANDERS = 1e-3  # rad left over by it, correlated from pulse to pulse: then every pulse is followed


@dataclass(frozen=True, eq=False)
class ShaftAngle:
    """Shaft angle at every sample of a run: theta (n,) [rad], zero at a pulse.

    speed: mean over the run [rad/s]. drift: change of the speed over the run [rad/s]. jitter: rms of what the
    pulses leave over [rad]. source: "channel", "tacho" or "speed". phase_known: False when nothing says where
    angle zero is.
    """

    theta: np.ndarray
    speed: float
    drift: float
    jitter: float
    source: str
    phase_known: bool
    pulses: int = 0

    @property
    def std(self) -> float:
        """Standard deviation of angle zero [rad]: jitter of the pulses over the root of their number."""
        return self.jitter / np.sqrt(self.pulses) if self.pulses else 0.0


def shaft_angle(recording: Recording, run: Run) -> ShaftAngle:
    """Return the shaft angle of a run: angle channel, else tacho pulses, else nominal speed times time.

    Between and beyond pulses the angle is a polynomial of time, or a cubic spline, whichever leaves the least by
    the Bayesian information criterion: the jitter of pulses is smoothed, a drift of the speed is followed.

    Raises RotorsimError when the run has none of the three, or they make no sense.
    """
    if len(run.time) < 2:
        count = "1 sample" if len(run.time) == 1 else f"{len(run.time)} samples"
        raise RotorsimError(Problem(f"empty run: {count}", _subject(run), run.place), exit_code=1)
    channel = recording.column("clock.theta")
    if channel is not None and channel in run.values:
        return _from_channel(run, run.values[channel], channel)
    pulses = run.tacho
    voltage = recording.column("tacho")
    if pulses is None and voltage is not None and voltage in run.values:
        pulses = pulse_times(run.time, run.values[voltage])
    if pulses is not None and len(pulses) >= 2:
        return _from_pulses(run, np.asarray(pulses, float))
    if run.speed is None:
        hint = 'add "tacho": [times of a once-per-rev pulse], a channel "clock.theta", or at least "speed"'
        what = "no shaft angle: no tacho, no angle channel, no speed"
        raise RotorsimError(Problem(what, _subject(run), run.place, hint))
    origin = float(pulses[0]) if pulses is not None and len(pulses) == 1 else 0.0
    theta = run.speed * (run.time - origin)
    return ShaftAngle(theta, run.speed, 0.0, 0.0, "speed", pulses is not None and len(pulses) == 1)


def _subject(run: Run) -> str:
    return f"run {run.id}"


def _from_channel(run: Run, theta: np.ndarray, column: str) -> ShaftAngle:
    if not np.isfinite(theta).all():
        raise RotorsimError(Problem("not finite", f"{_subject(run)}: column {column}", run.place))
    unwrapped = np.unwrap(theta) if np.ptp(theta) <= TURN * 1.05 else theta
    time = run.time - run.time[0]
    quadratic = np.polynomial.Polynomial.fit(time, unwrapped, 2)
    rate = quadratic.deriv()
    if not abs(unwrapped[-1] - unwrapped[0]) > 0:
        what = "the shaft angle does not change"
        raise RotorsimError(Problem(what, f"{_subject(run)}: column {column}", run.place))
    speed = float((unwrapped[-1] - unwrapped[0]) / (time[-1] - time[0]))
    return ShaftAngle(unwrapped, speed, float(rate(time[-1]) - rate(time[0])), 0.0, "channel", True)


def _from_pulses(run: Run, pulses: np.ndarray) -> ShaftAngle:
    subject = f"{_subject(run)}: tacho"
    if not np.isfinite(pulses).all() or not (np.diff(pulses) > 0).all():
        raise RotorsimError(Problem("the pulse times must be finite and rise", subject, run.place))
    turns = np.arange(len(pulses)) * TURN
    centre, half = (pulses[-1] + pulses[0]) / 2, (pulses[-1] - pulses[0]) / 2
    u = (pulses - centre) / half
    sign = -1.0 if run.speed is not None and run.speed < 0 else 1.0
    best: tuple[float, np.ndarray, float, np.ndarray] | None = None
    inside = (run.time - centre) / half
    for count in range(
        2, min(MOST_COEFFICIENTS, max(2, (len(pulses) + 1) // 2 if len(pulses) < 10 else len(pulses) // 3)) + 1
    ):
        fit = np.polynomial.Chebyshev.fit(u, turns, count - 1, domain=[-1, 1])
        left = turns - fit(u)
        variance = max(float(left @ left) / len(pulses), (1e-9 * TURN) ** 2)
        criterion = len(pulses) * np.log(variance) + count * np.log(len(pulses))
        if best is None or criterion < best[0] - 1e-9:
            freedom = max(len(pulses) - count, 1)
            best = (criterion, fit(inside), float(np.sqrt(left @ left / freedom)), left)
    assert best is not None
    theta, jitter = best[1], best[2]
    left = best[3]
    follows = float(left[1:] @ left[:-1]) > 2 / np.sqrt(len(left)) * float(left @ left)
    if follows and len(left) > 8 and jitter > WANDERS:  # no low polynomial follows the speed: trust every pulse
        theta = CubicSpline(u, turns, bc_type="natural")(inside)
        jitter = float(np.sqrt(np.mean(np.diff(left, 2) ** 2) / 6))
    theta = sign * theta
    span = run.time[-1] - run.time[0]
    rate = np.gradient(theta, run.time) if len(theta) > 2 else np.zeros(len(theta))
    speed = float((theta[-1] - theta[0]) / span)
    return ShaftAngle(theta, speed, float(rate[-1] - rate[0]), jitter, "tacho", True, len(pulses))


def pulse_times(time: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """Return the times (k,) [s] at which a pulse signal rises through half its height, interpolated.

    Raises RotorsimError for a signal without pulses.
    """
    low, high = np.percentile(voltage, (1, 99.9))
    if not high > low:
        low, high = float(np.min(voltage)), float(np.max(voltage))
    if not high > low:
        raise RotorsimError(Problem("the pulse signal is constant", "tacho"))
    middle, guard = (low + high) / 2, 0.1 * (high - low)
    above = voltage > middle
    rising = np.flatnonzero(~above[:-1] & above[1:])
    kept: list[float] = []
    armed = True
    position = 0
    for k in rising:
        if kept and not armed:
            armed = bool((voltage[position : k + 1] < middle - guard).any())
        if armed:
            share = (middle - voltage[k]) / (voltage[k + 1] - voltage[k])
            kept.append(float(time[k] + share * (time[k + 1] - time[k])))
            armed, position = False, int(k)
    return np.array(kept)


def at_equal_angles(angle: ShaftAngle, values: np.ndarray, per_turn: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a signal resampled at equal steps of the shaft angle, over whole turns (order tracking).

    values: (n,) or (n, m). Returns angles (k,) [rad] and values (k,) or (k, m); cubic spline interpolation.
    Raises RotorsimError when the shaft turns less than once or not one way.
    """
    theta = angle.theta if angle.speed > 0 else -angle.theta
    if not (np.diff(theta) > 0).all():
        raise RotorsimError(Problem("the shaft does not turn one way all the time", "shaft angle"))
    step = TURN / per_turn
    first = np.ceil(theta[0] / step - 1e-9)
    turns = np.floor((theta[-1] - first * step) / TURN + 1e-9)
    if turns < 1:
        raise RotorsimError(Problem("less than one turn was recorded", "shaft angle", hint="a longer run"))
    at = np.clip((first + np.arange(int(turns) * per_turn)) * step, theta[0], theta[-1])
    return (at if angle.speed > 0 else -at), np.asarray(CubicSpline(theta, values)(at))
