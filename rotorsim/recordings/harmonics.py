"""Harmonics of the runs of a recording, channel by channel, about each run's own shaft angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.harmonic_fit import HarmonicFit, fit_harmonics
from rotorsim.recordings.recording import ANGLE, TACHO, Recording, Run
from rotorsim.recordings.shaft_angle import ShaftAngle, refuse_run_up, shaft_angle

__all__ = ["RunHarmonics", "harmonics_of"]


@dataclass(frozen=True, eq=False)
class RunHarmonics:
    """One run of a recording with its shaft angle and the harmonics of its channels."""

    run: Run
    angle: ShaftAngle
    fit: HarmonicFit


def harmonics_of(
    recording: Recording, runs: Sequence[Run] | None = None, *, orders: int | None = None
) -> list[RunHarmonics]:
    """Return the harmonics of every channel but the angle, for the given runs (default: all).

    orders: highest order; default as many as each run carries, at most 16. Errors of sampled pulses may be alike in
    all R runs (a trigger is late each time), so that R runs know angle zero no better than one: each is given R times
    the variance, which is above any covariance they can have (R v I - v 1 1^T is positive semidefinite).
    Raises RotorsimError with what is wrong in every run: no angle, samples that are not finite, too short.
    """
    channels = {c: channel for c, channel in recording.channels.items() if channel.signal not in (ANGLE, TACHO)}
    units = {channel.name: channel.unit for channel in channels.values()}
    chosen = recording.runs if runs is None else runs
    found: list[RunHarmonics] = []
    problems: list[Problem] = []
    with threadpool_limits(1, "blas"):  # matrices of 5000 x 35: threads cost more than they save
        for run in chosen:
            try:
                angle = shaft_angle(recording, run)
                refuse_run_up(f"run {run.id}", run.place, run.time, angle.theta)
                angle = replace(angle, sampled=angle.sampled * len(chosen) ** 0.5)
                signals = {channels[c].name: np.asarray(run.values[c]) for c in channels if c in run.values}
                fit = fit_harmonics(
                    run.id, run.time, angle.theta, signals, units, orders=orders, angle_std=angle.std,
                    weights={channels[c].name: np.asarray(w) for c, w in run.weights.items()},
                )  # fmt: skip
                found.append(RunHarmonics(run, angle, fit))
            except RotorsimError as error:
                problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return found
