"""One requirement of a standard on one machine: the number, its limit, the clause, and the verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim.errors import RotorsimError

MET, NOT_MET, UNSURE, NOT_JUDGED = "met", "not met", "unsure", "not judged"
ISO_2, ISO_3, ISO_4 = "ISO 14839-2:2004", "ISO 14839-3:2006", "ISO 14839-4:2012"
API_617, API_684 = "API 617 (8th ed., 2014)", "API RP 684 (2nd ed., 2005)"
RUNNING_TEST = f"{API_617}, mechanical running test"


@dataclass(frozen=True)
class Criterion:
    """One requirement.

    clause: standard, edition and place. what: the quantity. where: signal, speed, case. value, limit in ``unit``;
    at_most: the value must not exceed the limit, else it must not fall below. interval90: of a measured value. source:
    "modelled" or "measured". required: False for advice, which no verdict of the machine rests on. said: in words, why
    it is not judged, or its zone.
    """

    clause: str
    what: str
    where: str = ""
    value: float = np.nan
    limit: float = np.nan
    unit: str = "1"
    at_most: bool = True
    interval90: tuple[float, float] | None = None
    source: str = "modelled"
    required: bool = True
    said: str = ""
    stated: str = ""

    @property
    def verdict(self) -> str:
        """Verdict: "met", "not met", "unsure" (the limit lies within the interval), or "not judged"."""
        if self.stated:
            return self.stated
        if not (np.isfinite(self.limit) and not np.isnan(self.value)):
            return NOT_JUDGED
        ends = [self._fits(value) for value in self.interval90 or (self.value,)]
        return MET if all(ends) else UNSURE if any(ends) else NOT_MET

    def _fits(self, value: float) -> bool:
        return value <= self.limit if self.at_most else value >= self.limit


@dataclass(frozen=True, eq=False)
class Part:
    """One analysis: its criteria, what a reader must know, and the results, of which figures are drawn."""

    title: str
    criteria: tuple[Criterion, ...]
    notes: tuple[str, ...] = ()
    results: tuple[Any, ...] = field(default=())


def judged(title: str, clause: str, what: str, analysis: Callable[[], Part], *, required: bool = True) -> Part:
    """Return a part; where its analysis is refused, one that is not judged and says why."""
    try:
        return analysis()
    except RotorsimError as error:
        said = "; ".join(f"{one.subject}: {one.what}" if one.subject else one.what for one in error.problems)
        return not_judged(title, clause, what, said, required=required)


def not_judged(title: str, clause: str, what: str, said: str, *, required: bool = True) -> Part:
    """Return a part that is not judged, and why."""
    return Part(title, (Criterion(clause, what, required=required, said=said),))
