"""Bode plots of order vectors over the speed: measured beside simulated, and what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorsim.identification.in_orders import OrderIdentification, OrdersBeside
from rotorsim.recordings.orders import OrderRecording
from rotorsim.report.identification.parameters import heading
from rotorsim.report.style import BLUE, GREEN, INK, ORANGE, PURPLE, RED, figure, styled
from rotorsim.units import conversion

_RPM = 30 / np.pi
LINE_COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE)
LEAST_AMPLITUDE = 3.0  # times the noise, below which a phase is none


@dataclass(frozen=True)
class Curve:
    """Order vectors (n,), complex, SI, over speeds (n,) [rad/s]; line: how they are drawn."""

    label: str
    speed: np.ndarray
    vectors: np.ndarray
    line: str = "-"


def bode_figure(measured: Curve, simulated: Sequence[Curve], title: str, unit: str, noise: float) -> Figure:
    """Return amplitude 0-peak, phase lag and what is left of order vectors over the speed.

    unit: in which they are shown. noise: standard deviation of their real parts; a phase is shown where the amplitude
    is three times that.
    """
    with styled():
        made = figure(8.0, 7.6, title)
        amplitude, phase, left = made.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
        factor = 1.0 / conversion(unit, None)
        looks: list[tuple[Curve, dict[str, Any]]] = [
            (measured, {"color": INK, "marker": ".", "markersize": 4.0, "linewidth": 0.5})
        ]
        looks += [
            (one, {"color": LINE_COLOURS[k % len(LINE_COLOURS)], "linewidth": 1.3, "linestyle": one.line})
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
        amplitude.set_ylabel(f"amplitude [{unit}, 0-peak]")
        phase.set_ylabel("phase lag [deg]")
        left.set_ylabel(f"|measured - simulated| [{unit}]")
        left.set_xlabel("speed [rpm]")
        handles = amplitude.get_legend_handles_labels()
        more = left.get_legend_handles_labels()
        made.legend(handles[0] + more[0], handles[1] + more[1], loc="outside lower center", ncols=2)
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


def order_figures(identification: OrderIdentification, recording: OrderRecording) -> dict[str, Figure | None]:
    """Return a Bode plot of every run and channel."""
    title = heading(identification, recording)
    made: dict[str, Figure | None] = {}
    for item in identification.runs:
        for k, (label, vectors) in enumerate(item.measured.items(), 1):
            use = "" if item.use == "identify" else ", held out"
            made[f"orders_{item.run.id}_{k}"] = bode_figure(
                Curve("measured", item.run.speed, vectors),
                [Curve("order-tracked simulation", item.run.speed, item.simulated[label])],
                f"{label}, run {item.run.id}{use}: {title}",
                identification.units[label],
                identification.noise[label],
            )
    return made


def beside_figure(found: OrdersBeside, title: str) -> Figure:
    """Return the Bode plot of a diagram as it is beside the first channel of a run."""
    label, vectors = next(iter(found.compared.measured.items()))
    speed = found.compared.run.speed
    simulated = Curve("order-tracked simulation", speed, found.compared.simulated[label])
    title = f"{label}, {title}"
    return bode_figure(Curve("measured", speed, vectors), [simulated], title, found.units[label], found.noise[label])
