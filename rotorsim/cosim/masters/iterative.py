"""The iterative master: each step is repeated until inputs and outputs agree, by Picard or by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.inputs import Point, Polynomial, hermite, through
from rotorsim.cosim.masters.master import Settings
from rotorsim.cosim.masters.stepping import CLOSEST_POINTS, SavedMaster, SteppingMaster
from rotorsim.cosim.participant import Participant
from rotorsim.errors import Problem, RotorsimError

ITERATIONS = 30
SLOW_CONTRACTION = 0.5  # a contraction worse than this calls for Newton's method


@dataclass(frozen=True)
class _Trial:
    """A step from t of width h that can be repeated: points past (time, moving inputs), held inputs, saved states."""

    t: float
    h: float
    past: Sequence[Point]
    held: np.ndarray
    saved: Sequence[object]


class Iterative(SteppingMaster):
    """The step is repeated until the inputs at its end agree with the outputs: Picard, or Newton where that is slow.

    The unknown is the moving part of the inputs at the end; what is held is known at the start. Order 3 (where every
    participant tells the rates of its outputs) interpolates by cubic Hermite polynomials: values and rates at both
    ends. The interface Jacobian at the end of the step is found by repeating the step with each input moved.
    """

    name = "iterative"
    linear_in_many = False

    def __init__(self, coupling: Coupling[Participant], settings: Settings) -> None:
        order = 3 if settings.order is None else settings.order
        problems = []
        if not 0 <= order <= 3:
            hint = "0 holds the inputs, 1 linear, 2 quadratic; 3 for the iterative master"
            problems.append(Problem(f"extrapolation order {order}", self.name, hint=hint))
        if max(settings.rates or [1]) > 1:
            hint = "use master jacobi or gauss_seidel, or the same rate for all"
            problems.append(Problem("takes all participants at one rate", "iterative master", hint=hint))
        stuck = [p.name for p in coupling.participants if not p.can_restore]
        if stuck:
            hint = "use master waveform, which repeats the whole run, or gauss_seidel"
            problems.append(Problem(f"cannot take a step back: {', '.join(stuck)}", "iterative master", hint=hint))
        if problems:
            raise RotorsimError(*problems)
        self.hermite = order == 3 and coupling.has_rates
        super().__init__(coupling, settings, 1 if self.hermite else max(min(order, 2), 1))
        self.memory = self.degree - 1
        self.scale = np.zeros(len(coupling.u0))
        self.jacobian: np.ndarray | None = None
        self._width = 0.0
        self._rate = np.zeros(len(coupling.u0))
        for participant in coupling.participants:
            participant.stop = None  # rates are found by very short steps that are taken back, also at the end

    @property
    def order(self) -> int:
        return 3 if self.hermite else self.degree

    def begin(self, t: float, u: np.ndarray, known: list[list[Point]]) -> None:
        super().begin(t, u, known)
        if self.hermite:
            self._rate = self.coupling.consistent_rates(t, u, np.zeros(len(u)))

    def save(self) -> SavedMaster:
        return replace(super().save(), rate=self._rate)

    def restore(self, saved: SavedMaster) -> None:
        super().restore(saved)
        assert saved.rate is not None
        self._rate = saved.rate

    def _past(self, count: int) -> list[Point]:
        """Return time and moving inputs (n_u,) of the newest point and earlier ones, not too close to each other."""
        chosen: list[Point] = []
        for row in zip(*(points[::-1] for points in self.known), strict=True):
            if len(chosen) < count and (not chosen or chosen[-1][0] - row[0][0] > CLOSEST_POINTS * self._usual):
                y = np.concatenate([value for _, value in row])
                chosen.append((row[0][0], self.coupling.moving_wires @ y + self.coupling.u0))
        return chosen

    def _repeat(self, trial: _Trial, end: np.ndarray) -> np.ndarray:
        """Return outputs at the end (and h times their rates) for moving inputs that end so."""
        coupling, m, t, h = self.coupling, len(self.coupling.u0), trial.t, trial.h
        y, rates = [], []
        for participant, part, state in zip(coupling.participants, coupling.u_parts, trial.saved, strict=True):
            participant.restore(state)
            points = [(s, u[part]) for s, u in trial.past]
            if self.hermite:
                coefficients = hermite(points[0][1], h * self._rate[part], end[:m][part], end[m:][part])
            else:
                coefficients = through([(t + h, end[:m][part]), *points], t, h)
            coefficients[0] = coefficients[0] + trial.held[part]
            self.counters["participant_steps"] += 1
            y.append(participant.step(t, h, Polynomial(coefficients, h)))
            if self.hermite:
                rates.append(h * participant.output_rate(t + h, end[:m][part] + trial.held[part], end[m:][part] / h))
        self.counters["iterations"] += 1
        return np.concatenate([*y, *rates])

    def step(self, t: float, h: float, *, last: bool = False) -> tuple[np.ndarray, np.ndarray]:
        coupling = self.coupling
        saved = [p.save() for p in coupling.participants]
        m, n = len(coupling.u0), coupling.L.shape[1]
        past = self._past(1 if self.hermite else self.degree)
        u = past[0][1]
        held = coupling.held_wires @ np.concatenate([points[-1][1] for points in self.known])
        trial = _Trial(t, h, past, held, saved)
        L, offset = coupling.moving_wires, coupling.u0
        if self.hermite:
            end = np.concatenate([u + h * self._rate, h * self._rate])
            L, offset = np.kron(np.eye(2), L), np.concatenate([offset, np.zeros(m)])
        else:
            end = Polynomial(through(self._past(self.degree + 1), t, h), h)(h)
        if abs(h - self._width) > 1e-12 * h:
            self.jacobian, self._width = None, h
        before = np.inf
        for count in range(ITERATIONS):
            y = self._repeat(trial, end)
            residual = L @ y + offset - end
            self.scale = np.maximum(self.scale, np.maximum(np.abs(u), np.abs(end[:m])))
            floor = np.maximum(self.scale, 1e-12 * max(float(self.scale.max(initial=0.0)), 1e-30))
            floor = np.tile(floor, 1 + self.hermite)
            size = float((np.abs(residual) / floor).max(initial=0.0))
            if size <= self.tolerance:
                self.mismatch = size
                u, accepted = self._accept(t + h, y[:n], range(len(coupling.participants)))
                if self.hermite:
                    self._rate = coupling.consistent_rates(t + h, u, end[m:] / h)
                return u, accepted
            if not np.isfinite(size):
                break
            patience = 4 if self.jacobian is None else 8
            if count > patience or (self.jacobian is None and size > SLOW_CONTRACTION * before):
                self.jacobian = self._interface(trial, end, y, floor)
            try:
                slow = self.jacobian is not None
                end = end + (np.linalg.solve(np.eye(len(end)) - L @ self.jacobian, residual) if slow else residual)
            except np.linalg.LinAlgError:
                break
            before = size
        what = f"the coupling does not converge at t = {t:g} s with a step of {h:g} s"
        raise RotorsimError(Problem(what, "iterative master", hint="a smaller communication step"), exit_code=1)

    def _interface(self, trial: _Trial, end: np.ndarray, y: np.ndarray, floor: np.ndarray) -> np.ndarray:
        """Return dy/du (outputs, inputs) at the end of the step; inputs of different participants move together."""
        coupling, m, n = self.coupling, len(self.coupling.u0), self.coupling.L.shape[1]
        J = np.zeros((len(y), len(end)))
        widest = max((part.stop - part.start for part in coupling.u_parts), default=0)
        own = list(zip(coupling.u_parts, coupling.y_parts, strict=True))
        for shift in range(len(end) // max(m, 1)):
            for j in range(widest):
                moving = [(shift * m + u.start + j, part) for u, part in own if u.start + j < u.stop]
                columns = [column for column, _ in moving]
                moved, widths = end.copy(), 1e-4 * np.where(floor[columns] > 0, floor[columns], 1.0)
                moved[columns] += widths
                change = self._repeat(trial, moved) - y
                for (column, part), width in zip(moving, widths, strict=True):
                    for rows in (part, slice(n + part.start, n + part.stop))[: len(y) // max(n, 1)]:
                        J[rows, column] = change[rows] / width
        return J
