"""Figures of a run: time histories, orbit, full spectrum, run-up, and one page with all of them.

Every function returns a matplotlib figure; nothing is shown or kept in global state. Displacements are
in um, speeds in rpm, amplitudes 0-peak.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.errors import Problem, RotorsimError
from rotorsim.report.style import AXES, BLUE, GREEN, GREY, INK, ORANGE, RED, ROUNDING, display, figure, rpm, styled
from rotorsim.signals.envelopes import RunUp, run_up
from rotorsim.signals.spectrum import FullSpectrum, angle_of, full_spectrum, last_turns
from rotorsim.simulation.result import Result

__all__ = ["orbit", "overview", "run_up_figure", "save_figure", "spectrum_figure", "time_histories", "two_axis_signals"]

TURNS = 4.0  # shown in time histories
HUGE = 1e100  # the axes of matplotlib overflow far beyond
GROWN = 1e3  # from the first to the second half of an unstable run: then on a logarithmic scale


def two_axis_signals(result: Result) -> list[str]:
    """Return what can be drawn as an orbit: (n, 2) signals, and the node of largest motion of (n, nodes, 2) ones."""
    found = []
    for name, array in result.signals.items():
        if array.ndim == 2 and array.shape[1] == 2:
            found.append(name)
        elif array.ndim == 3 and array.shape[2] == 2:
            late = array[len(array) // 2 :]
            node = int(np.argmax(np.ptp(late, axis=0).max(axis=1)))
            found.append(f"{name}[{node + 1}]")
    return found


def speed_of(result: Result) -> str | None:
    """Return the recorded shaft speed: the one of the clock that gives the angle, else ``clock.speed``, else None."""
    name = (angle_of(result) or "clock.theta").removesuffix("theta") + "speed"
    return name if name in result else None


def title_of(result: Result) -> str:
    """Return the title of a run: diagram, speed or range of speeds, and what went wrong with it."""
    name = str(result.provenance.get("diagram", "")) or "run"
    if result.status != "finished":
        name += f" ({result.status})"
    angle, speed = angle_of(result), speed_of(result)
    if len(result.time) < 3 or (angle is None and speed is None):
        return name
    rates = result[speed] if speed else np.diff(result[angle or ""]) / np.diff(result.time)
    if np.ptp(rates) > 1e-3 * np.abs(rates).max():
        return f"{name}, {rpm(rates[0]):.0f} to {rpm(rates[-1]):.0f} rpm"
    return f"{name}, {rpm(np.mean(rates)):.0f} rpm"


def _last(result: Result, turns: float) -> slice:
    angle = angle_of(result)
    if angle is not None:
        theta = np.abs(result[angle])
        start = int(np.searchsorted(theta, theta[-1] - 2 * np.pi * turns - 1e-9))
        if len(theta) - start > 8:
            return slice(start, len(theta))
    return slice(max(len(result.time) - 2000, 0), len(result.time))


def _key(axes: Axes, columns: int = 1) -> None:
    """Put the legend above the axes, at the right, where it hides no curve."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        borderaxespad=0.0,
        handlelength=1.4,
        columnspacing=1.0,
    )


def _draw_time(axes: Axes, result: Result, signal: str, part: slice) -> None:
    values = result[signal][part]
    grown = result.status == "diverged" or bool(np.abs(values).max(initial=0.0) > HUGE)
    if result.status == "unstable":  # at first its growth is still seen on a linear scale
        half = len(result.time) // 2
        grown |= bool(
            np.abs(result[signal][half:]).max(initial=0.0) > GROWN * np.abs(result[signal][:half]).max(initial=0)
        )
    if grown:  # growth without bound is a straight line on a logarithmic scale
        size = np.abs(values)
        values = np.where((size > 0) & (size < HUGE), size, np.nan)
    values, unit = display(values, result.unit(signal))
    if values.ndim == 2 and values.shape[1] == 2:
        for k, axis in enumerate("xy"):
            axes.plot(result.time[part], values[:, k], color=AXES[axis], label=f"|{axis}|" if grown else axis)
    else:
        flat = values.reshape(len(values), -1)
        for k in range(flat.shape[1]):
            axes.plot(result.time[part], flat[:, k], label=f"[{k + 1}]" if flat.shape[1] > 1 else None)
    if grown and np.isfinite(values).any():
        axes.set_yscale("log")
    axes.set_title(signal, loc="left")
    axes.set(ylabel=f"[{unit}]", xlabel="time [s]")
    axes.margins(x=0)
    handles, labels = axes.get_legend_handles_labels()
    if handles and len(labels) <= 8:
        _key(axes, len(labels))


