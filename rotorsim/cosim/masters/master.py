"""What a master of a co-simulation does: start the participants, and bring them to the end of the run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.participant import Participant
from rotorsim.errors import RotorsimError


@dataclass(frozen=True)
class Settings:
    """order: of the polynomial of the signals (None: the master's own); tolerance: of iterations, relative.

    rates: how many base steps each participant takes at once; (): all one.
    """

    order: int | None = None
    tolerance: float = 1e-8
    rates: Sequence[int] = ()


@dataclass(frozen=True)
class Schedule:
    """Communication steps [s] until the end [s]; adaptive: relative error allowed per step, None: fixed steps.

    fast: the loop in C is asked for, whatever it does differently. progress: gets the share that is done.
    """

    step: float
    end: float
    adaptive: float | None = None
    fast: bool = False
    progress: Callable[[float], None] | None = None

    def report(self, share: float) -> None:
        """Tell how much is done."""
        if self.progress is not None:
            self.progress(share)


@dataclass(frozen=True)
class Trajectory:
    """Communication points: times (n,) [s], outputs (n, n_y); mismatch (n,): relative, of the inputs of each step.

    failure: what ended the run early.
    """

    times: np.ndarray
    rows: np.ndarray
    mismatch: np.ndarray | None = None
    failure: RotorsimError | None = None


class Master(ABC):
    """Advances the participants of a coupling. counters: steps, participant_steps, iterations, rejected.

    order: of the polynomial of the inputs within a step. in_steps: it goes step by step, so that its linearised loop
    can be analysed; else it repeats the whole run.
    """

    name: str
    in_steps = True

    def __init__(self, coupling: Coupling[Participant], settings: Settings) -> None:
        self.coupling, self.tolerance = coupling, settings.tolerance
        self.rates = tuple(settings.rates or [1] * len(coupling.participants))
        self.counters = {"steps": 0, "participant_steps": 0, "iterations": 0, "rejected": 0}

    @property
    @abstractmethod
    def order(self) -> int:
        """The order of the inputs within a step, as it is reported."""

    def start(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Initialise all participants at t with inputs that agree with their outputs; return u (n_u,) and y (n_y,).

        Until outputs are known an FMU has the start values of its inputs: zero may be no value for it.
        """
        coupling = self.coupling
        own = list(zip(coupling.participants, coupling.u_parts, strict=True))
        u = coupling.u0.copy()
        for participant, part in own:
            u[part] += 0.0 if participant.u_starts is None else participant.u_starts
        for participant, part in own:
            participant.initialise(t, u[part])
        u, _ = coupling.consistent(t, u)
        for participant, part in own:
            participant.start(t, u[part])
        return coupling.consistent(t, u)

    @abstractmethod
    def run(self, schedule: Schedule, first: np.ndarray) -> Trajectory:
        """Go from 0, where the outputs are ``first`` (n_y,), to the end. Raises RotorsimError without result."""
