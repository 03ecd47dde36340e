"""What is suspicious about the signals of a recording, said before anything is fitted to them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.measure.consistency import alike_runs, missing_channels, swapped_axes
from rotorsim.recordings.recording import ANGLE, TACHO, Channel, Recording, Run
from rotorsim.signals.shaft_angle import pulse_edges, run_up_in_words, shaft_angle
from rotorsim.signals.stretches import clipped_stretches, flat_stretches
from rotorsim.units import conversion, parse_unit

UNUSABLE = ("tacho", "impossible_size", "empty_run")  # errors by which no speed or no size is to be believed
AT_FAULT = ("constant_signal", "clipped_signal", "flat_stretch", "wrong_unit")  # a probe that does not show the motion
_LARGE, _SMALL = 5e-3, 1e-9  # m, rms of a rotor's displacement
_CURRENT = 1e3  # A
_HUGE, _TINY = 1e50, 1e-50  # in any unit
_GAP = 1.5  # of the usual step
_RATE = 1e-3  # stated against found
_PULSE = 0.3  # of the usual interval
_SPEED = 0.02  # stated against found
_WANDER = 0.01  # over a run
_SAMPLED = 1e-3  # rad, of 1X
_COVERED = 1.5  # turns at an end of a steady run without a pulse,
_BARE = 0.05  # and of the run
_STEADY = 0.1  # of the usual interval, all intervals of such a run


def check_signals(recording: Recording) -> list[Problem]:
    """Return what is wrong or suspicious; each text begins with the words of its ``code``.

    Errors: "empty_run", "not_finite" (a warning where nothing turns), "impossible_size", "lost_samples" (time that
    does not rise, a stated rate that does not fit), "tacho", "two_runs_alike" (identical data). Warnings:
    "constant_signal", "clipped_signal", "flat_stretch", "lost_samples" (gaps), "wrong_unit", "missing_channel",
    "no_phase_reference", "speed_wanders", "run_up" (or coast-down), "sampled_pulses", "two_runs_alike" (no new
    equations), "swapped_axes".
    """
    problems = list(missing_channels(recording))
    sound = []
    for run in recording.runs:
        found = _RunCheck(recording, run).problems()
        problems += found
        if not {"empty_run", "impossible_size"} & {problem.code for problem in found}:
            sound.append(run)
    return [*problems, *alike_runs(sound), *swapped_axes(recording, sound)]


@dataclass(frozen=True)
class _Turning:
    """How fast the shaft turned: times (k,) [s] and speeds (k,) [rad/s] between pulses or samples of the angle."""

    times: np.ndarray
    speeds: np.ndarray
    what: str


@dataclass(frozen=True)
class _RunCheck:
    recording: Recording
    run: Run

    def problem(
        self, code: str, what: str, hint: str = "", *, column: str = "", error: bool = False, stated: bool = False
    ) -> Problem:
        """Return what was found; stated: it is wrong in recording.json, not in the data file."""
        subject = f"{self.run.id}: column {column}" if column else self.run.id
        place = self.run.place if stated else Place(self.run.file)
        return Problem(what, subject, place, hint, "error" if error else "warning", code)

    def problems(self) -> list[Problem]:
        count = len(self.run.time)
        if count < 2:
            return [self.problem("empty_run", f"empty run: {count} sample{'s' * (count != 1)}", error=True)]
        found = list(self.time())
        for column, values in self.values.items():
            found += self.column(self.recording.channels[column], values)
        turnings, wrong = self.turnings()
        found += [*wrong, *self.contradictions(turnings)]
        if turnings and not any(problem.severity == "error" for problem in found):
            found += self.steadiness(turnings[0])
        return [*found, *self.phase_reference()]

    @property
    def values(self) -> dict[str, np.ndarray]:
        """The samples of the channels that the recording has."""
        return {column: values for column, values in self.run.values.items() if column in self.recording.channels}

    @property
    def turns(self) -> bool:
        """Whether a shaft turns in this run, whose harmonics need every sample."""
        signals = {channel.signal for channel in self.recording.channels.values()}
        return bool(signals & {ANGLE, TACHO} or self.run.tacho is not None or self.run.speed)

    # --- samples ------------------------------------------------------------------------------------

    def time(self) -> Iterator[Problem]:
        time, code = self.run.time, "lost_samples"
        bad = np.flatnonzero(~np.isfinite(time))
        if len(bad):
            what = f"not finite: {len(bad)} values of time, the first is sample {bad[0] + 1}"
            yield self.problem("not_finite", what, error=True)
            return
        steps = np.diff(time)
        back = np.flatnonzero(steps <= 0)
        if len(back):
            at, plural = back[0], "s" * (len(back) > 1)
            where = f"first from {time[at]:.9g} to {time[at + 1]:.9g} s"
            what = f"lost samples: time does not rise at {len(back)} sample{plural}, {where}"
            yield self.problem(code, what, "samples may be doubled or out of order", error=True)
            return
        usual = float(np.median(steps))
        gaps = np.flatnonzero(steps > _GAP * usual)
        if len(gaps) > 0.1 * len(steps):
            what = f"lost samples: time is uneven, its steps are {steps.min():.3g} to {steps.max():.3g} s"
            yield self.problem(code, what)
            return
        if len(gaps):
            first = f"first {steps[gaps[0]]:.3g} s long at {time[gaps[0]]:.6g} s"
            yield self.problem(code, f"lost samples: {len(gaps)} gap{'s' * (len(gaps) > 1)} in time, {first}")
        rate = float(np.sum(np.round(steps / usual))) / float(time[-1] - time[0])
        stated = self.run.sample_rate
        if stated is not None and abs(rate / stated - 1.0) > _RATE:
            what = f"lost samples: sample_rate says {stated:.9g} Hz, the time column {rate:.9g} Hz"
            yield self.problem(code, what, "remove sample_rate, or correct it", error=True, stated=True)

    def column(self, channel: Channel, values: np.ndarray) -> Iterator[Problem]:
        column, time = channel.column, self.run.time
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            what = f"not finite: {len(bad)} of {len(values)} samples, first at {time[bad[0]]:.6g} s"
            known, error = values[np.isfinite(values)], bool(np.isinf(values).any() or self.turns)
            hint = "cut the run before it, or leave it out" if error else "compared in time, it is left out"
            yield self.problem("not_finite", what, hint, column=column, error=error)
            if error or not len(known):
                return
            values = known
        largest = float(np.abs(values).max())
        if largest > _HUGE or 0 < largest < _TINY:
            what = f"impossible size: the largest value is {largest:.3g} in SI"
            yield self.problem("impossible_size", what, "check the unit", column=column, error=True)
        elif values.min() == values.max():
            what = f"constant signal: all samples are {_shown(values[0], channel)}"
            yield self.problem("constant_signal", what, column=column)
        else:
            yield from self.size(channel, values)
            if not (len(bad) or channel.signal in (ANGLE, TACHO) or channel.signal.startswith("reference.")):
                yield from self.stretches(channel, values)  # others stand still by nature

    def stretches(self, channel: Channel, values: np.ndarray) -> Iterator[Problem]:
        """Find signals that stand still: clipped, or of a converter that hangs."""
        cut, stuck = clipped_stretches(values), flat_stretches(values)
        if cut:
            levels = " and ".join(_shown(level, channel) for level in sorted({float(values[at]) for at, _ in cut}))
            count = sum(last - first for first, last in cut)
            what = f"clipped signal: {count} samples in {len(cut)} stretches stand at {levels}"
            hint = "measure with a larger range, or leave the run out"
            yield self.problem("clipped_signal", what, hint, column=channel.column)
        if stuck:
            (first, last), more = stuck[0], f" (and {len(stuck) - 1} more)" if len(stuck) > 1 else ""
            what = f"flat stretch: {last - first} equal samples from {self.run.time[first]:.6g} s on{more}"
            yield self.problem("flat_stretch", what, "a converter or a transmission may hang", column=channel.column)

    def size(self, channel: Channel, values: np.ndarray) -> Iterator[Problem]:
        """Find values that only a mix-up of units explains."""
        rms = float(np.sqrt(np.mean(np.square(values))))
        dimension = parse_unit(channel.unit).dimension
        is_rotor = channel.axis is not None or channel.signal.startswith("rotor")
        units, likely, rest = "A and mA", "", ", or the run went unstable"
        if dimension == parse_unit("m").dimension and channel.signal.endswith(".displacement") and is_rotor:
            units = "m, mm and um"
            likely = "more than 5 mm" if rms > _LARGE else "less than 1 nm" if rms < _SMALL else ""
        elif dimension == parse_unit("A").dimension and rms > _CURRENT:
            likely = "more than 1 kA"
        if likely:
            what = f"wrong unit? rms {rms:.4g} {units[0]} with unit '{channel.unit}' is {likely}"
            hint = f"{units} may be mixed up in recording.json{rest * (rms > _SMALL)}"
            yield self.problem("wrong_unit", what, hint, column=channel.column)

    # --- phase --------------------------------------------------------------------------------------

    def phase_reference(self) -> Iterator[Problem]:
        channels = self.recording.channels.values()
        turns = any(channel.axis for channel in channels) and not any(c.signal in (ANGLE, TACHO) for c in channels)
        if turns and self.run.tacho is None and self.run.speed is None:
            hint = 'give "tacho": times of a once-per-turn pulse, a channel of clock.theta, or "speed" (0: at rest)'
            what = "no phase reference: neither tacho nor angle nor speed"
            yield self.problem("no_phase_reference", what, hint, stated=True)

    def contradictions(self, turnings: list[_Turning]) -> Iterator[Problem]:
        """Find a speed by pulses or the angle that is not the stated one, nor that of the others."""
        for turning in turnings if self.run.speed is not None else ():
            stated, speeds = abs(self.run.speed or 0.0), turning.speeds
            if not speeds.min() * (1 - _SPEED) <= stated <= speeds.max() * (1 + _SPEED):
                yield self.contradiction(turning, "the stated speed is", stated)
        for turning in turnings[1:]:
            first = float(turnings[0].speeds.mean())
            if abs(float(turning.speeds.mean()) / first - 1.0) > _SPEED:
                yield self.contradiction(turning, f"{turnings[0].what} says", first)

    def contradiction(self, turning: _Turning, other: str, speed: float) -> Problem:
        mean = float(turning.speeds.mean())
        ratio = mean / speed if speed else 0.0
        higher, lower = round(ratio), round(1 / ratio) if ratio > 0 else 0
        by_angle = turning.what == "the angle"
        by_samples = by_angle or self.run.tacho is None
        hint = "correct the speed or sample_rate in recording.json" if by_samples else ""
        if higher > 1 and abs(ratio / higher - 1.0) < _SPEED:
            pulses = f"there {'are' if by_samples else 'may be'} {higher} pulses in a turn"
            hint = f"sample_rate may be {higher} times too high" if by_samples else f"{pulses}: keep one"
            hint += f", or {pulses}" * (by_samples and not by_angle)
        elif by_samples and lower > 1 and abs(ratio * lower - 1.0) < _SPEED:
            hint = f"sample_rate may be {lower} times too low"
        what = f"tacho: {turning.what} says {_rpm(mean)}, {other} {_rpm(speed)}"
        return self.problem("tacho", what, hint, error=True, stated=True)

    def steadiness(self, turning: _Turning) -> Iterator[Problem]:
        """Find a speed that changes, and pulses that say where angle zero is no better than a sample."""
        run = self.run
        try:
            angle = shaft_angle(self.recording, run)
        except RotorsimError:
            return  # said elsewhere
        said = run_up_in_words(run.time, angle.theta) if np.all(np.diff(run.time) > 0) else ""
        if said:
            hint = "identify, diagnose and run compare it in time; spectrum and locate need runs at steady speeds"
            yield self.problem("run_up", said, hint, stated=True)
        elif len(turning.speeds) >= 4:
            mean, centred = float(turning.speeds.mean()), turning.times - turning.times.mean()
            square = float(centred @ centred)
            slope = float(centred @ turning.speeds) / square
            residual = turning.speeds - mean - slope * centred
            doubt = math.sqrt(float(residual @ residual) / (len(residual) - 2) / square)
            drift = slope * float(run.time[-1] - run.time[0]) / mean
            if abs(drift) > _WANDER and abs(slope) > 3 * doubt:
                what = f"speed wanders: by {100 * drift:+.2g} % over the run, around {_rpm(mean)}"
                hint = "fit against the measured angle; fewer turns in a run wander less"
                yield self.problem("speed_wanders", what, hint, stated=True)
        if angle.alike > _SAMPLED:
            zero = f"shaft angle zero is uncertain by {math.degrees(angle.alike):.2g} deg at {_rpm(abs(angle.speed))}"
            hint = "sample the pulse so fast that its edge shows, or time the edges"
            hint += " and give them as tacho" if run.tacho is None else '; "tacho_resolution": 0 says they were'
            what = f"sampled pulses: they lie on samples, so that {zero}"
            yield self.problem("sampled_pulses", what, hint, stated=True)

    def turnings(self) -> tuple[list[_Turning], list[Problem]]:
        """Return the speed by each of stated pulses, a pulse signal and the angle, and what is wrong with pulses."""
        time = self.run.time
        rises = bool(np.all(np.isfinite(time)) and np.all(np.diff(time) > 0))
        signals = {self.recording.channels[c].signal: values for c, values in self.values.items()}
        kinds = [kind for kind in (ANGLE, TACHO) if rises and kind in signals]
        signals = {kind: signals[kind] for kind in kinds if np.all(np.isfinite(signals[kind]))}
        trains = {} if self.run.tacho is None else {"the tacho": self.run.tacho}
        if not trains and TACHO in signals and np.ptp(signals[TACHO]) > 0:
            trains = {"the pulse signal": pulse_edges(time, signals[TACHO])[0]}
        turnings, problems = [], []
        for name, pulses in trains.items():
            wrong = self.wrong_pulses(pulses)
            if wrong is not None:
                problems.append(wrong)
            elif len(pulses) > 1:
                turnings.append(_Turning((pulses[1:] + pulses[:-1]) / 2, 2 * math.pi / np.diff(pulses), name))
        if ANGLE in signals:
            angle = signals[ANGLE]
            angle = np.unwrap(angle) if np.ptp(angle) <= 1.05 * 2 * math.pi else angle
            turns = abs(angle[-1] - angle[0]) / (2 * math.pi)
            if turns >= 1:
                at = np.linspace(0, len(angle) - 1, min(int(turns), len(angle) - 1, 50) + 1).astype(int)
                speeds = np.abs(np.diff(angle[at])) / np.diff(time[at])
                turnings.append(_Turning((time[at][1:] + time[at][:-1]) / 2, speeds, "the angle"))
        return turnings, problems

    def wrong_pulses(self, pulses: np.ndarray) -> Problem | None:
        """Return what is wrong with pulse times (k,) [s], None where they make sense."""
        steps, time = np.diff(pulses), self.run.time
        start, stop = float(time[0]), float(time[-1])
        back = np.flatnonzero(steps <= 0)
        reach = 2 * float(np.median(steps)) if len(steps) else float(time[1] - time[0])
        outside = pulses[(pulses < start - reach) | (pulses > stop + reach)]
        what = hint = ""
        if len(back):
            at = back[0]
            what = f"pulse {at + 2} at {pulses[at + 1]:.9g} s is not after pulse {at + 1} at {pulses[at]:.9g} s"
        elif len(outside):
            what = f"{len(outside)} of {len(pulses)} pulses are outside the run ({start:g} to {stop:.6g} s)"
            hint = f"the first is at {outside[0]:.6g} s; pulses and samples need one clock"
        else:
            odd, usual = _odd(steps)
            step = float(np.median(steps)) if len(steps) else 1.0
            bare = max(pulses[0] - start, stop - pulses[-1]) / step if len(steps) >= 3 else 0.0
            steady = np.abs(steps / step - 1).max(initial=0.0) < _STEADY
            if len(odd):
                at, missing = odd[0], int(np.sum(steps[odd] > usual[odd]))
                kinds = [(missing, "missing"), (len(odd) - missing, "too early")]
                counted = " and ".join(f"{count} {kind}" for count, kind in kinds if count)
                first = f"the first after {pulses[at]:.6g} s, by {steps[at]:.4g} s instead of {usual[at]:.4g} s"
                what, hint = f"{counted}, {first}", "pulses may be missing or doubled"
            elif steady and bare > max(_COVERED, _BARE * (stop - start) / step):
                span = f"from {pulses[0]:.6g} to {pulses[-1]:.6g} s in a run from {start:.6g} to {stop:.6g} s"
                what = f"pulses {span}, which lacks {round(bare)} at an end"
                hint = "sample_rate may be wrong; pulses and samples need one clock"
        return self.problem("tacho", f"tacho: {what}", hint, error=True, stated=True) if what else None


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


def _shown(value: float, channel: Channel) -> str:
    return f"{value / conversion(channel.unit, None) + 0.0:.6g} {channel.unit}"  # zero has no sign


def _rpm(speed: float) -> str:
    return f"{speed * 30 / math.pi:.5g} rpm"
