"""The shaft angle of a run: from its angle channel, from tacho pulses, or from a steady nominal speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.recordings.recording import Recording, Run

__all__ = [
    "ShaftAngle",
    "at_equal_angles",
    "pulse_edges",
    "pulse_resolution",
    "pulse_times",
    "refuse_run_up",
    "run_up",
    "shaft_angle",
    "speed_change",
    "steady_limit",
]

TURN = 2 * np.pi
MOST_COEFFICIENTS = 8  # of the polynomial through the pulses
MOST_SAMPLES = 100_000  # of a run, in which a change of speed is looked for: more are thinned out evenly
SLOPE = np.sqrt(5)  # times jitter / sqrt(N): standard deviation of what N pulses say of a line and a parabola, at most
TEETH = 1.5  # times the variance of a sampled pulse: jitter of a fifth of its period beside it breaks up saw teeth
STATED = 0.01  # of a stated speed: its standard deviation, half of what `open_experiment` lets it be wrong by
MOST_TURNED = 0.1  # rad that harmonics may be off at the ends of a run, to be followed: the tenth by 1, where its slope
# with the angle is still that of a tangent
WANDERS = 1e-3  # rad left over by it, correlated from pulse to pulse: then every pulse is followed
UNIFORM = 1 / np.sqrt(12)  # standard deviation of what lies anywhere in an interval of length one
STAMPED = np.sqrt(1 / 6)  # of the middle of that interval against the stated time: it begins there, ends or is about it
ON_GRID = 1e-6  # of a sample period: nearer to a sample than rounding of doubles explains
CHANCE = 1e-6  # that pulses which are not sampled all lie there
DIGITS = 9  # behind the point, to which stated times may be rounded: more are no resolution of an instrument
DAMPING = 0.1  # ratio of the mode that a steady run may cross: amplification factor 5, where API 617 asks for margins
PHASE = np.radians(1.0)  # by which a drift of the speed may turn its response
LEAST = 0.01  # of the speed: a drift that is never refused
PLATEAU = 0.1  # of the height of a pulse: nearer to a level than that, a sample may be before or after the edge


@dataclass(frozen=True, eq=False)
class ShaftAngle:
    """Shaft angle at every sample of a run: theta (n,) [rad], zero at a pulse.

    speed: mean over the run [rad/s]. drift: change of the speed over the run [rad/s]. jitter: rms of what the
    pulses leave over [rad]. source: "channel", "tacho" or "speed". phase_known: False when nothing says where
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
    if len(run.time) < 2:
        count = "1 sample" if len(run.time) == 1 else f"{len(run.time)} samples"
        raise RotorsimError(Problem(f"empty run: {count}", _subject(run), run.place), exit_code=1)
    channel = recording.column("clock.theta")
    if channel is not None and channel in run.values:
        return _from_channel(run, run.values[channel], channel)
    pulses = run.tacho
    voltage = recording.column("tacho")
    doubt, stamp = 0.0, 0.0  # s: of each pulse, and of all alike
    if pulses is None and voltage is not None and voltage in run.values:
        pulses, doubts = pulse_edges(run.time, run.values[voltage])
        doubt = float(np.sqrt(np.mean(doubts**2))) if len(doubts) else 0.0
    elif pulses is not None:
        resolution = pulse_resolution(recording, run)
        doubt, stamp = UNIFORM * resolution, STAMPED * resolution
    if pulses is not None and len(pulses) >= 2:
        return _from_pulses(run, np.asarray(pulses, float), doubt, stamp)
    if run.speed is None:
        hint = 'add "tacho": [times of a once-per-rev pulse], a channel "clock.theta", or at least "speed"'
        what = "no shaft angle: no tacho, no angle channel, no speed"
        raise RotorsimError(Problem(what, _subject(run), run.place, hint))
    origin = float(pulses[0]) if pulses is not None and len(pulses) == 1 else 0.0
    theta = run.speed * (run.time - origin)
    known = pulses is not None and len(pulses) == 1
    shared = abs(run.speed) * doubt
    smooth = min(STATED * float(np.ptp(theta)) / 2, MOST_TURNED)
    return ShaftAngle(theta, run.speed, 0.0, 0.0, "speed", known, int(known), shared, smooth, stamp)


