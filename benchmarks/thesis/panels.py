"""Panels that the figures of the thesis are made of: time histories, orbits, full spectra, run-ups.

Displacements are in um, currents in A, amplitudes 0-peak; time histories show four turns of the window 4 s to 5 s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from rotorsim import Result, envelope, full_spectrum, harmonics
from rotorsim.report.style import BLUE, GREY, INK, ORANGE, RED, display
from rotorsim.report.text.table import rpm

WINDOW = (4.0, 5.0)  # s, after which the thesis takes the motion as settled
TURNS = 4.0  # shown of the window
ORDERS = 9  # of the running speed, to either side
STANDS_OUT = 2e-3  # of the largest line: less is drawn without a phase

__all__ = ["TURNS", "WINDOW", "harmonic", "history", "key", "orbit", "peak", "peak_near", "ramp", "spectrum", "square"]


def history(axes: Axes, result: Result, signals: Sequence[str], labels: Sequence[str], title: str) -> None:
    """Draw signals of the same unit against time, over the first turns of the window."""
    part = _turns(result)
    for signal, label, line in zip(signals, labels, _lines(len(signals)), strict=True):
        values, unit = display(result[signal][part], result.unit(signal))
        axes.plot(result.time[part], values, label=label or None, **line)
        axes.set(xlabel="time [s]", ylabel=f"[{unit}]")
    axes.set_title(title, loc="left")
    axes.margins(x=0)
    if any(labels):
        key(axes, len(labels))


def orbit(axes: Axes, result: Result, signal: str, title: str) -> None:
    """Draw y over x, turn upon turn of the window; a dot where the shaft angle is zero or whole turns."""
    part = _turns(result)
    r = result.complex(signal)[part]
    curve, unit = display(r, result.unit(signal))
    theta = result["clock.theta"][part] / (2 * np.pi)
    whole = np.arange(np.ceil(theta[0] - 1e-9), np.floor(theta[-1]) + 1)
    marks, _ = display(np.interp(whole, theta, r.real) + 1j * np.interp(whole, theta, r.imag), result.unit(signal))
    axes.plot(curve.real, curve.imag, color=BLUE, lw=1.0)
    axes.plot(marks.real, marks.imag, "o", ms=4.5, color=RED)
    axes.annotate(
        "angle 0", (marks[0].real, marks[0].imag), (-6, 0), textcoords="offset points", ha="right", fontsize=8
    )
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    axes.set_title(title, loc="left")
    square(axes, curve)


def square(axes: Axes, curve: np.ndarray) -> None:
    """Give both axes of an orbit one scale, in a square that holds it."""
    ends = [(part.min(), part.max()) for part in (curve.real, curve.imag)]
    half = 0.55 * max(high - low for low, high in ends)
    (x, y) = ((low + high) / 2 for low, high in ends)
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
    axes.set_box_aspect(1)


def spectrum(amplitude: Axes, phase: Axes, result: Result, signal: str, titles: tuple[str, str]) -> None:
    """Draw amplitude and phase of the full spectrum of x + i y over the window, against frequency.

    Phases count from shaft angle zero, thesis eq. (2.50), and are drawn at the harmonics that stand out.
    """
    found = full_spectrum(result, signal, window=WINDOW)
    running = found.running or 1.0
    order = found.frequency / running
    inside = np.abs(order) <= ORDERS + 0.5
    values, unit = display(found.amplitude[inside], found.unit)
    size, frequency, order = np.abs(values), found.frequency[inside], order[inside]
    lines = [int(np.argmin(np.abs(order - k))) for k in range(-ORDERS, ORDERS + 1)]
    lines = [k for k in lines if size[k] > STANDS_OUT * size.max()]
    for name, colour, side in (("backward", ORANGE, -1), ("mean", GREY, 0), ("forward", BLUE, 1)):
        chosen = [k for k in lines if np.sign(np.round(order[k])) == side]
        amplitude.vlines(frequency[chosen], 0, size[chosen], color=colour, lw=2.2, label=name)
        phase.plot(frequency[chosen], np.degrees(np.angle(values[chosen])), "o", ms=4, color=colour)
    amplitude.plot(frequency, size, color=GREY, lw=0.5)
    for k in lines:
        if size[k] > 0.03 * size.max():
            amplitude.annotate(
                f"{np.round(order[k]):.0f}X" if round(order[k]) else "0",
                (frequency[k], size[k]),
                (0, 2),
                textcoords="offset points",
                ha="center",
                fontsize=7.5,
            )
    amplitude.set(xlabel="frequency [Hz]", ylabel=f"[{unit}, 0-peak]", ylim=(0, 1.12 * size.max()))
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]", ylim=(-190, 190), yticks=range(-180, 181, 90))
    phase.axhline(0, color=GREY, lw=0.6)
    for axes, title in zip((amplitude, phase), titles, strict=True):
        axes.set_xlim(-(ORDERS + 0.5) * running, (ORDERS + 0.5) * running)
        axes.set_title(title, loc="left")
    amplitude.legend(loc="upper left", fontsize=8)


def ramp(samples: Axes, hull: Axes, result: Result, signal: str, titles: tuple[str, str]) -> tuple[np.ndarray, ...]:
    """Draw a run-up and its Hilbert envelope against the speed alpha t; return that speed [rpm] and the envelope [m].

    The ends of an envelope by FFT are wrong and are left out: half a percent of the samples on either side.
    """
    speed, x = rpm(result["clock.speed"]), result[signal]
    hidden = len(x) // 200
    height = envelope(x - x.mean())
    inside = slice(hidden, -hidden)
    shown, unit = display(x, result.unit(signal))
    samples.plot(speed, shown, color=GREY, lw=0.25, rasterized=True)
    samples.set(xlabel="speed alpha t [rpm]", ylabel=f"x [{unit}]")
    hull.plot(speed[inside], display(height, result.unit(signal))[0][inside], color=INK, lw=0.7)
    hull.set(xlabel="speed alpha t [rpm]", ylabel=f"[{unit}, 0-peak]", ylim=(0, None))
    for axes, title in zip((samples, hull), titles, strict=True):
        axes.set_title(title, loc="left")
        axes.set_xlim(0, float(np.round(speed[-1], -2)))
    return speed[inside], height[inside]


def peak_near(speed: np.ndarray, height: np.ndarray, at: float, width: float = 0.1) -> tuple[float, float]:
    """Return speed [rpm] and height of the largest envelope within a share of a speed."""
    near = np.flatnonzero(np.abs(speed / at - 1) < width)
    best = near[np.argmax(height[near])]
    return float(speed[best]), float(height[best])


def peak(result: Result, signal: str) -> float:
    """Return the largest |signal| in the window 4 s to 5 s."""
    return float(np.abs(result[signal][result.time >= WINDOW[0] - 1e-9]).max())


def harmonic(result: Result, signal: str, order: int) -> complex:
    """Return a harmonic of a two-axis signal, fitted to the shaft angle over the window."""
    return harmonics(result, signal, window=WINDOW)[order]


def key(axes: Axes, columns: int = 1) -> None:
    """Put the legend above the axes, at the right, where it hides no curve."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        borderaxespad=0.0,
        handlelength=1.4,
        columnspacing=1.0,
        fontsize=8,
    )


def _turns(result: Result) -> slice:
    """Return the samples of the first turns of the window."""
    theta = result["clock.theta"]
    first = int(np.searchsorted(result.time, WINDOW[0] - 1e-9))
    return slice(first, int(np.searchsorted(theta, theta[first] + 2 * np.pi * TURNS + 1e-9)) + 1)


def _lines(number: int) -> list[dict[str, object]]:
    colours = (BLUE, ORANGE, "#009E73", RED, "#CC79A7", GREY)
    return [{"color": colours[k], "lw": 1.1} for k in range(number)]
