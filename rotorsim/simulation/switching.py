"""A diagram at work whose parts change their equations at events (FMUs for Model Exchange), as an instance.

Compiled steps go on until an event is due inside one; that step is taken again, and ends at the event.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.called import event_that_waits, forget_failures, has_failed, raise_failure
from rotorsim.model.compiled import Model
from rotorsim.model.instance import CompiledInstance, Instance, StepCallback, sound
from rotorsim.model.mode import Mode, ModeOf, modes_of
from rotorsim.simulation.event_steps import ACCUMULATE, EventSteps, rounding

# Steps at once, first and at most; what an event is in is computed again from the last start. A piece costs 8 us beside
# its steps, of 1.5 us each in a small diagram: 64 lose less than a tenth. At most half a megabyte of a signal is lost.
AT_ONCE = 64, 65536
MOST_ITERATIONS = 100  # of one event, until no part changes the inputs of another


@dataclass(frozen=True)
class _Saved:
    inner: Any
    modes: tuple[Any, ...]
    sides: np.ndarray
    next_time: float
    touching: bool
    clock: float


@contextmanager
def carrying_out_events(model: Model, instance: Instance, p: np.ndarray) -> Iterator[Instance]:
    """Give an instance of a diagram with parameters p (n_p,) that carries out the events of its parts, if it has any.

    Afterwards these parts are as they begin for all others.
    """
    modes = modes_of(model, p)
    if not modes:
        yield instance
        return
    try:
        yield SwitchingInstance(model, instance, modes)
    finally:
        for one in modes:
            one.mode.end()


class SwitchingInstance(EventSteps):
    """An instance (`rotorsim.model.instance.Instance`) that carries out the events of its parts.

    events: how many were carried out. stepwise: a part wants to be told of every completed step.
    """

    def __init__(self, model: Model, inner: Instance, modes: Sequence[ModeOf]) -> None:
        super().__init__(sum(one.mode.n_indicators for one in modes))
        self.inner, self.parts, self._name = inner, tuple(modes), model.diagram.name
        self.modes = tuple(one.mode for one in modes)
        self.path, self.n_y = inner.path, inner.n_y
        self.events = 0
        self.stepwise = any(mode.reports for mode in self.modes)
        self._guard(False)
        self._ahead = AT_ONCE[0]
        self._held: Any = None  # the instance before the step that is taken
        self._row = np.empty((1, inner.n_y))
        self._point: float | None = None  # time at which the parts were asked last, with the present states
        self._told, self._wants = -np.inf, False  # last completed step of a method of its own steps; it wants an event

    @property
    def x(self) -> np.ndarray:
        """States (n_x,)."""
        return self.inner.x

    @x.setter
    def x(self, values: np.ndarray) -> None:
        self.inner.x[:] = values

    @property
    def z(self) -> np.ndarray:
        """Discrete states (n_z,)."""
        return self.inner.z

    @z.setter
    def z(self, values: np.ndarray) -> None:
        self.inner.z[:] = values

    @property
    def can_go_back(self) -> bool:
        """Whether all that was saved can be restored."""
        return all(mode.can_go_back for mode in self.modes)

    @property
    def p(self) -> np.ndarray:
        """Parameters (n_p,)."""
        return np.asarray(self.inner.p)  # type: ignore[attr-defined]

    def start(self, t: float) -> None:
        """Begin at t; inputs other than those with which a part was initialised can make an event there."""
        for mode in self.modes:
            mode.begin()
        self.inner.start(t)
        self._told, self._wants = t, False
        self.next_time = min(mode.due for mode in self.modes)
        self.sides = np.concatenate([np.where(mode.sides(), 1.0, -1.0) for mode in self.modes])
        if self.next_time <= t or self._crossed(self._present(t)).any():
            self._events(t, 0.0)
        else:
            self._take_sides(t)

    def run(self, n0: int, n1: int, t0: float, h: float, every: int, rows: np.ndarray) -> int:
        """Take the steps n0 to n1 - 1, as `Instance` says. Raises RotorsimError where a part fails at an event."""
        first, n = -(-n0 // every), n0
        while n < n1:
            if self.stepwise:
                n = self._run_stepwise(n, n1, t0, h, every, rows, first)
                if has_failed() or not sound(self.inner.x):
                    return n
                continue
            begun, until, saved = n, min(n + self._ahead, n1), self.inner.save()
            self._guard(True)
            n = self.inner.run(begun, until, t0, h, every, rows[-(-begun // every) - first :])
            self._guard(False)
            due = event_that_waits()
            if due is None:
                if has_failed() or n < until:
                    return n
                self._ahead = min(2 * self._ahead, AT_ONCE[1])
                continue
            forget_failures()
            self.inner.restore(saved)
            step = int((due - t0) / h + 1e-9)  # in which the event is due, or behind the one at whose end it is
            n = max(begun, step - 1)
            if n > begun:
                self.inner.run(begun, n, t0, h, every, rows[-(-begun // every) - first :])
                raise_failure()
            while n <= min(step, n1 - 1):
                self._careful(n, t0, h, every, rows, first)
                n += 1
            self._ahead = AT_ONCE[0]
        return n

    def _run_stepwise(self, n: int, n1: int, t0: float, h: float, every: int, rows: np.ndarray, first: int) -> int:
        """Take steps of which parts are told, until one wants an event; return the step reached.

        They are told from C; a step in which an event is due is taken from Python, which finds where.
        """
        inner, reporting = self.inner, [one.mode for one in self.parts if one.mode.reports]
        callbacks = [StepCallback(*found, 0) for mode in reporting if (found := mode.completed_callback()) is not None]
        if isinstance(inner, CompiledInstance) and len(callbacks) == len(reporting):
            begun, until = n, min(n + self._ahead, n1)
            self._guard(True)
            n = inner.run_stepwise(begun, until, t0, h, every, rows[-(-begun // every) - first :], callbacks)
            self._guard(False)
            self._ahead = min(2 * self._ahead, AT_ONCE[1]) if n == until else AT_ONCE[0]
            if n > begun and self._completed_results(t0 + n * h, reporting, callbacks):
                self._note(np.zeros(len(self.sides), bool), t0 + n * h, h)
                self._events(t0 + n * h, rounding(t0 + n * h, h))
                return n
            if n == until or (has_failed() and event_that_waits() is None):
                return n
            forget_failures()
        self._careful(n, t0, h, every, rows, first)
        return n + 1

    def _completed_results(self, t: float, reporting: Sequence[Mode], callbacks: Sequence[StepCallback]) -> bool:
        """Take what parts said that were told of a step to t; return whether one wants an event."""
        self._point = t
        wants = [mode.completed_result(t, one.said) for mode, one in zip(reporting, callbacks, strict=True)]
        return any(wants)

    def derivative(self, t: float, x: np.ndarray) -> np.ndarray:
        """Return x' (n_x,)."""
        return self.inner.derivative(t, x)

    def record(self, t: float, x: np.ndarray) -> np.ndarray:
        """Return the recorded signals (n_y,)."""
        return self.inner.record(t, x)

    def sample(self, t: float) -> None:
        """Carry out the sample hits due at t."""
        self.inner.sample(t)

    def next_hit(self) -> float:
        """Return the time of the next sample hit."""
        return self.inner.next_hit()

    def save(self) -> Any:
        """Return what `restore` needs."""
        modes = tuple(mode.save() for mode in self.modes)
        return _Saved(self.inner.save(), modes, self.sides.copy(), self.next_time, self.touching, self.clock)

    def restore(self, saved: Any) -> None:
        """Go back. Raises RotorsimError where events came between and a part cannot be set back."""
        self.inner.restore(saved.inner)
        for mode, own in zip(self.modes, saved.modes, strict=True):
            mode.restore(own)
        self.sides, self.next_time = saved.sides.copy(), saved.next_time
        self.touching, self.clock = saved.touching, saved.clock
        self._forget_after(self.clock)

    # -- for methods that choose their own steps -----------------------------------------------------------------------

    def crossings(self) -> list[Callable[[float, np.ndarray], float]]:
        """Return functions of t and x, each of which falls through zero where an event indicator leaves its side."""
        known: dict[str, Any] = {}

        def distances(t: float, x: np.ndarray) -> np.ndarray:
            key = (t, x.tobytes())
            if known.get("key") != key:
                known["key"], known["z"] = key, self._indicators(t, x)
            return np.asarray(self.sides * known["z"])

        found: list[Any] = [partial(lambda k, t, x: float(distances(t, x)[k]), k) for k in range(len(self.sides))]
        for one in found:
            one.terminal, one.direction = True, -1.0
        return found

    def completions(self, others: Sequence[Any]) -> list[Callable[[float, np.ndarray], float]]:
        """Return a function of t and x that tells parts of steps, and falls through zero where one wants an event.

        To be asked behind each step, after others, of which one that passes zero (of scipy's form) cuts it short.
        """
        before: list[float] = []

        def wanted(t: float, x: np.ndarray) -> float:
            if t >= self._told:
                now = [other(t, x) for other in others]
                cut = any(
                    a * b <= 0 and (a >= 0 or getattr(other, "direction", 0) >= 0)
                    for other, a, b in zip(others, before, now, strict=False)
                )
                before[:] = now
                if t > self._told and not cut:
                    self.inner.x[:] = x
                    self._present(t)
                    self._told, self._wants = t, self._completed(t)
            return (
                -1.0 if self._wants and t >= self._told else 1.0
            )  # looking for the zero, the method asks within a step

        wanted.terminal, wanted.direction = True, -1.0  # type: ignore[attr-defined]
        return [wanted] if self.stepwise else []

    def carry_out_due(self, t: float, x: np.ndarray, h: float) -> np.ndarray:
        """Carry out what is due at t with states x, if anything is; return the states then. h: step of the diagram."""
        self.inner.x[:] = x
        crossed = self._crossed(self._present(t))
        wants = self._wants or (t > self._told and self._completed(t))
        self._told, self._wants = t, False
        if crossed.any() or wants or self.next_time <= t + rounding(t, h):
            self._note(crossed, t, h)
            self._events(t, rounding(t, h))
        return np.array(self.inner.x)

    # -- one step ------------------------------------------------------------------------------------------------------

    def _careful(self, n: int, t0: float, h: float, every: int, rows: np.ndarray, first: int) -> None:
        """Take one step that may have events in it."""
        if n % every == 0:
            rows[n // every - first] = self.inner.record(t0 + n * h, self.inner.x)
        self._held = self.inner.save()
        self._step(t0 + n * h, h)

    def _guard(self, on: bool) -> None:
        for mode in self.modes:
            mode.guard(on)

    def _after(self, t: float, h: float) -> np.ndarray:
        self._point = None
        self.inner.restore(self._held)
        if h > 0:
            self.inner.run(0, 1, t, h, 1, self._row)
            raise_failure()
        return np.array(self.inner.x)

    def _accept(self, t: float, h: float, x: np.ndarray) -> None:
        self._held = self.inner.save()

    def _indicators(self, t: float, x: np.ndarray) -> np.ndarray:
        self.inner.derivative(t, x)
        raise_failure()
        self._point = t
        z = np.concatenate([np.zeros(0), *(mode.indicators() for mode in self.modes)])
        if (bad := np.flatnonzero(~np.isfinite(z))).size:  # has no side: an event would be missed
            block, k = self._place(int(bad[0]))
            raise self._failed(t, f"gives {z[bad[0]]} for event indicator {k}", block)
        return z

    def _present(self, t: float) -> np.ndarray:
        return self._indicators(t, self.inner.x)

    def _completed(self, t: float) -> bool:
        if not self.stepwise:
            return False
        if self._point != t:
            self._present(t)
        wants = [one.mode.completed(t, self.inner.x[one.part]) for one in self.parts if one.mode.reports]
        return any(wants)  # all are told

    def _carry_out(self, t: float) -> None:
        """Carry out an event of all parts, and more of those whose inputs it has changed."""
        self._present(t)
        fed: dict[int, np.ndarray] = {}
        for _ in range(MOST_ITERATIONS):
            now = [mode.inputs() for mode in self.modes]
            changed = [k for k, u in enumerate(now) if k not in fed or not np.array_equal(u, fed[k])]
            if not changed:
                break
            for k in changed:
                mode, part = self.modes[k], self.parts[k].part
                self.inner.x[part], fed[k] = mode.event(t, np.array(self.inner.x[part])), now[k]
            self._present(t)
        else:
            raise self._endless(t, f"its parts change one another {MOST_ITERATIONS} times at one event")
        self.events += 1
        self.next_time = min(mode.due for mode in self.modes)
        self._held = self.inner.save()

    def _take_sides(self, t: float) -> None:
        super()._take_sides(t)
        for mode in self.modes:
            mode.settle()

    def _place(self, indicator: int) -> tuple[str, int]:
        """Return the block of an indicator, and which it is of its own, from 1."""
        first = np.cumsum([0, *(mode.n_indicators for mode in self.modes)])
        k = int(np.searchsorted(first, indicator, side="right")) - 1
        return self.parts[k].block, int(indicator - first[k] + 1)

    def _endless(self, t: float, what: str, indicator: int | None = None) -> RotorsimError:
        if indicator is None:
            return self._failed(t, what, self._name, ACCUMULATE)
        block, k = self._place(indicator)
        return self._failed(t, f"event indicator {k} {what}", block, ACCUMULATE)

    @staticmethod
    def _failed(t: float, what: str, subject: str, hint: str = "") -> RotorsimError:
        error = RotorsimError(Problem(f"{what} (t = {t:.9g} s)", subject, hint=hint), exit_code=1)
        error.time = t  # type: ignore[attr-defined]
        return error
