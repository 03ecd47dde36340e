"""From a diagram and a recording to a diagnosis: what is missing, where, the repaired diagram, and the proof."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from rotorsim.diagnose.base import base_fit, with_uncertain
from rotorsim.diagnose.fitting import Fit, Source
from rotorsim.diagnose.insertion import Spot
from rotorsim.diagnose.naming import CLASS, Named, least_gain, name_missing, where
from rotorsim.diagnose.outside import Unknown, describe
from rotorsim.diagnose.scoring import Held, Score, left_out_score, score
from rotorsim.diagnose.time_data import is_in_time
from rotorsim.diagnose.trials import Candidate, Round, is_adequate
from rotorsim.diagnose.values import values_in
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.registry import Registry
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identify.experiment import Experiment
from rotorsim.identify.profile import Z90
from rotorsim.recordings.checks import check_signals
from rotorsim.recordings.harmonics import RunHarmonics, harmonics_of
from rotorsim.recordings.recording import Recording
from rotorsim.recordings.second_frequency import Second, find_second, with_second

__all__ = ["VERDICTS", "Diagnosis", "Effect", "diagnose"]

VERDICTS = ("consistent", "missing_physics", "outside_catalogue", "not_identifiable")
LIKELY = 0.01  # probability from which a place or a member of a class is listed
MOST_CLASS = 4  # physics that explain the data alike, beyond which nothing is named
SETTLED = 0.5  # of the rms of all signals: what harmonics leave over of a run that has no settled motion
REJECTED = 12  # rivals that are listed


@dataclass(frozen=True, eq=False)
class Effect:
    """One missing effect: the chosen candidate, its class with probabilities, the places with probabilities.

    rivals: of the other members of the class the best candidate each.
    """

    candidate: Candidate
    members: Mapping[str, float]
    rivals: Mapping[str, Candidate]
    places: tuple[tuple[Spot, float], ...]

    @property
    def physics(self) -> str:
        """The name of the physics."""
        return self.candidate.insertion.physics


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer to why a diagram and a recording differ; see `diagnose`.

    effects: what is missing (or, outside the catalogue, what was nearest). before, after: fits of the diagram as
    given and repaired; document: the repaired one. scores: hold-out NRMSE of both. rejected: (physics, why).
    detectable: physics -> smallest size that would have been seen, with its unit, where nothing was found.
    """

    verdict: str
    effects: tuple[Effect, ...]
    places: tuple[tuple[Spot, float], ...]
    rejected: tuple[tuple[str, str], ...]
    before: Fit
    after: Fit
    document: Mapping[str, Any]
    score_before: Score
    score_after: Score
    next_experiment: str
    statement: str
    named: Named
    warnings: tuple[Problem, ...] = ()
    detectable: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    outside: Mapping[str, Any] = field(default_factory=dict)
    source: Source | None = None
    held: tuple[Held, ...] = ()


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
        from rotorsim.diagnose.time_diagnosis import diagnose_in_time

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
        harmonics = _beside(recording, harmonics, second, warnings, "used")
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
    named = name_missing(
        base, source, registry=registry, physics=physics, workers=workers, scheduler=scheduler, progress=progress,
    )  # fmt: skip
    effects = tuple(_effect(item, found, named.slack) for item, found in zip(named.chosen, named.rounds, strict=False))
    verdict = _verdict(named, effects, source)
    places = _places(named, effects)
    unknown = _unknown(named, source, places) if verdict == "outside_catalogue" else None
    after = named.fit if unknown is None or unknown.fit is None else min(unknown.fit, named.fit, key=_criterion)
    document = values_in(after.document, after.values)
    first = values_in(named.base.document, named.base.values)
    scores = [score(d, source, held) if held else left_out_score(d, source) for d in (first, document)]
    found = Diagnosis(
        verdict=verdict,
        effects=effects,
        places=places,
        rejected=_rejected(named, effects),
        before=named.base,
        after=after,
        detectable=_detectable(named) if verdict == "consistent" else {},
        outside={} if unknown is None else {**unknown.data, "description": unknown.description},
        document=document,
        score_before=scores[0],
        score_after=scores[1],
        next_experiment="",
        statement="",
        named=named,
        warnings=tuple(warnings),
        source=source,
        held=held,
    )
    from rotorsim.diagnose.wording import next_experiment, statement

    found = replace(found, next_experiment=next_experiment(found))
    return replace(found, statement=statement(found))


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
    if not kept:
        return tuple(runs)
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


