"""Masters of a co-simulation: Jacobi and Gauss-Seidel; communication steps fixed or adaptive, one rate or several.

Signals between communication points are polynomials through the values at the newest points that are known:
extrapolation (order 0..2), or interpolation where the end of the step is known already. Sampled signals are held.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.participant import Held, InputHistory
from rotorsim.errors import Problem, RotorsimError

__all__ = ["MASTERS", "GaussSeidel", "Jacobi", "Master", "Polynomial", "SavedMaster", "held_mismatch", "make_master"]

MASTERS = ("jacobi", "gauss_seidel", "iterative")
CLOSE = 1e-6  # of a step: a sample hit so close to a communication point is there
NEAR = 0.1  # of a step: points closer than this are not used together
Point = tuple[float, np.ndarray]  # time, outputs of a participant


class Polynomial:
    """u(tau) = c_0 + c_1 (tau / h) + c_2 (tau / h)^2."""

    def __init__(self, coefficients: Sequence[np.ndarray], h: float) -> None:
        self.coefficients, self.h = coefficients, h

    def __call__(self, tau: float) -> np.ndarray:
        if len(self.coefficients) == 1:
            return self.coefficients[0]
        s = tau / self.h
        total = self.coefficients[-1]
        for coefficient in self.coefficients[-2::-1]:
            total = total * s + coefficient
        return total


def through(points: Sequence[Point], start: float, h: float) -> list[np.ndarray]:
    """Return the coefficients, in (t - start) / h, of the polynomial through one to three points (Newton's form)."""
    y0 = points[0][1]
    if len(points) == 1:
        return [y0]
    s = [(t - start) / h for t, _ in points]
    first = (points[1][1] - y0) / (s[1] - s[0])
    if len(points) == 2:
        return [y0 - first * s[0], first]
    second = ((points[2][1] - points[1][1]) / (s[2] - s[1]) - first) / (s[2] - s[0])
    return [y0 - first * s[0] + second * (s[0] * s[1]), first - second * (s[0] + s[1]), second]


@dataclass(frozen=True)
class SavedMaster:
    """All that a master needs to go back: states of the participants, known points, and where it was."""

    states: list[object]
    known: list[list[Point]]
    since: list[float]
    tick: int
    more: object = None


@dataclass(frozen=True)
class _Source:
    """What participant a gives to another: wires of its moving and of its held outputs; stride between points."""

    a: int
    moving: np.ndarray | None
    held: np.ndarray | None
    stride: int


class Master:
    """Advances coupled participants. order: of the polynomial of the signals (0 hold, 1 linear, 2 quadratic).

    rates: how many base steps each participant takes at once; in between, its outputs are extrapolated (held ones
    held). Signals are read at points that are as far apart as the slower of the two participants steps.
    sampling: participants whose sample hits are communication points. mismatch: of the last step, how far the inputs
    that were foreseen are from those that the outputs then ask for, relative to the largest so far.
    """

    def __init__(
        self, coupling: Coupling, order: int = 0, tolerance: float = 1e-8, rates: Sequence[int] | None = None
    ) -> None:
        self.coupling, self.order, self.tolerance = coupling, order, tolerance
        self.rates = tuple(rates or [1] * len(coupling.participants))
        self.known: list[list[Point]] = [[] for _ in coupling.participants]
        self.since = [0.0] * len(coupling.participants)
        self.tick = 0
        self.mismatch = 0.0
        self._largest = np.zeros(1)
        self.peak = np.zeros(coupling.L.shape[1])
        self.counters = {"steps": 0, "participant_steps": 0, "iterations": 0, "rejected": 0}
        self._sources = [self._sources_of(k) for k in range(len(coupling.participants))]
        self.widest = max((s.stride for sources in self._sources for s in sources), default=1)
        self.depth = order * self.widest + 1  # points that a step may look back to
        self._kept = 2 * self.depth + self.widest
        self.plain = False
        self._sequence: list[int] | None = None  # of plain steps, one after the other; None: at once
        self._now: np.ndarray | None = None  # inputs at the last point of plain steps
        self._rows = [(coupling.L[rows], coupling.u0[rows]) for rows in coupling.u_parts]
        self._usual = 0.0  # step between communication points
        self.sampling = [k for k, part in enumerate(coupling.y_parts) if coupling.held_wires[:, part].any()]

    def _sources_of(self, k: int) -> list[_Source]:
        coupling, rows = self.coupling, self.coupling.u_parts[k]
        found = []
        for a, columns in enumerate(coupling.y_parts):
            wires = [L[rows, columns] for L in (coupling.moving_wires, coupling.held_wires)]
            moving, held = (L if L.any() else None for L in wires)
            if moving is not None or held is not None:
                found.append(_Source(a, moving, held, -(-self.rates[k] // self.rates[a])))
        return found

    @property
    def told_order(self) -> int:
        """The order of the polynomial of the inputs within a step."""
        return self.order

    def start(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Initialise all participants at t with inputs that agree with their outputs; return u and y."""
        coupling = self.coupling
        u = coupling.u0.copy()
        for participant, part in zip(coupling.participants, coupling.u_parts, strict=True):
            participant.initialise(t, u[part])
        u, _ = coupling.consistent(t, u)
        for participant, part in zip(coupling.participants, coupling.u_parts, strict=True):
            participant.start(t, u[part])
        u, y = coupling.consistent(t, u)
        self.known = [[(t, y[part])] for part in coupling.y_parts]
        self.since = [t] * len(coupling.participants)
        self.tick, self._now = 0, None
        return u, y

    def advance(self, t: float, end: float, *, last: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Go from one communication point to the next, with more of them at the sample hits that are told.

        With several rates there are none in between: the rate of a sampled participant is to fit its sample time.
        """
        self._usual = h = end - t
        while (hit := self.next_hit(t)) < end - CLOSE * h:
            self.step(t, max(hit - t, CLOSE * h))
            t = max(hit, t + CLOSE * h)
        return self.step(t, end - t, last=last)

    def next_hit(self, t: float) -> float:
        """Return the time of the next sample hit of the participants whose held outputs others use."""
        if max(self.rates) > 1:
            return np.inf
        return min((self.coupling.participants[k].next_hit(t) for k in self.sampling), default=np.inf)

    def step(self, t: float, h: float, *, last: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Advance from t to t + h those whose turn it is; return inputs and outputs there.

        last: it is everybody's turn. Outputs of those that are behind are what the others see of them.
        """
        if self.plain:
            return self._plain_step(t + h)
        if self.tick == 0 and self.order > 1 and self.coupling.has_rates:
            self._look_back(t, h)
        self.tick += 1
        due = [k for k, rate in enumerate(self.rates) if last or self.tick % rate == 0]
        foreseen = self.foreseen(t + h)
        return self._accept(t + h, self._advance(due, t + h, foreseen.copy()), due, foreseen)

    def simplify(self) -> bool:
        """Take plain steps from now on where these do the same; return whether they do.

        All participants then step at one rate with inputs that are held, and none is looked back at. ``mismatch`` is
        not told any more: it follows from the rows (`held_mismatch`).
        """
        one = self.order == 0 and max(self.rates) == 1 and not self.sampling
        self.plain = one and isinstance(self, Jacobi | GaussSeidel)
        if isinstance(self, GaussSeidel):
            self._sequence = self.coupling.order
        return self.plain

    def _plain_step(self, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Advance all from their last point to the end with held inputs; return inputs and outputs there."""
        coupling, known = self.coupling, self.known
        y = np.concatenate([points[-1][1] for points in known])
        if self._sequence is None:
            u = coupling.inputs_of(y) if self._now is None else self._now
            new = [
                participant.step(start, end - start, Held(u[part]))
                for participant, start, part in zip(coupling.participants, self.since, coupling.u_parts, strict=True)
            ]
            y = np.concatenate(new)
        else:
            for k in self._sequence:
                start, (L, u0) = self.since[k], self._rows[k]
                y[coupling.y_parts[k]] = coupling.participants[k].step(start, end - start, Held(L @ y + u0))
        u = coupling.L @ y + coupling.u0
        if coupling.passes:
            u, y = coupling.consistent(end, u, y, range(len(known)))
        for points, part in zip(known, coupling.y_parts, strict=True):
            points[:] = [(end, y[part])]
        self.since = [end] * len(known)
        self._now = u
        self.counters["steps"] += 1
        self.counters["participant_steps"] += len(known)
        return u, y

    def _look_back(self, t: float, h: float) -> None:
        """Put points before the start by the rates of the signals there: the first step is then not a held one."""
        coupling = self.coupling
        if any(len(points) > 1 for points in self.known):
            return
        u = coupling.inputs_of(np.concatenate([points[0][1] for points in self.known]))
        rate = coupling.consistent_rates(t, u, np.zeros_like(u))
        for k, part in enumerate(coupling.u_parts):
            slope = coupling.participants[k].output_rate(t, u[part], rate[part])
            (_, y), apart = self.known[k][0], h * self.rates[k]
            self.known[k] = [(t - j * apart, y - j * apart * slope) for j in range(self.widest, 0, -1)] + self.known[k]

    def _advance(self, due: Sequence[int], end: float, y: np.ndarray) -> np.ndarray:
        """Advance participants to the end; return y with their outputs in it."""
        raise NotImplementedError

    def _step(self, k: int, end: float, until: float | None) -> np.ndarray:
        """Advance one participant with what is known until a time (None: all that is)."""
        start = self.since[k]
        self.counters["participant_steps"] += 1
        return self.coupling.participants[k].step(start, end - start, self._inputs(k, start, end - start, until))

    def _inputs(self, k: int, start: float, h: float, until: float | None) -> InputHistory:
        """Return the inputs of participant k from start to start + h."""
        total = [self.coupling.u0[self.coupling.u_parts[k]]]
        for source in self._sources[k]:
            if source.held is not None:
                total[0] = total[0] + source.held @ self._newest(source.a, start)
            if source.moving is not None:
                points = self._points(source.a, source.stride, until)
                for power, coefficient in enumerate(through(points, start, h)):
                    part = source.moving @ coefficient
                    if power < len(total):
                        total[power] = total[power] + part
                    else:
                        total.append(part)
        return Polynomial(total, h) if len(total) > 1 else Held(total[0])

    def _points(self, a: int, stride: int, until: float | None) -> list[Point]:
        """Return the newest point of a participant and earlier ones, as many as the order wants.

        Points much closer than a step (at sample hits) are left out: differences over them would be noise.
        """
        known = self.known[a]
        j = len(known) - 1
        if until is not None:
            while j > 0 and known[j][0] > until:
                j -= 1
        chosen = [known[j]]
        apart = NEAR * self._usual
        while len(chosen) <= self.order and (j := j - stride) >= 0:
            if chosen[-1][0] - known[j][0] > apart:
                chosen.append(known[j])
        return chosen

    def _newest(self, a: int, t: float) -> np.ndarray:
        """Return the outputs of a participant at its last point until t."""
        known = self.known[a]
        return next((y for time, y in reversed(known) if time <= t), known[0][1])

    def foreseen(self, t: float) -> np.ndarray:
        """Return the outputs at t as the points known so far tell them."""
        parts = []
        for a, part in enumerate(self.coupling.y_parts):
            newest, value = self.known[a][-1]
            if self.order:
                moved = Polynomial(through(self._points(a, 1, None), newest, 1.0), 1.0)(t - newest).copy()
                held = self.coupling.is_held[part]
                moved[held] = value[held]
            parts.append(moved if self.order else value)
        return np.concatenate(parts)

    def _accept(
        self, t: float, y: np.ndarray, due: Sequence[int], foreseen: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        coupling = self.coupling
        u = coupling.inputs_of(y)
        if coupling.passes:
            u, y = coupling.consistent(t, u, y, due)
        self._compare(u, coupling.inputs_of(foreseen))
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
        self.since, self.tick, self._now = list(saved.since), saved.tick, None


def held_mismatch(coupling: Coupling, rows: np.ndarray) -> np.ndarray:
    """Return of rows of outputs (n, n_y) `Master.mismatch` of each step, inputs held: |u_k - u_(k-1)| / max |u|."""
    u = rows @ coupling.L.T + coupling.u0
    largest = np.maximum.accumulate(np.abs(u[1:]), axis=0)
    relative = np.abs(np.diff(u, axis=0)) / np.where(largest > 0, largest, 1.0)
    return np.concatenate([[0.0], relative.max(axis=1, initial=0.0)])


class Jacobi(Master):
    """All participants step at once with what is known at the start of their steps."""

    def _advance(self, due: Sequence[int], end: float, y: np.ndarray) -> np.ndarray:
        for k in due:
            y[self.coupling.y_parts[k]] = self._step(k, end, self.since[k])
        return y


class GaussSeidel(Master):
    """Participants step one after the other; those that come later see the new outputs of the earlier ones."""

    def _advance(self, due: Sequence[int], end: float, y: np.ndarray) -> np.ndarray:
        for k in self.coupling.order:
            if k in due:
                part = self.coupling.y_parts[k]
                y[part] = self._step(k, end, None)
                self._note(k, end, y[part].copy())
        return y


def make_master(
    name: str,
    coupling: Coupling,
    *,
    order: int | None = None,
    tolerance: float = 1e-8,
    rates: Sequence[int] | None = None,
) -> Master:
    """Return a master by name. Raises RotorsimError for unknown names, orders, and rates that it cannot keep."""
    from rotorsim.cosim.iterative import Iterative

    kinds: dict[str, Callable[..., Master]] = {"jacobi": Jacobi, "gauss_seidel": GaussSeidel, "iterative": Iterative}
    if name not in kinds:
        raise RotorsimError(Problem(f"no master '{name}'", hint=f"one of {', '.join(MASTERS)}, waveform"))
    chosen = (3 if name == "iterative" else 0) if order is None else order
    if not 0 <= chosen <= (3 if name == "iterative" else 2):
        hint = "0 holds the inputs, 1 linear, 2 quadratic; 3 for the iterative master"
        raise RotorsimError(Problem(f"extrapolation order {chosen}", name, hint=hint))
    if name == "iterative" and max(rates or [1]) > 1:
        hint = "use master jacobi or gauss_seidel, or the same rate for all"
        raise RotorsimError(Problem("takes all participants at one rate", "iterative master", hint=hint))
    return kinds[name](coupling, chosen, tolerance, rates)
