"""Figures of linear analyses: Campbell diagram, frequency response, ISO 14839-3 sensitivity, speed curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from rotorsim.report.style import BLUE, GREEN, GREY, ORANGE, RED, display, figure, rpm, styled

if TYPE_CHECKING:
    from rotorsim.simulate.campbell_diagram import Campbell
    from rotorsim.simulate.frequency import FrequencyResponse, Sensitivity
    from rotorsim.simulate.periodic_result import Periodic

__all__ = ["campbell_figure", "frequency_response_figure", "periodic_figure", "sensitivity_figure"]

_WHIRL = {"forward": (BLUE, "-"), "backward": (ORANGE, "--"), "planar": (GREEN, ":")}


def campbell_figure(found: Campbell, title: str = "", *, orders: Sequence[int] = (1, 2)) -> Figure:
    """Return damped natural frequencies over speed, with the lines of the orders and the critical speeds."""
    speed = rpm(found.speeds)
    with styled():
        made = figure(7.5, 5.0, title)
        axes = made.add_subplot()
        shown: set[str] = set()
        for mode in range(found.frequency_hz.shape[1]):
            kinds = [str(w) for w in found.whirl[:, mode]]
            kind = max(set(kinds), key=kinds.count) if kinds else "planar"
            colour, line = _WHIRL.get(kind, (GREY, "-"))
            axes.plot(speed, found.frequency_hz[:, mode], line, color=colour, label=kind if kind not in shown else None)
            shown.add(kind)
        reach = 1.25 * max(orders) * float(found.speeds[-1]) / (2 * np.pi)  # modes far above are never excited
        lowest = np.sort(found.frequency_hz[0][np.isfinite(found.frequency_hz[0])])
        top = min(float(np.nanmax(found.frequency_hz)) * 1.08, max(reach, 1.2 * float(lowest[min(3, len(lowest) - 1)])))
        for order in orders:
            line_hz = order * np.asarray(found.speeds) / (2 * np.pi)
            axes.plot(speed, np.where(line_hz <= top, line_hz, np.nan), color=GREY, lw=0.8)
            last = int(np.flatnonzero(line_hz <= top)[-1])
            axes.annotate(f"{order}X", (speed[last], line_hz[last]), color=GREY, ha="right", va="bottom")
        for crossing in found.crossings:
            axes.plot(rpm(crossing.speed), crossing.frequency_hz, "o", ms=5, mfc="white", mec=RED, zorder=4)
            label = f"{float(rpm(crossing.speed)):.0f}"
            at = (float(rpm(crossing.speed)), crossing.frequency_hz)
            axes.annotate(
                label, at, xytext=(5, -9), textcoords="offset points", fontsize=8, color=RED, annotation_clip=True
            )
        axes.set(xlabel="speed [rpm]", ylabel="damped natural frequency [Hz]", ylim=(0, top))
        axes.margins(x=0)
        axes.legend(loc="upper left", title="whirl (critical speeds in rpm)")
    return made


def frequency_response_figure(found: FrequencyResponse, title: str = "") -> Figure:
    """Return magnitude and phase over frequency of every output to every input."""
    with styled():
        made = figure(7.5, 5.0, title)
        upper, lower = made.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        for o, output in enumerate(found.outputs):
            for i, source in enumerate(found.inputs):
                value = found.value[:, o, i]
                if not np.abs(value).max() > 1e-12 * np.abs(found.value).max():
                    continue
                label = f"{output} / {source} [{found.units[o][i]}]"
                upper.loglog(found.frequencies, np.abs(value), label=label)
                lower.semilogx(found.frequencies, np.degrees(np.unwrap(np.angle(value))))
        upper.set(ylabel="magnitude")
        lower.set(ylabel="phase [deg]", xlabel="frequency [Hz]")
        upper.legend()
    return made


def sensitivity_figure(found: Sensitivity, title: str = "") -> Figure:
    """Return the sensitivity of every axis with the zones of ISO 14839-3."""
    with styled():
        made = figure(7.5, 4.2, title)
        axes = made.add_subplot()
        top = max(6.0, 1.15 * float(np.nanmax(found.singular)))
        zones = ((0, 3, "A", "#dff0e3"), (3, 4, "B", "#eef3d2"), (4, 5, "C", "#fbe8c8"), (5, top, "D", "#f7d4cb"))
        for low, high, name, colour in zones:
            axes.axhspan(low, high, color=colour, zorder=0)
            axes.annotate(name, (0.985, (low + high) / 2), xycoords=("axes fraction", "data"), ha="right", va="center")
        for k, name in enumerate(found.names):
            label = f"{name}: peak {found.peaks[k]:.2f} at {found.peak_frequencies[k]:.0f} Hz, zone {found.zones[k]}"
            axes.semilogx(found.frequencies, np.abs(found.axes[:, k]), label=label)
        axes.semilogx(found.frequencies, found.singular, color=GREY, ls="--", lw=1, label="largest singular value")
        axes.set(xlabel="frequency [Hz]", ylabel="sensitivity |S|", ylim=(0, top))
        axes.margins(x=0)
        axes.legend(loc="upper left")
    return made


def periodic_figure(found: Periodic, signal: str, title: str = "", *, orders: Sequence[int] = (1, 2, 3, -1)) -> Figure:
    """Return the amplitude of harmonics of a two-axis signal over speed."""
    values, unit = display(np.abs(found.harmonics[signal]), found.units.get(signal, ""))
    middle = values.shape[1] // 2
    with styled():
        made = figure(7.5, 4.5, title)
        axes = made.add_subplot()
        for order in orders:
            if abs(order) <= middle:
                axes.semilogy(rpm(found.speeds), values[:, middle + order], label=f"{order:+d}X")
        axes.set(title=f"harmonics of {signal}", xlabel="speed [rpm]", ylabel=f"[{unit}, 0-peak]")
        axes.margins(x=0)
        axes.legend()
    return made
