"""Figures of an identification: parameters, correlation, full spectra, curves over speed, orbits.

Measured and predicted side by side; displacements in um, speeds in rpm, amplitudes 0-peak, bars and intervals 90 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from rotorsim.identify.identification import Identification, Identified
from rotorsim.identify.profile import Z90
from rotorsim.recordings.recording import Recording
from rotorsim.report.comparison import Comparison, Signal, compare
from rotorsim.report.figures import save_figure
from rotorsim.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, display, figure, rpm, styled

__all__ = [
    "correlation_figure", "identification_figures", "orbits_figure", "parameters_figure", "save_figures",
    "spectrum_figure", "speed_curve_figure",
]  # fmt: skip

RUNS = 4  # shown in spectra and orbits
HARMONICS = 4  # shown over speed
RAW = 4000  # samples shown in an orbit
STANDS_OUT = 1.5  # times the noise level
NOISE_COLOUR = "#e4e4e4"
GROUPS = ((BLUE, "o", "-"), (RED, "s", "--"), (GREEN, "^", "-."), (PURPLE, "D", ":"), (ORANGE, "v", "-"), (INK, "P", "--"))


def identification_figures(found: Identification, recording: Recording) -> dict[str, Figure]:
    """Return the figures of an identification by name, those left out that have nothing to show."""
    compared = compare(found, recording)
    made = {
        "parameters": parameters_figure(found),
        "correlation": correlation_figure(found),
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


def _title(found: Identification, recording: Recording | None = None) -> str:
    title = found.diagram.name + (f" identified from {recording.name}" if recording is not None else "")
    if not found.adequate:
        title += f"\nthe model does not explain the data: residual variance {found.excess:.3g} times that of the noise"
    return title


# parameters -------------------------------------------------------------------------------------------------------


def _shown(unit: str) -> tuple[float, str]:
    """Return factor and unit in which a parameter is written."""
    return {"m": (1e6, "um"), "rad": (180 / math.pi, "deg")}.get(unit, (1.0, "" if unit == "1" else unit))


def _number(item: Identified) -> str:
    """Return 'value +- half width unit', to two digits of the half width."""
    factor, unit = _shown(item.unit)
    value, low, high = (part * factor for part in (item.value, *item.interval90))
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return f"{value:.6g} {unit}".strip()
    up, down = high - value, value - low
    digits = 1 - math.floor(math.log10(max(up, down)))
    if abs(value) >= 1e7 or digits > 8:
        return f"{value:.6g} +- {max(up, down):.2g} {unit}".strip()

    def text(number: float) -> str:
        return f"{round(number, digits):.{max(digits, 0)}f}"

    spread = f"\u00b1 {text(max(up, down))}" if 0.8 < up / max(down, 1e-300) < 1.25 else f"+{text(up)} \u2212{text(down)}"
    return f"{text(value)} {spread} {unit}".strip()


def _scale(item: Identified) -> float:
    """Return what counts as 100 %: the value; for an angle one radian."""
    ends = [abs(end) for end in (item.value, *item.interval90) if math.isfinite(end)]
    return 1.0 if item.unit == "rad" else abs(item.value) or max(ends) or 1.0


def parameters_figure(found: Identification) -> Figure:
    """Return every parameter's 90 % interval and start value, relative to the identified value, with its number."""
    items, starts = list(found.parameters.values()), {item.name: item.value for item in found.free}
    ends, begins = [], []
    for item in items:
        ends.append([100 * (end - item.value) / _scale(item) for end in item.interval90])
        change = starts.get(item.name, math.nan) - item.value
        if item.unit == "rad":
            change = math.remainder(change, 2 * math.pi)
        begins.append(100 * change / _scale(item))
    precision = 100 * float(found.settings.get("precision", 0.05))
    sizes = np.abs([end for pair in ends for end in pair])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    linear = 10.0 ** np.clip(np.floor(np.log10(sizes.min(initial=precision))), -4, 0)
    reach = float(np.clip(np.nanmax(np.abs([*sizes, *begins, 2 * precision])), 10, 900)) * 1.5
    with styled():
        made = figure(9.0, 1.7 + 0.36 * len(items), _title(found))
        axes = made.add_subplot()
        axes.set_xscale("symlog", linthresh=linear, linscale=0.5)
        axes.axvspan(-precision, precision, color="#eaf3ec", zorder=0)
        axes.axvline(0, color=GREY, lw=0.8)
        for k, (item, (low, high), start) in enumerate(zip(items, ends, begins, strict=True)):
            colour = BLUE if item.verdict.identifiable else GREY
            low, high = (max(low, -2 * reach), min(high, 2 * reach)) if high > low else (0.0, 0.0)
            axes.plot([low, high], [k, k], color=colour, lw=2.0, marker="|", ms=7, mew=1.5)
            axes.plot(0, k, "o", ms=5, color=colour, zorder=3)
            if math.isfinite(start):
                outside = abs(start) > reach
                mark = (">" if start > 0 else "<") if outside else "|"
                at = math.copysign(0.97 * reach, start) if outside else start
                axes.plot(at, k, mark, ms=6 if outside else 11, mew=1.8, color=RED, zorder=4)
        _key_of_parameters(axes, items, precision)
        axes.set(xlabel="difference from the identified value [%] (angles: of one radian)", xlim=(-reach, reach),
                 ylim=(len(items) - 0.5, -0.5))  # fmt: skip
        _symlog_ticks(axes, linear, reach)
        axes.set_yticks(range(len(items)), [item.name for item in items])
        axes.grid(axis="y", visible=False)
        right = axes.twinx()
        right.set(ylim=axes.get_ylim())
        right.set_yticks(range(len(items)), [_number(item) for item in items])
        right.grid(visible=False)
        for side in (axes, right):
            side.tick_params(axis="y", length=0)
            for text, item in zip(side.get_yticklabels(), items, strict=True):
                text.set_color(INK if item.verdict.identifiable else GREY)
    return made


