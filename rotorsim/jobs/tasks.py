"""Tasks: a few jobs with their function, packed for another process and performed there."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import import_module
from typing import Any

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.store import Outcome, plain

Function = Callable[[Any], Any]
Job = tuple[int, Any]  # index and argument
Task = Sequence[Job]

KILLED: Outcome = {
    "failure": {
        "type": "KilledWorker",
        "text": "the process that ran this job died, each time: killed, out of memory or crashed",
    }
}


def tasks_of(jobs: Sequence[Job], chunk: int) -> Iterator[Task]:
    """Yield the jobs in tasks of at most ``chunk``."""
    return (jobs[first : first + chunk] for first in range(0, len(jobs), chunk))


def outcome(function: Function, argument: Any) -> Outcome:
    """Return the result of a job as plain data, or how it failed."""
    try:
        return {"result": plain(function(argument))}
    except (Exception, SystemExit) as error:
        return failure(error)


def failure(error: BaseException) -> Outcome:
    """Return the outcome of a job that raised an error."""
    return {"failure": {"type": type(error).__name__, "text": str(error)}}


def pack(function: Function, task: Task) -> bytes:
    """Return a task as bytes for another process. Raises RotorsimError for what cannot be sent."""
    try:
        return bytes(import_module("cloudpickle").dumps((function, task)))
    except Exception as error:
        raise RotorsimError(
            Problem(
                f"cannot be sent to another process: {type(error).__name__}: {error}",
                f"job {task[0][0]}",
                hint="a function of a module and arguments of plain data can",
            )
        ) from None


def perform(payload: bytes) -> list[tuple[int, Outcome]]:
    """Run the jobs of a packed task, in a worker; return their indices and outcomes."""
    function, task = pickle.loads(payload)
    return [(index, outcome(function, argument)) for index, argument in task]


def reply(payload: bytes) -> bytes:
    """Run the jobs of a packed task; return the outcomes, or the failure to read what was sent, as bytes."""
    try:
        return pickle.dumps(perform(payload))
    except Exception as error:
        return pickle.dumps(failure(error))


def outcomes_in(answer: bytes, task: Task) -> Iterable[tuple[int, Outcome]]:
    """Return the indices and outcomes in what `reply` gave for a task."""
    given = pickle.loads(answer)
    return given if isinstance(given, list) else ((index, given) for index, _ in task)
