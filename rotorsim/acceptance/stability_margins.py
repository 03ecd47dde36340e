"""ISO 14839-3: peak of the sensitivity of every bearing axis, modelled and measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorsim.acceptance.conditions import Conditions
from rotorsim.acceptance.criterion import ISO_3, Criterion, Part, judged
from rotorsim.linear.control.margins import ZONES, Margins, margins
from rotorsim.linear.linearisation import speed_of
from rotorsim.model.compiled import Model
from rotorsim.recordings.injection import InjectionRecording
from rotorsim.signals.injection.measured_margins import measured_margins

MARGINS_TITLE, CLAUSE, WHAT = "Stability margins of the bearing loops", f"{ISO_3}, table 1", "peak of |S|"
EQUAL_PEAKS = 1e-6  # relative difference of peaks at two speeds that are one


@dataclass(frozen=True, eq=False)
class MarginsAt:
    """Margins at a speed [rad/s]; None where the diagram has none."""

    speed: float | None
    margins: Margins


def modelled_margins(model: Model, given: Conditions) -> Part:
    """Return the largest peak of |S| of every axis at standstill and at the ends of the operating speeds."""
    return judged(MARGINS_TITLE, CLAUSE, WHAT, lambda: _modelled(model, given))


def _modelled(model: Model, given: Conditions) -> Part:
    speeds: list[float | None] = [None]
    if speed_of(model, model.p0) is not None:
        speeds = [0.0, *sorted({given.lowest, given.highest} - {np.nan})] if np.isfinite(given.highest) else [0.0]
    limit = _limit(given)
    worst: dict[str, Criterion] = {}
    notes: list[str] = []
    found = []
    for speed in speeds:
        result: Margins = margins(model, parameters={} if speed is None else {"speed": speed})
        notes += [note for note in result.notes if note not in notes]
        found.append(MarginsAt(speed, result))
        at = "" if speed is None else f" at {speed * 30 / np.pi:.5g} rpm"
        for axis in result.axes:
            value = axis.peak if result.stable else np.inf
            said = f"zone {axis.zone}, at {axis.frequency:.4g} Hz" if result.stable else "the closed loop is unstable"
            if axis.name not in worst or not value <= worst[axis.name].value * (1 + EQUAL_PEAKS):
                worst[axis.name] = Criterion(CLAUSE, WHAT, f"{axis.name}{at}", value, limit, said=said)
    singular = max((one.margins for one in found), key=lambda one: np.nan_to_num(one.singular_peak))
    if len(worst) > 1 and np.isfinite(singular.singular_peak):
        at = f"at {singular.singular_peak_frequency:.4g} Hz"
        notes.append(f"all axes together: largest singular value of S {singular.singular_peak:.3g} {at}; not judged")
    return Part(MARGINS_TITLE, tuple(worst.values()), tuple(notes), tuple(found))


def _limit(given: Conditions) -> float:
    return next(limit for limit, zone in ZONES if zone == given.zone)


def measured_stability(recording: InjectionRecording, given: Conditions) -> Part:
    """Return the peak of |S| of every axis that was injected at, with its 90 % interval."""
    title = f"Stability margins, {recording.name}"

    def analysis() -> Part:
        made: list[Criterion] = []
        notes: list[str] = []
        every = measured_margins(recording)
        for one in every:
            notes += [note for note in one.notes if note not in notes]
            at = ", ".join(one.runs) if one.speed is None else f"{one.speed * 30 / np.pi:.5g} rpm"
            for axis in one.axes:
                low, high = axis.interval90["peak"]
                said = f"zone {axis.zones}, at {axis.best.frequency:.4g} Hz"
                where = f"{axis.name} at {at}"
                limit, best = _limit(given), axis.best.peak
                made.append(
                    Criterion(CLAUSE, WHAT, where, best, limit, interval90=(low, high), source="measured", said=said)
                )
        return Part(title, tuple(made), tuple(notes), every)

    return judged(title, CLAUSE, WHAT, analysis)
