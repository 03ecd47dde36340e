"""Which of many insertions are fitted at all, by what is promised of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Insertion, Law
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Bounds, Evidence, Promise
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.diagnosis.search.candidates import Job, Round
from rotorsim.diagnosis.search.promises import at_best_places, misfit_of, most_promising
from rotorsim.diagnosis.search.work import Work
from rotorsim.jobs.threads import one_thread

MOST_FITS = 90  # in one round; places beyond are screened
# times the least misfit that any place allows: places that allow no less are not looked at. The bound is that of free
# harmonics, so that no law there leaves less; ten covers the one linear step of the diagram's own parameters in it
POSSIBLE = 10.0
WEIGHED_ALIKE = (
    2.0  # ratio of the noise of two signals by two measures: a promise is off by as much at most (NEAR_PROMISE)
)
UNMOVED = 3.0  # standard deviations by which a diagram is another one
HINT = 0.3  # drop of the misfit for each parameter, with data that are explained already, that is worth a closer look


def is_alike(one: Mapping[Any, float], other: Mapping[Any, float]) -> bool:
    """Return whether two measures of the noise weigh signals alike: promises are the same shares of a misfit."""
    if not one or one.keys() != other.keys():
        return False
    ratio = [one[signal] / other[signal] for signal in one]
    return max(ratio) <= WEIGHED_ALIKE * min(ratio)


@dataclass(frozen=True, eq=False)
class Screened:
    """kept: the insertions that are fitted. promises: of each insertion; near: so where that tells places apart.

    laws: what insertions leave by linear theory of their laws, of those where that is known. elsewhere: what is fitted
    where its law is chosen. reused: whether promises are those of an earlier round.
    """

    kept: list[int]
    promises: Sequence[Promise | None]
    near: Sequence[Promise | None]
    laws: Mapping[int, Promise] = field(default_factory=dict)
    elsewhere: Sequence[int] = ()
    reused: bool = False


@dataclass(frozen=True, eq=False)
class Screening:
    """What evidence promises of insertions, and which of them are worth a fit."""

    evidence: Evidence
    work: Work

    def all(self, before: Fit, candidates: Sequence[Insertion]) -> Screened:
        """Return all insertions, with what their laws leave."""
        unknown, every = [None] * len(candidates), [*range(len(candidates))]
        return Screened(every, unknown, unknown, self._laws(before, candidates))

    def screened(
        self,
        before: Fit,
        candidates: Sequence[Insertion],
        jobs: Sequence[Job],
        places: Bounds | None,
        earlier: Round | None,
    ) -> Screened:
        """Return which insertions are fitted, and what they promise.

        Of an earlier round from here only those that were likely are looked at.
        """
        unknown: list[Promise | None] = [None] * len(candidates)
        by_law = places is not None and places.by_law
        if not by_law and not self.evidence.costly:
            laws = self._laws(before, candidates)
            if is_adequate(before):
                return Screened(self._promising(candidates, jobs, before.misfit, laws), unknown, unknown, laws)
            others = [k for k in range(len(candidates)) if k not in laws]
            likely = self._at_likely_places([candidates[k] for k in others], [jobs[k] for k in others], places)
            best, elsewhere = at_best_places(candidates, laws, before)
            kept = [*best, *(others[k] for k in likely)]
            return Screened(kept, unknown, unknown, {k: one for k, one in laws.items() if k in kept}, elsewhere)
        known = None if earlier is None else earlier.likely
        shares = earlier.shares if earlier is not None and self._holds(earlier, before) else {}
        promises: list[Promise | None] = [
            Promise(before.misfit * shares[item.key] if item.key in shares else np.inf) for item in candidates
        ]
        looked_at = [
            k for k, item in enumerate(candidates) if item.key not in shares and (known is None or item.key in known)
        ]
        if self.evidence.costly or places is None:
            found = self._by_sensitivities(before, [jobs[k] for k in looked_at])
        else:
            found = self.work.promises_of_laws([candidates[k] for k in looked_at], places)
        for k, one in zip(looked_at, found, strict=True):
            promises[k] = one
        kept = most_promising(candidates, [misfit_of(one) for one in promises], before)
        return Screened(kept, promises, unknown if self.evidence.costly else promises, reused=bool(shares))

    def _holds(self, earlier: Round, before: Fit) -> bool:
        """Return whether what was promised in an earlier round holds: beside the same diagram, the noise alike."""
        if not is_alike(earlier.weighed_by, self.evidence.weighed_by):
            return False
        then, now = earlier.before.values, before.values
        same = is_adequate(earlier.before) == is_adequate(before) and then.keys() == now.keys()
        return same and all(abs(now[k] - then[k]) <= UNMOVED * before.std(j) for j, k in enumerate(now))

    def _laws(self, before: Fit, candidates: Sequence[Insertion]) -> dict[int, Promise]:
        """Return what insertions leave by linear theory of their laws, of those where that is known."""
        laws = self.evidence.laws(before)
        if laws is None:
            return {}
        found = self.work.promises_of_laws(candidates, laws, self.work.jobs.processes)
        # lines beside the harmonics are not in it: what makes them would be excluded by what it does not do to those
        return {k: one for k, one in enumerate(found) if one is not None and not candidates[k].from_lines}

    def _by_sensitivities(self, before: Fit, jobs: Sequence[Job]) -> list[Promise | None]:
        """Return what laws promise by their sensitivities, beside what the diagram without them does."""
        [beside, *promises] = self.work.promises([(values_in(before.document, before.values), [[{}]]), *jobs])
        least = HINT * len(before.free) if is_adequate(before) else 0.0  # below, it is noise
        told = [not np.isnan([beside, promise]).any() for promise in promises]
        known = [max(beside - promise, 0.0) if k else None for k, promise in zip(told, promises, strict=True)]
        return [None if one is None else Promise(before.misfit - (one if one > least else 0.0)) for one in known]

    def _at_likely_places(
        self, candidates: Sequence[Insertion], jobs: Sequence[Job], places: Bounds | None
    ) -> list[int]:
        """Return which insertions are fitted where places are many: each law at its best place, then the best places.

        A bound compares places for one law: with parameters far off, a law of two ports has less of it than one of one.
        It is that of free harmonics, which explain part of what a law elsewhere does: the less there is to explain, the
        less it tells.
        """
        if places is None:
            return self._promising(candidates, jobs)
        with one_thread():
            bounds = [misfit_of(one) for one in places.promises(candidates)]
        known = sorted({bound for bound in bounds if bound is not None})
        if not known:
            return self._promising(candidates, jobs)
        kept = [k for k, bound in enumerate(bounds) if bound is None]
        best: dict[Law, int] = {}
        for k in sorted((k for k in range(len(candidates)) if bounds[k] is not None), key=lambda k: bounds[k] or 0.0):
            best.setdefault(candidates[k].law, k)
        kept += best.values()
        for least in known:
            if least > POSSIBLE * known[0]:
                break
            here = [k for k, bound in enumerate(bounds) if bound == least and k not in kept]
            if least > known[0] and len(kept) + len(here) > MOST_FITS:
                break
            kept += here
        return kept

    def _promising(
        self,
        candidates: Sequence[Insertion],
        jobs: Sequence[Job],
        before: float = np.inf,
        laws: Mapping[int, Promise] | None = None,
    ) -> list[int]:
        """Return the best place of each law, and the next best that promise a drop of the misfit before, by one step.

        Where that is not known of any place of a law (NaN), one is fitted all the same: what fails there is said.
        """
        most, laws = before - HINT * MOST_FITS, laws or {}
        others = [k for k in range(len(jobs)) if k not in laws]
        promises = np.zeros(len(jobs))
        promises[[*laws]] = [one.misfit for one in laws.values()]
        promises[others] = self.work.promises([jobs[k] for k in others])
        order = np.argsort(promises, kind="stable")
        seen: set[Law] = set()
        first: list[int] = []
        second: list[int] = []
        for k in order.tolist():
            law = candidates[k].law
            if np.isinf(promises[k]):
                continue
            if law not in seen:
                first.append(k)
            elif promises[k] < most:
                second.append(k)
            seen.add(law)
        return [*first, *second[: max(MOST_FITS - len(first), MOST_FITS // 3)]]
