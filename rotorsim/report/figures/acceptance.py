"""Figures of an acceptance: displacement over its zones, unbalance response, critical speed map, mode shapes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import CubicHermiteSpline

from rotorsim.acceptance.displacement import DISPLACEMENT_ZONES
from rotorsim.diagram.diagram import Diagram
from rotorsim.report.figures.margins import AXIS_COLOURS, ZONE_COLOURS
from rotorsim.report.style import BLUE, GREY, INK, LINE_STYLES, ORANGE, RED, figure, legend_below, styled
from rotorsim.report.text.table import rpm

if TYPE_CHECKING:
    from rotorsim.acceptance.displacement import Displacement
    from rotorsim.acceptance.unbalance import UnbalanceCases
    from rotorsim.linear.modes.collocation import Collocation, FreeModes, ModeShape
    from rotorsim.linear.modes.critical_speed_map import CriticalSpeedMap

MARKERS = ("o", "s", "^", "D", "v", "P")
OPERATING = "#e9eef5"
MOST_SHAPES = 6
SHOWN_SPEEDS = 6.0  # times the largest operating speed, up to which critical speeds are shown
FEW_PLANES = 0.15  # of the length between planes: from there on the curve between two of them is a guess
LEAST_TOP = 0.6  # of the clearance: zone D is seen


@styled()
def displacement_figure(results: Sequence[Displacement], title: str = "") -> Figure:
    """Return D_max / C_min over the speed, over the zones of ISO 14839-2: lines are modelled, marks measured."""
    made = figure(7.5, 4.2, title)
    axes = made.add_subplot()
    top = LEAST_TOP
    number = 0
    for one in results:
        for k, place in enumerate(one.places):
            share = one.largest[:, k] / one.clearance[k]
            modelled = one.source == "modelled"
            line, marker = (LINE_STYLES[number % 4], ".") if modelled else ("", MARKERS[number % 6])
            look: Any = {"ls": line, "marker": marker, "color": AXIS_COLOURS[number % 6]}
            label = f"{place}, {one.source if modelled else f'measured, {one.source}'}"
            axes.plot(rpm(one.speeds), share, label=label, **look)
            top = max(top, 1.1 * float(np.nanmax(share, initial=0.0)))
            number += 1
    limits = [0.0, *(limit for limit, _ in DISPLACEMENT_ZONES), top]
    for low, high, (name, colour) in zip(limits, limits[1:], ZONE_COLOURS.items(), strict=False):
        axes.axhspan(low, high, color=colour, zorder=0)
        axes.annotate(name, (0.985, (low + high) / 2), xycoords=("axes fraction", "data"), ha="right", va="center")
    axes.set(xlabel="speed [rpm]", ylabel="largest displacement / clearance", ylim=(0, top))
    legend_below(made, axes, 2)
    return made


@styled()
def unbalance_figure(found: UnbalanceCases, title: str = "") -> Figure:
    """Return peak-to-peak displacement over the speed, the unbalance in one plane after the other.

    Probes are lines, other places with a clearance dashed; A_vl over the operating speeds; critical speeds marked.
    """
    planes = found.response.planes
    made = figure(7.5, 1.2 + 2.6 * len(planes), title)
    panels = made.subplots(len(planes), 1, sharex=True, squeeze=False)[:, 0]
    speeds = rpm(found.response.speeds)
    for j, (axes, plane) in enumerate(zip(panels, planes, strict=True)):
        low, high = (rpm(end) for end in found.operating)
        axes.axvspan(low, max(high, low * 1.002), color=OPERATING, zorder=0, label="operating speeds")
        for i, place in enumerate(found.response.signals):
            line = "-" if i < found.probes else "--"
            axes.plot(speeds, 2e6 * found.size[:, i, j], line, color=AXIS_COLOURS[i % 6], label=place)
        limit = f"A_vl {found.limit * 1e6:.3g} um, probes"
        axes.plot([low, max(high, low * 1.01)], [found.limit * 1e6] * 2, color=RED, lw=1.6, label=limit)
        axes.axvline(rpm(found.trip), color=GREY, lw=0.8, ls=":", label="trip speed")
        for one in found.critical:
            axes.axvline(rpm(one.peak.speed), color=RED, lw=0.8, ls="--", label="critical speeds")
            if j == 0:
                at, text = rpm(one.peak.speed), f"{rpm(one.peak.speed):.0f} rpm\nAF {one.peak.amplification:.2f}"
                form: Any = {"xycoords": ("data", "axes fraction"), "xytext": (3, -3), "textcoords": "offset points"}
                axes.annotate(text, (at, 1.0), fontsize=8, color=RED, va="top", **form)
        axes.set(ylabel="displacement [um, peak-peak]", ylim=(0, None), xmargin=0)
        axes.set_title(f"U_a = {found.unbalances[j] * 1e6:.4g} g mm at {plane}", loc="left")
    panels[-1].set_xlabel("speed [rpm]")
    legend_below(made, panels[0], 3)
    return made


@styled()
def critical_speed_map_figure(
    found: CriticalSpeedMap, title: str = "", *, operating: tuple[float, float] | None = None
) -> Figure:
    """Return undamped critical speeds over the stiffness of the supports, and the bearings' own stiffness across."""
    made = figure(7.5, 4.8, title or str(found.provenance.get("diagram", "")))
    axes = made.add_subplot()
    for k in range(found.speeds.shape[1]):
        axes.loglog(found.stiffness, rpm(found.speeds[:, k]), color=BLUE, label="critical speeds, forward")
    shown = found.speeds[np.isfinite(found.speeds)]
    ends = (float(shown.min()) / 1.5, float(shown.max()) * 1.5) if len(shown) else (10.0, 1000.0)
    for k, (name, (hz, stiffness)) in enumerate(found.bearings.items()):
        real = np.real(stiffness)
        inside = (2 * np.pi * hz >= ends[0]) & (2 * np.pi * hz <= ends[1]) & (real > 0)
        values = np.where(inside, real, np.nan)
        look: Any = {"color": (ORANGE, INK, GREY)[k % 3], "ls": ("-", "--", ":")[k // 3 % 3]}
        axes.loglog(values, rpm(2 * np.pi * hz), label=f"stiffness of {name}, real part", **look)
    for _, support, speed in found.crossings:
        axes.plot(support, rpm(speed), "o", ms=5, mfc="white", mec=RED, zorder=4, label="crossing")
    if operating is not None:
        axes.axhspan(*(rpm(end) for end in operating), color=OPERATING, zorder=0, label="operating speeds")
    axes.set(xlabel="stiffness of each support [N/m]", ylabel="speed [rpm]", xmargin=0)
    if operating is not None:
        ends = (min(ends[0], operating[0] / 1.5), min(ends[1], SHOWN_SPEEDS * operating[1]))
    axes.set(ylim=tuple(rpm(end) for end in ends), xlim=(found.stiffness[0], found.stiffness[-1]))
    axes.grid(visible=True, which="both", lw=0.4)
    legend_below(made, axes, 3)
    return made


@styled()
def mode_shapes_figure(found: FreeModes, diagram: Diagram, title: str = "") -> Figure:
    """Return the bent modes of the free rotor along the shaft, with its probes and magnets."""
    chosen, pairs = found.shapes[:MOST_SHAPES], found.pairs
    made = figure(7.5, 0.9 + 1.35 * len(chosen), title)
    panels = made.subplots(max(len(chosen), 1), 1, sharex=True, squeeze=False)[:, 0]
    at, unit = axial_positions(diagram, len(chosen[0].shape) if chosen else 0)
    for axes, one in zip(panels, chosen, strict=False):
        axes.axhline(0.0, color=GREY, lw=0.8)
        top = 1.25
        if unit.endswith("[mm]") and len(one.slope) == len(at):
            order = np.unique(at, return_index=True)[1]
            fine = np.linspace(at.min(), at.max(), 400)
            curve = CubicHermiteSpline(at[order], one.shape[order], one.slope[order] / 1e3)(fine)
            few = np.diff(at[order]).max() > FEW_PLANES * np.ptp(at)
            label = "between few planes: by displacement and slope" if few else None
            axes.plot(fine, curve, ":" if few else "-", color=BLUE, lw=0.9 if few else 1.2, label=label)
            axes.plot(at, one.shape, ".", color=BLUE, ms=4)
            top = max(top, 1.08 * float(np.abs(curve).max()))
        else:
            axes.plot(at, one.shape, "-", color=BLUE, marker=".", ms=4)
        for pair in pairs:
            if pair.mode == one.number:
                _mark(axes, at, one, pair)
        axes.set(ylim=(-top, top), yticks=(-1, 0, 1))
        axes.set_title(f"mode {one.number}, {one.frequency:.4g} Hz", loc="left")
    panels[-1].set_xlabel(unit)
    made.supylabel("displacement, of the largest", fontsize=9)
    if pairs:
        legend_below(made, panels[0], 3)
    return made


def _mark(axes: Axes, at: np.ndarray, mode: ModeShape, pair: Collocation) -> None:
    """Mark a probe and its magnet on a mode; red where they move against each other."""
    colour = RED if pair.verdict == "opposite phase" else INK
    for signal, marker, what in ((pair.magnet, "s", "magnet"), (pair.probe, "v", "probe")):
        place = node_of(signal)
        if place is not None and place < len(at):
            axes.plot(at[place], mode.shape[place], marker, ms=6, mfc="none", mec=colour, label=what, ls="")


def node_of(signal: str) -> int | None:
    """Return the place (from 0) of a signal such as ``rotor.displacement[3,1]`` among the planes of its rotor."""
    inside = signal.partition("[")[2].rstrip("]").split(",")
    return int(inside[0]) - 1 if len(inside) == 2 else 0 if len(inside) == 1 and inside[0] else None


def axial_positions(diagram: Diagram, count: int) -> tuple[np.ndarray, str]:
    """Return where the planes of the rotor are along the shaft, and what that is: [mm], or their numbers."""
    for node in diagram.nodes.values():
        drawing = getattr(node.block, "drawing", None)
        rows = [] if drawing is None else drawing(node.values).stations
        if len(rows) == count > 1:
            return 1e3 * np.array(rows), "along the shaft [mm]"
    return np.arange(1, count + 1), "plane of the rotor"
