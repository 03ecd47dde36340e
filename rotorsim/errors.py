"""Errors as part of the product: place, what is wrong, what was expected, and a hint."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

# What steers a terminal or turns the direction of writing, and what XML cannot hold: C0 (but tab and line feed),
# C1, overrides of direction, halves of characters, and the two that are none.
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]")


def visible(text: str) -> str:
    """Return a text with its control characters written out, as ``\\u001b``: names of others reach the terminal."""
    return CONTROL.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def escape(text: str) -> str:
    """Return a text for XML and HTML, which hold no control characters."""
    from html import escape as escaped

    return escaped(visible(text))


@dataclass(frozen=True, order=True)
class Place:
    """Where a problem is: file, line and column (counted from 1; 0 when unknown)."""

    file: str = ""
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.file and self.line else self.file

    def part(self, *steps: str | int) -> Place:
        """Return the place of a part of what is here, as far as it is known."""
        return self


@dataclass(frozen=True)
class Problem:
    """One mistake: ``what`` is wrong at ``place`` / ``subject`` (block.port), and how to cure it (``hint``).

    severity: ``"error"`` or ``"warning"``. code: what kind of mistake it is, where code has to know: no text is read.
    """

    what: str
    subject: str = ""
    place: Place = field(default_factory=Place)
    hint: str = ""
    severity: str = "error"
    code: str = ""

    def __str__(self) -> str:
        head = ": ".join(part for part in (str(self.place), self.severity, self.subject) if part)
        text = f"{head}: {self.what}"
        return visible(f"{text}\n\nhint: {self.hint}" if self.hint else text)


class Problems(list[Problem]):
    """The mistakes and oddities found so far, in the order in which they were found."""

    def error(self, what: str, subject: str = "", place: Place | None = None, hint: str = "") -> None:
        """Add a mistake."""
        self.append(Problem(what, subject, place or Place(), hint))

    def warning(self, what: str, subject: str = "", place: Place | None = None, hint: str = "") -> None:
        """Add what is odd but no mistake."""
        self.append(Problem(what, subject, place or Place(), hint, "warning"))


class RotorsimError(Exception):
    """Base of all errors of rotorsim: carries every problem found, not only the first.

    problems: tuple of `Problem`; exit_code: 2 for misuse or bad input, 1 for a failure in the data.
    """

    exit_code = 2

    def __init__(self, *problems: Problem | str, exit_code: int | None = None) -> None:
        self.problems = tuple(p if isinstance(p, Problem) else Problem(what=p) for p in problems)
        if exit_code is not None:
            self.exit_code = exit_code
        super().__init__("\n".join(str(problem) for problem in self.problems))


def near_miss(word: str, known: Iterable[str], *, list_all: bool = True, most: int = 3) -> str:
    """Return a hint for a misspelt word: the ``most`` closest known ones, else the list of all (if short enough)."""
    from difflib import get_close_matches

    names = sorted({str(name) for name in known})
    folded = {name.lower(): name for name in reversed(names)}
    if word.lower() in folded:
        return f"did you mean '{folded[word.lower()]}'?"
    close = get_close_matches(word, names, n=most, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(f"'{name}'" for name in close) + "?"
    if not list_all or not names:
        return ""
    shown = ", ".join(names[:40]) + (", ..." if len(names) > 40 else "")
    return f"known: {shown}"
