"""Figures of an identification: parameters, correlation, full spectra, curves over speed, orbits.

Measured and predicted side by side; displacements in um, speeds in rpm, amplitudes 0-peak, bars and intervals 90 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

from rotorsim.identification.identification import Identification
from rotorsim.identification.profile import Z90
from rotorsim.recordings.recording import Recording
from rotorsim.report.figures.run import save_figure
from rotorsim.report.identification.comparison import Comparison, Signal, compare
from rotorsim.report.identification.parameters import correlation_figure, parameters_figure, sheet
from rotorsim.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, display, order_axis, rpm, styled

__all__ = [
    "correlation_figure",
    "identification_figures",
    "orbits_figure",
    "parameters_figure",
    "save_figures",
    "spectrum_figure",
    "speed_curve_figure",
]

RUNS = 4  # shown in spectra and orbits
HARMONICS = 4  # shown over speed
PHASE_STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45, 90)
RAW = 4000  # samples shown in an orbit
STANDS_OUT = 2.0  # times the noise level
NOISE_COLOUR = "#e4e4e4"
GROUPS = (
    (BLUE, "o", "-"),
    (RED, "s", "--"),
    (GREEN, "^", "-."),
    (PURPLE, "D", ":"),
    (ORANGE, "v", "-"),
    (INK, "P", "--"),
)


def identification_figures(found: Identification, recording: Recording) -> dict[str, Figure]:
    """Return the figures of an identification by name, those left out that have nothing to show."""
    compared = compare(found, recording)
    made = {
        "parameters": parameters_figure(found, recording),
        "correlation": correlation_figure(found, recording),
        "spectrum": spectrum_figure(compared),
        "speed_curve": speed_curve_figure(compared),
        "orbits": orbits_figure(compared),
    }
    return {name: one for name, one in made.items() if one is not None}


def save_figures(found: Identification, recording: Recording, folder: str | Path) -> list[Path]:
    """Write the figures of an identification into a folder as PNG; return the files."""
    files = []
    for name, made in identification_figures(found, recording).items():
        files.append(Path(folder) / f"{name}.png")
        save_figure(made, files[-1])
    return files


def spectrum_figure(compared: Comparison, count: int = RUNS) -> Figure | None:
    """Return full spectra, measured with error bars against the model, of up to ``count`` runs."""
    signals, runs = compared.signals[:3], compared.chosen(count)
    with styled():
        made = sheet(
            5.4 * len(signals) + 0.4, 1.3 + 1.95 * len(runs), compared.found, compared.recording, "full spectra"
        )
        grid = made.subplots(len(runs), len(signals), squeeze=False, sharex="col", sharey="col")
        for column, signal in enumerate(signals):
            low, high = _order_range(compared, signal, runs)
            for row, r in enumerate(runs):
                axes = grid[row, column]
                _draw_spectrum(axes, compared, r, signal)
                axes.set_title(compared.title(r), loc="left", fontsize=8.5)
                axes.set_ylabel(f"[{display(1.0, signal.unit)[1]}, 0-peak]")
                order_axis(axes, low, high)
            _spectrum_heights(list(grid[:, column]), compared, signal, runs, (low, high))
            grid[-1, column].set_xlabel("order of running speed" + (" (negative: backward)" if signal.y else ""))
            grid[0, column].annotate(
                signal.title,
                (0.0, 1.0),
                xycoords="axes fraction",
                xytext=(0, 20),
                textcoords="offset points",
                fontsize=10,
                fontweight="bold",
            )
        handles, labels = grid[0, 0].get_legend_handles_labels()
        made.legend(handles[::-1], labels[::-1], loc="outside lower center", ncols=len(labels))
    return made


def _order_range(compared: Comparison, signal: Signal, runs: Sequence[int]) -> tuple[int, int]:
    """Return the lowest and highest order that stands out of the noise in some run, and one more."""
    seen = [0, 3, -3 if signal.y else 0]
    for r in runs:
        measured, model = compared.measured(r, signal), compared.model(r, signal)
        clear = np.maximum(np.abs(measured.value), np.abs(model)) > STANDS_OUT * measured.noise
        seen += measured.orders[clear].tolist()
    orders = compared.orders(signal)
    low, high = max(min(seen) - 1, int(orders.min())), min(max(seen) + 1, int(orders.max()))
    return (low if signal.y else 0), high


def _draw_spectrum(axes: Axes, compared: Comparison, r: int, signal: Signal) -> None:
    measured, model = compared.measured(r, signal), np.abs(compared.model(r, signal))
    size, std, noise = (
        display(part, signal.unit)[0] for part in (np.abs(measured.value), measured.amplitude_std, measured.noise)
    )
    model = display(model, signal.unit)[0]
    orders = measured.orders
    clear = (size > noise) | (model > 0.3 * noise)
    edges = np.append(orders - 0.5, orders[-1] + 0.5)
    axes.set_yscale("log")
    axes.stairs(
        noise, edges, baseline=1e-300, fill=True, color=NOISE_COLOUR, label="noise alone (95 % of harmonics)", zorder=0
    )
    for side, colour in ((orders < 0, ORANGE), (orders == 0, GREY), (orders > 0, BLUE)):
        axes.vlines(orders[side & clear], 1e-300, size[side & clear], color=colour, lw=1.2, alpha=0.6)
    bars = np.array([np.minimum(Z90 * std, size * (1 - 1e-6)), Z90 * std])[:, clear]
    axes.plot(orders[~clear], size[~clear], "o", ms=3.0, color="#a9a9a9", zorder=2)
    axes.errorbar(
        orders[clear],
        size[clear],
        bars,
        fmt="o",
        ms=3.6,
        color=INK,
        elinewidth=1.0,
        capsize=2.0,
        capthick=1.0,
        label="measured, 90 % interval",
        zorder=3,
    )
    axes.plot(orders, model, "o", ms=8, mfc="none", mec=RED, mew=1.2, label="model", zorder=4)
    axes.grid(axis="x", visible=False)


def _spectrum_heights(
    column: list[Axes], compared: Comparison, signal: Signal, runs: Sequence[int], orders: tuple[int, int]
) -> None:
    tops, noises = [], []
    for r in runs:
        measured = compared.measured(r, signal)
        inside = (measured.orders >= orders[0]) & (measured.orders <= orders[1])
        tops.append(np.abs(measured.value[inside]).max())
        noises.append(measured.noise[inside].min())
    low, high = display(0.15 * min(noises), signal.unit)[0], display(3.0 * max(tops), signal.unit)[0]
    if high > 0:
        column[0].set_ylim(max(float(low), 1e-7 * float(high)), float(high))


def main_orders(compared: Comparison, signal: Signal, count: int = HARMONICS) -> np.ndarray:
    """Return the signed orders that are largest in some run, and out of the noise; those of the mean if it settles."""
    orders = compared.orders(signal)
    size = np.zeros(len(orders))
    for r in range(len(compared.experiment.runs)):
        measured = compared.measured(r, signal)
        clear = np.abs(measured.value) > STANDS_OUT * measured.noise
        size = np.maximum(size, np.where(clear, np.abs(measured.value), 0))
    if compared.has_slow_states:
        size[orders == 0] = 0.0
    best = np.argsort(-size, kind="stable")[:count]
    chosen = orders[best[size[best] > 0]]
    return np.array(sorted(chosen, key=lambda k: (abs(k), -k)), int)


def speed_curve_figure(compared: Comparison, signal: Signal | None = None) -> Figure | None:
    """Return amplitude and phase of the main harmonics over speed: measured with error bars, the model as a line.

    None when fewer than two runs, or no harmonic that stands out of the noise.
    """
    signal = compared.signals[0] if signal is None else signal
    orders = main_orders(compared, signal)
    if len(compared.experiment.runs) < 2 or not len(orders):
        return None
    with styled():
        made = sheet(
            0.8 + 3.1 * max(len(orders), 2), 5.4, compared.found, compared.recording, "main harmonics over speed"
        )
        grid = made.subplots(2, len(orders), squeeze=False, sharex=True, height_ratios=(1.5, 1.0))
        for k, order in enumerate(orders):
            name = (
                "mean"
                if order == 0
                else f"{order}X" + ("" if not signal.y else " (forward)" if order > 0 else " (backward)")
            )
            grid[0, k].set_title(name, loc="left")
            grid[0, k].set_yscale("log")
            grid[1, k].set_xlabel("speed [rpm]")
        grid[0, 0].set_ylabel(f"{signal.title}\n[{display(1.0, signal.unit)[1]}, 0-peak]")
        grid[1, 0].set_ylabel("phase [deg]")
        middle = np.full(len(orders), np.nan)  # phase of every column, so that all groups are on the same branch
        for k, group in enumerate(compared.groups):
            _draw_group(grid, compared, signal, orders, group, GROUPS[k % len(GROUPS)], middle)
        for upper, lower in grid.T:
            _logarithmic_ticks(upper)
            span = float(np.ptp(lower.get_ylim()))
            lower.yaxis.set_major_locator(MultipleLocator(next((s for s in PHASE_STEPS if span / s <= 5), 180)))
        handles, labels = grid[0, 0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    return made


def _logarithmic_ticks(axes: Axes) -> None:
    """Label 1, 2, 5 of every decade with plain numbers, over many decades only powers of ten."""
    low, high = np.log10(axes.get_ylim())
    if high - low < 2.5:
        finest = (1.0, 2.0, 5.0) if high - low > 0.7 else tuple(np.arange(1.0, 10.0))
        axes.yaxis.set_major_locator(LogLocator(subs=finest))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_group(
    grid: np.ndarray,
    compared: Comparison,
    signal: Signal,
    orders: np.ndarray,
    group: str,
    style: tuple[str, str, str],
    middle: np.ndarray,
) -> None:
    """Draw the runs of one group, and the model: as a line, or at their speeds where it takes measured inputs."""
    colour, mark, line = style
    runs = sorted(compared.groups[group], key=lambda r: compared.experiment.fits[r].speed)
    at = np.array([compared.experiment.fits[r].speed for r in runs])
    measured = [compared.measured(r, signal) for r in runs]
    columns = [int(np.flatnonzero(compared.orders(signal) == order)[0]) for order in orders]
    speeds, curve = compared.curve(group, signal, orders)
    form: dict[str, Any] = {"ls": line}
    if not len(speeds):
        speeds, curve = at, np.array([compared.model(r, signal)[columns] for r in runs])
        form = {"ls": "none", "marker": mark, "ms": 9, "mfc": "none"}
    behind = f", {group}" if group else ""
    kept = {"fmt": mark, "ms": 4.5, "color": colour, "elinewidth": 1.0, "capsize": 2.5, "zorder": 3}
    for k, column in enumerate(columns):
        angle = _unwrapped(curve[:, k], middle[k])
        middle[k] = np.nanmedian(angle) if np.isfinite(angle).any() else middle[k]
        for axes, height in zip(grid[:, k], (display(np.abs(curve[:, k]), signal.unit)[0], angle), strict=True):
            axes.plot(rpm(speeds), height, color=colour, label=f"model{behind}", **form)
        value = np.array([one.value[column] for one in measured])
        size, bar = (
            display(part, signal.unit)[0]
            for part in (np.abs(value), Z90 * np.array([one.amplitude_std[column] for one in measured]))
        )
        grid[0, k].errorbar(
            rpm(at), size, [np.minimum(bar, size * (1 - 1e-6)), bar], label=f"measured, 90 %{behind}", **kept
        )
        std = np.array([one.phase_std[column] for one in measured])
        near = np.interp(at, speeds, np.nan_to_num(angle))
        phase = np.degrees(np.angle(value))
        phase += 360 * np.round((near - phase) / 360)
        sure = std < 1.0
        grid[1, k].errorbar(rpm(at)[sure], phase[sure], np.degrees(Z90 * std[sure]), **kept)


def _unwrapped(values: np.ndarray, middle: float) -> np.ndarray:
    """Return a continuous phase [deg], over gaps too, whose median is near another, or in -180..180 without one."""
    angle = np.full(len(values), np.nan)
    there = np.isfinite(values)
    if there.any():
        some = np.degrees(np.unwrap(np.angle(values[there])))
        angle[there] = some - 360 * np.round((np.median(some) - (0.0 if np.isnan(middle) else middle)) / 360)
    return angle


def orbits_figure(compared: Comparison, signal: Signal | None = None, count: int = RUNS) -> Figure | None:
    """Return measured and predicted orbits of a two-axis signal; None without one."""
    pairs = [one for one in compared.signals if one.y is not None]
    if signal is None and not pairs:
        return None
    signal = signal or pairs[0]
    runs = compared.chosen(count)
    columns = 2 if len(runs) > 1 else 1
    rows = -(-len(runs) // columns)
    with styled():
        made = sheet(
            4.4 * columns + 0.4, 1.2 + 4.0 * rows, compared.found, compared.recording, f"orbits of {signal.title}"
        )
        for k, r in enumerate(runs):
            axes = made.add_subplot(rows, columns, k + 1)
            _draw_orbit(axes, compared, r, signal)
            axes.set_title(compared.title(r), loc="left", fontsize=8.5)
            unit = display(1.0, signal.unit)[1]
            axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
        handles, labels = made.axes[0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return made


def _draw_orbit(axes: Axes, compared: Comparison, r: int, signal: Signal) -> None:
    theta = np.linspace(0, 2 * np.pi, 721)
    measured, model = (display(part, signal.unit)[0] for part in compared.orbit(r, signal, theta))
    raw = display(compared.raw(r, signal), signal.unit)[0][-RAW:]
    axes.plot(raw.real, raw.imag, ".", ms=1.5, color="#c4c4c4", label="samples", rasterized=True, zorder=1)
    axes.plot(measured.real, measured.imag, color=BLUE, lw=2.2, label="measured, synchronous")
    axes.plot(model.real, model.imag, "--", color=RED, lw=1.4, label="model")
    axes.plot(measured[0].real, measured[0].imag, "o", ms=6, color=BLUE, label="shaft angle zero", zorder=4)
    axes.plot(model[0].real, model[0].imag, "o", ms=9, mfc="none", mec=RED, zorder=4)
    step = np.diff(measured) * np.sign(compared.experiment.fits[r].speed)
    at = 90 + int(np.argmax(np.abs(step[90:-90])))  # where it is fastest, away from shaft angle zero
    tail, tip = measured[at] - step[at] / 2, measured[at] + step[at] / 2
    axes.annotate(
        "",
        (tip.real, tip.imag),
        (tail.real, tail.imag),
        zorder=5,
        arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0, "mutation_scale": 24, "shrinkA": 0, "shrinkB": 0},
    )
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
