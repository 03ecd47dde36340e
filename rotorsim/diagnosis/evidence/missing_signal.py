"""The signal that a diagram lacks at a place, as recordings in time show it without any law."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.criteria import CRITERIA
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


def likely_spots(classes: Sequence[PlaceClass]) -> frozenset[Spot]:
    """Return the places of classes, the likeliest first, that the data do not rule out."""
    least = classes[0].probability * np.exp(-CRITERIA.equivalent / 2) if classes else 0.0
    return frozenset(spot for one in classes if one.probability >= least for spot in one.places)


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
    that may be chance. follows: the exponent by which its power follows that of what is simulated without it, from
    stretch to stretch, and its standard deviation: 1 of what is proportional, 0 of what has nothing to do with it.
    line: power of the line that stands out of it most, 1 of what chance makes.
    repeated: the largest correlation between its courses in runs that are simulated alike (the same inputs, from the
    same start); None without any such runs.
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
    follows: tuple[float, float] = (0.0, np.inf)
    line: float = 0.0

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

        In a time T, where the autocorrelation is exp(-t / tau): var(rms^2) = 2 tau / T rms^4; the variance of the
        autocorrelation at tau is (1 - 3 / e^2) tau / T, hence var(tau) = (e^2 - 3) tau^3 / T.
        Source: M. S. Bartlett, J. R. Stat. Soc. Suppl. 8 (1946) 27-41.
        """
        tau, length = self.correlation_time, float(sum(np.ptp(run.time) for run in self.runs))
        if value == "correlation_time":
            return tau, float(np.sqrt((np.e**2 - 3) * tau**3 / length)), "s"
        return self.rms, self.rms * float(np.sqrt(tau / length / 2)), self.unit or ""

    @property
    def kurtosis(self) -> tuple[float, float]:
        """Its excess kurtosis about its mean in all runs, 0 of Gaussian noise, and the standard deviation of that.

        Of n samples 24 / n times the sum of rho^4: in a time T, where rho = exp(-t / tau), 12 tau / T.
        Source: Z. A. Lomnicki, Metrika 4 (1961) 37-62.
        """
        added = np.concatenate([run.added for run in self.runs])
        added, length = added - added.mean(), sum(np.ptp(run.time) for run in self.runs)
        square = float(np.mean(added**2))
        excess = float(np.mean(added**4)) / square**2 - 3 if square > 0 else 0.0
        return excess, float(np.sqrt(12 * self.correlation_time / length))

    @property
    def loudest(self) -> SignalRun:
        """The run in which the signal is largest."""
        return max(self.runs, key=lambda run: float(np.mean(run.added**2)))
