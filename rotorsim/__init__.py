"""Block diagrams, FMUs and diagnosis for rotors in active magnetic bearings.

import rotorsim
diagram = rotorsim.load("jeffcott")
result = rotorsim.simulate(diagram, parameters={"speed": "1500 rpm"})
result.plot().savefig("jeffcott.png")
"""

from __future__ import annotations

from rotorsim._lazy import lazy

_HOME = {
    "load": "diagram",
    "simulate": "simulate",
    "periodic": "simulate",
    "linearise": "simulate",
    "modes": "simulate",
    "campbell": "simulate",
    "frequency_response": "simulate",
    "sensitivity": "simulate",
    "identify": "identify",
    "diagnose": "diagnose",
    "load_recording": "recordings",
    "Result": "simulate",
    "RotorsimError": "errors",
    "Block": "block",
}
__all__ = ["__version__", *_HOME]
__version__ = "0.1.0"
__getattr__, __dir__ = lazy(__name__, _HOME)
