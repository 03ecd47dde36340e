"""Figures of a run: time histories, orbit, full spectrum, run-up, and one page with all of them.

Every function returns a matplotlib figure; nothing is shown or kept in global state. Displacements are
in um, speeds in rpm.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from rotorsim.errors import Problem, RotorsimError, visible
from rotorsim.files import atomic_target
from rotorsim.report.amplitudes import from_peak, of_amplitude, shown_amplitudes
from rotorsim.report.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    MEASURED_MARK,
    ORANGE,
    RED,
    ZERO_SHARE,
    display,
    figure,
    styled,
)
from rotorsim.report.text.run import two_axis_signals
from rotorsim.report.text.table import rpm
from rotorsim.signals.envelopes import RunUp, run_up
from rotorsim.signals.spectrum import FullSpectrum, angle_of, full_spectrum, last_turns
from rotorsim.signals.two_axis import TwoAxis, two_axis_harmonics
from rotorsim.simulation.result import Result, flat_name

TURNS = 4.0  # shown in time histories
LARGEST_DRAWN = 1e100  # the axes of matplotlib overflow far beyond
DRAWN_ORDERS = 8  # shown in spectra
ORDER_LABEL = "order of running speed"
SIDES = {(-1, "backward"): ORANGE, (0, "_mean"): GREY, (1, "forward"): BLUE}
GROWN = 1e3  # from the first to the second half of an unstable run: then on a logarithmic scale


def _speed_of(result: Result) -> str | None:
    """Return the recorded shaft speed: the one of the clock that gives the angle, else ``clock.speed``, else None."""
    name = (angle_of(result) or "clock.theta").removesuffix("theta") + "speed"
    return name if name in result else None


def _title_of(result: Result) -> str:
    """Return the title of a run: diagram, speed or range of speeds, and what went wrong with it."""
    name = str(result.provenance.get("diagram", "")) or "run"
    name += f" ({result.status})" if result.status != "finished" else ""
    angle, speed = angle_of(result), _speed_of(result)
    if len(result.time) < 3 or (angle is None and speed is None):
        return name
    rates = rpm(result[speed] if speed else np.diff(result[angle or ""]) / np.diff(result.time))
    if np.ptp(rates) > 1e-3 * np.abs(rates).max():
        return f"{name}, {rates[0]:.0f} to {rates[-1]:.0f} rpm"
    return f"{name}, {np.mean(rates):.0f} rpm"


def _last_turns(result: Result, angle: str) -> slice:
    """Return the last TURNS of a run."""
    theta = np.abs(result[angle])
    start = int(np.searchsorted(theta, theta[-1] - 2 * np.pi * TURNS - 1e-9))
    return slice(start if len(theta) - start > 8 else max(len(theta) - 2000, 0), len(theta))


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
    shape = result[signal].shape[1:]
    values, unit = display(result[signal][part].reshape(-1, int(np.prod(shape))), result.unit(signal))
    two_axis = shape == (2,)
    names = list("xy") if two_axis else [f"[{k + 1}]" for k in range(values.shape[1])]
    grown = _has_grown(result, signal, part)
    if grown:  # growth without bound is a straight line on a logarithmic scale
        size = np.abs(values)
        values = np.where((size > 0) & (size < LARGEST_DRAWN), size, np.nan)
        names = [f"|{name}|" for name in names] if two_axis else names
    for k, name in enumerate(names):
        colour: dict[str, Any] = {"color": (BLUE, ORANGE)[k]} if two_axis else {}
        axes.plot(result.time[part], values[:, k], label=name if len(names) > 1 else None, **colour)
    if grown and np.isfinite(values).any():
        axes.set_yscale("log")
    axes.set_title(signal, loc="left")
    axes.set(ylabel=f"[{unit}]", xlabel="time [s]", xmargin=0)
    if 1 < len(names) <= 8:
        _key(axes, len(names))


def _has_grown(result: Result, signal: str, part: slice) -> bool:
    """Return whether a signal grew without bound; at first its growth is still seen on a linear scale."""
    first, second = (np.abs(half).max(initial=0.0) for half in np.array_split(result[signal], 2))
    unstable = result.status == "unstable" and second > GROWN * first
    return bool(
        result.status == "diverged" or unstable or np.abs(result[signal][part]).max(initial=0.0) > LARGEST_DRAWN
    )


@styled()
def time_histories(result: Result, signals: Sequence[str] = ()) -> Figure:
    """Return the signals against time, one panel each; default: all but speed and shaft angle."""
    hidden = (angle_of(result), _speed_of(result))
    names = signals or [n for n in result.signals if n not in hidden] or list(result.signals)
    made = figure(8.0, 1.2 + 1.8 * len(names), _title_of(result))
    for k, name in enumerate(names):
        _draw_time(made.add_subplot(len(names), 1, k + 1), result, name, slice(None))
    return made


def _key_phasor(result: Result, angle: str, signal: str, part: slice) -> np.ndarray:
    """Return the complex signal where the shaft angle is a whole number of turns, between samples too."""
    turns, r = result[angle][part] / (2 * np.pi), result.complex(signal)[part]
    turns = turns if turns[-1] >= turns[0] else -turns
    whole = np.arange(np.floor(turns[0] + 1e-9), np.floor(turns[-1] + 1e-9)) + 1
    return np.asarray(np.interp(whole, turns, r.real) + 1j * np.interp(whole, turns, r.imag))


def _draw_orbit(axes: Axes, result: Result, angle: str, signal: str, part: slice) -> None:
    r, unit = display(result.complex(signal)[part], result.unit(signal))
    axes.plot(r.real, r.imag, color=BLUE, lw=1.0)
    marks, _ = display(_key_phasor(result, angle, signal, part), result.unit(signal))
    if len(marks):
        axes.plot(marks.real, marks.imag, "o", ms=5, color=RED, label="theta = 0", zorder=3)
        _key(axes)
    axes.set_title("orbit", loc="left")
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    axes.set_aspect("equal", adjustable="datalim")


def _draw_spectrum(axes: Axes, spectrum: FullSpectrum, title: str) -> np.ndarray:
    """Draw the amplitudes of a spectrum; return where its lines are."""
    amplitude, unit = display(from_peak(spectrum.amplitude, spectrum.frequency), spectrum.unit)
    order, size = spectrum.frequency / (spectrum.running or 1.0), np.abs(amplitude)
    inside = np.abs(order) <= DRAWN_ORDERS + 0.5
    nearest = np.abs(order[:, None] - np.arange(-DRAWN_ORDERS, DRAWN_ORDERS + 1)).argmin(axis=0)
    peaks = nearest[size[nearest] > 1e-4 * size.max()]
    axes.plot(order[inside], size[inside], color=GREY, lw=0.6)
    for (side, name), colour in SIDES.items():
        chosen = peaks[_side(order[peaks]) == side]
        axes.vlines(order[chosen], 0, size[chosen], color=colour, lw=2.2, label=name)
    axes.set_title(title, loc="left")
    axes.set_xticks(range(-DRAWN_ORDERS, DRAWN_ORDERS + 1), minor=True)
    ends = (-DRAWN_ORDERS - 0.5, DRAWN_ORDERS + 0.5), (0, float(size[inside].max()) * 1.05 or 1.0)
    axes.set(
        xticks=range(-DRAWN_ORDERS + 1, DRAWN_ORDERS, 2), xlim=ends[0], ylim=ends[1], ylabel=f"[{of_amplitude(unit)}]"
    )
    _key(axes, 3)
    return np.asarray(peaks)


def _side(order: np.ndarray) -> np.ndarray:
    """Return -1 for backward whirl, 0 for the mean, 1 for forward whirl."""
    return np.sign(np.where(np.abs(order) <= 0.5, 0.0, order)).astype(int)


def _spectrum(result: Result, signal: str, window: tuple[float, float] | None) -> FullSpectrum:
    angle = angle_of(result)
    if angle is None:
        hint = "record clock.theta"
        raise RotorsimError(Problem("the shaft angle was not recorded", signal, hint=hint))
    spectrum = full_spectrum(result, signal, window=window or last_turns(result, angle), angle=angle)
    if not spectrum.running:
        raise RotorsimError(Problem("the shaft does not turn", angle, hint="set a speed other than zero"))
    return spectrum


@styled()
def spectrum_figure(
    result: Result, signal: str, *, window: tuple[float, float] | None = None, beside: Result | None = None
) -> Figure:
    """Return amplitude and phase of the full spectrum over orders of the running speed.

    window: times [s] (default: the last whole turns). beside: what was measured, its harmonics drawn as diamonds.
    Phases count from shaft angle zero.
    Raises RotorsimError when the shaft angle was not recorded or the shaft does not turn.
    """
    spectrum = _spectrum(result, signal, window)
    made = figure(7.5, 5.0, _title_of(result))
    axes, phase = made.subplots(2, 1, height_ratios=(2, 1), sharex=True)
    peaks = _draw_spectrum(axes, spectrum, f"full spectrum of {signal}")
    order = spectrum.frequency[peaks] / (spectrum.running or 1.0)
    phase.axhline(0, color=GREY, lw=0.6)
    for (side, _), colour in SIDES.items():
        chosen = _side(order) == side
        phase.plot(order[chosen], np.degrees(np.angle(spectrum.amplitude[peaks[chosen]])), "o", ms=4, color=colour)
    phase.set(ylabel="phase [deg]", ylim=(-190, 190), yticks=range(-180, 181, 90), xlabel=ORDER_LABEL)
    if beside is not None and signal in beside and angle_of(beside) is not None:
        _draw_measured(axes, phase, two_axis_harmonics(beside, signal, window=window))
    return made


def _draw_measured(axes: Axes, phase: Axes, measured: TwoAxis) -> None:
    """Draw the harmonics that were measured, those that stand out of the noise."""
    fitted = measured.harmonics
    orders = np.array(fitted.orders)
    shown = (np.abs(orders) <= DRAWN_ORDERS) & (True if measured.significant is None else measured.significant)
    size, _ = display(np.abs(from_peak(fitted.values, orders)), fitted.unit)
    axes.plot(orders[shown], size[shown], **MEASURED_MARK, color=INK, label="measured")
    axes.set_ylim(top=max(axes.get_ylim()[1], 1.05 * float(size[shown].max(initial=0.0))))
    phase.plot(orders[shown], np.degrees(np.angle(fitted.values[shown])), **MEASURED_MARK, color=INK)
    _key(axes, 4)


def _draw_run_up(axes: Axes, result: RunUp) -> None:
    speeds, (sizes, unit) = rpm(result.speeds), display(result.sizes(shown_amplitudes()), result.unit)
    samples, _ = display(result.samples, result.unit)
    beside = shown_amplitudes() == "0-peak"  # only these are on the scale of the samples
    if beside:
        axes.plot(rpm(result.speed), samples, color=GREY, lw=0.3, alpha=0.25, rasterized=True)
    axes.plot(speeds, sizes, color=INK, lw=0.9, label=f"each turn, {shown_amplitudes()}")
    largest = max(float(np.nanmax(curve, initial=0.0)) for curve in result.orders.values())
    for (order, curve), colour in zip(result.orders.items(), (BLUE, ORANGE, GREEN), strict=False):
        if np.nanmax(curve, initial=0.0) > ZERO_SHARE * largest:
            axes.plot(speeds, display(from_peak(curve), result.unit)[0], color=colour, lw=1.0, label=f"{order}X")
    marks = [(f"{one.order}X", one.speed, float(from_peak(one.peak))) for one in result.resonances()]
    if result.rises:
        marks.append(("still rising", result.resonance, float(result.sizes(shown_amplitudes())[result.largest])))
    for (name, speed, peak), mark in zip(marks, "ov^s", strict=False):
        height = float(display(peak, result.unit)[0])
        label = f"{name} at {rpm(speed):.0f} rpm: {height:.4g} {of_amplitude(unit)}"
        axes.plot(rpm(speed), height, mark, ms=6, mfc="white", mec=INK, ls="none", label=label, zorder=4)
    top = 1.12 * float(sizes[len(sizes) // 50 :].max())
    axes.set_title(f"run-up: {result.signal}, about its mean", loc="left")
    axes.set(xlabel="speed [rpm]", ylabel=f"[{of_amplitude(unit)}]", ylim=(-top if beside else 0.0, top), xmargin=0)
    axes.legend(loc="lower left" if beside else "upper left", fontsize=7.5)


@styled()
def overview(result: Result) -> Figure:
    """Return one page of a run: time histories, orbit, full spectrum; of a run-up its orders.

    Signals without two axes are drawn against time only, and so is everything of a run that did not finish.
    """
    pairs, speed, angle = two_axis_signals(result), _speed_of(result), angle_of(result)
    if not pairs or result.status != "finished" or len(result.time) < 100:
        return time_histories(result)
    if speed is not None and np.ptp(result[speed]) > 1e-6 * np.abs(result[speed]).max():
        if not (np.diff(result[speed]) >= 0).all():
            return time_histories(result)
        made = figure(9.0, 1.0 + 2.8 * len(pairs), _title_of(result))
        for k, name in enumerate(pairs):
            found = run_up(result, flat_name(name, (0,)), speed=speed)
            _draw_run_up(made.add_subplot(len(pairs), 1, k + 1), found)
        return made
    if angle is None or abs(float(result[angle][-1] - result[angle][0])) < 2 * np.pi:
        return time_histories(result)
    part = _last_turns(result, angle)
    made = figure(11.0, 1.0 + 3.0 * len(pairs), _title_of(result))
    grid = made.add_gridspec(len(pairs), 3, width_ratios=(1.5, 1.0, 1.5))
    for k, name in enumerate(pairs):
        _draw_time(made.add_subplot(grid[k, 0]), result, name, part)
        _draw_orbit(made.add_subplot(grid[k, 1]), result, angle, name, part)
        axes = made.add_subplot(grid[k, 2])
        _draw_spectrum(axes, _spectrum(result, name, None), "full spectrum")
        axes.set_xlabel(ORDER_LABEL)
    return made


def save_figure(made: Figure, path: str | Path) -> None:
    """Write a figure as .png, .svg or .pdf, whole or not at all."""
    for text in made.findobj(Text):
        if visible(text.get_text()) != text.get_text():  # a name of others, which an SVG cannot hold
            text.set_text(visible(text.get_text()))
    with atomic_target(Path(path)) as temporary, styled():
        made.savefig(temporary)
