"""Time simulation, harmonic balance, linear analyses and their results."""

from __future__ import annotations

from rotorsim._lazy import callable_as, lazy

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
__getattr__, __dir__ = lazy(__name__, _HOME)

callable_as(__name__)
