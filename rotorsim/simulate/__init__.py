"""Time simulation, harmonic balance, linear analyses and their results."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOME = {
    "simulate": "run",
    "Result": "result",
    "save": "files",
    "load_result": "files",
    "periodic": "periodic_motion",
    "linearise": "linear",
    "equilibrium": "linear",
    "modes": "eigenmodes",
    "campbell": "campbell_diagram",
    "frequency_response": "frequency",
    "sensitivity": "frequency",
    "design_state_feedback": "design",
    "full_spectrum": "spectrum",
    "harmonics": "spectrum",
    "reconstruction_error": "spectrum",
    "envelope": "envelopes",
    "run_up": "envelopes",
    "resonance_peaks": "envelopes",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: scipy need not be loaded to run a fixed-step simulation."""
    if name in _HOME:
        value = getattr(import_module(f"rotorsim.simulate.{_HOME[name]}"), name)
        globals()[name] = value  # found at once next time
        return value
    raise AttributeError(f"module 'rotorsim.simulate' has no attribute '{name}'")
