"""The mode of an FMU for Model Exchange in a run that carries its events out (`rotorsim.model.mode.Mode`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorsim.fmi.equations import FmuEquations
from rotorsim.fmi.runtime.memory import Said
from rotorsim.fmi.runtime.model_exchange import SAVED_STATES
from rotorsim.fmi.runtime.slave import Slave


@dataclass(frozen=True)
class SavedMode:
    """Where the events were; epoch: of the state of the FMU itself."""

    sides: np.ndarray
    due: float
    epoch: int


class FmuMode:
    """The mode of the instance with some parameters (n_p,) that these equations come from.

    FMI 2.0.4, section 3.2.2: discrete states change in event mode only, so that between two events, and completed steps
    that it wants to be told of, an FMU is a function of time, states and inputs.
    """

    def __init__(self, equations: FmuEquations, parameters: np.ndarray) -> None:
        self._equations, self._p = equations, np.array(parameters, float)
        kind = equations.description.kinds["me"]
        self._saves = kind.can_get_set_state
        self.n_indicators = equations.description.n_events
        self.reports = kind.completed_step_needed
        self.due = np.inf
        self._epoch = self._epochs = 0  # grows with every change of the FMU
        self._handles: dict[int, int] = {}  # of saved states, by epoch

    @property
    def can_go_back(self) -> bool:
        """Whether what was saved can be restored: nothing has changed, or the FMU saves its state."""
        return self._saves or not self._epochs

    def begin(self) -> None:
        """Take the mode in which the FMU begins."""
        _, self.due = self._equations.mode(self._p)

    def end(self) -> None:
        """Guard the equations again; an instance that has changed is not used any more."""
        self.guard(True)
        if self._epochs:
            self._equations.discard(self._p)

    def guard(self, on: bool) -> None:
        """Say whether the equations end where an event is due."""
        self._equations.guard(on)

    def inputs(self) -> np.ndarray:
        """Return the inputs at the present point, as the FMU has them."""
        return self._equations.seen[: self._equations.n_u].copy()

    def indicators(self) -> np.ndarray:
        """Return the event indicators (n_indicators,) at the present point."""
        return self._equations.seen[self._equations.n_u :].copy()

    def sides(self) -> np.ndarray:
        """Return which indicators are above zero in the mode."""
        return self._equations.mode(self._p)[0]

    def settle(self) -> None:
        """Take the sides at the present point as those of the mode."""
        self._equations.set_mode(self._p, self.indicators() > 0, self.due)

    def completed(self, t: float, x: np.ndarray) -> bool:
        """Tell the FMU that a step is accepted; return whether it wants an event. Raises FmuError."""
        slave = self._changing()
        wants = slave.completed_step(t, x, self.inputs())
        if slave.ended:
            raise slave.end_asked(t)
        return wants

    def completed_callback(self) -> tuple[int, int] | None:
        """Return the function of equations.c that tells the FMU, and its context."""
        return self._equations.completed_callback(self._p)

    def completed_result(self, t: float, said: int) -> bool:
        """Take what the FMU said when it was told of the last of some steps. Raises FmuError where it wants the end."""
        slave = self._changing()
        if said == Said.PENDING:
            said = slave.completed_pending(t)
        wants = slave.completed_step(t, None, self.inputs()) if said == Said.UNTOLD else slave.completed_said(t, said)
        if slave.ended:
            raise slave.end_asked(t)
        return wants

    def event(self, t: float, x: np.ndarray) -> np.ndarray:
        """Carry out an event and return the states after it. Raises FmuError, also where it ends the simulation."""
        slave = self._changing()
        update = slave.event_update(t, x, self.inputs())
        if update.terminate:
            raise slave.end_asked(t)
        self.due = update.next_time
        return slave.states()

    def _changing(self) -> Slave:
        """Return the instance, which changes now."""
        self._epoch = self._epochs = self._epochs + 1
        return self._equations.at_work(self._p)

    def save(self) -> SavedMode:
        """Return sides, the time event that is due, and the state of the FMU, saved once between two changes."""
        if self._saves and self._epoch not in self._handles:
            slave = self._equations.at_work(self._p)
            self._handles[self._epoch] = slave.save_state()
            if len(self._handles) > SAVED_STATES:  # the first is that of the start, which may be come back to
                slave.free_state(self._handles.pop(list(self._handles)[1]))
        return SavedMode(self.sides(), self.due, self._epoch)

    def restore(self, saved: SavedMode) -> None:
        """Go back to a saved mode. Raises FmuError where the FMU has changed since and cannot be set back."""
        if saved.epoch != self._epoch:
            slave = self._equations.at_work(self._p)
            if saved.epoch not in self._handles:
                what = "cannot be taken back over an event: it does not let its state be saved"
                raise slave.step_failed("-", what, "refused", slave.time)
            slave.restore_state(self._handles[saved.epoch])
            self._epoch = saved.epoch
        self.due = saved.due
        self._equations.set_mode(self._p, saved.sides, saved.due)
