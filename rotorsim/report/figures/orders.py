"""Figures of run-ups and coast-downs: Bode and polar plots of order vectors, cascade, shaft centreline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rotorsim.errors import Problem, RotorsimError
from rotorsim.measure.order_vectors import OrderVectors
from rotorsim.recordings.orders import OrderChannel, OrderRun
from rotorsim.recordings.recording import Channel
from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.style import BLUE, GREEN, GREY, ORANGE, PURPLE, RED, figure, legend_below, styled
from rotorsim.report.text.orders import shown_unit
from rotorsim.report.text.table import rpm
from rotorsim.signals.orders.critical_speeds import CriticalSpeeds
from rotorsim.signals.orders.extraction import Positions
from rotorsim.signals.turning import turning

CHANNEL_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, RED, GREY)
MOST_CHANNELS = len(CHANNEL_COLOURS)
SPEED_MARKS = 8  # speeds that are written along a polar plot, at most
MOST_WINDOWS = 40  # curves of a cascade
CASCADE_ORDERS = 5.0  # of the highest speed
CASCADE_WINDOWS = 15.0  # of a run, one after the other: a window is as long
FLOOR = 1e-3  # of the largest line in a cascade: what is smaller lies on the base line


@dataclass(frozen=True, eq=False)
class Tracked:
    """Vectors of one order of a run: channels by column, what the modes are fitted as, and a diagram beside them."""

    run: OrderRun
    channels: Mapping[str, OrderChannel]
    found: CriticalSpeeds
    simulated: Mapping[str, np.ndarray] = field(default_factory=dict)
    diagram: str = ""
    operating: tuple[float, float] | None = None

    @property
    def order(self) -> np.ndarray:
        """The rows in the order of their speeds, (n,)."""
        return np.argsort(self.run.speed, kind="stable")


def orders_figure(kind: str, vectors: OrderVectors, drawn: Tracked) -> Figure:
    """Return a figure of a run: "bode" or "polar" of its vectors, "cascade" or "centreline" of its samples.

    Raises RotorsimError where channels are of several units, or what is measured does not make that figure.
    """
    title = f"{vectors.orders.name}, {drawn.run.id}"
    if kind in ("bode", "polar"):
        units = sorted({one.unit for one in drawn.channels.values()})
        if len(units) > 1:
            hint = "--signal chooses what is drawn"
            raise RotorsimError(Problem(f"--figure {kind} has one scale, not {' and '.join(units)}", title, hint=hint))
        what, draw = ("Bode plot", bode_plot) if kind == "bode" else ("Polar plot", polar_plot)
        return draw(drawn, f"{what} of {drawn.found.order}X, {title}")
    if kind == "cascade" and drawn.run.noise is not None:
        hint = "bode, polar and centreline are drawn of runs at constant speeds"
        raise RotorsimError(Problem("--figure cascade needs a run-up or coast-down", title, hint=hint))
    if vectors.sampled is None:
        hint = "bode and polar are drawn of tables"
        raise RotorsimError(Problem(f"--figure {kind} needs samples: these are order vectors", title, hint=hint))
    pairs = _pairs(drawn.channels)
    if not pairs:
        what = f"--figure {kind} needs channels of axis x and of axis y of one place"
        raise RotorsimError(Problem(what, title))
    unit, factor = shown_unit(next(one for one in drawn.channels.values() if one.column == pairs[0][0].column))
    if kind == "centreline":
        blind = [one.column for pair in pairs for one in pair if vectors.sampled.channels[one.column].coupling == "ac"]
        if blind:
            what = f'--figure centreline needs means, and {", ".join(blind)} have none: "coupling": "ac"'
            raise RotorsimError(Problem(what, title))
        of_run = [at for at in vectors.positions if at.run == drawn.run.id]
        columns = [(x.column, y.column) for x, y in pairs]
        return centreline_plot(of_run, columns, unit, factor, f"Shaft centreline, {title}")
    own = next(one for one in vectors.sampled.runs if one.id == drawn.run.id)
    x, y = (own.values[one.column] for one in pairs[0])
    window = float(own.time[-1] - own.time[0]) / CASCADE_WINDOWS
    speed = np.abs(turning(vectors.sampled, own).speed)
    named = f"Cascade of full spectra, {pairs[0][0].signal}, {title}"
    return cascade_plot(own.time, x + 1j * y, speed, unit, factor, named, window)


def _pairs(channels: Mapping[str, OrderChannel]) -> list[tuple[Channel, Channel]]:
    """Return the channels of axis x and of axis y of each place that has both."""
    places: dict[tuple[str, int | None, float | None], dict[str, Channel]] = {}
    for one in channels.values():
        if one.axis is not None:
            places.setdefault((one.signal, one.node, one.position), {})[one.axis] = one
    return [(axes["x"], axes["y"]) for axes in places.values() if len(axes) == 2]


@styled()
def bode_plot(tracked: Tracked, title: str) -> Figure:
    """Return amplitude and phase lag over the speed: measured, the fitted modes, their settled response.

    Critical speeds are lines with their 90 % intervals; a diagram's run-up and the operating speeds stand beside.
    """
    made = figure(8.0, 6.6, title)
    amplitude, phase = made.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    speed = rpm(tracked.run.speed[tracked.order])
    unit = ""
    for (name, channel), colour in zip(tracked.channels.items(), CHANNEL_COLOURS, strict=False):
        unit, factor = _shown(channel)
        curves: list[tuple[np.ndarray | None, dict[str, Any], str]] = [
            (tracked.run.vectors[name], {"ls": "", "marker": ".", "ms": 3.0}, channel.name),
            (_on(tracked, tracked.found.fitted.get(name)), {"lw": 1.0}, ""),
            (_on(tracked, tracked.found.settled.get(name)), {"lw": 1.0, "ls": ":"}, ""),
            (tracked.simulated.get(name), {"lw": 1.2, "ls": "--"}, ""),
        ]
        for k, (values, look, what) in enumerate(curves):
            if values is None:
                continue
            own = values[tracked.order]
            amplitude.plot(speed, np.abs(own) * factor, color=colour, label=what, **look)
            if k == 0:
                phase.plot(speed, np.mod(-np.degrees(np.angle(own)), 360.0), color=colour, **look)
            elif k == 3:
                phase.plot(*_lag_line(speed, own), color=colour, **look)
    styles = {"modes that were fitted": "-", "the same, settled": ":"} if tracked.found.fitted else {}
    for what, line in {**styles, **({tracked.diagram: "--"} if tracked.simulated else {})}.items():
        amplitude.plot([], [], color=GREY, lw=1.0, ls=line, label=what)
    _mark(amplitude, tracked)
    _mark(phase, tracked)
    amplitude.set(ylabel=f"amplitude of {tracked.found.order}X [{of_amplitude(unit)}]", ylim=(0, None))
    phase.set(ylabel="phase lag [deg]", xlabel="speed [rpm]", ylim=(0, 360), yticks=[0, 90, 180, 270, 360])
    legend_below(made, amplitude, 3)
    return made


def _on(tracked: Tracked, values: np.ndarray | None) -> np.ndarray | None:
    """Return a curve over the speeds of the fit at the nearest of them to those of the rows."""
    if values is None or len(values) == len(tracked.run.speed):
        return values
    order = np.argsort(tracked.found.speed, kind="stable")
    fine = tracked.found.speed[order]
    return np.asarray(values[order][np.clip(np.searchsorted(fine, tracked.run.speed), 0, len(fine) - 1)])


def _shown(channel: OrderChannel) -> tuple[str, float]:
    """Return the unit in which amplitudes of a channel are shown, and the factor from SI, 0-peak."""
    unit, factor = shown_unit(channel)
    return unit, float(from_peak(factor))


def _lag_line(speed: np.ndarray, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return speeds and phase lags [deg, 0..360] with gaps where these wrap."""
    lag = np.mod(-np.degrees(np.angle(vectors)), 360.0)
    wraps = np.flatnonzero(np.abs(np.diff(lag)) > 180) + 1
    return np.insert(speed.astype(float), wraps, np.nan), np.insert(lag, wraps, np.nan)


