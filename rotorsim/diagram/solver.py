"""How a diagram is simulated: the methods by name, step, tolerances. Light, so that the command line starts fast."""

from __future__ import annotations

from dataclasses import dataclass

# methods that choose their own steps -> their names in scipy.integrate
ADAPTIVE = {"dop853": "DOP853", "rk45": "RK45", "radau": "Radau", "bdf": "BDF", "lsoda": "LSODA"}
SOLVER_METHODS = ("rk4", *ADAPTIVE)


@dataclass(frozen=True)
class Solver:
    """How to simulate: method ``rk4`` or an adaptive one, step [s], stop time [s], tolerances."""

    method: str = "rk4"
    step: float = 1e-4
    stop: float = 1.0
    record_every: int = 1
    rtol: float = 1e-8
    atol: float = 1e-12
