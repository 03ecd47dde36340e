"""Name what is missing: every row of the catalogue at every place is put into the diagram, refitted and judged."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from rotorsim.diagnose.fitting import LATER, Fit, Source, fit_from_plain, fit_to_plain
from rotorsim.diagnose.insertion import Insertion, Spot, fixed_of, insertions, starts_of
from rotorsim.diagram.registry import Registry
from rotorsim.identify.coordinates import ANGLE_UNIT
from rotorsim.jobs import Failure, local_workers, run_jobs

__all__ = ["Candidate", "Named", "Round", "is_adequate", "least_gain", "name_missing"]

NOT_EXPLAINED = 1e-4  # probability of the misfit below which a model does not explain the data
MODEL_ERROR = 1.05  # excess variance that is not worth a name, whatever its probability
CLASS = 10.0  # criterion within which two explanations are not told apart (odds of 150 to 1)
MOST_EFFECTS = 3
FALSE_ALARM = 0.01  # probability that noise alone makes any row of the catalogue look as good
WORTH = 0.9  # share of what is left unexplained that one more effect must explain
BEAM = 2  # explanations that the next round starts from
MOST_FITS = 90  # in one round; places beyond are screened
BATCHES = 4  # of jobs, for every process
FIRST_EVALUATIONS, SECOND_EVALUATIONS = 5, 15  # of a nonlinear diagram, before it is judged whether it is worth more
LAST_EVALUATIONS = 3  # where the data are explained already, and only rivals are looked for
SECOND = 8  # nonlinear fits that get as far as the second
REFINED = 3  # fits carried to the end at least
PROMISING = 0.3  # of the misfit before: below, a fit is carried to the end
HINT = 0.3  # drop of the misfit for each parameter, with data that are explained already, that is worth a closer look
NEAR = 100.0  # times the misfit of one that explains the data: beyond, no rival of it will

_Job = tuple[dict[str, Any], list[list[dict[str, float]]]]


@dataclass(frozen=True, eq=False)
class Candidate:
    """An insertion and the refitted diagram with it."""

    insertion: Insertion
    fit: Fit

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of the parameters of the fault in the diagram."""
        return tuple(name for name in self.insertion.free if name in self.fit.values)

    @property
    def physical(self) -> bool:
        """Whether no parameter of the fault ended at a bound."""
        names = [item.name for item in self.fit.free]
        return not any(self.fit.at_bound[names.index(name)] for name in self.parameters)


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the selection: what was tried on top of ``before``, the best first."""

    before: Fit
    tried: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate | None:
        """The best candidate that is physical."""
        return next((item for item in self.tried if not item.fit.failure and item.physical), None)


@dataclass(frozen=True, eq=False)
class Named:
    """base: the diagram as given, refitted. chosen: the effects, in the order in which they were found; fit: with all.

    rounds: what was tried for each of them, with all others in place. level: probability of a false alarm for each.
    """

    base: Fit
    chosen: tuple[Candidate, ...]
    rounds: tuple[Round, ...]
    fit: Fit
    level: float
    counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def explained(self) -> bool:
        """Whether what is left over is noise."""
        return is_adequate(self.fit)


def is_adequate(found: Fit) -> bool:
    """Return whether a model leaves over what noise can make."""
    if found.failure:
        return False
    return found.goodness >= NOT_EXPLAINED or found.misfit <= MODEL_ERROR * found.freedom


def name_missing(
    base: Fit,
    source: Source,
    *,
    registry: Registry | None = None,
    physics: Collection[str] | None = None,
    most: int = MOST_EFFECTS,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Named:
    """Return what explains a recording that the fitted diagram ``base`` does not, effect by effect.

    physics: rows of the catalogue that are tried (default: all).
    Raises RotorsimError.
    """
    with ExitStack() as stack:
        if scheduler is None:
            scheduler, workers = stack.enter_context(local_workers(workers)), None
        return _named(_Selection(source, registry, physics, workers, scheduler, progress), base, most)


def _named(selection: _Selection, base: Fit, most: int) -> Named:
    selection.nominal = {item.name: item.value for item in base.free if item.unit != ANGLE_UNIT}
    first = selection.round(base)
    level = _level(first.tried)
    if is_adequate(base) and not _noticed(first, base, level):
        return Named(base, (), (first,), base, level, selection.counts)
    beam: list[tuple[Candidate, ...]] = [(item,) for item in _distinct(first, base)[:BEAM]]
    if not beam:
        return Named(base, (), (first,), base, level, selection.counts)
    chosen: tuple[Candidate, ...] = beam[0]
    rounds = [first]
    while not is_adequate(chosen[-1].fit) and len(chosen) < most:
        grown: list[tuple[tuple[Candidate, ...], Round]] = []
        for path in beam:
            after = selection.round(path[-1].fit)
            for item in _distinct(after, path[-1].fit)[:1]:
                grown.append(((*path, item), after))
            if grown and is_adequate(grown[-1][0][-1].fit):
                break
        if not grown:
            break
        grown.sort(key=lambda pair: pair[0][-1].fit.criterion)
        best, after = grown[0]
        if not is_adequate(best[-1].fit) and _share(best[-1].fit, chosen[-1].fit) < WORTH:
            break
        beam, chosen = [path for path, _ in grown], best
        rounds = [*rounds, after]
    if is_adequate(chosen[-1].fit):
        chosen, rounds = selection.reconsidered(base, chosen, rounds)
    return Named(base, chosen, tuple(rounds), chosen[-1].fit, level, selection.counts)


def _level(tried: Sequence[Candidate]) -> float:
    """Return the probability of a false alarm that one of these candidates may take up."""
    ways = {(item.insertion.physics, item.insertion.spot) for item in tried if not item.fit.failure}
    return FALSE_ALARM / max(len(ways), 1)


def least_gain(item: Candidate, base: Fit, level: float) -> float:
    """Return the drop of the misfit that noise alone makes by the unknowns of a candidate with probability level.

    A nonlinear law has one more: where it begins to act is chosen, too.
    """
    return float(chi2.isf(level, max(item.fit.unknowns - base.unknowns + item.fit.nonlinear, 1)))


def _by_misfit(fits: Sequence[Fit]) -> list[int]:
    return sorted((k for k, fit in enumerate(fits) if not fit.failure), key=lambda k: fits[k].misfit)


def _share(after: Fit, before: Fit) -> float:
    """Return the share of what was left unexplained before that is explained after."""
    return 1 - (after.misfit - after.freedom) / max(before.misfit - before.freedom, 1.0)


def _noticed(found: Round, base: Fit, level: float) -> bool:
    """Return whether a candidate explains more than noise would have it explain."""
    return any(
        base.misfit - item.fit.misfit > least_gain(item, base, level) for item in found.tried if not item.fit.failure
    )


def _distinct(found: Round, before: Fit) -> list[Candidate]:
    """Return the physical candidates that explain more than before, the best of each physics."""
    best: dict[str, Candidate] = {}
    for item in found.tried:
        if not item.fit.failure and item.physical and item.fit.criterion < before.criterion:
            best.setdefault(item.insertion.physics, item)
    return list(best.values())


class _Selection:
    def __init__(
        self, source: Source, registry: Registry | None, physics: Collection[str] | None, workers: int | None,
        scheduler: str | None, progress: Callable[[float], None] | None,
    ) -> None:  # fmt: skip
        self.source, self.registry, self.physics = source, registry, physics
        self.workers, self.scheduler, self.progress = workers, scheduler, progress
        self.counts = {"fits": 0, "rounds": 0}
        self.nominal: dict[str, float] = {}

    def round(self, before: Fit) -> Round:
        """Try every insertion into a fitted diagram."""
        document = values_in(before.document, before.values)
        diagram = self.source.load(document)
        found = insertions(diagram, self.source.recorded, self.registry)
        if self.physics is not None:
            found = [item for item in found if item.physics in self.physics]
        self.counts["rounds"] += 1
        jobs = []
        largest = self.source.largest()
        for item in found:
            sizes = _sizes(item, largest)
            starts, fixed = starts_of(item, sizes), fixed_of(item, sizes)
            here = [dict(zip(item.free, start.values(), strict=True)) for start in starts]
            groups = [here, [{**self.nominal, **start} for start in here]]
            jobs.append((item.document(document, {**fixed, **starts[0]}), groups))
        if len(jobs) > MOST_FITS:
            kept = self._screened(found, jobs)
            found, jobs = [found[k] for k in kept], [jobs[k] for k in kept]
        self.counts["fits"] += len(found)
        fits = self._fit(jobs, FIRST_EVALUATIONS, linear_only=True)
        later = [k for k, fit in enumerate(fits) if fit.failure == LATER]
        explained = is_adequate(before) or any(is_adequate(fit) for fit in fits)
        more = self._fit([jobs[k] for k in later], LAST_EVALUATIONS if explained else FIRST_EVALUATIONS)
        for k, fit in zip(later, more, strict=True):
            fits[k] = fit
        fits = self._refined(before, jobs, fits)
        tried = [Candidate(item, fit) for item, fit in zip(found, fits, strict=True)]
        tried.sort(key=lambda item: (bool(item.fit.failure), item.fit.criterion))
        return Round(before, tuple(tried))

    def _screened(self, found: Sequence[Insertion], jobs: Sequence[_Job]) -> list[int]:
        """Return which insertions are fitted where places are many: the best place of each law, then the next best.

        They are judged by the misfit that one step from their start promises.
        """
        promises = np.array(self._promises(jobs))
        order = np.argsort(promises, kind="stable")
        seen: set[tuple[str, int]] = set()
        first: list[int] = []
        second: list[int] = []
        for k in order.tolist():
            law = (found[k].physics, found[k].variant)
            if not np.isfinite(promises[k]):
                continue
            (second if law in seen else first).append(k)
            seen.add(law)
        return [*first, *second[: max(MOST_FITS - len(first), MOST_FITS // 3)]]

    def _promises(self, jobs: Sequence[_Job]) -> list[float]:
        count = min(len(jobs), BATCHES * (self.workers or 2))
        batches = [list(jobs[k::count]) for k in range(count)]
        results = run_jobs(
            _promise_batch, [(batch, self.source) for batch in batches], workers=self.workers,
            scheduler=self.scheduler, progress=self.progress, on_error="return",
        )  # fmt: skip
        out = [float("inf")] * len(jobs)
        for k, result in enumerate(results):
            if not isinstance(result, Failure):
                out[k::count] = result
        return out

    def _refined(self, before: Fit, jobs: Sequence[_Job], fits: list[Fit]) -> list[Fit]:
        """Return the fits, those that promise most carried to the end.

        Where one of all explains the data, only those near it matter any more.
        """
        if not any(is_adequate(fit) for fit in fits):
            order = [k for k in _by_misfit(fits) if fits[k].nonlinear]
            self._again(jobs, fits, order[:SECOND], SECOND_EVALUATIONS)
        order = _by_misfit(fits)
        if is_adequate(before):  # only what is not noise matters
            order = [k for k in order if before.misfit - fits[k].misfit > HINT * len(fits[k].free)][:SECOND]
        elif any(is_adequate(fit) for fit in fits):
            near = NEAR * min(fit.misfit for fit in fits if not fit.failure)
            order = [k for k in order if fits[k].misfit < near]
        else:
            order = [k for n, k in enumerate(order) if n < REFINED or fits[k].misfit < PROMISING * before.misfit]
        self._again(jobs, fits, order, None)
        return fits

    def _again(self, jobs: Sequence[_Job], fits: list[Fit], which: Sequence[int], most: int | None) -> None:
        """Carry some fits on from where they are, in place."""
        continued: list[_Job] = [(values_in(jobs[k][0], fits[k].values), [[{}]]) for k in which]
        for k, fit in zip(which, self._fit(continued, most), strict=True):
            if not fit.failure and fit.misfit <= fits[k].misfit:
                fits[k] = replace(fit, seconds=fit.seconds + fits[k].seconds)

    def _fit(self, jobs: Sequence[_Job], most: int | None, *, linear_only: bool = False) -> list[Fit]:
        if not jobs:
            return []
        count = min(len(jobs), BATCHES * (self.workers or 2))
        batches = [list(jobs[k::count]) for k in range(count)]
        results = run_jobs(
            _fit_batch, [(batch, self.source, most, linear_only) for batch in batches], workers=self.workers,
            scheduler=self.scheduler, progress=self.progress, on_error="return",
        )  # fmt: skip
        fits: list[Fit] = [Fit(document, failure="was not fitted") for document, _ in jobs]
        for k, result in enumerate(results):
            if isinstance(result, Failure):
                for j in range(k, len(jobs), count):
                    fits[j] = Fit(jobs[j][0], failure=result.text)
                continue
            for j, plain in zip(range(k, len(jobs), count), result, strict=True):
                fits[j] = fit_from_plain(jobs[j][0], plain)
        return fits

    def reconsidered(
        self, base: Fit, chosen: tuple[Candidate, ...], rounds: list[Round]
    ) -> tuple[tuple[Candidate, ...], list[Round]]:  # fmt: skip
        """Return the choice without effects that others make superfluous, every one tried again beside the others.

        Effects are found one by one, so that an early one may stand for what a later one explains better.
        """
        k = 0
        while len(chosen) > 1 and k < len(chosen):
            others = [item for j, item in enumerate(chosen) if j != k]
            without = self.refitted(base, others, chosen[-1].fit)
            if not without.failure and without.criterion <= chosen[-1].fit.criterion:
                chosen = (*others[:-1], Candidate(others[-1].insertion, without))
                rounds = [item for j, item in enumerate(rounds) if j != k]
                k = 0
                continue
            if k == len(chosen) - 1:  # it was found beside all the others
                break
            again = self.round(without)
            rounds[k] = again
            best = again.best
            if best is not None and best.fit.criterion < chosen[-1].fit.criterion - CLASS:
                chosen = (*others, best)
                rounds = [*(item for j, item in enumerate(rounds) if j != k), again]
                k = 0
                continue
            k += 1
        return chosen, rounds

    def refitted(self, base: Fit, effects: Sequence[Candidate], near: Fit) -> Fit:
        """Return the diagram with these effects only, fitted from their values in another fit."""
        document = base.document
        for item in effects:
            document = item.insertion.document(document)
        document = values_in(document, near.values)
        with threadpool_limits(1, "blas"):
            return self.source.fit(document, [[{}], [self.nominal]])


def _promise_batch(argument: tuple[list[_Job], Source]) -> list[float]:
    batch, source = argument
    with threadpool_limits(1, "blas"):
        return [source.promise(document, starts) for document, starts in batch]


def _fit_batch(argument: tuple[list[_Job], Source, int | None, bool]) -> list[dict[str, Any]]:
    batch, source, most, linear_only = argument
    with threadpool_limits(1, "blas"):
        return [
            fit_to_plain(source.fit(document, starts, most=most, linear_only=linear_only)) for document, starts in batch
        ]


def values_in(document: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """Return a document with SI values in place of those of parameters ("e", "rub.gap", "bearing.k[2]") that it has."""
    new = {**document, "parameters": dict(document.get("parameters", {})), "blocks": dict(document["blocks"])}
    for name, value in values.items():
        base, _, inside = name.partition("[")
        block, _, key = base.rpartition(".")
        if not block:
            if base in new["parameters"]:
                new["parameters"][base] = _replaced(new["parameters"][base], inside, float(value))
        elif block in new["blocks"]:
            changed = dict(new["blocks"][block])
            parameters = dict(changed.get("parameters", {}))
            parameters[key] = _replaced(parameters.get(key), inside, float(value))
            new["blocks"][block] = {**changed, "parameters": parameters}
    return new


def _replaced(before: Any, inside: str, value: float) -> Any:
    """Return a parameter's JSON value with one entry ("2" or "3,1]" of it, counted from 1) replaced."""
    if not inside:
        return value
    if not isinstance(before, list):
        return before  # one value for all entries: each is found again from there
    head, _, rest = inside.rstrip("]").partition(",")
    out = list(before)
    out[int(head) - 1] = _replaced(out[int(head) - 1], rest, value)
    return out


def _sizes(insertion: Insertion, largest: Mapping[str, float]) -> dict[str, float]:
    """Return the largest magnitude of the inputs of an insertion that were recorded (at their node or any)."""
    out = {}
    for key, source in insertion.feeds.items():
        exact = [v for name, v in largest.items() if name.startswith(source.rstrip("]"))]
        near = [v for name, v in largest.items() if name.partition("[")[0] == source.partition("[")[0]]
        if exact or near:
            out[key] = max(exact or near)
    return out


def where(tried: Sequence[Candidate], scale: float) -> list[tuple[Spot, float]]:
    """Return the probability of every spot, by the best candidate there; scale: variance of the noise, as a factor."""
    best: dict[Spot, float] = {}
    for item in tried:
        if not item.fit.failure:
            spot = item.insertion.spot
            best[spot] = min(best.get(spot, np.inf), item.fit.criterion)
    if not best:
        return []
    least = min(best.values())
    weights = {spot: float(np.exp(-0.5 * (value - least) / max(scale, 1.0))) for spot, value in best.items()}
    total = sum(weights.values())
    return sorted(((spot, weight / total) for spot, weight in weights.items()), key=lambda pair: -pair[1])
