"""Samples in time beside what diagrams simulate, the worst stretch enlarged; residuals, their autocorrelation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.fft import irfft, next_fast_len, rfft

from rotorsim.report.comparison.samples import SampleComparison, Trace
from rotorsim.report.style import GREY, INK, RED, Look, figure, legend_below, styled

SIMULATED_LOOK = Look("simulated", RED, line="--")  # of one diagram that has no other name
TICKS = 5  # of an enlarged stretch, whose times have many digits
MOST_TRACES = 6  # of a figure
DRAWN_POINTS = 4000  # of a line: beyond, the smallest and largest of as many stretches
WINDOW = 0.06  # of a run: the stretch that is enlarged, or
PERIODS = 15  # of the signal if that is less,
LEAST_WINDOW = 60  # samples of it at least
LAGS = 150  # of an autocorrelation
WHITE_95 = 1.96  # over sqrt(N): what 95 % of the autocorrelations of white noise stay within


@styled()
def beside_figure(compared: SampleComparison) -> Figure:
    """Return signals measured and simulated: whole runs, and the stretch of each that is explained least."""
    worst = sorted(compared.traces, key=lambda trace: -np.nan_to_num(trace.nrmse()))[:MOST_TRACES]
    shown = [trace for trace in compared.traces if any(trace is one for one in worst)]
    made = figure(11.0, 1.3 + 1.9 * len(shown), compared.title)
    grid = made.subplots(len(shown), 2, squeeze=False, width_ratios=(1.7, 1.0))
    for (whole, zoom), trace in zip(grid, shown, strict=True):
        factor, unit = trace.shown
        part = worst_stretch(trace)
        whole.set_title(_errors(trace, compared.looks), loc="left", fontsize=8.5)
        whole.axvspan(trace.time[part.start], trace.time[part.stop - 1], color="#f3e6d8", zorder=0, lw=0)
        zoom.set_title("worst stretch", loc="left", fontsize=9)
        zoom.locator_params(axis="x", nbins=TICKS)
        for axes, piece in ((whole, slice(None)), (zoom, part)):
            _line(axes, trace.time[piece], factor * trace.measured[piece], INK, 1.9, "-", "measured")
            for look, y in zip(compared.looks, trace.simulated, strict=True):
                if y is not None:
                    _line(axes, trace.time[piece], factor * y[piece], look.colour, 1.0, look.line, look.label)
            axes.set(ylabel=f"[{unit or '1'}]", xmargin=0)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    legend_below(made, grid[0, 0])
    return made


def _errors(trace: Trace, looks: Sequence[Look]) -> str:
    """Return a signal, its run, and by how much each diagram is wrong."""
    factor, unit = trace.shown
    parts = []
    for k, look in enumerate(looks):
        size = f"rms error {factor * trace.rms(k):.3g} {unit}".rstrip()
        label = look.label.replace("diagram", "").strip()
        text = f"NRMSE {100 * trace.nrmse(k):.3g} %, {size}" if len(looks) == 1 else f"{size} {label}"
        parts.append(f"{label} diverges" if trace.simulated[k] is None else text)
    return f"{trace.name}, run {trace.run}: {', '.join(parts)}"


@styled()
def residuals_in_time_figure(compared: SampleComparison) -> Figure:
    """Return the residual of every signal, runs one after another, and its autocorrelation with the white 95 % band."""
    traces = compared.traces
    names = list(dict.fromkeys(trace.name for trace in traces))[:MOST_TRACES]
    single = len(compared.looks) == 1
    made = figure(11.0, 1.3 + 1.9 * len(names), compared.title)
    grid = made.subplots(len(names), 2, squeeze=False, width_ratios=(1.7, 1.0))
    for (left, right), name in zip(grid, names, strict=True):
        own = [trace for trace in traces if trace.name == name]
        factor, unit = max(own, key=lambda trace: float(np.nanmax(np.abs(trace.measured), initial=0.0))).shown
        begin = 0.0
        for k, trace in enumerate(own):
            for j, look in enumerate(compared.looks):
                if trace.simulated[j] is not None:
                    at, label = begin + trace.time - trace.time[0], "residual" if single else look.label
                    _line(left, at, factor * trace.residual(j), look.colour, 0.6, "-", label)
            begin += float(trace.time[-1] - trace.time[0])
            if k + 1 < len(own):
                left.axvline(begin, color=GREY, lw=0.8, ls=":", label="next run")
        left.axhline(0, color=GREY, lw=0.8)
        left.set_title(f"{name}, measured less simulated", loc="left", fontsize=9)
        left.set(ylabel=f"[{unit or '1'}]", xmargin=0)
        _draw_autocorrelation(right, own, compared.looks)
    grid[-1, 0].set_xlabel("time [s], runs one after another" if len(traces) > len(names) else "time [s]")
    grid[-1, 1].set_xlabel("lag [s]")
    legend_below(made, grid[0, 0])
    made.legends[0].set_loc("outside lower left")
    known = [text.get_text() for text in made.legends[0].get_texts()]
    handles, labels = grid[0, 1].get_legend_handles_labels()
    other = {label: handle for label, handle in zip(labels, handles, strict=True) if single or label not in known}
    made.legend(list(other.values()), list(other), loc="outside lower right", ncols=2)
    return made


def worst_stretch(trace: Trace) -> slice:
    """Return the stretch of a run whose residual, of the first diagram, is largest in the mean square."""
    return stretch(trace.residual(), trace.measured)


def stretch(values: np.ndarray, signal: np.ndarray, *, about_mean: bool = False) -> slice:
    """Return the stretch of a run where values (N,) are largest in the mean square, or vary most about their mean.

    signal (N,): whose periods say how long it is.
    """
    values, size = np.nan_to_num(values), len(values)
    above = signal > np.nanmean(signal) if np.isfinite(signal).any() else np.zeros(size, bool)
    period = 2 * size / max(int(np.count_nonzero(above[1:] != above[:-1])), 1)
    width = min(size, max(round(min(WINDOW * size, PERIODS * period)), LEAST_WINDOW))
    ones = np.ones(width)
    sums = np.convolve(values**2, ones, "valid")
    if about_mean:
        sums -= np.convolve(values, ones, "valid") ** 2 / width
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
        e, n = np.where(there, residual - mean, 0.0), min(lags + 1, len(residual))
        size = next_fast_len(len(e) + n, real=True)
        products = irfft(np.abs(rfft(np.stack([e, there.astype(float)]), size)) ** 2, size)[:, :n]
        sums[:n] += products[0]
        counts[:n] += np.round(products[1])
    power = sums[0] / max(counts[0], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(counts > 0, sums / counts / power, np.nan), int(counts[0])


def _draw_autocorrelation(axes: Axes, traces: Sequence[Trace], looks: Sequence[Look]) -> None:
    """Draw the autocorrelation of each residual; of the last, on which the verdict rests, as lines from zero."""
    lags = min(LAGS, max(len(trace.time) for trace in traces) // 4)
    period = np.median(np.concatenate([np.diff(trace.time) for trace in traces]))
    count = sum(int(np.isfinite(trace.measured).sum()) for trace in traces)
    band = WHITE_95 / np.sqrt(max(count, 1))
    at, reach, outside = period * np.arange(1, lags + 1), 3 * band, []
    axes.axhspan(-band, band, color="#dfe9f3", zorder=0, label="white noise (95 %)")
    for k, look in enumerate(looks):
        residuals = [trace.residual(k) for trace in traces if trace.simulated[k] is not None]
        if not residuals:
            continue
        values = autocorrelation(residuals, lags)[0][1:]
        label = "autocorrelation" if len(looks) == 1 else look.label
        if k + 1 < len(looks):
            axes.plot(at, values, color=look.colour, lw=1.0, label=label)
        else:
            axes.vlines(at, 0, values, color=look.colour, lw=1.0, label=label)
        reach = max(reach, 1.3 * float(np.nanmax(np.abs(values), initial=0.0)))
        outside.append(f"{100 * np.mean(np.abs(values) > band) if lags else 0.0:.0f} %")
    axes.axhline(0, color=GREY, lw=0.8)
    axes.set_title(f"autocorrelation: {' and '.join(outside)} of lags outside the band", loc="left", fontsize=9)
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
