"""Harmonics of the runs of a recording, channel by channel, about each run's own shaft angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.harmonic_fit import HarmonicFit, check_samples, fit_harmonics, harmonic_basis
from rotorsim.recordings.held import without_held
from rotorsim.recordings.recording import ANGLE, TACHO, Recording, Run
from rotorsim.recordings.shaft_angle import ShaftAngle, shaft_angle

__all__ = ["RunHarmonics", "harmonics_of"]


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
    found: list[RunHarmonics] = []
    problems: list[Problem] = []
    with threadpool_limits(1, "blas"):  # matrices of 5000 x 35: threads cost more than they save
        for run in recording.runs if runs is None else runs:
            try:
                angle = shaft_angle(recording, run)
                columns = [c for c in channels if c in run.values]
                y = np.column_stack([run.values[c] for c in columns])
                check_samples(run.id, [channels[c].name for c in columns], y, angle.theta)
                basis = harmonic_basis(run.id, run.time, angle.theta, orders=orders)
                y, held = without_held(basis, y)
                lost = int(held.sum(axis=0).max(initial=0))
                if lost:
                    run = replace(run, values={**run.values, **dict(zip(columns, y.T, strict=True))})
                fit = fit_harmonics(
                    run.id, run.time, angle.theta, {channels[c].name: y[:, k] for k, c in enumerate(columns)}, units,
                    angle_std=angle.std, basis=basis, lost=lost / len(y),
                    weights={channels[c].name: np.asarray(w) for c, w in run.weights.items()},
                )  # fmt: skip
                found.append(RunHarmonics(run, angle, fit, lost))
            except RotorsimError as error:
                problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return found
