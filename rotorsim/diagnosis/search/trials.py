"""Every fault candidate at every place, put into a fitted diagram and refitted, what is promising to the end."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import LINES, Insertion, Law
from rotorsim.diagnosis.catalogue.values import structure_of, values_in
from rotorsim.diagnosis.evidence.evidence import Evidence, Promise
from rotorsim.diagnosis.evidence.fit import DEFERRED, Effort, Fit, is_adequate, is_astray
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass, likely_spots
from rotorsim.diagnosis.search.candidates import Candidate, Job, Round, simplest_first
from rotorsim.diagnosis.search.promises import (
    MOST_BROKEN,
    MOST_PROMISING,
    NEAR_PROMISE,
    NEARLY,
    NEXT_CLASSES,
    RIVAL_MISFIT,
    STARTED,
    as_promising,
    at_likely_places,
    at_next_places,
    at_other_places,
    at_rival_places,
    beyond_of,
    by_misfit,
    drop_of,
    falls_short,
    is_beyond,
    is_kept,
    is_slow,
    level_of,
    likely_of,
    noticed_from,
    still_likely,
)
from rotorsim.diagnosis.search.screening import HINT, MOST_FITS, Screening
from rotorsim.diagnosis.search.starts import jobs_of, led, near_laws, off_bounds
from rotorsim.diagnosis.search.work import Work
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.jobs.jobs import Jobs
from rotorsim.jobs.threads import one_thread

AGAIN = 8  # of the best of an earlier round
FIRST_EVALUATIONS, SECOND_EVALUATIONS = 5, 15  # of a nonlinear diagram, before it is judged whether it is worth more
LAST_EVALUATIONS = 3  # where the data are explained already, and only rivals are looked for
SECOND_STAGE_FITS = 8  # nonlinear fits that get as far as the second
REFINED = 3  # fits carried to the end at least
PROMISING = 0.3  # of the misfit before: below, a fit is carried to the end


class Trials:
    """Insertions into fitted diagrams, each refitted; ``slack``: of the misfit, what says nothing.

    base: the diagram as given, refitted, beside which effects are looked for; None: alone. rounds: by the diagram that
    they begin with, those with another measure of the noise at first. Where one begins again, what was likely is looked
    at, and the best candidates are fitted from where they were.
    """

    def __init__(
        self,
        evidence: Evidence,
        catalogue: Catalogue,
        jobs: Jobs,
        rounds: Mapping[str, Round] | None = None,
        base: Fit | None = None,
    ) -> None:
        self.evidence, self.catalogue, self.work = evidence, catalogue, Work(evidence, jobs)
        self.rounds = dict(rounds or {})
        self.counts = {"fits": 0, "rounds": 0}
        given = () if base is None else base.free
        self.nominal = {item.name: item.value for item in given if item.unit != ANGLE_UNIT}
        self.unsized = frozenset(item.name for item in given if not (item.scale or item.value))
        self.slack = 0.0
        if base is not None and evidence.refines_meshes(base.document):
            self.slack = CRITERIA.mesh_error * base.rows
        self.base = base

    def round(self, before: Fit) -> Round:
        """Try every insertion into a fitted diagram; beside an effect, few of those that will never be one more."""
        document, largest = values_in(before.document, before.values), self.evidence.largest()
        earlier = self.rounds.get(structure_of(before.document))
        again = {} if earlier is None else earlier.worth_again(len(earlier.tried) if self.evidence.costly else AGAIN)
        found = self._candidates(before, document)
        self.counts["rounds"] += 1
        every = found
        hypotheses = len({(item.physics, item.spot) for item in found})
        many = len(found) > MOST_FITS or self.evidence.costly or any(item.fault.enters == "signal" for item in found)
        places = self.evidence.bounds(before) if many else None
        largest = {**largest, **({} if places is None else places.carried)}
        away = off_bounds(before, self.nominal)
        # of a nonlinear diagram it costs too much to begin once more from values as given
        jobs = jobs_of(found, document, largest, away, None if before.nonlinear else {**self.nominal, **away})
        classes: Sequence[PlaceClass] = ()
        elsewhere: list[tuple[Insertion, Job]] = []
        untried: list[tuple[Insertion, Job]] = []
        likely: frozenset[str] | None = None
        screening = Screening(self.evidence, self.work)
        screened = screening.screened(before, found, jobs, places, earlier) if many else screening.all(before, found)
        level = level_of(hypotheses)
        called = [k for k in screened.kept if found[k].from_lines and k not in screened.laws]
        beside = self.base is not None and before is not self.base
        most = max((drop_of(one, before) for one in screened.laws.values() if one.exact), default=0.0)

        def is_out(k: int, first: Sequence[Fit]) -> bool:
            one = screened.laws.get(k)
            short = beside and bool(first) and falls_short(one, before)
            return short or is_beyond(one, before, first, noticed_from(len(found[k].free), level), most)

        if many:
            classes = () if places is None else places.classes
            kept, promises = screened.kept, screened.near
            likely = likely_of(found, screened.promises, before)
            kept += [k for k, item in enumerate(found) if item.key in again and k not in kept]
            known = [{} if one is None else dict(one.start) for one in promises]
            jobs = [
                (start, led(groups, again.get(item.key) or near))
                for item, (start, groups), near in zip(found, jobs, known, strict=True)
            ]
            if self.evidence.costly:  # from where they were, and on all samples
                jobs = [
                    (values_in(start, again[item.key]), [[{}]]) if item.key in again else (start, groups)
                    for item, (start, groups) in zip(found, jobs, strict=True)
                ]
            jobs = near_laws(jobs, screened.laws)
            promised = {k: one for k in kept if (one := screened.laws.get(k) or promises[k]) is not None}
            begun = self._begun(before, jobs, kept, promised, is_out, called)
            beyond = beyond_of(before, [*begun.values()])
            effort = Effort(FIRST_EVALUATIONS, linear_only=True, beyond=beyond, lost=False)
            unsure = () if places is None or places.sure or is_adequate(before) else classes
            others = at_likely_places(found, promises, unsure, begun)
            begun |= zip(others, self._fit([jobs[k] for k in others], effort), strict=True)
            for places_of_class in unsure[:NEXT_CLASSES]:
                others = at_next_places(found, promises, places_of_class, before, begun)
                begun |= zip(others, self._fit([jobs[k] for k in others], effort), strict=True)
            others = at_other_places(found, promises, before, begun)
            begun |= zip(others, self._fit([jobs[k] for k in others], effort), strict=True)
            rivals = (*at_rival_places(found, promises, before, [*begun]), *screened.elsewhere)
            elsewhere = [(found[k], jobs[k]) for k in rivals if k not in begun]
            left = [k for k, one in enumerate(screened.promises) if one is not None and k not in begun]
            untried = [(found[k], jobs[k]) for k in left]
        else:
            jobs = near_laws(jobs, screened.laws)
            begun = self._begun(before, jobs, screened.kept, screened.laws, is_out, called)
        first = [*begun.values()]
        later = [k for k, fit in begun.items() if fit.failure == DEFERRED and not is_out(k, first)]
        begun = {k: fit for k, fit in begun.items() if fit.failure != DEFERRED or k in later}
        explained = is_adequate(before) or any(is_adequate(fit) for fit in first)
        more = self._fit([jobs[k] for k in later], Effort(LAST_EVALUATIONS if explained else FIRST_EVALUATIONS))
        begun |= zip(later, more, strict=True)
        excluded = tuple((found[k], one) for k, one in screened.laws.items() if k not in begun)
        fits, jobs, found = [*begun.values()], [jobs[k] for k in begun], [found[k] for k in begun]
        self.counts["fits"] += len(found)
        fits, ended = self._refined(before, jobs, fits, [item.law for item in found])
        found, fits = self._finer(before, found, fits)
        beyond = (
            0.0 if self.evidence.costly else beyond_of(before, fits)
        )  # what leaves more may have been stopped early
        ended |= {k for k, fit in enumerate(fits) if fit.failure or (not fit.nonlinear and fit.misfit <= beyond)}
        tried = [
            Candidate(item, fit, self._astray(before, fit), k in ended)
            for k, (item, fit) in enumerate(zip(found, fits, strict=True))
        ]
        tried += [] if self.evidence.costly else self._meant(before, tried, untried)
        untried = [pair for pair in untried if pair[0].key not in {item.insertion.key for item in tried}]
        likely = None if likely is None else still_likely(likely, tried)
        ordered = tuple(simplest_first(tried, self.slack))
        places_of = tuple(classes), hypotheses, tuple(elsewhere), tuple(untried), likely
        given = zip(every, screened.promises, strict=True) if self.evidence.costly else ()
        shares = {k.key: p.misfit / before.misfit for k, p in given if p is not None and p.misfit < before.misfit}
        by = self.evidence.weighed_by if earlier is None or not screened.reused else earlier.weighed_by
        return self._kept(Round(before, ordered, *places_of, excluded, shares, by))

    def _kept(self, found: Round) -> Round:
        self.rounds[structure_of(found.before.document)] = found
        return found

    def _candidates(self, before: Fit, document: dict[str, Any]) -> list[Insertion]:
        """Return the insertions that a residual may call for: beside noise, a line is hum of the instruments."""
        lines, quiet = LINES in self.evidence.largest(), is_adequate(before)
        return [
            item
            for item in self.catalogue.candidates(self.evidence.load(document), self.evidence.recorded)
            if (lines or not item.from_lines) and not item.read_off and not (quiet and item.begins_at_line)
        ]

    def completed(
        self, found: Round, physics: Collection[str], chosen: Insertion | None = None, *, every: bool = False
    ) -> Round:
        """Return a round with these physics carried to the end, each law at its best place and in that of a choice.

        What was chosen is fitted at the rival places of its law, too; every: all laws in its place.
        """
        tried = list(found.tried)
        more = [] if chosen is None else found.beside(chosen, physics, every=every)
        of_law: dict[Law, int] = {}
        for k in sorted(range(len(tried)), key=lambda k: tried[k].fit.misfit):
            item = tried[k]
            if item.insertion.physics in physics and not item.fit.failure:
                of_law.setdefault(item.insertion.law, k)
        which = [k for k in of_law.values() if not tried[k].final]
        if not which and not more:
            return found
        jobs: list[Job] = [(values_in(tried[k].fit.document, tried[k].fit.values), [[{}]]) for k in which]
        jobs += [job for _, job in more]
        beyond = beyond_of(found.before, [item.fit for item in tried])
        effort = Effort(FIRST_EVALUATIONS if every else None, beyond=beyond, lost=not every)
        fits = self._fit(jobs, effort)
        ended = {*range(len(jobs))}
        if every:  # of many laws few are carried to the end
            ended = {*by_misfit(fits)[:REFINED]}
            self._again(jobs, fits, [*ended], None)
        for k, fit in zip(which, fits, strict=False):
            better = not fit.failure and fit.misfit <= tried[k].fit.misfit
            fit = fit if better else tried[k].fit
            tried[k] = Candidate(tried[k].insertion, fit, self._astray(found.before, fit))
        for n, (insertion, _) in enumerate(more, start=len(which)):
            tried.append(Candidate(insertion, fits[n], self._astray(found.before, fits[n]), n in ended))
        return self._kept(found.with_tried(tried, self.slack))

    def beside(self, found: Round, nearest: Candidate) -> Round:
        """Return a round with the laws that promise as much as the nearest leaves, beside its parameters and motion.

        At the places that are likely beside these. A fit without what is missing may have gone anywhere, and what laws
        promise beside it goes astray with it.
        """
        with one_thread():
            places = self.evidence.bounds(found.before, nearest.fit)
            likely = likely_spots(() if places is None else places.classes)
            jobs = {item.key: (item, job) for item, job in (*found.elsewhere, *found.untried) if item.spot in likely}
            tried = [item.insertion for item in found.tried if item.insertion.spot in likely]
            every = [*tried, *(item for item, _ in jobs.values())]
        promises = [] if places is None else self.work.promises_of_laws(every, places)
        which = as_promising(every, promises, len(tried), NEARLY * nearest.fit.misfit)
        ready: list[Job] = []
        for k in which:
            (_, (document, groups)), promise = jobs[every[k].key], promises[k]
            ready.append((document, led(groups, {} if promise is None else dict(promise.start))))
        fits = self._fit(ready, Effort(beyond=NEAR_PROMISE * nearest.fit.misfit))
        more = [Candidate(every[k], fit, self._astray(found.before, fit)) for k, fit in zip(which, fits, strict=True)]
        return self._kept(found.with_tried([*found.tried, *more], self.slack)) if more else found

    def _astray(self, before: Fit, fit: Fit) -> str:
        """Return in words the parameters of the diagram that are ``astray`` times what was given and fitted.

        Of an offset that is given as zero nobody has stated a size.
        """
        found, known = [], before.values
        for item, value in zip(fit.free, fit.theta, strict=True):
            sizes = [item.scale, abs(self.nominal.get(item.name, 0.0)), abs(known.get(item.name, 0.0))]
            sized = item.name in self.nominal and item.name not in self.unsized and item.unit != ANGLE_UNIT
            if sized and is_astray(item, value, sizes):
                size = min(size for size in sizes if size > 0) if item.series else max(sizes)
                found.append(f"{item.name} {abs(value) / size:.2g} times as large")
        return " and ".join(found)

    def _begun(
        self,
        before: Fit,
        jobs: Sequence[Job],
        kept: Sequence[int],
        promised: Mapping[int, Promise],
        is_out: Callable[[int, Sequence[Fit]], bool],
        called: Sequence[int] = (),
    ) -> dict[int, Fit]:
        """Return first fits; where one of the most promising explains the data, no others that never will are followed.

        Of those that have lost the motion only the most promising are begun with short parts of the runs. kept: what is
        fitted; promised: where something is known of it. is_out: what is not fitted beside the most promising.
        called: what lines of the recording call for, which nothing else explains: it is fitted first.
        """
        known = [k for k in kept if k in promised and promised[k].misfit < np.inf and not is_out(k, [])]
        by_promise = sorted(known, key=lambda k: promised[k].misfit)
        order = [*called]
        first = self._fit([jobs[k] for k in order], Effort(FIRST_EVALUATIONS)) if order else []
        for n in range(0 if any(map(is_adequate, first)) else MOST_BROKEN):
            more = by_promise[n * MOST_PROMISING : (n + 1) * MOST_PROMISING]
            first += self._fit([jobs[k] for k in more], Effort(FIRST_EVALUATIONS))
            order += more
            if not more or is_kept(before, first, promised[more[0]]):
                break
        others = [k for k in kept if k not in order and not is_out(k, first)]
        most = LAST_EVALUATIONS if promised and any(map(is_adequate, first)) else FIRST_EVALUATIONS
        effort = Effort(most, linear_only=True, beyond=beyond_of(before, first), lost=not known)
        rest = self._fit([jobs[k] for k in others], effort)
        return dict(zip([*order, *others], [*first, *rest], strict=True))

    def _fit(self, jobs: Sequence[Job], effort: Effort) -> list[Fit]:
        return self.work.fits(jobs, effort)

    def _refined(
        self, before: Fit, jobs: Sequence[Job], fits: list[Fit], laws: Sequence[Law]
    ) -> tuple[list[Fit], set[int]]:
        """Return the fits, and which of them were carried to the end: those that promise most.

        laws: physics and variant of each. Where one of all explains the data, only those near it matter any more.
        """
        if not any(is_adequate(fit) for fit in fits):
            order = [k for k in by_misfit(fits) if fits[k].nonlinear]
            self._again(jobs, fits, order[:SECOND_STAGE_FITS], SECOND_EVALUATIONS)
        order = by_misfit(fits)
        if is_adequate(before):  # only what is not noise matters
            order = [k for k in order if before.misfit - fits[k].misfit > HINT * len(fits[k].free)][:SECOND_STAGE_FITS]
        elif any(is_adequate(fit) for fit in fits):
            least = fits[order[0]].misfit
            slow = before.misfit - STARTED * (before.misfit - least)
            if before.misfit < RIVAL_MISFIT * least:
                best_of: dict[Law, int] = {}  # of the places of each law
                for k in order:
                    best_of.setdefault(laws[k], k)
                self._again(jobs, fits, [k for k in best_of.values() if is_slow(fits[k], slow)], SECOND_EVALUATIONS)
            order = [k for k in by_misfit(fits) if fits[k].misfit < RIVAL_MISFIT * least and not is_slow(fits[k], slow)]
            if self.evidence.costly:  # of what explains little after its first steps the first few
                order = [k for n, k in enumerate(order) if n < REFINED or fits[k].misfit <= slow]
        else:
            most = min(PROMISING * before.misfit, RIVAL_MISFIT * min((fits[k].misfit for k in order), default=np.inf))
            order = [k for n, k in enumerate(order) if n < REFINED or fits[k].misfit < most]
        self._again(jobs, fits, order, None)
        return fits, set(order)

    def _finer(self, before: Fit, found: Sequence[Insertion], fits: Sequence[Fit]) -> tuple[list[Insertion], list[Fit]]:
        """Return insertions and fits, the best with finer approximations of their laws where the data show it.

        Where all leave more than noise, with what the laws state once (the width of a jump) free as well: what a wrong
        width leaves must not be taken for another effect.
        """
        found, fits = list(found), list(fits)
        best = by_misfit(fits)[:REFINED]
        which = [] if is_adequate(before) else [k for k in best if found[k].fault.finer]
        finer = [found[k].finer for k in which]
        jobs: list[Job] = []
        for k, item in zip(which, finer, strict=True):
            document = values_in(fits[k].document, fits[k].values)
            jobs.append((item.approximated(document), [[{}]]))
        for k, item, fit in zip(which, finer, self._fit(jobs, Effort()), strict=True):
            if not fit.failure and fit.misfit < fits[k].misfit:
                found[k], fits[k] = item, replace(fit, seconds=fit.seconds + fits[k].seconds)
        if not any(map(is_adequate, (before, *(fits[k] for k in best)))):
            with one_thread():
                for k in best:
                    fits[k] = self.evidence.finished(fits[k], [found[k]])
        return found, fits

    def _meant(
        self, before: Fit, tried: Sequence[Candidate], untried: Sequence[tuple[Insertion, Job]]
    ) -> list[Candidate]:
        """Return the simpler laws that the best fits stand for, where these were not tried, from what was found."""
        fitted = [item for item in tried if not item.fit.failure]
        found: dict[str, tuple[Insertion, Job]] = {}
        for best in sorted(fitted, key=lambda item: item.fit.misfit)[:REFINED]:
            physics, values = best.simpler[2] if best.simpler else "", best.fit.values
            here = best.insertion.spot, best.insertion.depends_on
            for item, (document, _) in untried:
                if item.physics == physics and (item.spot, item.depends_on) == here:
                    start = {name: value for name, value in values.items() if name not in best.parameters}
                    pairs = ((f"{item.name}.{key}", f"{best.insertion.name}.{key}") for key in item.fault.free)
                    start |= {own: values[other] for own, other in pairs if other in values}
                    found.setdefault(item.key, (item, (document, [[start]])))
        fits = self._fit([job for _, job in found.values()], Effort())
        fitted_now = zip(found.values(), fits, strict=True)
        return [Candidate(item, fit, self._astray(before, fit)) for (item, _), fit in fitted_now]

    def _again(self, jobs: Sequence[Job], fits: list[Fit], which: Sequence[int], most: int | None) -> None:
        """Carry some fits on from where they are, in place."""
        continued: list[Job] = []
        for k in which:
            away = {} if fits[k].nonlinear else off_bounds(fits[k], self.nominal)
            continued.append((values_in(jobs[k][0], fits[k].values), [[{}], *([[away]] if away else [])]))
        for k, fit in zip(which, self._fit(continued, Effort(most)), strict=True):
            if not fit.failure and fit.misfit <= fits[k].misfit:
                fits[k] = replace(fit, seconds=fit.seconds + fits[k].seconds)

    def refitted(
        self, base: Fit, effects: Sequence[Candidate], near: Fit, new: Candidate | None = None
    ) -> tuple[Candidate, ...]:
        """Return these effects only, put in one by one; the last has the fit of all, from their values in ``near``.

        new: the effect that is not in there: from those of its own fit. Empty where they cannot stand alone.
        """
        document, known = dict(base.document), dict(near.values)
        entered = []
        for item in effects:
            here = self.catalogue.candidates(self.evidence.load(document), self.evidence.recorded)
            again = next((other for other in here if other.key == item.insertion.key), None)
            if again is None:
                return ()
            again = again.finer if again.finer.values == item.insertion.values else again
            old, name = item.insertion.name, again.name
            there = item.fit if item is new else near
            had = there.document["blocks"][old].get("parameters", {})
            own = {key: there.values[f"{old}.{key}"] for key in again.fault.free if f"{old}.{key}" in there.values}
            set_once = {key: there.values.get(f"{old}.{key}", had[key]) for key in again.fault.fixed if key in had}
            bounds = {key: there.document["identify"].get(f"{old}.{key}", {}) for key in again.fault.free}
            limits = {key: (given["low"], given["high"]) for key, given in bounds.items() if given}
            document = again.document(document, {**own, **set_once}, limits)
            known |= {f"{name}.{key}": value for key, value in own.items()}
            entered.append(again)
        known = {name: value for name, value in known.items() if name in document["identify"]}
        document = values_in(document, known)  # a block that was put in the place of another has others
        with one_thread():
            fit = self.evidence.fit(document, [[{}], [{**self.nominal, **off_bounds(near, self.nominal)}]])
        if fit.failure:
            return ()
        pairs = zip(entered[:-1], effects, strict=False)
        kept = (Candidate(one, old.fit if one.name == old.insertion.name else fit) for one, old in pairs)
        return (*kept, Candidate(entered[-1], fit))
