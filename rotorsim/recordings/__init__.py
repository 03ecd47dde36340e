"""Recordings of machines: reading and writing measurement files, and checking the signals in them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOME = {
    "Channel": "recording",
    "Run": "recording",
    "Recording": "recording",
    "load_recording": "loading",
    "save_recording": "writing",
    "NewRun": "writing",
    "check_signals": "checks",
    "recording_schema": "document",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name in _HOME:
        value = getattr(import_module(f"rotorsim.recordings.{_HOME[name]}"), name)
        globals()[name] = value  # found at once next time
        return value
    raise AttributeError(f"module 'rotorsim.recordings' has no attribute '{name}'")
