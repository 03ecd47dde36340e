"""Lists of independent jobs (sweeps, Monte-Carlo, bootstraps, fits) on local processes, or on a cluster by Dask.

Results go to a store as they finish; an interrupted run resumes from it. Local processes are reached over pipes
(`rotorsim.jobs.processes`): nothing listens on the network.
"""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import pickle
import re
import reprlib
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.processes import Pool
from rotorsim.jobs.store import Outcome, open_store, plain

__all__ = ["Failure", "Jobs", "local_workers", "run_jobs"]

CONNECT_TIMEOUT = 10.0  # s, until a scheduler counts as not reachable
LOST_TIMEOUT = 60.0  # s without any worker, until the run is given up
RETRIES = 2  # of a job whose worker died
SHOWN = 5  # failures in an error

_SAME_VERSION = ("python", "dask", "distributed", "cloudpickle", "numpy", "rotorsim")
_TICK = 1.0  # s, between looks at the workers
_SETTINGS = {"distributed.admin.large-graph-warning-threshold": "1 TiB"}
_POOLS: dict[str, Pool] = {}  # of `local_workers`, under the names that stand for them

Job = tuple[int, Any]  # index and argument

_KILLED: Outcome = {
    "failure": {
        "type": "KilledWorker",
        "text": "the process that ran this job died, each time: killed, out of memory or crashed",
    }
}


@dataclass(frozen=True)
class Failure:
    """A job that failed: its index (from 0), the type of the error, and what it said."""

    index: int
    type: str
    text: str


@dataclass(frozen=True)
class Jobs:
    """Where lists of jobs run, and who is told how far they are; see `run_jobs`."""

    workers: int | None = None
    scheduler: str | None = None
    progress: Callable[[float], None] | None = None


def run_jobs(
    function: Callable[[Any], Any],
    arguments: Sequence[Any],
    *,
    store: str | Path | None = None,
    key: str = "",
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
    chunk: int = 1,
    on_error: str = "raise",
) -> list[Any]:
    """Return ``[function(argument) for argument in arguments]``, computed in parallel.

    function: of a module, not nested; returns dicts, lists, numbers, text or None. NumPy numbers and arrays become
    numbers and lists, tuples become lists; NaN and infinity are kept.
    store: file of JSON lines (NaN as Python writes it), one for every job as it finishes. Jobs found there are not
    run again, failed ones are; a list that was made longer runs what is new.
    key: whatever else decides the results than the name of the function and the arguments.
    scheduler: None: processes of this machine, one thread each (in a script, call it under
    ``if __name__ == "__main__":``); "synchronous": this process; "tcp://host:port" or "tls://host:port": a Dask
    cluster. Whoever reaches such a scheduler can run code on its workers, and in this process, which unpickles what
    it answers: name only one that nobody else can reach, or one that TLS guards (Dask's configuration).
    workers: processes (default: one for every CPU), or how many jobs at a time a cluster gets. With one worker or
    one job all is done in this process.
    progress: called with the fraction done (0..1). chunk: jobs handed over at a time; more for short jobs.
    on_error: "raise": all jobs are run, then the failures are raised; "return": a `Failure` stands for the result.

    Raises RotorsimError.
    """
    _check(scheduler, workers, chunk, on_error)
    total = len(arguments)
    with open_store(store, function, key, arguments) as (outcomes, append):
        left = [(index, argument) for index, argument in enumerate(arguments) if index not in outcomes]
        if progress and outcomes:
            progress(len(outcomes) / total)
        with closing(_finished(function, left, scheduler, workers, chunk)) as finished:
            for index, outcome in finished:
                append(index, outcome)
                outcomes[index] = outcome
                if progress:
                    progress(len(outcomes) / total)
    results = [_result(index, outcomes[index]) for index in range(total)]
    failures = [result for result in results if isinstance(result, Failure)]
    if failures and on_error == "raise":
        raise _failed(failures, arguments, store)
    return results


def _check(scheduler: str | None, workers: int | None, chunk: int, on_error: str) -> None:
    problems = []
    known = scheduler is None or scheduler == "synchronous" or scheduler in _POOLS
    if not known and not re.fullmatch(r"(tcp|tls)://[^/]+:\d+", str(scheduler)):
        hint = "tcp://host:port of a Dask scheduler, or synchronous"
        problems.append(Problem(f"'{scheduler}' is not the address of a scheduler", "scheduler", hint=hint))
    if workers is not None and workers < 1:
        problems.append(Problem(f"{workers} workers: at least one is needed", "workers"))
    if chunk < 1:
        problems.append(Problem(f"{chunk} jobs at a time: at least one is needed", "chunk"))
    if on_error not in ("raise", "return"):
        problems.append(Problem(f"'{on_error}' is unknown", "on_error", hint="raise or return"))
    if problems:
        raise RotorsimError(*problems)


