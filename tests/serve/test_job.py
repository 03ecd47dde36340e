"""Work in a thread that is stopped by another one."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

import pytest

from rotorsim import RotorsimError
from rotorsim.serve.job import Job


def ended(work: Callable[[], object], job: Job) -> list[object]:
    """Return what a job has returned or raised, once somebody has stopped it 50 ms after it began."""
    found: list[object] = []
    begun = threading.Event()

    def do() -> None:
        def watched() -> object:
            begun.set()
            return work()

        try:
            found.append(job.do(watched))
        except RotorsimError as error:
            found.append(error.problems[0].what)

    thread = threading.Thread(target=do)
    thread.start()
    assert begun.wait(10)
    time.sleep(0.05)
    job.stop()
    thread.join(10)
    assert not thread.is_alive()
    return found


def test_work_that_would_never_end_is_stopped_and_cleans_up() -> None:
    left = []

    def work() -> None:
        try:
            while True:
                with contextlib.suppress(Exception):  # what stops it is none of the work's own
                    time.sleep(0.001)
        finally:
            left.append("cleaned")

    assert ended(work, Job()) == ["stopped"]
    assert left == ["cleaned"]


def test_what_has_ended_is_not_stopped_and_later_work_neither() -> None:
    job = Job()
    assert ended(lambda: 7, job) == [7]
    assert Job().do(lambda: sum(range(1000))) == 499500


def test_what_is_stopped_before_it_begins_does_not_begin() -> None:
    job, done = Job(), []
    job.stop()
    with pytest.raises(RotorsimError, match="stopped"):
        job.do(lambda: done.append(1))
    assert done == []


def test_what_c_makes_of_the_stop_is_the_stop() -> None:
    job = Job()

    def work() -> None:
        job.stop()
        try:
            while True:
                time.sleep(0.001)
        except BaseException:
            raise SystemError("returned a result with an exception set") from None

    with pytest.raises(RotorsimError, match="stopped"):
        job.do(work)
    with pytest.raises(SystemError):  # of nobody who was stopped
        Job().do(lambda: (_ for _ in ()).throw(SystemError("its own")))