def time_histories(result: Result, signals: list[str] | None = None, *, turns: float | None = None) -> Figure:
    """Return the signals against time, one panel each (all of the run, or its last turns)."""
    hidden = (angle_of(result), speed_of(result))
    names = signals or [n for n in result.signals if n not in hidden] or list(result.signals)
    part = slice(0, len(result.time)) if turns is None else _last(result, turns)
    with styled():
        made = figure(8.0, 1.2 + 1.8 * len(names), title_of(result))
        for k, name in enumerate(names):
            _draw_time(made.add_subplot(len(names), 1, k + 1), result, name, part)
    return made


def _key_phasor(result: Result, signal: str, part: slice) -> np.ndarray:
    """Return the complex signal where the shaft angle is a whole number of turns, between samples too."""
    angle = angle_of(result)
    if angle is None:
        return np.empty(0, complex)
    turns, r = result[angle][part] / (2 * np.pi), result.complex(signal)[part]
    if turns[-1] < turns[0]:
        turns = -turns
    whole = np.arange(np.floor(turns[0] + 1e-9), np.floor(turns[-1] + 1e-9)) + 1
    return np.asarray(np.interp(whole, turns, r.real) + 1j * np.interp(whole, turns, r.imag))


def _draw_orbit(axes: Axes, result: Result, signal: str, part: slice, title: str) -> None:
    r, unit = display(result.complex(signal)[part], result.unit(signal))
    axes.plot(r.real, r.imag, color=BLUE, lw=1.0)
    marks, _ = display(_key_phasor(result, signal, part), result.unit(signal))
    if len(marks):
        axes.plot(marks.real, marks.imag, "o", ms=5, color=RED, label="theta = 0", zorder=3)
        _key(axes)
    axes.set_title(title, loc="left")
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    axes.set_aspect("equal", adjustable="datalim")


def orbit(result: Result, signal: str, *, turns: float = TURNS) -> Figure:
    """Return the orbit of a two-axis signal over the last turns, with the key phasor (theta = 0) marked."""
    with styled():
        made = figure(5.0, 5.0, title_of(result))
        _draw_orbit(made.add_subplot(), result, signal, _last(result, turns), f"orbit of {signal}")
    return made


def _colour(order: float) -> str:
    return GREY if abs(order) <= 0.5 else BLUE if order > 0 else ORANGE


def _draw_spectrum(axes: Axes, phase: Axes | None, found: FullSpectrum, orders: int, title: str) -> None:
    running = found.running or 1.0
    amplitude, unit = display(found.amplitude, found.unit)
    order = found.frequency / running
    inside = np.abs(order) <= orders + 0.5
    size = np.abs(amplitude)
    peaks = [int(np.argmin(np.abs(order - k))) for k in range(-orders, orders + 1)]
    peaks = [k for k in peaks if size[k] > 1e-4 * size.max()]
    axes.plot(order[inside], size[inside], color=GREY, lw=0.6)
    for colour, name, chosen in (
        (ORANGE, "backward", [k for k in peaks if order[k] < -0.5]),
        (GREY, "_mean", [k for k in peaks if abs(order[k]) <= 0.5]),
        (BLUE, "forward", [k for k in peaks if order[k] > 0.5]),
    ):
        axes.vlines(order[chosen], 0, size[chosen], color=colour, lw=2.2, label=name)
    axes.set_title(title, loc="left")
    axes.set(ylabel=f"[{unit}, 0-peak]")
    axes.set_xticks(range(-orders, orders + 1), minor=True)
    axes.set_xticks(range(-orders + 1, orders, 2))
    axes.set_xlim(-orders - 0.5, orders + 0.5)
    axes.set_ylim(0, float(size[inside].max()) * 1.05 or 1.0)
    _key(axes, 3)
    (axes if phase is None else phase).set_xlabel("order of running speed")
    if phase is not None:
        angle = np.degrees(np.angle(amplitude[peaks]))
        phase.axhline(0, color=GREY, lw=0.6)
        for k, value in zip(peaks, angle, strict=True):
            phase.plot(order[k], value, "o", ms=4, color=_colour(float(order[k])))
        phase.set(ylabel="phase [deg]", ylim=(-190, 190), yticks=range(-180, 181, 90))


def _spectrum(result: Result, signal: str, window: tuple[float, float] | None) -> FullSpectrum:
    angle = angle_of(result)
    if angle is None:
        hint = "record clock.theta"
        raise RotorsimError(Problem("the shaft angle was not recorded", signal, hint=hint))
    found = full_spectrum(result, signal, window=window or last_turns(result, angle), angle=angle)
    if not found.running:
        raise RotorsimError(Problem("the shaft does not turn", angle, hint="set a speed other than zero"))
    return found


