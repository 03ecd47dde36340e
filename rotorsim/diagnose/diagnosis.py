"""From a diagram and a recording to a diagnosis: what is missing, where, the repaired diagram, and the proof."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from rotorsim.diagnose.base import base_fit, with_uncertain
from rotorsim.diagnose.conclusions import Diagnosis, concluded, effects_of, in_words, nearest, unknown_of, verdict_of
from rotorsim.diagnose.fitting import Fit, Source
from rotorsim.diagnose.naming import NEARLY, name_missing
from rotorsim.diagnose.scoring import DETAILS, Held, Score, left_out_score, predicts, score
from rotorsim.diagnose.time_data import is_in_time
from rotorsim.diagnose.time_diagnosis import diagnose_in_time
from rotorsim.diagnose.values import values_in
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.registry import Registry
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identify.experiment import Experiment
from rotorsim.recordings.checks import check_signals
from rotorsim.recordings.harmonics import RunHarmonics, harmonics_of
from rotorsim.recordings.recording import Recording
from rotorsim.recordings.second_frequency import Second, find_second, with_second

__all__ = ["Diagnosis", "diagnose"]

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
    Raises RotorsimError for recordings with errors, and what `rotorsim.identify.experiment.open_experiment` raises.
    """
    warnings = [*_checked(recording), *([] if hold_out is None else _checked(hold_out))]
    if is_in_time(diagram, recording):
        return diagnose_in_time(
            diagram, recording, hold_out=hold_out, physics=physics, warnings=warnings, trust_blocks=trust_blocks,
            workers=workers, scheduler=scheduler, progress=progress,
        )  # fmt: skip
    harmonics = _settled(tuple(harmonics_of(recording, recording.select("identify"))), warnings, "used")
    if not harmonics:
        hint = "diagnosis needs runs at constant speed that have settled"
        raise RotorsimError(Problem("no run has a settled motion", recording.name, hint=hint), *warnings, exit_code=1)
    folder = str(Path(diagram.file).parent) if diagram.file else None
    second = find_second(recording, harmonics)
    if second is not None:
        told = _beside(recording, harmonics, second, warnings, "used")
        second, harmonics = (second, told) if told else (None, harmonics)
    source = Source(recording, harmonics, folder, trust_blocks, second)
    held = _held(recording, hold_out, second, warnings)
    folders = diagram.document.get("block_folders", []) if trust_blocks and folder else []
    registry = Registry([Path(folder or ".") / name for name in folders])
    with threadpool_limits(1, "blas"):
        _refuse_still(source.open(source.load(with_uncertain(diagram))))  # says what is wrong, and where
        base, refined = base_fit(diagram, source)
    if base.failure:
        raise RotorsimError(Problem(base.failure, diagram.name))
    warnings += [Problem(note, severity="warning") for note in refined]
    source = replace(source, standing=base.nuisances)
    named = name_missing(
        base, source, registry=registry, physics=physics, workers=workers, scheduler=scheduler, progress=progress,
    )  # fmt: skip
    effects = effects_of(named)
    scores: dict[Fit, Score] = {}

    def scored(fit: Fit) -> Score:
        if fit not in scores:
            document = values_in(fit.document, fit.values)
            scores[fit] = score(document, source, held) if held else left_out_score(document, source)
        return scores[fit]

    found_some = bool(effects) and (named.explained or named.nearly)
    details = DETAILS if named.explained else 1 - NEARLY  # what is left in the fitted runs may be left there
    disproved = found_some and bool(held) and not predicts(scored(base), scored(named.fit), details)
    verdict = verdict_of(named, effects, alike=source.alike, disproved=disproved)
    unknown = unknown_of(named, effects, source) if verdict == "outside_catalogue" else None
    after = nearest(named, unknown, disproved=disproved)
    found = concluded(
        named, effects, verdict, fits=(base, after), scores=(scored(base), scored(after)), source=source, held=held,
        unknown=unknown, warnings=warnings, disproved=scored(named.fit) if disproved else None,
    )  # fmt: skip
    return in_words(found)


def _checked(recording: Recording) -> list[Problem]:
    problems = [*recording.warnings, *check_signals(recording)]
    if any(problem.severity == "error" for problem in problems):
        raise RotorsimError(*problems, exit_code=1)
    return problems


def _refuse_still(experiment: Experiment) -> None:
    """Refuse signals that stand still though the diagram moves them."""
    problems = [
        Problem(
            "is constant: no diagram explains a shaft that turns and does not move it", f"run {item.run.id}: {name}",
            item.run.place, "leave the channel out of recording.json if its sensor is dead",
        )
        for item in experiment.runs for name in experiment.predicted if item.fit.rms[item.fit.names.index(name)] == 0
    ]  # fmt: skip
    if problems:
        raise RotorsimError(*problems, exit_code=1)


def _beside(
    recording: Recording, runs: Sequence[RunHarmonics], second: Second, warnings: list[Problem], use: str
) -> tuple[RunHarmonics, ...]:
    """Return runs with lines of a second frequency fitted; those that cannot tell them from harmonics are left out."""
    kept, lost = with_second(recording, runs, second)
    near = "lines that do not follow the shaft are too near to its harmonics"
    warnings += [Problem(f"{near}: it is not {use}", f"run {name}", severity="warning") for name in lost]
    return kept


def _held(
    recording: Recording, hold_out: Recording | None, second: Second | None, warnings: list[Problem]
) -> tuple[Held, ...]:
    """Return the runs that are only scored; those that do not follow the shaft are left out, with a warning."""
    found = []
    parts = [(recording, recording.select("hold_out")), *([] if hold_out is None else [(hold_out, hold_out.runs)])]
    for part, runs in parts:
        kept = _settled(tuple(harmonics_of(part, runs)) if runs else (), warnings, "scored")
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
    return tuple(kept)
