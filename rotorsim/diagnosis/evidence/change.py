"""A further experiment and how far apart it puts two hypotheses: how often it must be made, and which is best."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from rotorsim.criteria import CRITERIA

MOST_ALIKE = 16  # runs of one kind that anyone would make


@dataclass(frozen=True)
class Change:
    """A run in words, how far apart it puts two hypotheses [standard deviations], and how often it must be made.

    runs: 0 where no number of such runs suffices.
    """

    words: str
    separation: float
    runs: int = 1


def change_of(words: str, separation: Callable[[int], float]) -> Change | None:
    """Return a run with as many of it as separate two hypotheses; None if it tells nothing.

    separation: of a number of such runs [standard deviations].
    """
    separations = [separation(n) for n in range(1, MOST_ALIKE + 1)]
    enough = next((n for n, value in enumerate(separations, 1) if value**2 > CRITERIA.equivalent), 0)
    if enough or separations[0] > CRITERIA.separation:
        return Change(words, separations[max(enough, 1) - 1], enough)
    return None


def best_of(changes: Iterable[Change | None]) -> Change | None:
    """Return the change that takes the fewest runs, of these the one that separates most; None of none."""
    found = [change for change in changes if change is not None]
    return max(found, key=lambda change: (-(change.runs or MOST_ALIKE + 1), change.separation), default=None)
