"""From a diagram and a recording to a diagnosis: what is missing, where, the repaired diagram, and the proof."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.conclusions import (
    Diagnosis,
    concluded,
    effects_of,
    in_words,
    nearest,
    unknown_of,
    verdict_of,
)
from rotorsim.diagnosis.conclude.explaining import explanations, is_force, residual_of
from rotorsim.diagnosis.evidence.base import base_fit, with_uncertain
from rotorsim.diagnosis.evidence.drifts import drift_warnings, find_drifts, tells_drifts, with_drifts
from rotorsim.diagnosis.evidence.harmonic import Fit, Source
from rotorsim.diagnosis.evidence.scoring import Held, Score, left_out_score, score
from rotorsim.diagnosis.evidence.waveform.data import is_in_time
from rotorsim.diagnosis.search.converters import find_converters
from rotorsim.diagnosis.search.naming import Named, name_missing, without_effects, without_last
from rotorsim.diagnosis.search.pickups import find_pickups
from rotorsim.diagnosis.search.proof import is_faint, is_material, prove
from rotorsim.diagnosis.search.trials import is_adequate
from rotorsim.diagnosis.waveform import diagnose_in_time
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.experiment import Experiment
from rotorsim.jobs.jobs import Jobs
from rotorsim.jobs.threads import one_thread
from rotorsim.measure.checks import check_signals
from rotorsim.recordings.recording import Recording
from rotorsim.signals.asynchronous import Asynchronous, find_asynchronous, with_asynchronous
from rotorsim.signals.converters import stated_steps, through_converters
from rotorsim.signals.harmonics import RunHarmonics, contradictions, harmonics_of
from rotorsim.signals.pickup import pickup_warnings, with_pickups
from rotorsim.signals.quantisation import Step

__all__ = ["Diagnosis", "diagnose", "material_effects"]

PICKUPS = 3  # times that lines which are picked up are looked for, behind stronger ones
SETTLED = 0.5  # of the rms of all signals: what harmonics leave over of a run that has no settled motion


def diagnose(
    diagram: Diagram,
    recording: Recording,
    *,
    hold_out: Recording | None = None,
    physics: Collection[str] | None = None,
    trust_blocks: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Diagnosis:
    """Return what a diagram lacks to explain a recording.

    The free parameters of the diagram are refitted; if noise does not explain what is left over, every declared fault
    (`rotorsim.fault.Fault`) is tried at every place; physics: only these. hold_out: further runs that take part in no
    fit.
    Raises RotorsimError for recordings with errors, and what `identification.experiment.open_experiment` raises.
    """
    Jobs(workers, scheduler)  # what is wrong with them is said before any work
    warnings = [*_checked(recording), *([] if hold_out is None else _checked(hold_out))]
    if is_in_time(diagram, recording):
        return diagnose_in_time(
            diagram,
            recording,
            hold_out=hold_out,
            physics=physics,
            warnings=warnings,
            trust_blocks=trust_blocks,
            workers=workers,
            scheduler=scheduler,
            progress=progress,
        )
    folder = str(Path(diagram.file).parent) if diagram.file else None
    folders = diagram.document.get("block_folders", []) if trust_blocks and folder else []
    registry = Registry([Path(folder or ".") / name for name in folders])
    empty = Source(recording, (), folder, trust_blocks)
    steps, unseen = stated_steps(diagram, recording)
    warnings += unseen
    given = data = _prepared(empty, hold_out, steps, warnings)
    with one_thread():
        _refuse_still(data.source.open(data.source.load(with_uncertain(diagram))))  # says what is wrong, and where
        before, refined = base_fit(diagram, data.source)
        picked: list[float] = []
        for _ in range(PICKUPS):
            more = [] if before.failure else find_pickups(before, data.source)
            if not more:
                break
            picked += more
            given = data = _prepared(empty, hold_out, steps, warnings, picked)
            before, refined = base_fit(diagram, data.source)
        drifts: dict[str, float] = {} if before.failure else find_drifts(before, data.source)
        if drifts:
            less = _prepared(empty, hold_out, steps, warnings, picked, drifts)
            without, finer = base_fit(diagram, less.source)
            if not tells_drifts(without):
                drifts = {}  # what the diagram lacks may drift, too
            else:
                given = data = less
                before, refined = without, finer
                warnings += drift_warnings(drifts, recording)
    if before.failure:
        raise RotorsimError(Problem(before.failure, diagram.name))
    base = before
    converters = [] if is_adequate(base) else find_converters(base.document, data.source, registry, physics)
    if converters:
        steps |= {name: step for converter in converters for name, step in converter.steps.items()}
        warnings += [problem for converter in converters for problem in converter.warnings]
        data = _prepared(empty, hold_out, steps, warnings, picked, drifts)
        with one_thread():
            base, refined = base_fit(data.source.load(converters[-1].document), data.source)
    source, held = replace(data.source, standing=base.nuisances, given=before.free), data.held
    named = name_missing(
        base, source, registry=registry, physics=physics, workers=workers, scheduler=scheduler, progress=progress
    )
    scored = _Scores(source, held)
    named = material_effects(named, scored)
    effects = effects_of(named)
    proof = None
    if (effects or converters) and named.explains:
        left = 0.0 if named.explained else max(1 - named.share, 0.0)
        proof = prove(scored(base), scored(named.fit), left=left, held=bool(held))
    disproved = proof is not None and proof.status == "disproved"
    with one_thread():
        faint = is_faint(base, scored(base)) and not is_force(base, source)
    if faint and effects and (disproved or not named.explains):
        named, effects = without_effects(named), ()
    verdict = verdict_of(
        named, effects, alike=source.alike, disproved=disproved, converters=bool(converters), faint=faint
    )
    unknown = unknown_of(named, effects, source) if verdict == "outside_catalogue" else None
    after = nearest(named, unknown, disproved=disproved)
    score_before = scored(base) if base is before else _Scores(given.source, given.held)(before)
    with one_thread():
        explained = explanations(named, effects, source, held) if verdict == "missing_physics" else ()
        residual = residual_of(base, after, source) if verdict in ("missing_physics", "consistent") else None
    found = concluded(
        named,
        effects,
        verdict,
        fits=(before, after),
        scores=(score_before, scored(after)),
        source=source,
        held=held,
        unknown=unknown,
        converters=converters,
        readings=(given.source, given.held) if converters else None,
        recordings=[recording, *([] if hold_out is None else [hold_out])],
        proof=proof,
        explained=explained,
        residual=residual,
        warnings=[*warnings, *data.warnings, *(Problem(note, severity="warning") for note in refined)],
    )
    return in_words(found)


def material_effects(named: Named, scored: Callable[[Fit], Score]) -> Named:
    """Return a search without effects that do not show in runs that took no part, each beside those found before."""
    while named.chosen and named.explains:
        less = without_last(named)
        if is_material(scored(less.fit), scored(named.fit), less.fit, named.fit):
            break
        named = less
    base = named.base
    if named.chosen and named.explains and not is_material(scored(base), scored(named.fit), base, named.fit):
        return without_effects(named)
    return named


@dataclass(frozen=True, eq=False)
class _Data:
    """What a diagnosis is made from, what it is scored with, and what was left out of both."""

    source: Source
    held: tuple[Held, ...]
    warnings: tuple[Problem, ...]


def _prepared(
    empty: Source,
    hold_out: Recording | None,
    steps: Mapping[str, Step],
    earlier: Sequence[Problem],
    picked: Sequence[float] = (),
    drifts: Mapping[str, float] = MappingProxyType({}),
) -> _Data:
    """Return the harmonics of recordings whose signals went through converters of known steps.

    picked: frequencies [Hz] of lines that channels pick up, and that no part of the machine makes. drifts: of the
    offsets of channels (`rotorsim.diagnosis.evidence.drifts`).
    """
    recording = through_converters(empty.recording, steps)
    hold_out = None if hold_out is None else through_converters(hold_out, steps)
    warnings: list[Problem] = []
    harmonics = _settled(tuple(harmonics_of(recording, recording.select("identify"))), warnings, "used")
    if not harmonics:
        hint = "diagnosis needs runs at constant speed that have settled"
        settled = Problem("no run has a settled motion", recording.name, hint=hint)
        raise RotorsimError(settled, *earlier, *warnings, exit_code=1)
    harmonics, lines = with_pickups(recording, harmonics, picked)
    warnings += pickup_warnings(lines, recording, "is picked up", "it is fitted beside the harmonics, as no physics")
    harmonics = with_drifts(harmonics, drifts)
    second = find_asynchronous(recording, harmonics)
    if second is not None:
        told = _beside(recording, harmonics, second, warnings, "used")
        second, harmonics = (second, told) if told else (None, harmonics)
    source = replace(empty, recording=recording, harmonics=harmonics, second=second)
    return _Data(source, _held(recording, hold_out, second, picked, drifts, warnings), tuple(warnings))


class _Scores:
    """Scores fits on held-out runs, or on runs left out one by one; each once."""

    def __init__(self, source: Source, held: tuple[Held, ...]) -> None:
        self.source, self.held = source, held
        self.known: dict[Fit, Score] = {}

    def __call__(self, fit: Fit) -> Score:
        if fit not in self.known:
            document = values_in(fit.document, fit.values)
            scored = score(document, self.source, self.held) if self.held else left_out_score(document, self.source)
            self.known[fit] = scored
        return self.known[fit]


def _checked(recording: Recording) -> list[Problem]:
    problems = [*recording.warnings, *check_signals(recording)]
    if any(problem.severity == "error" for problem in problems):
        raise RotorsimError(*problems, exit_code=1)
    return problems


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
    """Return runs with lines of a second frequency fitted; those that cannot tell them from harmonics are left out."""
    kept, lost = with_asynchronous(recording, runs, second)
    near = "lines that do not follow the shaft are too near to its harmonics"
    warnings += [Problem(f"{near}: it is not {use}", f"run {name}", severity="warning") for name in lost]
    return kept


def _held(
    recording: Recording,
    hold_out: Recording | None,
    second: Asynchronous | None,
    picked: Sequence[float],
    drifts: Mapping[str, float],
    warnings: list[Problem],
) -> tuple[Held, ...]:
    """Return the runs that are only scored; those that do not follow the shaft are left out, with a warning."""
    found = []
    parts = [(recording, recording.select("hold_out")), *([] if hold_out is None else [(hold_out, hold_out.runs)])]
    for part, runs in parts:
        kept = _settled(tuple(harmonics_of(part, runs)) if runs else (), warnings, "scored")
        kept = with_drifts(with_pickups(part, kept, picked)[0], drifts)
        if kept and second is not None:
            kept = _beside(part, kept, second, warnings, "scored")
        found += [Held(part, kept)] if kept else []
    return tuple(found)


def _settled(runs: Sequence[RunHarmonics], warnings: list[Problem], use: str) -> tuple[RunHarmonics, ...]:
    """Return the runs whose signals follow the shaft, and warn of the others."""
    kept = []
    for item in runs:
        if (item.fit.residual > SETTLED * item.fit.rms).all():
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
