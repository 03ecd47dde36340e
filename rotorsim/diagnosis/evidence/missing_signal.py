"""The signal that a diagram lacks at a place, as recordings in time show it without any law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Spot


@dataclass(frozen=True)
class PlaceClass:
    """Places whose signals change all recorded outputs alike, so that no data separate them, the likeliest first.

    probability: that a free signal acts at one of them, among all classes.
    """

    places: tuple[Spot, ...]
    probability: float


@dataclass(frozen=True, eq=False, repr=False)
class SignalRun:
    """A missing signal in one run, at instants time (N,) [s]: added (N,), its standard deviation std (N,).

    over (N,): the signal that it is drawn against. law, law_over (N,): what the law that was found adds in the repaired
    diagram, and over what it is drawn; None without a law.
    """

    run: str
    time: np.ndarray
    added: np.ndarray
    std: np.ndarray
    over: np.ndarray
    law: np.ndarray | None = None
    law_over: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class MissingSignal:
    """A free signal at a place that explains what a diagram leaves of all outputs; SI.

    unit, over_unit: as the diagram or the recording states them, None where neither does. over: the name of the signal
    that it is drawn against, share: how much of its variance a map of that explains. physics: the law that was found
    there, empty without one.
    """

    place: Spot
    unit: str | None
    over: str
    over_unit: str | None
    share: float
    runs: tuple[SignalRun, ...]
    classes: tuple[PlaceClass, ...]
    physics: str = ""

    @property
    def loudest(self) -> SignalRun:
        """The run in which the signal is largest."""
        return max(self.runs, key=lambda run: float(np.mean(run.added**2)))
