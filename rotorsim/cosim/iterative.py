"""The iterative master: each step is repeated until inputs and outputs agree, by Picard or by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.masters import NEAR, Master, Point, Polynomial, SavedMaster, through
from rotorsim.errors import Problem, RotorsimError

__all__ = ["Iterative"]

ITERATIONS = 30
SLOW = 0.5  # a contraction worse than this calls for Newton's method


class Iterative(Master):
    """The step is repeated until the inputs at its end agree with the outputs: Picard, or Newton where that is slow.

    The unknown is the moving part of the inputs at the end; what is held is known at the start. Order 3 (where every
    participant tells the rates of its outputs) interpolates by cubic Hermite polynomials: values and rates at both
    ends. The interface Jacobian at the end of the step is found by repeating the step with each input moved.
    """

    def __init__(
        self, coupling: Coupling, order: int = 3, tolerance: float = 1e-8, rates: Sequence[int] | None = None
    ) -> None:
        self.hermite = order == 3 and coupling.has_rates
        super().__init__(coupling, 1 if self.hermite else max(min(order, 2), 1), tolerance, rates)
        stuck = [p.name for p in coupling.participants if not p.can_restore]
        if stuck:
            hint = "use master waveform, which repeats the whole run, or gauss_seidel"
            raise RotorsimError(Problem(f"cannot take a step back: {', '.join(stuck)}", "iterative master", hint=hint))
        self.scale = np.zeros(len(coupling.u0))
        self.jacobian: np.ndarray | None = None
        self._width = 0.0
        self._rate = np.zeros(len(coupling.u0))

    @property
    def told_order(self) -> int:
        return 3 if self.hermite else self.order

    def start(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        u, y = super().start(t)
        self.begin(t, u)
        return u, y

    def begin(self, t: float, u: np.ndarray) -> None:
        """Find the rates of the inputs at the start."""
        if self.hermite:
            self._rate = self.coupling.consistent_rates(t, u, np.zeros(len(u)))

    def save(self) -> SavedMaster:
        return replace(super().save(), more=self._rate)

    def restore(self, saved: SavedMaster) -> None:
        super().restore(saved)
        assert isinstance(saved.more, np.ndarray)
        self._rate = saved.more

    def _compare(self, u: np.ndarray, foreseen: np.ndarray) -> None:
        """The inputs agree: that is what the iteration ended with."""

    def _past(self, count: int) -> list[Point]:
        """Return time and moving inputs (n_u,) of the newest point and earlier ones, not too close to each other."""
        chosen: list[Point] = []
        for row in zip(*(points[::-1] for points in self.known), strict=True):
            if len(chosen) < count and (not chosen or chosen[-1][0] - row[0][0] > NEAR * self._usual):
                y = np.concatenate([value for _, value in row])
                chosen.append((row[0][0], self.coupling.moving_wires @ y + self.coupling.u0))
        return chosen

    def _try(
        self, t: float, h: float, end: np.ndarray, past: Sequence[Point], held: np.ndarray, saved: Sequence[object]
    ) -> np.ndarray:
        """Return outputs at the end (and h times their rates) for moving inputs that end so."""
        coupling, m = self.coupling, len(self.coupling.u0)
        y, rates = [], []
        for k, part in enumerate(coupling.u_parts):
            participant = coupling.participants[k]
            participant.restore(saved[k])
            points = [(s, u[part]) for s, u in past]
            if self.hermite:
                coefficients = _hermite(points[0][1], h * self._rate[part], end[:m][part], end[m:][part])
            else:
                coefficients = through([(t + h, end[:m][part]), *points], t, h)
            coefficients[0] = coefficients[0] + held[part]
            self.counters["participant_steps"] += 1
            y.append(participant.step(t, h, Polynomial(coefficients, h)))
            if self.hermite:
                rates.append(h * participant.output_rate(t + h, end[:m][part] + held[part], end[m:][part] / h))
        self.counters["iterations"] += 1
        return np.concatenate([*y, *rates])

    def step(self, t: float, h: float, *, last: bool = False) -> tuple[np.ndarray, np.ndarray]:
        coupling = self.coupling
        saved = [p.save() for p in coupling.participants]
        m, n = len(coupling.u0), coupling.L.shape[1]
        past = self._past(1 if self.hermite else self.order)
        u = past[0][1]
        held = coupling.held_wires @ np.concatenate([points[-1][1] for points in self.known])
        if self.hermite:
            end = np.concatenate([u + h * self._rate, h * self._rate])
            L = np.kron(np.eye(2), coupling.moving_wires)
            offset = np.concatenate([coupling.u0, np.zeros(m)])
        else:
            end = Polynomial(through(self._past(self.order + 1), t, h), h)(h)
            L, offset = coupling.moving_wires, coupling.u0
        if abs(h - self._width) > 1e-12 * h:
            self.jacobian, self._width = None, h
        before = np.inf
        for count in range(ITERATIONS):
            y = self._try(t, h, end, past, held, saved)
            residual = L @ y + offset - end
            self.scale = np.maximum(self.scale, np.maximum(np.abs(u), np.abs(end[:m])))
            floor = np.maximum(self.scale, 1e-12 * max(float(self.scale.max(initial=0.0)), 1e-30))
            floor = np.tile(floor, len(end) // m) if m else floor
            size = float((np.abs(residual) / floor).max(initial=0.0))
            if size <= self.tolerance:
                self.mismatch = size
                everybody = range(len(coupling.participants))
                u, accepted = self._accept(t + h, y[:n], everybody, y[:n])
                if self.hermite:
                    self._rate = coupling.consistent_rates(t + h, u, end[m:] / h)
                return u, accepted
            if not np.isfinite(size):
                break
            patience = 4 if self.jacobian is None else 8
            if count > patience or (self.jacobian is None and size > SLOW * before):
                self.jacobian = self._interface(t, h, end, y, past, held, saved, floor)
            if self.jacobian is None:
                end = end + residual
            else:
                try:
                    end = end + np.linalg.solve(np.eye(len(end)) - L @ self.jacobian, residual)
                except np.linalg.LinAlgError:
                    break
            before = size
        what = f"the coupling does not converge at t = {t:g} s with a step of {h:g} s"
        raise RotorsimError(Problem(what, "iterative master", hint="a smaller communication step"), exit_code=1)

    def _interface(
        self,
        t: float,
        h: float,
        end: np.ndarray,
        y: np.ndarray,
        past: Sequence[Point],
        held: np.ndarray,
        saved: Sequence[object],
        floor: np.ndarray,
    ) -> np.ndarray:
        """Return dy/du (outputs, inputs) at the end of the step; inputs of different participants move together."""
        coupling, m, n = self.coupling, len(self.coupling.u0), self.coupling.L.shape[1]
        J = np.zeros((len(y), len(end)))
        widest = max((part.stop - part.start for part in coupling.u_parts), default=0)
        for shift in range(len(end) // max(m, 1)):
            for j in range(widest):
                moved = end.copy()
                columns = [shift * m + part.start + j for part in coupling.u_parts if part.start + j < part.stop]
                steps = 1e-4 * np.where(floor[columns] > 0, floor[columns], 1.0)
                moved[columns] += steps
                change = self._try(t, h, moved, past, held, saved) - y
                for u_part, y_part in zip(coupling.u_parts, coupling.y_parts, strict=True):
                    column = shift * m + u_part.start + j
                    if u_part.start + j < u_part.stop:
                        for rows in (y_part, slice(n + y_part.start, n + y_part.stop))[: len(y) // max(n, 1)]:
                            J[rows, column] = change[rows] / steps[columns.index(column)]
        return J


def _hermite(u0: np.ndarray, r0: np.ndarray, u1: np.ndarray, r1: np.ndarray) -> list[np.ndarray]:
    """Return the coefficients of the cubic with values u0, u1 and rates r0, r1 (per step) at the ends of a step."""
    return [u0, r0, 3 * (u1 - u0) - (2 * r0 + r1), 2 * (u0 - u1) + (r0 + r1)]
