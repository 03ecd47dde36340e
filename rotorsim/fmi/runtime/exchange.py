"""Steps of an instance: Co-Simulation and Model Exchange, each by one call into the FMU's process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rotorsim.fmi.runtime.binding import CallError, status_error
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.instance import Instance, is_finite
from rotorsim.fmi.runtime.memory import Block, Head, Op, Said
from rotorsim.fmi.runtime.runs import make_runs
from rotorsim.fmi.runtime.steps import Member


@dataclass(frozen=True)
class EventUpdate:
    """What an event of Model Exchange changed; next_time: of the next time event [s], inf if there is none."""

    next_time: float
    states_changed: bool
    nominals_changed: bool
    terminate: bool


class Slave(Instance):
    """An instance of an FMU. `setup` first; then `exchange` (Co-Simulation) or the functions of Model Exchange.

    input_names, output_names: of the entries of u (n_u,) and y (n_y,). ended: the FMU has asked to end the simulation.
    Every function raises FmuError when the FMU fails.
    """

    # -- Co-Simulation -------------------------------------------------------------------------------------------------

    def exchange(
        self, u: np.ndarray | None, t: float, h: float | None = None, derivatives: np.ndarray | None = None
    ) -> np.ndarray:
        """Set the inputs u (n_u,), step from t to t + h, and return the outputs (n_y,) there.

        u: None leaves the inputs as they are. h: None makes no step. derivatives: (order, n_u) of the inputs at t,
        for FMUs that interpolate inputs.
        """
        self.begin_exchange(u, t, h, derivatives)
        return self.finish_exchange()

    def begin_exchange(
        self, u: np.ndarray | None, t: float, h: float | None = None, derivatives: np.ndarray | None = None
    ) -> None:
        """Begin what `exchange` does; FMUs in processes of their own then work at the same time."""
        op = Op.Y
        if u is not None:
            self._u[:] = u
            op |= Op.U
        if h:
            self._numbers[Block.T] = t
            self._numbers[Block.H] = h
            op |= Op.STEP
        if derivatives is not None:
            self._set_derivatives(derivatives)
            op |= Op.DU
        self._t = t
        try:
            self._begin(op)
        except CallError as failure:
            self._note_end()
            raise self._failed(failure, t) from None

    def finish_exchange(self) -> np.ndarray:
        """Return the outputs of what `begin_exchange` began."""
        self.wait(self._t, self.worker.finish)
        y = self.finite_outputs(self._t)
        if self.log:
            self._forward_log()
        return y

    def finite_outputs(self, t: float) -> np.ndarray:
        """Return the outputs (n_y,) of a step from t. Raises FmuError that names those that are not finite."""
        y = self._y.copy()
        return y if is_finite(y) else self._finite(y, self.output_names, t)

    def wait(self, t: float, finish: Callable[[], None]) -> None:
        """Wait by finish, which raises CallError, for a step from t that was begun. Raises FmuError."""
        try:
            finish()
        except CallError as failure:
            self._note_end()
            raise self._failed(failure, t) from None
        if self._head[Head.SAID]:
            self._note_end()

    def end_of(self, failure: FmuError, t: float) -> FmuError:
        """Return a failure of a step from t, or the end that the FMU asks for by refusing it."""
        if failure.kind != "discard" or not self.ended:
            return failure
        return self.end_asked(t if failure.last is None else failure.last)

    # -- in loop.c (see rotorsim.cosim.loop) ---------------------------------------------------------------------------

    def why_not_in_c(self) -> str:
        """Return why loop.c cannot take its steps now, or ""."""
        if self.kind != "cs" or not self.is_running:
            return "is not set up for Co-Simulation"
        return self.worker.why_not_in_c()

    def in_c(self, library: str) -> Member:
        """Return its steps for loop.c, whose library is at a path."""
        try:
            return self.worker.in_c(library)
        except CallError as failure:
            raise self._failed(failure) from None

    def addresses(self) -> tuple[list[int], list[int]]:
        """Return the addresses of its inputs and of its outputs."""
        block, counts = self.worker.block, (len(self.input_names), len(self.output_names))
        inputs, outputs = (
            [block.at(at + k) for k in range(n)] for at, n in zip((block.u, block.y), counts, strict=True)
        )
        return inputs, outputs

    def enter_c(self, member: Member, t: float) -> None:
        """Get ready for steps in C from t on."""
        self.wait(t, lambda: self.worker.enter_c(member))

    def leave_c(self, member: Member) -> None:
        """Take over from loop.c when it returns."""
        self.worker.leave_c(member)

    def finish_in_c(self, member: Member, what: int, t: float, end: float) -> None:
        """Do what loop.c left to be done in a step from t to an end."""
        try:
            self.wait(t, lambda: self.worker.finish_in_c(member, what))
        except FmuError as failure:
            raise self.end_of(failure, t) from None
        if self.ended:
            raise self.end_asked(end)

    # -- derivatives ---------------------------------------------------------------------------------------------------

    def _set_derivatives(self, derivatives: np.ndarray) -> None:
        if len(derivatives) > len(self._du):
            most = len(self._du)
            what = f"derivatives of inputs of order {len(derivatives)} cannot be set: the highest is {most}"
            raise self._refused(what)
        for k, row in enumerate(self._du):
            row[:] = derivatives[k] if k < len(derivatives) else 0.0

    def output_derivatives(self, order: int = 1) -> np.ndarray:
        """Return derivatives (n_y,) of the outputs at the end of the last step."""
        most = self.description.kinds[self.kind].max_output_derivative_order
        if not 1 <= order <= most:
            raise self._refused(f"derivatives of outputs of order {order} are not offered: the highest is {most}")
        if not self.output_names:
            return np.zeros(0)
        runs = make_runs(self.description.resolve(self.output_names), "output")
        found = [self.command("output_derivatives", refs=r["refs"], order=order, n=r["n"])["values"] for r in runs]
        whole = [v if r["index"] is None else [v[k] for k in r["index"]] for v, r in zip(found, runs, strict=True)]
        rates = np.concatenate([np.array(values, float) for values in whole])
        return self._finite(rates, self.output_names, None)

    # -- Model Exchange ------------------------------------------------------------------------------------------------

    def _evaluate(self, op: int, t: float, x: np.ndarray | None, u: np.ndarray | None) -> None:
        if self._phase != "initialising":
            op |= Op.TIME
            self._numbers[Block.T] = self._t = t
            if x is not None:
                self._x[:] = x
                op |= Op.X
        if u is not None:
            self._u[:] = u
            op |= Op.U
        try:
            self._run(op)
        except CallError as failure:
            raise self._failed(failure, t) from None
        if self.log:
            self._forward_log()

    def states(self) -> np.ndarray:
        """Return the states (n_states,) as the FMU last gave or got them."""
        return self._x.copy()

    def nominals(self) -> np.ndarray:
        """Return the nominal values (n_states,) of the states."""
        return self._nominals.copy()

    def derivatives(self, t: float, x: np.ndarray | None, u: np.ndarray | None = None) -> np.ndarray:
        """Return xdot (n_states,)."""
        self._evaluate(Op.XDOT, t, x, u)
        return self._finite(self._xdot.copy(), self.description.derivatives, t)

    def outputs(self, t: float, x: np.ndarray | None, u: np.ndarray | None = None) -> np.ndarray:
        """Return y (n_y,)."""
        self._evaluate(Op.Y, t, x, u)
        return self._finite(self._y.copy(), self.output_names, t)

    def evaluate(self, t: float, x: np.ndarray | None, u: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return xdot (n_states,) and y (n_y,) by one call."""
        self._evaluate(Op.XDOT | Op.Y, t, x, u)
        slope = self._finite(self._xdot.copy(), self.description.derivatives, t)
        return slope, self._finite(self._y.copy(), self.output_names, t)

    def event_indicators(self, t: float, x: np.ndarray | None, u: np.ndarray | None = None) -> np.ndarray:
        """Return the event indicators (n_events,): an event is where one changes its sign."""
        self._evaluate(Op.Z, t, x, u)
        return self._z.copy()

    def completed_step(self, t: float, x: np.ndarray | None, u: np.ndarray | None = None) -> bool:
        """Tell the FMU that a step of the solver is accepted; return whether it wants an event update."""
        self._evaluate(Op.COMPLETED, t, x, u)
        return self.completed_said(t, self._said)

    def completed_pending(self, t: float) -> int:
        """Wait for what the FMU says to a completed step of which C has told it. Raises FmuError."""
        try:
            self.worker.finish()
        except CallError as failure:
            raise self._failed(failure, t) from None
        return self._said

    def completed_said(self, t: float, said: int) -> bool:
        """Take what the FMU said to a completed step; return whether it wants an event update. Raises FmuError."""
        if said < 0:
            prefix = f"fmi{self.description.version[0]}"
            raise self._failed(status_error("CompletedIntegratorStep", -said, prefix), t)
        self.ended = self.ended or bool(said & Said.TERMINATE)
        return bool(said & Said.EVENT)

    def event_update(self, t: float, x: np.ndarray | None = None, u: np.ndarray | None = None) -> EventUpdate:
        """Carry out an event at t; afterwards `states` has the new states. Discrete inputs are set here only."""
        self._evaluate(Op.EVENT, t, x, u)
        self._note_end()
        return self.last_event()

    def event_refused(self, what: str, t: float) -> FmuError:
        """Return the failure of equations that hold between events alone."""
        who = "run" if self.description.states else "cosim"
        hint = f"`rotorsim {who}` carries events out; here there are equations between events alone"
        return self.step_failed("-", what, "event", t, hint)

    def last_event(self) -> EventUpdate:
        """Return what the last event, or the initialisation, said."""
        said = self._said
        return EventUpdate(
            self._numbers[Block.NEXT], bool(said & Said.STATES), bool(said & Said.NOMINALS), bool(said & Said.TERMINATE)
        )
