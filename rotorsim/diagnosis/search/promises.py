"""Which insertions are fitted, where it is known what their laws promise."""

from __future__ import annotations

from collections.abc import Sequence

from rotorsim.diagnosis.catalogue.insertion import Insertion, Law
from rotorsim.diagnosis.evidence.evidence import Promise
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.search.candidates import Candidate

MOST_LAWS = 16  # fitted in one round, each at its best place, where what laws promise is known
LEAST_FITS = 8  # in such a round, at the next best places where so many laws do not promise enough
MOST_PROMISING = 4  # laws that are fitted at rival places at once, and fits that come before the others
RIVAL_PLACES = 3  # of a law, with a promise within
NEAR_PROMISE = 2.0  # times that at its best place, as linear theory may err
UNLIKELY = 10.0  # times the least promise, or fit, of a round: beyond, a law is not looked at with another noise
PROMISED = 3.0  # times the least misfit that is promised: within, each law is fitted at its best place


def most_promising(candidates: Sequence[Insertion], bounds: Sequence[float | None], before: Fit) -> list[int]:
    """Return the insertions of which nothing is known, and those that promise most: each law first.

    Those that promise most of all at their rival places, too.
    """
    kept = [k for k, bound in enumerate(bounds) if bound is None]
    promised = {k: bound for k, bound in enumerate(bounds) if bound is not None and bound < before.misfit}
    order = sorted(promised, key=lambda k: promised[k])
    order = [k for k in order if promised[k] <= PROMISED * max(promised[order[0]], before.freedom)]
    best: dict[Law, int] = {}
    for k in order:
        best.setdefault(candidates[k].law, k)
    first = list(best.values())[:MOST_LAWS]
    for k in first[:MOST_PROMISING]:
        of_law = [n for n in order if candidates[n].law == candidates[k].law and n != k]
        most = NEAR_PROMISE * max(promised[k], before.freedom)
        first += [n for n in of_law if promised[n] <= most][:RIVAL_PLACES]
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


def misfit_of(promise: Promise | None) -> float | None:
    return None if promise is None else promise.misfit


def likely_of(candidates: Sequence[Insertion], promises: Sequence[Promise | None], before: Fit) -> frozenset[str]:
    """Return the keys of the insertions that another measure of the noise may make the most promising."""
    least = max(min((one.misfit for one in promises if one is not None), default=0.0), before.freedom)
    pairs = zip(candidates, promises, strict=True)
    return frozenset(item.key for item, one in pairs if one is None or one.misfit <= UNLIKELY * least)


def no_rivals(tried: Sequence[Candidate]) -> frozenset[str]:
    """Return the keys of what was carried to the end and leaves too much to be a rival with another noise.

    Noise is what the best leaves at each frequency; what leaves no more leaves as little by any weights.
    """
    ended = [item for item in tried if item.final and not item.fit.failure]
    least = min((item.fit.misfit for item in tried if not item.fit.failure), default=0.0)
    return frozenset(item.insertion.key for item in ended if item.fit.misfit > UNLIKELY * least)