def _key_of_parameters(axes: Axes, items: Sequence[Identified], precision: float) -> None:
    axes.plot([], [], "o-", ms=5, lw=2.0, color=BLUE, label="identified, 90 % interval")
    if not all(item.verdict.identifiable for item in items):
        axes.plot([], [], "o-", ms=5, lw=2.0, color=GREY, label="not identified")
    axes.plot([], [], "|", ms=11, mew=1.8, color=RED, label="start value in the diagram")
    handles = [*axes.get_legend_handles_labels()[0], Patch(color="#eaf3ec", label=f"wanted: \u00b1{precision:g} %")]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2,
                columnspacing=1.2, handlelength=1.4)  # fmt: skip


def _symlog_ticks(axes: Axes, linear: float, reach: float) -> None:
    decades = [10.0**k for k in range(round(math.log10(linear)), math.floor(math.log10(reach)) + 1)]
    step = -(-len(decades) // 5)
    chosen = decades[::-1][::step]
    ticks = [-d for d in chosen] + [0.0] + chosen[::-1]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:+g}" if value else "0"))
    axes.xaxis.set_minor_locator(NullLocator())


def correlation_figure(found: Identification) -> Figure:
    """Return the correlation of the estimates as a matrix with numbers."""
    names, values = list(found.parameters), np.asarray(found.correlation)
    m = len(names)
    size = 0.62 * m if m <= 12 else 0.42 * m
    with styled():
        made = figure(3.4 + size, 2.4 + size, _title(found))
        axes = made.add_subplot()
        shown = np.where(np.eye(m, dtype=bool), np.nan, values)
        picture = axes.imshow(shown, cmap="RdBu_r", vmin=-1, vmax=1)
        for i, j in np.ndindex(m, m):
            if i != j:
                colour = "white" if abs(values[i, j]) > 0.65 else INK
                text = f"{values[i, j]:+.2f}" if abs(values[i, j]) >= 0.005 else "0"
                axes.text(j, i, text, ha="center", va="center", fontsize=8.5 if m <= 12 else 6.5, color=colour)
        axes.set_xticks(range(m), names, rotation=40, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(m), names)
        axes.tick_params(length=0)
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        axes.set_title("correlation of the estimates", loc="left")
        bar = made.colorbar(picture, ax=axes, shrink=0.8, aspect=25, ticks=[-1, -0.5, 0, 0.5, 1])
        bar.outline.set_visible(False)
    return made


