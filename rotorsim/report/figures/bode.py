"""Bode plots of order vectors over the speed: measured beside simulated, and what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.style import BLUE, GREEN, INK, ORANGE, PURPLE, RED, figure, styled
from rotorsim.units import conversion

_RPM = 30 / np.pi
LINE_COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE)
ROW_LAGS = 20  # rows over which an autocorrelation is drawn
LEAST_AMPLITUDE = 3.0  # times the noise, below which a phase is none


@dataclass(frozen=True)
class Curve:
    """Order vectors (n,), complex, SI, over speeds (n,) [rad/s]; line, colour (default: the next): how it is drawn."""

    label: str
    speed: np.ndarray
    vectors: np.ndarray
    line: str = "-"
    colour: str = ""


def bode_figure(measured: Curve, simulated: Sequence[Curve], title: str, unit: str, noise: float) -> Figure:
    """Return amplitude, phase lag and what is left of order vectors over the speed.

    unit: in which they are shown. noise: standard deviation of their real parts; a phase is shown where the amplitude
    is three times that.
    """
    with styled():
        made = figure(8.0, 7.6, title)
        amplitude, phase, left = made.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
        factor = float(from_peak(1.0 / conversion(unit, None)))
        looks: list[tuple[Curve, dict[str, Any]]] = [
            (measured, {"color": INK, "marker": ".", "markersize": 4.0, "linewidth": 0.5})
        ]
        looks += [
            (one, {"color": one.colour or LINE_COLOURS[k % len(LINE_COLOURS)], "linewidth": 1.3, "linestyle": one.line})
            for k, one in enumerate(simulated)
        ]
        before: np.ndarray | None = None
        for curve, look in looks:
            speed, size = curve.speed * _RPM, np.abs(curve.vectors)
            lag = _lag(curve.vectors, before)
            before = lag if before is None else before
            amplitude.plot(speed, size * factor, label=curve.label, **look)
            phase.plot(speed, np.where(size > LEAST_AMPLITUDE * noise, lag, np.nan), **look)
            if curve is not measured:
                left.plot(speed, np.abs(measured.vectors - curve.vectors) * factor, **look)
        left.axhline(noise * factor * np.sqrt(2.0), color=INK, linewidth=0.8, linestyle="--", label="noise, rms")
        amplitude.set_ylabel(f"amplitude [{of_amplitude(unit)}]")
        phase.set_ylabel("phase lag [deg]")
        left.set_ylabel(f"|measured - simulated| [{of_amplitude(unit)}]")
        left.set_xlabel("speed [rpm]")
        handles = amplitude.get_legend_handles_labels()
        more = left.get_legend_handles_labels()
        made.legend(handles[0] + more[0], handles[1] + more[1], loc="outside lower center", ncols=2)
        return made


def residual_rows_figure(rows: Sequence[Curve], title: str) -> Figure:
    """Return what diagrams leave of order vectors in standard deviations of the noise, over the speed and row to row.

    rows: vectors less simulated ones without what noise keeps from row to row, over the deviation of their real parts.
    Below: the autocorrelation Re sum conj(e_n) e_(n+k) / sum |e_n|^2 with the band that white rows keep at 95 % of k.
    """
    with styled():
        made = figure(8.0, 5.4, title)
        over, alike = made.subplots(2, 1, height_ratios=[3, 2])
        for curve in rows:
            over.plot(
                curve.speed * _RPM, np.abs(curve.vectors), curve.line, color=curve.colour, lw=1.0, label=curve.label
            )
            e = np.nan_to_num(curve.vectors)
            lags = np.arange(1, min(ROW_LAGS, len(e) - 1) + 1)
            square = max(float(np.vdot(e, e).real), 1e-300)
            r = [float(np.vdot(e[:-k], e[k:]).real) / square for k in lags]
            alike.plot(lags, r, curve.line, color=curve.colour, marker=".")
        count = int(np.isfinite(rows[0].vectors).sum())
        band = 1.96 / np.sqrt(2 * max(count, 1))
        alike.axhspan(-band, band, color=INK, alpha=0.12, lw=0, label="white noise, 95 %")
        over.axhline(np.sqrt(2.0), color=INK, lw=0.8, ls="--", label="noise, rms")
        over.set(yscale="log", ylabel="|measured - simulated| / noise", xlabel="speed [rpm]")
        alike.set(ylabel="autocorrelation", xlabel="rows between")
        alike.xaxis.set_major_locator(MaxNLocator(integer=True))
        handles, more = over.get_legend_handles_labels(), alike.get_legend_handles_labels()
        made.legend(handles[0] + more[0], handles[1] + more[1], loc="outside lower center", ncols=4)
        return made


def _lag(vectors: np.ndarray, beside: np.ndarray | None) -> np.ndarray:
    """Return the phase lag [deg] without jumps of a turn, near that of another curve."""
    lag = -np.degrees(np.angle(vectors))
    there = np.isfinite(lag)
    lag[there] = np.unwrap(lag[there], period=360.0)
    if beside is None:
        middle = float(np.median(lag[there])) if there.any() else 0.0
        return np.asarray(lag - 360.0 * np.floor(middle / 360.0))
    off = np.nanmedian(lag - beside)
    return np.asarray(lag - 360.0 * np.round(off / 360.0))
