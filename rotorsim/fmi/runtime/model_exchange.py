"""An FMU for Model Exchange at work: Runge-Kutta steps, or those of a method of SciPy, from event to event.

Time events are met exactly. A state event is where an event indicator changes its side (z > 0, or not; FMI 2.0.4,
section 3.2.2): it is located by Brent's method on the motion that the Runge-Kutta step itself gives. An indicator that
crosses zero and comes back within one step is not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from rotorsim.diagram.solver import ADAPTIVE
from rotorsim.fmi.runtime.exchange import Slave
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.linear.stability import largest_stable_step, rounded_down, step_factor
from rotorsim.model.runge_kutta import RK4

RTOL, ATOL = 1e-8, 1e-12  # of the methods that choose their own steps
NUDGE = 6e-6  # cube root of eps: relative width of central differences

LOCATED = 1e-12  # of a step: how well state events are located
TOUCH = 1e-10  # of a step: how far an indicator that is exactly zero is followed first
CHATTER = 1e-8  # of a step: the same crossing again so soon means that events accumulate
MOST_EVENTS_PER_STEP = 1000  # in one step
SAVED_STATES = 8  # saved states of the FMU that may be come back to
EPS = float(np.finfo(float).eps)
_NONE = np.zeros(0, bool)

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


class ModelExchange:
    """The continuous states of an instance, integrated by RK4 with all three kinds of events.

    discrete: which inputs (n_u,) are set at events only: a change of them is an event at the start of a step.
    """

    def __init__(self, slave: Slave, discrete: np.ndarray) -> None:
        self.slave, self.discrete = slave, discrete
        kind = slave.description.kinds["me"]
        self.saves, self.reports = kind.can_get_set_state, kind.completed_step_needed
        self.x = np.zeros(0)
        self.next_time = np.inf
        self.sides = np.zeros(slave.n_events)
        self.touching = False  # an indicator is exactly zero behind an event
        self.fed = np.zeros(0)
        self.clock = -np.inf  # time of the last event
        self.epoch = self._epochs = 0  # grows with every event
        self._saved = (0, 0)  # epoch and handle of the state saved last
        self._last: dict[tuple[int, bool], float] = {}
        self.method = "rk4"
        self._width, self._inputs = 0.0, np.zeros(0)  # of the last step

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
        self.sides = self._sides(t, u)

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        """Return the outputs (n_y,) of the present state."""
        return self.slave.outputs(self._not_before_event(t), self.x, u)

    def output_after(self, t: float, h: float, u: Inputs) -> np.ndarray:
        """Return the outputs (n_y,) a very short time h later, as if there were no events."""
        return self.slave.outputs(t + h, self._after(t, h, u, 0.0), u(h))

    def advance(self, t: float, h: float, u: Inputs, count: int) -> None:
        """Integrate from t to t + h in ``count`` steps; u(tau): inputs. Raises FmuError, also when the FMU ends it."""
        width = h / count
        self._width, self._inputs = width, np.array(u(h), float)
        self._at_start(t, _rounding(t, width), u(0.0))
        for k in range(count):
            self._step(t + k * width, width, u, k * width)

    # -- from event to event -------------------------------------------------------------------------------------------

    def _step(self, start: float, h: float, u: Inputs, before: float) -> None:
        """Take one step; the inputs at time t are u(before + t - start)."""
        end, tiny = start + h, _rounding(start, h)
        t, events = self._not_before_event(start), 0
        while t < end - tiny:
            goal = self.next_time if self.next_time < end - tiny else end
            if self.touching:  # which side it takes is seen before it may come back
                goal, self.touching = min(goal, t + max(TOUCH * h, 1e3 * EPS * abs(t))), False
            since, width = before + (t - start), goal - t
            x, crossed = self._after(t, width, u, since), _NONE
            if self.sides.size:
                crossed = self._crossed(self._indicators(goal, x, u(since + width)))
                if crossed.any():
                    width, x, crossed = self._locate(t, width, x, u, since, h)
                    goal = t + width
            self.x, t = x, goal
            now = u(before + (t - start))
            wants = self.reports and self.slave.completed_step(t, x, now)
            if self.slave.ended:
                raise self.slave.end_asked(t)
            if crossed.any() or wants:
                events += 1
                if events > MOST_EVENTS_PER_STEP:
                    raise self._endless(
                        t, f"there are more than {MOST_EVENTS_PER_STEP} state events in one step of {h:.3g} s"
                    )
                self._note(crossed, t, h)
                self._events(t, tiny, now)
            elif self.next_time <= t + tiny:
                self._events(t, tiny, now)

    def _at_start(self, t: float, tiny: float, u: np.ndarray) -> None:
        """Carry out events that are due at once: by time, or because inputs have jumped since the last step."""
        jumped = bool((u[self.discrete] != self.fed).any())
        if self.sides.size and not jumped:
            jumped = bool(self._crossed(self._indicators(self._not_before_event(t), self.x, u)).any())
        if jumped or self.next_time <= t + tiny:
            self._events(self._not_before_event(t), tiny, u)

    def _events(self, t: float, tiny: float, u: np.ndarray) -> None:
        """Carry out the event at t, and more while the next one is due at once."""
        for _ in range(MOST_EVENTS_PER_STEP):
            self.clock = max(t, self.next_time) if self.next_time <= t + tiny else t
            update = self.slave.event_update(self.clock, self.x, u)
            self.epoch = self._epochs = self._epochs + 1
            if update.terminate:
                raise self.slave.end_asked(self.clock)
            self.x, self.next_time, self.fed = self.slave.states(), update.next_time, u[self.discrete]
            if self.next_time > t + tiny:
                self.sides = self._sides(self.clock, u)
                return
        raise self._endless(t, f"the next time event is due at once, {MOST_EVENTS_PER_STEP} times")

    def _not_before_event(self, t: float) -> float:
        """Return t, or the time of the last event where that is later by rounding: time never goes back."""
        return self.clock if 0 < self.clock - t <= 1e-9 * max(abs(t), 1.0) else t

    # -- state events --------------------------------------------------------------------------------------------------

    def _indicators(self, t: float, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        z = self.slave.event_indicators(t, x, u)
        if (bad := np.flatnonzero(~np.isfinite(z))).size:
            what = f"gives {z[bad[0]]} for event indicator {bad[0] + 1}"
            raise self.slave.step_failed("GetEventIndicators", what, "value", t)
        return z

    def _crossed(self, z: np.ndarray) -> np.ndarray:
        """Return which indicators have left their side; zero belongs to the lower one."""
        return np.asarray(((self.sides > 0) & (z <= 0)) | ((self.sides < 0) & (z > 0)))

    def _sides(self, t: float, u: np.ndarray) -> np.ndarray:
        """Return the side of every indicator, +-1, and note whether one is exactly zero."""
        if not self.sides.size:
            return self.sides
        z = self._indicators(t, self.x, u)
        self.touching = bool((z == 0).any())
        return np.where(z > 0, 1.0, -1.0)

    def _locate(
        self, t: float, width: float, end: np.ndarray, u: Inputs, since: float, h: float
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the width of the step that ends right behind the first crossing, the states there, what crossed."""
        tolerance = max(LOCATED * h, 2 * EPS * abs(t))

        def at(step: float) -> tuple[np.ndarray, np.ndarray]:
            x = end if step == width else self._after(t, step, u, since)
            return x, self._indicators(t + step, x, u(since + step))

        def distance(step: float) -> float:
            """Return how far the closest indicator still is from zero, on its own side."""
            return float((self.sides * at(step)[1]).min())

        low = 0.0 if distance(0.0) > 0 else min(TOUCH * h, width) / 2  # exactly zero at the start
        step = float(brentq(distance, low, width, xtol=tolerance, rtol=4 * EPS)) if distance(low) > 0 else low
        reach = tolerance
        x, z = at(step)
        while not (crossed := self._crossed(z)).any() and step < width:
            step = min(step + reach, width)
            reach *= 2
            x, z = at(step)
        return step, x, crossed

    def _note(self, crossed: np.ndarray, t: float, h: float) -> None:
        """Refuse crossings that come back at once: a contact that comes to rest, a relay that chatters."""
        for k in np.flatnonzero(crossed).tolist():
            key = (k, bool(self.sides[k] > 0))
            if t - self._last.get(key, -np.inf) < max(CHATTER * h, 100 * EPS * abs(t)):
                raise self._endless(t, f"event indicator {k + 1} crosses zero again and again")
            self._last[key] = t

    # -- one step ------------------------------------------------------------------------------------------------------

    def _after(self, t: float, h: float, u: Inputs, tau: float) -> np.ndarray:
        """Return the states after a step h from t, as if there were no events; the inputs are u(tau + time since t)."""
        x = self.x
        stages: list[np.ndarray] = []
        if not x.size:
            return x
        if self.method != "rk4":
            return self._by_scipy(t, h, u, tau)
        for a, c in zip(RK4.a, RK4.c, strict=True):
            stages.append(self.slave.derivatives(t + c * h, x + h * _combined(a, stages), u(tau + c * h)))
        return np.asarray(x + h * _combined(RK4.b, stages))

    def _by_scipy(self, t: float, h: float, u: Inputs, tau: float) -> np.ndarray:
        """Return the states after h by a method that chooses its own steps, implicit for stiff equations."""
        from scipy.integrate import solve_ivp

        def f(s: float, x: np.ndarray) -> np.ndarray:
            return self.slave.derivatives(s, x, u(tau + (s - t)))

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
        self._last = {key: t for key, t in self._last.items() if t <= self.clock}

    # -- failures ------------------------------------------------------------------------------------------------------

    def _endless(self, t: float, what: str) -> FmuError:
        hint = "events accumulate: a contact that comes to rest, or a relay without hysteresis, inside the FMU"
        return self.slave.step_failed("-", what, "endless", t, hint)


def _combined(weights: Sequence[float], stages: Sequence[np.ndarray]) -> Any:
    """Return sum w_j k_j."""
    return sum(w * k for w, k in zip(weights, stages, strict=True) if w)


def _rounding(t: float, h: float) -> float:
    """Return within which time an event counts as due at the end of a step of h from t."""
    return max(1e-10 * h, 8 * EPS * abs(t))
