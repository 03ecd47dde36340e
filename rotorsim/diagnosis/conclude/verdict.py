"""What follows from a selection: effects with equivalence classes and places, the verdict, why the others lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot
from rotorsim.diagnosis.conclude.result import Effect, untried_of
from rotorsim.diagnosis.conclude.unknown_force import UnknownForce, unknown_force
from rotorsim.diagnosis.evidence.evidence import Evidence, Promise, Terms
from rotorsim.diagnosis.evidence.fit import Fit, is_noise
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass, likely_spots, spots_of
from rotorsim.diagnosis.evidence.opened import Converter
from rotorsim.diagnosis.search.candidates import Candidate, Round
from rotorsim.diagnosis.search.promises import noticed_from
from rotorsim.diagnosis.search.selection import Selection, least_gain, likely_places
from rotorsim.diagnosis.search.work import Work
from rotorsim.errors import Problem

REJECTED = 12  # hypotheses that are listed
NEAR_THEORY = "by linear theory its residual variance is {:.3g} times {}"
BY_THEORY = NEAR_THEORY + ", against {:.3g}"


def effects_of(selection: Selection) -> tuple[Effect, ...]:
    """Return the effects that were chosen, each with what explains the data as well."""
    pairs = zip(selection.chosen, selection.rounds, strict=False)
    return tuple(effect_of(item, found, selection.slack) for item, found in pairs)


def effect_of(candidate: Candidate, found: Round, slack: float) -> Effect:
    """Return an effect with the physics and places that explain the data as well; slack: see `Selection`.

    It is compared as it was in that round: its rivals stood beside the same others. What holds its law as a special
    case, and explains no more than further parameters cost and meshes get wrong, is no rival; nor is a force of a
    machine once more as a signal, with more of them. Slack is no excuse for more parameters: what meshes get wrong,
    they would explain, too.
    """
    chosen, candidate = candidate, found.as_tried(candidate)  # what grows is fitted to more than in its round
    own = candidate.insertion.physics
    scale = max(candidate.fit.excess_variance, 1.0)
    possible = [item for item in found.tried if not item.fit.failure and item.physical]
    best: dict[str, float] = {}
    for item in possible:
        wider, least = own in item.insertion.fault.special_cases, candidate.fit.criterion
        more_free = len(item.fit.free) > len(candidate.fit.free)
        least -= slack if wider and more_free else 0.0
        wider |= more_free and (candidate.insertion.fault.enters, item.insertion.fault.enters) == ("force", "signal")
        if wider and item.fit.criterion >= least:
            continue
        more = max(item.fit.criterion - candidate.fit.criterion - (0.0 if more_free else slack), 0.0) / scale
        best[item.insertion.physics] = min(best.get(item.insertion.physics, np.inf), more)
    best[own] = 0.0
    weights = {name: float(np.exp(-0.5 * value)) for name, value in best.items() if value <= CRITERIA.equivalent}
    total = sum(weights.values())
    members = {name: weight / total for name, weight in sorted(weights.items(), key=lambda pair: -pair[1])}
    # what is refuted, and reads like it, says where it is all the same
    names = {
        *members,
        *(item.insertion.physics for item in found.tried if item.refuted and _reads_like(item, candidate)),
    }
    same = [candidate, *(item for item in found.tried if item.insertion.physics in names)]  # it is there, if all fail
    places = tuple(one for one in likely_places(same, scale) if one.probability >= CRITERIA.listed)
    rivals: dict[str, Candidate] = {}
    for item in possible:
        if item.insertion.physics in members and item.insertion.physics != own:
            rivals.setdefault(item.insertion.physics, item)
    return Effect(chosen if chosen.insertion.grows else candidate, members, rivals, places)


def _reads_like(item: Candidate, other: Candidate) -> bool:
    return item.insertion.physics in other.insertion.fault.confused_with


def converter_effect(converter: Converter, fit: Fit) -> Effect:
    """Return a converter as an effect that nothing else explains: readings are steps or they are not."""
    item = converter.insertion
    return Effect(Candidate(item, fit), {item.physics: 1.0}, {}, (PlaceClass((item.spot,), 1.0),))


def verdict_of(
    selection: Selection,
    effects: Sequence[Effect],
    *,
    alike: bool = False,
    disproved: bool = False,
    converters: bool = False,
    faint: bool = False,
    contradicted: bool = False,
) -> str:
    """Return one of VERDICTS.

    alike: all runs have one speed and the same settings, which anything explains, or too few samples to judge.
    disproved: with the effects the diagram does not predict hold-out runs. converters: readings show steps that the
    diagram lacks. faint: the residual of the diagram is so small that only a named cause makes it physics.
    contradicted: hold-out runs show that something is missing, where the fitted runs do not.
    Several effects of which one may be nearly anything describe a law that is in no catalogue.
    """
    named = bool(effects) and not disproved and selection.explains
    if not named and not contradicted and (faint or (not effects and is_noise(selection.base))):
        if converters:
            return "outside_catalogue" if disproved else "missing_physics"
        return "not_identifiable" if alike else "consistent"
    if not named:
        return "outside_catalogue"
    if any(len(effect.members) > CRITERIA.most_equivalent for effect in effects):
        return "not_identifiable" if len(effects) == 1 else "outside_catalogue"
    return "missing_physics"


def is_no_explanation(selection: Selection, predicted: float) -> bool:
    """Return whether effects stand for a law that is none of them; predicted: the share of what they leave that can be.

    A cause that explains most may leave details of its law. What explains less, and leaves what the motion predicts,
    only imitates another law; so do several, since each was found in the details of those before it, that leave more
    than noise that is not as modelled (`Criteria.slight`).
    """
    if not selection.chosen or not predicted:
        return False
    several = len(selection.chosen) > 1 and 1 / (1 - predicted) > CRITERIA.slight
    return several or selection.share < CRITERIA.cause


def unknown_of(selection: Selection, effects: Sequence[Effect], work: Work) -> UnknownForce | None:
    """Return what is known of a force outside the catalogue, at the likeliest place where a force can act."""
    tried = [item.insertion for found in selection.rounds for item in found.tried]
    acting = {item.spot for item in tried if item.fault.enters == "force"}
    spots = [spot for spot in spots_of(places_of(selection, effects)) if spot in acting] or sorted(acting, key=str)
    return unknown_force(selection.base, work, spots[0]) if spots else None


def signals_of(
    selection: Selection, effects: Sequence[Effect], after: Fit, evidence: Evidence, verdict: str
) -> tuple[MissingSignal, ...]:
    """Return what is missing as signals in time: of each effect beside the others, or outside the catalogue of all."""
    if verdict == "consistent":
        return ()
    first = selection.first
    if verdict == "outside_catalogue" or not effects:
        spot = _likeliest(first.classes, places_of(selection, effects))
        found = [] if spot is None else [evidence.missing_signal(first.before, after, None, spot, first.classes)]
    else:
        pairs = zip((effect.candidate.insertion for effect in effects), selection.rounds, strict=False)
        found = [
            evidence.missing_signal(beside.before, after, item, item.spot, beside.classes) for item, beside in pairs
        ]
    return tuple(signal for signal in found if signal is not None)


def _likeliest(classes: Sequence[PlaceClass], places: Sequence[PlaceClass]) -> Spot | None:
    """Return the likeliest place of a free signal; of those that the data do not separate, where a law explains most.

    places: of laws, the likeliest first.
    """
    spots = spots_of(places)
    if not classes:
        return next(iter(spots), None)
    likely = likely_spots(classes)
    return next((spot for spot in spots if spot in likely), classes[0].places[0])


def nearest(selection: Selection, unknown: UnknownForce | None, *, disproved: bool = False) -> Fit:
    """Return the fit that explains most: with the effects, unless disproved, or with the map of an unknown force."""
    fits = [selection.base if disproved else selection.fit]
    fits += [] if unknown is None or unknown.fit is None else [unknown.fit]
    return min(fits, key=lambda fit: fit.criterion)


def places_of(selection: Selection, effects: Sequence[Effect], *, outside: bool = False) -> tuple[PlaceClass, ...]:
    """Return the places of all effects, or of the best candidates where none was chosen, the likeliest first.

    outside: of a law that is none of the effects, so that places are those of a free signal, if these are known.
    """
    if outside and selection.first.classes:
        found = selection.first.classes
    elif effects:
        found = tuple(one for effect in effects for one in effect.places)
    elif is_noise(selection.base):
        found = ()
    else:
        found = likely_places(selection.rounds[0].tried, max(selection.base.excess_variance, 1.0))
    seen: set[Spot] = set()
    places = []
    for one in sorted(found, key=lambda one: -one.probability):
        spots = tuple(spot for spot in one.places if spot not in seen)
        if spots and one.probability >= CRITERIA.listed:
            places.append(replace(one, places=spots))
            seen.update(spots)
    return tuple(places)


def detectable_sizes(selection: Selection) -> dict[str, dict[str, Any]]:
    """Return for each physics the smallest size that would have been seen: its first parameter, where it is linear."""
    out: dict[str, dict[str, Any]] = {}
    for item in selection.rounds[0].tried:
        fit, physics = item.fit, item.insertion.physics
        if physics in out or fit.failure or fit.nonlinear or not item.parameters or item.ended:
            continue
        j = [free.name for free in fit.free].index(item.parameters[0])
        std = float(np.sqrt(max(fit.covariance[j, j], 0.0)))
        if np.isfinite(std) and std > 0:
            value = float(np.sqrt(least_gain(item, selection.base, selection.level))) * std
            key = item.parameters[0].rpartition(".")[2]
            out[physics] = {"parameter": key, "value": value, "unit": fit.free[j].unit}
    for insertion, promise in selection.rounds[0].excluded:
        key = next(iter(insertion.fault.free), "")
        std = promise.std.get(key, np.inf)
        if promise.exact and np.isfinite(std) and std > 0:
            drop = noticed_from(len(insertion.free), selection.level)
            size = {"parameter": key, "value": float(np.sqrt(drop)) * std, "unit": insertion.kind.parameters[key].unit}
            out.setdefault(insertion.physics, size)
    return out


def rejected_of(selection: Selection, effects: Sequence[Effect], terms: Terms) -> tuple[tuple[str, str], ...]:
    """Return the rivals of the first effect and why they lost, the nearest first."""
    if not effects:
        return ()
    passed = {name for effect in effects for name in effect.members}
    passed |= {name for name, _ in unfinished(selection, effects, terms)}
    first = selection.first.best
    best = selection.first.as_tried(effects[0].candidate if first is None else first).fit
    out: dict[str, str] = {}
    for item in selection.first.tried:
        if not item.fit.stopped and item.insertion.physics not in passed and len(out) < REJECTED:
            out.setdefault(item.insertion.physics, _why(item, best, terms))
    for insertion, promise in _excluded(selection):
        if insertion.physics not in passed and len(out) < REJECTED:
            ratio = promise.misfit / max(selection.base.freedom, 1)
            out.setdefault(insertion.physics, BY_THEORY.format(ratio, terms.noise, best.excess_variance))
    return tuple(out.items())


def _excluded(selection: Selection) -> list[tuple[Insertion, Promise]]:
    """Return what linear theory told to explain too little to be fitted, the nearest first."""
    return sorted(selection.first.excluded, key=lambda pair: pair[1].misfit)


def unfinished(selection: Selection, effects: Sequence[Effect], terms: Terms) -> tuple[tuple[str, str], ...]:
    """Return what was tried beside the first effect's like, but not fitted to the end, and how far it came.

    Without effects only what was stopped by a part that failed.
    """
    stopped = [(name, f"could not be fitted: {why}") for name, why in untried_of(selection).items()]
    if not effects:
        return tuple(stopped)
    members = {name for effect in effects for name in effect.members}
    best: dict[str, Candidate] = {}
    for item in sorted(selection.first.tried, key=lambda item: item.fit.misfit):
        if item.insertion.physics not in members:
            best.setdefault(item.insertion.physics, item)
    text = "was not fitted to the end; so far its residual variance is {:.3g} times {}"
    open_ones = {
        name: text.format(item.fit.excess_variance, terms.noise) for name, item in best.items() if not item.final
    }
    for insertion, promise in _excluded(selection):
        if not promise.exact and insertion.physics not in members | set(best):
            ratio = promise.misfit / max(selection.base.freedom, 1)
            open_ones.setdefault(insertion.physics, f"was not fitted; {NEAR_THEORY.format(ratio, terms.noise)}")
    return (*open_ones.items(), *stopped)


def _why(item: Candidate, best: Fit, terms: Terms) -> str:
    fit = item.fit
    if fit.failure:
        return f"cannot be fitted: {fit.failure}"
    if item.unphysical:
        return item.unphysical
    if fit.misfit > 2 * best.misfit:
        return f"residual variance {fit.excess_variance:.3g} times {terms.noise}, against {best.excess_variance:.3g}"
    if fit is best:
        return "explains most alone, but less than the effects found explain together"
    more = len(fit.free) - len(best.free)
    if more > 0:
        lost = float(fit.left_out.sum() - best.left_out.sum())
        return f"needs {more} more parameters and predicts {terms.predicted} no better (misfit {lost:+.3g})"
    return f"explains the data less well: criterion higher by {fit.criterion - best.criterion:.3g}"


def conventions(effects: Sequence[Effect]) -> list[Problem]:
    """Return as warnings what no run shows and the laws of these effects take as given."""
    laws = [item.candidate.insertion for item in effects]
    return [
        Problem(item.fault.convention, f"{item.physics} at {item.spot}", severity="warning")
        for item in laws
        if item.fault.convention
    ]
