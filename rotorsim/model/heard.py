"""What goes wrong inside a fit without ending it: trials at which a part whose equations are elsewhere fails.

Whoever fits listens (`hearing`), and says afterwards what was heard; a remark that nobody listens to is a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from rotorsim.errors import Place, Problem, RotorsimError

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
BARRED = 1.0  # misfit that the next step of a search would gain: more than the noise makes of one parameter by itself
GIVEN_UP = "given up"  # kind of a failure after which a part is not asked any more: it ends a fit


@dataclass(frozen=True)
class Mishap:
    """What happened ``count`` times: the first failure of its kind (`rotorsim.fmi.runtime.failure.FmuError`).

    A remark has no kind.
    """

    subject: str
    kind: str
    what: str
    file: str = ""
    count: int = 1

    def problem(self) -> Problem:
        """Return it as a warning."""
        first, line, rest = self.what.partition("\n")
        trials = "1 trial failed so" if self.count == 1 else f"{self.count} trials failed so"
        first += f": {trials}, and other values were tried" if self.kind else ""
        return Problem(first + line + rest, self.subject, Place(self.file), severity="warning")


class Heard:
    """The mishaps of a fit, each kind once. begun: with which parameters it began, by part."""

    def __init__(self) -> None:
        self.begun: dict[str, Any] = {}
        self._of: dict[tuple[str, ...], Mishap] = {}

    @property
    def mishaps(self) -> tuple[Mishap, ...]:
        """The mishaps, in the order in which they came first."""
        return tuple(self._of.values())

    def problems(self) -> list[Problem]:
        """Return the mishaps as warnings."""
        return [mishap.problem() for mishap in self.mishaps]

    def add(self, mishaps: Iterable[Mishap]) -> None:
        """Count mishaps."""
        for one in mishaps:
            key = (one.subject, one.kind, "" if one.kind else one.what)
            known = self._of.get(key)
            self._of[key] = one if known is None else replace(known, count=known.count + one.count)

    def of(self, subject: str, kind: str) -> Mishap | None:
        """Return the failures of a part of one kind, None where there was none."""
        return self._of.get((subject, kind, ""))


_listening: list[Heard] = []


@contextmanager
def hearing() -> Iterator[Heard]:
    """Hear what goes wrong inside; who listened before hears nothing of it."""
    heard = Heard()
    _listening.append(heard)
    try:
        yield heard
    finally:
        _listening.remove(heard)


def listener() -> Heard:
    """Return whom failures are told: nobody's where nobody listens."""
    return _listening[-1] if _listening else Heard()


def is_heard() -> bool:
    """Return whether somebody listens: whether this is inside a fit."""
    return bool(_listening)


def tell(error: BaseException) -> None:
    """Tell of a failure."""
    if isinstance(error, RotorsimError) and error.problems:
        problem = error.problems[0]
        kind = getattr(error, "kind", "") or type(error).__name__
        listener().add([Mishap(problem.subject, kind, problem.what, problem.place.file)])


def remark(subject: str, what: str) -> None:
    """Tell of something that ends nothing."""
    if _listening:
        listener().add([Mishap(subject, "", what)])
    else:
        warnings.warn(f"{subject}: {what}", RuntimeWarning, stacklevel=3)


def gives_up(error: RotorsimError) -> bool:
    """Return whether a failure of a trial ends the fit."""
    return getattr(error, "kind", "") == GIVEN_UP


def surviving(function: Callable[[T], R], starts: Iterable[T]) -> Iterator[R]:
    """Yield what a function gives from each start at which nothing fails. Raises the first failure where all fail."""
    first: RotorsimError | None = None
    any_good = False
    for start in starts:
        try:
            found = function(start)
        except RotorsimError as error:
            if gives_up(error):
                raise
            first = first or error
            continue
        any_good = True
        yield found
    if first is not None and not any_good:
        raise first


def barred(error: RotorsimError) -> RotorsimError:
    """Return the failure of a fit whose search would go on where trials failed."""
    problem = error.problems[0]
    what = f"the search ends where it fails, and would go on beyond: {problem.what}"
    return RotorsimError(replace(problem, what=what), exit_code=1)


def said(function: Callable[P, R]) -> Callable[P, R]:
    """Let a fit say what it heard: among the ``warnings`` of its result, a dataclass."""

    @wraps(function)
    def call(*arguments: P.args, **named: P.kwargs) -> R:
        with hearing() as heard:
            found: Any = function(*arguments, **named)
        made: R = replace(found, warnings=(*found.warnings, *heard.problems())) if heard.mishaps else found
        return made

    return call