def _result(index: int, outcome: Outcome) -> Any:
    return Failure(index, **outcome["failure"]) if "failure" in outcome else outcome["result"]


def _failed(failures: list[Failure], arguments: Sequence[Any], store: str | Path | None) -> RotorsimError:
    """Return the error that lists the first failures."""
    problems = []
    for failure in failures[:SHOWN]:
        argument = " ".join(reprlib.repr(arguments[failure.index]).split())
        text = failure.text if len(failure.text) <= 500 else failure.text[:500] + " ..."
        problems.append(Problem(f"{failure.type}: {text}", f"job {failure.index} ({argument})"))
    what = f"{len(failures)} of {len(arguments)} jobs failed"
    what += f", the first {SHOWN} are above" if len(failures) > SHOWN else ""
    hint = "run again with the same store: only the failed jobs are run" if store else ""
    return RotorsimError(*problems, Problem(what, hint=hint), exit_code=1)


# -- the work ----------------------------------------------------------------------------------------------------------


def _finished(
    function: Callable[[Any], Any], jobs: list[Job], scheduler: str | None, workers: int | None, chunk: int
) -> Generator[tuple[int, Outcome], None, None]:
    """Yield index and outcome of every job as it finishes."""
    if scheduler is None:
        workers = 1 if _is_worker() else min(workers or _cpus(), math.ceil(len(jobs) / chunk))
    if scheduler == "synchronous" or not jobs or (scheduler is None and workers == 1):
        for index, argument in jobs:
            yield index, _outcome(function, argument)
        return
    if scheduler is None:
        with Pool(workers or 1, _serve) as pool:
            yield from _shared_out(pool, function, jobs, chunk)
    elif scheduler in _POOLS:
        yield from _shared_out(_POOLS[scheduler], function, jobs, chunk)
    else:
        with _cluster(scheduler) as client, client.as_current():
            try:
                yield from _spread(client, function, jobs, workers, chunk)
            except (OSError, _distributed().CancelledError):
                raise _lost("the connection to the scheduler is lost") from None


def _cpus() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _is_worker() -> bool:
    """Return whether this process is a worker, which cannot have workers of its own: jobs within a job."""
    process = multiprocessing.current_process()
    return process.daemon and not getattr(process, "_inheriting", False)  # inheriting: only reads the script


def _outcome(function: Callable[[Any], Any], argument: Any) -> Outcome:
    try:
        return {"result": plain(function(argument))}
    except (Exception, SystemExit) as error:
        return _failure(error)


def _failure(error: BaseException) -> Outcome:
    return {"failure": {"type": type(error).__name__, "text": str(error)}}


def _perform(payload: bytes) -> list[tuple[int, Outcome]]:
    """Run the jobs of one task, in a worker."""
    function, jobs = pickle.loads(payload)
    return [(index, _outcome(function, argument)) for index, argument in jobs]


def _serve(payload: bytes) -> bytes:
    """Run the jobs of one task, in a process of this machine."""
    try:
        return pickle.dumps(_perform(payload))
    except Exception as error:  # what was sent cannot be read there
        return pickle.dumps(_failure(error))


def _shared_out(
    pool: Pool, function: Callable[[Any], Any], jobs: list[Job], chunk: int
) -> Iterator[tuple[int, Outcome]]:
    """Yield index and outcome of every job as the processes finish them.

    The jobs of a task that killed its process are run again one by one; one that kills it each time has failed.
    """
    deaths: Counter[int] = Counter()

    def lost(task: list[Job]) -> list[list[Job]]:
        if len(task) > 1:
            return [[job] for job in task]
        deaths[task[0][0]] += 1
        return [task] if deaths[task[0][0]] <= RETRIES else []

    tasks = deque(jobs[first : first + chunk] for first in range(0, len(jobs), chunk))
    for task, reply in pool.perform(tasks, lambda task: _pickled(function, task), lost):
        if reply is None:
            yield task[0][0], _KILLED
            continue
        outcomes = pickle.loads(reply)
        yield from outcomes if isinstance(outcomes, list) else ((index, outcomes) for index, _ in task)