def _mark(axes: Axes, tracked: Tracked) -> None:
    """Mark critical speeds with their intervals, and the operating speeds."""
    for one in tracked.found.found:
        low, high = (rpm(end) for end in one.interval90("speed"))
        axes.axvspan(low, high, color=RED, alpha=0.25, lw=0)
        axes.axvline(rpm(one.peak.speed), color=RED, lw=0.8, label="critical speed, 90 %")
    if tracked.operating is not None:
        axes.axvspan(*(rpm(end) for end in tracked.operating), color=GREEN, alpha=0.12, lw=0, label="operating speeds")


@styled()
def polar_plot(tracked: Tracked, title: str) -> Figure:
    """Return the vectors of each channel in the plane, phase lag clockwise, with speeds along them."""
    made = figure(7.0, 7.0, title)
    axes: Any = made.add_subplot(projection="polar")
    axes.set_theta_zero_location("E")
    axes.set_theta_direction(-1)
    speed = rpm(tracked.run.speed[tracked.order])
    unit = ""
    for (name, channel), colour in zip(tracked.channels.items(), CHANNEL_COLOURS, strict=False):
        unit, factor = _shown(channel)
        curves: list[tuple[np.ndarray | None, dict[str, Any], str]] = [
            (tracked.run.vectors[name], {"marker": ".", "ms": 3.0, "lw": 0.5}, channel.name),
            (tracked.simulated.get(name), {"lw": 1.2, "ls": "--"}, f"{channel.name}, {tracked.diagram}"),
        ]
        for values, look, what in curves:
            if values is not None:
                own = values[tracked.order]
                axes.plot(-np.angle(own), np.abs(own) * factor, color=colour, label=what, **look)
        own = tracked.run.vectors[name][tracked.order]
        for one in tracked.found.found:
            k = int(np.argmin(np.abs(speed - rpm(one.peak.speed))))
            label = "critical speeds"
            axes.plot(-np.angle(own[k]), np.abs(own[k]) * factor, "o", ms=8, mfc="none", mec=RED, ls="", label=label)
        length = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(np.nan_to_num(own))))])
        for at in np.unique(np.searchsorted(length, np.linspace(0, length[-1], SPEED_MARKS))):
            k = min(int(at), len(own) - 1)
            if np.isfinite(own[k]):
                place = (-np.angle(own[k]), np.abs(own[k]) * factor)
                axes.annotate(f"{speed[k]:.0f}", place, fontsize=7, color=colour)
    axes.set_xlabel(f"{tracked.found.order}X: phase lag, amplitude [{of_amplitude(unit)}], speeds [rpm]")
    legend_below(made, axes, 3)
    return made


