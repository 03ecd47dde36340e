"""Fits and promises of many documents, shared out over all workers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Insertion, Law
from rotorsim.diagnosis.evidence.evidence import Evidence, Promise, Promising
from rotorsim.diagnosis.evidence.fit import Effort, Fit, fit_from_plain, fit_to_plain
from rotorsim.diagnosis.search.candidates import Job
from rotorsim.diagram.resolve.registry import is_built_in
from rotorsim.jobs.jobs import Failure, Jobs, run_jobs
from rotorsim.jobs.tasks import KILLED
from rotorsim.jobs.threads import one_thread
from rotorsim.model.heard import Heard, Mishap, hearing, listener

DIED = KILLED["failure"]["type"]
BATCHES = 4  # of jobs, for every process
Answer = dict[str, Any]  # of a batch: what was found, and the mishaps on the way


@dataclass(frozen=True, eq=False)
class Work:
    """What evidence says of documents, over the processes of ``jobs``."""

    evidence: Evidence
    jobs: Jobs

    def promises_of_laws(
        self, candidates: Sequence[Insertion], places: Promising, batches: int = 0
    ) -> list[Promise | None]:
        """Return what laws promise, shared out over all workers, all places of a law together.

        Blocks of the user are not known there. batches: how many (default: BATCHES for every process).
        """
        of_law: dict[Law, list[int]] = {}
        for k, item in enumerate(candidates):
            of_law.setdefault(item.law if is_built_in(item.kind) else ("", 0, False), []).append(k)
        here = of_law.pop(("", 0, False), [])
        count = batches or BATCHES * self.jobs.processes
        shared: list[list[int]] = [[] for _ in range(min(len(of_law), count))]
        for which in sorted(of_law.values(), key=len, reverse=True):
            min(shared, key=len).extend(which)
        arguments = [([candidates[k] for k in batch], places) for batch in (*shared, here)]
        given = [*run_jobs(_promised_batch, arguments[:-1], jobs=self.jobs), _promised_batch(arguments[-1])]
        given = [_heard_of(answer) for answer in given]
        found: list[Promise | None] = [None] * len(candidates)
        for batch, promises in zip((*shared, here), given, strict=True):
            for k, one in zip(batch, promises, strict=True):
                found[k] = None if one is None else Promise(**one)
        return found

    def promises(self, jobs: Sequence[Job]) -> list[float]:
        """Return what documents with a law promise, NaN where that is not known: a part failed, or the job."""
        found = self._spread(_promise_batch, jobs, ())
        return [np.nan if isinstance(item, Failure) else item for item in found]

    def fits(self, jobs: Sequence[Job], effort: Effort) -> list[Fit]:
        """Return the fits of documents; of one that is lost, its failure."""
        fits = self._spread(_fit_batch, jobs, (effort,))
        return [
            Fit(document, failure=_reason(plain), stopped=True)
            if isinstance(plain, Failure)
            else fit_from_plain(document, plain)
            for (document, _), plain in zip(jobs, fits, strict=True)
        ]

    def _spread(self, function: Callable[[Any], Answer], jobs: Sequence[Job], options: tuple[Any, ...]) -> list[Any]:
        """Return what a function gives for every job, in batches over all workers; `Failure` of one that is lost."""
        if not jobs:
            return []
        count = min(len(jobs), BATCHES * (self.jobs.workers or 2))
        out: list[Any] = [None] * len(jobs)
        batches = [range(k, len(jobs), count) for k in range(count)]
        while batches:  # those that failed are done once more, one by one: only the job that did is lost
            arguments = [([jobs[k] for k in batch], self.evidence, *options) for batch in batches]
            results = run_jobs(function, arguments, jobs=self.jobs, on_error="return")
            again: list[range] = []
            for batch, result in zip(batches, results, strict=True):
                if isinstance(result, Failure) and len(batch) > 1:
                    again += [range(k, k + 1) for k in batch]
                    continue
                found = [result] * len(batch) if isinstance(result, Failure) else _heard_of(result)
                for k, one in zip(batch, found, strict=True):
                    out[k] = one
            batches = again
        return out


def _reason(failure: Failure) -> str:
    """Return in words why a job is lost: its process died, or an error that nobody foresaw."""
    return failure.text if failure.type == DIED else f"internal error: {failure.type}: {failure.text}"


def _heard_of(answer: Answer) -> list[Any]:
    """Return what a batch has found, once who listens here has heard what went wrong there."""
    listener().add(Mishap(**one) for one in answer["mishaps"])
    return list(answer["found"])


def _each(function: Callable[[Any], Any], items: Iterable[Any]) -> Answer:
    """Return what a function gives for every item, and what went wrong meanwhile, each item being a fit of its own."""
    every, found = Heard(), []
    with one_thread():
        for item in items:
            with hearing() as heard:
                found.append(function(item))
            every.add(heard.mishaps)
    return {"found": found, "mishaps": [asdict(one) for one in every.mishaps]}


def _promise_batch(argument: tuple[list[Job], Evidence]) -> Answer:
    batch, evidence = argument

    def promise(job: Job) -> float:
        found = evidence.promise(job[0], job[1])
        return np.nan if found == np.inf and any(one.kind for one in listener().mishaps) else found

    return _each(promise, batch)


def _promised_batch(argument: tuple[list[Insertion], Promising]) -> Answer:
    items, places = argument
    answer = _each(places.promises, [items])
    promised = (None if one is None else asdict(one) for one in answer["found"][0])
    return {**answer, "found": [*promised]}


def _fit_batch(argument: tuple[list[Job], Evidence, Effort]) -> Answer:
    batch, evidence, effort = argument
    return _each(lambda job: fit_to_plain(evidence.fit(job[0], job[1], effort)), batch)
