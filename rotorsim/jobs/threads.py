"""Threads: one for linear algebra, whose many small matrices cost more in several; several for compiled code."""

from __future__ import annotations

import threading
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


_count: ContextVar[int] = ContextVar("threads", default=1)
_alone = threading.Lock()  # of all that is not compiled code: nothing else need be written for threads
_held = threading.local()


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let `side_by_side` use so many threads inside a ``with``."""
    token = _count.set(count)
    try:
        yield
    finally:
        _count.reset(token)


def side_by_side(function: Callable[[A], R], arguments: Sequence[A]) -> Iterable[R]:
    """Return ``map(function, arguments)``, in `threads`: while one runs `compiled` code, others go on."""
    count = min(_count.get(), len(arguments))
    if count < 2 or getattr(_held, "here", False):
        return map(function, arguments)

    def alone(argument: A) -> R:
        with _alone:
            _held.here = True
            return function(argument)

    with ThreadPoolExecutor(count) as pool:
        begun = [pool.submit(copy_context().run, alone, argument) for argument in arguments]
        return [one.result() for one in begun]


@contextmanager
def compiled() -> Iterator[None]:
    """Let the other threads go on inside a ``with``, which holds a call of compiled code and nothing else."""
    if not getattr(_held, "here", False):
        yield
        return
    _alone.release()
    try:
        yield
    finally:
        _alone.acquire()
