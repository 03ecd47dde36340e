"""Measured harmonics over the speed: those of the runs of a recording that turn at a constant one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.measure.as_result import as_result, has_angle
from rotorsim.recordings.recording import Recording, Run
from rotorsim.signals.shaft_angle import refuse_run_up, shaft_angle
from rotorsim.signals.spectrum import Harmonics
from rotorsim.signals.two_axis import two_axis_harmonics, two_axis_names


@dataclass(frozen=True, eq=False)
class HarmonicsOverSpeed:
    """Harmonics of one two-axis signal at the speeds (n,) [rad/s] of runs, ascending; negative: turning backward.

    phase_known (n,): whether something says where the shaft angle is zero.
    """

    runs: tuple[str, ...]
    speeds: np.ndarray
    harmonics: tuple[Harmonics, ...]
    phase_known: np.ndarray

    def order(self, order: float) -> np.ndarray:
        """Return R_k of one order at every speed, (n,), 0-peak; NaN where a run does not carry it."""
        return np.array([one[order] if order in one.orders else np.nan for one in self.harmonics], complex)


def harmonics_over_speed(recording: Recording, runs: Iterable[Run] | None = None) -> Mapping[str, HarmonicsOverSpeed]:
    """Return the harmonics of every two-axis signal over the speed of the runs that turn at a constant one.

    runs: default all. Raises RotorsimError where no run does, and as `two_axis_harmonics`.
    """
    found: dict[str, list[tuple[float, str, Harmonics, bool]]] = {}
    for run in recording.runs if runs is None else runs:
        if not has_angle(recording, run):
            continue
        angle = shaft_angle(recording, run)
        try:
            refuse_run_up(run.id, run.place, run.time, angle.theta)
        except RotorsimError:
            continue
        result = as_result(recording, run, angle)
        speed = float(angle.theta[-1] - angle.theta[0]) / float(run.time[-1] - run.time[0])
        for name in two_axis_names(result):
            fitted = two_axis_harmonics(result, name, angle_std=angle.std).harmonics
            found.setdefault(name, []).append((speed, run.id, fitted, angle.phase_known))
    if not found:
        hint = "it takes channels of both axes, and an angle, pulses or a speed"
        raise RotorsimError(Problem("no run at a constant speed with a two-axis signal", recording.name, hint=hint))
    return {name: _sorted(runs) for name, runs in found.items()}


def _sorted(runs: list[tuple[float, str, Harmonics, bool]]) -> HarmonicsOverSpeed:
    speeds, names, fitted, known = zip(*sorted(runs, key=lambda one: one[:2]), strict=True)
    return HarmonicsOverSpeed(names, np.array(speeds), fitted, np.array(known))
