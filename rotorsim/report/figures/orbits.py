"""Orbits of runs of a turning shaft beside those of diagrams."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.report.comparison.harmonics import Comparison, Signal
from rotorsim.report.style import INK, display, figure, legend_below, styled

RUNS = 4  # shown
RAW = 4000  # samples shown


@styled()
def orbits_figure(compared: Comparison, count: int = RUNS) -> Figure | None:
    """Return orbits of some runs: samples, their synchronous part, and every diagram; None without two axes."""
    signal = next((one for one in compared.signals if one.y is not None), None)
    if signal is None:
        return None
    chosen = compared.runs.spread(count)
    columns = min(len(chosen), 2)
    rows = -(-len(chosen) // columns)
    title = f"Orbits of {signal.title}, {compared.of}"
    made = figure(4.4 * columns + 0.4, 1.2 + 4.0 * rows, title)
    for k, r in enumerate(chosen):
        axes = made.add_subplot(rows, columns, k + 1)
        _draw_orbit(axes, compared, r, signal)
        axes.set_title(compared.runs.title(r), loc="left", fontsize=8.5)
        unit = display(1.0, signal.unit)[1]
        axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    legend_below(made, made.axes[0])
    return made


def _draw_orbit(axes: Axes, compared: Comparison, r: int, signal: Signal) -> None:
    theta = np.linspace(0, 2 * np.pi, 721)
    samples = display(compared.runs.samples(r, signal), signal.unit)[0][-RAW:]
    axes.plot(samples.real, samples.imag, ".", ms=1.8, color="#bdbdbd", label="samples", rasterized=True, zorder=1)
    measured = display(compared.runs.orbit(r, signal, theta)[0], signal.unit)[0]
    axes.plot(measured.real, measured.imag, color=INK, lw=2.4, label="measured, synchronous", zorder=2)
    for look, runs in compared.diagrams:
        orbit = display(runs.orbit(r, signal, theta)[1], signal.unit)[0]
        axes.plot(orbit.real, orbit.imag, look.line, color=look.colour, lw=1.4, label=look.label, zorder=3)
        axes.plot(orbit[0].real, orbit[0].imag, look.marker, ms=9, mfc="none", mec=look.colour, zorder=4)
    axes.plot(measured[0].real, measured[0].imag, "D", ms=4.5, color=INK, label="shaft angle zero", zorder=5)
    step = np.diff(measured) * np.sign(compared.runs.speeds[r])
    at = 90 + int(np.argmax(np.abs(step[90:-90])))  # where it is fastest, away from shaft angle zero
    tail, tip = measured[at] - step[at] / 2, measured[at] + step[at] / 2
    arrow = {"arrowstyle": "-|>", "color": INK, "lw": 0, "mutation_scale": 24, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (tip.real, tip.imag), (tail.real, tail.imag), zorder=5, arrowprops=arrow)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