def _effect(candidate: Candidate, found: Round, slack: float = 0.0) -> Effect:
    """Return an effect with the physics and places that explain the data as well; slack: see `Named`."""
    scale = max(candidate.fit.misfit / candidate.fit.freedom, 1.0)
    best: dict[str, float] = {}
    for item in found.tried:
        if not item.fit.failure and item.physical:
            more = item.fit.criterion - candidate.fit.criterion - slack
            best[item.insertion.physics] = min(best.get(item.insertion.physics, np.inf), max(more, 0.0) / scale)
    best[candidate.insertion.physics] = 0.0
    near = {name: value for name, value in best.items() if value <= CLASS}
    weights = {name: float(np.exp(-0.5 * value)) for name, value in near.items()}
    total = sum(weights.values())
    members = {name: weight / total for name, weight in sorted(weights.items(), key=lambda pair: -pair[1])}
    same = [item for item in found.tried if item.insertion.physics in members]
    places = tuple((spot, p) for spot, p in where(same, scale) if p >= LIKELY)
    rivals: dict[str, Candidate] = {}
    for item in found.tried:
        name = item.insertion.physics
        if name in members and name != candidate.insertion.physics and not item.fit.failure and item.physical:
            rivals.setdefault(name, item)
    return Effect(candidate, members, rivals, places)


def _verdict(named: Named, effects: Sequence[Effect], source: Source | None = None) -> str:
    if not effects and is_adequate(named.base) and source is not None and source.alike:
        return "not_identifiable"  # one speed is explained by anything
    if not effects:
        return "consistent" if is_adequate(named.base) else "outside_catalogue"
    if not named.explained:
        return "outside_catalogue"
    if any(len(effect.members) > MOST_CLASS for effect in effects):
        return "not_identifiable"
    return "missing_physics"


def _criterion(fit: Fit) -> float:
    return fit.criterion


def _unknown(named: Named, source: Source, places: Sequence[tuple[Spot, float]]) -> Unknown | None:
    """Return what is known of a force outside the catalogue, at the likeliest place where a force can act."""
    acting = {
        item.insertion.spot for found in named.rounds for item in found.tried if item.insertion.fault.enters == "force"
    }
    spots = [spot for spot, _ in places if spot in acting] or sorted(acting, key=str)
    return describe(named.base, source, spots[0]) if spots else None


def _detectable(named: Named) -> dict[str, dict[str, Any]]:
    """Return for each physics the smallest size that would have been seen: its first parameter, where it is linear."""
    out: dict[str, dict[str, Any]] = {}
    for item in named.rounds[0].tried:
        fit, physics = item.fit, item.insertion.physics
        if physics in out or fit.failure or fit.nonlinear or not item.parameters or not item.physical:
            continue
        j = [free.name for free in fit.free].index(item.parameters[0])
        std = float(np.sqrt(max(fit.covariance[j, j], 0.0)))
        if np.isfinite(std) and std > 0:
            key = item.parameters[0].rpartition(".")[2]
            out[physics] = {
                "parameter": key,
                "value": float(np.sqrt(least_gain(item, named.base, named.level))) * std,
                "unit": fit.free[j].unit,
            }
    return out


def _places(named: Named, effects: Sequence[Effect]) -> tuple[tuple[Spot, float], ...]:
    found: dict[Spot, float] = {}
    for effect in effects:
        for spot, probability in effect.places:
            found[spot] = max(found.get(spot, 0.0), probability)
    if not effects and not is_adequate(named.base):
        scale = max(named.base.misfit / named.base.freedom, 1.0)
        found = dict(where(named.rounds[0].tried, scale))
    return tuple(sorted(((s, p) for s, p in found.items() if p >= LIKELY), key=lambda pair: -pair[1]))


def _rejected(named: Named, effects: Sequence[Effect]) -> tuple[tuple[str, str], ...]:
    """Return the rivals of the first effect and why they lost, the nearest first."""
    if not effects:
        return ()
    out: dict[str, str] = {}
    members = {name for effect in effects for name in effect.members}
    best = effects[0].candidate.fit
    for item in named.rounds[0].tried:
        name = item.insertion.physics
        if name in members or name in out:
            continue
        out[name] = _why(item, best)
        if len(out) >= REJECTED:
            break
    return tuple(out.items())


def _why(item: Candidate, best: Fit) -> str:
    fit = item.fit
    if fit.failure:
        return f"cannot be fitted: {fit.failure}"
    if not item.physical:
        names = [free.name for free in fit.free]
        ended = [name for name in item.parameters if fit.at_bound[names.index(name)]]
        return f"its {', '.join(name.rpartition('.')[2] for name in ended)} ended at a physical bound"
    if fit.misfit > 2 * best.misfit:
        left = fit.misfit / fit.freedom
        return f"leaves {left:.3g} times the variance of the noise, against {best.misfit / best.freedom:.3g}"
    more = len(fit.free) - len(best.free)
    lost = float(fit.left_out.sum() - best.left_out.sum())
    if more > 0:
        return f"needs {more} more parameters and predicts runs left out no better (misfit {lost:+.3g})"
    return f"explains the data less well: criterion higher by {fit.criterion - best.criterion:.3g}"


def interval(value: float, std: float) -> tuple[float, float]:
    """Return the 90 % interval of an estimate."""
    return value - Z90 * std, value + Z90 * std
