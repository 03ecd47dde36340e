"""How identified parameters move from the diagram as given to the repaired one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.report.style import GREY, Look, figure, legend_below, styled

WIDEST_AXIS = {"%": 150.0, "deg": 180.0}  # change of a parameter to which the axis reaches
Estimates = Mapping[str, Mapping[str, Any]]  # name -> value, interval90, unit, at_bound


@styled()
def parameters_figure(before: Estimates, after: Estimates, looks: Sequence[Look]) -> Figure | None:
    """Return how parameters move: both values with 90 % intervals, in parts of the later one, or degrees for angles.

    None where nothing is in both. One at its bound is hollow, without an interval; the other value is then what it is
    compared with. Beyond WIDEST_AXIS the change is written at the edge.
    """
    names = [name for name in after if name in before and not (_at_bound(before[name]) and _at_bound(after[name]))]
    angles = [name for name in names if after[name]["unit"] == "rad"]
    panels = {"%": [name for name in names if name not in angles], "deg": angles}
    panels = {unit: some for unit, some in panels.items() if some}
    if not panels:
        return None
    height = 1.5 + 0.42 * max(len(some) for some in panels.values())
    made = figure(5.2 * len(panels), height, "How identified parameters move, with 90 % intervals")
    grid = made.subplots(1, len(panels), squeeze=False)
    for axes, (unit, some) in zip(grid[0], panels.items(), strict=True):
        _draw_moves(axes, [(name, before[name], after[name]) for name in reversed(some)], looks, unit)
    legend_below(made, grid[0, 0])
    return made


def _at_bound(item: Mapping[str, Any]) -> bool:
    return bool(item.get("at_bound"))


def _draw_moves(
    axes: Axes, rows: Sequence[tuple[str, Mapping[str, Any], Mapping[str, Any]]], looks: Sequence[Look], unit: str
) -> None:
    """Draw (name, before, after) of parameters, from below."""
    drawn = []
    for row, (_, before, after) in enumerate(rows):
        base = before if _at_bound(after) or not after["value"] else after
        drawn += [
            (row + shift, look, item, _relative(item, base["value"], unit))
            for shift, item, look in zip((0.14, -0.14), (before, after), looks, strict=True)
        ]
    ends = np.array([places for *_, places in drawn])
    limit = min(1.15 * float(np.abs(ends).max(initial=1e-3)), WIDEST_AXIS[unit])
    for height, look, item, (centre, low, high) in drawn:
        form: dict[str, Any] = {"ms": 5, "color": look.colour, "capsize": 2.5, "elinewidth": 1.2}
        marker, label = look.marker, look.label
        if _at_bound(item):
            low = high = centre
            form["mfc"], label = "white", f"{label}, at its bound"
        if abs(centre) > limit:
            side = float(np.sign(centre))
            text, marker = f"{centre:+.3g} {unit} ", "<" if side < 0 else ">"
            low = high = centre = 0.97 * side * limit
            place: Any = {"xytext": (-8 * side, 0), "textcoords": "offset points", "va": "center", "fontsize": 8}
            axes.annotate(text, (centre, height), ha="right" if side > 0 else "left", **place)
        bars = [[max(centre - low, 0)], [max(high - centre, 0)]]
        axes.errorbar(centre, height, xerr=bars, fmt=marker, label=label, **form)
    axes.axvline(0.0, color=GREY, lw=0.8, zorder=0)
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    least, most = min(0.0, ends.min()), max(0.0, ends.max())
    room = 0.08 * (most - least)
    reach = max(least - room, -limit), min(most + room, limit)
    axes.set(xlim=reach, ylim=(-0.6, len(rows) - 0.4), xlabel=f"change against {looks[1].label} [{unit}]")


def _relative(item: Mapping[str, Any], base: float, unit: str) -> tuple[float, float, float]:
    """Return value and interval against a base value, in degrees (of the nearest turn) or percent."""
    low, high = (item["value"] if end is None or not math.isfinite(end) else end for end in item["interval90"])
    moved = np.array([item["value"], low, high]) - base
    if unit == "deg":
        value, low, high = np.degrees(moved - 2 * np.pi * np.round(moved[0] / (2 * np.pi)))
    else:
        value, low, high = 100 * moved / (abs(base) or abs(item["value"]) or 1.0)
    return float(value), float(low), float(high)
