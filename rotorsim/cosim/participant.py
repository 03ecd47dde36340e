"""Who takes part in a co-simulation, as one interface: a compiled part of the diagram, an FMU, a linear model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from rotorsim.cosim.inputs import InputHistory
from rotorsim.cosim.loop import LoopMember
from rotorsim.errors import RotorsimError
from rotorsim.linear.linear_model import LinearModel


class Participant(ABC):
    """A subsystem that a master advances from one communication point to the next.

    inputs, outputs: flat names, in the order of the vectors u (n_u,) and y (n_y,). feedthrough: (n_y, n_u), whether an
    output follows an input at the same instant. moving (n_y,): outputs that change between sample hits by themselves;
    following (n_y, n_u): those that move when an input does. blocks: of the diagram, that it stands for.
    The order of calls: `initialise`, `output` until the inputs fit, `start`, steps.
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    blocks: tuple[str, ...] = ()
    feedthrough: np.ndarray
    moving: np.ndarray
    following: np.ndarray
    can_restore: bool = True  # a step can be taken back
    has_rates: bool = True  # it tells the rates of its outputs
    equal_steps: bool = False  # all its steps must have one length
    stop: float | None = None  # time [s] that no step goes beyond, None: there is none
    method: str = "rk4"  # that integrates the states of an FMU for Model Exchange
    do_steps: int = 0  # of an FMU for Co-Simulation, and of one step of the master at most
    most_parts: int = 0
    u_starts: np.ndarray | None = None  # (n_u,) inputs with which it is initialised first; None: zero
    u_scales: np.ndarray | None = None  # (n, 2): SI = factor * value in loop.c + offset; None: all are SI
    y_scales: np.ndarray | None = None

    @abstractmethod
    def initialise(self, t: float, u: np.ndarray) -> None:
        """Begin at time t with inputs u, which may still change; sample hits wait for `start`."""

    @abstractmethod
    def start(self, t: float, u: np.ndarray) -> None:
        """End the initialisation with inputs u: sample hits due at t are carried out."""

    @abstractmethod
    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        """Return the outputs of the present state for inputs u."""

    @abstractmethod
    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return the rates of the outputs of the present state, for inputs u that move at a rate."""

    @abstractmethod
    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        """Advance from t to t + h with inputs u(tau); return the outputs there for the inputs u(h)."""

    @abstractmethod
    def next_hit(self, t: float) -> float:
        """Return the time of the next sample hit after t that it knows of, infinity if there is none."""

    @abstractmethod
    def save(self) -> Any:
        """Return the state, to be given to `restore`."""

    @abstractmethod
    def restore(self, saved: Any) -> None:
        """Go back to a saved state."""

    @abstractmethod
    def linear(self, used: np.ndarray) -> LinearModel | str:
        """Return the linearisation at the present state, or why there is none. used (n_y,): outputs others take."""

    def in_loop(self) -> LoopMember | None:
        """Return what takes its place in loop.c, which holds inputs; None where that is not possible."""
        return None

    @property
    def loop_is_exact(self) -> bool:
        """Whether its steps in loop.c are those that it takes itself."""
        return False

    @property
    def has_log(self) -> bool:
        """Whether its messages are wanted as they come."""
        return False

    def unstable_step(self) -> str:
        """Return why the steps that were taken give no solution, or "" (see `ModelExchange`)."""
        return ""

    def final(self) -> np.ndarray:
        """Return the outputs (n_y,) as they are, whatever it is at. Raises RotorsimError."""
        raise RotorsimError(f"{self.name} does not end a run by itself")

    def report(self) -> dict[str, Any] | None:
        """Return what is to be known of its run as an FMU, None where it is none."""
        return None

    def close(self) -> None:
        """Free what it holds."""
        return
