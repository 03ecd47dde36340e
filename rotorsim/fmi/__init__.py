"""Functional mock-up units: export of diagrams and parts of them, import, co-simulation."""

from __future__ import annotations

from rotorsim._lazy import lazy

_HOME = {
    "export_fmu": "export",
    "open_fmu": "slave",
    "cosimulate": "cosimulation",
}
__all__ = list(_HOME)
__getattr__, __dir__ = lazy(__name__, _HOME)
