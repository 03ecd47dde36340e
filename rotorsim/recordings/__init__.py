"""Recordings of machines: reading and writing measurement files, and checking the signals in them."""

from __future__ import annotations

from rotorsim._lazy import lazy

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
__getattr__, __dir__ = lazy(__name__, _HOME)
