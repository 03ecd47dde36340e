"""Figures of stability margins: |S| over the zones of ISO 14839-3 and the open loop, modelled, measured, or both."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.linear.control.margins import ZONES
from rotorsim.linear.loop import open_loop_of
from rotorsim.report.style import BLUE, GREEN, GREY, INK, LINE_STYLES, ORANGE, PURPLE, RED, figure, phase_line, styled

if TYPE_CHECKING:
    from rotorsim.linear.control.margins import Margins
    from rotorsim.signals.injection.measured_margins import MeasuredMargins

SHOWN_BESIDE = 1.5  # times the frequencies that were measured: shown of a diagram
AXIS_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, RED, GREY)
ZONE_COLOURS = {"A": "#dff0e3", "B": "#eef3d2", "C": "#fbe8c8", "D": "#f7d4cb"}
LOWEST_TOP = 6.0  # of the scale of |S|: zone D is seen
HIGHEST_TOP = 25.0  # noise of a measurement where hardly anything was injected is not worth a scale


@styled()
def margins_figure(result: Margins, title: str = "") -> Figure:
    """Return |S| of every axis over the zones of ISO 14839-3, and its open loop G_o in magnitude and phase."""
    made, panels = _panels(title or str(result.provenance.get("diagram", "")))
    S = np.diagonal(result.sensitivity, axis1=1, axis2=2)
    for k, axis in enumerate(result.axes):
        peak = f"peak {axis.peak:.2f} at {axis.frequency:.0f} Hz" if result.stable else "closed loop unstable"
        look, label = {"color": AXIS_COLOURS[k % 6], "ls": LINE_STYLES[k % 4]}, f"{axis.name}: {peak}, zone {axis.zone}"
        _curves(panels, result.frequencies, S[:, k], open_loop_of(S[:, k]), look, label)
    if np.isfinite(result.singular).any():
        label = "largest singular value"
        panels[0].semilogx(result.frequencies, result.singular, color=GREY, lw=0.8, zorder=1.9, label=label)
    _finish(panels, float(np.nanmax([np.abs(S).max(), np.nanmax(result.singular, initial=0.0)])))
    return made


@styled()
def measured_margins_figure(measured: MeasuredMargins, title: str = "", *, modelled: Margins | None = None) -> Figure:
    """Return the same as measured, with 90 % intervals of |S|; where that of a diagram is given, dashed beside it."""
    made, panels = _panels(title or measured.recording)
    own = {} if modelled is None else {axis.name: k for k, axis in enumerate(modelled.axes)}
    largest = [axis.best.peak for axis in measured.axes]
    for axis, colour in zip(measured.axes, AXIS_COLOURS * 10, strict=False):
        low, high = axis.interval90["peak"]
        peak = f"peak {axis.best.peak:.2f} ({low:.2f} to {high:.2f}) at {axis.best.frequency:.0f} Hz"
        label = f"{axis.name}: {peak}, zone {axis.zones}"
        S = np.where(axis.measured, axis.sensitivity, np.nan)
        _curves(panels, axis.frequencies, S, axis.open_loop(), {"color": colour}, label)
        size = np.abs(S)
        panels[0].fill_between(
            axis.frequencies, size - axis.half_width, size + axis.half_width, color=colour, alpha=0.3, lw=0
        )
        if modelled is not None and axis.name in own:
            k = own[axis.name]
            values = modelled.sensitivity[:, k, k]
            beside = modelled.axes[k]
            name = modelled.provenance.get("diagram", "diagram")
            label = f"{name}: peak {beside.peak:.2f} at {beside.frequency:.0f} Hz, zone {beside.zone}"
            look = {"color": INK, "ls": ("--", ":")[k % 2], "lw": 1.0}
            _curves(panels, modelled.frequencies, values, open_loop_of(values), look, label)
            largest.append(float(np.abs(values).max()))
    _finish(panels, max(largest))
    ends = [axis.band for axis in measured.axes]
    panels[0].set_xlim(min(low for low, _ in ends) / SHOWN_BESIDE, max(high for _, high in ends) * SHOWN_BESIDE)
    return made


def _panels(title: str) -> tuple[Figure, list[Axes]]:
    """Return an empty figure of sensitivity, magnitude and phase of the open loop over the frequency."""
    made = figure(7.5, 7.5, title)
    panels = list(made.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2)))
    panels[0].set(ylabel="sensitivity |S|", xmargin=0)
    panels[1].set(ylabel="open loop |G_o|")
    panels[2].set(ylabel="phase of G_o [deg]", xlabel="frequency [Hz]", ylim=(-190, 190), yticks=range(-180, 181, 90))
    return made, panels


def _curves(panels: list[Axes], hz: np.ndarray, S: np.ndarray, G: np.ndarray, look: dict[str, Any], label: str) -> None:
    panels[0].semilogx(hz, np.abs(S), label=label, **look)
    panels[1].loglog(hz, np.abs(G), **look)
    panels[2].semilogx(*phase_line(hz, G), **look)


def _finish(panels: list[Axes], largest: float) -> None:
    """Shade the zones up to the largest |S|, mark |G_o| = 1, and say what is what."""
    axes = panels[0]
    panels[1].axhline(1.0, color=GREY, lw=0.8)
    top = min(max(LOWEST_TOP, 1.15 * largest), HIGHEST_TOP)
    limits = [0.0, *(limit for limit, _ in ZONES), top]
    for low, high, (name, colour) in zip(limits, limits[1:], ZONE_COLOURS.items(), strict=False):
        axes.axhspan(low, high, color=colour, zorder=0)
        axes.annotate(name, (0.985, (low + high) / 2), xycoords=("axes fraction", "data"), ha="right", va="center")
    axes.set(ylim=(0, top))
    axes.legend(loc="upper left")