# spectra ----------------------------------------------------------------------------------------------------------


def spectrum_figure(compared: Comparison, count: int = RUNS) -> Figure | None:
    """Return full spectra, measured with error bars against the model, of up to ``count`` runs."""
    signals, runs = compared.signals[:3], compared.chosen(count)
    with styled():
        made = figure(5.4 * len(signals) + 0.4, 1.3 + 1.95 * len(runs), _title(compared.found, compared.recording))
        grid = made.subplots(len(runs), len(signals), squeeze=False, sharex="col", sharey="col")
        for column, signal in enumerate(signals):
            low, high = _order_range(compared, signal, runs)
            for row, r in enumerate(runs):
                axes = grid[row, column]
                _draw_spectrum(axes, compared, r, signal)
                axes.set_title(compared.title(r), loc="left", fontsize=8.5)
                axes.set_ylabel(f"[{display(1.0, signal.unit)[1]}, 0-peak]")
                step = 1 if high - low < 18 else 2 if high - low < 30 else 4
                ticks = [k for k in range(low, high + 1) if k % step == (1 if step > 1 else 0) or k == 0]
                axes.set_xticks(ticks, [f"{k}X" if k else "0" for k in ticks])
                axes.set_xlim(low - 0.6, high + 0.6)
            _spectrum_heights(list(grid[:, column]), compared, signal, runs, (low, high))
            grid[-1, column].set_xlabel("order of running speed" + (" (negative: backward)" if signal.y else ""))
            grid[0, column].annotate(signal.title, (0.0, 1.0), xycoords="axes fraction", xytext=(0, 20),
                                     textcoords="offset points", fontsize=10, fontweight="bold")  # fmt: skip
        handles, labels = grid[0, 0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=len(labels))
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
    size, std, noise = (display(part, signal.unit)[0] for part in (np.abs(measured.value), measured.amplitude_std, measured.noise))
    model = display(model, signal.unit)[0]
    orders = measured.orders
    edges = np.append(orders - 0.5, orders[-1] + 0.5)
    axes.set_yscale("log")
    axes.stairs(noise, edges, baseline=1e-300, fill=True, color=NOISE_COLOUR, label="noise level (95 %)", zorder=0)
    tiny = np.full(len(orders), 1e-300)
    axes.vlines(orders, tiny, size, color=np.where(orders < 0, ORANGE, BLUE), lw=1.0, alpha=0.6)
    bars = np.array([np.minimum(Z90 * std, size * (1 - 1e-6)), Z90 * std])
    axes.errorbar(orders, size, bars, fmt="o", ms=3.6, color=INK, elinewidth=1.0, capsize=2.0, capthick=1.0,
                  label="measured, 90 %", zorder=3)  # fmt: skip
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