def pulse_resolution(recording: Recording, run: Run) -> float:
    """Return how finely the stated pulse times of a run are resolved [s]; 0: as finely as numbers are.

    It is what the run says (``tacho_resolution``), else the larger one of the last digit that any time of the
    recording has, and of the sample period where all pulses of all runs lie on samples: one that lies elsewhere
    was not sampled, and those on samples are there since speed and sample rate are whole multiples.
    """
    if run.tacho_resolution is not None:
        return run.tacho_resolution
    every = (*(other for other in recording.runs if other is not run), run)
    runs = [other for other in every if other.tacho_resolution is None and _has_pulses(other)]
    if not _has_pulses(run):
        return 0.0
    digits = max(_last_digit(np.asarray(other.tacho)) for other in runs)
    digit = 10.0**-digits if digits <= DIGITS else 0.0
    chances = [_by_chance(other, digit) for other in runs]
    sampled = max(chances) <= 1 and float(np.prod(chances)) < CHANCE
    step = float(np.median(np.diff(run.time)))
    scattered = any(_scatter(np.asarray(other.tacho)) > digit / 10 for other in runs)
    # times such as 0.04, 0.08, ... need two digits because of the speed: without scatter they are not rounded to 10 ms
    return max(digit if digit <= step or scattered else 0.0, step if sampled else 0.0)


def _has_pulses(run: Run) -> bool:
    return run.tacho is not None and len(run.tacho) >= 2 and len(run.time) >= 2 and bool(np.isfinite(run.tacho).all())


def _last_digit(times: np.ndarray) -> int:
    """Return how many digits behind the point the times [s] need, at most DIGITS + 1."""
    for digits in range(DIGITS + 1):
        scaled = times * 10.0**digits
        if (np.abs(scaled - np.round(scaled)) <= 1e-15 * np.abs(scaled) + 1e-9).all():
            return digits
    return DIGITS + 1


def _scatter(times: np.ndarray) -> float:
    """Return the standard deviation of pulses [s] about a speed that changes evenly from turn to turn."""
    turns = np.linspace(-1, 1, len(times))
    left = times - np.polynomial.Polynomial.fit(turns, times, 2)(turns) if len(times) > 3 else np.zeros(1)
    return float(np.sqrt(np.mean(left**2)))


def _by_chance(run: Run, digit: float) -> float:
    """Return the probability that pulses anywhere are as near to samples as those of a run; inf where one is not near.

    digit: of the last digit of the times; coarser than half a sample period it says nothing.
    """
    assert run.tacho is not None
    inside = run.tacho[(run.tacho >= run.time[0]) & (run.tacho <= run.time[-1])]
    step = float(np.median(np.diff(run.time)))
    if not len(inside) or not step > 0:
        return 1.0
    room = ON_GRID * step + 4 * np.finfo(float).eps * float(np.abs(run.time).max()) + digit / 2 * (digit <= step / 2)
    after = np.clip(np.searchsorted(run.time, inside), 1, len(run.time) - 1)
    off = np.minimum(np.abs(run.time[after] - inside), np.abs(inside - run.time[after - 1]))
    return np.inf if off.max() > room else float(min(2 * room / step, 1.0) ** min(len(inside), 1000))


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


