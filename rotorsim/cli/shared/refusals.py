"""How the verbs refuse what cannot be done."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rotorsim.errors import Problem, RotorsimError


def refuse_if(wrong: object, what: str, subject: str = "", *, exit_code: int = 2, **more: Any) -> None:
    """Raise RotorsimError if something is wrong; more: place and hint of the `Problem`."""
    if wrong:
        raise RotorsimError(Problem(what, subject, **more), exit_code=exit_code)


def refuse_all(problems: Sequence[Problem], exit_code: int = 2) -> None:
    """Raise RotorsimError with problems, if there are any."""
    if problems:
        raise RotorsimError(*problems, exit_code=exit_code)


def gathered(**readers: Callable[[], Any]) -> dict[str, Any]:
    """Return what every reader returns, by name. Raises RotorsimError with the mistakes of all of them."""
    found: dict[str, Any] = {}
    problems: list[Problem] = []
    for name, read in readers.items():
        try:
            found[name] = read()
        except RotorsimError as error:
            problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return found
