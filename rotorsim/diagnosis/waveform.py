"""The diagnosis of recordings in time: the same steps as for a shaft, on the errors of simulated runs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.conclusions import (
    Diagnosis,
    Effect,
    concluded,
    effects_of,
    in_words,
    nearest,
    unknown_of,
    verdict_of,
)
from rotorsim.diagnosis.conclude.waveform_wording import (
    errors_in_words,
    in_terms,
    of_what_rests,
    units_in_words,
    what_controllers_obey,
    what_is_left,
)
from rotorsim.diagnosis.evidence.base import base_fit
from rotorsim.diagnosis.evidence.harmonic import Fit, Source
from rotorsim.diagnosis.evidence.resonance.fitting import is_by_resonances
from rotorsim.diagnosis.evidence.scoring import Held
from rotorsim.diagnosis.evidence.waveform.data import TimeRun, read_run
from rotorsim.diagnosis.evidence.waveform.reference import judged_by, open_time_source
from rotorsim.diagnosis.evidence.waveform.scoring import left_out_in_time, score_in_time
from rotorsim.diagnosis.evidence.waveform.source import TimeSource
from rotorsim.diagnosis.search.naming import Named, name_missing
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording

__all__ = ["diagnose_in_time"]

TERMS = {  # of the wording for shafts
    "runs left out": "stretches left out",
    "runs at more speeds and amplitudes": "runs at more amplitudes and frequencies of what drives it",
    "change the unbalance or the gains at one speed": "drive it harder and more softly",
    "change it at one speed, by unbalance or gains": "drive it harder and more softly",
    "loss over a wide range of speeds: viscous loss grows with speed": "loss over a wide range of frequencies",
}
SURPASSED = 0.5  # of the variance that the flexible model leaves: a fit that leaves less takes its place


def diagnose_in_time(
    diagram: Diagram,
    recording: Recording,
    *,
    hold_out: Recording | None = None,
    physics: Collection[str] | None = None,
    warnings: Sequence[Problem] = (),
    trust_blocks: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Diagnosis:
    """Return what a diagram lacks to explain a recording that is no settled motion of a shaft.

    See `rotorsim.diagnosis.diagnosis.diagnose`; what noise is, and what is adequate: `evidence.waveform.source`.
    Raises RotorsimError for recordings that do not fit the diagram.
    """
    registry = _registry(diagram, trust_blocks)
    if is_by_resonances(diagram, recording):
        from rotorsim.diagnosis.resonance import diagnose_modes

        return diagnose_modes(
            diagram,
            recording,
            hold_out=hold_out,
            registry=registry,
            physics=physics,
            warnings=warnings,
            trust_blocks=trust_blocks,
            workers=workers,
            scheduler=scheduler,
            progress=progress,
        )
    with one_thread():
        source = open_time_source(diagram, recording, trust_blocks=trust_blocks)
        held = _held(diagram, source, recording, hold_out)
        base, refined = base_fit(diagram, cast(Source, source))
    if base.failure:
        raise RotorsimError(Problem(base.failure, diagram.name))
    options: dict[str, Any] = {
        "registry": registry,
        "physics": physics,
        "workers": workers,
        "scheduler": scheduler,
        "progress": progress,
    }
    named = name_missing(base, cast(Source, source), **options)
    if named.chosen and _surpasses(named.fit):
        with one_thread():
            source = judged_by(source, named.fit)
            base = source.at(base)
        named = name_missing(base, cast(Source, source), **options)
    effects = effects_of(named)
    verdict = "outside_catalogue" if _is_twice(effects) else verdict_of(named, effects)
    unknown = None
    with one_thread():
        after, before = _with_shapes(named, source), named.base
        if verdict == "outside_catalogue":
            unknown = unknown_of(named, effects, cast(Source, source))
            after = nearest(named, unknown)
        elif named.chosen and _surpasses(after):  # what it leaves is the better measure of the noise
            source = judged_by(source, after)
            after, before = source.fit(after.document, [[after.values]]), source.at(before)
        documents = [values_in(fit.document, fit.values) for fit in (before, after)]
        scores = [score_in_time(d, source, held) if held else left_out_in_time(d, source) for d in documents]
    if unknown is None:
        effects = tuple(replace(item, candidate=replace(item.candidate, fit=after)) for item in effects)
    found = concluded(
        named,
        effects,
        verdict,
        fits=(before, after),
        scores=scores,
        source=cast(Source, source),
        unknown=unknown,
        held=tuple(Held(part, ()) for part in (recording, hold_out) if part is not None) if held else (),
        warnings=(*of_what_rests(warnings), *(Problem(note, severity="warning") for note in refined)),
    )
    found = in_words(found)
    words = [
        *what_is_left(found),
        *errors_in_words(source, found, held),
        *what_controllers_obey(source),
        *units_in_words(source, found),
    ]
    twice = " and ".join(effect.physics for effect in effects) if _is_twice(effects) else ""
    terms = {f"the nearest, {twice},": f"{twice}, which stand for a law that is neither,"} if twice else {}
    return in_terms(replace(found, statement=" ".join([found.statement, *words])), {**TERMS, **terms})


def _is_twice(effects: Sequence[Effect]) -> bool:
    """Return whether one effect was taken twice at one place: together they stand for a law that neither has."""
    keys = [(effect.physics, effect.candidate.insertion.spot) for effect in effects]
    return len(set(keys)) < len(keys)


def _surpasses(fit: Fit) -> bool:
    return fit.misfit < SURPASSED * fit.freedom


def _registry(diagram: Diagram, trust_blocks: bool) -> Registry:
    folders = diagram.document.get("block_folders", []) if trust_blocks and diagram.file else []
    return Registry([Path(diagram.file).parent / name for name in folders])


def _held(
    diagram: Diagram, source: TimeSource, recording: Recording, hold_out: Recording | None
) -> tuple[TimeRun, ...]:
    runs = [*recording.select("hold_out"), *(hold_out.runs if hold_out is not None else ())]
    return tuple(read_run(diagram, run, source.channels) for run in runs)


def _with_shapes(named: Named, source: TimeSource) -> Fit:
    """Return the fit with what the faults state once (the width of a step) free as well, if that explains more."""
    document = {**named.fit.document, "identify": dict(named.fit.document.get("identify", {}))}
    fixed = [f"{item.insertion.name}.{key}" for item in named.chosen for key in item.insertion.fault.fixed]
    if not fixed:
        return named.fit
    document = values_in(document, named.fit.values)
    document["identify"] = {**document["identify"], **{name: {} for name in fixed}}
    found = source.fit(document, [[{}]])
    better = not found.failure and found.criterion < named.fit.criterion
    return found if better and not found.at_bound[-len(fixed) :].any() else named.fit