# over speed -------------------------------------------------------------------------------------------------------


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
        made = figure(0.8 + 3.1 * max(len(orders), 2), 5.4, _title(compared.found, compared.recording))
        grid = made.subplots(2, len(orders), squeeze=False, sharex=True, height_ratios=(1.5, 1.0))
        for k, order in enumerate(orders):
            name = "mean" if order == 0 else f"{order}X" + ("" if not signal.y else " forward" if order > 0 else " backward")
            grid[0, k].set_title(name, loc="left")
            grid[0, k].set_yscale("log")
            grid[1, k].set_xlabel("speed [rpm]")
        grid[0, 0].set_ylabel(f"{signal.title}\n[{display(1.0, signal.unit)[1]}, 0-peak]")
        grid[1, 0].set_ylabel("phase [deg]")
        for group, style in zip(compared.groups, _styles(len(compared.groups)), strict=True):
            _draw_group(grid, compared, signal, orders, group, style)
        for axes in grid[1]:
            axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))
        handles, labels = grid[0, 0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    return made


def _styles(count: int) -> list[tuple[str, str, str]]:
    return [GROUPS[k % len(GROUPS)] for k in range(count)]


def _draw_group(
    grid: np.ndarray, compared: Comparison, signal: Signal, orders: np.ndarray, group: str, style: tuple[str, str, str]
) -> None:
    colour, mark, line = style
    runs = compared.groups[group]
    speeds, curve = compared.curve(group, signal, orders)
    at = np.array([compared.experiment.fits[r].speed for r in runs])
    measured = [compared.measured(r, signal) for r in runs]
    behind = f", {group}" if group else ""
    for k, order in enumerate(orders):
        column = int(np.flatnonzero(compared.orders(signal) == order)[0])
        value = np.array([one.value[column] for one in measured])
        std = np.array([(one.amplitude_std[column], one.phase_std[column]) for one in measured])
        own = np.array([compared.model(r, signal)[column] for r in runs])
        phase = np.degrees(np.angle(value))
        if len(speeds):
            angle = _unwrapped(curve[:, k])
            grid[0, k].plot(rpm(speeds), display(np.abs(curve[:, k]), signal.unit)[0], line, color=colour, label=f"model{behind}")
            grid[1, k].plot(rpm(speeds), angle, line, color=colour)
            turns = np.argsort(speeds)
            phase = phase + 360 * np.round((np.interp(at, speeds[turns], np.nan_to_num(angle[turns])) - phase) / 360)
        else:
            predicted = phase + np.degrees(np.angle(own / value))
            for axes, height in ((grid[0, k], display(np.abs(own), signal.unit)[0]), (grid[1, k], predicted)):
                axes.plot(rpm(at), height, mark, ms=9, mfc="none", mec=colour, label=f"model{behind}")
        size, bar = display(np.abs(value), signal.unit)[0], Z90 * display(std[:, 0], signal.unit)[0]
        kept = {"fmt": mark, "ms": 4.5, "color": colour, "elinewidth": 1.0, "capsize": 2.5, "zorder": 3}
        bars = [np.minimum(bar, size * (1 - 1e-6)), bar]
        grid[0, k].errorbar(rpm(at), size, bars, label=f"measured, 90 %{behind}", **kept)
        sure = std[:, 1] < 1.0
        grid[1, k].errorbar(rpm(at)[sure], phase[sure], np.degrees(Z90 * std[sure, 1]), **kept)


def _unwrapped(values: np.ndarray) -> np.ndarray:
    """Return a continuous phase [deg] with its mean in -180..180, over gaps too."""
    angle = np.full(len(values), np.nan)
    there = np.isfinite(values)
    if there.any():
        some = np.degrees(np.unwrap(np.angle(values[there])))
        angle[there] = some - 360 * np.round(some.mean() / 360)
    return angle


# orbits -----------------------------------------------------------------------------------------------------------


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
        made = figure(4.4 * columns + 0.4, 1.2 + 4.0 * rows, f"{_title(compared.found, compared.recording)}\norbit of {signal.title}")
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
    forward = np.sign(compared.experiment.fits[r].speed)
    at = 60 if forward > 0 else 660
    tip = at + int(24 * forward)
    axes.annotate("", (measured[tip].real, measured[tip].imag), (measured[at].real, measured[at].imag),
                  arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 0, "mutation_scale": 16})  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
