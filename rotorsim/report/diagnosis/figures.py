"""Figures of a diagnosis: spectra, orbits and speed curves, before and after.

Amplitudes are 0-peak. Before is vermilion with squares, after blue with circles, measured black: colours of Okabe & Ito
that colour-blind readers tell apart, and marks that differ as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

from rotorsim.identification.profile import Z90
from rotorsim.report.diagnosis.comparison import Pair
from rotorsim.report.identification.comparison import Comparison, Signal
from rotorsim.report.identification.figures import PHASE_STEPS
from rotorsim.report.style import BLUE, INK, RED, display, figure, order_axis, rpm, styled

__all__ = ["LOOK", "STANDS_OUT", "legend", "orbits_figure", "spectra_figure", "speed_curves_figure", "wide_sheet"]

LOOK: dict[str, dict[str, Any]] = {
    "before": {"color": RED, "marker": "s", "ls": "--", "ms": 8.5},
    "after": {"color": BLUE, "marker": "o", "ls": "-", "ms": 7.0},
    "model": {"color": BLUE, "marker": "o", "ls": "-", "ms": 7.0},
}
NOISE_COLOUR = "#e4e4e4"
MAIN = (1, -1, 2, 3, -2, -3)  # orders that come first in speed curves
RUNS, CURVES, GROUPS = 3, 4, 2
STANDS_OUT = 2.0  # times the noise level
RAW = 3000  # samples shown in an orbit
ARROW = (0.110, 0.125)  # of a turn: from where to where the arrow of an orbit points


def wide_sheet(width: float, height: float, title: str) -> Figure:
    """Return an empty figure whose title is folded to its width."""
    return figure(width, height, "\n".join(wrap(title, int(9.5 * width))))


def legend(made: Figure, axes: Axes) -> None:
    """Put the legend of some axes below the whole figure, every entry once."""
    handles, labels = axes.get_legend_handles_labels()
    kept = dict(zip(labels, handles, strict=True))
    made.legend(
        list(kept.values()), list(kept), loc="outside lower center", ncols=min(len(kept), 6 if len(kept) != 7 else 4)
    )


# -- spectra -----------------------------------------------------------------------------------------------------------


def spectra_figure(pair: Pair, count: int = RUNS) -> Figure:
    """Return full spectra of some runs: measured with 90 % intervals, and both diagrams."""
    signals, runs = pair.telling[:2], pair.any.chosen(count)
    with styled():
        made = wide_sheet(
            5.6 * len(signals) + 0.5, 1.5 + 2.1 * len(runs), f"Full spectra of {pair.runs}, amplitude 0-peak"
        )
        grid = made.subplots(len(runs), len(signals), squeeze=False, sharex="col", sharey="col")
        for column, signal in enumerate(signals):
            low, high = _order_range(pair, signal, runs)
            for row, r in enumerate(runs):
                axes = grid[row, column]
                _draw_spectrum(axes, pair, r, signal)
                axes.set_title(f"{signal.title}, {pair.any.title(r)}", loc="left", fontsize=8.5)
                axes.set_ylabel(f"[{display(1.0, signal.unit)[1]}]")
                order_axis(axes, low, high)
            _heights(grid[0, column], pair, signal, runs, (low, high))
            grid[-1, column].set_xlabel("order of running speed" + (" (negative: backward)" if signal.y else ""))
        legend(made, grid[0, 0])
    return made


def _order_range(pair: Pair, signal: Signal, runs: Sequence[int]) -> tuple[int, int]:
    """Return the lowest and highest order that stands out of the noise in some run, and one more."""
    seen = [0, 3, -3 if signal.y else 0]
    orders = pair.any.orders(signal)
    for r in runs:
        measured = pair.any.measured(r, signal)
        size = np.abs(measured.value)
        for _, compared in pair.models:
            size = np.maximum(size, np.nan_to_num(np.abs(compared.model(r, signal))))
        seen += orders[size > STANDS_OUT * measured.noise].tolist()
        beside = pair.any.lines(r, signal)
        if beside is not None:
            clear = np.abs(beside[0].value) > STANDS_OUT * beside[0].noise
            seen += [round(place) for place in beside[0].orders[clear].tolist()]
    low, high = max(min(seen) - 1, int(orders.min())), min(max(seen) + 1, int(orders.max()))
    return (low if signal.y else 0), high


def _draw_spectrum(axes: Axes, pair: Pair, r: int, signal: Signal) -> None:
    measured = pair.any.measured(r, signal)
    orders = measured.orders
    size, std, noise = (
        display(part, signal.unit)[0] for part in (np.abs(measured.value), measured.amplitude_std, measured.noise)
    )
    axes.set_yscale("log")
    axes.stairs(
        noise,
        np.append(orders - 0.5, orders[-1] + 0.5),
        baseline=1e-300,
        fill=True,
        color=NOISE_COLOUR,
        label="noise alone (95 %)",
        zorder=0,
    )
    clear = size > noise
    bars = np.array([np.minimum(Z90 * std, size * (1 - 1e-6)), Z90 * std])
    axes.vlines(orders[clear], 1e-300, size[clear], color="#bdbdbd", lw=1.0, zorder=1)
    axes.plot(orders[~clear], size[~clear], ".", ms=4, color="#a0a0a0", zorder=2)
    axes.errorbar(
        orders[clear],
        size[clear],
        bars[:, clear],
        fmt="D",
        ms=3.2,
        color=INK,
        elinewidth=1.0,
        capsize=2.0,
        label="measured, 90 % interval",
        zorder=5,
    )
    for name, compared in pair.models:
        look, predicted = LOOK[name], compared.model(r, signal)
        own = compared.measured(r, signal).value - predicted  # readings, or what went into their converter
        value, left = (display(np.abs(part), signal.unit)[0] for part in (predicted, own))
        axes.plot(
            orders,
            value,
            look["marker"],
            ms=look["ms"],
            mfc="none",
            mec=look["color"],
            mew=1.3,
            label=pair.labels[name],
            zorder=4,
        )
        axes.plot(
            orders, left, "x", ms=4.5, color=look["color"], mew=1.1, label=f"left over, {pair.labels[name]}", zorder=3
        )
    _draw_lines(axes, pair, r, signal)
    axes.grid(axis="x", visible=False)


def _draw_lines(axes: Axes, pair: Pair, r: int, signal: Signal) -> None:
    """Draw lines beside the harmonics that stand out of the noise: smaller marks, and what each diagram says."""
    for name, compared in pair.models:
        found = compared.lines(r, signal)
        if found is None:
            continue
        measured, model = found
        clear = np.abs(measured.value) > measured.noise
        at, look = measured.orders[clear], LOOK[name]
        size, std, value, left = (
            display(part[clear], signal.unit)[0]
            for part in (np.abs(measured.value), measured.amplitude_std, np.abs(model), np.abs(measured.value - model))
        )
        if compared is pair.any:
            axes.vlines(at, 1e-300, size, color="#d8d8d8", lw=0.8, zorder=1)
            axes.errorbar(
                at,
                size,
                np.array([np.minimum(Z90 * std, size * (1 - 1e-6)), Z90 * std]),
                fmt="d",
                ms=2.6,
                color=INK,
                elinewidth=0.8,
                label="measured at kX + nu",
                zorder=5,
            )
        axes.plot(at, value, look["marker"], ms=0.65 * look["ms"], mfc="none", mec=look["color"], mew=0.9, zorder=4)
        axes.plot(at, left, "x", ms=0.65 * look["ms"], color=look["color"], mew=0.8, zorder=3)


def _heights(axes: Axes, pair: Pair, signal: Signal, runs: Sequence[int], orders: tuple[int, int]) -> None:
    tops, noises = [], []
    for r in runs:
        measured = pair.any.measured(r, signal)
        inside = (measured.orders >= orders[0]) & (measured.orders <= orders[1])
        tops.append(np.abs(measured.value[inside]).max())
        tops += [np.nan_to_num(np.abs(one.model(r, signal)[inside])).max() for _, one in pair.models]
        noises.append(measured.noise[inside].min())
        beside = pair.any.lines(r, signal)
        tops += [] if beside is None else np.abs(beside[0].value).tolist()
    low, high = display(0.15 * min(noises), signal.unit)[0], display(3.0 * max(tops), signal.unit)[0]
    if high > 0:
        axes.set_ylim(max(float(low), 1e-7 * float(high)), float(high))


# -- orbits ------------------------------------------------------------------------------------------------------------


def orbits_figure(pair: Pair, count: int = RUNS) -> Figure | None:
    """Return orbits of some runs: samples, their synchronous part, and both diagrams; None without two axes."""
    signal = next((one for one in pair.telling if one.y is not None), None)
    if signal is None:
        return None
    runs = pair.any.chosen(count)
    with styled():
        made = wide_sheet(3.7 * len(runs) + 0.6, 4.9, f"Orbits of {signal.title}, {pair.runs}")
        for k, r in enumerate(runs):
            axes = made.add_subplot(1, len(runs), k + 1)
            _draw_orbit(axes, pair, r, signal)
            axes.set_title(pair.any.title(r), loc="left", fontsize=8.5)
            unit = display(1.0, signal.unit)[1]
            axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
        legend(made, made.axes[0])
    return made


def _draw_orbit(axes: Axes, pair: Pair, r: int, signal: Signal) -> None:
    theta = np.linspace(0, 2 * np.pi, 721)
    raw = display(pair.any.raw(r, signal), signal.unit)[0][-RAW:]
    axes.plot(raw.real, raw.imag, ".", ms=2.5, color="#b5b5b5", label="samples", rasterized=True, zorder=1)
    measured = display(pair.any.orbit(r, signal, theta)[0], signal.unit)[0]
    axes.plot(measured.real, measured.imag, color=INK, lw=2.6, label="measured, synchronous", zorder=2)
    for name, compared in pair.models:
        look = LOOK[name]
        orbit = display(compared.orbit(r, signal, theta)[1], signal.unit)[0]
        axes.plot(
            orbit.real,
            orbit.imag,
            ls=(0, (5, 2)) if name == "before" else "-",
            color=look["color"],
            lw=1.4,
            label=pair.labels[name],
            zorder=3,
        )
        axes.plot(orbit[0].real, orbit[0].imag, look["marker"], ms=7, mfc="white", mec=look["color"], zorder=4)
    axes.plot(measured[0].real, measured[0].imag, "D", ms=4.5, color=INK, label="shaft angle zero", zorder=5)
    tail, head = (measured[int(part * len(measured))] for part in ARROW)
    look_arrow = {"arrowstyle": "-|>", "color": INK, "lw": 2.0, "mutation_scale": 16}
    axes.annotate("", (head.real, head.imag), (tail.real, tail.imag), arrowprops=look_arrow, zorder=5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)


# -- over speed --------------------------------------------------------------------------------------------------------


def speed_curves_figure(pair: Pair, fitted: Pair | None = None) -> Figure | None:
    """Return amplitude and phase of the main harmonics over speed: measured with bars, both diagrams as lines.

    fitted: the runs that took part in fitting, shown beside with small marks. None with fewer than two runs, or where
    nothing stands out of the noise.
    """
    signal = next((one for one in pair.telling if one.y is not None), pair.telling[0])
    orders = _main_orders(pair, signal)
    runs = pair.any.experiment.runs
    if len(runs) < 2 or not len(orders):
        return None
    groups = sorted(pair.any.groups, key=lambda label: -len(pair.any.groups[label]))[:GROUPS]
    with styled():
        title = f"Main harmonics of {signal.title} over speed, {pair.runs}, amplitude 0-peak"
        made = wide_sheet(0.8 + 3.2 * max(len(orders), 2), 1.2 + 4.2 * len(groups), title)
        grid = made.subplots(
            2 * len(groups), len(orders), squeeze=False, sharex=True, height_ratios=(1.5, 1.0) * len(groups)
        )
        for g, group in enumerate(groups):
            panels = grid[2 * g : 2 * g + 2]
            middle = _draw_group(panels, pair, signal, orders, group)
            if fitted is not None and pair.held:
                _draw_fitted(panels, pair, fitted, signal, orders, group, middle)
            for upper, lower in panels.T:
                _plain_ticks(upper, lower)
        for k in range(len(orders)):
            grid[-1, k].set_xlabel("speed [rpm]")
        legend(made, grid[0, 0])
    return made


def _main_orders(pair: Pair, signal: Signal) -> np.ndarray:
    """Return the orders that stand out of the noise in some run, 1X, -1X, 2X, 3X first."""
    orders = pair.any.orders(signal)
    clear, size = np.zeros(len(orders), bool), np.zeros(len(orders))
    for r in range(len(pair.any.experiment.runs)):
        measured = pair.any.measured(r, signal)
        value = np.abs(measured.value)
        clear |= value > STANDS_OUT * measured.noise
        size = np.maximum(size, value)
    wanted = [k for k in MAIN if k in orders[clear]]
    rest = [int(orders[j]) for j in np.argsort(-size) if clear[j] and orders[j] not in wanted and orders[j] != 0]
    chosen = [*wanted[:CURVES], *rest][:CURVES]
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


def _draw_group(grid: np.ndarray, pair: Pair, signal: Signal, orders: np.ndarray, group: str) -> np.ndarray:
    """Draw the runs of one set of settings; return the phase [rad] about which each order is drawn."""
    runs = sorted(pair.any.groups[group], key=lambda r: pair.any.experiment.fits[r].speed)
    at = np.array([pair.any.experiment.fits[r].speed for r in runs])
    columns = [int(np.flatnonzero(pair.any.orders(signal) == order)[0]) for order in orders]
    curves = [(name, *_curve(pair, compared, group, signal, orders, runs, columns)) for name, compared in pair.models]
    middle = np.zeros(len(orders))
    for k, order in enumerate(orders):
        upper, lower = grid[:, k]
        kind = "" if not signal.y else " (forward)" if order > 0 else " (backward)"
        upper.set_title(f"{order}X{kind}" + (f"\n{group}" if group and k == 0 else ""), loc="left", fontsize=9)
        upper.set_yscale("log")
        for number, (name, speeds, curve) in enumerate(curves):
            look = LOOK[name]
            alone = {"ls": "none", "marker": look["marker"], "mfc": "none"}
            form = {"ls": look["ls"]} if len(speeds) > len(runs) else alone
            upper.plot(
                rpm(speeds),
                display(np.abs(curve[:, k]), signal.unit)[0],
                color=look["color"],
                label=pair.labels[name],
                **form,
            )
            angle = _continuous(curve[:, k])
            if np.isfinite(angle).any():
                place = float(np.nanmedian(angle))
                turns = np.round((place - middle[k]) / (2 * np.pi)) if number else np.round(place / (2 * np.pi))
                angle = angle - 2 * np.pi * turns
                middle[k] = np.nanmedian(angle)
            lower.plot(rpm(speeds), np.degrees(angle), color=look["color"], **form)
        best = curves[-1][1], _continuous(curves[-1][2][:, k])
        _points(upper, lower, pair.any, runs, signal, columns[k], at, best, middle[k], "measured, 90 % interval")
    grid[0, 0].set_ylabel(f"{signal.title}\n[{display(1.0, signal.unit)[1]}]")
    grid[1, 0].set_ylabel("phase [deg]")
    return middle


def _points(
    upper: Axes,
    lower: Axes,
    compared: Comparison,
    runs: Sequence[int],
    signal: Signal,
    column: int,
    at: np.ndarray,
    curve: tuple[np.ndarray, np.ndarray],
    middle: float,
    label: str,
    small: bool = False,
) -> None:
    """Draw measured amplitudes and phases with intervals, phases on the branch of a curve (speeds, angle)."""
    measured = [compared.measured(r, signal) for r in runs]
    value = np.array([one.value[column] for one in measured])
    size, bars = (
        display(part, signal.unit)[0]
        for part in (np.abs(value), Z90 * np.array([one.amplitude_std[column] for one in measured]))
    )
    std = np.array([one.phase_std[column] for one in measured])
    form: dict[str, Any] = {"fmt": "D", "ms": 4.0, "color": INK, "elinewidth": 1.0, "capsize": 2.5, "zorder": 5}
    if small:
        form |= {"ms": 3.2, "color": "#8a8a8a", "mfc": "white", "capsize": 0, "zorder": 4}
    upper.errorbar(rpm(at), size, [np.minimum(bars, size * (1 - 1e-6)), bars], label=label, **form)
    speeds, angle = curve
    there = np.isfinite(angle)
    near = np.full(len(at), middle)
    if there.any():
        near = np.interp(at, speeds[there], angle[there])
        near = near - 2 * np.pi * np.round((np.median(angle[there]) - middle) / (2 * np.pi))
    phase = np.angle(value)
    phase = phase + 2 * np.pi * np.round((near - phase) / (2 * np.pi))
    sure = std < 1.0
    lower.errorbar(rpm(at)[sure], np.degrees(phase)[sure], np.degrees(Z90 * std[sure]), **form)


def _draw_fitted(
    grid: np.ndarray, pair: Pair, fitted: Pair, signal: Signal, orders: np.ndarray, group: str, middle: np.ndarray
) -> None:
    """Draw the fitted runs that have the settings of a group."""
    one, other = pair.any.experiment, fitted.any.experiment
    if signal.x not in other.predicted or one.p.shape[1] != other.p.shape[1]:
        return
    model = one.model
    still = model.parameter_vector({"speed": 1.0}) == model.parameter_vector({"speed": 2.0})
    p = one.p[pair.any.groups[group][0]]
    runs = [r for r, row in enumerate(other.p) if np.array_equal(row[still], p[still])]
    runs = sorted(runs, key=lambda r: other.fits[r].speed)
    every = fitted.any.orders(signal)
    if not runs:
        return
    at = np.array([other.fits[r].speed for r in runs])
    for name, compared in fitted.models:
        speeds, curve = fitted.curve(compared, compared.group_of(runs[0]), signal, orders)
        for k in range(len(orders) if len(speeds) else 0):  # beyond the held-out runs
            look = {"color": LOOK[name]["color"], "ls": LOOK[name]["ls"], "lw": 0.8, "zorder": 1}
            grid[0, k].plot(rpm(speeds), display(np.abs(curve[:, k]), signal.unit)[0], **look)
            angle = _continuous(curve[:, k])
            if np.isfinite(angle).any():
                angle = angle - 2 * np.pi * np.round((np.nanmedian(angle) - middle[k]) / (2 * np.pi))
                grid[1, k].plot(rpm(speeds), np.degrees(angle), **look)
    for k, order in enumerate(orders):
        if order in every:
            column = int(np.flatnonzero(every == order)[0])
            speeds, curve = _curve(pair, pair.any, group, signal, orders, pair.any.groups[group], [column])
            best = (speeds, _continuous(curve[:, k])) if curve.shape[1] > k else (at, np.full(len(at), np.nan))
            upper, lower = grid[:, k]
            label = "measured, fitted runs"
            _points(upper, lower, fitted.any, runs, signal, column, at, best, middle[k], label, small=True)


def _curve(
    pair: Pair,
    compared: Comparison,
    group: str,
    signal: Signal,
    orders: np.ndarray,
    runs: Sequence[int],
    columns: Sequence[int],
) -> tuple[np.ndarray, np.ndarray]:
    """Return speeds and harmonics of a diagram over speed, or at the runs alone where it has no curve."""
    label = group if group in compared.groups else compared.group_of(runs[0])
    speeds, values = pair.curve(compared, label, signal, orders)
    if len(speeds):
        return speeds, values
    at = np.array([compared.experiment.fits[r].speed for r in runs])
    return at, np.array([compared.model(r, signal)[list(columns)] for r in runs])


def _continuous(values: np.ndarray) -> np.ndarray:
    """Return the phase [rad] without jumps, over gaps too."""
    angle = np.full(len(values), np.nan)
    there = np.isfinite(values)
    angle[there] = np.unwrap(np.angle(values[there]))
    return angle
