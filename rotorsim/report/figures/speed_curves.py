"""Amplitude and phase over speed: runs of a turning shaft with error bars, diagrams as lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

from rotorsim.criteria import Z90
from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.comparison.harmonics import Comparison, PredictedRuns, Signal
from rotorsim.report.comparison.speed_curves import meets, speed_curve, speed_range
from rotorsim.report.style import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    RED,
    SHOWN_HARMONIC,
    Look,
    display,
    figure,
    legend_below,
    styled,
)
from rotorsim.report.text.table import rpm

FIRST_ORDERS = (1, -1, 2, 3, -2, -3)  # orders that come first
CURVES, GROUPS = 4, 2  # orders, and sets of settings with panels of their own
PHASE_STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45, 90)
MEASURED = Look("measured, 90 % interval", INK, "D", size=4.0)
FITTED = Look("measured, fitted runs", "#8a8a8a", "D", size=3.2)
NOT_BESIDE_CURVES = (
    Look("", BLUE, "o", "-"),
    Look("", RED, "s", "--"),
    Look("", GREEN, "^", "-."),
    Look("", PURPLE, "D", ":"),
    Look("", ORANGE, "v", "-"),
    Look("", INK, "P", "--"),
)
Curve = tuple[np.ndarray, np.ndarray]  # speeds (n,) [rad/s], and harmonics (n, orders) or a phase (n,) [deg]
NOWHERE: Curve = (np.zeros(1), np.zeros(1))


@dataclass(frozen=True)
class _Set:
    """Runs with the same settings, and the diagrams beside them."""

    group: str
    measured: Look
    diagrams: Sequence[tuple[Look, PredictedRuns]]

    @property
    def runs(self) -> PredictedRuns:
        return self.diagrams[-1][1]


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Fitted runs with the settings of a set of others; diagrams: beside all of them, by their labels."""

    diagrams: Mapping[str, PredictedRuns]
    members: Sequence[int]

    @property
    def runs(self) -> PredictedRuns:
        return [*self.diagrams.values()][-1]

    @property
    def reach(self) -> np.ndarray | None:
        """The lowest and the highest speed (2,) [rad/s]."""
        return speed_range(self.runs, self.runs.group_of(self.members[0]))

    def meet(self, label: str, panels: _Panels, curve: Curve) -> bool:
        """Return whether a curve goes through the motion that its diagram has in these runs."""
        own = self.diagrams.get(label)
        return own is not None and meets(own, self.members, panels.signal, panels.orders, *curve)


@dataclass(frozen=True, eq=False)
class _Panels:
    """Amplitude above phase for each order, (2, orders); branches: the phase drawn last, on which all others lie."""

    grid: np.ndarray
    signal: Signal
    orders: np.ndarray
    branches: list[Curve]


@styled()
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
    title = f"Main harmonics of {signal.title} over speed, {compared.of}"
    made = figure(0.8 + 3.2 * max(len(orders), 2), 1.2 + 4.2 * len(rows), title)
    heights = (1.5, 1.0) * len(rows)
    grid = made.subplots(2 * len(rows), len(orders), squeeze=False, sharex=True, height_ratios=heights)
    for half, row in zip(np.split(grid, len(rows)), rows, strict=True):
        panels = _Panels(half, signal, orders, [NOWHERE] * len(orders))
        for axes, order in zip(half[0], orders, strict=True):
            kind = "" if signal.y is None else " (forward)" if order > 0 else " (backward)"
            only = f"\n{row[0].group}" if len(rows) > 1 and order == orders[0] else ""
            axes.set_title(f"{order}X{kind}{only}", loc="left", fontsize=9)
            axes.set_yscale("log")
        for item in row:
            _draw_set(panels, item, None if fitted is None else _of_set(fitted, item, signal, orders))
        for upper, lower in half.T:
            _plain_ticks(upper, lower)
        half[0, 0].set_ylabel(f"{signal.title}\n[{of_amplitude(display(1.0, signal.unit)[1])}]")
        half[1, 0].set_ylabel("phase [deg]")
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
    for group, look in zip(groups, cycle(NOT_BESIDE_CURVES), strict=False):
        behind = f", {group}" if group else ""
        measured = replace(look, label=f"{MEASURED.label}{behind}", size=4.5)
        row.append(_Set(group, measured, [(replace(look, label=f"{model.label}{behind}"), runs)]))
    return [row]


def _main_orders(runs: PredictedRuns, signal: Signal) -> np.ndarray:
    """Return the orders that stand out of the noise in some run, 1X, -1X, 2X, 3X first."""
    orders = runs.orders(signal)
    measured = [runs.measured(r, signal) for r in range(len(runs.speeds))]
    clear = np.any([one.size > SHOWN_HARMONIC * one.noise for one in measured], axis=0) & (orders != 0)
    largest = np.max([one.size for one in measured], axis=0)
    by_size = orders[clear][np.argsort(-largest[clear])].tolist()
    chosen = [*(k for k in FIRST_ORDERS if k in by_size), *(k for k in by_size if k not in FIRST_ORDERS)][:CURVES]
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


