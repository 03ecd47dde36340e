"""Steps of fixed length that end at events: of time, of state (an indicator changes its side), of a completed step.

Time events are met exactly. A state event is where an event indicator changes its side (z > 0, or not; FMI 2.0.4,
section 3.2.2): it is located by Brent's method on the motion that the step itself gives. An indicator that crosses zero
and comes back within one step is not seen.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from rotorsim.errors import RotorsimError

LOCATED = 1e-12  # of a step: how well state events are located
TOUCH = 1e-10  # of a step: how far an indicator that is exactly zero is followed first
CHATTER = 1e-8  # of a step: the same crossing again so soon means that events accumulate
MOST_EVENTS_PER_STEP = 1000  # in one step
ACCUMULATE = "events accumulate: a contact that comes to rest, or a relay without hysteresis, inside the FMU"
EPS = float(np.finfo(float).eps)
_NONE = np.zeros(0, bool)


class EventSteps(ABC):
    """Steps of a system from event to event.

    sides (n_z,): +-1, on which every event indicator is; next_time: of the next time event [s]; touching: an indicator
    is exactly zero behind an event; clock: time of the last event.
    """

    def __init__(self, n_indicators: int) -> None:
        self.next_time = np.inf
        self.sides = np.zeros(n_indicators)
        self.touching = False
        self.clock = -np.inf
        self._last: dict[tuple[int, bool], float] = {}

    # -- the system ----------------------------------------------------------------------------------------------------

    @abstractmethod
    def _after(self, t: float, h: float) -> np.ndarray:
        """Return the states after a step h from t, as if there were no events."""

    @abstractmethod
    def _indicators(self, t: float, x: np.ndarray) -> np.ndarray:
        """Return the event indicators (n_z,) at t, with states that `_after` has returned last."""

    @abstractmethod
    def _accept(self, t: float, h: float, x: np.ndarray) -> None:
        """Take x, which `_after` has returned for a step h from t, as the present states."""

    @abstractmethod
    def _completed(self, t: float) -> bool:
        """Tell that a step to t is accepted; return whether an event is wanted."""

    @abstractmethod
    def _carry_out(self, t: float) -> None:
        """Carry out the event at t; `next_time` is then that of the next one, and the present states those behind."""

    @abstractmethod
    def _present(self, t: float) -> np.ndarray:
        """Return the event indicators (n_z,) of the present states."""

    @abstractmethod
    def _endless(self, t: float, what: str, indicator: int | None = None) -> RotorsimError:
        """Return the error that events accumulate; indicator: the place in `sides` of the one that it is about."""

    # -- from event to event -------------------------------------------------------------------------------------------

    def _step(self, start: float, h: float) -> None:
        """Take one step."""
        end, tiny = start + h, rounding(start, h)
        t, events = self._not_before_event(start), 0
        while t < end - tiny:
            goal = self.next_time if self.next_time < end - tiny else end
            if self.touching:  # which side it takes is seen before it may come back
                goal, self.touching = min(goal, t + max(TOUCH * h, 1e3 * EPS * abs(t))), False
            width = h if t == start and goal == end else goal - t
            x, crossed = self._after(t, width), _NONE
            if self.sides.size:
                crossed = self._crossed(self._indicators(goal, x))
                if crossed.any():
                    width, x, crossed = self._locate(t, width, h)
                    goal = t + width
            self._accept(t, width, x)
            t = goal
            wants = self._completed(t)
            if crossed.any() or wants:
                events += 1
                if events > MOST_EVENTS_PER_STEP:
                    raise self._endless(
                        t, f"there are more than {MOST_EVENTS_PER_STEP} state events in one step of {h:.3g} s"
                    )
                self._note(crossed, t, h)
                self._events(t, tiny)
            elif self.next_time <= t + tiny:
                self._events(t, tiny)

    def _events(self, t: float, tiny: float) -> None:
        """Carry out the event at t, and more while the next one is due at once."""
        for _ in range(MOST_EVENTS_PER_STEP):
            self.clock = max(t, self.next_time) if self.next_time <= t + tiny else t
            self._carry_out(self.clock)
            if self.next_time > t + tiny:
                self._take_sides(self.clock)
                return
        raise self._endless(t, f"the next time event is due at once, {MOST_EVENTS_PER_STEP} times")

    def _not_before_event(self, t: float) -> float:
        """Return t, or the time of the last event where that is later by rounding: time never goes back."""
        return self.clock if 0 < self.clock - t <= 1e-9 * max(abs(t), 1.0) else t

    # -- state events --------------------------------------------------------------------------------------------------

    def _crossed(self, z: np.ndarray) -> np.ndarray:
        """Return which indicators have left their side; zero belongs to the lower one."""
        return np.asarray(((self.sides > 0) & (z <= 0)) | ((self.sides < 0) & (z > 0)))

    def _take_sides(self, t: float) -> None:
        """Take the side of every indicator, +-1, and note whether one is exactly zero."""
        if self.sides.size:
            z = self._present(t)
            self.touching = bool((z == 0).any())
            self.sides = np.where(z > 0, 1.0, -1.0)

    def _locate(self, t: float, width: float, h: float) -> tuple[float, np.ndarray, np.ndarray]:
        """Return the width of the step that ends right behind the first crossing, the states there, what crossed."""
        from scipy.optimize import brentq  # as long to load as many a run takes

        tolerance = max(LOCATED * h, 2 * EPS * abs(t))

        def at(step: float) -> tuple[np.ndarray, np.ndarray]:
            x = self._after(t, step)
            return x, self._indicators(t + step, x)

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
                raise self._endless(t, "crosses zero again and again", k)
            self._last[key] = t

    def _forget_after(self, t: float) -> None:
        """Forget crossings after t: a step was taken back."""
        self._last = {key: at for key, at in self._last.items() if at <= t}


def rounding(t: float, h: float) -> float:
    """Return within which time an event counts as due at the end of a step of h from t."""
    return max(1e-10 * h, 8 * EPS * abs(t))
