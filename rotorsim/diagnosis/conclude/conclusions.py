"""What follows from the rounds of a search: effects with their classes and places, verdict, rivals, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rotorsim._shown import Shown
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.explaining import Explained
from rotorsim.diagnosis.conclude.unknown_force import Unknown, describe
from rotorsim.diagnosis.evidence.harmonic import Fit, Source
from rotorsim.diagnosis.evidence.scoring import Held, Score
from rotorsim.diagnosis.search.converters import Converter
from rotorsim.diagnosis.search.naming import CLASS, Named, least_gain, where
from rotorsim.diagnosis.search.proof import Proof
from rotorsim.diagnosis.search.trials import Candidate, Round, is_noise
from rotorsim.errors import Problem
from rotorsim.identification.profile import Z90
from rotorsim.recordings.recording import Recording

__all__ = [
    "VERDICTS",
    "Diagnosis",
    "Effect",
    "Estimated",
    "concluded",
    "conventions",
    "effects_of",
    "estimates",
    "in_words",
    "interval",
    "nearest",
    "unknown_of",
    "verdict_of",
]

VERDICTS = ("consistent", "missing_physics", "outside_catalogue", "not_identifiable")
LIKELY = 0.01  # probability from which a place or a member of a class is listed
MOST_CLASS = 4  # physics that explain the data alike, beyond which nothing is named: a longer list is no name
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

    def spot_of(self, physics: str) -> Spot | None:
        """Return where a member of the class acts, as it explains the data best; None where it is not known."""
        item = self.candidate if physics == self.physics else self.rivals.get(physics)
        return None if item is None else item.insertion.spot


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Shown):
    """The answer to why a diagram and a recording differ; see `diagnose`.

    effects: what is missing (or, outside the catalogue, what was nearest). before, after: fits of the diagram as
    given and repaired; document: the repaired one. scores: hold-out NRMSE of both. rejected: (physics, why).
    detectable: physics -> smallest size that would have been seen, with its unit, where nothing was found. proof: what
    runs that took no part say of the effects; explained: of each, how much of what is to be explained there; residual:
    what is left over beyond noise (`explaining.residual_of`). converters: that readings show;
    readings: with harmonics as they are, source and held-out runs, where those of ``source`` are of what went into
    converters. recordings: as they were given, held-out ones last.
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
    open: tuple[tuple[str, str], ...] = ()
    proof: Proof | None = None
    explained: tuple[Explained, ...] = ()
    residual: Mapping[str, Any] | None = None
    converters: tuple[Converter, ...] = ()
    readings: tuple[Source, tuple[Held, ...]] | None = None
    recordings: tuple[Recording, ...] = ()

    _figure = "rotorsim.report.diagnosis.compared:before_and_after_figure"

    def __repr__(self) -> str:
        return f"Diagnosis({self.verdict}: {self.statement})"

    @property
    def searched(self) -> tuple[Effect, ...]:
        """The effects that a search found, without the converters that readings show."""
        return tuple(effect for effect in self.effects if not effect.candidate.insertion.from_steps)

    def taken(self, effect: Effect) -> dict[str, tuple[float, float, str]]:
        """Return the parameters of an effect that the data gave by themselves: value, standard deviation, unit."""
        insertion = effect.candidate.insertion
        second = getattr(self.source, "second", None)
        out = {} if second is None else dict.fromkeys(insertion.from_lines, (second.value, second.std, "rad/s"))
        for converter in self.converters:
            if converter.insertion is insertion:
                step = converter.step
                out |= {
                    key: (step.size, step.std, insertion.kind.parameters[key].unit or "")
                    for key in insertion.from_steps
                }
        return out


def effects_of(named: Named) -> tuple[Effect, ...]:
    """Return the effects that were chosen, each with what explains the data as well."""
    return tuple(_effect(item, found, named.slack) for item, found in zip(named.chosen, named.rounds, strict=False))


def _effect(candidate: Candidate, found: Round, slack: float) -> Effect:
    """Return an effect with the physics and places that explain the data as well; slack: see `Named`.

    It is compared as it was in that round: its rivals stood beside the same others.
    """
    candidate = _as_tried(candidate, found)
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
    same = [candidate, *(item for item in found.tried if item.insertion.physics in members)]  # it is there, if all fail
    places = tuple((spot, p) for spot, p in where(same, scale) if p >= LIKELY)
    rivals: dict[str, Candidate] = {}
    for item in found.tried:
        name = item.insertion.physics
        if name in members and name != candidate.insertion.physics and not item.fit.failure and item.physical:
            rivals.setdefault(name, item)
    return Effect(candidate, members, rivals, places)


