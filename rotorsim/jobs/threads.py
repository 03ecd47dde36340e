"""One thread of linear algebra: for many small matrices, threads cost more than they save."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

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
