"""From a diagram and a recording to a diagnosis: what is missing, where, the repaired diagram, and the proof."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude import verdict as verdicts
from rotorsim.diagnosis.conclude.disturbance import disturbed
from rotorsim.diagnosis.conclude.result import Diagnosis, Effect, taken_twice, untried_of
from rotorsim.diagnosis.conclude.shares import Explained, explanations, residual_of
from rotorsim.diagnosis.conclude.unknown_force import UnknownForce
from rotorsim.diagnosis.conclude.validation import Proof, contradicts, is_faint, material_effects, prove, prove_by_error
from rotorsim.diagnosis.conclude.wording import next_experiment, statement
from rotorsim.diagnosis.evidence.disturbance import is_unpredicted
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.diagnosis.evidence.open import Opened, open_evidence
from rotorsim.diagnosis.search.selection import Selection, select_effects, with_faint, without_effects
from rotorsim.diagnosis.search.work import Work
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.jobs import Jobs, local_workers
from rotorsim.jobs.threads import one_thread, threads
from rotorsim.measure.checks import check_signals
from rotorsim.model.heard import listener, said
from rotorsim.model.load import load_standalone
from rotorsim.recordings.orders import OrderRecording, renamed
from rotorsim.recordings.recording import Recording

__all__ = ["Diagnosis", "diagnose"]

RECALIBRATIONS = 2  # of the noise by what the effects leave, each of which begins the search anew


@said
def diagnose(
    diagram: Diagram,
    recording: Recording | OrderRecording,
    *,
    hold_out: Recording | OrderRecording | None = None,
    physics: Collection[str] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    jobs: Jobs | None = None,
    progress: Callable[[float], None] | None = None,
) -> Diagnosis:
    """Return what a diagram lacks to explain a recording.

    The free parameters of the diagram are refitted; if noise does not explain the residual, every declared fault
    (`rotorsim.fault.Fault`) is tried at every place; physics: only these. hold_out: further runs that take part in no
    fit. Sub-diagrams are dissolved first: their blocks are named as there is place for them, which a warning tells.
    workers, scheduler, progress: see `rotorsim.jobs.jobs.run_jobs`. jobs: instead of scheduler and workers,
    processes that are kept (`rotorsim.jobs.jobs.local_workers`).
    Raises RotorsimError for recordings with errors, and for those that do not fit the diagram.
    """
    how = Jobs(workers, scheduler, progress) if jobs is None else replace(jobs, progress=progress)
    diagram, alone = load_standalone(diagram)
    recording = renamed(recording, alone.named)
    hold_out = None if hold_out is None else renamed(hold_out, alone.named)
    warnings = [*alone.notes, *_checked(recording), *([] if hold_out is None else _checked(hold_out))]
    warnings += parts_without_role(diagram)
    with local_workers(how, __name__) as kept, threads(kept.pool.size if kept.pool else 1):  # which waits meanwhile
        return _diagnosed(diagram, recording, hold_out, physics, kept, warnings)


def _diagnosed(
    diagram: Diagram,
    recording: Recording | OrderRecording,
    hold_out: Recording | OrderRecording | None,
    physics: Collection[str] | None,
    jobs: Jobs,
    warnings: Sequence[Problem],
) -> Diagnosis:
    """Return what a diagram lacks to explain a recording that can be read; see `diagnose`."""
    with one_thread():
        opened = open_evidence(diagram, recording, hold_out, Catalogue.of(diagram, physics), warnings)
    if opened.base.failure:
        raise RotorsimError(Problem(opened.base.failure, diagram.name), exit_code=1 if listener().mishaps else 2)
    evidence, selection = opened.evidence, select_effects(opened.base, opened.evidence, opened.catalogue, jobs)
    found = fitted_again(opened.base, selection, evidence)
    if found is not None:
        opened = replace(opened, base=found, before=found if opened.before is opened.base else opened.before)
        selection = select_effects(found, evidence, opened.catalogue, jobs)
    base = opened.base
    for n in range(RECALIBRATIONS):
        with one_thread():
            worth = selection.explains if n else bool(selection.chosen)
            quieter = evidence.recalibrated(selection.fit) if worth else None
            base = base if quieter is None else quieter.at(opened.base)
        if quieter is None:
            break
        evidence, selection = quieter, select_effects(base, quieter, opened.catalogue, jobs, selection)
    with one_thread():
        diagnosis = _concluded(replace(opened, evidence=evidence, base=base), selection, jobs)
    recordings = (recording, *(() if hold_out is None else (hold_out,)))
    diagnosis = replace(
        diagnosis, recordings=recordings, warnings=(*diagnosis.warnings, *verdicts.conventions(diagnosis.effects))
    )
    diagnosis = replace(diagnosis, next_experiment=next_experiment(diagnosis), statement=statement(diagnosis))
    inserted = [effect.candidate.insertion.name for effect in diagnosis.effects]
    with one_thread():
        remarks = diagnosis.evidence.remarks(diagnosis.before, diagnosis.after, inserted)
    return replace(diagnosis, statement=" ".join([diagnosis.statement, *remarks]))


def fitted_again(base: Fit, selection: Selection, evidence: Evidence) -> Fit | None:
    """Return the fit of the diagram from its parameters beside what leaves least, where it then explains the data.

    Its first fit ended in another minimum, from which any law may lead on; else None.
    """
    nearest = selection.first.nearest
    if is_adequate(base) or nearest is None or not is_adequate(nearest.fit):
        return None
    start = {item.name: nearest.fit.values[item.name] for item in base.free if item.name in nearest.fit.values}
    with one_thread():
        again = evidence.fit(base.document, [[start]])
    return again if is_adequate(again) else None


def parts_without_role(diagram: Diagram) -> list[Problem]:
    """Return warnings of parts with equations of their own that no fault of a machine's parts is tried at."""
    what = "its ports do not say what it is: faults of rotors, bearings and controllers are not tried there"
    hint = '"ports" among its parameters names them: displacement, velocity, current, force'
    return [
        Problem(what, name, node.place, hint, severity="warning")
        for name, node in diagram.nodes.items()
        if node.block.opaque and node.block.roles == {node.block.category}
    ]


