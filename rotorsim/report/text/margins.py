"""Stability margins of bearing loops as text and data, modelled and measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from rotorsim.linear.control.margins import STANDARD, Axis, Margins
from rotorsim.report.text.table import rpm, table
from rotorsim.signals.injection.measured_margins import MeasuredAxis, MeasuredMargins

MARGIN_COLUMNS = (
    "peak |S|",
    "[dB]",
    "at [Hz]",
    "zone",
    "gain up",
    "gain down",
    "phase margin [deg]",
    "delay margin [ms]",
)


def margins_text(result: Margins) -> str:
    """Return the margins of all axes, and the verdict."""
    rows = [(axis.name, *_cells(axis)) for axis in result.axes]
    parts = [table(("injected at", *MARGIN_COLUMNS), rows), result.statement]
    if np.isfinite(result.singular_peak):
        parts.append(
            f"all axes together: largest singular value of S {result.singular_peak:.3g} "
            f"at {result.singular_peak_frequency:.4g} Hz"
        )
    return f"{parts[0]}\n\n" + "\n".join(parts[1:])


def measured_text(measured: MeasuredMargins, modelled: Margins | None, diagram: str) -> str:
    """Return the margins of all axes as measured, with their 90 % intervals; below each that of a diagram."""
    own = {} if modelled is None else {axis.name: axis for axis in modelled.axes}
    rows = []
    for axis in measured.axes:
        rows.append((axis.name, *_measured_cells(axis), "{:.4g} to {:.4g}".format(*axis.band)))
        if axis.name in own:
            rows.append((f"  {diagram}", *_cells(own[axis.name]), ""))
    header = ("injected at, intervals of 90 %", *MARGIN_COLUMNS, "measured [Hz]")
    parts = [condition_text(measured), table(header, rows), measured.statement]
    told = np.isfinite(measured.singular)
    if len(measured.axes) > 1 and told.any():
        k = int(np.nanargmax(measured.singular))
        parts.append(
            f"all axes together: largest singular value of S {measured.singular[k]:.3g} "
            f"at {measured.frequencies[k]:.4g} Hz"
        )
    return f"{parts[0]}\n{parts[1]}\n\n" + "\n".join(parts[2:])


def condition_text(measured: MeasuredMargins) -> str:
    """Return the runs, the speed and the settings of a condition."""
    speed = "speed not known" if measured.speed is None else f"{rpm(measured.speed):.5g} rpm"
    settings = "".join(f", {name} = {value}" for name, value in measured.settings.items())
    return f"{', '.join(measured.runs)}: {speed}{settings}"


def _cells(axis: Axis) -> tuple[str, ...]:
    if not np.isfinite(axis.peak):
        return ("-", "-", "-", axis.zone, "-", "-", "-", "-")
    return (
        f"{axis.peak:.3f}",
        f"{20 * np.log10(axis.peak):.1f}",
        f"{axis.frequency:.4g}",
        axis.zone,
        _factor(axis.gain_up, axis.gain_up_frequency),
        _factor(axis.gain_down, axis.gain_down_frequency),
        _at(axis.phase, axis.phase_frequency, 1.0),
        _at(axis.delay, axis.delay_frequency, 1e3),
    )


def _factor(value: float, frequency: float) -> str:
    return f"x {value:.3g} at {frequency:.4g} Hz" if np.isfinite(frequency) else "no limit"


def _at(value: float, frequency: float, factor: float) -> str:
    return f"{factor * value:.3g} at {frequency:.4g} Hz" if np.isfinite(value) else "no limit"


def _measured_cells(axis: MeasuredAxis) -> tuple[str, ...]:
    best, interval = axis.best, axis.interval90

    def with_interval(name: str, factor: float = 1.0) -> str:
        if name not in interval:
            return "no limit seen"
        value, half = getattr(best, name) * factor, (interval[name][1] - interval[name][0]) / 2 * factor
        return f"{value:.3g} +- {half:.2g} at {getattr(best, f'{name}_frequency'):.4g} Hz"

    low, high = interval["peak"]
    gains = (("x " if name in interval else "") + with_interval(name) for name in ("gain_up", "gain_down"))
    return (
        f"{best.peak:.3f} ({low:.3f} to {high:.3f})",
        f"{20 * np.log10(best.peak):.1f}",
        f"{best.frequency:.4g}",
        axis.zones,
        *gains,
        with_interval("phase"),
        with_interval("delay", 1e3),
    )


def margins_data(result: Margins, diagram: str, speed: float | None) -> dict[str, Any]:
    """Return all numbers of a diagram, SI, in the form of --json."""
    S = np.diagonal(result.sensitivity, axis1=1, axis2=2)
    return {
        "diagram": diagram,
        "standard": STANDARD,
        "speed": speed,
        "stable": result.stable,
        "sampled": result.sampled,
        "zone": result.zone,
        "axes": [{"name": axis.name, "zone": axis.zone, **_numbers(axis)} for axis in result.axes],
        "largest_singular_value": {"peak": result.singular_peak, "frequency": result.singular_peak_frequency},
        "frequencies": result.frequencies,
        "sensitivity": {axis.name: S[:, k] for k, axis in enumerate(result.axes)},
        "notes": list(result.notes),
    }


def measured_data(every: Sequence[MeasuredMargins], modelled: Sequence[dict[str, Any] | None]) -> dict[str, Any]:
    """Return all numbers that were measured, SI, and those of a diagram beside them, in the form of --json."""
    return {
        "recording": every[0].recording,
        "standard": STANDARD,
        "conditions": [
            {
                "runs": list(one.runs),
                "speed": one.speed,
                "set": dict(one.settings),
                "axes": [_measured_axis(axis) for axis in one.axes],
                "judged_up_to": one.highest,
                "lines": [{"frequency": line.frequency, "amplitude": list(line.amplitude)} for line in one.lines],
                "notes": list(one.notes),
            }
            | ({} if beside is None else {"modelled": beside})
            for one, beside in zip(every, modelled, strict=True)
        ],
    }


def _measured_axis(axis: MeasuredAxis) -> dict[str, Any]:
    there = axis.measured
    return {
        "name": axis.name,
        "zones": axis.zones.split(" or "),
        **_numbers(axis.best),
        "interval90": {name: list(ends) for name, ends in axis.interval90.items()},
        "frequencies": axis.frequencies[there],
        "sensitivity": axis.sensitivity[there],
        "half_width90": axis.half_width[there],
        "coherence": axis.coherence[there],
    }


def _numbers(axis: Axis) -> dict[str, float]:
    return {item.name: getattr(axis, item.name) for item in fields(axis) if item.name not in ("name", "zone")}
