"""Figures of linear analyses: Campbell diagram, frequency response, speed curves, modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import Bbox

from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LINE_STYLES,
    MEASURED_MARK,
    ORANGE,
    RED,
    ZERO_SHARE,
    display,
    figure,
    legend_below,
    phase_line,
    styled,
)
from rotorsim.report.text.table import rpm

if TYPE_CHECKING:
    from rotorsim.linear.control.frequency import FrequencyResponse
    from rotorsim.linear.control.step_response import StepResponse
    from rotorsim.linear.modes.campbell import Campbell
    from rotorsim.linear.modes.eigenmodes import Modes
    from rotorsim.measure.over_speed import HarmonicsOverSpeed
    from rotorsim.settled.result import Periodic


MOST_CURVES = 8  # of a frequency response: more hide one another, and their legend takes the figure
PHASE_MARKS = 6  # about so many, at quarter turns
LABEL_OFFSETS = (-13, 5, -25, 17, -37, 29, -49, 41)  # points below or above a mark at which its speed is written
_WHIRL = {"forward": (BLUE, "-"), "backward": (ORANGE, "--"), "planar": (GREEN, ":")}


def _stretches(whirl: np.ndarray) -> list[tuple[slice, str]]:
    """Return the parts of a mode between speeds in which it whirls alike.

    The kind of the higher speed counts: at rest most modes are planar, or any combination of two equal ones.
    """
    kinds = [str(after or before) for before, after in pairwise(whirl)]
    parts = [list(part) for _, part in groupby(range(len(kinds)), kinds.__getitem__)]
    return [(slice(part[0], part[-1] + 2), kinds[part[0]]) for part in parts]


def _mark_crossings(axes: Axes, result: Campbell) -> None:
    """Mark critical speeds, and write each where it hides no other."""
    crossings = sorted((c for c in result.crossings if result.resonant[c.mode - 1]), key=lambda c: (c.order, c.speed))
    places = np.array([(rpm(c.speed), c.frequency_hz) for c in crossings]).reshape(-1, 2)
    if crossings:
        modulo = np.array([c.modulo for c in crossings])
        rate = np.max(modulo, initial=0.0, where=modulo > 0)
        for there, mark, more in ((np.isnan(modulo), "o", ""), (modulo > 0, "s", f", frequency modulo {rate:.6g} Hz")):
            if there.any():
                label = f"critical speed [rpm]{more}"
                axes.plot(*places[there].T, mark, ms=5, mfc="white", mec=RED, zorder=4, label=label)
    inside, pixels = axes.get_window_extent(), axes.figure.dpi / 72
    spots = axes.transData.transform(places) if crossings else places
    taken = [Bbox([spot - 4 * pixels, spot + 4 * pixels]) for spot in spots]
    for (speed, frequency), spot in zip(places, spots, strict=True):
        text = f"{speed:.0f}"
        width = 0.62 * 8 * len(text)  # of 8-point digits
        for shift in ((side, level) for level in LABEL_OFFSETS for side in (6.0, -6.0 - width)):
            low = spot + pixels * np.array(shift)
            frame = Bbox([low, low + pixels * np.array([width, 9.0])])
            if _fits(frame, inside, taken):
                taken.append(frame)
                line = {"arrowprops": {"arrowstyle": "-", "color": RED, "lw": 0.4}} if abs(shift[1]) > 13 else {}
                form: Any = {"xytext": shift, "textcoords": "offset points", "fontsize": 8, "color": RED, **line}
                axes.annotate(text, (speed, frequency), **form)
                break


def _fits(frame: Bbox, inside: Bbox, taken: Sequence[Bbox]) -> bool:
    """Return whether a frame is inside another and overlaps none of those that are taken."""
    corners = all(inside.contains(*corner) for corner in frame.corners())
    return corners and not any(frame.overlaps(other) for other in taken)


@styled()
def campbell_figure(result: Campbell, title: str = "", *, orders: Sequence[int] = (1, 2)) -> Figure:
    """Return damped natural frequencies over speed, with the lines of the orders and the critical speeds.

    Modes with a damping ratio above 1/sqrt(2) at all speeds, which have no resonance, are left out.
    """
    speed = rpm(result.speeds)
    made = figure(7.5, 5.0, title or str(result.provenance.get("diagram", "")))
    axes = made.add_subplot()
    resonant = np.flatnonzero(result.resonant)
    for mode in resonant:
        for part, kind in _stretches(result.whirl[:, mode]):
            colour, line = _WHIRL.get(kind, (GREY, "-"))
            axes.plot(speed[part], result.frequency_hz[part, mode], line, color=colour, label=kind)
    top = _top(result, orders)
    if len(result.stable) and not result.stable.all():
        there = ~result.stable
        axes.plot(speed[there], result.frequency_hz[there][:, resonant], "x", ms=4, color=RED, label="machine unstable")
    for order in orders:
        line_hz = order * np.asarray(result.speeds) / (2 * np.pi)
        inside = np.flatnonzero(line_hz <= top)
        axes.plot(speed, np.where(line_hz <= top, line_hz, np.nan), color=GREY, lw=0.8)
        at = (speed[inside[-1]], line_hz[inside[-1]])
        axes.annotate(f"{order}X", at, color=GREY, ha="right", va="bottom")
    axes.set(xlabel="speed [rpm]", ylabel="damped natural frequency [Hz]", ylim=(0, top), xmargin=0)
    _mark_crossings(axes, result)
    _legend_above(axes)
    return made


def _legend_above(axes: Axes) -> None:
    """Put the legend above the axes, every entry once, if there is any."""
    handles, labels = axes.get_legend_handles_labels()
    entries = {label: handle for label, handle in zip(labels, handles, strict=True) if label}
    if entries:
        place: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 4, "borderaxespad": 0.2}
        axes.legend(list(entries.values()), list(entries), **place)


def _top(result: Campbell, orders: Sequence[int]) -> float:
    """Return the highest frequency shown [Hz]: modes far above every order are never excited."""
    line = max(orders) * float(result.speeds[-1]) / (2 * np.pi)
    if not np.isfinite(result.frequency_hz).any():
        return max(line, 1.0)
    shown = result.frequency_hz[:, result.resonant]
    lowest = np.sort(shown[0][np.isfinite(shown[0])])[:4] if shown.size else np.zeros(0)
    highest = float(np.nanmax(shown, initial=0.0)) * 1.08 or 1.25 * line
    return min(highest, max(1.25 * line, 1.2 * float(lowest.max(initial=0.0))))


@styled()
def frequency_response_figure(response: FrequencyResponse, title: str = "") -> Figure:
    """Return magnitude and phase over frequency of every output to every input (entries that are zero left out).

    Of many entries the MOST_CURVES that grow largest are drawn, and the title says so. Of a loop that is not stable the
    figure says so: it would never settle to this response.
    """
    if not response.stable:
        title = f"{title} (not stable: no settled response)".strip()
    pairs = list(np.ndindex(response.value.shape[1:]))
    sizes = {(o, i): float(np.nanmax(np.abs(response.value[:, o, i]), initial=0.0)) for o, i in pairs}
    drawn = [pair for pair in pairs if sizes[pair] > 1e-12 * max(sizes.values(), default=0.0)]
    if len(drawn) > MOST_CURVES:
        title = f"{title} (the {MOST_CURVES} largest of {len(drawn)})".strip()
        kept = sorted(drawn, key=lambda pair: -sizes[pair])[:MOST_CURVES]
        drawn = [pair for pair in drawn if pair in kept]
    made = figure(7.5, 5.0, title)
    upper, lower = made.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for k, (o, i) in enumerate(drawn):
        value, line = response.value[:, o, i], LINE_STYLES[k % 4]
        label = f"{response.outputs[o]} / {response.inputs[i]} [{response.units[o][i]}]"
        upper.loglog(response.frequencies, np.abs(value), line, label=label)
        angle = np.degrees(np.unwrap(np.angle(value)))
        angle -= 360 * np.round(angle[0] / 360 - 1e-6)  # begin in -180..180
        lower.semilogx(response.frequencies, angle, line)
    units = {response.units[o][i] for o, i in drawn}
    upper.set(ylabel=f"magnitude [{units.pop()}]" if len(units) == 1 else "magnitude", xmargin=0)
    lower.set(ylabel="phase [deg]", xlabel="frequency [Hz]", xmargin=0)
    low, high = lower.get_ylim()
    lower.yaxis.set_major_locator(MultipleLocator(90 * max(1, round((high - low) / (90 * PHASE_MARKS)))))
    if drawn:
        legend_below(made, upper, 2)
    return made


@styled()
def step_response_figure(found: StepResponse, title: str = "") -> Figure:
    """Return the response over time to a step of 1 at each input (entries that are zero left out), and final values."""
    if not found.stable:
        title = f"{title} (not stable)".strip()
    made = figure(7.5, 4.2, title)
    axes = made.add_subplot()
    largest = float(np.abs(found.value).max(initial=0.0))
    units = set()
    for k, (o, i) in enumerate(np.ndindex(*found.value.shape[1:])):
        above, below = found.units[k]
        if np.abs(found.value[:, o, i]).max(initial=0.0) > ZERO_SHARE * largest:
            shown, unit = display(found.value[:, o, i], above)
            label = f"{found.outputs[o]}, step of 1 {below if below != '1' else ''} at {found.inputs[i]}"
            axes.plot(found.time, shown, LINE_STYLES[k % 4], label=" ".join(label.split()))
            units.add(unit)
            final = found.numbers[k].final
            if np.isfinite(final):
                axes.axhline(float(display(final, above)[0]), color=GREY, lw=0.7, ls=":")
    axes.set(xlabel="time [s]", ylabel=f"response [{', '.join(sorted(units))}]", xmargin=0)
    legend_below(made, axes, 2)
    return made


@styled()
def periodic_figure(
    result: Periodic,
    signals: Sequence[str] | str | None = None,
    title: str = "",
    *,
    orders: Sequence[float] = (1, 2, 3, -1),
    measured: Mapping[str, HarmonicsOverSpeed] | None = None,
) -> Figure:
    """Return amplitude and phase of harmonics over speed, one row of panels per signal.

    signals: default those of two axes, else all. measured: harmonics of runs, drawn as diamonds. Speeds without a
    solution are gaps, unstable motions crosses; what is rounding beside the largest harmonic is not drawn.
    Raises RotorsimError for signals not in the result.
    """
    names = [signals] if isinstance(signals, str) else list(signals or result.two_axis or result.harmonics)
    there = [k for k in orders if np.isclose(result.orders, k, rtol=0, atol=1e-9).any()]
    speed = rpm(result.speeds)
    unstable = np.array([stable is False for stable in result.stable], bool)
    mark = "-" if len(speed) > 1 else "o"
    made = figure(9.5, 0.7 + 2.6 * len(names), title or str(result.provenance.get("diagram", "")))
    panels = made.subplots(len(names), 2, sharex=True, squeeze=False)
    for (left, right), name in zip(panels, names, strict=True):
        unit = result.units.get(name, "")
        curves = np.array([result.harmonic(name, order) for order in there])
        floor = ZERO_SHARE * np.nanmax(np.abs(curves), initial=0.0)
        for order, curve in zip(there, curves, strict=True):
            seen = np.where(np.abs(curve) > floor, curve, np.nan)
            sizes, shown = display(from_peak(np.abs(seen), order), unit)
            (line,) = left.plot(speed, sizes, mark, label=f"{order:+g}X")
            right.plot(*phase_line(speed, seen), mark, color=line.get_color())
            left.plot(speed[unstable], sizes[unstable], "x", ms=5, color=line.get_color())
            if name in (measured or {}) and measured:
                _draw_measured(left, right, measured[name], order, unit, line.get_color())
        left.set_title(name, loc="left")
        left.set(ylabel=f"amplitude [{of_amplitude(shown)}]", yscale="log" if floor > 0 else "linear", xmargin=0)
        right.set(ylabel="phase [deg]", ylim=(-190, 190), yticks=range(-180, 181, 90))
    panels[0, 0].plot([], [], "x", ms=5, color=GREY, label="unstable" if unstable.any() else None)
    panels[0, 0].plot([], [], **MEASURED_MARK, color=INK, label="measured" if measured else None)
    for axes in panels[-1]:
        axes.set_xlabel("speed [rpm]")
    made.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=len(there) + 2)
    return made


def _draw_measured(left: Axes, right: Axes, measured: HarmonicsOverSpeed, order: float, unit: str, colour: str) -> None:
    values = measured.order(order)
    left.plot(rpm(measured.speeds), display(from_peak(np.abs(values), order), unit)[0], **MEASURED_MARK, color=colour)
    phases = np.where(measured.phase_known, np.degrees(np.angle(values)), np.nan)
    right.plot(rpm(measured.speeds), phases, **MEASURED_MARK, color=colour)


@styled()
def modes_figure(result: Modes, title: str = "") -> Figure:
    """Return the poles that oscillate: frequency [Hz] against damping ratio; unstable ones stand left of zero."""
    made = figure(6.5, 4.2, title or str(result.provenance.get("diagram", "")))
    axes = made.add_subplot()
    for whirl, (colour, _) in _WHIRL.items():
        chosen = [mode for mode in result.modes if mode.whirl == whirl]
        sizes = [mode.damping_ratio for mode in chosen], [mode.frequency_hz for mode in chosen]
        if chosen:
            axes.plot(*sizes, "o", ms=6, mfc="white", mec=colour, label=whirl)
    axes.axvline(0.0, color=RED, lw=0.8)
    label = "damped natural frequency [Hz]"
    axes.set(xlabel="damping ratio (below zero: unstable)", ylabel=label, ylim=(0, None))
    _legend_above(axes)
    return made