def _spread(
    client: Any, function: Callable[[Any], Any], jobs: list[Job], workers: int | None, chunk: int
) -> Iterator[tuple[int, Outcome]]:
    """Yield index and outcome of every job as the cluster finishes them.

    No more tasks are handed over than there are threads: so a worker that dies takes only the task with it that it
    works on. The jobs of a task that killed its workers are run again one by one.
    """
    distributed = _distributed()
    waiting = deque(jobs[first : first + chunk] for first in range(0, len(jobs), chunk))
    running: dict[Any, list[Job]] = {}
    seen = time.monotonic()
    while waiting or running:
        threads = sum(client.nthreads().values())
        if threads:
            seen = time.monotonic()
        elif time.monotonic() - seen > LOST_TIMEOUT:
            raise _lost("the cluster has no workers any more")
        while waiting and len(running) < min(threads, workers or threads):
            task = waiting.popleft()
            running[client.submit(_perform, _pickled(function, task), pure=False)] = task
        if not running:
            time.sleep(_TICK)
            continue
        with suppress(TimeoutError):
            distributed.wait(list(running), timeout=_TICK, return_when="FIRST_COMPLETED")
        for future in [future for future in running if future.done()]:
            task = running.pop(future)
            if future.status == "finished":
                yield from future.result()
            elif future.status != "error":
                raise ConnectionError
            elif not isinstance(future.exception(), distributed.KilledWorker):
                yield from ((index, _failure(future.exception())) for index, _ in task)
            elif len(task) > 1:
                waiting.extendleft([job] for job in reversed(task))
            else:
                yield task[0][0], _KILLED


def _pickled(function: Callable[[Any], Any], task: list[Job]) -> bytes:
    try:
        return bytes(import_module("cloudpickle").dumps((function, task)))
    except Exception as error:
        what = f"cannot be sent to another process: {type(error).__name__}: {error}"
        hint = "a function of a module and arguments of plain data can"
        raise RotorsimError(Problem(what, f"job {task[0][0]}", hint=hint)) from None


def _lost(what: str) -> RotorsimError:
    hint = "start the cluster again and run again: with a store, only the jobs that are left are run"
    return RotorsimError(Problem(what, hint=hint), exit_code=1)


# -- the cluster -------------------------------------------------------------------------------------------------------


def _distributed() -> Any:
    return import_module("distributed")  # slow: only when jobs are run


@contextmanager
def _cluster(scheduler: str) -> Iterator[Any]:
    """Give a client of the cluster, which logs nothing."""
    _distributed()
    levels = {log: log.level for log in map(logging.getLogger, ("distributed", "distributed.client"))}
    try:
        for log in levels:
            log.setLevel(logging.CRITICAL)
        with import_module("dask").config.set(_SETTINGS), _connected(scheduler) as client:
            yield client
    finally:
        for log, level in levels.items():
            log.setLevel(level)


@contextmanager
def local_workers(workers: int | None = None) -> Iterator[str | None]:
    """Keep the worker processes of this machine for several calls of `run_jobs`; give what to pass as ``scheduler``.

    workers: processes (default: one for every CPU). With one, or within a job, there are none: "synchronous".
    """
    count = _cpus() if workers is None else workers
    if count == 1 or _is_worker():
        yield "synchronous"
        return
    with Pool(count, _serve) as pool:
        name = f"processes-{id(pool):x}"
        _POOLS[name] = pool
        try:
            yield name
        finally:
            del _POOLS[name]


@contextmanager
def _connected(scheduler: str) -> Iterator[Any]:
    """Give a client of a running cluster, whose workers have the same versions as this process."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of versions: looked at below
            client: Any = _distributed().Client(scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except Exception as error:
        why = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
        what = f"the scheduler {scheduler} cannot be reached: {why}"
        hint = "is it running (`dask scheduler`), and is the address the one it prints?"
        raise RotorsimError(Problem(what, hint=hint)) from None
    with client:
        found = client.get_versions(packages=list(_SAME_VERSION[1:]))
        if not found["workers"]:
            hint = f"start some: `dask worker {scheduler}`"
            raise RotorsimError(Problem(f"the cluster {scheduler} has no workers", hint=hint))
        problems = list(islice(_mismatches(found), SHOWN))
        if problems:
            raise RotorsimError(*problems)
        yield client


def _mismatches(found: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what is of another version elsewhere: a scheduler reads messages only, a worker runs the jobs."""
    here = found["client"]["packages"]
    there: list[tuple[str, Any, tuple[str, ...]]] = [("the scheduler", found["scheduler"], ("distributed",))]
    there += [(f"worker {name}", worker, _SAME_VERSION) for name, worker in found["workers"].items()]
    for name, seen, packages in there:
        for package in packages:
            mine, other = (_version(package, versions) for versions in (here, seen["packages"]))
            if mine != other:
                what = f"has {package} {other}, this process has {mine}" if other else f"has no {package}"
                yield Problem(what, name, hint=f"install {package} {mine} there")


def _version(package: str, versions: Mapping[str, Any]) -> str | None:
    version = versions.get(package)
    return ".".join(version.split(".")[:2]) if version and package == "python" else version
