"""Work in a thread that another one can stop."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock, get_ident
from typing import TypeVar

from rotorsim.errors import Problem, RotorsimError

Found = TypeVar("Found")


class StoppedError(BaseException):
    """Somebody has stopped the work; no exception of the work itself, so that nothing in it takes it for one."""


@dataclass
class Job:
    """A piece of work that is done once, in whichever thread calls `do`.

    It is stopped between two steps of the interpreter: what is computed in one call (a factorisation, a piece of a
    compiled run) ends first.
    """

    _lock: Lock = field(default_factory=Lock)
    _thread: int | None = None
    _stopped: bool = False

    def stop(self) -> None:
        """Stop the work, now or before it begins; what has ended stays."""
        with self._lock:
            self._stopped = True
            if self._thread is not None:
                raised = ctypes.py_object(StoppedError)
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread), raised)

    def do(self, work: Callable[[], Found]) -> Found:
        """Return what the work returns. Raises RotorsimError where it was stopped."""
        try:
            with self._lock:
                if self._stopped:
                    raise StoppedError
                self._thread = get_ident()
            try:
                return work()
            finally:
                with self._lock:  # who stops it holds the lock: later than here nothing is raised any more
                    self._thread = None
        except StoppedError:
            raise RotorsimError(Problem("stopped"), exit_code=1) from None
        except Exception:
            if self._stopped:  # what is raised within a call of C comes out of it as another error
                raise RotorsimError(Problem("stopped"), exit_code=1) from None
            raise
