"""Signals in time beside what one or more diagrams simulate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorsim.report.style import Look


@dataclass(frozen=True, eq=False)
class Trace:
    """A measured signal of one run in time (N,) and what each diagram simulates, None where one diverges."""

    run: str
    name: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    simulated: tuple[np.ndarray | None, ...]


@dataclass(frozen=True, eq=False)
class SampleComparison:
    """Diagrams, the one as given first, beside the same signals in time; of: what the runs are called in titles."""

    looks: tuple[Look, ...]
    traces: tuple[Trace, ...]
    of: str