def _of_set(fitted: Comparison, item: _Set, signal: Signal, orders: np.ndarray) -> _Fitted | None:
    """Return the fitted runs that have the settings of some others; None without any."""
    one, other = item.runs.experiment, fitted.runs.experiment
    if signal.x not in other.predicted or one.p.shape[1] != other.p.shape[1]:
        return None
    still, p = ~item.runs.follows_speed, one.p[item.runs.groups[item.group][0]]
    members = [r for r, row in enumerate(other.p) if np.array_equal(row[still], p[still])]
    if not members or not set(orders) <= set(fitted.runs.orders(signal)):
        return None
    return _Fitted({look.label: runs for look, runs in fitted.diagrams}, members)


def _draw_set(panels: _Panels, item: _Set, fitted: _Fitted | None) -> None:
    """Draw diagrams and runs with the same settings; thinly, where fitted ones reach further, and those."""
    members = sorted(item.runs.groups[item.group], key=lambda r: item.runs.speeds[r])
    for look, runs in item.diagrams:
        group = item.group if item.group in runs.groups else runs.group_of(members[0])
        curve = speed_curve(runs, group, panels.signal, panels.orders, None if fitted is None else fitted.reach)
        form: dict[str, Any] = {"ls": look.line, "color": look.colour, "label": look.label}
        if curve is None:
            form |= {"ls": "none", "marker": look.marker, "ms": 9, "mfc": "none"}
            columns = np.searchsorted(runs.orders(panels.signal), panels.orders)
            curve = runs.speeds[members], np.array([runs.prediction(r, panels.signal)[columns] for r in members])
        elif fitted is not None:
            if fitted.meet(look.label, panels, curve):
                _draw_curve(panels, curve, {"color": look.colour, "ls": look.line, "lw": 0.8, "zorder": 1})
            curve = _within(curve, speed_range(runs, group))
        panels.branches[:] = _draw_curve(panels, curve, form)
    _draw_points(panels, item.runs, members, item.measured)
    if fitted is not None:
        _draw_points(panels, fitted.runs, fitted.members, FITTED, mfc="white", capsize=0, zorder=4)


def _within(curve: Curve, ends: np.ndarray | None) -> Curve:
    """Return the part of a curve between two speeds."""
    if ends is None:
        return curve
    inside = (curve[0] >= ends.min()) & (curve[0] <= ends.max())
    return curve[0][inside], curve[1][inside]


def _draw_curve(panels: _Panels, curve: Curve, form: dict[str, Any]) -> list[Curve]:
    """Draw harmonics over speed; return their phases, those drawn before where there are none."""
    branches, (speeds, values) = [], curve
    for (upper, lower), branch, own in zip(panels.grid.T, panels.branches, values.T, strict=True):
        angle = _continuous(own, float(np.nanmedian(branch[1])))
        upper.plot(rpm(speeds), display(from_peak(np.abs(own)), panels.signal.unit)[0], **form)
        lower.plot(rpm(speeds), angle, **form)
        branches.append((speeds, angle) if np.isfinite(angle).any() else branch)
    return branches


def _continuous(values: np.ndarray, middle: float) -> np.ndarray:
    """Return a phase [deg] without jumps, over gaps too, its median within half a turn of another."""
    angle, there = np.full(len(values), np.nan), np.isfinite(values)
    angle[there] = np.degrees(np.unwrap(np.angle(values[there])))
    return angle - 360 * np.round((np.median(angle[there]) - middle) / 360) if there.any() else angle


def _draw_points(panels: _Panels, runs: PredictedRuns, members: Sequence[int], look: Look, **more: Any) -> None:
    """Draw measured amplitudes and phases with 90 % intervals, phases on the branch of a diagram."""
    measured, at = [runs.measured(r, panels.signal) for r in members], runs.speeds[list(members)]
    rows = [(one.value, one.amplitude_std, one.phase_std) for one in measured]
    values, size_stds, phase_stds = (np.array(part) for part in zip(*rows, strict=True))
    form: dict[str, Any] = {"elinewidth": 1.0, "capsize": 2.5, "zorder": 5} | more
    form |= {"fmt": look.marker, "ms": look.size, "color": look.colour, "label": look.label}
    columns = np.searchsorted(runs.orders(panels.signal), panels.orders)
    for (upper, lower), (speeds, angle), column in zip(panels.grid.T, panels.branches, columns, strict=True):
        value, std, there = values[:, column], phase_stds[:, column], np.isfinite(angle)
        size, bar = (
            display(from_peak(part), panels.signal.unit)[0] for part in (np.abs(value), Z90 * size_stds[:, column])
        )
        upper.errorbar(rpm(at), size, [np.minimum(bar, size * (1 - 1e-6)), bar], **form)
        phase, near = np.degrees(np.angle(value)), np.interp(at, speeds[there], angle[there])
        phase += 360 * np.round((near - phase) / 360)
        sure = std < 1.0
        lower.errorbar(rpm(at)[sure], phase[sure], np.degrees(Z90 * std[sure]), **form)
