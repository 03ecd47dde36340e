"""The shaft angle of a run: from its angle channel, from tacho pulses, or from a steady nominal speed."""

from __future__ import annotations

from dataclasses import dataclass
from math import tau

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from scipy.interpolate import CubicSpline

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.recordings.recording import ANGLE, TACHO, Recording, Run

MOST_COEFFICIENTS = 8  # of the polynomial through the pulses
THINNED_SAMPLES = 100_000  # of a run, in which a change of speed is looked for: more are thinned out evenly
SLOPE = np.sqrt(5)  # times jitter / sqrt(N): standard deviation of what N pulses say of a line and a parabola, at most
TEETH = 1.5  # times the variance of a sampled pulse: jitter of a fifth of its period beside it breaks up saw teeth
STATED = 0.01  # of a stated speed: its standard deviation, half of what `open_experiment` lets it be wrong by
MOST_TURNED = 0.1  # rad that harmonics may be off at the ends of a run, to be followed: the tenth by 1, where its
# derivative by the angle is still that of a tangent
CORRELATED = 1e-3  # rad of its residual, correlated from pulse to pulse: then every pulse is followed
UNIFORM = 1 / np.sqrt(12)  # standard deviation of what lies anywhere in an interval of length one
STAMPED = np.sqrt(1 / 6)  # of the middle of that interval against the stated time: it begins there, ends or is about it
ON_GRID = 1e-6  # of a sample period: nearer to a sample than rounding of doubles explains
ACCIDENT = 1e-6  # that pulses which are not sampled all lie there
DIGITS = 9  # behind the point, to which stated times may be rounded: more are no resolution of an instrument
DAMPING = 0.1  # ratio of the mode that a steady run may cross: amplification factor 5, where API 617 asks for margins
PHASE = np.radians(1.0)  # by which a drift of the speed may turn its response
LEAST_DRIFT = 0.01  # of the speed: a drift that is never refused
PLATEAU = 0.1  # of the height of a pulse: nearer to a level than that, a sample may be before or after the edge


@dataclass(frozen=True, eq=False)
class ShaftAngle:
    """Shaft angle at every sample of a run: theta (n,) [rad], zero at a pulse.

    speed: mean over the run [rad/s]. drift: change of the speed over the run [rad/s]. jitter: rms of the residual
    of the pulses [rad]. source: "channel", "tacho" or "speed". phase_known: False when nothing says where
    angle zero is. sampled: standard deviation of an error that sampled pulses of the run have in common [rad]. stamp:
    of the time by which all pulses of a recording are late, wherever in its period a sample is stamped [s]. smooth:
    standard deviation of an error of the speed and of its drift, as an angle at the ends of the run [rad].
    contradicted: the harmonics ask for more than that (`rotorsim.signals.angle_refinement`).
    """

    theta: np.ndarray
    speed: float
    drift: float
    jitter: float
    source: str
    phase_known: bool
    pulses: int = 0
    sampled: float = 0.0
    smooth: float = 0.0
    stamp: float = 0.0
    contradicted: bool = False

    @property
    def std(self) -> float:
        """Standard deviation of angle zero [rad]: jitter over the root of the number of pulses, and what they share."""
        return float(np.hypot(self.jitter / np.sqrt(self.pulses), self.alike)) if self.pulses else 0.0

    @property
    def alike(self) -> float:
        """Standard deviation of what sampled pulses share [rad]."""
        return float(np.hypot(self.sampled, self.speed * self.stamp))


def shaft_angle(recording: Recording, run: Run) -> ShaftAngle:
    """Return the shaft angle of a run: angle channel, else tacho pulses, else nominal speed times time.

    Between and beyond pulses the angle is a polynomial of time, or a cubic spline, whichever leaves the least by
    the Bayesian information criterion: the jitter of pulses is smoothed, a drift of the speed is followed. A sampled
    pulse lies anywhere in its period T: T / sqrt(12), which is averaged as far as the pulses are seen to scatter.

    Raises RotorsimError when the run has none of the three, or they make no sense.
    """
    subject = f"run {run.id}"
    if len(run.time) < 2:
        count = "1 sample" if len(run.time) == 1 else f"{len(run.time)} samples"
        raise RotorsimError(Problem(f"empty run: {count}", subject, run.place), exit_code=1)
    channel = recording.column(ANGLE)
    if channel is not None and channel in run.values:
        return _from_channel(run, run.values[channel], f"{subject}: column {channel}")
    pulses, doubt, stamp = pulses_of(recording, run)
    if len(pulses) >= 2:
        return _from_pulses(run, pulses, doubt, stamp)
    if run.speed is None:
        hint = 'add "tacho": [times of a once-per-rev pulse], a channel "clock.theta", or at least "speed"'
        raise RotorsimError(Problem("no shaft angle: no tacho, no angle channel, no speed", subject, run.place, hint))
    known = len(pulses) == 1
    theta = run.speed * (run.time - (float(pulses[0]) if known else 0.0))
    smooth = min(STATED * float(np.ptp(theta)) / 2, MOST_TURNED)
    return ShaftAngle(theta, run.speed, 0.0, 0.0, "speed", known, int(known), abs(run.speed) * doubt, smooth, stamp)


