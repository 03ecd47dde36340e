"""Every fault candidate at every place, put into a fitted diagram and refitted, what is promising to the end."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import LINES, Insertion, fixed_of, limits_of, sizes_at, starts_of
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Bounds, Evidence
from rotorsim.diagnosis.evidence.fit import DEFERRED, Fit, fit_from_plain, fit_to_plain, is_adequate
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass
from rotorsim.identification.coordinates import ANGLE_UNIT
from rotorsim.identification.profile import Z90
from rotorsim.jobs.jobs import Failure, Jobs, run_jobs
from rotorsim.jobs.threads import one_thread

MOST_FITS = 90  # in one round; places beyond are screened
# times the least misfit that any place allows: places that allow no less are not looked at. The bound is that of free
# harmonics, so that no law there leaves less; ten covers the one linear step of the diagram's own parameters in it
POSSIBLE = 10.0
MOST_LAWS = 16  # fitted in one round, where what laws promise is known
DECLARED = 2  # starts of a law that are tried beside one that is known to be near
AGAIN = 8  # of the best of an earlier round
PROMISED = 3.0  # times the least misfit that is promised: within, each law is fitted at its best place
BATCHES = 4  # of jobs, for every process
FIRST_EVALUATIONS, SECOND_EVALUATIONS = 5, 15  # of a nonlinear diagram, before it is judged whether it is worth more
LAST_EVALUATIONS = 3  # where the data are explained already, and only rivals are looked for
SECOND_STAGE_FITS = 8  # nonlinear fits that get as far as the second
REFINED = 3  # fits carried to the end at least
PROMISING = 0.3  # of the misfit before: below, a fit is carried to the end
HINT = 0.3  # drop of the misfit for each parameter, with data that are explained already, that is worth a closer look
STARTED = 0.1  # share of what the best explains: of nonlinear laws below, SECOND_EVALUATIONS are the last
RESTART = 0.1  # of its scale: how far off a bound a parameter of the diagram begins again
RIVAL_MISFIT = 100.0  # times the misfit of one that explains the data: beyond, no rival of it will

_Job = tuple[dict[str, Any], list[list[dict[str, float]]]]  # a document with an insertion, groups of starts


@dataclass(frozen=True, eq=False)
class Candidate:
    """An insertion and the refitted diagram with it.

    astray: parameters of the diagram that have left all reason. final: whether the fit was carried to the end.
    """

    insertion: Insertion
    fit: Fit
    astray: str = ""
    final: bool = True

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of the parameters of the fault in the diagram."""
        return tuple(name for name in self.insertion.free if name in self.fit.values)

    @property
    def ended(self) -> tuple[str, ...]:
        """The parameters of the fault that ended at a bound."""
        ended = {item.name for item, end in zip(self.fit.free, self.fit.at_bound, strict=True) if end}
        return tuple(name for name in self.parameters if name in ended)

    @property
    def physical(self) -> bool:
        """Whether this can be: see `unphysical`."""
        return not self.unphysical

    @property
    def unphysical(self) -> str:
        """Why this cannot be, empty where it can.

        A parameter of the fault ended at a bound; none of its sizes differs significantly from zero (their 90 %
        intervals hold it, were the rest of its law known); or it needs a parameter of the diagram far beyond all
        reason, as one that cancels the effect is.
        """
        fit = self.fit
        if fit.failure:
            return ""
        if self.ended:
            return f"its {', '.join(name.rpartition('.')[2] for name in self.ended)} ended at a physical bound"
        names = [item.name for item in fit.free]
        sizes = [name for name in self.parameters if name.rpartition(".")[2] in self.insertion.fault.sizes]
        std = fit.alone if len(fit.alone) else np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
        significant = (abs(fit.theta[j]) > Z90 * std[j] for j in map(names.index, sizes))
        if sizes and not any(significant):
            keys = " and ".join(name.rpartition(".")[2] for name in sizes)
            return f"its {keys} is not significantly different from zero"
        return f"needs {self.astray}" if self.astray else ""


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the selection: what was tried on top of ``before``, the best first; classes: of free signals.

    ways: physics and places that were looked at, with those of which too little was promised to try them.
    """

    before: Fit
    tried: tuple[Candidate, ...]
    classes: tuple[PlaceClass, ...] = ()
    ways: int = 0

    @property
    def best(self) -> Candidate | None:
        """The best candidate that is physical."""
        return next((item for item in self.tried if not item.fit.failure and item.physical), None)


class Trials:
    """Insertions into fitted diagrams, each refitted; ``slack``: of the misfit, what says nothing.

    earlier: a round with another measure of the noise, whose best candidates are fitted again, from where they were.
    """

    def __init__(self, evidence: Evidence, catalogue: Catalogue, jobs: Jobs, earlier: Round | None = None) -> None:
        self.evidence, self.catalogue, self.jobs = evidence, catalogue, jobs
        best = [] if earlier is None else [item for item in earlier.tried if not item.fit.failure][:AGAIN]
        self.known = {item.insertion.key: {name: item.fit.values[name] for name in item.parameters} for item in best}
        self.counts = {"fits": 0, "rounds": 0}
        self.nominal: dict[str, float] = {}
        self.unsized: frozenset[str] = frozenset()
        self.slack = 0.0

    def round(self, before: Fit) -> Round:
        """Try every insertion into a fitted diagram."""
        document, largest = values_in(before.document, before.values), self.evidence.largest()
        found = [
            item
            for item in self.catalogue.candidates(self.evidence.load(document), self.evidence.recorded)
            if (LINES in largest or not item.from_lines) and not item.from_steps
        ]
        self.counts["rounds"] += 1
        ways = len({(item.physics, item.spot) for item in found})
        jobs = []
        away = self._off_bounds(before)
        classes: Sequence[PlaceClass] = ()
        for item in found:
            sizes = sizes_at(item, largest)
            starts, fixed = starts_of(item, sizes), fixed_of(item, sizes)
            here = [dict(zip(item.free, start.values(), strict=True)) for start in starts]
            groups = [[{**off, **start} for off in (({}, away) if away else ({},)) for start in here]]
            if not before.nonlinear:  # else it costs too much to begin once more from values as given
                groups.append([{**self.nominal, **away, **start} for start in here])
            jobs.append((item.document(document, {**fixed, **starts[0]}, limits_of(item, sizes)), groups))
        if len(jobs) > MOST_FITS or self.evidence.costly or any(item.fault.enters == "signal" for item in found):
            places = self.evidence.bounds(before)
            kept = self._screened(before, found, jobs, places)
            classes = () if places is None else places.classes
            kept += [k for k, item in enumerate(found) if item.key in self.known and k not in kept]
            led = {k: {} if places is None else dict(places.start(found[k])) for k in kept}
            jobs = [(jobs[k][0], _led(jobs[k][1], self.known.get(found[k].key) or led[k])) for k in kept]
            found = [found[k] for k in kept]
        self.counts["fits"] += len(found)
        fits = self._fit(jobs, FIRST_EVALUATIONS, linear_only=True)
        later = [k for k, fit in enumerate(fits) if fit.failure == DEFERRED]
        explained = is_adequate(before) or any(is_adequate(fit) for fit in fits)
        more = self._fit([jobs[k] for k in later], LAST_EVALUATIONS if explained else FIRST_EVALUATIONS)
        for k, fit in zip(later, more, strict=True):
            fits[k] = fit
        fits, ended = self._refined(before, jobs, fits, [item.law for item in found])
        tried = [
            Candidate(item, fit, self._astray(before, fit), bool(fit.failure) or not fit.nonlinear or k in ended)
            for k, (item, fit) in enumerate(zip(found, fits, strict=True))
        ]
        return Round(before, tuple(_simplest_first(tried, self.slack)), tuple(classes), ways)

    def completed(self, found: Round, physics: Collection[str]) -> Round:
        """Return a round with these physics carried to the end, each law at its best place."""
        tried = list(found.tried)
        best: dict[tuple[str, int], int] = {}
        for k in sorted(range(len(tried)), key=lambda k: tried[k].fit.misfit):
            item = tried[k]
            if item.insertion.physics in physics and not item.fit.failure:
                best.setdefault(item.insertion.law, k)
        which = [k for k in best.values() if not tried[k].final]
        jobs: list[_Job] = [(values_in(tried[k].fit.document, tried[k].fit.values), [[{}]]) for k in which]
        for k, fit in zip(which, self._fit(jobs, None), strict=True):
            better = not fit.failure and fit.misfit <= tried[k].fit.misfit
            fit = fit if better else tried[k].fit
            tried[k] = Candidate(tried[k].insertion, fit, self._astray(found.before, fit))
        return replace(found, tried=tuple(_simplest_first(tried, self.slack))) if which else found

    def _astray(self, before: Fit, fit: Fit) -> str:
        """Return in words the parameters of the diagram that are ``astray`` times what was given and fitted.

        Of an offset that is given as zero nobody has stated a size.
        """
        found, known = [], before.values
        for item, value in zip(fit.free, fit.theta, strict=True):
            usual = max(item.scale, abs(self.nominal.get(item.name, 0.0)), abs(known.get(item.name, 0.0)))
            sized = item.name in self.nominal and item.name not in self.unsized and item.unit != ANGLE_UNIT
            if sized and abs(value) > CRITERIA.astray * usual > 0:
                found.append(f"{item.name} {abs(value) / usual:.2g} times as large")
        return " and ".join(found)

    def _off_bounds(self, fit: Fit) -> dict[str, float]:
        """Return where parameters of the diagram as given that ended at a bound begin again: as given, off the bound.

        What held one there may be gone with the next effect.
        """
        found = {}
        for item, ended in zip(fit.free, fit.at_bound, strict=True):
            if ended and item.name in self.nominal:
                off = min(RESTART * (item.scale or 1.0), (item.high - item.low) / 2)
                found[item.name] = float(np.clip(self.nominal[item.name], item.low + off, item.high - off))
        return found

    def _screened(
        self, before: Fit, candidates: Sequence[Insertion], jobs: Sequence[_Job], places: Bounds | None
    ) -> list[int]:
        """Return which insertions are fitted where places are many: each law at its best place, then the best places.

        A bound compares places for one law: with parameters far off, a law of two ports has less of it than one of one.
        """
        if self.evidence.costly:
            [beside, *promises] = self._promises([(values_in(before.document, before.values), [[{}]]), *jobs])
            least = HINT * len(before.free) if is_adequate(before) else 0.0  # below, it is noise
            gains = (beside - promise if beside - promise > least else 0.0 for promise in promises)
            return _most_promising(candidates, [before.misfit - gain for gain in gains], before)
        if places is not None and places.by_law:
            with one_thread():
                return _most_promising(candidates, [places.bound(item) for item in candidates], before)
        if is_adequate(before):
            return self._promising(candidates, jobs, before.misfit - HINT * MOST_FITS)
        if places is None:
            return self._promising(candidates, jobs)
        with one_thread():
            bounds = [places.bound(item) for item in candidates]
        known = sorted({bound for bound in bounds if bound is not None})
        if not known:
            return self._promising(candidates, jobs)
        kept = [k for k, bound in enumerate(bounds) if bound is None]
        best: dict[tuple[str, int], int] = {}
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

    def _promising(self, candidates: Sequence[Insertion], jobs: Sequence[_Job], most: float = np.inf) -> list[int]:
        """Return the best place of each law, and the next best below ``most``, by what one step promises."""
        promises = np.array(self._promises(jobs))
        order = np.argsort(promises, kind="stable")
        seen: set[tuple[str, int]] = set()
        first: list[int] = []
        second: list[int] = []
        for k in order.tolist():
            law = candidates[k].law
            if not np.isfinite(promises[k]):
                continue
            if law not in seen:
                first.append(k)
            elif promises[k] < most:
                second.append(k)
            seen.add(law)
        return [*first, *second[: max(MOST_FITS - len(first), MOST_FITS // 3)]]

    def _promises(self, jobs: Sequence[_Job]) -> list[float]:
        return [np.inf if isinstance(item, Failure) else item for item in self._spread(_promise_batch, jobs, ())]

    def _fit(self, jobs: Sequence[_Job], most: int | None, *, linear_only: bool = False) -> list[Fit]:
        fits = self._spread(_fit_batch, jobs, (most, linear_only))
        return [
            Fit(document, failure=plain.text) if isinstance(plain, Failure) else fit_from_plain(document, plain)
            for (document, _), plain in zip(jobs, fits, strict=True)
        ]

    def _spread(
        self, function: Callable[[Any], list[Any]], jobs: Sequence[_Job], options: tuple[Any, ...]
    ) -> list[Any]:
        """Return what a function gives for every job, in batches over all workers; `Failure` where a batch is lost."""
        if not jobs:
            return []
        count = min(len(jobs), BATCHES * (self.jobs.workers or 2))
        batches = [list(jobs[k::count]) for k in range(count)]
        results = run_jobs(
            function, [(batch, self.evidence, *options) for batch in batches], jobs=self.jobs, on_error="return"
        )
        out: list[Any] = [None] * len(jobs)
        for k, result in enumerate(results):
            out[k::count] = [result] * len(batches[k]) if isinstance(result, Failure) else result
        return out

    def _refined(
        self, before: Fit, jobs: Sequence[_Job], fits: list[Fit], laws: Sequence[tuple[str, int]]
    ) -> tuple[list[Fit], set[int]]:
        """Return the fits, and which of them were carried to the end: those that promise most.

        laws: physics and variant of each. Where one of all explains the data, only those near it matter any more.
        """
        if not any(is_adequate(fit) for fit in fits):
            order = [k for k in _by_misfit(fits) if fits[k].nonlinear]
            self._again(jobs, fits, order[:SECOND_STAGE_FITS], SECOND_EVALUATIONS)
        order = _by_misfit(fits)
        if is_adequate(before):  # only what is not noise matters
            order = [k for k in order if before.misfit - fits[k].misfit > HINT * len(fits[k].free)][:SECOND_STAGE_FITS]
        elif any(is_adequate(fit) for fit in fits):
            least = fits[order[0]].misfit
            slow = before.misfit - STARTED * (before.misfit - least)
            if before.misfit < RIVAL_MISFIT * least:
                best_of: dict[tuple[str, int], int] = {}  # of the places of each law
                for k in order:
                    best_of.setdefault(laws[k], k)
                self._again(jobs, fits, [k for k in best_of.values() if _is_slow(fits[k], slow)], SECOND_EVALUATIONS)
            order = [
                k for k in _by_misfit(fits) if fits[k].misfit < RIVAL_MISFIT * least and not _is_slow(fits[k], slow)
            ]
        else:
            order = [k for n, k in enumerate(order) if n < REFINED or fits[k].misfit < PROMISING * before.misfit]
        self._again(jobs, fits, order, None)
        return fits, set(order)

    def _again(self, jobs: Sequence[_Job], fits: list[Fit], which: Sequence[int], most: int | None) -> None:
        """Carry some fits on from where they are, in place."""
        continued: list[_Job] = []
        for k in which:
            away = {} if fits[k].nonlinear else self._off_bounds(fits[k])
            continued.append((values_in(jobs[k][0], fits[k].values), [[{}], *([[away]] if away else [])]))
        for k, fit in zip(which, self._fit(continued, most), strict=True):
            if not fit.failure and fit.misfit <= fits[k].misfit:
                fits[k] = replace(fit, seconds=fit.seconds + fits[k].seconds)

    def refitted(self, base: Fit, effects: Sequence[Candidate], near: Fit) -> tuple[Candidate, ...]:
        """Return these effects only, put in one by one; the last has the fit of all, from their values in ``near``.

        Empty where they cannot stand alone.
        """
        document, known = dict(base.document), dict(near.values)
        entered = []
        for item in effects:
            here = self.catalogue.candidates(self.evidence.load(document), self.evidence.recorded)
            again = next((other for other in here if other.key == item.insertion.key), None)
            if again is None:
                return ()
            old, new = item.insertion.name, again.name
            had = near.document["blocks"][old].get("parameters", {})
            own = {key: near.values[f"{old}.{key}"] for key in again.fault.free if f"{old}.{key}" in near.values}
            set_once = {key: had[key] for key in again.fault.fixed if key in had}
            bounds = {key: near.document["identify"].get(f"{old}.{key}", {}) for key in again.fault.free}
            limits = {key: (given["low"], given["high"]) for key, given in bounds.items() if given}
            document = again.document(document, {**own, **set_once}, limits)
            known |= {f"{new}.{key}": value for key, value in own.items()}
            entered.append(again)
        known = {name: value for name, value in known.items() if name in document["identify"]}
        document = values_in(document, known)  # a block that was put in the place of another has others
        with one_thread():
            fit = self.evidence.fit(document, [[{}], [{**self.nominal, **self._off_bounds(near)}]])
        if fit.failure:
            return ()
        pairs = zip(entered[:-1], effects, strict=False)
        kept = (Candidate(new, old.fit if new.name == old.insertion.name else fit) for new, old in pairs)
        return (*kept, Candidate(entered[-1], fit))


def _most_promising(candidates: Sequence[Insertion], bounds: Sequence[float | None], before: Fit) -> list[int]:
    """Return the insertions of which nothing is known, and those that promise most: each law first."""
    kept = [k for k, bound in enumerate(bounds) if bound is None]
    promised = {k: bound for k, bound in enumerate(bounds) if bound is not None and bound < before.misfit}
    order = sorted(promised, key=lambda k: promised[k])
    best: dict[tuple[str, int], int] = {}
    for k in order:
        if promised[k] <= PROMISED * max(promised[order[0]], before.freedom):
            best.setdefault(candidates[k].law, k)
    first = list(best.values())[:MOST_LAWS]
    more = [k for k in order if k not in first and promised[k] <= PROMISED * max(promised[order[0]], before.freedom)]
    return [*kept, *first, *more[: max(MOST_LAWS - len(first), 0)]]


def _led(groups: list[list[dict[str, float]]], start: dict[str, float]) -> list[list[dict[str, float]]]:
    """Return one that is known to be near, the same beside the diagram as given, and DECLARED starts, in one group."""
    if not start:
        return groups
    return [[start, {**groups[-1][0], **start}, *(group[0] for group in groups[:DECLARED])]]


def _is_slow(fit: Fit, most: float) -> bool:
    """Return whether the fit of a nonlinear law has not got below a misfit: it may have begun too far away."""
    return fit.nonlinear and fit.misfit > most


def _by_misfit(fits: Sequence[Fit]) -> list[int]:
    return sorted((k for k, fit in enumerate(fits) if not fit.failure), key=lambda k: fits[k].misfit)


def _simplest_first(tried: list[Candidate], slack: float) -> list[Candidate]:
    """Return candidates by their criterion; of those that it does not tell from the best, the simplest first."""
    tried = sorted(tried, key=lambda item: (bool(item.fit.failure), item.fit.criterion))
    least = next((item.fit.criterion for item in tried if not item.fit.failure and item.physical), np.inf)
    near = [item for item in tried if not item.fit.failure and item.physical and item.fit.criterion <= least + slack]
    near.sort(key=lambda item: (len(item.fit.free), item.fit.criterion))
    return [*near, *(item for item in tried if item not in near)]


def _promise_batch(argument: tuple[list[_Job], Evidence]) -> list[float]:
    batch, evidence = argument
    with one_thread():
        return [evidence.promise(document, starts) for document, starts in batch]


def _fit_batch(argument: tuple[list[_Job], Evidence, int | None, bool]) -> list[dict[str, Any]]:
    batch, evidence, most, linear_only = argument
    with one_thread():
        return [
            fit_to_plain(evidence.fit(document, starts, most=most, linear_only=linear_only))
            for document, starts in batch
        ]
