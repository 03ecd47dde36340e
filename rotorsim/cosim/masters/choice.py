"""The masters by name."""

from __future__ import annotations

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.masters.explicit import GaussSeidel, Jacobi
from rotorsim.cosim.masters.iterative import Iterative
from rotorsim.cosim.masters.master import Master, Settings
from rotorsim.cosim.masters.stepping import SteppingMaster
from rotorsim.cosim.masters.waveform import Waveform
from rotorsim.cosim.participant import Participant
from rotorsim.errors import Problem, RotorsimError

_STEPPING: dict[str, type[Jacobi | GaussSeidel | Iterative]] = {
    kind.name: kind for kind in (Jacobi, GaussSeidel, Iterative)
}
_MASTERS: dict[str, type[Master]] = {**_STEPPING, Waveform.name: Waveform}


def make_master(name: str, coupling: Coupling[Participant], settings: Settings) -> Master:
    """Return a master. Raises RotorsimError for unknown names, orders, and rates that it cannot keep."""
    if name not in _MASTERS:
        raise RotorsimError(Problem(f"no master '{name}'", hint=f"one of {', '.join(_MASTERS)}"))
    return _MASTERS[name](coupling, settings)


def make_stepping_master(name: str, coupling: Coupling[Participant], settings: Settings) -> SteppingMaster:
    """Return a master that goes step by step. Raises RotorsimError."""
    if name not in _STEPPING:
        raise RotorsimError(Problem(f"master {name} takes no steps", hint=f"one of {', '.join(_STEPPING)}"))
    return _STEPPING[name](coupling, settings)
