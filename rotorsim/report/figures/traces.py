"""Signals in time beside what diagrams simulate, and below each the residual."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.report.comparison.samples import SampleComparison, Trace
from rotorsim.report.style import INK, display, figure, legend_below, styled

TRACES = 3  # shown
DRAWN_SAMPLES = 2500  # samples of a residual that are drawn
PERIODS = 15  # of a trace that are drawn in full


@styled()
def traces_figure(compared: SampleComparison) -> Figure:
    """Return signals in time beside what every diagram simulates, and below each its residual."""
    shown = compared.traces[:TRACES]
    made = figure(9.0, 1.2 + 3.4 * len(shown), f"Signals in time, {compared.of}")
    grid = made.subplots(2 * len(shown), 1, squeeze=False, height_ratios=(1.6, 1.0) * len(shown))
    for (upper, lower), trace in zip(grid.reshape(-1, 2), shown, strict=True):
        _draw_trace(upper, lower, trace, compared)
    legend_below(made, grid[0, 0])
    return made


def _draw_trace(upper: Axes, lower: Axes, trace: Trace, compared: SampleComparison) -> None:
    part, step = _window(trace), max(1, len(trace.measured) // DRAWN_SAMPLES)
    measured, unit = display(trace.measured, trace.unit)
    upper.plot(trace.time[part], measured[part], color=INK, lw=2.0, label="measured")
    for look, values in zip(compared.looks, trace.simulated, strict=True):
        if values is None:
            continue
        simulated = display(values, trace.unit)[0]
        upper.plot(trace.time[part], simulated[part], look.line, color=look.colour, lw=1.1, label=look.label)
        lower.plot(trace.time[::step], (measured - simulated)[::step], color=look.colour, lw=0.7)
    upper.set_title(f"{trace.name}, run {trace.run}", loc="left", fontsize=9)
    upper.set(xlabel="time [s]", ylabel=f"[{unit}]", xmargin=0)
    lower.set(xlabel="time [s]", ylabel=f"residual\n[{unit}]", xmargin=0)


def _window(trace: Trace) -> slice:
    """Return the part of a trace in which the first diagram is most wrong, PERIODS of it."""
    n = len(trace.measured)
    mean = np.nanmean(trace.measured)
    above = trace.measured > mean
    period = 2 * n / max(int(np.count_nonzero(above[1:] != above[:-1])), 1)
    width = int(min(n, max(PERIODS * period, 100)))
    first = trace.simulated[0]
    wrong = np.nan_to_num(trace.measured - (mean if first is None else first))  # nothing where nothing was measured
    start = int(np.argmax(np.convolve(wrong**2, np.ones(width), "valid")))
    return slice(start, start + width)
