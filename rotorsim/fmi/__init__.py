"""Functional mock-up units: export of diagrams and parts of them, import, co-simulation."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOME = {
    "export_fmu": "export",
    "open_fmu": "slave",
    "cosimulate": "cosimulation",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name in _HOME:
        value = getattr(import_module(f"rotorsim.fmi.{_HOME[name]}"), name)
        globals()[name] = value  # found at once next time
        return value
    raise AttributeError(f"module 'rotorsim.fmi' has no attribute '{name}'")
