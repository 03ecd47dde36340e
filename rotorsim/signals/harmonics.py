"""Harmonics of the runs of a recording, channel by channel, about each run's own shaft angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import ANGLE, TACHO, Channel, Recording, Run
from rotorsim.signals.angle_refinement import refined_angle
from rotorsim.signals.dropped_samples import fill_dropped
from rotorsim.signals.harmonic_basis import check_samples, harmonic_basis
from rotorsim.signals.harmonic_fit import HarmonicFit, Samples, fit_harmonics
from rotorsim.signals.noise.colour import common_colour
from rotorsim.signals.noise.whitening import FALSE_ALARM
from rotorsim.signals.shaft_angle import ShaftAngle, refuse_run_up, shaft_angle

EVEN_SPEED = 2  # numbers that pulses of an even speed have: angle zero and the speed


@dataclass(frozen=True, eq=False)
class RunHarmonics:
    """One run of a recording with its shaft angle and the harmonics of its channels.

    run: with dropped samples filled in; lost: how many, in the channel that dropped most.
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
    fitted: list[RunHarmonics] = []
    problems: list[Problem] = []
    turning: list[Run] = []
    angles: list[ShaftAngle] = []
    for run in recording.runs if runs is None else runs:
        try:
            angle = shaft_angle(recording, run)
            refuse_run_up(f"run {run.id}", run.place, run.time, angle.theta)
        except RotorsimError as error:
            problems += error.problems
        else:
            turning.append(run)
            angles.append(angle)
    with one_thread():  # matrices of 5000 x 35: threads cost more than they save
        for run, angle in zip(turning, with_one_jitter(angles), strict=True):
            try:
                fitted.append(_run_harmonics(recording, run, angle, orders))
            except RotorsimError as error:
                problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return with_one_noise(fitted)


def _run_harmonics(recording: Recording, run: Run, angle: ShaftAngle, orders: int | None) -> RunHarmonics:
    """Return the harmonics of one run, its angle refined and its dropped samples filled in."""
    channels = _channels(recording, run)
    y = np.column_stack([run.values[c.column] for c in channels])
    check_samples(run.id, [c.name for c in channels], y, angle.theta)
    basis = harmonic_basis(run.id, run.time, angle.theta, orders=orders)
    angle, basis = refined_angle(run.time, angle, y, basis)
    y, dropped = fill_dropped(basis, y)
    lost = int(dropped.sum(axis=0).max(initial=0))
    if lost:
        run = replace(run, values={**run.values, **{c.column: y[:, k] for k, c in enumerate(channels)}})
    fit = fit_harmonics(samples_of(recording, run, angle, lost), basis=basis)
    return RunHarmonics(run, angle, fit, lost)


def samples_of(recording: Recording, run: Run, angle: ShaftAngle, lost: int = 0) -> Samples:
    """Return what the harmonics of a run are fitted to; see `RunHarmonics`."""
    channels = _channels(recording, run)
    return Samples(
        run.id,
        run.time,
        angle.theta,
        {c.name: np.asarray(run.values[c.column]) for c in channels},
        {c.name: c.unit for c in channels},
        {c.name: np.asarray(run.weights[c.column]) for c in channels if c.column in run.weights},
        angle.std,
        angle.stamp,
        lost / len(run.time),
    )


def _channels(recording: Recording, run: Run) -> list[Channel]:
    """Return the channels of a run that are compared: all but the angle."""
    return [c for c in recording.channels.values() if c.signal not in (ANGLE, TACHO) and c.column in run.values]


def contradictions(runs: Sequence[RunHarmonics]) -> list[Problem]:
    """Return warnings of runs whose harmonics and pulses contradict one another."""
    what = "its harmonics turn otherwise than its pulses say, by more than these leave open"
    hint = "do the pulses and the signals have one clock? is the speed steady? does the shaft warm up (1X drifts)?"
    return [
        Problem(what, f"run {item.run.id}", item.run.place, hint, severity="warning")
        for item in runs
        if item.angle.contradicted
    ]


def with_one_noise(runs: Sequence[RunHarmonics]) -> list[RunHarmonics]:
    """Return runs whose noise has one colour in each channel, that of the instrument, and its level in each run.

    Runs whose noise is not of the common colour keep their own.
    """
    colours = [item.fit.noise.colours().copy() for item in runs]
    changed = set()
    for name in dict.fromkeys(name for item in runs for name in item.fit.names):
        places = {r: item.fit.names.index(name) for r, item in enumerate(runs) if name in item.fit.names}
        noise = {r: runs[r].fit.noise for r in places}
        bands = [noise[r].bands_of(c) for r, c in places.items()]
        laws = common_colour(bands, [float(runs[r].run.time[-1] - runs[r].run.time[0]) for r in places])
        for (r, c), law in zip(places.items(), laws, strict=True):
            if law is not None and (law[1] > 0 or not noise[r].white):
                colours[r][c] = law
                changed.add(r)
    return [replace(item, fit=item.fit.recoloured(colours[r])) if r in changed else item for r, item in enumerate(runs)]


def with_one_jitter(angles: Sequence[ShaftAngle]) -> list[ShaftAngle]:
    """Return angles whose pulses jitter by one time, that of the instrument, from the residuals of those of all runs.

    A few pulses tell little of their jitter, and two tell nothing. Runs whose pulses scatter by more than that, for
    their speed wanders, keep their own.
    """
    turns = np.array([angle.source == "tacho" and angle.speed != 0 for angle in angles], bool)
    count = np.array([max(angle.pulses - EVEN_SPEED, 0) for angle in angles]) * turns
    square = np.array([(angle.jitter / (angle.speed or 1.0)) ** 2 for angle in angles])
    alike = count > 0
    if not alike.any():
        return list(angles)
    while True:
        jitter = float(np.average(square[alike], weights=count[alike]))
        wide = alike & (square * count > jitter * chi2.isf(FALSE_ALARM, np.maximum(count, 1)))
        if not wide.any() or (wide == alike).all():
            break
        alike[np.argmax(np.where(wide, square, -1.0))] = False
    shared = turns & (square * count <= jitter * chi2.isf(FALSE_ALARM, np.maximum(count, 1)))
    return [
        replace(angle, jitter=abs(angle.speed) * float(np.sqrt(jitter))) if one else angle
        for angle, one in zip(angles, shared, strict=True)
    ]