def _from_pulses(run: Run, pulses: np.ndarray, doubt: float, stamp: float) -> ShaftAngle:
    subject = f"{_subject(run)}: tacho"
    if not np.isfinite(pulses).all() or not (np.diff(pulses) > 0).all():
        raise RotorsimError(Problem("the pulse times must be finite and rise", subject, run.place))
    turns = np.arange(len(pulses)) * TURN
    centre, half = (pulses[-1] + pulses[0]) / 2, (pulses[-1] - pulses[0]) / 2
    u = (pulses - centre) / half
    sign = -1.0 if run.speed is not None and run.speed < 0 else 1.0
    best: tuple[float, np.polynomial.Chebyshev, float, np.ndarray] | None = None
    inside = (run.time - centre) / half
    each = TURN * (len(pulses) - 1) / (pulses[-1] - pulses[0]) * doubt  # rad: what sampling alone leaves over
    least = max((1e-9 * TURN) ** 2, TEETH * each**2)  # below, pulses share saw teeth: a drift is not told from them
    for count in range(
        2, min(MOST_COEFFICIENTS, max(2, (len(pulses) + 1) // 2 if len(pulses) < 10 else len(pulses) // 3)) + 1
    ):
        fit = np.polynomial.Chebyshev.fit(u, turns, count - 1, domain=[-1, 1])
        left = turns - fit(u)
        variance = max(float(left @ left) / len(pulses), least)
        criterion = len(pulses) * np.log(variance) + count * np.log(len(pulses))
        if best is None or criterion < best[0] - 1e-9:
            freedom = max(len(pulses) - count, 1)
            best = (criterion, fit, float(np.sqrt(left @ left / freedom)), left)
    assert best is not None
    _, smoothest, jitter, left = best
    follows = float(left[1:] @ left[:-1]) > 2 / np.sqrt(len(left)) * float(left @ left)
    # no low polynomial follows the speed: trust every pulse; the saw teeth of sampled ones are not followed
    trusted = follows and len(left) > 8 and jitter > np.hypot(WANDERS, 2 * each)
    theta = np.asarray((CubicSpline(u, turns, bc_type="natural") if trusted else smoothest)(inside))
    if trusted:
        jitter = max(float(np.sqrt(np.mean(np.diff(left, 2) ** 2) / 6)), each)
    theta = sign * theta
    span = run.time[-1] - run.time[0]
    first, last = ((theta[k + 1] - theta[k]) / (run.time[k + 1] - run.time[k]) for k in (0, len(theta) - 2))
    speed = float((theta[-1] - theta[0]) / span)
    shared = float(_shared(left, jitter, each)) if doubt else 0.0
    smooth = float(np.hypot(each, SLOPE * jitter / np.sqrt(len(pulses))))
    return ShaftAngle(theta, speed, float(last - first), jitter, "tacho", True, len(pulses), shared, smooth, stamp)


def _shared(left: np.ndarray, jitter: float, each: float) -> float:
    """Return what the errors of sampled pulses have in common [rad], beyond what `ShaftAngle.std` makes of jitter.

    left: (k,) what the pulses leave over. Of the variance of a sampled pulse, each^2, what is not seen as scatter is
    common to all. What is seen is a saw tooth whose teeth, two changes of sign long, average like so many pulses.
    """
    changes = int(np.sum(np.diff(np.sign(left)) != 0))
    teeth = min(max(2 * changes, 1), len(left))
    seen = min(jitter, each) ** 2
    return float(np.sqrt(each**2 - seen + seen * (1 / teeth - 1 / len(left))))


def speed_change(time: np.ndarray, theta: np.ndarray) -> float:
    """Return the even change of the speed over samples of the shaft angle (n,), as a share of the mean speed."""
    every = -(-len(time) // MOST_SAMPLES)
    time, theta = time[::every], theta[::every]
    u = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
    _, first, second = np.polynomial.polynomial.polyfit(u, theta - theta[0], 2)
    return float(4 * second / first) if first else 0.0


def steady_limit(turns: float) -> float:
    """Return the `speed_change` e up to which a run of N turns is taken as steady.

    The response of a mode of damping ratio z lags behind a drifting speed: by 1 / (z W) in time, at resonance by
    e / (2 pi N z^2) in phase; and averaged over the run it is wrong by (e / z)^2 / 12. Both stay below a degree at
    z = 0.1: e < 0.11 % N and e < 4.6 %. A drift of 1 % is never refused, however short the run.
    """
    lag = TURN * turns * DAMPING**2 * PHASE
    return float(max(LEAST, min(lag, DAMPING * np.sqrt(12 * PHASE))))


def refuse_run_up(subject: str, place: Place, time: np.ndarray, theta: np.ndarray) -> None:
    """Raise RotorsimError where the speed changes by more than `steady_limit` over samples of the angle (n,)."""
    said = run_up(time, theta)
    if said:
        limit = 100 * steady_limit(abs(float(theta[-1] - theta[0])) / TURN)
        hint = f"cut out a part in which it changes by less than {limit:.2g} %, or record runs at steady speeds"
        what = f"{said}: its orders are not those of one speed"
        raise RotorsimError(Problem(what, subject, place, hint))


def run_up(time: np.ndarray, theta: np.ndarray) -> str:
    """Return how the speed changes where it is not steady, empty where it is: ``run-up from 600 to 9600 rpm``."""
    if len(time) < 8 or not (np.isfinite(theta).all() and (np.diff(time) > 0).all()):
        return ""
    change = speed_change(time, theta)
    if abs(change) <= steady_limit(abs(float(theta[-1] - theta[0])) / TURN):
        return ""
    n = max(len(time) // 50, 2)
    first = abs(theta[n - 1] - theta[0]) / (time[n - 1] - time[0]) * 30 / np.pi
    last = abs(theta[-1] - theta[-n]) / (time[-1] - time[-n]) * 30 / np.pi
    return f"{'run-up' if change > 0 else 'coast-down'} from {first:.4g} to {last:.4g} rpm"


def pulse_times(time: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """Return the times (k,) [s] at which a pulse signal rises through half its height; see `pulse_edges`."""
    return pulse_edges(time, voltage)[0]


def pulse_edges(time: np.ndarray, voltage: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the times (k,) [s] at which a pulse signal rises through half its height, and their std (k,) [s].

    Between two samples on the edge itself the time is interpolated, std 0 (noise is seen as jitter). From one on the
    edge and one on a level, the edge passes half its height between where it does at once and where it does in a
    straight line from sample to sample; between two levels, it does so anywhere: the middle, length / sqrt(12).
    Raises RotorsimError for a signal without pulses.
    """
    low, high = np.percentile(voltage, (1, 99.9))
    if not high > low:
        low, high = float(np.min(voltage)), float(np.max(voltage))
    if not high > low:
        raise RotorsimError(Problem("the pulse signal is constant", "tacho"))
    middle, guard = (low + high) / 2, PLATEAU * (high - low)
    above = voltage > middle
    rising = np.flatnonzero(~above[:-1] & above[1:])
    kept: list[float] = []
    doubts: list[float] = []
    armed = True
    position = 0
    for k in rising:
        if kept and not armed:
            armed = bool((voltage[position : k + 1] < middle - guard).any())
        if armed:
            step = float(time[k + 1] - time[k])
            first, last = _edge(float(voltage[k]), float(voltage[k + 1]), low, high)
            kept.append(float(time[k] + (first + last) / 2 * step))
            doubts.append(UNIFORM * (last - first) * step)
            armed, position = False, int(k)
    return np.array(kept), np.array(doubts)


def _edge(before: float, after: float, low: float, high: float) -> tuple[float, float]:
    """Return the share of a sample period after which half the height is passed, earliest and latest."""
    middle, near = (low + high) / 2, PLATEAU * (high - low)
    from_level, to_level = before < low + near, after > high - near
    straight = (middle - before) / (after - before)
    return (0.0 if to_level else straight), (1.0 if from_level else straight)


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
