"""What is suspicious about the signals of a recording, said before anything is fitted to them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations, groupby

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.recordings.recording import ANGLE, TACHO, Channel, Recording, Run
from rotorsim.signals.shaft_angle import pulse_edges, run_up_in_words, shaft_angle
from rotorsim.signals.stretches import clipped, flat
from rotorsim.units import conversion, parse_unit

__all__ = ["check_signals"]

_LARGE, _SMALL = 5e-3, 1e-9  # m, rms of a rotor's displacement
_CURRENT = 1e3  # A
_HUGE, _TINY = 1e50, 1e-50  # in any unit
_GAP = 1.5  # of the usual step
_RATE = 1e-3  # stated against found
_PULSE = 0.3  # of the usual interval
_SPEED = 0.02  # stated against found
_WANDER = 0.01  # over a run
_ALIKE = 1e-3  # two speeds
_SAMPLED = 1e-3  # rad, of 1X
_COVERED = 1.5  # turns at an end of a steady run without a pulse,
_BARE = 0.05  # and of the run
_STEADY = 0.1  # of the usual interval, all intervals of such a run


def check_signals(recording: Recording) -> list[Problem]:
    """Return what is wrong or suspicious, each text beginning with the name of the finding.

    Errors: "empty run", "not finite", "impossible size", "lost samples" (time that does not rise, a stated rate that
    does not fit), "tacho", "two runs alike" (identical data). Warnings: "constant signal", "clipped signal",
    "flat stretch", "lost samples" (gaps), "wrong unit?", "missing channel", "no phase reference", "speed wanders",
    "run-up", "coast-down", "sampled pulses", "two runs alike" (no new equations), "swapped axes?".
    """
    found = list(_missing_channels(recording))
    full = []
    for run in recording.runs:
        if len(run.time) < 2:
            what = f"empty run: {len(run.time)} samples" if len(run.time) != 1 else "empty run: 1 sample"
            found.append(Problem(what, run.id, Place(run.file)))
            continue
        finder = _RunFinder(recording, run)
        finder.find()
        found += finder.found
        if not any(problem.what.startswith("impossible size") for problem in finder.found):
            full.append(run)
    found += _alike(full)
    found += _swapped(recording, full)
    return found


@dataclass
class _Turning:
    """How fast the shaft turned: times (k,) [s] and speeds (k,) [rad/s] between pulses or samples of the angle."""

    times: np.ndarray
    speeds: np.ndarray
    what: str


class _RunFinder:
    def __init__(self, recording: Recording, run: Run) -> None:
        self.recording, self.run = recording, run
        self.found: list[Problem] = []

    def say(
        self, what: str, column: str = "", hint: str = "", *, error: bool = False, place: Place | None = None
    ) -> None:
        subject = f"{self.run.id}: column {column}" if column else self.run.id
        severity = "error" if error else "warning"
        self.found.append(Problem(what, subject, place or Place(self.run.file), hint, severity))

    def find(self) -> None:
        self.time()
        for column, values in self.run.values.items():
            self.column(self.recording.channels[column], values)
        self.tacho()
        self.phase_reference()

    # --- samples ------------------------------------------------------------------------------------

    def time(self) -> None:
        time = self.run.time
        steps = np.diff(time)
        if not np.all(np.isfinite(time)):
            bad = np.flatnonzero(~np.isfinite(time))
            self.say(f"not finite: {len(bad)} values of time, the first is sample {bad[0] + 1}", error=True)
            return
        back = np.flatnonzero(steps <= 0)
        if len(back):
            at = back[0]
            where = f"first from {time[at]:.9g} to {time[at + 1]:.9g} s"
            self.say(
                f"lost samples: time does not rise at {len(back)} sample{'s' * (len(back) > 1)}, {where}",
                hint="samples may be doubled or out of order",
                error=True,
            )
            return
        usual = float(np.median(steps))
        gaps = np.flatnonzero(steps > _GAP * usual)
        if len(gaps) > 0.1 * len(steps):
            self.say(f"lost samples: time is uneven, its steps are {steps.min():.3g} to {steps.max():.3g} s")
            return
        if len(gaps):
            at = gaps[0]
            plural = "s" if len(gaps) > 1 else ""
            self.say(f"lost samples: {len(gaps)} gap{plural} in time, first {steps[at]:.3g} s long at {time[at]:.6g} s")
        rate = float(np.sum(np.round(steps / usual))) / float(time[-1] - time[0])
        stated = self.run.sample_rate
        if stated is not None and abs(rate / stated - 1.0) > _RATE:
            what = f"lost samples: sample_rate says {stated:.9g} Hz, the time column {rate:.9g} Hz"
            self.say(what, hint="remove sample_rate, or correct it", error=True, place=self.run.place)

    def column(self, channel: Channel, values: np.ndarray) -> None:
        column, time = channel.column, self.run.time
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            what = f"not finite: {len(bad)} of {len(values)} samples, first at {time[bad[0]]:.6g} s"
            self.say(what, column, "cut the run before it, or leave it out", error=True)
            return
        largest = float(np.abs(values).max())
        if largest > _HUGE or 0 < largest < _TINY:
            self.say(f"impossible size: the largest value is {largest:.3g} in SI", column, "check the unit", error=True)
            return
        if values.min() == values.max():
            self.say(f"constant signal: all samples are {_shown(values[0], channel)}", column)
            return
        self.size(channel, values)
        if channel.signal in (ANGLE, TACHO) or channel.signal.startswith("reference."):
            return  # saw teeth, pulses and set-points stand still by nature
        cut = clipped(values)
        if cut:
            levels = " and ".join(_shown(level, channel) for level in sorted({float(values[at]) for at, _ in cut}))
            count = sum(last - first for first, last in cut)
            self.say(
                f"clipped signal: {count} samples in {len(cut)} stretches stand at {levels}",
                column,
                "measure with a larger range, or leave the run out",
            )
        stuck = flat(values)
        if stuck:
            first, last = stuck[0]
            more = f" (and {len(stuck) - 1} more)" if len(stuck) > 1 else ""
            what = f"flat stretch: {last - first} equal samples from {time[first]:.6g} s on{more}"
            self.say(what, column, "a converter or a transmission may hang")

    def size(self, channel: Channel, values: np.ndarray) -> None:
        """Find values that only a mix-up of units explains."""
        rms = float(np.sqrt(np.mean(np.square(values))))
        dimension = parse_unit(channel.unit).dimension
        is_rotor = channel.axis is not None or channel.signal.startswith("rotor")
        if dimension == parse_unit("m").dimension and channel.signal.endswith(".displacement") and is_rotor:
            units, likely = "m, mm and um", "more than 5 mm" if rms > _LARGE else "less than 1 nm"
            doubtful = not _SMALL <= rms <= _LARGE
        else:
            units, likely = "A and mA", "more than 1 kA"
            doubtful = dimension == parse_unit("A").dimension and rms > _CURRENT
        if doubtful:
            what = f"wrong unit? rms {rms:.4g} {units[0]} with unit '{channel.unit}' is {likely}"
            rest = ", or the run went unstable" if likely.startswith("more") else ""
            self.say(what, channel.column, f"{units} may be mixed up in recording.json{rest}")

    # --- phase --------------------------------------------------------------------------------------

    def phase_reference(self) -> None:
        channels = self.recording.channels.values()
        turns = any(channel.axis is not None for channel in channels)
        has = any(channel.signal in (ANGLE, TACHO) for channel in channels)
        if turns and not has and self.run.tacho is None and self.run.speed is None:
            hint = 'give "tacho": times of a once-per-turn pulse, a channel of clock.theta, or "speed" (0: at rest)'
            self.say("no phase reference: neither tacho nor angle nor speed", hint=hint, place=self.run.place)

    def tacho(self) -> None:
        sources = [turning for turning in self.turnings() if len(turning.speeds)]
        run = self.run
        stated = abs(run.speed) if run.speed is not None else None
        for turning in sources if stated is not None else ():
            low, high = float(turning.speeds.min()), float(turning.speeds.max())
            assert stated is not None
            if not low * (1 - _SPEED) <= stated <= high * (1 + _SPEED):
                self.contradicts(turning, float(turning.speeds.mean()), "the stated speed is", stated)
        for turning in sources[1:]:
            first, mean = float(sources[0].speeds.mean()), float(turning.speeds.mean())
            if abs(mean / first - 1.0) > _SPEED:
                self.contradicts(turning, mean, f"{sources[0].what} says", first)
        if sources and not any(problem.severity == "error" for problem in self.found):
            self.steadiness(sources[0])

    def contradicts(self, turning: _Turning, mean: float, other: str, speed: float) -> None:
        ratio = mean / speed if speed else 0.0
        by_samples = turning.what == "the angle" or self.run.tacho is None
        hint = "correct the speed or sample_rate in recording.json" if by_samples else ""
        if round(ratio) > 1 and abs(ratio / round(ratio) - 1.0) < _SPEED:
            hint = f"there may be {round(ratio)} pulses in a turn: keep one"
            if by_samples:
                hint = f"sample_rate may be {round(ratio)} times too high"
                hint += f", or there are {round(ratio)} pulses in a turn" * (turning.what != "the angle")
        elif by_samples and ratio > 0 and round(1 / ratio) > 1 and abs(ratio * round(1 / ratio) - 1.0) < _SPEED:
            hint = f"sample_rate may be {round(1 / ratio)} times too low"
        what = f"tacho: {turning.what} says {_rpm(mean)}, {other} {_rpm(speed)}"
        self.say(what, hint=hint, error=True, place=self.run.place)

    def steadiness(self, turning: _Turning) -> None:
        """Find a speed that changes, and pulses that say where angle zero is no better than a sample."""
        run = self.run
        try:
            angle = shaft_angle(self.recording, run)
        except RotorsimError:
            return  # said elsewhere
        said = run_up_in_words(run.time, angle.theta) if np.all(np.diff(run.time) > 0) else ""
        if said:
            hint = "spectrum, identify, diagnose and locate refuse it: they need runs at steady speeds"
            self.say(said, hint=hint, place=run.place)
        elif len(turning.speeds) >= 4:
            span = float(run.time[-1] - run.time[0])
            centred = turning.times - turning.times.mean()
            slope = float(centred @ turning.speeds) / float(centred @ centred)
            rest = turning.speeds - turning.speeds.mean() - slope * centred
            doubt = math.sqrt(float(rest @ rest) / (len(rest) - 2) / float(centred @ centred))
            drift = slope * span / float(turning.speeds.mean())
            if abs(drift) > _WANDER and abs(slope) > 3 * doubt:
                what = (
                    f"speed wanders: by {100 * drift:+.2g} % over the run, around {_rpm(float(turning.speeds.mean()))}"
                )
                self.say(what, hint="fit against the measured angle; fewer turns in a run wander less", place=run.place)
        if angle.alike > _SAMPLED:
            zero = f"shaft angle zero is uncertain by {math.degrees(angle.alike):.2g} deg at {_rpm(abs(angle.speed))}"
            hint = "sample the pulse so fast that its edge shows, or time the edges"
            hint += " and give them as tacho" if run.tacho is None else '; "tacho_resolution": 0 says they were'
            self.say(f"sampled pulses: they lie on samples, so that {zero}", hint=hint, place=run.place)

    def turnings(self) -> Iterator[_Turning]:
        """Yield the speed by each of stated pulses, a pulse signal and the angle, after finding what is wrong there."""
        run = self.run
        rises = bool(np.all(np.isfinite(run.time))) and bool(np.all(np.diff(run.time) > 0))
        if run.tacho is not None:
            found = self.pulses(run.tacho)
            if found is not None:
                yield found
        columns = {channel.signal: c for c, channel in self.recording.channels.items() if c in run.values}
        voltage = run.values.get(columns.get(TACHO, ""))
        if run.tacho is None and voltage is not None and rises and np.all(np.isfinite(voltage)) and np.ptp(voltage) > 0:
            found = self.pulses(pulse_edges(run.time, voltage)[0], "the pulse signal")
            if found is not None:
                yield found
        angle = run.values.get(columns.get(ANGLE, ""))
        if angle is None or not rises or not np.all(np.isfinite(angle)):
            return
        angle = np.unwrap(angle) if np.ptp(angle) <= 1.05 * 2 * math.pi else angle
        turns = abs(angle[-1] - angle[0]) / (2 * math.pi)
        if turns >= 1:
            at = np.linspace(0, len(angle) - 1, min(int(turns), len(angle) - 1, 50) + 1).astype(int)
            speeds = np.abs(np.diff(angle[at])) / np.diff(run.time[at])
            yield _Turning((run.time[at][1:] + run.time[at][:-1]) / 2, speeds, "the angle")

    def pulses(self, pulses: np.ndarray, name: str = "the tacho") -> _Turning | None:
        steps, time = np.diff(pulses), self.run.time
        back = np.flatnonzero(steps <= 0)
        if len(back):
            at = back[0]
            what = f"tacho: pulse {at + 2} at {pulses[at + 1]:.9g} s is not after pulse {at + 1} at {pulses[at]:.9g} s"
            self.say(what, error=True, place=self.run.place)
            return None
        reach = 2 * float(np.median(steps)) if len(steps) else float(time[1] - time[0])
        outside = pulses[(pulses < time[0] - reach) | (pulses > time[-1] + reach)]
        if len(outside):
            what = (
                f"tacho: {len(outside)} of {len(pulses)} pulses are outside the run ({time[0]:g} to {time[-1]:.6g} s)"
            )
            hint = f"the first is at {outside[0]:.6g} s; pulses and samples need one clock"
            self.say(what, hint=hint, error=True, place=self.run.place)
            return None
        odd, usual = _odd(steps)
        if len(odd):
            at = odd[0]
            missing = int(np.sum(steps[odd] > usual[odd]))
            kinds = [f"{missing} missing"] if missing else []
            kinds += [f"{len(odd) - missing} too early"] if missing < len(odd) else []
            first = f"the first after {pulses[at]:.6g} s, by {steps[at]:.4g} s instead of {usual[at]:.4g} s"
            self.say(
                f"tacho: {' and '.join(kinds)}, {first}",
                hint="pulses may be missing or doubled",
                error=True,
                place=self.run.place,
            )
            return None
        if len(steps) >= 3 and np.abs(steps / np.median(steps) - 1).max() < _STEADY:
            step = float(np.median(steps))
            bare = max(pulses[0] - time[0], time[-1] - pulses[-1]) / step
            if bare > max(_COVERED, _BARE * (time[-1] - time[0]) / step):
                what = (
                    f"tacho: pulses from {pulses[0]:.6g} to {pulses[-1]:.6g} s in a run from {time[0]:.6g} to "
                    f"{time[-1]:.6g} s, which lacks {round(bare)} at an end"
                )
                hint = "sample_rate may be wrong; pulses and samples need one clock"
                self.say(what, hint=hint, error=True, place=self.run.place)
                return None
        return _Turning((pulses[1:] + pulses[:-1]) / 2, 2 * math.pi / steps, name)


def _odd(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which intervals between pulses are out of line, and what they should be.

    Each is compared with the median of its neighbours and with the speeds before and after it, carried on in a
    straight line of time: a run-up changes the speed a lot, but smoothly. At a constant angular acceleration the line
    is exact (a mean speed is that at mid-time), from standstill too.
    """
    rates = 1.0 / steps
    n = len(rates)
    if n < 3:
        return np.empty(0, dtype=int), steps
    half = min(3, (n - 1) // 2)
    centres = np.clip(np.arange(n), half, n - 1 - half)
    usual = np.array([np.median(rates[c - half : c + half + 1]) for c in centres])
    guesses = [usual]
    if n >= 4:
        at = np.cumsum(steps) - steps / 2
        slope = np.diff(rates) / np.diff(at)
        guesses.append(np.concatenate((usual[:2], rates[1:-1] + slope[:-1] * (at[2:] - at[1:-1]))))
        guesses.append(np.concatenate((rates[1:-1] + slope[1:] * (at[:-2] - at[1:-1]), usual[-2:])))
    odd = np.all([np.abs(rates - guess) > _PULSE * np.abs(guess) for guess in guesses], axis=0)
    return np.flatnonzero(odd), 1.0 / usual


# --- whole recordings ----------------------------------------------------------------------------------------------


def _missing_channels(recording: Recording) -> Iterator[Problem]:
    there = {(c.signal, c.node, c.position, c.axis) for c in recording.channels.values()}
    for column, channel in recording.channels.items():
        partner = {"x": "y", "y": "x"}.get(channel.axis or "")
        if partner and (channel.signal, channel.node, channel.position, partner) not in there:
            what = f"missing channel: {channel.name} is measured, its {partner} axis is not"
            hint = "forward and backward whirl cannot be told apart with one axis"
            yield Problem(what, f"channel {column}", Place(str(recording.folder)), hint, "warning")


def _alike(runs: list[Run]) -> Iterator[Problem]:
    """Find runs with the same data, and runs to be fitted that repeat another one's conditions."""
    prints = {run.id: _fingerprint(run) for run in runs}
    for one, other in combinations(runs, 2):
        if prints[one.id] == prints[other.id]:
            what = f"two runs alike: the data of {one.id} and {other.id} are identical"
            yield Problem(what, other.id, other.place, f"leave one of {one.file} and {other.file} out")
    repeats = [run for run in runs if run.use == "identify" and run.speed is not None]
    key = lambda run: sorted((name, repr(value)) for name, value in run.settings.items())  # noqa: E731
    for _, group in groupby(sorted(repeats, key=key), key=key):
        for one, other in combinations(list(group), 2):
            same = abs(one.speed - other.speed) <= _ALIKE * max(abs(one.speed), abs(other.speed))  # type: ignore[operator, arg-type]
            if same and prints[one.id] != prints[other.id]:
                what = f"two runs alike: {one.id} and {other.id} have the same speed and set"
                hint = "they average noise, but add no new equations; vary the speed or a gain"
                yield Problem(what, other.id, other.place, hint, "warning")


def _fingerprint(run: Run) -> str:
    digest = hashlib.sha256()
    for column in sorted(run.values):
        digest.update(column.encode("utf-8", "replace") + np.ascontiguousarray(run.values[column]).tobytes())
    return digest.hexdigest()


def _swapped(recording: Recording, runs: list[Run]) -> Iterator[Problem]:
    """Find a pair of axes that is exchanged: a current follows its displacement's axis, not the other one.

    A circular orbit with a quarter turn between displacement and current looks alike, but then one of the two
    crossed correlations is negative where an exchange leaves both with the same sign.
    """
    pairs: dict[tuple[str, int | None, float | None], dict[str, str]] = {}
    for column, channel in recording.channels.items():
        if channel.axis is not None:
            pairs.setdefault((channel.signal, channel.node, channel.position), {})[channel.axis] = column
    both = {where: axes for where, axes in pairs.items() if len(axes) == 2}
    for where, axes in both.items():
        for other, currents in both.items():
            if where[0].endswith(".displacement") and other[0].endswith(".current"):
                votes = [_vote(run.values, axes, currents) for run in runs]
                if votes.count(1) > 0 and votes.count(-1) == 0 and votes.count(1) >= 0.3 * len(votes):
                    what = (
                        f"swapped axes? {axes['x']} follows {currents['y']} and {axes['y']} follows {currents['x']}"
                        f" in {votes.count(1)} of {len(votes)} runs"
                    )
                    hint = f"exchange {axes['x']} and {axes['y']}, or {currents['x']} and {currents['y']}"
                    yield Problem(what, f"column {axes['x']}", Place(str(recording.folder)), hint, "warning")


def _vote(values: Mapping[str, np.ndarray], axes: Mapping[str, str], currents: Mapping[str, str]) -> int:
    """Return 1 if a run speaks for exchanged axes, -1 if against, 0 if it tells nothing."""
    signals = np.array([values[axes["x"]], values[axes["y"]], values[currents["x"]], values[currents["y"]]])
    if not np.all(np.isfinite(signals)) or np.any(np.ptp(signals, axis=1) == 0):
        return 0
    c = np.corrcoef(signals)
    straight, crossed = (c[0, 2], c[1, 3]), (c[0, 3], c[1, 2])
    if min(map(abs, crossed)) > 0.8 and max(map(abs, straight)) < 0.5 and crossed[0] * crossed[1] > 0:
        return 1
    return -1 if min(map(abs, straight)) > 0.7 else 0


def _shown(value: float, channel: Channel) -> str:
    return f"{value / conversion(channel.unit, None):.6g} {channel.unit}"


def _rpm(speed: float) -> str:
    return f"{speed * 30 / math.pi:.5g} rpm"
