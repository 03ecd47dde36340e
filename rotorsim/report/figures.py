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
from rotorsim.report.style import AXES, BLUE, GREY, ORANGE, RED, display, figure, rpm, styled
from rotorsim.simulate.result import Result
from rotorsim.simulate.spectrum import FullSpectrum, RunUp, full_spectrum, last_turns, run_up

__all__ = ["orbit", "overview", "run_up_figure", "spectrum_figure", "time_histories", "two_axis_signals"]

ANGLE, SPEED = "clock.theta", "clock.speed"
TURNS = 4.0  # shown in time histories


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


def title_of(result: Result) -> str:
    """Return the title of a run: diagram and constant speed."""
    name = str(result.provenance.get("diagram", ""))
    if ANGLE not in result or len(result.time) < 3:
        return name
    rates = np.diff(result[ANGLE]) / np.diff(result.time)
    if np.ptp(rates) > 1e-3 * abs(rates[-1]):
        return f"{name}, {rpm(rates[0]):.0f} to {rpm(rates[-1]):.0f} rpm"
    return f"{name}, {rpm(rates.mean()):.0f} rpm"


def _last(result: Result, turns: float) -> slice:
    if ANGLE in result:
        theta = result[ANGLE]
        start = int(np.searchsorted(theta, theta[-1] - 2 * np.pi * turns - 1e-9))
        if len(theta) - start > 8:
            return slice(start, len(theta))
    return slice(max(len(result.time) - 2000, 0), len(result.time))


def _unit(result: Result, signal: str) -> str:
    return result.units.get(signal, result.units.get(signal.partition("[")[0], ""))


def _draw_time(axes: Axes, result: Result, signal: str, part: slice) -> None:
    values, unit = display(result[signal][part], _unit(result, signal))
    if values.ndim == 2 and values.shape[1] == 2:
        for k, axis in enumerate("xy"):
            axes.plot(result.time[part], values[:, k], color=AXES[axis], label=axis)
    else:
        flat = values.reshape(len(values), -1)
        for k in range(flat.shape[1]):
            axes.plot(result.time[part], flat[:, k], label=f"[{k + 1}]" if flat.shape[1] > 1 else None)
    axes.set(title=signal, ylabel=f"[{unit}]", xlabel="time [s]")
    axes.margins(x=0)
    handles, labels = axes.get_legend_handles_labels()
    if handles and len(labels) <= 8:
        axes.legend(loc="upper right", ncols=len(labels))


def time_histories(result: Result, signals: list[str] | None = None, *, turns: float | None = None) -> Figure:
    """Return the signals against time, one panel each (all of the run, or its last turns)."""
    names = signals or [n for n in result.signals if n not in (ANGLE, SPEED)]
    part = slice(0, len(result.time)) if turns is None else _last(result, turns)
    with styled():
        made = figure(8.0, 1.2 + 1.8 * len(names), title_of(result))
        for k, name in enumerate(names):
            _draw_time(made.add_subplot(len(names), 1, k + 1), result, name, part)
    return made


