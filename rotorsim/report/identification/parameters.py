"""Figures of identified parameters: values with intervals beside their start values, and the correlation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from rotorsim.identification.result import Identification, Identified
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import Recording
from rotorsim.report.style import BLUE, GREY, INK, RED, figure, styled
from rotorsim.report.text.table import parameter_unit

ZERO = 1e-9  # of the start value: a search that ended at a bound of zero
MINUS = "\u2212"
WANTED = "#eaf3ec"


def heading(identification: Identification, recording: Recording | OrderRecording | None) -> str:
    """Return what was identified from what, for titles, and in a second line whether the model explains it."""
    title = identification.diagram.name + (f" identified from {recording.name}" if recording is not None else "")
    if identification.adequate:
        return title
    if identification.excess is None:
        return f"{title}\nnot explained by the model"
    excess = f"{float(f'{identification.excess:.3g}'):,.6g}"
    return f"{title}\nnot explained by the model: residual variance {excess} times the noise"


def _number(item: Identified, start: float) -> str:
    """Return 'value +- half width unit', to two digits of the half width."""
    unit, factor = parameter_unit("" if item.unit == "1" else item.unit)
    value, low, high = (part * factor for part in (item.value, *item.interval90))
    if _is_zero(item.value, start):
        return f"0 {unit}".strip()
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return f"{value:.6g} {unit}".strip()
    up, down = high - value, value - low
    most, digits = max(up, down), 1 - math.floor(math.log10(max(up, down)))
    if abs(value) >= 1e7 or digits > 8:
        return f"{value:.6g} +- {most:.2g} {unit}".strip()
    texts = (f"{round(n, digits):.{max(digits, 0)}f}".replace("-", MINUS) for n in (value, up, down, most))
    number, above, below, half = texts
    alike = 0.8 < up / max(down, 1e-300) < 1.25
    spread = f"\u00b1 {half}" if alike else f"+{above} {MINUS}{below}"
    return f"{number} {spread} {unit}".strip()


def _is_zero(value: float, start: float) -> bool:
    return value == 0 or abs(value) <= ZERO * abs(start)


def _relative(item: Identified, start: float) -> list[float]:
    """Return both ends of the interval and the start value, less the value, in % of the value; angles: of one radian.

    A value of zero is compared with its start value.
    """
    scale, change = abs(item.value), start - item.value
    if _is_zero(item.value, start):
        scale = abs(start) if math.isfinite(start) and start else 1.0
    if item.unit == "rad":
        scale, change = 1.0, math.remainder(change, 2 * math.pi) if math.isfinite(change) else change
    return [100 * part / scale for part in (*(end - item.value for end in item.interval90), change)]


@styled()
def parameters_figure(identification: Identification, recording: Recording | OrderRecording | None = None) -> Figure:
    """Return every parameter's 90 % interval and start value, relative to the identified value, with its number."""
    items, known = list(identification.parameters.values()), {item.name: item.value for item in identification.free}
    starts = [known.get(item.name, math.nan) for item in items]
    moved = np.array([_relative(item, start) for item, start in zip(items, starts, strict=True)])
    precision = 100 * float(identification.settings.get("precision", 0.05))
    sizes = (moved[:, 1] - moved[:, 0]) / 2
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    linear = 10.0 ** np.clip(np.floor(np.log10(sizes.min(initial=precision))), -4, 0)
    reach = float(np.clip(np.nanmax(np.abs([*sizes, *moved[:, 2], 2 * precision])), 10, 900)) * 1.5
    colours = [BLUE if item.verdict.identifiable else GREY for item in items]
    made = figure(9.0, 1.7 + 0.36 * len(items), f"Parameters, {heading(identification, recording)}")
    axes = made.add_subplot()
    axes.set_xscale("symlog", linthresh=linear, linscale=0.8)
    axes.axvspan(-precision, precision, color=WANTED, zorder=0)
    axes.axvline(0, color=GREY, lw=0.8)
    for k, ((low, high, start), colour) in enumerate(zip(moved, colours, strict=True)):
        ends = np.clip([low, high], -2 * reach, 2 * reach) if high > low else np.zeros(2)
        axes.plot(ends, [k, k], color=colour, lw=2.0, marker="|", ms=7, mew=1.5)
        axes.plot(0, k, "o", ms=5, color=colour, zorder=3)
        if math.isfinite(start):
            outside = abs(start) > reach
            mark, size = ((">" if start > 0 else "<"), 6) if outside else ("|", 11)
            at = math.copysign(0.97 * reach, start) if outside else start
            axes.plot(at, k, mark, ms=size, mew=1.8, color=RED, zorder=4)
    _key_of_parameters(axes, items, precision)
    axes.set(
        xlabel="difference from the identified value [%], angles: of one radian; "
        f"logarithmic beyond \u00b1{linear:g} %",
        xlim=(-reach, reach),
        ylim=(len(items) - 0.5, -0.5),
    )
    _symlog_ticks(axes, linear, reach)
    right = axes.twinx()
    right.set(ylim=axes.get_ylim())
    numbers = [_number(item, start) for item, start in zip(items, starts, strict=True)]
    for side, texts in ((axes, [item.name for item in items]), (right, numbers)):
        side.set_yticks(range(len(items)), texts)
        side.grid(axis="y", visible=False)
        side.tick_params(axis="y", length=0)
        for text, colour in zip(side.get_yticklabels(), colours, strict=True):
            text.set_color(INK if colour == BLUE else GREY)
    right.grid(visible=False)
    return made