def _checked(recording: Recording | OrderRecording) -> list[Problem]:
    if isinstance(recording, OrderRecording):
        return [*recording.warnings]
    problems = [*recording.warnings, *check_signals(recording)]
    if any(problem.severity == "error" for problem in problems):
        raise RotorsimError(*problems, exit_code=1)
    return problems


@dataclass(frozen=True, eq=False)
class _Judged:
    """A selection with its effects, what hold-out runs say of them, and the verdict."""

    selection: Selection
    effects: tuple[Effect, ...]
    verdict: str
    proof: Proof | None

    @property
    def disproved(self) -> bool:
        return self.proof is not None and self.proof.status == "disproved"

    @property
    def outside(self) -> bool:
        return self.verdict == "outside_catalogue"


def _judged(opened: Opened, selection: Selection) -> _Judged:
    """Return a selection without what hold-out runs do not show, and the verdict that follows."""
    evidence, validation, converters = opened.evidence, opened.evidence.validation, opened.converters
    proof: Proof | None = None
    faint = contradicted = False
    if validation is not None:
        contradicted = validation.held_out and contradicts(selection.base, validation.score(selection.base))
        selection = with_faint(selection) if contradicted and not selection.chosen else selection
        selection = material_effects(selection, validation.score)
        if (selection.chosen or converters) and selection.explains:
            left = 0.0 if selection.explained else max(1 - selection.share, 0.0)
            scores = validation.score(selection.base), validation.score(selection.fit)
            grows = any(item.insertion.grows for item in selection.chosen)
            proof = prove(*scores, left=left, held=validation.held_out, drifting=grows, converters=bool(converters))
        faint = is_faint(selection.base, validation.score(selection.base)) and not validation.is_force(selection.base)
    elif opened.held_out and not evidence.independent and selection.chosen and selection.explains:
        proof = prove_by_error(evidence.score(selection.base), evidence.score(selection.fit))
    disproved = proof is not None and proof.status == "disproved"
    if (faint or contradicted) and (disproved or not selection.explains):
        selection = without_effects(selection)
    effects = verdicts.effects_of(selection)
    verdict = verdicts.verdict_of(
        selection,
        effects,
        alike=evidence.alike or bool(evidence.unjudged),
        disproved=disproved,
        converters=bool(converters),
        faint=faint,
        contradicted=contradicted,
    )
    if verdict == "consistent" and evidence.structure(selection.fit):
        verdict = "outside_catalogue"
    if verdict == "consistent" and untried_of(selection):
        verdict = "not_identifiable"
    if verdict == "missing_physics":
        imitates = verdicts.is_no_explanation(selection, evidence.unexplained(selection.fit))
        verdict = "outside_catalogue" if imitates or taken_twice(effects) else verdict
    return _Judged(selection, effects, verdict, proof)