def _draw_orbit(axes: Axes, result: Result, signal: str, part: slice) -> None:
    r, unit = display(result.complex(signal)[part], _unit(result, signal))
    axes.plot(r.real, r.imag, color=BLUE, lw=1.0)
    if ANGLE in result:
        theta = result[ANGLE][part] / (2 * np.pi)
        at = np.flatnonzero(np.diff(np.floor(theta + 1e-9)) > 0) + 1
        axes.plot(r.real[at], r.imag[at], "o", ms=4.5, color=RED, label="theta = 0", zorder=3)
        axes.legend(loc="upper right")
    axes.set(title=f"orbit of {signal}", xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    axes.set_aspect("equal", adjustable="datalim")


def orbit(result: Result, signal: str, *, turns: float = TURNS) -> Figure:
    """Return the orbit of a two-axis signal over the last turns, with the key phasor (theta = 0) marked."""
    with styled():
        made = figure(5.0, 5.0, title_of(result))
        _draw_orbit(made.add_subplot(), result, signal, _last(result, turns))
    return made


def _draw_spectrum(axes: Axes, phase: Axes | None, found: FullSpectrum, running: float, orders: int) -> None:
    amplitude, unit = display(found.amplitude, found.unit)
    order = found.frequency / running
    inside = np.abs(order) <= orders + 0.5
    size = np.abs(amplitude)
    peaks = [int(np.argmin(np.abs(order - k))) for k in range(-orders, orders + 1)]
    peaks = [k for k in peaks if size[k] > 1e-4 * size.max()]
    axes.plot(order[inside], size[inside], color=GREY, lw=0.6)
    axes.vlines(order[peaks], 0, size[peaks], color=[BLUE if order[k] >= 0 else ORANGE for k in peaks], lw=2.2)
    axes.set(title=f"full spectrum of {found.signal}", ylabel=f"[{unit}, 0-peak]")
    axes.set_xlabel("order of running speed:  backward < 0 < forward")
    axes.set_xticks(range(-orders, orders + 1), minor=True)
    axes.set_xticks(range(-orders + 1, orders, 2))
    axes.set_ylim(bottom=0)
    if phase is not None:
        angle = np.degrees(np.angle(amplitude[peaks]))
        phase.axhline(0, color=GREY, lw=0.6)
        for k, value in zip(peaks, angle, strict=True):
            phase.plot(order[k], value, "o", ms=4, color=BLUE if order[k] >= 0 else ORANGE)
        phase.set(ylabel="phase [deg]", ylim=(-190, 190), yticks=range(-180, 181, 90))
        phase.set_xlabel("order of running speed")
        phase.set_xticks(range(-orders + 1, orders, 2))


def _running(result: Result, window: tuple[float, float] | None) -> float:
    if ANGLE not in result:
        hint = f"record {ANGLE}"
        raise RotorsimError(Problem("the shaft angle was not recorded", ANGLE, hint=hint))
    theta, time = result[ANGLE], result.time
    start, stop = (0, -1) if window is None else np.searchsorted(time, window) - (0, 1)
    rate = float((theta[stop] - theta[start]) / (time[stop] - time[start]) / (2 * np.pi))
    if rate <= 0:
        raise RotorsimError(Problem("the shaft does not turn", ANGLE, hint="set a speed above zero"))
    return rate


def spectrum_figure(
    result: Result, signal: str, *, window: tuple[float, float] | None = None, orders: int = 8
) -> Figure:
    """Return amplitude and phase of the full spectrum over orders of the running speed."""
    window = window or last_turns(result)
    with styled():
        made = figure(7.5, 5.0, title_of(result))
        axes, phase = made.subplots(2, 1, height_ratios=(2, 1), sharex=True)
        _draw_spectrum(axes, phase, full_spectrum(result, signal, window=window), _running(result, window), orders)
    return made


def _draw_run_up(axes: Axes, found: RunUp) -> None:
    speed = rpm(found.speed)
    samples, unit = display(found.samples, found.unit)
    curve, _ = display(found.envelope, found.unit)
    peak, _ = display(found.peak, found.unit)
    axes.plot(speed, samples, color=BLUE, lw=0.3, alpha=0.5, rasterized=True)
    axes.plot(speed, curve, color=RED, lw=1.4, label="Hilbert envelope")
    label = f"largest at {rpm(found.resonance):.0f} rpm: {float(peak):.4g} {unit}, 0-peak"
    axes.axvline(rpm(found.resonance), color=GREY, ls="--", lw=0.9, label=label)
    axes.set(title=f"run-up: {found.signal}", xlabel="speed [rpm]", ylabel=f"[{unit}, 0-peak]")
    axes.margins(x=0)
    axes.legend(loc="upper left")


def run_up_figure(result: Result, signal: str) -> Figure:
    """Return one axis of a run-up with its Hilbert envelope against the speed."""
    with styled():
        made = figure(8.0, 4.0, title_of(result))
        _draw_run_up(made.add_subplot(), run_up(result, signal))
    return made


def overview(result: Result) -> Figure:
    """Return one page of a run: time histories, orbit, full spectrum; of a run-up its envelopes.

    Signals without two axes are drawn against time only.
    """
    pairs = two_axis_signals(result)
    if SPEED in result and len(result.time) > 100 and np.ptp(result[SPEED]) > 1e-6 * np.abs(result[SPEED]).max():
        with styled():
            made = figure(9.0, 1.0 + 2.8 * len(pairs), title_of(result))
            for k, name in enumerate(pairs):
                entry = name[:-1] + ",1]" if name.endswith("]") else f"{name}[1]"
                _draw_run_up(made.add_subplot(len(pairs), 1, k + 1), run_up(result, entry))
        return made
    if not pairs or ANGLE not in result or len(result.time) < 100:
        return time_histories(result)
    part, window = _last(result, TURNS), last_turns(result)
    with styled():
        made = figure(11.0, 1.0 + 3.0 * len(pairs), title_of(result))
        grid = made.add_gridspec(len(pairs), 3, width_ratios=(1.5, 1.0, 1.5))
        for k, name in enumerate(pairs):
            _draw_time(made.add_subplot(grid[k, 0]), result, name, part)
            _draw_orbit(made.add_subplot(grid[k, 1]), result, name, part)
            axes = made.add_subplot(grid[k, 2])
            _draw_spectrum(axes, None, full_spectrum(result, name, window=window), _running(result, window), 8)
    return made


def save_figure(made: Figure, path: Any) -> None:
    """Write a figure as .png, .svg or .pdf, whole or not at all."""
    from pathlib import Path

    from rotorsim.diagram.files import atomic_target

    with atomic_target(Path(path)) as temporary, styled():
        made.savefig(temporary)
