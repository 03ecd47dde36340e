"""Signals in time beside what one or more diagrams simulate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorsim.report.style import Look
from rotorsim.units import conversion

LENGTHS = ((1e-3, 1e6, "um"), (0.5, 1e3, "mm"))  # largest value, factor, unit of what was recorded in m


def shown_in(unit: str, values: np.ndarray) -> tuple[float, str]:
    """Return by what SI values are multiplied to be shown, and in which unit: that given, metres by their size."""
    if unit == "m":
        largest = float(np.nanmax(np.abs(values), initial=0.0))
        return next(((factor, length) for size, factor, length in LENGTHS if largest < size), (1.0, "m"))
    return 1 / conversion(unit or "1", None), "" if unit == "1" else unit


@dataclass(frozen=True, eq=False)
class Trace:
    """A signal of a run, measured (N,) and as each diagram simulates it (N,), SI, at instants time (N,) [s].

    measured: NaN where nothing was. simulated: None where a diagram diverges. unit: as recorded.
    """

    run: str
    name: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    simulated: tuple[np.ndarray | None, ...]

    def residual(self, k: int = 0) -> np.ndarray:
        """Return measured less simulated by diagram k, (N,); about the mean of the signal where that diverges."""
        y = self.simulated[k]
        return np.asarray(self.measured - (self._mean if y is None else y))

    def nrmse(self, k: int = 0) -> float:
        """Return sqrt(sum (y - y_model)^2 / sum (y - mean)^2); not a number of a signal that stands still."""
        there = np.isfinite(self.measured)
        total = float(((self.measured[there] - self._mean) ** 2).sum())
        return float(np.sqrt(np.nansum(self.residual(k) ** 2) / total)) if total > 0 else np.nan

    def rms(self, k: int = 0) -> float:
        """Return the root mean square of the residual, SI."""
        there = np.isfinite(self.measured)
        return float(np.sqrt(np.mean(self.residual(k)[there] ** 2))) if there.any() else np.nan

    @property
    def _mean(self) -> float:
        there = np.isfinite(self.measured)
        return float(self.measured[there].mean()) if there.any() else 0.0

    @property
    def shown(self) -> tuple[float, str]:
        """The factor and the unit by which values are shown."""
        return shown_in(self.unit, self.measured)


@dataclass(frozen=True, eq=False)
class SampleComparison:
    """Diagrams, the one as given first, beside the same signals in time; title: of figures of them."""

    looks: tuple[Look, ...]
    traces: tuple[Trace, ...]
    title: str

    def worst_runs(self) -> SampleComparison:
        """Return every signal once, in the run in which the first diagram is most wrong."""
        worst: dict[str, Trace] = {}
        for trace in self.traces:
            if trace.name not in worst or trace.rms() > worst[trace.name].rms():
                worst[trace.name] = trace
        return SampleComparison(self.looks, tuple(worst.values()), self.title)
