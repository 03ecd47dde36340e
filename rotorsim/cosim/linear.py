"""Linearised participants: x' = A x + B u, y = C x + D u, with jumps of the state at sample hits.

Discrete states stand behind the continuous ones in x, with zero rate; a hit of some samplers is x := J x + K u.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from scipy.linalg import expm

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.participant import CompiledParticipant

if TYPE_CHECKING:
    from rotorsim.cosim.participant import InputHistory

__all__ = ["LinearCoupling", "LinearModel", "LinearParticipant", "linear_part"]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
HIT = 1e-6  # of a period: how far from its time a hit is still due
Jump = Callable[[tuple[int, ...]], tuple[np.ndarray, np.ndarray]]


def _no_jump(_: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    raise AssertionError("there are no samplers")


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Matrices A (n, n), B (n, n_u), C (n_y, n), D (n_y, n_u); periods: of the samplers [s].

    jump: the samplers due -> J (n, n), K (n, n_u). exact: the part itself has these matrices, everywhere and always.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    periods: tuple[float, ...] = ()
    jump: Jump = field(default=_no_jump)
    exact: bool = False

    def due(self, t: float) -> tuple[int, ...]:
        """Return the samplers that have a hit at t."""
        return tuple(k for k, T in enumerate(self.periods) if abs(t / T - round(t / T)) < HIT)

    def hits(self, start: float, end: float) -> list[float]:
        """Return the times of hits after start, until end."""
        times: list[float] = []
        for T in self.periods:
            first, last = int(np.floor(start / T + HIT)) + 1, int(np.floor(end / T + HIT))
            times += [n * T for n in range(first, last + 1)]
        times.sort()
        return [t for k, t in enumerate(times) if k == 0 or t - times[k - 1] > HIT * min(self.periods)]


class LinearParticipant:
    """A linear model as a participant, advanced exactly for inputs that are polynomials between hits.

    It starts from zero right behind the hits at the start. x (n,), or (n, runs): many runs at once.
    """

    can_restore = True
    has_rates = True

    def __init__(self, name: str, inputs: Sequence[str], outputs: Sequence[str], model: LinearModel) -> None:
        self.name, self.inputs, self.outputs, self.model = name, tuple(inputs), tuple(outputs), model
        self.feedthrough = self.following = model.D != 0
        self.moving = np.ones(len(model.C), bool)
        self.x = np.zeros(len(model.A))
        self._known: dict[float, tuple[np.ndarray, list[np.ndarray]]] = {}

    def initialise(self, t: float, u: np.ndarray) -> None:
        self.x = np.zeros(len(self.model.A))

    def start(self, t: float, u: np.ndarray) -> None:
        """Nothing is left to be done."""

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        return np.asarray(self.model.C @ self.x + self.model.D @ u)

    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        m = self.model
        return np.asarray(m.C @ (m.A @ self.x + m.B @ u) + m.D @ rate)

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        at = t
        for hit in self.model.hits(t, t + h) if self.model.periods else ():
            self._flow(at - t, hit - at, u)
            J, K = self.model.jump(self.model.due(hit))
            self.x = J @ self.x + K @ u(hit - t)
            at = hit
        if t + h - at > HIT * h:
            self._flow(at - t, t + h - at, u)
        return self.output(t + h, u(h))

    def _flow(self, start: float, h: float, u: InputHistory) -> None:
        key = float(f"{h:.9e}")
        if key not in self._known:
            A, B = self.model.A, self.model.B
            taus = h * (1 + NODES) / 2
            kernels = [w * h / 2 * expm(A * (h - tau)) @ B for tau, w in zip(taus, WEIGHTS, strict=True)]
            self._known[key] = (expm(A * h), kernels)
        transition, kernels = self._known[key]
        x = transition @ self.x
        for kernel, node in zip(kernels, NODES, strict=True):
            x = x + kernel @ u(start + h * (1 + node) / 2)
        self.x = x

    def next_hit(self, t: float) -> float:
        return min((T * (np.floor(t / T + HIT) + 1) for T in self.model.periods), default=np.inf)

    def forget(self) -> None:
        """Drop the matrices of step widths that will not come again."""
        self._known.clear()

    def save(self) -> Any:
        return self.x.copy()

    def restore(self, saved: Any) -> None:
        self.x = saved.copy()

    def close(self) -> None:
        """Nothing is held."""


class LinearCoupling(Coupling):
    """A coupling of linear participants, whose vectors may be matrices: a column for each of many runs at once."""

    def consistent(
        self, t: float, u: np.ndarray, y: np.ndarray | None = None, due: Sequence[int] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return u and y that agree: (I - L D) u = L C x + u0."""
        turn = range(len(self.participants)) if due is None else due
        D = np.zeros((self.L.shape[1], self.L.shape[0]))
        free = [y[part] if y is not None else None for part in self.y_parts]
        for k in turn:
            participant = self.participants[k]
            assert isinstance(participant, LinearParticipant)
            D[self.y_parts[k], self.u_parts[k]] = participant.model.D
            free[k] = participant.model.C @ participant.x
        known = np.concatenate([part for part in free if part is not None])
        u = np.linalg.solve(np.eye(len(self.L)) - self.L @ D, self.inputs_of(known))
        return u, known + D @ u


def linear_part(participant: CompiledParticipant) -> LinearModel:
    """Return a compiled part linearised where it starts, its sampled blocks included."""
    part, p = participant.part, participant.p
    trace = part.trace
    x0, z0 = part.initial(p)
    n_z, n_s = participant.n_z, len(trace.samplers)
    z, u = (_column(trace.z, places) for places in (range(n_z), range(n_z, trace.z.numel())))
    s = ca.vertcat(trace.x, z)
    y = ca.vertcat(*[part.expression(name) for name in participant.outputs]) if participant.outputs else ca.SX(0, 1)
    rate = ca.vertcat(trace.xdot, ca.SX.zeros(n_z, 1))
    after = ca.vertcat(trace.x, _column(trace.z_next, range(n_z)))
    point = [trace.t, trace.x, trace.z, trace.p]
    slopes = [ca.jacobian(e, by) for e in (rate, y) for by in (s, u)]
    jumps = [ca.jacobian(after, by) for by in (s, u)]
    exact = not any(ca.depends_on(J, ca.vertcat(trace.t, s, u)) for J in (*slopes, *jumps))
    flow = ca.Function("flow", point, [ca.densify(J) for J in slopes])
    n, n_u, n_y = s.numel(), u.numel(), y.numel()
    shapes = ((n, n), (n, n_u), (n_y, n), (n_y, n_u))  # CasADi has shapes of its own for what is empty
    A, B, C, D = (np.array(m.full()).reshape(shape) for m, shape in zip(flow(0.0, x0, z0, p), shapes, strict=True))
    if not n_s:
        return LinearModel(A, B, C, D, exact=exact)
    jump = ca.Function("jump", [*point, trace.w, trace.hit], [ca.densify(J) for J in jumps])
    known: dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]] = {}

    def at(due: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        if due not in known:
            hit = np.isin(np.arange(n_s), due).astype(float)
            found = jump(0.0, x0, z0, p, np.zeros(trace.w.numel()), hit)
            known[due] = (np.array(found[0].full()).reshape(n, n), np.array(found[1].full()).reshape(n, n_u))
        return known[due]

    return LinearModel(A, B, C, D, tuple(float(p[sampler.period]) for sampler in trace.samplers), at, exact)


def _column(vector: Any, places: range) -> Any:
    """Return entries of a vector as a column, also where there are none."""
    return vector[list(places)] if places else ca.SX(0, 1)
