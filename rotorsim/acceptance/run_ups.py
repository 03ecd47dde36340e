"""API 617: critical speeds that a run-up or coast-down has passed, and their separation margins, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.acceptance.conditions import Conditions
from rotorsim.acceptance.criterion import API_684, MET, RUNNING_TEST, UNSURE, Criterion, Part, judged
from rotorsim.acceptance.limits import vibration_limit
from rotorsim.acceptance.probes import examined
from rotorsim.recordings.orders import OrderChannel, OrderRecording, OrderRun
from rotorsim.recordings.recording import Recording
from rotorsim.signals.orders.critical_speeds import CriticalSpeed, CriticalSpeeds, critical_speeds
from rotorsim.signals.orders.extraction import tracked_recording
from rotorsim.signals.orders.resonance import IN_RANGE, RESPONSIVE, unmeasured
from rotorsim.signals.turning import is_run_up

CLAUSE, WHAT = f"{API_684}, SP6.8.2.10", "separation margin"


@dataclass(frozen=True, eq=False)
class PassedRunUp:
    """A run-up or coast-down, and the critical speeds that it has passed."""

    run: OrderRun
    channels: Mapping[str, OrderChannel]
    found: CriticalSpeeds


def run_ups_of(recording: Recording) -> list[str]:
    """Return the runs whose speed changes."""
    return [run.id for run in recording.runs if is_run_up(recording, run)]


def measured_critical_speeds(recording: Recording | OrderRecording, given: Conditions) -> Part:
    """Return the critical speeds of 1X of every run, corrected for the sweep rate, and their separation margins."""
    title = f"Critical speeds, {recording.name}"
    return judged(title, CLAUSE, WHAT, lambda: _passed(title, recording, given))


def _passed(title: str, recording: Recording | OrderRecording, given: Conditions) -> Part:
    notes: list[str] = []
    recording, faults = examined(recording)
    if isinstance(recording, Recording):
        recording = tracked_recording(recording, (1,))[0]
        notes += [f"{one.subject}: {one.what}" for one in recording.warnings]
    made: list[Criterion] = []
    results = []
    for run in recording.runs:
        blind = [f"{column}: {what}" for (id, column), what in faults.items() if id == run.id]
        found = critical_speeds(run, recording.channels, 1)
        results.append(PassedRunUp(run, recording.channels, found))
        if not found.explained:
            notes.append(f"{run.id}: the modes leave {found.excess:.3g} times the variance of the noise")
        made += [_criterion(one, run.id, given) for one in found.found]
        made += [_as_measured(one, blind) for one in _vibration(run, recording.channels, given)]
        low, high = float(found.speed.min()), float(found.speed.max())
        where = f"{run.id}, {low * 30 / np.pi:.5g} to {high * 30 / np.pi:.5g} rpm"
        short = _not_covered(low, high, given)
        if short:
            made.append(Criterion(CLAUSE, WHAT, where, source="measured", said=short))
        elif not found.found and found.explained:
            said = "; ".join(["no critical speed", *blind])
            stated = UNSURE if blind else MET
            made.append(Criterion(CLAUSE, WHAT, where, source="measured", said=said, stated=stated))
        gaps = unmeasured(low, high, given.lowest, given.highest) if not short else []
        if gaps:  # a diagram tells what is there
            spans = " and ".join(f"{a * 30 / np.pi:.5g} to {b * 30 / np.pi:.5g} rpm" for a, b in gaps)
            said, required = "a critical speed might be too near there: not passed", not given.probes
            made.append(Criterion(CLAUSE, WHAT, f"{run.id}, {spans}", source="measured", said=said, required=required))
        if not found.found and not found.explained:
            made.append(Criterion(CLAUSE, WHAT, where, source="measured", said="no critical speed is told"))
    return Part(title, tuple(made), tuple(notes), tuple(results))


def _as_measured(one: Criterion, blind: Sequence[str]) -> Criterion:
    """Return a criterion that is met as unsure where probes are at fault."""
    return replace(one, stated=UNSURE, said="; ".join(blind)) if blind and one.verdict == MET else one


def _vibration(run: OrderRun, channels: Mapping[str, OrderChannel], given: Conditions) -> list[Criterion]:
    """Judge the largest 1X of the displacements at operating speeds, a part of the vibration, against A_vl."""
    inside = (run.speed >= given.lowest * (1 - IN_RANGE)) & (run.speed <= given.highest * (1 + IN_RANGE))
    sizes = []
    for name, one in channels.items():
        if one.order == 1 and one.signal.endswith("displacement") and name in run.vectors:
            size = np.where(inside & np.isfinite(run.vectors[name]), np.abs(run.vectors[name]), -np.inf)
            if inside.any() and np.isfinite(size.max()):
                sizes.append((2 * float(size.max()), float(run.speed[size.argmax()]), one.name))
    if not sizes:
        return []
    largest, speed, name = max(sizes)
    where = f"{name} at {speed * 30 / np.pi:.5g} rpm, {run.id}"
    limit = vibration_limit(given.highest) * 1e6
    what = "1X of the vibration, peak to peak"
    return [Criterion(RUNNING_TEST, what, where, largest * 1e6, limit, "um", source="measured")]


def _not_covered(low: float, high: float, given: Conditions) -> str:
    """Return why a run does not tell that there is no critical speed; "" where it passes all operating speeds."""
    if not np.isfinite(given.highest):
        return "no operating speed is given: --operating"
    if low > given.lowest * (1 + IN_RANGE) or high < given.highest * (1 - IN_RANGE):
        return "it does not pass all operating speeds: there may be a critical speed among the others"
    return ""


def _criterion(one: CriticalSpeed, run: str, given: Conditions) -> Criterion:
    low, high = (end * 30 / np.pi for end in one.interval90("speed"))
    af = one.interval90("amplification")
    speed = f"{one.peak.speed * 30 / np.pi:.5g} rpm ({low:.5g} to {high:.5g})"
    where = f"{run}, N_c {speed}, AF {one.peak.amplification:.3g} ({af[0]:.3g} to {af[1]:.3g})"
    if not np.isfinite(given.highest):
        return Criterion(CLAUSE, WHAT, where, source="measured", said="no operating speed is given: --operating")
    margin, verdict = one.separation(given.lowest, given.highest)
    said = f"AF below {RESPONSIVE:g}: no margin needed" if one.peak.amplification < RESPONSIVE else ""
    return Criterion(
        CLAUSE, WHAT, where, margin.actual, margin.required, "%", False, source="measured", said=said, stated=verdict
    )
