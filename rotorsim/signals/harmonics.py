"""Harmonics of the runs of a recording, channel by channel, about each run's own shaft angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import ANGLE, TACHO, Recording, Run
from rotorsim.signals.angle_refinement import refined
from rotorsim.signals.colour import Bands, common_colour
from rotorsim.signals.harmonic_fit import HarmonicFit, check_samples, fit_harmonics, harmonic_basis
from rotorsim.signals.held import without_held
from rotorsim.signals.noise import Noise
from rotorsim.signals.shaft_angle import ShaftAngle, refuse_run_up, shaft_angle

__all__ = ["RunHarmonics", "contradictions", "harmonics_of", "with_one_jitter", "with_one_noise"]

LINE = 2  # numbers that pulses of an even speed have: angle zero and the speed
WANDERS = 1e-3  # probability that pulses of one jitter scatter so much in a run


@dataclass(frozen=True, eq=False)
class RunHarmonics:
    """One run of a recording with its shaft angle and the harmonics of its channels.

    run: with samples that were lost and held put right; lost: how many, in the channel that lost most.
    """

    run: Run
    angle: ShaftAngle
    fit: HarmonicFit
    lost: int = 0


def harmonics_of(
    recording: Recording, runs: Sequence[Run] | None = None, *, orders: int | None = None
) -> list[RunHarmonics]:
    """Return the harmonics of every channel but the angle, for the given runs (default: all).

    orders: highest order; default as many as each run carries, at most 16.
    Raises RotorsimError with what is wrong in every run: no angle, samples that are not finite, too short.
    """
    channels = {c: channel for c, channel in recording.channels.items() if channel.signal not in (ANGLE, TACHO)}
    units = {channel.name: channel.unit for channel in channels.values()}
    chosen = recording.runs if runs is None else runs
    found: list[RunHarmonics] = []
    problems: list[Problem] = []
    angles: list[tuple[Run, ShaftAngle]] = []
    for run in chosen:
        try:
            angle = shaft_angle(recording, run)
            refuse_run_up(f"run {run.id}", run.place, run.time, angle.theta)
            angles.append((run, angle))
        except RotorsimError as error:
            problems += error.problems
    with one_thread():  # matrices of 5000 x 35: threads cost more than they save
        for run, angle in zip([run for run, _ in angles], with_one_jitter([angle for _, angle in angles]), strict=True):
            try:
                columns = [c for c in channels if c in run.values]
                y = np.column_stack([run.values[c] for c in columns])
                check_samples(run.id, [channels[c].name for c in columns], y, angle.theta)
                basis = harmonic_basis(run.id, run.time, angle.theta, orders=orders)
                angle, basis = refined(run.id, run.time, angle, y, basis)
                y, held = without_held(basis, y)
                lost = int(held.sum(axis=0).max(initial=0))
                if lost:
                    run = replace(run, values={**run.values, **dict(zip(columns, y.T, strict=True))})
                fit = fit_harmonics(
                    run.id,
                    run.time,
                    angle.theta,
                    {channels[c].name: y[:, k] for k, c in enumerate(columns)},
                    units,
                    angle_std=angle.std,
                    stamp=angle.stamp,
                    basis=basis,
                    lost=lost / len(y),
                    weights={channels[c].name: np.asarray(w) for c, w in run.weights.items()},
                )
                found.append(RunHarmonics(run, angle, fit, lost))
            except RotorsimError as error:
                problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return with_one_noise(found)


def contradictions(runs: Sequence[RunHarmonics]) -> list[Problem]:
    """Return warnings of runs whose harmonics and pulses contradict one another."""
    what = "its harmonics turn otherwise than its pulses say, by more than these leave open"
    hint = "do the pulses and the signals have one clock? is the speed steady?"
    return [
        Problem(what, f"run {item.run.id}", item.run.place, hint, severity="warning")
        for item in runs
        if item.angle.contradicted
    ]


def with_one_noise(runs: Sequence[RunHarmonics]) -> list[RunHarmonics]:
    """Return runs whose noise has one colour in each channel, that of the instrument, and its level in each run.

    Runs whose noise is not of the common colour keep their own.
    """
    durations = [float(item.run.time[-1] - item.run.time[0]) for item in runs]
    colours = [_own_colour(item.fit.noise, len(item.fit.names)) for item in runs]
    changed = set()
    for name in dict.fromkeys(name for item in runs for name in item.fit.names):
        having = [r for r, item in enumerate(runs) if name in item.fit.names]
        place = [runs[r].fit.names.index(name) for r in having]
        bands = [_of_one(runs[r].fit.noise.bands, c) for r, c in zip(having, place, strict=True)]
        laws = common_colour(bands, [durations[r] for r in having])
        for r, c, law in zip(having, place, laws, strict=True):
            if law is not None and (law[1] > 0 or not runs[r].fit.noise.white):
                colours[r][c] = law
                changed.add(r)
    return [_recoloured(item, colours[r]) if r in changed else item for r, item in enumerate(runs)]


def _recoloured(item: RunHarmonics, colour: np.ndarray) -> RunHarmonics:
    fit = item.fit
    return replace(item, fit=replace(fit, noise=fit.noise.recoloured(colour, fit.turns, int(fit.orders[-1]))))


def _of_one(bands: Bands | None, channel: int) -> Bands | None:
    return None if bands is None else replace(bands, power=bands.power[:, [channel]])


def _own_colour(noise: Noise, channels: int) -> np.ndarray:
    if noise.colour is not None:
        return noise.colour.copy()
    white = np.diag(noise.spectrum[0].real)
    return np.column_stack([white, np.zeros(channels), np.ones(channels)])


def with_one_jitter(angles: Sequence[ShaftAngle]) -> list[ShaftAngle]:
    """Return angles whose pulses jitter by one time, that of the instrument, from what those of all runs leave over.

    A few pulses tell little of their jitter, and two tell nothing. Runs whose pulses scatter by more than that, for
    their speed wanders, keep their own.
    """
    turns = [angle.source == "tacho" and angle.speed != 0 for angle in angles]
    count = np.array([max(angle.pulses - LINE, 0) for angle in angles]) * turns
    square = np.array([(angle.jitter / (angle.speed or 1.0)) ** 2 for angle in angles])
    alike = count > 0
    for _ in angles:
        if not alike.any():
            return list(angles)
        jitter = float(np.average(square[alike], weights=count[alike]))
        wide = alike & (square * count > jitter * chi2.isf(WANDERS, np.maximum(count, 1)))
        if not wide.any() or (wide == alike).all():
            break
        worst = int(np.argmax(np.where(wide, square, -1.0)))
        alike[worst] = False
    found = []
    for angle, turning, own, n in zip(angles, turns, square, count, strict=True):
        shared = turning and own * n <= jitter * chi2.isf(WANDERS, max(n, 1))
        found.append(replace(angle, jitter=abs(angle.speed) * float(np.sqrt(jitter))) if shared else angle)
    return found
