"""Recordings of a turning shaft as evidence: harmonics, and what of them is pick-up, drift or quantisation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.evidence.base_fit import base_fit, with_uncertain
from rotorsim.diagnosis.evidence.fit import is_adequate
from rotorsim.diagnosis.evidence.harmonic.converters import find_converters
from rotorsim.diagnosis.evidence.harmonic.drifts import drift_warnings, find_drifts, tells_drifts, with_drifts
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from rotorsim.diagnosis.evidence.harmonic.pickups import find_pickups
from rotorsim.diagnosis.evidence.opened import Opened
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.harmonic.experiment import Experiment
from rotorsim.recordings.recording import Recording
from rotorsim.signals.asynchronous import Asynchronous, find_asynchronous, with_asynchronous
from rotorsim.signals.converters import stated_steps, through_converters
from rotorsim.signals.harmonics import RunHarmonics, contradictions, harmonics_of
from rotorsim.signals.pickup import pickup_warnings, with_pickups
from rotorsim.signals.quantisation import Step

PICKUPS = 3  # times that lines which are picked up are looked for, behind stronger ones


@dataclass(frozen=True)
class Conditions:
    """What is known of signals beside what the machine makes of them.

    steps: quantisation steps of channels. picked: frequencies [Hz] of lines that channels pick up. drifts: of the
    offsets of channels, rms slope [SI].
    """

    steps: Mapping[str, Step] = field(default_factory=dict)
    picked: Sequence[float] = ()
    drifts: Mapping[str, float] = field(default_factory=dict)


def open_harmonics(
    diagram: Diagram,
    recording: Recording,
    hold_out: Recording | None,
    catalogue: Catalogue,
    warnings: Sequence[Problem],
) -> Opened:
    """Return the harmonics of a recording as evidence, and the fit of the diagram as given.

    Lines that are no force anywhere are pick-up; offsets that drift by more than noise make means less certain;
    quantisation steps that the readings show and the diagram lacks are taken out by a converter.
    Raises RotorsimError where no run has a settled motion, or signals do not fit the diagram.
    """
    folder = diagram.folder
    empty = HarmonicEvidence(recording, (), folder, catalogue.trust)
    steps, unseen = stated_steps(diagram, recording)
    notes = [*warnings, *unseen]
    conditions = Conditions(steps)
    readings = Readings()
    given, extra = harmonic_evidence(empty, hold_out, conditions, notes, readings)
    _refuse_still(given.open(given.load(with_uncertain(diagram))))  # says what is wrong, and where
    before, refined = base_fit(diagram, given)
    for _ in range(PICKUPS):
        more = [] if before.failure else find_pickups(before, given)
        if not more:
            break
        conditions = replace(conditions, picked=[*conditions.picked, *more])
        given, extra = harmonic_evidence(empty, hold_out, conditions, notes, readings)
        before, refined = base_fit(diagram, given)
    drifts = {} if before.failure else find_drifts(before, given)
    if drifts:
        drifting = replace(conditions, drifts=drifts)
        less, less_extra = harmonic_evidence(empty, hold_out, drifting, notes, readings)
        fit, finer = base_fit(diagram, less)
        if tells_drifts(fit):  # else what the diagram lacks may drift, too
            conditions, given, extra, before, refined = drifting, less, less_extra, fit, finer
            notes += drift_warnings(drifts, recording)
    evidence, base = given, before
    converters = [] if before.failure or is_adequate(base) else find_converters(base.document, given, catalogue)
    if converters:
        found = {name: step for converter in converters for name, step in converter.steps.items()}
        notes += [problem for converter in converters for problem in converter.warnings]
        found = {**steps, **found}
        evidence, extra = harmonic_evidence(empty, hold_out, replace(conditions, steps=found), notes, readings)
        base, refined = base_fit(evidence.load(converters[-1].document), evidence)
    return Opened(
        evidence=replace(evidence, standing=base.nuisances, given=before.free),
        base=base,
        before=before,
        given=given,
        catalogue=catalogue,
        held_out=evidence.held_out,
        warnings=[*notes, *extra, *(Problem(note, severity="warning") for note in refined)],
        converters=converters,
    )


class Readings:
    """Recordings before their converters, and the harmonics of their runs: each found once."""

    def __init__(self) -> None:
        self._before = cache(lambda recording, steps: through_converters(recording, dict(steps)))
        self.fitted: Callable[[Recording, str], list[RunHarmonics]] = cache(_fitted)

    def before(self, recording: Recording, steps: Mapping[str, Step]) -> Recording:
        """Return a recording with the signals that went into converters of these steps."""
        found: Recording = self._before(recording, tuple(sorted(steps.items())))
        return found


def _fitted(recording: Recording, use: str) -> list[RunHarmonics]:
    """Return the harmonics of the runs of a recording for a use; "": of all of them."""
    runs = recording.select(use) if use else recording.runs
    return harmonics_of(recording, runs) if runs else []


def harmonic_evidence(
    empty: HarmonicEvidence,
    hold_out: Recording | None,
    conditions: Conditions,
    earlier: Sequence[Problem] = (),
    readings: Readings | None = None,
) -> tuple[HarmonicEvidence, list[Problem]]:
    """Return the harmonics of recordings under conditions, and warnings; earlier: those of before, for the error."""
    readings = readings or Readings()
    fitted, recording = readings.fitted, readings.before(empty.recording, conditions.steps)
    hold_out = None if hold_out is None else readings.before(hold_out, conditions.steps)
    warnings: list[Problem] = []
    harmonics = settled_runs(fitted(recording, "identify"), warnings, "used")
    if not harmonics:
        hint = "diagnosis needs runs at constant speed that have settled"
        problem = Problem("no run has a settled motion", recording.name, hint=hint)
        raise RotorsimError(problem, *earlier, *warnings, exit_code=1)
    harmonics, lines = with_pickups(recording, harmonics, conditions.picked)
    warnings += pickup_warnings(lines, recording, "is picked up", "it is fitted beside the harmonics, as no physics")
    harmonics = with_drifts(harmonics, conditions.drifts)
    second = find_asynchronous(recording, harmonics)
    if second is not None:
        beside = _beside(recording, harmonics, second, warnings, "used")
        second, harmonics = (second, beside) if beside else (None, harmonics)

    def held(part: Recording, use: str) -> tuple[RunHarmonics, ...]:
        kept = settled_runs(fitted(part, use), warnings, "scored")
        kept = with_drifts(with_pickups(part, kept, conditions.picked)[0], conditions.drifts)
        return _beside(part, kept, second, warnings, "scored") if kept and second is not None else kept

    parts = [(recording, "hold_out"), *([] if hold_out is None else [(hold_out, "")])]
    scored = tuple((part, kept) for part, use in parts if (kept := held(part, use)))
    return replace(empty, recording=recording, harmonics=harmonics, second=second, held=scored), warnings


def settled_runs(runs: Sequence[RunHarmonics], warnings: list[Problem], use: str) -> tuple[RunHarmonics, ...]:
    """Return the runs whose signals follow the shaft, and warn of the others; use: "used" or "scored"."""
    kept = []
    for item in runs:
        if (item.fit.residual > CRITERIA.settled * item.fit.rms).all():
            what = f"most of it does not follow the shaft, so that it has no settled motion: it is not {use}"
            warnings.append(Problem(what, f"run {item.run.id}", item.run.place, severity="warning"))
        else:
            kept.append(item)
    warnings += contradictions(kept)
    lost = [item for item in kept if item.lost]
    if lost:
        what = f"{sum(item.lost for item in lost)} samples repeat the one before, as lost ones do: they are not {use}"
        first, *_, last = lost[0].run.id, lost[-1].run.id
        subject = f"run {first}" if len(lost) == 1 else f"{len(lost)} runs from {first} to {last}"
        warnings.append(Problem(what, subject, severity="warning"))
    return tuple(kept)


def _refuse_still(experiment: Experiment) -> None:
    """Refuse signals that stand still though the diagram moves them."""
    problems = [
        Problem(
            "is constant: no diagram explains a shaft that turns and does not move it",
            f"run {item.run.id}: {name}",
            item.run.place,
            "leave the channel out of recording.json if its sensor is dead",
        )
        for item in experiment.runs
        for name in experiment.predicted
        if item.fit.rms[item.fit.names.index(name)] == 0
    ]
    if problems:
        raise RotorsimError(*problems, exit_code=1)


def _beside(
    recording: Recording, runs: Sequence[RunHarmonics], second: Asynchronous, warnings: list[Problem], use: str
) -> tuple[RunHarmonics, ...]:
    """Return runs with asynchronous lines fitted; those that cannot separate them from harmonics are left out."""
    kept, lost = with_asynchronous(recording, runs, second)
    near = "lines that do not follow the shaft are too near to its harmonics"
    warnings += [Problem(f"{near}: it is not {use}", f"run {name}", severity="warning") for name in lost]
    return kept
