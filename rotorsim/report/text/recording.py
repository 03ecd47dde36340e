"""What is in a recording, as data and in a line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rotorsim.report.text.table import counted, rpm

if TYPE_CHECKING:
    from rotorsim.recordings.recording import Recording


def contents(recording: Recording) -> dict[str, Any]:
    """Return what is in a recording: channels, runs, those held out, speeds [rad/s], settings that differ."""
    speeds = [run.speed for run in recording.runs if run.speed is not None]
    names = list(dict.fromkeys(name for run in recording.runs for name in run.settings))
    settings = [run.settings for run in recording.runs]
    different = [one for k, one in enumerate(settings) if one not in settings[:k]]
    return {
        "channels": len(recording.channels),
        "runs": len(recording.runs),
        "hold_out": len(recording.select("hold_out")),
        "speed_low": min(speeds, default=None),
        "speed_high": max(speeds, default=None),
        "settings": len(different) if names else 0,
        "set": names,
    }


def contents_line(data: dict[str, Any]) -> str:
    """Return `contents` as words: ``4 channels, 9 runs (1 held out), 1140 to 1620 rpm, 2 sets of controller.KP``."""
    held = f" ({data['hold_out']} held out)" if data["hold_out"] else ""
    parts = [counted(data["channels"], "channel"), counted(data["runs"], "run") + held]
    if data["speed_low"] is not None:
        ends = dict.fromkeys(f"{rpm(data[key]):.6g}" for key in ("speed_low", "speed_high"))
        parts.append(f"{' to '.join(ends)} rpm")
    if data["settings"]:
        shown = " and ".join(data["set"]) if len(data["set"]) < 3 else f"{len(data['set'])} parameters"
        parts.append(f"{counted(data['settings'], 'set')} of {shown}")
    return ", ".join(parts)
