"""Lists of independent jobs (sweeps, Monte-Carlo, bootstraps, fits) on local processes, or on a cluster by Dask.

Results go to a store as they finish; an interrupted run resumes from it. Local processes are reached over pipes
(`rotorsim.jobs.processes`): nothing listens on the network.
"""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.cluster import run_on_cluster
from rotorsim.jobs.processes import Pool
from rotorsim.jobs.store import Outcome, open_store
from rotorsim.jobs.tasks import Function, Job, outcome
from rotorsim.jobs.threads import in_worker, own_cores

LISTED_FAILURES = 5  # failures in an error


@dataclass(frozen=True)
class Jobs:
    """How lists of jobs are run.

    workers: processes (default: one for every CPU), or how many tasks at a time a cluster gets. With one worker or
    one job all is done in this process.
    scheduler: None: processes of this machine, one thread each (in a script, call it under
    ``if __name__ == "__main__":``); "synchronous": this process; "tcp://host:port" or "tls://host:port": a Dask
    cluster. Whoever reaches such a scheduler can run code on its workers, and in this process, which unpickles what
    it answers: name only one that nobody else can reach, or one that TLS guards (Dask's configuration).
    progress: called with the fraction done (0..1). pool: processes that are kept (`local_workers`).

    Raises RotorsimError for what cannot be a scheduler or a number of workers.
    """

    workers: int | None = None
    scheduler: str | None = None
    progress: Callable[[float], None] | None = None
    pool: Pool | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        problems = []
        named = self.scheduler
        if named not in (None, "synchronous") and not re.fullmatch(r"(tcp|tls)://[^/]+:\d+", str(named)):
            problems.append(
                Problem(
                    f"'{named}' is not the address of a scheduler",
                    "scheduler",
                    hint="tcp://host:port of a Dask scheduler, or synchronous",
                )
            )
        if self.workers is not None and self.workers < 1:
            problems.append(Problem(f"{self.workers} workers: at least one is needed", "workers"))
        if problems:
            raise RotorsimError(*problems)

    @property
    def processes(self) -> int:
        """How many processes there are at least: 1 where it is this one, or nothing is known of a cluster."""
        return self.pool.size if self.pool else self.workers or 1 if self.scheduler else _processes(self)


@dataclass(frozen=True)
class Failure:
    """A job that failed: its index (from 0), the type of the error, and what it said."""

    index: int
    type: str
    text: str


def run_jobs(
    function: Function,
    arguments: Sequence[Any],
    *,
    jobs: Jobs = Jobs(),
    store: str | Path | None = None,
    key: str = "",
    chunk: int = 1,
    on_error: str = "raise",
) -> list[Any]:
    """Return ``[function(argument) for argument in arguments]``, computed in parallel.

    function: of a module, not nested; returns dicts, lists, numbers, text or None. NumPy numbers and arrays become
    numbers and lists, tuples become lists; NaN and infinity are kept.
    store: file of JSON lines (NaN as Python writes it), one for every job as it finishes. Jobs found there are not
    run again, failed ones are; a list that was made longer runs what is new.
    key: whatever else decides the results than the name of the function and the arguments.
    chunk: jobs handed over at a time; more for short jobs.
    on_error: "raise": all jobs are run, then the failures are raised; "return": a `Failure` stands for the result.

    Raises RotorsimError.
    """
    if chunk < 1:
        raise RotorsimError(Problem(f"{chunk} jobs at a time: at least one is needed", "chunk"))
    if on_error not in ("raise", "return"):
        raise RotorsimError(Problem(f"'{on_error}' is unknown", "on_error", hint="raise or return"))
    total = len(arguments)
    with open_store(store, function, key, arguments) as (outcomes, append):
        left = [(index, argument) for index, argument in enumerate(arguments) if index not in outcomes]
        if jobs.progress and outcomes:
            jobs.progress(len(outcomes) / total)
        with closing(_finished(function, left, jobs, chunk)) as finished:
            for index, ended in finished:
                append(index, ended)
                outcomes[index] = ended
                if jobs.progress:
                    jobs.progress(len(outcomes) / total)
    failures = {i: Failure(i, **outcomes[i]["failure"]) for i in range(total) if "failure" in outcomes[i]}
    if failures and on_error == "raise":
        raise _failed(list(failures.values()), arguments, store)
    return [failures.get(i) or outcomes[i]["result"] for i in range(total)]


def _failed(failures: list[Failure], arguments: Sequence[Any], store: str | Path | None) -> RotorsimError:
    """Return the error that lists the first failures."""
    problems = []
    for failure in failures[:LISTED_FAILURES]:
        argument = " ".join(reprlib.repr(arguments[failure.index]).split())
        text = failure.text if len(failure.text) <= 500 else failure.text[:500] + " ..."
        problems.append(Problem(f"{failure.type}: {text}", f"job {failure.index} ({argument})"))
    what = f"{len(failures)} of {len(arguments)} jobs failed"
    what += f", the first {LISTED_FAILURES} are above" if len(failures) > LISTED_FAILURES else ""
    return RotorsimError(
        *problems,
        Problem(what, hint="run again with the same store: only the failed jobs are run" if store else ""),
        exit_code=1,
    )


def _finished(
    function: Function, left: list[Job], jobs: Jobs, chunk: int
) -> Generator[tuple[int, Outcome], None, None]:
    """Yield index and outcome of every job as it finishes."""
    count = min(_processes(jobs), math.ceil(len(left) / chunk))
    if jobs.pool and left:
        yield from jobs.pool.run(function, left, chunk)
    elif jobs.scheduler not in (None, "synchronous") and left:
        yield from run_on_cluster(str(jobs.scheduler), function, left, jobs.workers, chunk)
    elif count > 1:
        with Pool(count) as pool:
            yield from pool.run(function, left, chunk)
    else:
        yield from ((index, outcome(function, argument)) for index, argument in left)


def _processes(jobs: Jobs) -> int:
    """Return how many processes of this machine jobs get: 1 means this one."""
    if jobs.scheduler or in_worker():  # which cannot have workers of its own: jobs within a job
        return 1
    return jobs.workers or own_cores()


@contextmanager
def local_workers(jobs: Jobs, *modules: str) -> Iterator[Jobs]:
    """Keep the worker processes of this machine for several calls of `run_jobs`; give the jobs to pass there.

    With one worker, within a job, or with a scheduler there are none to keep; those that are kept already stay.
    modules: what the processes import as they start, while this one goes on.
    """
    count = _processes(jobs)
    if jobs.scheduler or jobs.pool:
        yield jobs
    elif count == 1:
        yield replace(jobs, workers=None, scheduler="synchronous")
    else:
        with Pool(count, modules) as pool:
            yield replace(jobs, workers=None, pool=pool)
