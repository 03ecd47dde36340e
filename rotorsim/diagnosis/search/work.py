"""Fits and promises of many documents, shared out over all workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Insertion, Law
from rotorsim.diagnosis.evidence.evidence import Bounds, Evidence, Promise
from rotorsim.diagnosis.evidence.fit import Effort, Fit, fit_from_plain, fit_to_plain
from rotorsim.diagnosis.search.candidates import Job
from rotorsim.diagram.resolve.registry import is_built_in
from rotorsim.jobs.jobs import Failure, Jobs, run_jobs
from rotorsim.jobs.threads import one_thread

BATCHES = 4  # of jobs, for every process


@dataclass(frozen=True, eq=False)
class Work:
    """What evidence says of documents, over the processes of ``jobs``."""

    evidence: Evidence
    jobs: Jobs

    def promises_of_laws(self, candidates: Sequence[Insertion], places: Bounds) -> list[Promise | None]:
        """Return what laws promise, shared out over all workers, all places of a law together.

        Blocks of the user are not known there.
        """
        of_law: dict[Law, list[int]] = {}
        for k, item in enumerate(candidates):
            of_law.setdefault(item.law if is_built_in(item.kind) else ("", 0, False), []).append(k)
        here = of_law.pop(("", 0, False), [])
        batches: list[list[int]] = [[] for _ in range(min(len(of_law), BATCHES * self.jobs.processes))]
        for which in sorted(of_law.values(), key=len, reverse=True):
            min(batches, key=len).extend(which)
        arguments = [([candidates[k] for k in batch], places) for batch in (*batches, here)]
        given = [*run_jobs(_promised_batch, arguments[:-1], jobs=self.jobs), _promised_batch(arguments[-1])]
        found: list[Promise | None] = [None] * len(candidates)
        for batch, promises in zip((*batches, here), given, strict=True):
            for k, one in zip(batch, promises, strict=True):
                found[k] = None if one is None else Promise(*one)
        return found

    def promises(self, jobs: Sequence[Job]) -> list[float]:
        """Return what documents with a law promise, infinite where a batch is lost."""
        return [np.inf if isinstance(item, Failure) else item for item in self._spread(_promise_batch, jobs, ())]

    def fits(self, jobs: Sequence[Job], effort: Effort) -> list[Fit]:
        """Return the fits of documents; of a batch that is lost, its failure."""
        fits = self._spread(_fit_batch, jobs, (effort,))
        return [
            Fit(document, failure=plain.text) if isinstance(plain, Failure) else fit_from_plain(document, plain)
            for (document, _), plain in zip(jobs, fits, strict=True)
        ]

    def _spread(self, function: Callable[[Any], list[Any]], jobs: Sequence[Job], options: tuple[Any, ...]) -> list[Any]:
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


def _promise_batch(argument: tuple[list[Job], Evidence]) -> list[float]:
    batch, evidence = argument
    with one_thread():
        return [evidence.promise(document, starts) for document, starts in batch]


def _promised_batch(argument: tuple[list[Insertion], Bounds]) -> list[tuple[float, dict[str, float]] | None]:
    items, places = argument
    with one_thread():
        return [None if one is None else (one.misfit, dict(one.start)) for one in places.promises(items)]


def _fit_batch(argument: tuple[list[Job], Evidence, Effort]) -> list[dict[str, Any]]:
    batch, evidence, effort = argument
    with one_thread():
        return [fit_to_plain(evidence.fit(document, starts, effort)) for document, starts in batch]
