"""Compiled code in several threads, all else in one at a time."""

import threading
import time
from contextvars import ContextVar

import pytest

from rotorsim.jobs.jobs import Jobs, run_jobs
from rotorsim.jobs.threads import compiled, own_cores, side_by_side, threads


@pytest.mark.parametrize("count", [1, 2])
def test_whoever_asks_for_no_more_leaves_out_the_rest(count):
    """As where a run diverges: the others need not be simulated."""
    begun = []

    def task(k):
        begun.append(k)
        time.sleep(0.01)
        return k * k

    with threads(count):
        found = iter(side_by_side(task, range(100)))
        assert next(found) == 0
        found = None
    assert len(begun) < 100


def test_compiled_code_runs_side_by_side_and_nothing_else():
    """Two wait for one another inside of it; outside never more than one is at work."""
    meet, at_work, most = threading.Barrier(2, timeout=30), [0], [0]

    def task(k):
        for _ in range(3):
            at_work[0] += 1
            most[0] = max(most[0], at_work[0])
            time.sleep(0.001)
            at_work[0] -= 1
            with compiled():
                meet.wait()
        return k

    with threads(2):
        assert list(side_by_side(task, range(6))) == [0, 1, 2, 3, 4, 5]
    assert most == [1]


def test_what_fails_is_raised_and_leaves_no_lock_behind():
    def task(k):
        with compiled():
            if k == 1:
                raise ValueError("of the second")
        return k

    with threads(2):
        with pytest.raises(ValueError, match="of the second"):
            list(side_by_side(task, range(3)))
        assert list(side_by_side(lambda k: k, range(3))) == [0, 1, 2]


def test_what_holds_where_they_are_begun_holds_in_them():
    """Who listens to mishaps is of a context, and hears those of all threads."""
    said = ContextVar("said", default="nothing")
    said.set("here")
    with threads(2):
        assert list(side_by_side(lambda _: said.get(), range(2))) == ["here", "here"]


def test_a_task_that_asks_for_threads_gets_none():
    with threads(2):
        assert list(side_by_side(lambda k: list(side_by_side(lambda j: j + k, range(2))), range(2))) == [[0, 1], [1, 2]]


def cores(_):
    return own_cores()


def test_a_worker_has_one_core_as_others_are_beside_it():
    assert run_jobs(cores, [0, 1], jobs=Jobs(workers=2)) == [1, 1]
    assert own_cores() >= 1
