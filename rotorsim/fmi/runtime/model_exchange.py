"""An FMU for Model Exchange at work: Runge-Kutta steps, or those of a method of SciPy, from event to event."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorsim.diagram.solver import ADAPTIVE
from rotorsim.errors import RotorsimError
from rotorsim.fmi.runtime.exchange import Slave
from rotorsim.linear.stability import largest_stable_step, rounded_down, step_factor
from rotorsim.model.runge_kutta import RK4
from rotorsim.simulation.event_steps import ACCUMULATE, EventSteps, rounding

RTOL, ATOL = 1e-8, 1e-12  # of the methods that choose their own steps
NUDGE = 6e-6  # cube root of eps: relative width of central differences

SAVED_STATES = 8  # saved states of the FMU that may be come back to

Inputs = Callable[[float], np.ndarray]


@dataclass(frozen=True)
class SavedState:
    """Continuous states and where the events were; handle: the saved state of the FMU itself, where it can."""

    x: np.ndarray
    next_time: float
    sides: np.ndarray
    touching: bool
    fed: np.ndarray
    clock: float
    epoch: int
    handle: int | None


class ModelExchange(EventSteps):
    """The continuous states of an instance, integrated by RK4 with all three kinds of events.

    discrete: which inputs (n_u,) are set at events only: a change of them is an event at the start of a step.
    """

    def __init__(self, slave: Slave, discrete: np.ndarray) -> None:
        super().__init__(slave.n_events)
        self.slave, self.discrete = slave, discrete
        kind = slave.description.kinds["me"]
        self.saves, self.reports = kind.can_get_set_state, kind.completed_step_needed
        self.x = np.zeros(0)
        self.fed = np.zeros(0)
        self.epoch = self._epochs = 0  # grows with every event
        self._saved = (0, 0)  # epoch and handle of the state saved last
        self.method = "rk4"
        self._width, self._inputs = 0.0, np.zeros(0)  # of the last step
        self._inputs_at: Inputs = lambda t: np.zeros(0)  # of the step that is taken, by the time

    @property
    def may_have_events(self) -> bool:
        """Whether the FMU declares event indicators, or variables that change at events."""
        description = self.slave.description
        return description.n_events > 0 or any(
            v.variability == "discrete" and v.causality in ("output", "local") for v in description.variables.values()
        )

    def begin(self, t: float, u: np.ndarray) -> None:
        """Take over after the initialisation with inputs u (n_u,)."""
        first = self.slave.last_event()
        self.x, self.next_time = self.slave.states(), first.next_time
        self.epoch = self._epochs = self._epochs + 1
        self.clock, self.fed = -np.inf, u[self.discrete]
        self._last = {}
        if first.terminate:
            raise self.slave.end_asked(t)
        self._hold(u)
        self._take_sides(t)

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        """Return the outputs (n_y,) of the present state."""
        return self.slave.outputs(self._not_before_event(t), self.x, u)

    def output_after(self, t: float, h: float, u: Inputs) -> np.ndarray:
        """Return the outputs (n_y,) a very short time h later, as if there were no events."""
        self._inputs_at = lambda at: u(at - t)
        return self.slave.outputs(t + h, self._after(t, h), u(h))

    def advance(self, t: float, h: float, u: Inputs, count: int) -> None:
        """Integrate from t to t + h in ``count`` steps; u(tau): inputs. Raises FmuError, also when the FMU ends it."""
        width = h / count
        self._width, self._inputs = width, np.array(u(h), float)
        self._at_start(t, rounding(t, width), u(0.0))
        for k in range(count):
            start, before = t + k * width, k * width
            self._inputs_at = lambda at, start=start, before=before: u(before + (at - start))  # type: ignore[misc]
            self._step(start, width)

    # -- from event to event -------------------------------------------------------------------------------------------

    def _hold(self, u: np.ndarray) -> None:
        self._inputs_at = lambda _: u

    def _at_start(self, t: float, tiny: float, u: np.ndarray) -> None:
        """Carry out events that are due at once: by time, or because inputs have jumped since the last step."""
        self._hold(u)
        jumped = bool((u[self.discrete] != self.fed).any())
        if self.sides.size and not jumped:
            jumped = bool(self._crossed(self._present(self._not_before_event(t))).any())
        if jumped or self.next_time <= t + tiny:
            self._events(self._not_before_event(t), tiny)

    def _carry_out(self, t: float) -> None:
        u = self._inputs_at(t)
        update = self.slave.event_update(t, self.x, u)
        self.epoch = self._epochs = self._epochs + 1
        if update.terminate:
            raise self.slave.end_asked(t)
        self.x, self.next_time, self.fed = self.slave.states(), update.next_time, u[self.discrete]

    def _completed(self, t: float) -> bool:
        wants = self.reports and self.slave.completed_step(t, self.x, self._inputs_at(t))
        if self.slave.ended:
            raise self.slave.end_asked(t)
        return wants

    def _accept(self, t: float, h: float, x: np.ndarray) -> None:
        self.x = x

    def _present(self, t: float) -> np.ndarray:
        return self._indicators(t, self.x)

    def _indicators(self, t: float, x: np.ndarray) -> np.ndarray:
        z = self.slave.event_indicators(t, x, self._inputs_at(t))
        if (bad := np.flatnonzero(~np.isfinite(z))).size:
            what = f"gives {z[bad[0]]} for event indicator {bad[0] + 1}"
            raise self.slave.step_failed("GetEventIndicators", what, "value", t)
        return z

    # -- one step ------------------------------------------------------------------------------------------------------

    def _after(self, t: float, h: float) -> np.ndarray:
        x, u = self.x, self._inputs_at
        stages: list[np.ndarray] = []
        if not x.size:
            return x
        if self.method != "rk4":
            return self._by_scipy(t, h)
        for a, c in zip(RK4.a, RK4.c, strict=True):
            stages.append(self.slave.derivatives(t + c * h, x + h * _combined(a, stages), u(t + c * h)))
        return np.asarray(x + h * _combined(RK4.b, stages))

    def _by_scipy(self, t: float, h: float) -> np.ndarray:
        """Return the states after h by a method that chooses its own steps, implicit for stiff equations."""
        from scipy.integrate import solve_ivp

        def f(s: float, x: np.ndarray) -> np.ndarray:
            return self.slave.derivatives(s, x, self._inputs_at(s))

        made = solve_ivp(f, (t, t + h), self.x, method=ADAPTIVE[self.method], t_eval=(t + h,), rtol=RTOL, atol=ATOL)
        if not made.success:
            raise self.slave.step_failed("GetDerivatives", f"{self.method}: {made.message.lower()}", "error", t)
        return np.asarray(made.y[:, -1])

    def unstable_step(self) -> str:
        """Return why the steps that were taken give no solution, or nothing: RK4 at the poles of the FMU itself.

        The poles are those of its present state, by central differences; growing ones are the FMU's own matter.
        """
        if self.method != "rk4" or not self.x.size or not self._width or not np.isfinite(self.x).all():
            return ""
        t, u, x = max(self.clock, 0.0), self._inputs, self.x
        f, widths = self.slave.derivatives, NUDGE * np.maximum(np.abs(x), max(float(np.abs(x).max()), 1.0) * NUDGE)
        moves = np.diag(widths)
        J = np.column_stack([(f(t, x + move, u) - f(t, x - move, u)) / (2 * move.sum()) for move in moves])
        if not np.isfinite(J).all():
            return ""
        poles = np.linalg.eigvals(J)
        decaying = poles[poles.real < -1e-6 * np.abs(poles)]
        if not (step_factor(self._width * decaying) > 1 + 1e-6).any():
            return ""
        fastest = complex(decaying[np.argmax(np.abs(decaying))])
        at = f"{fastest.real:.4g} 1/s" + (f", {abs(fastest.imag) / (2 * np.pi):.4g} Hz" if fastest.imag else "")
        limit = rounded_down(largest_stable_step(decaying))
        return (
            f"the step {self._width:.3g} s of its states is too large: RK4 is stable here up to {limit:.3g} s "
            f"(its fastest pole: {at})"
        )

    # -- saved states --------------------------------------------------------------------------------------------------

    def save(self) -> SavedState:
        """Return all that `restore` needs.

        Discrete states change at events only, or also at completed steps where the FMU wants to be told of these: the
        state of the FMU itself is saved once between two events, or every time.
        """
        if self.saves and (self.reports or self._saved[0] != self.epoch):
            self._saved = self.epoch, self.slave.save_state()
            self.slave.free_states(but=SAVED_STATES)
        handle = self._saved[1] if self.saves else None
        return SavedState(
            self.x.copy(), self.next_time, self.sides.copy(), self.touching, self.fed, self.clock, self.epoch, handle
        )

    def restore(self, saved: SavedState) -> None:
        """Go back to a saved state. Raises FmuError where events came between and the FMU cannot be set back."""
        if saved.epoch != self.epoch and saved.handle is None:
            what = "cannot be taken back over an event: it does not let its state be saved"
            raise self.slave.step_failed("-", what, "refused", saved.clock)
        if saved.handle is not None and (self.reports or saved.epoch != self.epoch):
            self.slave.restore_state(saved.handle)
        self.x, self.sides, self.fed, self.touching = saved.x.copy(), saved.sides.copy(), saved.fed, saved.touching
        self.next_time, self.clock, self.epoch = saved.next_time, saved.clock, saved.epoch
        self._forget_after(self.clock)

    # -- failures ------------------------------------------------------------------------------------------------------

    def _endless(self, t: float, what: str, indicator: int | None = None) -> RotorsimError:
        text = what if indicator is None else f"event indicator {indicator + 1} {what}"
        return self.slave.step_failed("-", text, "endless", t, ACCUMULATE)


def _combined(weights: Sequence[float], stages: Sequence[np.ndarray]) -> Any:
    """Return sum w_j k_j."""
    return sum(w * k for w, k in zip(weights, stages, strict=True) if w)
