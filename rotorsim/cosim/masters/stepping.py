"""Masters that go from one communication point to the next; steps fixed or adaptive.

Signals between communication points are polynomials through the values at the newest points that are known:
extrapolation (order 0..2), or interpolation where the end of the step is known already. Sampled signals are held.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.inputs import Point, Polynomial, through
from rotorsim.cosim.masters.master import Master, Schedule, Settings, Trajectory
from rotorsim.cosim.participant import Participant
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.instance import is_finite

STEP_HIT_TOLERANCE = 1e-6  # of a step: a sample hit so close to a communication point is there
CLOSEST_POINTS = 0.1  # of a step: points closer than this are not used together
LARGEST_ADAPTIVE = 100  # the adaptive step over the one given


@dataclass(frozen=True)
class SavedMaster:
    """All that a master needs to go back: states of the participants, known points, and where it was.

    rate: of the inputs, where the master uses it.
    """

    states: list[object]
    known: list[list[Point]]
    since: list[float]
    tick: int
    rate: np.ndarray | None = None


class SteppingMaster(Master):
    """Steps participants with signals that are polynomials.

    known: points of every participant, the newest last; since: their times; tick: base steps taken. sampling:
    participants whose sample hits are communication points. mismatch: of the last step, how far the inputs that were
    foreseen are from those that the outputs then ask for, relative to the largest so far. widest: between points that
    are used together, in points; memory: points before the newest that a step may look back to. linear_in_many: its
    steps are linear in the signals, so that these may be matrices, a column for each of many runs.
    """

    linear_in_many = True

    def __init__(self, coupling: Coupling[Participant], settings: Settings, degree: int, widest: int = 1) -> None:
        super().__init__(coupling, settings)
        self.degree, self.widest, self.memory = degree, widest, degree * widest
        self.known: list[list[Point]] = [[] for _ in coupling.participants]
        self.since = [0.0] * len(coupling.participants)
        self.tick = 0
        self.mismatch = 0.0
        self._largest = np.zeros(1)
        self._peak = np.zeros(coupling.L.shape[1])
        self._kept = 2 * self.memory + widest + 2
        self._usual = 0.0  # step between communication points
        self.sampling = [k for k, part in enumerate(coupling.y_parts) if coupling.held_wires[:, part].any()]

    @property
    def order(self) -> int:
        return self.degree

    def start(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        u, y = super().start(t)
        self.begin(t, u, [[(t, y[part])] for part in self.coupling.y_parts])
        return u, y

    def begin(self, t: float, u: np.ndarray, known: list[list[Point]]) -> None:
        """Begin at t with inputs u (n_u,) and the points known by then."""
        self.known, self.since, self.tick = known, [t] * len(known), 0

    # -- the run -------------------------------------------------------------------------------------------------------

    def run(self, schedule: Schedule, first: np.ndarray) -> Trajectory:
        if schedule.fast:
            hint = "take master jacobi or gauss_seidel with order 0, or leave out fast"
            raise RotorsimError(Problem("it holds inputs and repeats nothing", "the fast loop", hint=hint))
        points, failure = [(0.0, first, 0.0)], None
        try:
            for t, y in self._points(schedule):
                points.append((t, y, self.mismatch))
                if not is_finite(y):
                    break
                schedule.report(t / schedule.end)
        except RotorsimError as error:
            failure = error
        times, rows, mismatch = (np.array(column) for column in zip(*points, strict=True))
        return self.with_last(Trajectory(times, rows, mismatch, failure))

    def _points(self, schedule: Schedule) -> Iterator[tuple[float, np.ndarray]]:
        """Yield time and outputs of every communication point behind the start."""
        step, end = schedule.step, schedule.end
        t, count, width = 0.0, 0, step
        while t < end - 1e-9 * step:
            if schedule.adaptive is None:
                count += 1
                target = min(count * step, end)
                y = self.advance(t, target, last=target >= end - 1e-9 * step)[1]
            else:
                target, y, width = self._doubled(t, min(width, end - t), schedule.adaptive, step)
            t = target
            yield t, y

    def with_last(self, made: Trajectory) -> Trajectory:
        """Return a trajectory with the last sample where an FMU itself asked for the end of the run.

        The outputs of the others are as foreseen there; it takes the place of a point at the same time.
        """
        error, coupling = made.failure, self.coupling
        if not isinstance(error, FmuError) or error.kind != "ended" or not (error.time or 0.0) >= made.times[-1]:
            return made
        t, name = float(error.time or 0.0), error.problems[0].subject
        y = np.array(self.foreseen(t), float)
        own = [(p, part) for p, part in zip(coupling.participants, coupling.y_parts, strict=True) if p.name == name]
        try:
            for participant, part in own:
                y[part] = participant.final()
        except RotorsimError:
            return made
        keep = len(made.times) - (t <= made.times[-1] + 1e-12 * abs(t))
        times, rows = np.append(made.times[:keep], t), np.vstack([made.rows[:keep], y])
        mismatch = np.zeros(len(times)) if made.mismatch is None else np.append(made.mismatch[:keep], 0.0)
        return Trajectory(times, rows, mismatch, error)

    def _doubled(self, t: float, h: float, allowed: float, most: float) -> tuple[float, np.ndarray, float]:
        """Take one step of h and, from the same state, two of h/2; return time, outputs, next step. It ends at hits."""
        wanted, h = h, min(h, max(self.next_hit(t) - t, 1e-6 * most))
        while True:
            saved = self.save()
            _, once = self.step(t, h)
            self.restore(saved)
            self.step(t, h / 2)
            _, twice = self.step(t + h / 2, h / 2)
            scale = np.maximum(np.maximum(np.abs(once), np.abs(twice)), 1e-12)
            self._peak = np.maximum(self._peak, scale)
            error = float((np.abs(twice - once) / self._peak).max(initial=0.0))
            if error <= allowed or h < 1e-6 * most:
                grown = max(h * min(2.0, 0.9 * (allowed / max(error, 1e-30)) ** 0.5), wanted if h < wanted else 0.0)
                return t + h, twice, min(grown, LARGEST_ADAPTIVE * most)
            self.counters["rejected"] += 1
            self.restore(saved)
            wanted = h = h * max(0.2, 0.9 * (allowed / error) ** 0.5)

    # -- steps ---------------------------------------------------------------------------------------------------------

    def advance(self, t: float, end: float, *, last: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Go from one communication point to the next, with more of them at the sample hits that are told.

        With several rates there are none in between: the rate of a sampled participant is to fit its sample time.
        """
        self._usual = h = end - t
        while (hit := self.next_hit(t)) < end - STEP_HIT_TOLERANCE * h:
            self.step(t, max(hit - t, STEP_HIT_TOLERANCE * h))
            t = max(hit, t + STEP_HIT_TOLERANCE * h)
        return self.step(t, end - t, last=last)

    def next_hit(self, t: float) -> float:
        """Return the time of the next sample hit of the participants whose held outputs others use."""
        if max(self.rates) > 1:
            return np.inf
        return min((self.coupling.participants[k].next_hit(t) for k in self.sampling), default=np.inf)

    @abstractmethod
    def step(self, t: float, h: float, *, last: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Advance from t to t + h those whose turn it is; return inputs and outputs there. last: everybody's turn."""

    def _points_of(self, a: int, stride: int, until: float | None) -> list[Point]:
        """Return the newest point of a participant and earlier ones, as many as the degree wants.

        Points much closer than a step (at sample hits) are left out: differences over them would be noise.
        """
        known = self.known[a]
        j = len(known) - 1
        if until is not None:
            while j > 0 and known[j][0] > until:
                j -= 1
        chosen = [known[j]]
        apart = CLOSEST_POINTS * self._usual
        while len(chosen) <= self.degree and (j := j - stride) >= 0:
            if chosen[-1][0] - known[j][0] > apart:
                chosen.append(known[j])
        return chosen

    def foreseen(self, t: float) -> np.ndarray:
        """Return the outputs at t as the points known so far tell them."""
        parts = []
        for a, part in enumerate(self.coupling.y_parts):
            newest, value = self.known[a][-1]
            if self.degree:
                moved = Polynomial(through(self._points_of(a, 1, None), newest, 1.0), 1.0)(t - newest)
                held = self.coupling.is_held[part].reshape(-1, *[1] * (value.ndim - 1))
                value = np.where(held, value, moved)
            parts.append(value)
        return np.concatenate(parts)

    def _accept(self, t: float, y: np.ndarray, due: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Make inputs and outputs agree at the end of a step, and keep what is known there."""
        coupling = self.coupling
        u = coupling.inputs_of(y)
        if coupling.passes:
            u, y = coupling.consistent(t, u, y, due)
        for k in due:
            self._note(k, t, y[coupling.y_parts[k]])
            self.since[k] = t
        self.counters["steps"] += 1
        return u, y

    def _note(self, k: int, t: float, y: np.ndarray) -> None:
        """Keep a point; it takes the place of one at the same time."""
        known = self.known[k]
        if known[-1][0] == t:
            known[-1] = (t, y)
        else:
            known.append((t, y))
            del known[: -self._kept]

    def _compare(self, u: np.ndarray, foreseen: np.ndarray) -> None:
        """Note how far the inputs at the end of the step are from those foreseen, relative to the largest so far."""
        self._largest = np.maximum(self._largest, np.abs(u))
        scale = np.where(self._largest > 0, self._largest, 1.0)
        self.mismatch = float((np.abs(foreseen - u) / scale).max(initial=0.0))

    def save(self) -> SavedMaster:
        """Return the state of all participants and what is known."""
        states = [p.save() for p in self.coupling.participants]
        return SavedMaster(states, [list(points) for points in self.known], list(self.since), self.tick)

    def restore(self, saved: SavedMaster) -> None:
        """Go back to a saved state."""
        for participant, state in zip(self.coupling.participants, saved.states, strict=True):
            participant.restore(state)
        self.known = [list(points) for points in saved.known]
        self.since, self.tick = list(saved.since), saved.tick
