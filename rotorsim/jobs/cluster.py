"""Jobs on a cluster, by Dask."""

from __future__ import annotations

import logging
import time
import warnings
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import islice
from typing import Any

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.store import Outcome
from rotorsim.jobs.tasks import KILLED, Function, Job, Task, failure, pack, perform, tasks_of

CONNECT_TIMEOUT = 10.0  # s, until a scheduler counts as not reachable
LOST_TIMEOUT = 60.0  # s without any worker, until the run is given up
LISTED_VERSIONS = 5  # differences of version in an error

_SAME_VERSION = ("python", "dask", "distributed", "cloudpickle", "numpy", "rotorsim")
_TICK = 1.0  # s, between looks at the workers


def run_on_cluster(
    scheduler: str, function: Function, jobs: list[Job], most: int | None, chunk: int
) -> Iterator[tuple[int, Outcome]]:
    """Yield index and outcome of every job as a cluster finishes them, at most ``most`` tasks at a time.

    Raises RotorsimError where the cluster cannot be reached, is lost, or has other versions than this process.
    """
    distributed = import_module("distributed")  # slow: only when jobs are run
    levels = {log: log.level for log in map(logging.getLogger, ("distributed", "distributed.client"))}
    try:
        for log in levels:
            log.setLevel(logging.CRITICAL)
        large = {"distributed.admin.large-graph-warning-threshold": "1 TiB"}
        with import_module("dask").config.set(large), _connected(distributed, scheduler) as client:
            try:
                yield from _spread(distributed, client, function, jobs, most, chunk)
            except (OSError, distributed.CancelledError):
                raise _lost("the connection to the scheduler is lost") from None
    finally:
        for log, level in levels.items():
            log.setLevel(level)


def _spread(
    distributed: Any, client: Any, function: Function, jobs: list[Job], most: int | None, chunk: int
) -> Iterator[tuple[int, Outcome]]:
    """Yield index and outcome of every job.

    No more tasks are handed over than there are threads: so a worker that dies takes only the task with it that it
    works on. The jobs of a task that killed its workers are run again one by one.
    """
    waiting = deque(tasks_of(jobs, chunk))
    running: dict[Any, Task] = {}
    seen = time.monotonic()
    while waiting or running:
        threads = sum(client.nthreads().values())
        if threads:
            seen = time.monotonic()
        elif time.monotonic() - seen > LOST_TIMEOUT:
            raise _lost("the cluster has no workers any more")
        while waiting and len(running) < min(threads, most or threads):
            task = waiting.popleft()
            running[client.submit(perform, pack(function, task), pure=False)] = task
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
                yield from ((index, failure(future.exception())) for index, _ in task)
            elif len(task) > 1:
                waiting.extendleft([job] for job in reversed(task))
            else:
                yield task[0][0], KILLED


def _lost(what: str) -> RotorsimError:
    return RotorsimError(
        Problem(what, hint="start the cluster again and run again: with a store, only the jobs that are left are run"),
        exit_code=1,
    )


@contextmanager
def _connected(distributed: Any, scheduler: str) -> Iterator[Any]:
    """Give a client of a running cluster, whose workers have the same versions as this process."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of versions: looked at below
            client: Any = distributed.Client(scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except Exception as error:
        why = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
        raise RotorsimError(
            Problem(
                f"the scheduler {scheduler} cannot be reached: {why}",
                hint="is it running (`dask scheduler`), and is the address the one it prints?",
            )
        ) from None
    with client, client.as_current():
        versions = client.get_versions(packages=list(_SAME_VERSION[1:]))
        if not versions["workers"]:
            raise RotorsimError(
                Problem(f"the cluster {scheduler} has no workers", hint=f"start some: `dask worker {scheduler}`")
            )
        problems = list(islice(_mismatches(versions), LISTED_VERSIONS))
        if problems:
            raise RotorsimError(*problems)
        yield client


def _mismatches(versions: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what is of another version elsewhere: a scheduler reads messages only, a worker runs the jobs."""
    here = versions["client"]["packages"]
    there: list[tuple[str, Any, tuple[str, ...]]] = [("the scheduler", versions["scheduler"], ("distributed",))]
    there += [(f"worker {name}", worker, _SAME_VERSION) for name, worker in versions["workers"].items()]
    for name, seen, packages in there:
        for package in packages:
            mine, other = (_version(package, found) for found in (here, seen["packages"]))
            if mine != other:
                yield Problem(
                    f"has {package} {other}, this process has {mine}" if other else f"has no {package}",
                    name,
                    hint=f"install {package} {mine} there",
                )


def _version(package: str, versions: Mapping[str, Any]) -> str | None:
    version = versions.get(package)
    return ".".join(version.split(".")[:2]) if version and package == "python" else version