def pulses_of(recording: Recording, run: Run) -> tuple[np.ndarray, float, float]:
    """Return the pulses of a run (k,) [s], the std of each and of the time by which all are late [s]; none: (0,)."""
    voltage = recording.column(TACHO)
    if run.tacho is not None:
        resolution = pulse_resolution(recording, run)
        return run.tacho, UNIFORM * resolution, STAMPED * resolution
    if voltage is not None and voltage in run.values:
        pulses, doubts = pulse_edges(run.time, run.values[voltage])
        return pulses, float(np.sqrt(np.mean(doubts**2))) if len(doubts) else 0.0, 0.0
    return np.zeros(0), 0.0, 0.0


def pulse_resolution(recording: Recording, run: Run) -> float:
    """Return how finely the stated pulse times of a run are resolved [s]; 0: as finely as numbers are.

    It is what the run says (``tacho_resolution``), else the larger one of the last digit that any time of the
    recording has, and of the sample period where all pulses of all runs lie on samples: one that lies elsewhere
    was not sampled, and those on samples are there since speed and sample rate are whole multiples.
    """
    if run.tacho_resolution is not None:
        return run.tacho_resolution
    if not len(_stated_pulses(run)):
        return 0.0
    runs = [other for other in recording.runs if other is not run and other.tacho_resolution is None]
    pulses = [(other, _stated_pulses(other)) for other in (*runs, run)]
    pulses = [(other, times) for other, times in pulses if len(times)]
    digits = max(_last_digit(times) for _, times in pulses)
    digit = 10.0**-digits if digits <= DIGITS else 0.0
    chances = [_by_chance(other.time, times, digit) for other, times in pulses]
    sampled = max(chances) <= 1 and float(np.prod(chances)) < ACCIDENT
    step = float(np.median(np.diff(run.time)))
    scattered = any(_scatter(times) > digit / 10 for _, times in pulses)
    # times such as 0.04, 0.08, ... need two digits because of the speed: without scatter they are not rounded to 10 ms
    return max(digit if digit <= step or scattered else 0.0, step if sampled else 0.0)


def _stated_pulses(run: Run) -> np.ndarray:
    """Return the stated pulse times of a run, none where they do not say a speed."""
    good = run.tacho is not None and len(run.tacho) >= 2 and len(run.time) >= 2 and bool(np.isfinite(run.tacho).all())
    return run.tacho if good and run.tacho is not None else np.zeros(0)


def _last_digit(times: np.ndarray) -> int:
    """Return how many digits behind the point the times [s] need, at most DIGITS + 1."""
    for digits in range(DIGITS + 1):
        scaled = times * 10.0**digits
        if (np.abs(scaled - np.round(scaled)) <= 1e-15 * np.abs(scaled) + 1e-9).all():
            return digits
    return DIGITS + 1


def _scatter(times: np.ndarray) -> float:
    """Return the standard deviation of pulses [s] about a speed that changes evenly from turn to turn."""
    if len(times) <= 3:
        return 0.0
    turns = np.linspace(-1, 1, len(times))
    return float(np.sqrt(np.mean((times - Polynomial.fit(turns, times, 2)(turns)) ** 2)))


def _by_chance(time: np.ndarray, pulses: np.ndarray, digit: float) -> float:
    """Return the probability that pulses anywhere are as near to samples as these; inf where one is not near.

    digit: of the last digit of the times; coarser than half a sample period it says nothing.
    """
    inside = pulses[(pulses >= time[0]) & (pulses <= time[-1])]
    step = float(np.median(np.diff(time)))
    if not len(inside) or not step > 0:
        return 1.0
    room = ON_GRID * step + 4 * np.finfo(float).eps * float(np.abs(time).max()) + digit / 2 * (digit <= step / 2)
    after = np.clip(np.searchsorted(time, inside), 1, len(time) - 1)
    off = np.minimum(np.abs(time[after] - inside), np.abs(inside - time[after - 1]))
    return np.inf if off.max() > room else float(min(2 * room / step, 1.0) ** min(len(inside), 1000))


