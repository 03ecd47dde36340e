"""Compiled code in several threads, all else in one at a time."""

import threading
import time

import numpy as np
import pytest

from rotorsim.jobs.threads import compiled, side_by_side, threads


def test_without_threads_it_is_map_one_after_another():
    begun = []
    found = side_by_side(lambda k: begun.append(k) or k * k, [1, 2, 3])
    assert begun == []  # whoever stops at a failure leaves out the rest
    assert next(iter(found)) == 1
    assert begun == [1]


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
            side_by_side(task, range(3))
        assert list(side_by_side(lambda k: k, range(3))) == [0, 1, 2]


def test_what_holds_where_they_are_begun_holds_in_them():
    """NumPy's handling of errors, which is of a context."""
    with threads(2), np.errstate(over="raise"):
        assert list(side_by_side(lambda _: np.geterr()["over"], range(2))) == ["raise", "raise"]


def test_a_task_that_asks_for_threads_gets_none():
    with threads(2):
        assert list(side_by_side(lambda k: list(side_by_side(lambda j: j + k, range(2))), range(2))) == [[0, 1], [1, 2]]
