"""Full spectra of runs of a turning shaft beside those of diagrams, and what they leave of every harmonic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from rotorsim.criteria import Z90
from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.comparison.harmonics import Comparison, Harmonics, Signal
from rotorsim.report.style import INK, SHOWN_HARMONIC, Look, display, figure, legend_below, order_axis, styled
from rotorsim.report.text.table import rpm

RUNS, SIGNALS = 4, 3  # that are shown
NOISE_COLOUR = "#e4e4e4"
NOISE_LEVELS = (0, 2, 4, 10, 30, 100, 300, 1000)  # standard deviations
LEVEL_COLOURS = ("#ffffff", "#fdebd0", "#fdc98c", "#f39c46", "#d9670f", "#a63c00", "#6a2300", "#330d00")


@styled()
def spectra_figure(compared: Comparison, count: int = RUNS) -> Figure:
    """Return full spectra of up to ``count`` runs: measured with 90 % intervals, every diagram and its residual."""
    signals, chosen = compared.signals[:SIGNALS], compared.runs.spread(count)
    title = f"Full spectra, {compared.of}"
    made = figure(5.5 * len(signals) + 0.5, 1.5 + 2.05 * len(chosen), title)
    grid = made.subplots(len(chosen), len(signals), squeeze=False, sharex="col", sharey="col")
    for column, signal in zip(grid.T, signals, strict=True):
        for axes, r in zip(column, chosen, strict=True):
            _draw_spectrum(axes, compared, r, signal)
            axes.set_title(f"{signal.title}, {compared.runs.title(r)}", loc="left", fontsize=8.5)
            axes.set_ylabel(f"[{of_amplitude(display(1.0, signal.unit)[1])}]")
        _limit(column, compared, signal, chosen)
        column[-1].set_xlabel("order of running speed" + (" (negative: backward)" if signal.y else ""))
    legend_below(made, grid[0, 0])
    return made


def _draw_spectrum(axes: Axes, compared: Comparison, r: int, signal: Signal) -> None:
    measured = compared.runs.measured(r, signal)
    orders, noise = measured.orders, _shown(measured.noise, signal.unit, measured.orders)
    edges = np.append(orders - 0.5, orders[-1] + 0.5)
    axes.set_yscale("log")
    axes.stairs(noise, edges, baseline=1e-300, fill=True, color=NOISE_COLOUR, label="noise alone (95 %)", zorder=0)
    hidden = measured.size <= measured.noise
    axes.plot(orders[hidden], _shown(measured.size, signal.unit, orders)[hidden], ".", ms=4, color="#a0a0a0", zorder=2)
    _draw_measured(axes, measured, signal.unit, Look("measured, 90 % interval", INK, "D", size=3.2))
    for look, runs in compared.diagrams:
        own = runs.measured(r, signal)  # readings, or what went into their converter
        _draw_predicted(axes, own, runs.prediction(r, signal), signal.unit, look)
        lines = runs.lines(r, signal)
        if lines is not None:
            if runs is compared.runs:
                _draw_measured(axes, lines[0], signal.unit, Look("measured at kX + nu", INK, "d", size=2.6))
            _draw_predicted(axes, *lines, signal.unit, look, lines[0].size > lines[0].noise)
    axes.grid(axis="x", visible=False)


def _draw_measured(axes: Axes, measured: Harmonics, unit: str, look: Look) -> None:
    """Draw amplitudes above the noise with their 90 % intervals."""
    clear = measured.size > measured.noise
    at = measured.orders[clear]
    size, bar = (_shown(part[clear], unit, at) for part in (measured.size, Z90 * measured.amplitude_std))
    axes.vlines(at, 1e-300, size, color="#bdbdbd", lw=1.0, zorder=1)
    axes.errorbar(
        at,
        size,
        np.array([np.minimum(bar, size * (1 - 1e-6)), bar]),
        fmt=look.marker,
        ms=look.size,
        color=look.colour,
        elinewidth=1.0,
        capsize=2.0,
        label=look.label,
        zorder=5,
    )


def _draw_predicted(
    axes: Axes, measured: Harmonics, model: np.ndarray, unit: str, look: Look, lines: np.ndarray | None = None
) -> None:
    """Draw amplitudes of a diagram and its residual; of asynchronous lines those chosen, smaller."""
    at, value, left = (
        part if lines is None else part[lines]
        for part in (measured.orders, np.abs(model), np.abs(measured.value - model))
    )
    scale, labels = (1.0, (look.label, f"residual, {look.label}")) if lines is None else (0.65, ("", ""))
    form: dict[str, Any] = {
        "ms": scale * look.size,
        "mfc": "none",
        "mec": look.colour,
        "mew": 1.3 * scale,
        "label": labels[0],
    }
    axes.plot(at, _shown(value, unit, at), look.marker, zorder=4, **form)
    form = {"ms": 4.5 * scale, "color": look.colour, "mew": 1.1 * scale, "label": labels[1]}
    axes.plot(at, _shown(left, unit, at), "x", zorder=3, **form)


def _shown(values: Any, unit: str, orders: Any = 1) -> np.ndarray:
    """Return amplitudes [SI, 0-peak] as they are shown; means, at order 0, are none."""
    return display(from_peak(values, orders), unit)[0]


def _limit(column: Sequence[Axes], compared: Comparison, signal: Signal, chosen: Sequence[int]) -> None:
    """Let spectra reach over the orders that stand out of the noise in some run and one more, and over their sizes."""
    orders, seen, tops, noises = compared.runs.orders(signal), [0, 3, -3 if signal.y else 0], [], []
    for r in chosen:
        noise, size = compared.runs.measured(r, signal).noise, compared.largest(r, signal)
        seen += orders[size > SHOWN_HARMONIC * noise].tolist()
        tops.append(size)
        noises.append(noise)
        lines = compared.runs.lines(r, signal)
        if lines is not None:
            seen += np.round(lines[0].orders[lines[0].size > SHOWN_HARMONIC * lines[0].noise]).astype(int).tolist()
            tops.append(lines[0].size)
    first, last = max(min(seen) - 1, int(orders.min())), min(max(seen) + 1, int(orders.max()))
    for axes in column:
        order_axis(axes, first if signal.y else 0, last)
    inside = (orders >= first) & (orders <= last)
    low = _shown(0.15 * np.min([noise[inside] for noise in noises]), signal.unit)
    high = float(_shown(3.0 * np.max([np.max(top) for top in tops]), signal.unit))
    if high > 0:
        column[0].set_ylim(max(float(low), 1e-7 * high), high)


@styled()
def residuals_figure(compared: Comparison) -> Figure:
    """Return what each diagram leaves of every harmonic of every run, in standard deviations of the noise."""
    runs, signals = compared.runs, compared.signals[:SIGNALS]
    group = runs.group_numbers()
    order = np.lexsort((runs.speeds, group))
    rows = [_shown_orders(compared, signal) for signal in signals]
    heights = [len(orders) for orders in rows]
    width = 1.6 + max(0.42 * len(order), 2.6) * len(compared.diagrams)
    title = f"Residual of each harmonic, {compared.of} [standard deviations of the noise]"
    made = figure(max(width, 8.0), 1.6 + 0.15 * sum(heights) + 0.75 * len(signals), title)
    grid = made.subplots(len(signals), len(compared.diagrams), squeeze=False, height_ratios=heights)
    norm, colours = BoundaryNorm(NOISE_LEVELS, len(NOISE_LEVELS), extend="max"), ListedColormap(LEVEL_COLOURS)
    for (row, column), axes in np.ndenumerate(grid):
        (look, own), signal, orders = compared.diagrams[column], signals[row], rows[row]
        places = np.searchsorted(own.orders(signal), orders)
        values = np.ma.masked_invalid([own.residual(r, signal)[places] for r in order])
        image = axes.pcolormesh(values.T, norm=norm, cmap=colours, edgecolors="#e8e8e8", lw=0.4)
        axes.grid(visible=False)
        axes.set_title(f"{signal.title}: {look.label}", loc="left", fontsize=8.5)
        ticks = [j for j, k in enumerate(orders) if len(orders) < 12 or k % 2 or k == 0]
        names = [f"{orders[j]}X" if orders[j] else "mean" for j in ticks]
        axes.set_yticks(np.array(ticks) + 0.5, names, fontsize=7)
        for border in np.flatnonzero(np.diff(group[order])):
            axes.axvline(border + 1, color=INK, lw=1.0)
        shown = np.arange(0, len(order), max(1, len(order) // 12))
        speeds = [f"{speed:.0f}" for speed in rpm(own.speeds[order[shown]])]
        axes.set_xticks(shown + 0.5, speeds, rotation=60, fontsize=7.5)
        if row == len(signals) - 1:
            axes.set_xlabel("speed of the runs [rpm]; lines part sets of settings")
    bar = made.colorbar(image, ax=grid, ticks=NOISE_LEVELS, shrink=0.9, pad=0.01, aspect=35)
    bar.set_label("|measured - model| / noise")
    return made


def _shown_orders(compared: Comparison, signal: Signal) -> np.ndarray:
    """Return the orders between those that some diagram or the data have out of the noise."""
    orders = compared.runs.orders(signal)
    clear = np.abs(orders) <= 3
    for r in range(len(compared.runs.speeds)):
        measured = compared.runs.measured(r, signal)
        clear |= measured.size > SHOWN_HARMONIC * measured.noise
        for _, runs in compared.diagrams:
            clear |= np.nan_to_num(runs.residual(r, signal)) > 2 * SHOWN_HARMONIC
    seen = orders[clear]
    return np.asarray(orders[(orders >= seen.min()) & (orders <= seen.max())])