def _from_channel(run: Run, theta: np.ndarray, subject: str) -> ShaftAngle:
    if not np.isfinite(theta).all():
        raise RotorsimError(Problem("not finite", subject, run.place))
    theta = np.unwrap(theta) if np.ptp(theta) <= tau * 1.05 else theta
    if theta[-1] == theta[0]:
        raise RotorsimError(Problem("the shaft angle does not change", subject, run.place))
    time = run.time - run.time[0]
    rate = Polynomial.fit(time, theta, 2).deriv()
    speed = float((theta[-1] - theta[0]) / time[-1])
    return ShaftAngle(theta, speed, float(rate(time[-1]) - rate(0.0)), 0.0, "channel", True)


def _from_pulses(run: Run, pulses: np.ndarray, doubt: float, stamp: float) -> ShaftAngle:
    n = len(pulses)
    if not np.isfinite(pulses).all() or not (np.diff(pulses) > 0).all():
        raise RotorsimError(Problem("the pulse times must be finite and rise", f"run {run.id}: tacho", run.place))
    turns = np.arange(n) * tau
    centre, half = (pulses[-1] + pulses[0]) / 2, (pulses[-1] - pulses[0]) / 2
    u, inside = (pulses - centre) / half, (run.time - centre) / half
    each = tau * (n - 1) / (pulses[-1] - pulses[0]) * doubt  # rad: residual of sampling alone
    least = max((1e-9 * tau) ** 2, TEETH * each**2)  # below, pulses share saw teeth: a drift is not told from them
    curve = best_polynomial(u, turns, least)
    residual = turns - curve(u)
    jitter = float(np.sqrt(residual @ residual / max(n - curve.degree() - 1, 1)))
    theta = curve(inside)
    # no low polynomial follows the speed: trust every pulse; the saw teeth of sampled ones are not followed
    if _is_correlated(residual) and n > 8 and jitter > np.hypot(CORRELATED, 2 * each):
        theta = CubicSpline(u, turns, bc_type="natural")(inside)
        jitter = max(float(np.sqrt(np.mean(np.diff(residual, 2) ** 2) / 6)), each)
    if run.speed is not None and run.speed < 0:
        theta = -theta
    rates = np.diff(theta)[[0, -1]] / np.diff(run.time)[[0, -1]]
    speed = float((theta[-1] - theta[0]) / (run.time[-1] - run.time[0]))
    shared = _shared(residual, jitter, each) if doubt else 0.0
    smooth = float(np.hypot(each, SLOPE * jitter / np.sqrt(n)))
    return ShaftAngle(theta, speed, float(rates[1] - rates[0]), jitter, "tacho", True, n, shared, smooth, stamp)


