"""Spectra of one run of a loop with its test signals, without what these do not make: orders of the shaft, hum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.ndimage import uniform_filter1d

from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.control.margins import LARGEST_FREQUENCY
from rotorsim.recordings.injection import AFTER, BEFORE, TEST, InjectionRecording
from rotorsim.recordings.recording import ANGLE, Run
from rotorsim.signals.injection.local_polynomial import SMOOTHED, Spectra
from rotorsim.signals.injection.steady_lines import SteadyLine, without_lines, without_shapes
from rotorsim.signals.shaft_angle import ShaftAngle, pulses_of, refuse_run_up, shaft_angle

INJECTED = 0.1  # of the rms of the largest test signal of a run: an axis with less is not injected at
SILENT = 0.001  # of it: an axis with less has no test signal at all, and what it has cannot disturb the others
DEPENDENT = 0.95  # mean coherence of two test signals, above which their responses are not told apart
WELL_BELOW = 0.9  # of half of the sample rate: above, filters of converters are not alike
MOST_ORDERS_OUT = 20  # of the shaft, that are taken out by its angle
EVEN = 1e-3  # of a sample period
LEAST_RECORD = 1000  # samples


@dataclass(frozen=True, eq=False)
class RunSpectra:
    """Spectra of a run: inputs are its test signals, those of axes that are injected at first, outputs V1, then V2.

    outputs: axis, AFTER or BEFORE -> column. rest (K,): lines of the spectrum where steady motion is left. speed
    [rad/s]. highest: frequency [Hz] up to which they are meant.
    """

    run: Run
    speed: float | None
    axes: tuple[str, ...]
    outputs: Mapping[tuple[str, str], int]
    spectra: Spectra
    highest: float
    lines: tuple[SteadyLine, ...]
    rest: np.ndarray


def run_spectra(recording: InjectionRecording, run: Run) -> RunSpectra:
    """Return the spectra of a run without steady lines. Raises RotorsimError for one that tells nothing."""
    subject, time = f"run {run.id}", run.time
    n = len(time)
    if n < LEAST_RECORD:
        raise RotorsimError(Problem(f"{n} samples, {LEAST_RECORD} are needed", subject, run.place))
    period = float(time[-1] - time[0]) / (n - 1)
    if not period > 0 or np.abs(np.diff(time) / period - 1).max() > max(EVEN, 1e-9 * np.abs(time).max() / period):
        hint = "dropped samples? a constant rate is needed"
        raise RotorsimError(Problem("its samples are not evenly spaced", subject, run.place, hint))
    signals = _signals(recording, run)
    size = {name: float(np.std(own[TEST])) for name, own in signals.items()}
    largest = max(size.values(), default=0.0)
    axes = [name for name in signals if size[name] > 0 and size[name] >= INJECTED * largest]
    if not axes:
        hint = "the test signal is constant, or no axis has two channels in this run"
        raise RotorsimError(Problem("nothing is injected", subject, run.place, hint))
    driven = axes + [name for name in signals if name not in axes and size[name] > SILENT * largest]
    outputs = {(name, AFTER): k for k, name in enumerate(signals)}
    outputs |= {(name, BEFORE): len(signals) + k for k, name in enumerate(axes)}
    columns = np.stack([signals[name][role] for name, role in outputs], axis=1)
    spectra = Spectra.of(np.stack([signals[name][TEST] for name in driven], axis=1), columns, 1 / period)
    _refuse_dependent(spectra, driven, run)
    angle = _angle(recording, run)
    speed = run.speed if run.speed is not None else None if angle is None else angle.speed
    highest = min(judged_up_to(speed), WELL_BELOW / 2 / period)
    if angle is not None and angle.phase_known:
        turns = abs(angle.speed) / (2 * pi)
        orders = range(1, min(int(highest / turns), MOST_ORDERS_OUT) + 1) if turns > 0 else ()
        spectra = without_shapes(spectra, [np.fft.rfft(np.cos(k * angle.theta)) / np.sqrt(n) for k in orders])
    spectra, lines, rest = without_lines(spectra, highest)
    return RunSpectra(run, speed, tuple(axes), outputs, spectra, highest, tuple(lines), rest)


def judged_up_to(speed: float | None) -> float:
    """Return the frequency [Hz] up to which ISO 14839-3 judges a machine of a speed [rad/s]."""
    return max(LARGEST_FREQUENCY, 3 * abs(speed or 0.0) / (2 * pi))


def _signals(recording: InjectionRecording, run: Run) -> dict[str, dict[str, np.ndarray]]:
    """Return axis -> "test", "before", "after" -> samples (n,), the third as the difference of two."""
    found = {}
    for name, columns in recording.loops.items():
        own = {role: run.values[column] for role, column in columns.items() if column in run.values}
        if bad := [columns[role] for role, values in own.items() if not np.isfinite(values).all()]:
            raise RotorsimError(Problem("samples are missing or not finite", f"run {run.id}, {bad[0]}", run.place))
        if len(own) < 2:
            continue
        if TEST not in own:
            own[TEST] = own[AFTER] - own[BEFORE]
        elif BEFORE not in own:
            own[BEFORE] = own[AFTER] - own[TEST]
        elif AFTER not in own:
            own[AFTER] = own[BEFORE] + own[TEST]
        found[name] = own
    return found


def _refuse_dependent(spectra: Spectra, names: list[str], run: Run) -> None:
    """Raise RotorsimError for test signals of which one follows from another: nothing tells their responses apart."""

    def smooth(x: np.ndarray) -> np.ndarray:
        return np.asarray(uniform_filter1d(x.real, SMOOTHED) + 1j * uniform_filter1d(x.imag, SMOOTHED))

    for b in range(1, len(names)):
        for a in range(b):
            one, other = spectra.U[:, a], spectra.U[:, b]
            cross = np.abs(smooth(one * other.conj()))
            both = np.sqrt(np.maximum(smooth(np.abs(one) ** 2).real * smooth(np.abs(other) ** 2).real, 0.0))
            if cross.sum() > DEPENDENT * both.sum():
                what = f"the test signals at {names[a]} and {names[b]} depend on each other"
                hint = "inject at one axis after the other, or independent signals"
                raise RotorsimError(Problem(what, f"run {run.id}", run.place, hint))


def _angle(recording: InjectionRecording, run: Run) -> ShaftAngle | None:
    """Return the shaft angle of a run; None for one that says nothing of it.

    Raises RotorsimError for a run-up, and for pulses or an angle that make no sense.
    """
    has_angle = recording.column(ANGLE) in run.values
    if not has_angle and run.speed is None and len(pulses_of(recording, run)[0]) < 2:
        return None
    angle = shaft_angle(recording, run)
    if angle.phase_known:
        refuse_run_up(f"run {run.id}", run.place, run.time, angle.theta)
    return angle
