"""Which insertions are fitted, where it is known what their laws promise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from math import isclose

import numpy as np
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Insertion, Law
from rotorsim.diagnosis.evidence.evidence import Promise
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass, likely_spots
from rotorsim.diagnosis.search.candidates import Candidate

MOST_LAWS = 16  # fitted in one round, each at its best place, where what laws promise is known
LEAST_FITS = 8  # in such a round, at the next best places where so many laws do not promise enough
MOST_PROMISING = 4  # fits that come before the others
MOST_BROKEN = 3  # times that as many come, where what was promised to the first was not kept
SURE_PLACES = 2  # of a law beside its best, which are fitted at once where its promises are as exact as linear theory
BEST_LAWS = 2  # by their fits, which are tried at other places before one is chosen
OTHER_PLACES = 4  # of each of these, of promises that differ by more than
DISTINCT = 1e-3  # relative: what promises the same does the same
RIVAL_PLACES = 5  # of a law that is chosen, with a promise within
NEAR_PROMISE = 2.0  # times that at its best place, as linear theory may err
UNLIKE_PROMISE = 4.0  # times that of a law that is not proportional to its parameters: its step begins elsewhere, too
NEARLY = 1.1  # times what the best fit leaves: within, laws promise as much beside it, where linear theory hardly errs
SAME_PROMISE = 1e-6  # relative: what promises so nearly the same beside a fit does the same, but for units
RIVALS, RIVALS_OF_LAW = 8, 3  # that are tried beside the best fit at once, and of one law at different places
UNLIKELY = 10.0  # times the least promise, or fit, of a round: beyond, a law is not looked at with another noise
NEXT_CLASSES, NEXT_LAWS = 3, 6  # of places, and of laws at each, that are fitted where a round explains less than half
RIVAL_MISFIT = 100.0  # times the misfit of one that explains the data: beyond, no rival of it will
STARTED = 0.1  # share of what the best explains: a law that explains less is no rival of it
PROMISED = 3.0  # times the least misfit that is promised: within, each law is fitted at its best place


def most_promising(candidates: Sequence[Insertion], bounds: Sequence[float | None], before: Fit) -> list[int]:
    """Return the insertions of which nothing is known, and those that promise most: each law first."""
    kept = [k for k, bound in enumerate(bounds) if bound is None]
    promised = {k: bound for k, bound in enumerate(bounds) if bound is not None and bound < before.misfit}
    order = sorted(promised, key=lambda k: promised[k])
    order = [k for k in order if promised[k] <= PROMISED * max(promised[order[0]], before.freedom)]
    best: dict[Law, int] = {}
    for k in order:
        best.setdefault(candidates[k].law, k)
    first = list(best.values())[:MOST_LAWS]
    more = [k for k in order if k not in first]
    return [*kept, *first, *more[: max(LEAST_FITS - len(first), 0)]]


def at_rival_places(
    candidates: Sequence[Insertion], promises: Sequence[Promise | None], before: Fit, kept: Sequence[int]
) -> list[int]:
    """Return the insertions that are not kept and promise nearly as much as the same law at its best place."""
    of_law: dict[Law, list[int]] = {}
    known = {k: one.misfit for k, one in enumerate(promises) if one is not None and one.misfit < before.misfit}
    for k in sorted(known, key=lambda k: known[k]):
        of_law.setdefault(candidates[k].law, []).append(k)
    near: list[int] = []
    for which in of_law.values():
        most = NEAR_PROMISE * max(known[which[0]], before.freedom)
        near += [k for k in which if k not in kept and known[k] <= most][:RIVAL_PLACES]
    return near


def at_best_places(
    candidates: Sequence[Insertion], promises: Mapping[int, Promise], before: Fit
) -> tuple[list[int], list[int]]:
    """Return the insertions at the places where each law promises most, and at others where it promises nearly as much.

    The former are fitted, the latter once a law is chosen. Nearly: what it leaves there, and what it explains, are
    NEAR_PROMISE times worse at most; the one tells little of a weak effect, the other of a strong one.
    """
    of_law: dict[Law, list[int]] = {}
    for k in sorted(promises, key=lambda k: promises[k].misfit):
        of_law.setdefault(candidates[k].law, []).append(k)
    kept: list[int] = []
    elsewhere: list[int] = []
    for best, *others in of_law.values():
        most = NEAR_PROMISE * max(promises[best].misfit, before.freedom)
        least = (before.misfit - promises[best].misfit) / NEAR_PROMISE
        near = [k for k in others if promises[k].misfit <= min(most, before.misfit - least)]
        count = SURE_PLACES if promises[best].exact else 0
        kept += [best, *near[:count]]
        elsewhere += near[count:RIVAL_PLACES]
    return kept, elsewhere


def as_promising(
    candidates: Sequence[Insertion], promises: Sequence[Promise | None], tried: int, most: float
) -> list[int]:
    """Return the RIVALS that promise at most ``most``; the first ``tried`` were fitted.

    Not what promises the same as its law does where it is fitted: a wire and the one behind a gain.
    """
    known = {k: one.misfit for k, one in enumerate(promises) if one is not None}
    of_law: dict[Law, list[float]] = {}
    for k in (k for k in known if k < tried):
        of_law.setdefault(candidates[k].law, []).append(known[k])
    more: Counter[Law] = Counter()
    found: list[int] = []
    for k in sorted((k for k in known if k >= tried and known[k] <= most), key=known.__getitem__):
        law, misfit = candidates[k].law, known[k]
        same = any(isclose(misfit, one, rel_tol=SAME_PROMISE) for one in of_law.get(law, ()))
        if not same and more[law] < RIVALS_OF_LAW and len(found) < RIVALS:
            found.append(k)
            more[law] += 1
            of_law.setdefault(law, []).append(misfit)
    return found


def at_likely_places(
    candidates: Sequence[Insertion],
    promises: Sequence[Promise | None],
    classes: Sequence[PlaceClass],
    fits: Mapping[int, Fit],
) -> list[int]:
    """Return the insertion that promises most of every law without a fit at the likeliest places of free signals.

    classes: the likeliest first; empty where promises are sure. Where a nonlinear diagram is far from the runs,
    they tell where something is missing, and not what; none where a fit explains the runs.
    """
    if not classes or any(is_adequate(fit) for fit in fits.values()):
        return []
    likely = likely_spots(classes)
    fitted = {candidates[k].law for k in fits if candidates[k].spot in likely}
    known = {k: one.misfit for k, one in enumerate(promises) if one is not None and candidates[k].spot in likely}
    best: dict[Law, int] = {}
    for k in sorted(known, key=lambda k: known[k]):
        if candidates[k].law not in fitted:
            best.setdefault(candidates[k].law, k)
    return list(best.values())


def at_next_places(
    candidates: Sequence[Insertion],
    promises: Sequence[Promise | None],
    places: PlaceClass,
    before: Fit,
    fits: Mapping[int, Fit],
) -> list[int]:
    """Return the insertions of the NEXT_LAWS laws that promise most at a class of places, without those with a fit.

    None where a fit explains half of the residual. What a free signal explains at one place a law there may not: of an
    integrator whose output is recorded, a free signal explains all.
    """
    if any(not fit.failure and fit.misfit <= before.misfit / 2 for fit in fits.values()):
        return []
    known = {k: one.misfit for k, one in enumerate(promises) if one is not None and candidates[k].spot in places.places}
    best: dict[Law, int] = {}
    for k in sorted(known, key=lambda k: known[k]):
        best.setdefault(candidates[k].law, k)
    return [k for k in [*best.values()][:NEXT_LAWS] if k not in fits and known[k] < before.misfit]


def at_other_places(
    candidates: Sequence[Insertion], promises: Sequence[Promise | None], before: Fit, fits: Mapping[int, Fit]
) -> list[int]:
    """Return the insertions of the best laws by their fits {candidate: fit} at the places that promise most else.

    Where the diagram is far from the runs, promises tell laws apart better than places; none where it explains them.
    """
    if is_adequate(before):
        return []
    known = {k: one.misfit for k, one in enumerate(promises) if one is not None and one.misfit < before.misfit}
    better = [k for k in fits if k in known and not fits[k].failure and fits[k].misfit < before.misfit]
    laws = list(dict.fromkeys(candidates[k].law for k in sorted(better, key=lambda k: fits[k].misfit)))[:BEST_LAWS]
    others: list[int] = []
    for law in laws:
        seen = [known[k] for k in fits if k in known and candidates[k].law == law]
        chosen: list[int] = []
        for k in sorted((k for k in known if candidates[k].law == law and k not in fits), key=lambda k: known[k]):
            if len(chosen) < OTHER_PLACES and not any(isclose(known[k], one, rel_tol=DISTINCT) for one in seen):
                chosen.append(k)
                seen.append(known[k])
        others += chosen
    return others


def drop_of(promise: Promise, before: Fit) -> float:
    """Return how much of the misfit before a law explains by linear theory."""
    return min(promise.without, before.misfit) - promise.misfit


def is_beyond(promise: Promise | None, before: Fit, fits: Sequence[Fit], noticed: float, most: float) -> bool:
    """Return whether a law explains too little by linear theory to be a rival of those that were fitted first.

    noticed: drop of the misfit from which on a law is noticed beside a diagram that explains the data. most: the drop
    that linear theory tells of the best law that is proportional to its parameters: of two laws it errs alike.
    """
    if promise is None:
        return False
    drop = drop_of(promise, before)
    if is_adequate(before):
        return NEAR_PROMISE * drop < noticed
    least = min((fit.misfit for fit in fits if not fit.failure), default=before.misfit)
    if promise.exact:
        # FAULT: a bow that leaves noise was told to leave 547 times it, beside what explains the data
        found = min(promise.without, before.misfit) - least if explains_all_but(before, fits) else 0.0
        return NEAR_PROMISE * drop < max(most, found)
    return drop < max(STARTED * (before.misfit - least), most / UNLIKE_PROMISE)


def falls_short(promise: Promise | None, before: Fit) -> bool:
    """Return whether a law explains less by linear theory than one more effect must (`Criteria.worth`)."""
    if promise is None or is_adequate(before):
        return False
    drop = (NEAR_PROMISE if promise.exact else UNLIKE_PROMISE) * drop_of(promise, before)
    return drop < CRITERIA.worth * (before.misfit - before.freedom)


def explains_all_but(before: Fit, fits: Sequence[Fit]) -> bool:
    """Return whether one of some fits explains what a diagram leaves, or all but what a cause may leave."""
    least = min((fit.misfit for fit in fits if not fit.failure), default=before.misfit)
    most = CRITERIA.cause * (before.misfit - before.freedom)
    return not is_adequate(before) and (any(map(is_adequate, fits)) or before.misfit - least >= most)


def noticed_from(unknowns: int, level: float) -> float:
    """Return the drop of the misfit that noise alone makes by so many unknowns with probability level."""
    return float(chi2.isf(level, max(unknowns, 1)))


def level_of(hypotheses: int) -> float:
    """Return the probability of a false alarm for each of so many hypotheses."""
    return CRITERIA.false_alarm / max(hypotheses, 1)


def misfit_of(promise: Promise | None) -> float | None:
    return None if promise is None else promise.misfit


def likely_of(candidates: Sequence[Insertion], promises: Sequence[Promise | None], before: Fit) -> frozenset[str]:
    """Return the keys of the insertions that another measure of the noise may make the most promising."""
    least = max(min((one.misfit for one in promises if one is not None), default=0.0), before.freedom)
    pairs = zip(candidates, promises, strict=True)
    return frozenset(item.key for item, one in pairs if one is None or one.misfit <= UNLIKELY * least)


def still_likely(likely: frozenset[str], tried: Sequence[Candidate]) -> frozenset[str]:
    """Return the keys of what promised much and of what was fitted well, without what can be no rival.

    That was carried to the end and leaves too much. Noise is what the best leaves at each frequency; what leaves no
    more leaves as little by any weights.
    """
    fitted = [item for item in tried if not item.fit.failure]
    least = min((item.fit.misfit for item in fitted), default=0.0)
    near = {item.insertion.key for item in fitted if item.fit.misfit <= UNLIKELY * least}
    far = {item.insertion.key for item in fitted if item.final and item.insertion.key not in near}
    return frozenset((likely | near) - far)


def is_kept(before: Fit, fits: Sequence[Fit], promise: Promise) -> bool:
    """Return whether the best of some fits explains what was promised, as nearly as linear theory tells it."""
    least = min((fit.misfit for fit in fits if not fit.failure), default=np.inf)
    return NEAR_PROMISE * (before.misfit - least) >= before.misfit - promise.misfit


def beyond_of(before: Fit, fits: Sequence[Fit]) -> float:
    """Return the misfit beyond which a law is not followed after its first steps: it is no rival of the best fit.

    RIVAL_MISFIT times the misfit of the best, or what explains STARTED of what it explains. Infinite where that has not
    begun.
    """
    least = min((fit.misfit for fit in fits if not fit.failure), default=np.inf)
    if any(is_adequate(fit) for fit in fits):
        return RIVAL_MISFIT * least
    started = before.misfit - STARTED * (before.misfit - least)
    return min(RIVAL_MISFIT * least, started) if least < before.misfit else np.inf


def is_slow(fit: Fit, most: float) -> bool:
    """Return whether the fit of a nonlinear law has not got below a misfit: it may have begun too far away."""
    return fit.nonlinear and fit.misfit > most


def by_misfit(fits: Sequence[Fit]) -> list[int]:
    return sorted((k for k, fit in enumerate(fits) if not fit.failure), key=lambda k: fits[k].misfit)
