"""Amplitude and phase over speed: runs of a turning shaft with error bars, diagrams as lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

from rotorsim.identification.profile import Z90
from rotorsim.report.comparison.harmonics import Comparison, PredictedRuns, Signal
from rotorsim.report.comparison.speed_curves import speed_curve
from rotorsim.report.style import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    RED,
    STANDS_OUT,
    Look,
    display,
    figure,
    legend_below,
    styled,
)
from rotorsim.report.text.table import rpm

__all__ = ["speed_curves_figure"]

MAIN = (1, -1, 2, 3, -2, -3)  # orders that come first
CURVES, GROUPS = 4, 2  # orders, and sets of settings with panels of their own
PHASE_STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45, 90)
MEASURED = Look("measured, 90 % interval", INK, "D", size=4.0)
FITTED = Look("measured, fitted runs", "#8a8a8a", "D", size=3.2)
BESIDE = (
    Look("", BLUE, "o", "-"),
    Look("", RED, "s", "--"),
    Look("", GREEN, "^", "-."),
    Look("", PURPLE, "D", ":"),
    Look("", ORANGE, "v", "-"),
    Look("", INK, "P", "--"),
)
Branch = tuple[np.ndarray, np.ndarray]  # speeds (n,) [rad/s] and the phase there [deg]


@dataclass(frozen=True)
class _Set:
    """Runs with the same settings, and the diagrams beside them."""

    group: str
    measured: Look
    diagrams: Sequence[tuple[Look, PredictedRuns]]

    @property
    def runs(self) -> PredictedRuns:
        return self.diagrams[-1][1]


def speed_curves_figure(
    compared: Comparison, fitted: Comparison | None = None, signal: Signal | None = None
) -> Figure | None:
    """Return amplitude and phase of the main harmonics over speed: measured with bars, every diagram as a line.

    One diagram: all sets of settings together; several: the largest sets each in panels of their own. fitted: the runs
    that took part in fitting, shown beside with small marks. None with fewer than two runs, or where nothing stands out
    of the noise.
    """
    signal = signal or next((one for one in compared.signals if one.y is not None), compared.signals[0])
    orders = _main_orders(compared.runs, signal)
    if len(compared.runs.speeds) < 2 or not len(orders):
        return None
    rows = _rows(compared)
    with styled():
        title = f"Main harmonics of {signal.title} over speed, {compared.of}"
        made = figure(0.8 + 3.2 * max(len(orders), 2), 1.2 + 4.2 * len(rows), title)
        heights = (1.5, 1.0) * len(rows)
        grid = made.subplots(2 * len(rows), len(orders), squeeze=False, sharex=True, height_ratios=heights)
        for panels, row in zip(np.split(grid, len(rows)), rows, strict=True):
            middle = np.full(len(orders), np.nan)  # phase of every column, so that all lie on the same branch
            for axes, order in zip(panels[0], orders, strict=True):
                kind = "" if signal.y is None else " (forward)" if order > 0 else " (backward)"
                only = f"\n{row[0].group}" if len(rows) > 1 and order == orders[0] else ""
                axes.set_title(f"{order}X{kind}{only}", loc="left", fontsize=9)
                axes.set_yscale("log")
            for item in row:
                branches = _draw_set(panels, item, signal, orders, middle)
                if fitted is not None:
                    _draw_fitted(panels, item, fitted, signal, orders, middle, branches)
            for upper, lower in panels.T:
                _plain_ticks(upper, lower)
            panels[0, 0].set_ylabel(f"{signal.title}\n[{display(1.0, signal.unit)[1]}, 0-peak]")
            panels[1, 0].set_ylabel("phase [deg]")
        for axes in grid[-1]:
            axes.set_xlabel("speed [rpm]")
        legend_below(made, grid[0, 0])
    return made


def _rows(compared: Comparison) -> list[list[_Set]]:
    """Return the sets of settings that share panels, row by row."""
    groups = compared.runs.groups
    if len(compared.diagrams) > 1:
        largest = sorted(groups, key=lambda label: -len(groups[label]))[:GROUPS]
        return [[_Set(group, MEASURED, compared.diagrams)] for group in largest]
    [(model, runs)] = compared.diagrams
    row = []
    for group, look in zip(groups, cycle(BESIDE), strict=False):
        behind = f", {group}" if group else ""
        measured = replace(look, label=f"{MEASURED.label}{behind}", size=4.5)
        row.append(_Set(group, measured, [(replace(look, label=f"{model.label}{behind}"), runs)]))
    return [row]


def _main_orders(runs: PredictedRuns, signal: Signal) -> np.ndarray:
    """Return the orders that stand out of the noise in some run, 1X, -1X, 2X, 3X first."""
    orders = runs.orders(signal)
    measured = [runs.measured(r, signal) for r in range(len(runs.speeds))]
    clear = np.any([one.size > STANDS_OUT * one.noise for one in measured], axis=0) & (orders != 0)
    largest = np.max([one.size for one in measured], axis=0)
    by_size = orders[clear][np.argsort(-largest[clear])].tolist()
    chosen = [*(k for k in MAIN if k in by_size), *(k for k in by_size if k not in MAIN)][:CURVES]
    return np.array(sorted(chosen, key=lambda k: (abs(k), -k)), int)


def _plain_ticks(upper: Axes, lower: Axes) -> None:
    """Label amplitudes with plain numbers where they span few decades, phases in steps of the protractor."""
    low, high = np.log10(upper.get_ylim())
    if high - low < 2.5:
        finest = (1.0, 2.0, 5.0) if high - low > 0.7 else tuple(np.arange(1.0, 10.0))
        upper.yaxis.set_major_locator(LogLocator(subs=finest))
        upper.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))
        upper.yaxis.set_minor_formatter(NullFormatter())
    span = float(np.ptp(lower.get_ylim()))
    lower.yaxis.set_major_locator(MultipleLocator(next((s for s in PHASE_STEPS if span / s <= 5), 180)))


def _draw_set(panels: np.ndarray, item: _Set, signal: Signal, orders: np.ndarray, middle: np.ndarray) -> list[Branch]:
    """Draw diagrams and runs with the same settings; return the phase of the last diagram, order by order."""
    members = sorted(item.runs.groups[item.group], key=lambda r: item.runs.speeds[r])
    branches: list[Branch] = []
    for look, runs in item.diagrams:
        group = item.group if item.group in runs.groups else runs.group_of(members[0])
        curve = speed_curve(runs, group, signal, orders)
        form: dict[str, Any] = {"ls": look.line, "color": look.colour, "label": look.label}
        if curve is None:
            form |= {"ls": "none", "marker": look.marker, "ms": 9, "mfc": "none"}
            columns = np.searchsorted(runs.orders(signal), orders)
            curve = runs.speeds[members], np.array([runs.prediction(r, signal)[columns] for r in members])
        branches = _draw_curve(panels, *curve, signal.unit, middle, form)
    _draw_points(panels, item.runs, members, signal, orders, branches, middle, item.measured)
    return branches


def _draw_curve(
    panels: np.ndarray, speeds: np.ndarray, values: np.ndarray, unit: str, middle: np.ndarray, form: dict[str, Any]
) -> list[Branch]:
    """Draw harmonics (n, orders) over speed near the phases ``middle``, which follow; return the phases."""
    branches = []
    for k, (upper, lower) in enumerate(panels.T):
        upper.plot(rpm(speeds), display(np.abs(values[:, k]), unit)[0], **form)
        angle = _continuous(values[:, k], middle[k])
        if np.isfinite(angle).any():
            middle[k] = np.nanmedian(angle)
        lower.plot(rpm(speeds), angle, **form)
        branches.append((speeds, angle))
    return branches


def _continuous(values: np.ndarray, middle: float) -> np.ndarray:
    """Return a phase [deg] without jumps, over gaps too, its median near another, or in -180..180 without one."""
    angle = np.full(len(values), np.nan)
    there = np.isfinite(values)
    if there.any():
        some = np.degrees(np.unwrap(np.angle(values[there])))
        angle[there] = some - 360 * np.round((np.median(some) - (0.0 if np.isnan(middle) else middle)) / 360)
    return angle


def _draw_points(
    panels: np.ndarray,
    runs: PredictedRuns,
    members: Sequence[int],
    signal: Signal,
    orders: np.ndarray,
    branches: Sequence[Branch],
    middle: np.ndarray,
    look: Look,
    **more: Any,
) -> None:
    """Draw measured amplitudes and phases with 90 % intervals, phases on the branch of a diagram."""
    measured, at = [runs.measured(r, signal) for r in members], runs.speeds[list(members)]
    form: dict[str, Any] = {"elinewidth": 1.0, "capsize": 2.5, "zorder": 5} | more
    form |= {"fmt": look.marker, "ms": look.size, "color": look.colour, "label": look.label}
    for k, column in enumerate(np.searchsorted(runs.orders(signal), orders)):
        upper, lower = panels[:, k]
        value = np.array([one.value[column] for one in measured])
        amplitude_std, std = (
            np.array([part[column] for part in parts])
            for parts in zip(*((one.amplitude_std, one.phase_std) for one in measured), strict=True)
        )
        size, bar = (display(part, signal.unit)[0] for part in (np.abs(value), Z90 * amplitude_std))
        upper.errorbar(rpm(at), size, [np.minimum(bar, size * (1 - 1e-6)), bar], **form)
        speeds, angle = branches[k]
        there = np.isfinite(angle)
        near = np.interp(at, speeds[there], angle[there]) if there.any() else np.nan_to_num(middle[k])
        phase = np.degrees(np.angle(value))
        phase += 360 * np.round((near - phase) / 360)
        sure = std < 1.0
        lower.errorbar(rpm(at)[sure], phase[sure], np.degrees(Z90 * std[sure]), **form)


def _draw_fitted(
    panels: np.ndarray,
    item: _Set,
    fitted: Comparison,
    signal: Signal,
    orders: np.ndarray,
    middle: np.ndarray,
    branches: Sequence[Branch],
) -> None:
    """Draw the fitted runs that have the settings of some others, and thinly the diagrams beyond those."""
    one, other, every = item.runs.experiment, fitted.runs.experiment, fitted.runs.orders(signal)
    if signal.x not in other.predicted or one.p.shape[1] != other.p.shape[1] or not set(orders) <= set(every):
        return
    still, p = ~item.runs.follows_speed, one.p[item.runs.groups[item.group][0]]
    members = [r for r, row in enumerate(other.p) if np.array_equal(row[still], p[still])]
    if not members:
        return
    for look, runs in fitted.diagrams:
        curve = speed_curve(runs, runs.group_of(members[0]), signal, orders)
        if curve is not None:
            thin = {"color": look.colour, "ls": look.line, "lw": 0.8, "zorder": 1}
            _draw_curve(panels, *curve, signal.unit, middle.copy(), thin)
    form = {"mfc": "white", "capsize": 0, "zorder": 4}
    _draw_points(panels, fitted.runs, members, signal, orders, branches, middle, FITTED, **form)
