"""Block diagrams, FMUs and diagnosis for rotors in active magnetic bearings.

import rotorsim
diagram = rotorsim.load("jeffcott")
result = rotorsim.simulate(diagram, parameters={"speed": 2 * np.pi * 25})
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOME = {
    "load": "rotorsim.diagram",
    "simulate": "rotorsim.simulate",
    "periodic": "rotorsim.simulate",
    "linearise": "rotorsim.simulate",
    "modes": "rotorsim.simulate",
    "campbell": "rotorsim.simulate",
    "frequency_response": "rotorsim.simulate",
    "sensitivity": "rotorsim.simulate",
    "Result": "rotorsim.simulate",
    "RotorsimError": "rotorsim.errors",
    "Block": "rotorsim.block",
}
__all__ = ["__version__", *_HOME]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that the command line starts fast."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'rotorsim' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
