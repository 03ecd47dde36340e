"""Order vectors over the speed as text and data: what was tracked, critical speeds, separation margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.files import json_number
from rotorsim.recordings.orders import OrderChannel, OrderRecording, OrderRun
from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.text.table import counted, display_unit, rpm, table
from rotorsim.signals.orders.critical_speeds import CriticalSpeed, CriticalSpeeds
from rotorsim.signals.orders.resonance import RESPONSIVE, Peak, peak_in, unmeasured
from rotorsim.units import conversion

WHIRLS = ((0.2, "forward"), (-0.2, "planar"), (-np.inf, "backward"))  # from which share of a circle
SHOWN_CHANNELS = 4
ONE_WAY = 0.8  # of the range of its speeds, between the first and the last row of a run-up or coast-down
Operating = tuple[float, float]  # lowest and highest speed [rad/s]


def run_text(run: OrderRun) -> str:
    """Return what a run is, in one line."""
    first, last = rpm(run.speed[0]), rpm(run.speed[-1])
    if run.noise is not None:
        given = "".join(f", {name}={value}" for name, value in run.settings.items())
        return f"{run.id}: {counted(len(run.speed), 'run')} at constant speeds, {first:.5g} to {last:.5g} rpm{given}"
    what = "run-up" if last > first else "coast-down"
    if wanders(run):
        what, first, last = "speed rises and falls", rpm(run.speed.min()), rpm(run.speed.max())
    return (
        f"{run.id}: {what}, {first:.5g} to {last:.5g} rpm, {counted(len(run.speed), 'row')} of {turns_text(run.turns)}"
    )


def turns_text(turns: int) -> str:
    """Return ``1 turn`` or ``4 turns``."""
    return counted(turns, "turn")


def peaks_text(run: OrderRun, channels: Mapping[str, OrderChannel]) -> str:
    """Return the largest amplitude of each channel, as it is read off the curve."""
    lines = []
    for name, channel in channels.items():
        unit, factor = shown_unit(channel)
        size = np.abs(run.vectors.get(name, np.empty(0)))
        if not np.isfinite(size).any():
            lines.append([channel.label, "not measured", *["-"] * 4])
            continue
        peak, amplitude = largest_of(run, name)
        numbers = (rpm(peak.lower), rpm(peak.upper), peak.amplification)
        sides = [
            f"{value:.{digits}g}" if np.isfinite(value) else "-"
            for value, digits in zip(numbers, (5, 5, 3), strict=True)
        ]
        lines.append([channel.label, f"{factor * from_peak(amplitude):.4g} {unit}", f"{rpm(peak.speed):.5g}", *sides])
    return table(["as recorded", of_amplitude("largest"), "at [rpm]", "N1", "N2", "AF"], lines)


def shown_unit(channel: OrderChannel) -> tuple[str, float]:
    """Return the unit in which amplitudes of a channel are shown, as it was stated, and the factor from SI."""
    if channel.unit == "m":
        return display_unit("m")
    return channel.unit, 1.0 / conversion(channel.unit, None)


def largest_of(run: OrderRun, name: str) -> tuple[Peak, float]:
    """Return the peak of a channel as read off its curve over the speed, and its amplitude."""
    order = np.argsort(run.speed, kind="stable")
    size = np.abs(run.vectors[name])[order]
    at = int(np.nanargmax(size))
    peak = peak_in(run.speed[order], size, at)
    if wanders(run):  # up and down are two curves
        peak = Peak(float(run.speed[order][at]), np.nan, np.nan)
    return peak, float(size[at])


def wanders(run: OrderRun) -> bool:
    """Return whether the speed of a run both rises and falls, so that it is neither run-up nor coast-down."""
    return bool(abs(run.speed[-1] - run.speed[0]) < ONE_WAY * np.ptp(run.speed))


def critical_text(found: CriticalSpeeds, channels: Mapping[str, OrderChannel], operating: Operating | None) -> str:
    """Return the critical speeds of one order of a run."""
    head = f"{found.order}X: "
    operating = operating if found.order == 1 else None  # margins are of what unbalance drives
    lacks = "" if operating is None else f"\n{gaps_text(found, operating)}".rstrip()
    if not found.found:
        between = f"between {rpm(found.speed.min()):.5g} and {rpm(found.speed.max()):.5g} rpm"
        if found.explained:
            return head + f"no critical speed {between}{lacks}"
        what = f"linear modes leave {found.excess:.3g} times the variance of the noise"
        return head + f"no critical speed is told {between}: {what}{lacks}"
    shown = [name for name in channels if name in found.found[0].vectors][:SHOWN_CHANNELS]
    columns = [of_amplitude(channels[name].name) for name in shown]
    margins = [] if operating is None else ["SM", "required", ""]
    lines = []
    for one in found.found:
        af = f"{one.peak.amplification:.3g} +- {Z90 * one.std['amplification']:.2g}"
        cells = [f"{rpm(one.peak.speed):.6g} +- {Z90 * rpm(one.std['speed']):.2g}", af]
        cells += [f"{rpm(one.peak.lower):.5g}", f"{rpm(one.peak.upper):.5g}", _damping_text(one), whirl_text(one)]
        for name in shown:
            unit, factor = shown_unit(channels[name])
            cells.append(f"{factor * from_peak(abs(one.vectors[name])):.3g} {unit}")
        lines.append(cells + ([] if operating is None else margin_cells(one, operating)))
    header = [head + "N_c [rpm], 90 %", "AF, 90 %", "N1", "N2", "damping, 90 %", "whirl", *columns, *margins]
    text = table(header, lines)
    if not found.explained:
        text += f"\nthe modes leave {found.excess:.3g} times the variance of the noise: intervals are wider for it"
    return text + lacks


def _damping_text(one: CriticalSpeed) -> str:
    return f"{one.damping:.3g} +- {Z90 * one.std['damping']:.2g}"


def gaps_text(found: CriticalSpeeds, operating: Operating) -> str:
    """Return at which speeds a critical speed might be too near, and none can have been seen; "" where at none."""
    gaps = _gaps(found, operating)
    if not gaps:
        return ""
    spans = " and ".join(f"{rpm(a):.5g} to {rpm(b):.5g} rpm" for a, b in gaps)
    return f"not judged: {spans}, where a critical speed might be too near: the run does not pass there"


def _gaps(found: CriticalSpeeds, operating: Operating) -> list[tuple[float, float]]:
    return unmeasured(float(found.speed.min()), float(found.speed.max()), *operating)


def whirl_text(one: CriticalSpeed) -> str:
    """Return "forward", "backward", "planar", or "-" where two axes were not measured."""
    if not np.isfinite(one.whirl):
        return "-"
    return next(word for least, word in WHIRLS if one.whirl > least)


def margin_cells(one: CriticalSpeed, operating: Operating) -> list[str]:
    """Return actual and required margin and the verdict."""
    margin, verdict = one.separation(*operating)
    needed = "none" if one.peak.amplification < RESPONSIVE else f"{margin.required:.3g} %"
    return [f"{margin.actual:.3g} %", needed, verdict]


def orders_data(
    recording: OrderRecording, criticals: Sequence[CriticalSpeeds], operating: Operating | None
) -> dict[str, Any]:
    """Return all that was tracked and found, SI, in the form of --json."""
    runs = {
        run.id: {
            "turns": run.turns,
            "constant_speed": run.noise is not None,
            "time": None if run.time is None else run.time.tolist(),
            "speed": run.speed.tolist(),
            "vectors": {
                name: {"re": _numbers(v.real), "im": _numbers(v.imag)}
                for name, v in run.vectors.items()
                if name in recording.channels
            },
        }
        for run in recording.runs
    }
    channels = {name: {"signal": one.name, "order": one.order} for name, one in recording.channels.items()}
    return {
        "recording": recording.name,
        "slow_roll": "included" if recording.slow_roll else "subtracted",
        "channels": channels,
        "runs": runs,
        "critical_speeds": [_critical_data(found, operating) for found in criticals],
    }


def _critical_data(found: CriticalSpeeds, operating: Operating | None) -> dict[str, Any]:
    return {
        "run": found.run,
        "order": found.order,
        "excess_variance": found.excess,
        "explained": found.explained,
        "slow_roll": {name: {"re": v.real, "im": v.imag} for name, v in found.slow_roll.items()},
        "found": [
            {
                "speed": one.peak.speed,
                "lower": one.peak.lower,
                "upper": one.peak.upper,
                "amplification": one.peak.amplification,
                "frequency": one.frequency,
                "damping_ratio": one.damping,
                "std": dict(one.std),
                "interval90": {name: list(one.interval90(name)) for name in ("speed", "amplification", "damping")},
                "whirl": one.whirl if np.isfinite(one.whirl) else None,
                "amplitude": {name: abs(value) for name, value in one.vectors.items()},
            }
            | ({} if operating is None or found.order != 1 else _margin_data(one, operating))
            for one in found.found
        ],
    } | ({} if operating is None or found.order != 1 else {"not_passed": _gaps(found, operating)})


def _margin_data(one: CriticalSpeed, operating: Operating) -> dict[str, Any]:
    margin, verdict = one.separation(*operating)
    return {"separation_margin": {"actual": margin.actual, "required": margin.required, "verdict": verdict}}


def _numbers(values: np.ndarray) -> list[float | str | None]:
    return [json_number(float(value)) for value in values]
