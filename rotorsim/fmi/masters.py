"""Masters of a co-simulation: Jacobi, Gauss-Seidel, iterative with rollback; communication steps fixed or adaptive.

Inputs between communication points are polynomials through their values at earlier points (extrapolation, order 0..2)
or, once the end of the step is known, through the values at both ends (interpolation; order 3: and their rates).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.coupling import Coupling
from rotorsim.fmi.participant import InputHistory

__all__ = ["MASTERS", "Master", "make_master"]

MASTERS = ("jacobi", "gauss_seidel", "iterative")
ITERATIONS = 30
SLOW = 0.5  # a contraction worse than this calls for Newton's method
GROWTH, SHRINK = 2.0, 0.2


class _Polynomial:
    """Inputs during a step from values at earlier points (and at the end, where it is known)."""

    def __init__(self, times: Sequence[float], values: Sequence[np.ndarray]) -> None:
        self.times, self.values = list(times), list(values)

    def __call__(self, tau: float) -> np.ndarray:
        if len(self.times) == 1:
            return self.values[0]
        total = np.zeros_like(self.values[0])
        for j, (tj, vj) in enumerate(zip(self.times, self.values, strict=True)):
            weight = 1.0
            for k, tk in enumerate(self.times):
                if k != j:
                    weight *= (tau - tk) / (tj - tk)
            total = total + weight * vj
        return total


class Master:
    """Advances coupled participants. order: of the polynomial of the inputs (0 hold, 1 linear, 2 quadratic).

    held: inputs (n_u,) that are held whatever the order (sampled signals). mismatch: of the last step, how far the
    inputs that were used at its end are from those that the outputs then ask for, relative to the largest so far.
    """

    def __init__(
        self, coupling: Coupling, order: int = 0, tolerance: float = 1e-8, held: np.ndarray | None = None
    ) -> None:
        self.coupling, self.order, self.tolerance = coupling, order, tolerance
        self.held = np.zeros(len(coupling.u0), bool) if held is None else held
        self.past: list[tuple[float, np.ndarray]] = []
        self.mismatch = 0.0
        self._largest = np.zeros(len(coupling.u0))
        self.peak = np.zeros(coupling.L.shape[1])
        self.counters = {"steps": 0, "participant_steps": 0, "iterations": 0, "rejected": 0}

    def start(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Initialise all participants at t with inputs that agree with their outputs; return u and y."""
        u = self.coupling.u0.copy()
        for participant, part in zip(self.coupling.participants, self.coupling.u_parts, strict=True):
            participant.initialise(t, u[part])
        u, y = self.coupling.consistent(t, u)
        self.past = [(t, u)]
        return u, y

    def step(self, t: float, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Advance all from t to t + h; return inputs and outputs there."""
        raise NotImplementedError

    def _history(self, t: float, part: slice, end: np.ndarray | None, h: float) -> InputHistory:
        """Return the inputs of one participant during the step."""
        known = self.past[-(self.order + 1) :]
        if end is not None and self.order > 0:
            earlier = self.past[-self.order :]
            polynomial = _Polynomial([*(s - t for s, _ in earlier), h], [*(v[part] for _, v in earlier), end[part]])
        elif end is not None:
            polynomial = _Polynomial([0.0], [end[part]])
        else:
            polynomial = _Polynomial([s - t for s, _ in known], [v[part] for _, v in known])
        held = self.held[part]
        return polynomial if not held.any() else _PartlyHeld(polynomial, self.past[-1][1][part], held)

    def _advance(self, k: int, t: float, h: float, history: InputHistory) -> np.ndarray:
        self.counters["participant_steps"] += 1
        return self.coupling.participants[k].step(t, h, history)

    def _accept(self, t: float, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u = self.coupling.inputs_of(y)
        if self.coupling.feedthrough.any():
            u, y = self.coupling.consistent(t, u)
        self._compare(t, u)
        self.past = [*self.past[-2:], (t, u)]
        self.counters["steps"] += 1
        return u, y

    def _compare(self, t: float, u: np.ndarray) -> None:
        """Note how far the inputs that were used at the end of the step are from those that came out, relative."""
        start = self.past[-1][0]
        used = self._history(start, slice(0, len(u)), None, t - start)(t - start)
        self._largest = np.maximum(self._largest, np.abs(u))
        scale = np.where(self._largest > 0, self._largest, 1.0)
        self.mismatch = float((np.abs(used - u) / scale).max(initial=0.0))

    def save(self) -> tuple[list[object], list[tuple[float, np.ndarray]]]:
        """Return the state of all participants and the past inputs."""
        return [p.save() for p in self.coupling.participants], list(self.past)

    def restore(self, saved: tuple[list[object], list[tuple[float, np.ndarray]]]) -> None:
        """Go back to a saved state."""
        for participant, state in zip(self.coupling.participants, saved[0], strict=True):
            participant.restore(state)
        self.past = list(saved[1])


class _PartlyHeld:
    def __init__(self, polynomial: InputHistory, last: np.ndarray, held: np.ndarray) -> None:
        self.polynomial, self.last, self.held = polynomial, last, held

    def __call__(self, tau: float) -> np.ndarray:
        return np.where(self.held, self.last, self.polynomial(tau))


class Jacobi(Master):
    """All participants step at once with extrapolated inputs."""

    def step(self, t: float, h: float) -> tuple[np.ndarray, np.ndarray]:
        coupling = self.coupling
        y = np.concatenate([
            self._advance(k, t, h, self._history(t, part, None, h)) for k, part in enumerate(coupling.u_parts)
        ])  # fmt: skip
        return self._accept(t + h, y)


class GaussSeidel(Master):
    """Participants step one after the other; those that come later see the new outputs of the earlier ones."""

    def step(self, t: float, h: float) -> tuple[np.ndarray, np.ndarray]:
        coupling = self.coupling
        _, u = self.past[-1]
        end = self._history(t, slice(0, len(u)), None, h)(h)
        y = np.zeros(coupling.L.shape[1])
        known = np.zeros(len(y), bool)
        for k in coupling.order:
            rows = coupling.u_parts[k]
            fresh = ((coupling.L[rows] != 0) & known).any(axis=1)
            new = end[rows].copy()
            new[fresh] = (coupling.L[rows] @ y + coupling.u0[rows])[fresh]
            whole = end.copy()
            whole[rows] = new
            early = self._history(t, rows, None, h)
            late = self._history(t, rows, whole, h)
            y[coupling.y_parts[k]] = self._advance(k, t, h, _Mixed(early, late, fresh))
            known[coupling.y_parts[k]] = True
        return self._accept(t + h, y)


class _Mixed:
    """Inputs of which some have a known end."""

    def __init__(self, early: InputHistory, late: InputHistory, fresh: np.ndarray) -> None:
        self.early, self.late, self.fresh = early, late, fresh

    def __call__(self, tau: float) -> np.ndarray:
        return np.where(self.fresh, self.late(tau), self.early(tau))


class Iterative(Master):
    """The step is repeated until the inputs at its end agree with the outputs: Picard, or Newton where that is slow.

    Order 3 (where every participant tells the rates of its outputs) interpolates by cubic Hermite polynomials: values
    and rates at both ends. The interface Jacobian at the end of the step is found by repeating the step with each
    input moved.
    """

    jacobian: np.ndarray | None = None

    def _compare(self, t: float, u: np.ndarray) -> None:
        """The inputs agree: that is what the iteration ended with."""

    def __init__(
        self, coupling: Coupling, order: int = 3, tolerance: float = 1e-8, held: np.ndarray | None = None
    ) -> None:  # fmt: skip
        self.hermite = order == 3 and coupling.has_rates
        super().__init__(coupling, max(min(order, 2), 1) if not self.hermite else 1, tolerance, held)
        stuck = [p.name for p in coupling.participants if not p.can_restore]
        if stuck:
            hint = "use master waveform, which repeats the whole run, or gauss_seidel"
            raise RotorsimError(Problem(f"cannot take a step back: {', '.join(stuck)}", "iterative master", hint=hint))
        self.scale = np.zeros(len(coupling.u0))
        self._width = 0.0
        self._rate = np.zeros(len(coupling.u0))

    def start(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        u, y = super().start(t)
        self.begin(t, u)
        return u, y

    def begin(self, t: float, u: np.ndarray) -> None:
        """Find the rates of the inputs at the start."""
        if self.hermite:
            self._rate = self.coupling.consistent_rates(t, u, np.zeros(len(u)))

    def _try(self, t: float, h: float, end: np.ndarray, saved: list[object]) -> np.ndarray:
        """Return outputs at the end (and h times their rates) for inputs that end so."""
        coupling, m = self.coupling, len(self.coupling.u0)
        y, rates = [], []
        start = self.past[-1][1]
        for k, part in enumerate(coupling.u_parts):
            participant = coupling.participants[k]
            participant.restore(saved[k])
            if self.hermite:
                history: InputHistory = _Hermite(start[part], self._rate[part], end[part], end[m:][part] / h, h)
                if self.held[part].any():
                    history = _PartlyHeld(history, start[part], self.held[part])
            else:
                history = self._history(t, part, end, h)
            y.append(self._advance(k, t, h, history))
            if self.hermite:
                rates.append(h * participant.output_rate(t + h, end[part], end[m:][part] / h))
        self.counters["iterations"] += 1
        return np.concatenate([*y, *rates])

    def step(self, t: float, h: float) -> tuple[np.ndarray, np.ndarray]:
        coupling = self.coupling
        saved = [p.save() for p in coupling.participants]
        u = self.past[-1][1]
        m, n = len(u), coupling.L.shape[1]
        if self.hermite:
            end = np.concatenate([u + h * self._rate, h * self._rate])
            L = np.kron(np.eye(2), coupling.L)
            offset = np.concatenate([coupling.u0, np.zeros(m)])
        else:
            end, L, offset = self._history(t, slice(0, m), None, h)(h), coupling.L, coupling.u0
        if abs(h - self._width) > 1e-12 * h:
            self.jacobian, self._width = None, h
        before = np.inf
        for count in range(ITERATIONS):
            y = self._try(t, h, end, saved)
            residual = L @ y + offset - end
            self.scale = np.maximum(self.scale, np.maximum(np.abs(u), np.abs(end[:m])))
            floor = np.maximum(self.scale, 1e-12 * max(float(self.scale.max(initial=0.0)), 1e-30))
            floor = np.tile(floor, len(end) // m) if m else floor
            size = float((np.abs(residual) / floor).max(initial=0.0))
            if size <= self.tolerance:
                self.mismatch = size
                u, y = self._accept(t + h, y[:n])
                if self.hermite:
                    self._rate = coupling.consistent_rates(t + h, u, end[m:] / h)
                return u, y
            if not np.isfinite(size):
                break
            patience = 4 if self.jacobian is None else 8
            if count > patience or (self.jacobian is None and size > SLOW * before):
                self.jacobian = self._interface(t, h, end, y, saved, floor)
            if self.jacobian is None:
                end = end + residual
            else:
                end = end + np.linalg.solve(np.eye(len(end)) - L @ self.jacobian, residual)
            before = size
        raise RotorsimError(
            Problem(
                f"the coupling does not converge at t = {t:g} s with a step of {h:g} s",
                "iterative master",
                hint="a smaller communication step",
            ),
            exit_code=1,
        )

    def _interface(
        self, t: float, h: float, end: np.ndarray, y: np.ndarray, saved: list[object], floor: np.ndarray
    ) -> np.ndarray:  # fmt: skip
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
                change = self._try(t, h, moved, saved) - y
                for u_part, y_part in zip(coupling.u_parts, coupling.y_parts, strict=True):
                    column = shift * m + u_part.start + j
                    if u_part.start + j < u_part.stop:
                        for rows in (y_part, slice(n + y_part.start, n + y_part.stop))[: len(y) // max(n, 1)]:
                            J[rows, column] = change[rows] / steps[columns.index(column)]
        return J


class _Hermite:
    """The cubic with values u0, u1 and rates r0, r1 at both ends of a step."""

    def __init__(self, u0: np.ndarray, r0: np.ndarray, u1: np.ndarray, r1: np.ndarray, h: float) -> None:
        self.coefficients = (u0, h * r0, 3 * (u1 - u0) - h * (2 * r0 + r1), 2 * (u0 - u1) + h * (r0 + r1))
        self.h = h

    def __call__(self, tau: float) -> np.ndarray:
        s = tau / self.h
        a, b, c, d = self.coefficients
        return np.asarray(a + s * (b + s * (c + s * d)))


def make_master(
    name: str, coupling: Coupling, *, order: int | None = None, tolerance: float = 1e-8, held: np.ndarray | None = None
) -> Master:  # fmt: skip
    """Return a master by name. Raises RotorsimError for unknown names and orders."""
    kinds: dict[str, type[Master]] = {"jacobi": Jacobi, "gauss_seidel": GaussSeidel, "iterative": Iterative}
    if name not in kinds:
        raise RotorsimError(Problem(f"no master '{name}'", hint=f"one of {', '.join(MASTERS)}, waveform"))
    chosen = (3 if name == "iterative" else 0) if order is None else order
    if not 0 <= chosen <= (3 if name == "iterative" else 2):
        raise RotorsimError(
            Problem(
                f"extrapolation order {chosen}",
                name,
                hint="0 holds the inputs, 1 linear, 2 quadratic; 3 for the iterative master",
            )
        )
    return kinds[name](coupling, chosen, tolerance, held)
