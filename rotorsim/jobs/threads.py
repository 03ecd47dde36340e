"""Threads: one for linear algebra, whose many small matrices cost more in several; several for compiled code."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar, copy_context
from functools import cache
from typing import Any, TypeVar

A = TypeVar("A")
R = TypeVar("R")

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR")
ONE_THREAD = {  # environment of a process that uses one thread, read as it loads them
    **dict.fromkeys([f"{name}_NUM_THREADS" for name in _LIBRARIES], "1"),
    "VECLIB_MAXIMUM_THREADS": "1",
}


def one_thread() -> AbstractContextManager[Any]:
    """Let NumPy and SciPy use one thread inside a ``with``."""
    limit: AbstractContextManager[Any] = _libraries().limit(limits=1, user_api="blas")
    return limit


@cache
def _libraries() -> Any:
    """Return the libraries of linear algebra, looked up once: that takes 5 ms, as long as many a fit."""
    import scipy.linalg  # noqa: F401 - loads NumPy's and its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def in_worker() -> bool:
    """Return whether this process is a worker of another."""
    process = multiprocessing.current_process()
    return process.daemon and not getattr(process, "_inheriting", False)  # inheriting: it only reads the script


def own_cores() -> int:
    """Return how many cores this process may use: one in a worker, which has others beside it."""
    if in_worker():
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_count: ContextVar[int] = ContextVar("threads", default=1)
_alone = threading.Lock()  # of all that is not compiled code: nothing else need be written for threads
_task = threading.local()


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let `side_by_side` use so many threads inside a ``with``."""
    token = _count.set(count)
    try:
        yield
    finally:
        _count.reset(token)


def several_threads() -> bool:
    """Return whether `side_by_side` has more than one."""
    return _count.get() > 1 and not _is_task()


def side_by_side(function: Callable[[A], R], arguments: Sequence[A]) -> Iterable[R]:
    """Return ``map(function, arguments)``, in `threads`: while one runs `compiled` code, others go on.

    Whoever asks for no more, or meets a failure, leaves out those that are not begun.
    """
    count = min(_count.get(), len(arguments))
    return _in_threads(function, arguments, count) if count > 1 and several_threads() else map(function, arguments)


def _in_threads(function: Callable[[A], R], arguments: Sequence[A], count: int) -> Iterator[R]:
    def alone(argument: A) -> R:
        with _alone:
            _task.here = True
            return function(argument)

    pool = ThreadPoolExecutor(count)
    try:
        begun = deque(pool.submit(copy_context().run, alone, argument) for argument in arguments)
        while begun:
            yield begun.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _is_task() -> bool:
    return getattr(_task, "here", False)


@contextmanager
def compiled() -> Iterator[None]:
    """Let the other threads go on inside a ``with``, which holds a call of compiled code and nothing else."""
    if not _is_task():
        yield
        return
    _alone.release()
    try:
        yield
    finally:
        _alone.acquire()