def _key_of_parameters(axes: Axes, items: Sequence[Identified], precision: float) -> None:
    axes.plot([], [], "o-", ms=5, lw=2.0, color=BLUE, label="identified, 90 % interval")
    if not all(item.verdict.identifiable for item in items):
        axes.plot([], [], "o-", ms=5, lw=2.0, color=GREY, label="not identified")
    axes.plot([], [], "|", ms=11, mew=1.8, color=RED, label="start value in the diagram")
    handles = [*axes.get_legend_handles_labels()[0], Patch(color=WANTED, label=f"wanted: \u00b1{precision:g} %")]
    form: Any = {"ncols": 4, "borderaxespad": 0.2, "columnspacing": 1.2, "handlelength": 1.4}
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), **form)


def _symlog_ticks(axes: Axes, linear: float, reach: float) -> None:
    decades = [10.0**k for k in range(round(math.log10(linear)), math.floor(math.log10(reach)) + 1)]
    step = -(-len(decades) // 5)
    chosen = [d for d in decades[::-1][::step] if d > 1.5 * linear or len(decades) < 4]  # room for the zero
    ticks = [-d for d in chosen] + [0.0] + chosen[::-1]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:+g}".replace("-", MINUS) if value else "0"))
    axes.xaxis.set_minor_locator(NullLocator())


@styled()
def correlation_figure(identification: Identification, recording: Recording | OrderRecording | None = None) -> Figure:
    """Return the correlation of the estimates as a matrix with numbers."""
    names, values = list(identification.parameters), np.asarray(identification.correlation)
    m = len(names)
    size = 0.62 * m if m <= 12 else 0.42 * m
    made = figure(3.4 + size, 2.4 + size, f"Correlation, {heading(identification, recording)}")
    axes = made.add_subplot()
    shown = np.where(np.eye(m, dtype=bool), np.nan, values)
    picture = axes.imshow(shown, cmap="RdBu_r", vmin=-1, vmax=1)
    for i, j in np.ndindex(m, m):
        if i != j:
            colour = "white" if abs(values[i, j]) > 0.65 else INK
            text = f"{values[i, j]:+.2f}".replace("-", MINUS) if abs(values[i, j]) >= 0.005 else "0"
            axes.text(j, i, text, ha="center", va="center", fontsize=8.5 if m <= 12 else 6.5, color=colour)
    axes.set_xticks(range(m), names, rotation=40, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(m), names)
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    bar = made.colorbar(picture, ax=axes, shrink=0.8, aspect=25, ticks=[-1, -0.5, 0, 0.5, 1])
    bar.outline.set_visible(False)
    return made
