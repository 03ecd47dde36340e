"""What a run says in a few lines: peaks, and harmonics of two-axis signals at constant speed."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotorsim.simulate.result import Result
from rotorsim.simulate.spectrum import DEFAULT_ORDERS, harmonics, last_turns

__all__ = ["summarise", "summary_text", "two_axes"]

ANGLE = "clock.theta"


def summarise(result: Result) -> dict[str, Any]:
    """Return status, peaks and, at constant speed, harmonics R_k of every two-axis signal (0-peak).

    Harmonics are fitted over the last whole turns in the last fifth of the run. Of signals (nodes, 2) every
    node is listed.
    """
    summary: dict[str, Any] = {
        "diagram": result.provenance.get("diagram", ""),
        "status": result.status,
        "message": result.message,
        "end_time": float(result.time[-1]) if len(result.time) else 0.0,
        "signals": {
            name: {"unit": result.units.get(name, ""), "peak": float(np.abs(array).max()) if array.size else None}
            for name, array in result.signals.items()
        },
        "counters": dict(result.counters),
        "provenance": dict(result.provenance),
    }
    window = _window(result)
    if window is None:
        return summary
    summary["window"] = list(window)
    for name in two_axes(result):
        found = harmonics(result, name, DEFAULT_ORDERS, window=window)
        summary.setdefault("harmonics", {})[name] = [
            {"order": k, "amplitude": abs(value), "phase_deg": float(np.degrees(np.angle(value)))}
            for k, value in zip(found.orders, found.values.tolist(), strict=True)
        ]
    return summary


def _window(result: Result) -> tuple[float, float] | None:
    """Return the last turns, or None where the speed is not constant or less than one turn was recorded."""
    if ANGLE not in result or len(result.time) < 64 or result.status != "finished":
        return None
    theta = result[ANGLE]
    rates = np.diff(theta)
    if theta[-1] - theta[0] < 2 * np.pi or np.ptp(rates) > 1e-6 * abs(rates[-1]):
        return None
    return last_turns(result)


def two_axes(result: Result) -> list[str]:
    """Return the two-axis signals by name; of (nodes, 2) every node that moves."""
    found = []
    for name, array in result.signals.items():
        if array.ndim == 2 and array.shape[1] == 2:
            found.append(name)
        elif array.ndim == 3 and array.shape[2] == 2:
            moving = np.abs(array).max(axis=(0, 2)) > 0
            found += [f"{name}[{node + 1}]" for node in np.flatnonzero(moving)]
    return found


def summary_text(summary: dict[str, Any]) -> str:
    """Return a summary as text: a table of harmonics as thesis Table 2-2, or the peaks."""
    lines = []
    if "harmonics" in summary:
        start, stop = summary["window"]
        lines.append(f"{summary['diagram']}: harmonics of the shaft angle, {start:.4g} to {stop:.4g} s, 0-peak")
        for name, rows in summary["harmonics"].items():
            unit = summary["signals"].get(name, summary["signals"].get(name.partition("[")[0], {})).get("unit", "")
            scale, shown = (1e6, "um") if unit == "m" else (1.0, unit)
            lines += ["", f"{name}", f"{'order':>6} {f'amplitude [{shown}]':>16} {'phase [deg]':>12}"]
            lines += [f"{r['order']:>6} {r['amplitude'] * scale:>16.5g} {r['phase_deg']:>12.2f}" for r in rows]
        return "\n".join(lines)
    lines.append(f"{summary['diagram']}: largest values until {summary['end_time']:.4g} s")
    for name, entry in summary["signals"].items():
        peak = "-" if entry["peak"] is None else f"{entry['peak']:.6g}"
        lines.append(f"  {name:<32} {peak:>14} {entry['unit']}")
    return "\n".join(lines)
