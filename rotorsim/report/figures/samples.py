"""Samples in time beside what a diagram simulates, the worst stretch enlarged; residuals, their autocorrelation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.report.style import BLUE, GREY, INK, RED, figure, legend_below, styled
from rotorsim.units import conversion

MOST_TRACES = 6  # of a figure
DRAWN_POINTS = 4000  # of a line: beyond, the smallest and largest of as many stretches
WINDOW = 0.06  # of a run: the stretch that is enlarged,
LEAST_WINDOW = 60  # samples of it at least
LAGS = 150  # of an autocorrelation
WHITE_95 = 1.96  # over sqrt(N): what 95 % of the autocorrelations of white noise stay within
LENGTHS = ((1e-3, 1e6, "um"), (0.5, 1e3, "mm"))  # largest value, factor, unit of what was recorded in m


@dataclass(frozen=True, eq=False)
class Beside:
    """A signal of a run, measured and simulated (N,), SI, at instants time (N,) [s]; NaN where nothing was measured.

    unit: as recorded.
    """

    run: str
    name: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """Measured less simulated, (N,)."""
        return np.asarray(self.measured - self.simulated)

    @property
    def nrmse(self) -> float:
        """sqrt(sum (y - y_model)^2 / sum (y - mean)^2); not a number of a signal that stands still."""
        there = np.isfinite(self.measured)
        total = float(((self.measured[there] - self.measured[there].mean()) ** 2).sum()) if there.any() else 0.0
        return float(np.sqrt(np.nansum(self.residual**2) / total)) if total > 0 else np.nan

    @property
    def rms(self) -> float:
        """Root mean square of the residual, SI."""
        there = np.isfinite(self.measured)
        return float(np.sqrt(np.mean(self.residual[there] ** 2))) if there.any() else np.nan

    @property
    def shown(self) -> tuple[float, str]:
        """The factor and the unit by which values are shown: that of the recording, metres by their size."""
        if self.unit == "m":
            largest = float(np.nanmax(np.abs(self.measured), initial=0.0))
            return next(((factor, unit) for size, factor, unit in LENGTHS if largest < size), (1.0, "m"))
        return 1 / conversion(self.unit, None), "" if self.unit == "1" else self.unit


@styled()
def beside_figure(traces: Sequence[Beside], title: str) -> Figure:
    """Return signals measured and simulated: whole runs, and the stretch of each that is explained least."""
    shown = sorted(traces, key=lambda trace: -np.nan_to_num(trace.nrmse))[:MOST_TRACES]
    shown = [trace for trace in traces if any(trace is one for one in shown)]
    made = figure(11.0, 1.3 + 1.9 * len(shown), title)
    grid = made.subplots(len(shown), 2, squeeze=False, width_ratios=(1.7, 1.0))
    for (whole, zoom), trace in zip(grid, shown, strict=True):
        factor, unit = trace.shown
        part = worst_stretch(trace)
        text = (
            f"{trace.name}, run {trace.run}: NRMSE {100 * trace.nrmse:.3g} %, rms error {factor * trace.rms:.3g} {unit}"
        )
        whole.set_title(text.rstrip(), loc="left", fontsize=9)
        whole.axvspan(trace.time[part.start], trace.time[part.stop - 1], color="#f3e6d8", zorder=0, lw=0)
        zoom.set_title("worst stretch", loc="left", fontsize=9)
        for axes, piece in ((whole, slice(None)), (zoom, part)):
            _line(axes, trace.time[piece], factor * trace.measured[piece], INK, 1.6, "-", "measured")
            _line(axes, trace.time[piece], factor * trace.simulated[piece], RED, 1.0, "--", "simulated")
            axes.set(ylabel=f"[{unit or '1'}]", xmargin=0)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    legend_below(made, grid[0, 0])
    return made


@styled()
def residuals_in_time_figure(traces: Sequence[Beside], title: str) -> Figure:
    """Return the residual of every signal, runs one after another, and its autocorrelation with the white 95 % band."""
    names = list(dict.fromkeys(trace.name for trace in traces))[:MOST_TRACES]
    made = figure(11.0, 1.3 + 1.9 * len(names), title)
    grid = made.subplots(len(names), 2, squeeze=False, width_ratios=(1.7, 1.0))
    for (left, right), name in zip(grid, names, strict=True):
        own = [trace for trace in traces if trace.name == name]
        factor, unit = max(own, key=lambda trace: float(np.nanmax(np.abs(trace.measured), initial=0.0))).shown
        begin = 0.0
        for k, trace in enumerate(own):
            _line(left, begin + trace.time - trace.time[0], factor * trace.residual, BLUE, 0.6, "-", "residual")
            begin += float(trace.time[-1] - trace.time[0])
            if k + 1 < len(own):
                left.axvline(begin, color=GREY, lw=0.8, ls=":", label="next run")
        left.axhline(0, color=GREY, lw=0.8)
        left.set_title(f"{name}, measured less simulated", loc="left", fontsize=9)
        left.set(ylabel=f"[{unit or '1'}]", xmargin=0)
        _draw_autocorrelation(right, own)
    grid[-1, 0].set_xlabel("time [s], runs one after another" if len(traces) > len(names) else "time [s]")
    grid[-1, 1].set_xlabel("lag [s]")
    legend_below(made, grid[0, 0])
    made.legends[0].set_loc("outside lower left")
    handles, labels = grid[0, 1].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside lower right", ncols=2)
    return made


def worst_stretch(trace: Beside) -> slice:
    """Return the stretch of a run whose residual is largest in the mean square."""
    square = np.nan_to_num(trace.residual**2)
    width = min(len(square), max(round(WINDOW * len(square)), LEAST_WINDOW))
    sums = np.convolve(square, np.ones(width), "valid")
    start = int(np.median(np.flatnonzero(sums >= sums.max() * (1 - 1e-9))))  # a spike in its middle
    return slice(start, start + width)


def autocorrelation(residuals: Sequence[np.ndarray], lags: int) -> tuple[np.ndarray, int]:
    """Return the autocorrelation of residuals of several runs at lags 0..lags, and how many samples N it is of.

    r_k = (sum e_i e_(i+k) / n_k) / (sum e_i^2 / n_0), over the n_k pairs that were measured
    """
    sums, counts = np.zeros(lags + 1), np.zeros(lags + 1)
    mean = float(np.nanmean(np.concatenate(residuals)))
    for residual in residuals:
        there = np.isfinite(residual)
        e = np.where(there, residual - mean, 0.0)
        for k in range(min(lags, len(e) - 1) + 1):
            sums[k] += e[: len(e) - k] @ e[k:]
            counts[k] += np.count_nonzero(there[: len(e) - k] & there[k:])
    power = sums[0] / max(counts[0], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(counts > 0, sums / counts / power, np.nan), int(counts[0])


def _draw_autocorrelation(axes: Axes, traces: Sequence[Beside]) -> None:
    lags = min(LAGS, max(len(trace.time) for trace in traces) // 4)
    values, count = autocorrelation([trace.residual for trace in traces], lags)
    period = np.median(np.concatenate([np.diff(trace.time) for trace in traces]))
    band = WHITE_95 / np.sqrt(max(count, 1))
    axes.axhspan(-band, band, color="#dfe9f3", zorder=0, label="white noise (95 %)")
    axes.vlines(period * np.arange(1, lags + 1), 0, values[1:], color=BLUE, lw=1.0, label="autocorrelation")
    axes.axhline(0, color=GREY, lw=0.8)
    reach = max(1.3 * float(np.nanmax(np.abs(values[1:]), initial=0.0)), 3 * band)
    outside = np.nanmean(np.abs(values[1:]) > band) if lags else 0.0
    axes.set_title(f"autocorrelation: {100 * outside:.0f} % of lags outside the band", loc="left", fontsize=9)
    axes.set(ylim=(-min(reach, 1.05), min(reach, 1.05)), xlim=(0, period * (lags + 1)))


def _line(axes: Axes, x: np.ndarray, y: np.ndarray, colour: str, width: float, dashes: str, label: str) -> None:
    """Draw a line; one of more points than can be seen by the smallest and largest of every stretch."""
    dense = len(x) > DRAWN_POINTS
    if dense:
        size = len(x) // (DRAWN_POINTS // 2)
        count = len(x) // size
        part = y[: count * size].reshape(count, size)
        with np.errstate(all="ignore"):
            ends = np.stack([np.fmin.reduce(part, axis=1), np.fmax.reduce(part, axis=1)], axis=1)
        x, y = np.repeat(x[: count * size : size], 2), ends.ravel()
    axes.plot(x, y, dashes if not dense else "-", color=colour, lw=width, label=label)
