"""Evidence of a diagnosis: what both diagrams leave over, how parameters move, signals in time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from rotorsim.diagnosis.conclude.conclusions import Diagnosis
from rotorsim.report.diagnosis.comparison import Pair, Trace, excess_of, fitted_pair, held_pair, labels_of, traces
from rotorsim.report.diagnosis.figures import LOOK, STANDS_OUT, legend, speed_curves_figure, wide_sheet
from rotorsim.report.identification.comparison import Comparison, Signal
from rotorsim.report.style import GREY, INK, display, rpm, styled

__all__ = ["before_and_after_figure", "parameters_figure", "residuals_figure", "traces_figure"]

LEVELS = (0, 2, 4, 10, 30, 100, 300, 1000)  # standard deviations
LEVEL_COLOURS = ("#ffffff", "#fdebd0", "#fdc98c", "#f39c46", "#d9670f", "#a63c00", "#6a2300", "#330d00")
SHOWN = 2500  # samples of a trace that are drawn
PERIODS = 15  # of a trace that are drawn in full
WIDEST = {"%": 150.0, "deg": 180.0}  # change of a parameter to which the axis reaches


def before_and_after_figure(found: Diagnosis) -> Figure:
    """Return both diagrams beside held-out runs (fitted ones without any): over speed, or in time."""
    in_time, pair = traces(found), held_pair(found)
    if in_time or pair is None:
        return traces_figure(in_time, labels_of(found), not found.effects and found.after is found.before)
    return speed_curves_figure(pair, fitted_pair(found)) or residuals_figure(pair)


def residuals_figure(pair: Pair) -> Figure:
    """Return what each diagram leaves of every harmonic of every run, in standard deviations of the noise."""
    signals = pair.telling[:2]
    runs = _by_speed(pair.any)
    rows = {signal.title: _shown_orders(pair, signal, runs) for signal in signals}
    with styled():
        width = 1.6 + max(0.42 * len(runs), 2.6) * len(pair.models)
        heights = [len(rows[signal.title]) for signal in signals]
        title = f"Left over of each harmonic, {pair.runs} [standard deviations of the noise]"
        made = wide_sheet(max(width, 8.0), 1.6 + 0.15 * sum(heights) + 0.75 * len(signals), title)
        grid = made.subplots(len(signals), len(pair.models), squeeze=False, height_ratios=heights)
        norm, colours = BoundaryNorm(LEVELS, len(LEVELS), extend="max"), ListedColormap(LEVEL_COLOURS)
        image = None
        for row, signal in enumerate(signals):
            orders = rows[signal.title]
            for column, (name, compared) in enumerate(pair.models):
                axes = grid[row, column]
                every = compared.orders(signal).tolist()
                places = [every.index(int(k)) for k in orders]
                values = np.array([excess_of(compared, r, signal)[places] for r in runs]).T
                image = axes.pcolormesh(
                    np.ma.masked_invalid(values), norm=norm, cmap=colours, edgecolors="#e8e8e8", lw=0.4
                )
                axes.grid(visible=False)
                axes.set_title(f"{signal.title}: {pair.labels[name]}", loc="left", fontsize=8.5)
                ticks = [j for j, k in enumerate(orders) if len(orders) < 12 or k % 2 or k == 0]
                names = [f"{orders[j]}X" if orders[j] else "mean" for j in ticks]
                axes.set_yticks(np.array(ticks) + 0.5, names, fontsize=7)
                for place in _borders(compared, runs):
                    axes.axvline(place, color=INK, lw=1.0)
                speeds = [f"{float(rpm(compared.experiment.fits[r].speed)):.0f}" for r in runs]
                step = max(1, len(runs) // 12)
                axes.set_xticks(np.arange(0, len(runs), step) + 0.5, speeds[::step], rotation=60, fontsize=7.5)
                if row == len(signals) - 1:
                    axes.set_xlabel("speed of the runs [rpm]; lines part sets of settings")
        if image is not None:
            bar = made.colorbar(image, ax=grid, ticks=LEVELS, shrink=0.9, pad=0.01, aspect=35)
            bar.set_label("|measured - model| / noise")
    return made


def _by_speed(compared: Comparison) -> list[int]:
    speeds = [fit.speed for fit in compared.experiment.fits]
    labels = list(compared.groups)
    return sorted(range(len(speeds)), key=lambda r: (labels.index(compared.group_of(r)), speeds[r]))


def _borders(compared: Comparison, runs: Sequence[int]) -> list[int]:
    """Return where runs in this order change their settings."""
    labels = [compared.group_of(r) for r in runs]
    return [k for k in range(1, len(runs)) if labels[k] != labels[k - 1]]


def _shown_orders(pair: Pair, signal: Signal, runs: Sequence[int]) -> np.ndarray:
    """Return the orders between those that some diagram or the data have out of the noise."""
    orders = pair.any.orders(signal)
    clear = np.abs(orders) <= 3
    for r in runs:
        measured = pair.any.measured(r, signal)
        clear |= np.abs(measured.value) > STANDS_OUT * measured.noise
        for _, compared in pair.models:
            clear |= np.nan_to_num(excess_of(compared, r, signal)) > 2 * STANDS_OUT
    seen = orders[clear]
    return np.asarray(orders[(orders >= seen.min()) & (orders <= seen.max())])


def parameters_figure(
    before: Mapping[str, Mapping[str, Any]], after: Mapping[str, Mapping[str, Any]], labels: Mapping[str, str]
) -> Figure | None:
    """Return how parameters move: both values with 90 % intervals, in parts of the later one, or degrees for angles.

    None where nothing is in both. Each parameter: value, interval90, unit, at_bound (hollow, without an interval;
    the other value is then what it is compared with). Beyond WIDEST the change is written at the edge.
    """
    names = [name for name in after if name in before and not (_ends(before[name]) and _ends(after[name]))]
    panels = [
        ("%", [name for name in names if after[name]["unit"] != "rad"]),
        ("deg", [name for name in names if after[name]["unit"] == "rad"]),
    ]
    panels = [(unit, some) for unit, some in panels if some]
    if not panels:
        return None
    with styled():
        rows = max(len(some) for _, some in panels)
        made = wide_sheet(5.2 * len(panels), 1.5 + 0.42 * rows, "How identified parameters move, with 90 % intervals")
        grid = made.subplots(1, len(panels), squeeze=False, width_ratios=[1.0] * len(panels))
        for axes, (unit, some) in zip(grid[0], panels, strict=True):
            _draw_moves(axes, list(reversed(some)), before, after, labels, unit)
        legend(made, grid[0, 0])
    return made


def _ends(item: Mapping[str, Any]) -> bool:
    return bool(item.get("at_bound"))


def _draw_moves(
    axes: Axes,
    names: Sequence[str],
    before: Mapping[str, Mapping[str, Any]],
    after: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, str],
    unit: str,
) -> None:
    drawn = []
    for row, name in enumerate(names):
        base = before[name] if _ends(after[name]) or not after[name]["value"] else after[name]
        drawn += [
            (row + shift, look, item, _relative(item, base, unit == "deg"))
            for shift, item, look in ((0.14, before[name], "before"), (-0.14, after[name], "after"))
        ]
    ends = np.abs([end for *_, places in drawn for end in places])
    limit = min(1.15 * float(ends.max(initial=1e-3)), WIDEST[unit])
    for height, look, item, (centre, low, high) in drawn:
        form: dict[str, Any] = {"ms": 5, "color": LOOK[look]["color"], "capsize": 2.5, "elinewidth": 1.2}
        if _ends(item):
            form["mfc"] = "white"
            low = high = centre
        marker: str = LOOK[look]["marker"]
        if abs(centre) > limit:
            side = float(np.sign(centre))
            marker, low, high = ("<" if side < 0 else ">"), 0.97 * side * limit, 0.97 * side * limit
            axes.annotate(
                f"{centre:+.3g} {unit} ",
                (low, height),
                (-8 * side, 0),
                textcoords="offset points",
                ha="right" if side > 0 else "left",
                va="center",
                fontsize=8,
            )
            centre = low
        label = labels[look] + (", at its bound" if _ends(item) else "")
        axes.errorbar(
            centre, height, xerr=[[max(centre - low, 0)], [max(high - centre, 0)]], fmt=marker, label=label, **form
        )
    axes.axvline(0.0, color=GREY, lw=0.8, zorder=0)
    axes.set_yticks(range(len(names)), list(names))
    axes.set_ylim(-0.6, len(names) - 0.4)
    least, most = (sign * max(0.0, *(sign * end for *_, places in drawn for end in places)) for sign in (-1, 1))
    room = 0.08 * (most - least)
    axes.set_xlim(max(least - room, -limit), min(most + room, limit))
    axes.set_xlabel(f"change against {labels['after']} [{unit}]")


def _relative(item: Mapping[str, Any], base: Mapping[str, Any], degrees: bool) -> tuple[float, float, float]:
    """Return value and interval against a base value."""
    low, high = (item["value"] if end is None or not math.isfinite(end) else end for end in item["interval90"])
    values = np.array([item["value"], low, high])
    if degrees:
        turn = np.round((values[0] - base["value"]) / (2 * np.pi)) * 2 * np.pi
        values = np.degrees(values - turn - base["value"])
        return float(values[0]), float(values[1]), float(values[2])
    size = abs(base["value"]) or abs(item["value"]) or 1.0
    values = 100 * (values - base["value"]) / size
    return float(values[0]), float(values[1]), float(values[2])


def traces_figure(found: Sequence[Trace], labels: Mapping[str, str], same: bool) -> Figure:
    """Return signals in time beside what both diagrams simulate, and below each what they leave over."""
    shown = list(found)[:3]
    with styled():
        kind = "held-out runs" if shown[0].held else "runs that were fitted"
        made = wide_sheet(9.0, 1.2 + 3.4 * len(shown), f"Signals in time, {kind}")
        grid = made.subplots(2 * len(shown), 1, squeeze=False, height_ratios=(1.6, 1.0) * len(shown))[:, 0]
        for k, trace in enumerate(shown):
            _draw_trace(grid[2 * k], grid[2 * k + 1], trace, labels, same)
        legend(made, grid[0])
    return made


def _draw_trace(upper: Axes, lower: Axes, trace: Trace, labels: Mapping[str, str], same: bool) -> None:
    part = _window(trace)
    names = [("after", trace.after)] if same else [("before", trace.before), ("after", trace.after)]
    measured, unit = display(trace.measured, trace.unit)
    upper.plot(trace.time[part], measured[part], color=INK, lw=2.0, label="measured")
    for name, values in names:
        if values is None:
            continue
        shown = display(values, trace.unit)[0]
        look = LOOK[name]
        label = labels["model" if same else name]
        upper.plot(trace.time[part], shown[part], ls=look["ls"], color=look["color"], lw=1.1, label=label)
        step = max(1, len(measured) // SHOWN)
        lower.plot(trace.time[::step], (measured - shown)[::step], color=look["color"], lw=0.7, label=label)
    upper.set_title(f"{trace.name}, run {trace.run}", loc="left", fontsize=9)
    upper.set_ylabel(f"[{unit}]")
    lower.set_ylabel(f"left over\n[{unit}]")
    lower.set_xlabel("time [s]")
    upper.set_xlabel("time [s]")
    upper.margins(x=0)
    lower.margins(x=0)


def _window(trace: Trace) -> slice:
    """Return the part of a trace in which the diagram as given is most wrong, PERIODS of it."""
    n = len(trace.measured)
    above = trace.measured > trace.measured.mean()
    period = 2 * n / max(int(np.count_nonzero(above[1:] != above[:-1])), 1)
    width = int(min(n, max(PERIODS * period, 100)))
    wrong = trace.measured - (trace.before if trace.before is not None else trace.measured.mean())
    energy = np.convolve(wrong**2, np.ones(width), "valid")
    start = int(np.argmax(energy))
    return slice(start, start + width)
