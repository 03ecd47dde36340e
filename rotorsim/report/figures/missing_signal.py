"""The signal that a diagram lacks, estimated without a law: over time, and over what it may depend on."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, SignalRun
from rotorsim.report.comparison.samples import shown_in
from rotorsim.report.figures.samples import DRAWN_POINTS, TICKS, stretch
from rotorsim.report.style import BLUE, GREY, ORANGE, figure, legend_below, styled

Z95 = 1.96  # standard deviations: the band
UNKNOWN_UNIT = "SI"  # of a signal of which neither diagram nor recording states the unit


@styled()
def missing_signal_figure(signal: MissingSignal) -> Figure:
    """Return the signal over time in the run where it is largest, a part of that enlarged, and its map in all runs."""
    made = figure(11.0, 6.2, f"Missing signal at {signal.place.words}, estimated from all recorded outputs")
    axes = made.subplot_mosaic([["whole", "whole"], ["zoom", "map"]], height_ratios=(1.0, 1.5))
    run = signal.loudest
    factor, unit = _shown(signal.unit, run.added)
    part = stretch(run.added, run.over, about_mean=True)
    _draw_over_time(axes["whole"], signal, run, slice(None), factor)
    axes["whole"].axvspan(run.time[part.start], run.time[part.stop - 1], color="#f3e6d8", zorder=0, lw=0)
    axes["whole"].set_title(f"run {run.run}", loc="left", fontsize=9)
    _draw_over_time(axes["zoom"], signal, run, part, factor)
    axes["zoom"].locator_params(axis="x", nbins=TICKS)
    axes["zoom"].set_title("where it varies most", loc="left", fontsize=9)
    for name in ("whole", "zoom"):
        axes[name].set(xlabel="time [s]", ylabel=f"[{unit}]", xmargin=0)
    axes["map"].set(xlabel=_draw_map(axes["map"], signal, factor), ylabel=f"[{unit}]")
    legend_below(made, axes["whole"])
    return made


def _shown(unit: str | None, values: np.ndarray) -> tuple[float, str]:
    """Return factor and unit by which a signal is shown; SI where no unit is known."""
    if unit is None:
        return 1.0, UNKNOWN_UNIT
    factor, shown = shown_in(unit, values)
    return factor, shown or "1"


def _draw_over_time(axes: Axes, signal: MissingSignal, run: SignalRun, part: slice, factor: float) -> None:
    """Draw a part of a run: the estimate with its 95 % band, and the law."""
    part = slice(part.start, part.stop, max(1, len(run.time[part]) // DRAWN_POINTS))
    time, added, half = run.time[part], factor * run.added[part], factor * Z95 * run.std[part]
    axes.fill_between(time, added - half, added + half, color=BLUE, alpha=0.25, lw=0, label="its 95 % band")
    axes.plot(time, added, color=BLUE, lw=1.0, label="estimated, without a law")
    if run.law is not None:
        label = f"law found: {signal.physics.replace('_', ' ')}"
        axes.plot(time, factor * run.law[part], "--", color=ORANGE, lw=1.2, label=label)
    axes.axhline(0, color=GREY, lw=0.8)


def _draw_map(axes: Axes, signal: MissingSignal, factor: float) -> str:
    """Draw the estimate of all runs over a signal, and the law over what it reads; return what that is, with unit."""
    step = max(1, sum(len(run.time) for run in signal.runs) // DRAWN_POINTS)
    scale, unit = _shown(signal.over_unit, np.concatenate([run.over for run in signal.runs]))
    for run in signal.runs:
        axes.plot(scale * run.over[::step], factor * run.added[::step], ".", color=BLUE, ms=2.6, alpha=0.5, mew=0)
    for run in signal.runs:
        if run.law is not None and run.law_over is not None:
            axes.plot(scale * run.law_over[::step], factor * run.law[::step], ".", color=ORANGE, ms=1.8, mew=0)
    axes.axhline(0, color=GREY, lw=0.8)
    text = f"over {signal.over}, all runs: a map explains {100 * signal.share:.3g} %"
    axes.set_title(text, loc="left", fontsize=9)
    return f"{signal.over} [{unit}]"