@styled()
def centreline_plot(
    positions: Sequence[Positions], pairs: Sequence[tuple[str, str]], unit: str, factor: float, title: str
) -> Figure:
    """Return the mean positions of the shaft, from where it was in the first row: pairs of columns x and y."""
    made = figure(6.0, 6.0, title)
    axes = made.add_subplot()
    colours = iter([*CHANNEL_COLOURS] * (len(positions) * len(pairs)))
    for at in positions:
        order = np.argsort(at.speed, kind="stable")
        for x, y in pairs:
            places = np.stack([at.mean[x], at.mean[y]])[:, order] * factor
            places = places - places[:, :1]
            colour = next(colours)
            axes.plot(*places, color=colour, marker=".", ms=2.5, lw=0.8, label=f"{at.run}: {x}, {y}")
            for k in (0, len(order) - 1):
                axes.annotate(
                    f"{rpm(at.speed[order[k]]):.0f} rpm", (places[0, k], places[1, k]), fontsize=7, color=colour
                )
    axes.set(xlabel=f"x, mean [{unit}]", ylabel=f"y, mean [{unit}]", aspect="equal", adjustable="datalim")
    legend_below(made, axes)
    return made


@styled()
def cascade_plot(
    time: np.ndarray, z: np.ndarray, speed: np.ndarray, unit: str, factor: float, title: str, window: float
) -> Figure:
    """Return full spectra of z = x + i y (N,) [SI] of windows [s] along a run, one above the other over the speed.

    speed (N,) [rad/s], NaN where it is not known. Hann windows.
    """
    step = float(time[-1] - time[0]) / (len(time) - 1)
    n = max(int(window / step), 8)
    known = np.flatnonzero(np.isfinite(speed))
    starts = np.unique(np.linspace(known[0], max(known[-1] - n, known[0]), MOST_WINDOWS).astype(int))
    taper = np.hanning(n)
    frequency = np.fft.fftshift(np.fft.fftfreq(n, step))
    rows = []
    for first in starts:
        part = z[first : first + n]
        if len(part) < n:
            continue
        size = np.abs(np.fft.fftshift(np.fft.fft((part - part.mean()) * taper))) / taper.sum()
        rows.append((rpm(float(np.nanmean(speed[first : first + n]))), size))
    rows.sort(key=lambda row: row[0])
    largest = max(float(size.max()) for _, size in rows) or 1.0
    gap = (rows[-1][0] - rows[0][0]) / max(len(rows) - 1, 1) or 1.0
    made = figure(7.0, 5.8, title)
    axes = made.add_subplot()
    for at, size in rows[::-1]:
        lifted = at + 6 * gap * np.where(size < FLOOR * largest, 0.0, size) / largest
        axes.fill_between(frequency, at, lifted, color="white", lw=0, zorder=2)
        axes.plot(frequency, lifted, color=BLUE, lw=0.7, zorder=2)
    at = np.array([row[0] for row in rows])
    for sign in (1, -1):
        axes.plot(sign * at / 60, at, color=RED, lw=0.7, ls="--", label="1X" if sign > 0 else None, zorder=3)
    limit = CASCADE_ORDERS * float(at.max()) / 60
    label = f"{of_amplitude('amplitude')}: {from_peak(largest) * factor:.3g} {unit} are as high as {6 * gap:.4g} rpm"
    axes.plot([], [], color=BLUE, lw=0.7, label=label)
    axes.set(xlim=(-limit, limit), xlabel="frequency [Hz], backward < 0 < forward", ylabel="speed [rpm]")
    legend_below(made, axes)
    return made