def spectrum_figure(
    result: Result, signal: str, *, window: tuple[float, float] | None = None, orders: int = 8
) -> Figure:
    """Return amplitude and phase of the full spectrum over orders of the running speed.

    window: times [s] (default: the last whole turns). Phases count from shaft angle zero.
    Raises RotorsimError when the shaft angle was not recorded or the shaft does not turn.
    """
    found = _spectrum(result, signal, window)
    with styled():
        made = figure(7.5, 5.0, title_of(result))
        axes, phase = made.subplots(2, 1, height_ratios=(2, 1), sharex=True)
        _draw_spectrum(axes, phase, found, orders, f"full spectrum of {signal}")
    return made


def _draw_run_up(axes: Axes, found: RunUp) -> None:
    speeds, (peaks, unit) = rpm(found.speeds), display(found.peaks, found.unit)
    samples, _ = display(found.samples, found.unit)
    axes.plot(rpm(found.speed), samples, color=GREY, lw=0.3, alpha=0.25, rasterized=True)
    axes.plot(speeds, peaks, color=INK, lw=0.9, label="peak of each turn")
    largest = max(float(np.nanmax(curve, initial=0.0)) for curve in found.orders.values())
    for (order, curve), colour in zip(found.orders.items(), (BLUE, ORANGE, GREEN), strict=False):
        if np.nanmax(curve, initial=0.0) > ROUNDING * largest:
            axes.plot(speeds, display(curve, found.unit)[0], color=colour, lw=1.0, label=f"{order}X")
    marks = [(f"{one.order}X", one.speed, one.peak) for one in found.resonances()]
    if found.rises:
        marks.append(("still rising", found.resonance, found.peak))
    for (name, speed, peak), mark in zip(marks, "ov^s", strict=False):
        height = float(display(peak, found.unit)[0])
        label = f"{name} at {rpm(speed):.0f} rpm: {height:.4g} {unit}, 0-peak"
        axes.plot(rpm(speed), height, mark, ms=6, mfc="white", mec=INK, ls="none", label=label, zorder=4)
    top = 1.12 * float(peaks[len(peaks) // 50 :].max())
    axes.set_title(f"run-up: {found.signal}, about its mean", loc="left")
    axes.set(xlabel="speed [rpm]", ylabel=f"[{unit}, 0-peak]", ylim=(-top, top))
    axes.margins(x=0)
    axes.legend(loc="lower left", fontsize=7.5)


def run_up_figure(result: Result, signal: str) -> Figure:
    """Return one axis of a run-up against the speed: samples, peak of each turn, orders and their resonances."""
    found = run_up(result, signal, speed=speed_of(result) or "clock.speed")
    with styled():
        made = figure(8.0, 4.0, title_of(result))
        _draw_run_up(made.add_subplot(), found)
    return made


def overview(result: Result) -> Figure:
    """Return one page of a run: time histories, orbit, full spectrum; of a run-up its orders.

    Signals without two axes are drawn against time only, and so is everything of a run that did not finish.
    """
    pairs, speed, angle = two_axis_signals(result), speed_of(result), angle_of(result)
    if not pairs or result.status != "finished" or len(result.time) < 100:
        return time_histories(result)
    if speed is not None and np.ptp(result[speed]) > 1e-6 * np.abs(result[speed]).max():
        if not (np.diff(result[speed]) >= 0).all():
            return time_histories(result)
        with styled():
            made = figure(9.0, 1.0 + 2.8 * len(pairs), title_of(result))
            for k, name in enumerate(pairs):
                entry = name[:-1] + ",1]" if name.endswith("]") else f"{name}[1]"
                _draw_run_up(made.add_subplot(len(pairs), 1, k + 1), run_up(result, entry, speed=speed))
        return made
    if angle is None or abs(float(result[angle][-1] - result[angle][0])) < 2 * np.pi:
        return time_histories(result)
    part = _last(result, TURNS)
    with styled():
        made = figure(11.0, 1.0 + 3.0 * len(pairs), title_of(result))
        grid = made.add_gridspec(len(pairs), 3, width_ratios=(1.5, 1.0, 1.5))
        for k, name in enumerate(pairs):
            _draw_time(made.add_subplot(grid[k, 0]), result, name, part)
            _draw_orbit(made.add_subplot(grid[k, 1]), result, name, part, "orbit")
            _draw_spectrum(made.add_subplot(grid[k, 2]), None, _spectrum(result, name, None), 8, "full spectrum")
    return made


def save_figure(made: Figure, path: Any) -> None:
    """Write a figure as .png, .svg or .pdf, whole or not at all."""
    from pathlib import Path

    from matplotlib.text import Text

    from rotorsim.errors import visible
    from rotorsim.files import atomic_target

    for text in made.findobj(Text):
        if visible(text.get_text()) != text.get_text():  # a name of others, which an SVG cannot hold
            text.set_text(visible(text.get_text()))
    with atomic_target(Path(path)) as temporary, styled():
        made.savefig(temporary)