def best_polynomial(u: np.ndarray, turns: np.ndarray, least: float) -> Chebyshev:
    """Return the polynomial of angles (n,) [rad] at u (n,) within [-1, 1] that leaves least by the BIC.

    least: variance of the residual [rad^2] below which nothing is gained.
    """
    n = len(u)
    most = min(MOST_COEFFICIENTS, max(2, (n + 1) // 2 if n < 10 else n // 3))
    curves = [Chebyshev.fit(u, turns, degree, domain=[-1, 1]) for degree in range(1, most)]
    variances = [max(float(np.mean((turns - curve(u)) ** 2)), least) for curve in curves]
    return curves[int(np.argmin([n * np.log(value) + (k + 2) * np.log(n) for k, value in enumerate(variances)]))]


def _is_correlated(residual: np.ndarray) -> bool:
    """Return whether residuals of pulses (n,) are correlated from one to the next: two standard deviations."""
    return float(residual[1:] @ residual[:-1]) > float(2 / np.sqrt(len(residual)) * (residual @ residual))


def _shared(residual: np.ndarray, jitter: float, each: float) -> float:
    """Return what the errors of sampled pulses have in common [rad], beyond what `ShaftAngle.std` makes of jitter.

    residual: (k,) of the pulses. Of the variance of a sampled pulse, each^2, what is not seen as scatter is
    common to all. What is seen is a saw tooth whose teeth, two changes of sign long, average like so many pulses.
    """
    changes = int(np.sum(np.diff(np.sign(residual)) != 0))
    teeth = min(max(2 * changes, 1), len(residual))
    seen = min(jitter, each) ** 2
    return float(np.sqrt(each**2 - seen + seen * (1 / teeth - 1 / len(residual))))


def _speed_change(time: np.ndarray, theta: np.ndarray) -> float:
    """Return the even change of the speed over samples of the shaft angle (n,), as a share of the mean speed."""
    every = -(-len(time) // THINNED_SAMPLES)
    time, theta = time[::every], theta[::every]
    u = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
    _, first, second = np.polynomial.polynomial.polyfit(u, theta - theta[0], 2)
    return float(4 * second / first) if first else 0.0


def steady_limit(turns: float) -> float:
    """Return the change e of the speed up to which a run of N turns is taken as steady.

    The response of a mode of damping ratio z lags behind a drifting speed: by 1 / (z W) in time, at resonance by
    e / (2 pi N z^2) in phase; and averaged over the run it is wrong by (e / z)^2 / 12. Both stay below a degree at
    z = 0.1: e < 0.11 % N and e < 4.6 %. A drift of 1 % is never refused, however short the run.
    """
    lag = tau * turns * DAMPING**2 * PHASE
    return float(max(LEAST_DRIFT, min(lag, DAMPING * np.sqrt(12 * PHASE))))


def refuse_run_up(subject: str, place: Place, time: np.ndarray, theta: np.ndarray) -> None:
    """Raise RotorsimError where the speed changes by more than `steady_limit` over samples of the angle (n,)."""
    said = run_up_in_words(time, theta)
    if said:
        limit = 100 * steady_limit(abs(float(theta[-1] - theta[0])) / tau)
        hint = f"cut out a part in which it changes by less than {limit:.2g} %, or record runs at steady speeds"
        raise RotorsimError(Problem(f"{said}: its orders are not those of one speed", subject, place, hint))


def run_up_in_words(time: np.ndarray, theta: np.ndarray) -> str:
    """Return how the speed changes where it is not steady, empty where it is: ``run-up from 600 to 9600 rpm``."""
    if len(time) < 8 or not (np.isfinite(theta).all() and (np.diff(time) > 0).all()):
        return ""
    change = _speed_change(time, theta)
    if abs(change) <= steady_limit(abs(float(theta[-1] - theta[0])) / tau):
        return ""
    n = max(len(time) // 50, 2)
    first = abs(theta[n - 1] - theta[0]) / (time[n - 1] - time[0]) * 30 / np.pi
    last = abs(theta[-1] - theta[-n]) / (time[-1] - time[-n]) * 30 / np.pi
    return f"{'run-up' if change > 0 else 'coast-down'} from {first:.4g} to {last:.4g} rpm"


def pulse_edges(time: np.ndarray, voltage: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the times (k,) [s] at which a pulse signal rises through half its height, and their std (k,) [s].

    Between two samples on the edge itself the time is interpolated, std 0 (noise is seen as jitter). From one on the
    edge and one on a level, the edge passes half its height between where it does at once and where it does in a
    straight line from sample to sample; between two levels, it does so anywhere: the middle, length / sqrt(12).
    A dip of a pulse to about half its height makes no other pulse. Raises RotorsimError for a signal without pulses.
    """
    low, high = np.percentile(voltage, (1, 99.9))
    if not high > low:
        low, high = float(np.min(voltage)), float(np.max(voltage))
    if not high > low:
        raise RotorsimError(Problem("the pulse signal is constant", "tacho"))
    middle, guard = (low + high) / 2, PLATEAU * (high - low)
    above = voltage > middle
    rising = np.flatnonzero(~above[:-1] & above[1:])
    lows = np.cumsum(voltage < middle - guard)[rising]
    at = rising[np.diff(lows, prepend=-1) > 0]  # the signal was low since the edge before
    before, after, step = voltage[at], voltage[at + 1], time[at + 1] - time[at]
    straight = (middle - before) / (after - before)
    first = np.where(after > high - guard, 0.0, straight)  # shares of a period, earliest and latest
    last = np.where(before < low + guard, 1.0, straight)
    return np.asarray(time[at] + (first + last) / 2 * step), np.asarray(UNIFORM * (last - first) * step)