def _as_tried(candidate: Candidate, found: Round) -> Candidate:
    """Return a candidate with the fit that it has in a round."""
    same = (item.fit for item in found.tried if item.insertion.key == candidate.insertion.key and not item.fit.failure)
    return Candidate(candidate.insertion, next(same, candidate.fit))


def verdict_of(
    named: Named,
    effects: Sequence[Effect],
    *,
    alike: bool = False,
    disproved: bool = False,
    converters: bool = False,
    faint: bool = False,
) -> str:
    """Return one of VERDICTS.

    alike: all runs have one speed and the same settings, which anything explains. disproved: with the effects the
    diagram does not predict runs that took no part. converters: readings show steps that the diagram lacks. faint: what
    the diagram leaves over is so little that only a named cause makes it physics.
    """
    told = bool(effects) and not disproved and named.explains
    if not told and (faint or (not effects and is_noise(named.base))):
        if converters:
            return "outside_catalogue" if disproved else "missing_physics"
        return "not_identifiable" if alike else "consistent"
    if not told:
        return "outside_catalogue"
    if any(len(effect.members) > MOST_CLASS for effect in effects):
        return "not_identifiable"
    return "missing_physics"


def unknown_of(named: Named, effects: Sequence[Effect], source: Source) -> Unknown | None:
    """Return what is known of a force outside the catalogue, at the likeliest place where a force can act."""
    acting = {
        item.insertion.spot for found in named.rounds for item in found.tried if item.insertion.fault.enters == "force"
    }
    spots = [spot for spot, _ in _places(named, effects) if spot in acting] or sorted(acting, key=str)
    return describe(named.base, source, spots[0]) if spots else None


def _detectable(named: Named) -> dict[str, dict[str, Any]]:
    """Return for each physics the smallest size that would have been seen: its first parameter, where it is linear."""
    out: dict[str, dict[str, Any]] = {}
    for item in named.rounds[0].tried:
        fit, physics = item.fit, item.insertion.physics
        if physics in out or fit.failure or fit.nonlinear or not item.parameters or item.ended:
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
    if not effects and not is_noise(named.base):
        scale = max(named.base.misfit / named.base.freedom, 1.0)
        found = dict(where(named.rounds[0].tried, scale))
    return tuple(sorted(((s, p) for s, p in found.items() if p >= LIKELY), key=lambda pair: -pair[1]))


def _rejected(named: Named, effects: Sequence[Effect]) -> tuple[tuple[str, str], ...]:
    """Return the rivals of the first effect and why they lost, the nearest first."""
    if not effects:
        return ()
    out: dict[str, str] = {}
    members = {name for effect in effects for name in effect.members}
    found = named.first or named.rounds[0]
    first = found.best
    best = _as_tried(effects[0].candidate if first is None else first, found).fit
    open_ones = {name for name, _ in _open(named, effects)}
    for item in found.tried:
        name = item.insertion.physics
        if name in members or name in out or name in open_ones:
            continue
        out[name] = _why(item, best)
        if len(out) >= REJECTED:
            break
    return tuple(out.items())


def _open(named: Named, effects: Sequence[Effect]) -> tuple[tuple[str, str], ...]:
    """Return what was tried beside the first effect's like, but not fitted to the end, and how far it came."""
    if not effects:
        return ()
    members = {name for effect in effects for name in effect.members}
    best: dict[str, Candidate] = {}
    for item in (named.first or named.rounds[0]).tried:
        name = item.insertion.physics
        if name not in members and (name not in best or item.fit.misfit < best[name].fit.misfit):
            best[name] = item
    said = "was not fitted to the end; so far it leaves {:.3g} times the variance of the noise"
    nearest_first = sorted(best.items(), key=lambda pair: pair[1].fit.misfit)
    return tuple(
        (name, said.format(item.fit.misfit / item.fit.freedom)) for name, item in nearest_first if not item.final
    )