def _repaired(opened: Opened, judged: _Judged, unknown: UnknownForce | None) -> tuple[Evidence, Fit, Fit]:
    """Return the fits of the diagram as given and repaired, and the evidence, whose noise is what the better leaves."""
    evidence, selection = opened.evidence, judged.selection
    before = opened.before if opened.converters else selection.base
    after = verdicts.nearest(selection, unknown, disproved=judged.disproved)
    if judged.outside or not selection.chosen:
        return evidence, evidence.widened(before), evidence.widened(after)
    laws = [item.insertion for item in selection.chosen]
    evidence, after = evidence.sharpened(after, laws)
    after = evidence.finished(after, laws)
    quieter = evidence.recalibrated(after)
    if quieter is not None:
        evidence, before, after = quieter, quieter.at(before), quieter.fit(after.document, [[after.values]])
    return evidence, evidence.widened(before), evidence.widened(after)


def _concluded(opened: Opened, selection: Selection, jobs: Jobs) -> Diagnosis:
    """Return the diagnosis without its words."""
    validation, converters = opened.evidence.validation, opened.converters
    judged = _judged(opened, selection)
    selection, effects, verdict, proof = judged.selection, judged.effects, judged.verdict, judged.proof
    unknown = verdicts.unknown_of(selection, effects, Work(opened.evidence, jobs)) if judged.outside else None
    evidence, before, after = _repaired(opened, judged, unknown)
    if not judged.outside and after is not selection.fit:
        effects = tuple(replace(item, candidate=replace(item.candidate, fit=after)) for item in effects)
    explained: tuple[Explained, ...] = ()
    residual = None
    if validation is not None and verdict == "missing_physics":
        explained = explanations(selection, validation)
    if validation is not None and verdict in ("missing_physics", "consistent"):
        residual = residual_of(selection.base, after, validation)
    signals = verdicts.signals_of(selection, effects, after, evidence, verdict)
    unpredicted = verdict == "outside_catalogue" and is_unpredicted(selection.base, signals, evidence)
    open_ = judged.outside or (selection.mostly and not selection.explained)
    found = disturbed(selection, evidence, opened.catalogue) if open_ and not converters else None
    beside = effects[: 0 if found is None else len(found.selection.chosen)]
    named = all(len(item.members) <= CRITERIA.most_equivalent for item in beside) and not taken_twice(beside)
    if found is not None and named:
        verdict, unknown, proof, after = "missing_physics", None, None, found.fit
        effects = tuple(replace(item, candidate=replace(item.candidate, fit=after)) for item in beside)
        signals = verdicts.signals_of(found.selection, effects, after, evidence, verdict) if effects else ()
        effects, signals = (*effects, found.effect), (*signals, found.signal)
    every = (*effects, *(verdicts.converter_effect(item, selection.fit) for item in converters))
    terms, outside = evidence.terms, verdict == "outside_catalogue"
    places = () if verdict == "consistent" else verdicts.places_of(selection, every, outside=outside)
    return Diagnosis(
        verdict=verdict,
        effects=every,
        before=before,
        after=after,
        document=values_in(after.document, after.values),
        score_before=opened.given.score(before) if converters else evidence.score(before),
        score_after=evidence.score(after),
        selection=selection,
        evidence=evidence,
        given=opened.given,
        recordings=(),
        held_out=opened.held_out,
        places=places,
        rejected=(*verdicts.rejected_of(selection, effects, terms), *(opened.screened if effects else ())),
        open=verdicts.unfinished(selection, effects, terms),
        warnings=tuple(opened.warnings),
        detectable=verdicts.detectable_sizes(selection) if verdict == "consistent" else {},
        signals=signals,
        unknown=unknown,
        unpredicted=unpredicted,
        proof=proof,
        explained=explained,
        residual=residual,
        converters=converters,
    )
