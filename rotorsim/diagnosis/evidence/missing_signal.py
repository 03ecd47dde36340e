"""The signal that a diagram lacks at a place, as recordings in time show it without any law."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Spot


@dataclass(frozen=True)
class PlaceClass:
    """Places whose signals change all recorded outputs alike, so that no data separate them, the likeliest first.

    probability: that a free signal, or a law, acts at one of them, among all classes.
    """

    places: tuple[Spot, ...]
    probability: float

    @property
    def words(self) -> str:
        """The places in words."""
        return " or ".join(spot.words for spot in self.places)


def spots_of(classes: Iterable[PlaceClass]) -> tuple[Spot, ...]:
    """Return the places of classes, each once, in their order."""
    return tuple(dict.fromkeys(spot for one in classes for spot in one.places))


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
    there, empty without one. left, without: residual variance of all outputs with and without it, of the noise's.
    predicted: share of it that a black box predicts where it was left out, of what is simulated and of time, 0 where
    that may be chance. repeated: the largest correlation between its courses in runs that are simulated alike (the same
    inputs, from the same start); None without any such runs.
    """

    place: Spot
    unit: str | None
    over: str
    over_unit: str | None
    share: float
    runs: tuple[SignalRun, ...]
    classes: tuple[PlaceClass, ...]
    left: float
    without: float
    predicted: float
    repeated: float | None = None
    physics: str = ""

    @property
    def rms(self) -> float:
        """Its root mean square in all runs: that of the estimate and its uncertainty."""
        return float(np.sqrt(np.mean(np.concatenate([run.added**2 + run.std**2 for run in self.runs]))))

    @property
    def correlation_time(self) -> float:
        """The time after which 1/e of it is left [s], by its autocorrelation in all runs; the longest run at most."""
        parts = [run.added - run.added.mean() for run in self.runs]
        longest = max(map(len, parts))
        alike = np.zeros(longest)
        for part in parts:
            spectrum = np.abs(np.fft.rfft(part, 2 * len(part))) ** 2
            alike[: len(part)] += np.fft.irfft(spectrum, 2 * len(part))[: len(part)]
        below = np.flatnonzero(alike < alike[0] / np.e)
        step = max(float(np.median(np.diff(run.time))) for run in self.runs)
        if not len(below):
            return step * longest
        k = int(below[0])
        return step * float(k - (alike[0] / np.e - alike[k]) / (alike[k - 1] - alike[k]))

    def known(self, value: str) -> tuple[float, float, str]:
        """Return "rms" or "correlation_time" with its standard deviation and unit.

        In a time T, where the autocorrelation is exp(-t / tau): var(rms^2) = 2 tau / T rms^4, var(tau) = 2 tau^3 / T.
        Source: M. S. Bartlett, J. R. Stat. Soc. Suppl. 8 (1946) 27-41.
        """
        tau, length = self.correlation_time, float(sum(np.ptp(run.time) for run in self.runs))
        spread = float(np.sqrt(2 * tau / length))
        return (
            (tau, tau * spread, "s")
            if value == "correlation_time"
            else (self.rms, self.rms * spread / 2, self.unit or "")
        )

    @property
    def loudest(self) -> SignalRun:
        """The run in which the signal is largest."""
        return max(self.runs, key=lambda run: float(np.mean(run.added**2)))