def _why(item: Candidate, best: Fit) -> str:
    fit = item.fit
    if fit.failure:
        return f"cannot be fitted: {fit.failure}"
    if item.unphysical:
        return item.unphysical
    if fit.misfit > 2 * best.misfit:
        left = fit.misfit / fit.freedom
        return f"leaves {left:.3g} times the variance of the noise, against {best.misfit / best.freedom:.3g}"
    more = len(fit.free) - len(best.free)
    lost = float(fit.left_out.sum() - best.left_out.sum())
    if more > 0:
        return f"needs {more} more parameters and predicts runs left out no better (misfit {lost:+.3g})"
    return f"explains the data less well: criterion higher by {fit.criterion - best.criterion:.3g}"


def nearest(named: Named, unknown: Unknown | None, *, disproved: bool = False) -> Fit:
    """Return the fit that explains most: with the effects, unless disproved, or with the map of an unknown force."""
    fits = [named.base if disproved else named.fit]
    fits += [] if unknown is None or unknown.fit is None else [unknown.fit]
    return min(fits, key=lambda fit: fit.criterion)


def concluded(
    named: Named,
    effects: tuple[Effect, ...],
    verdict: str,
    *,
    fits: tuple[Fit, Fit],
    scores: Sequence[Score],
    source: Source,
    held: tuple[Held, ...],
    unknown: Unknown | None = None,
    warnings: Sequence[Problem] = (),
    screened: Sequence[tuple[str, str]] = (),
    converters: Sequence[Converter] = (),
    readings: tuple[Source, tuple[Held, ...]] | None = None,
    recordings: Sequence[Recording] = (),
    proof: Proof | None = None,
    explained: Sequence[Explained] = (),
    residual: Mapping[str, Any] | None = None,
) -> Diagnosis:
    """Return the diagnosis without its words. fits, scores: before and after; screened: further rivals and why.

    converters: that the readings show, beside the effects that were found; readings, recordings: see `Diagnosis`.
    """
    before, after = fits
    every = (*effects, *(_as_effect(converter, named.fit) for converter in converters))
    return Diagnosis(
        verdict=verdict,
        effects=every,
        places=() if verdict == "consistent" else _places(named, every),
        rejected=(*_rejected(named, effects), *(screened if effects else ())),
        open=_open(named, effects),
        before=before,
        after=after,
        document=values_in(after.document, after.values),
        score_before=scores[0],
        score_after=scores[1],
        next_experiment="",
        statement="",
        named=named,
        warnings=(*warnings, *conventions(every)),
        detectable=_detectable(named) if verdict == "consistent" else {},
        outside={} if unknown is None else {**unknown.data, "description": unknown.description},
        source=source,
        held=held,
        proof=proof,
        explained=tuple(explained),
        residual=residual,
        converters=tuple(converters),
        readings=readings,
        recordings=tuple(recordings),
    )


def _as_effect(converter: Converter, fit: Fit) -> Effect:
    """Return a converter as an effect that nothing else explains: readings are steps or they are not."""
    item = converter.insertion
    return Effect(Candidate(item, fit), {item.physics: 1.0}, {}, ((item.spot, 1.0),))


def conventions(effects: Sequence[Effect]) -> list[Problem]:
    """Return as warnings what no run shows and the laws of these effects take as given."""
    laws = [item.candidate.insertion for item in effects]
    return [
        Problem(item.fault.convention, f"{item.physics} at {item.spot}", severity="warning")
        for item in laws
        if item.fault.convention
    ]


def in_words(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis with its next experiment and its statement."""
    from rotorsim.diagnosis.conclude.wording import next_experiment, statement

    found = replace(found, next_experiment=next_experiment(found))
    return replace(found, statement=statement(found))


@dataclass(frozen=True)
class Estimated:
    """A parameter of a fit: value, standard deviation, 90 % interval within its bounds (infinite where open), unit."""

    value: float
    std: float
    interval: tuple[float, float]
    unit: str
    at_bound: bool = False


def estimates(fit: Fit) -> dict[str, Estimated]:
    """Return the parameters of a fit by name: what all of statement, diagnosis.json and report say of them."""
    return {
        item.name: Estimated(float(fit.theta[j]), fit.std(j), fit.interval90(j), item.unit, bool(fit.at_bound[j]))
        for j, item in enumerate(fit.free)
    }


def interval(value: float, std: float) -> tuple[float, float]:
    """Return the 90 % interval of an estimate."""
    return value - Z90 * std, value + Z90 * std
