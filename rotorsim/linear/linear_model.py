"""Linear models with jumps: x' = A x + B u, y = C x + D u; at a hit of some samplers x := J x + K u.

Discrete states stand behind the continuous ones in x, with zero rate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.model.linearity import jacobian
from rotorsim.model.part import Part

HIT = 1e-6  # of a period: how far from its time a hit is still due
Jump = Callable[[tuple[int, ...]], tuple[np.ndarray, np.ndarray]]


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
    jump: Jump | None = None
    exact: bool = False

    def due(self, t: float) -> tuple[int, ...]:
        """Return the samplers that have a hit at t."""
        return tuple(k for k, T in enumerate(self.periods) if abs(t / T - round(t / T)) < HIT)

    def at_hit(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Return J (n, n) and K (n, n_u) of the jump at t; without a hit the state stays as it is."""
        due = self.due(t)
        return self.jump(due) if due and self.jump else (np.eye(len(self.A)), np.zeros_like(self.B))

    def hits(self, start: float, end: float) -> list[float]:
        """Return the times of hits after start, until end."""
        ranges = [(T, int(np.floor(start / T + HIT)) + 1, int(np.floor(end / T + HIT))) for T in self.periods]
        times = sorted(n * T for T, first, last in ranges for n in range(first, last + 1))
        return [t for k, t in enumerate(times) if k == 0 or t - times[k - 1] > HIT * min(self.periods)]


class LinearPart:
    """The derivatives of a part with its sampled blocks as functions, made once; its inputs lie behind n_z of z.

    exact: the part itself has these matrices, everywhere and always.
    """

    def __init__(self, part: Part, n_z: int, outputs: Sequence[str]) -> None:
        trace = part.trace
        self.part = part
        z, u = (_column(trace.z, places) for places in (range(n_z), range(n_z, trace.z.numel())))
        s = ca.vertcat(trace.x, z)
        y = ca.vertcat(*[part.expression(name) for name in outputs]) if outputs else ca.SX(0, 1)
        rate = ca.vertcat(trace.xdot, ca.SX.zeros(n_z, 1))
        after = ca.vertcat(trace.x, _column(trace.z_next, range(n_z)))
        point = [trace.t, trace.x, trace.z, trace.p]
        blocks = [jacobian(e, by) for e in (rate, y) for by in (s, u)]
        jumps = [jacobian(after, by) for by in (s, u)]
        self.exact = not any(ca.depends_on(J, ca.vertcat(trace.t, s, u)) for J in (*blocks, *jumps))
        self._flow = ca.Function("flow", point, [ca.densify(J) for J in blocks])
        self._jump = ca.Function("jump", [*point, trace.w, trace.hit], [ca.densify(J) for J in jumps])
        n, n_u, n_y = s.numel(), u.numel(), y.numel()
        self._shapes = ((n, n), (n, n_u), (n_y, n), (n_y, n_u))  # CasADi has shapes of its own for what is empty

    def at(self, p: np.ndarray) -> LinearModel:
        """Return the matrices with parameters p, where the part starts."""
        trace = self.part.trace
        x0, z0 = self.part.initial(p)
        found = [np.array(m.full()) for m in self._flow(0.0, x0, z0, p)]
        A, B, C, D = (m.reshape(shape) for m, shape in zip(found, self._shapes, strict=True))

        @cache
        def jump(due: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
            hit = np.isin(np.arange(len(trace.samplers)), due).astype(float)
            J, K = self._jump(0.0, x0, z0, p, np.zeros(trace.w.numel()), hit)
            return np.array(J.full()).reshape(A.shape), np.array(K.full()).reshape(B.shape)

        periods = tuple(float(p[sampler.period]) for sampler in trace.samplers)
        return LinearModel(A, B, C, D, periods, jump if periods else None, self.exact)


def _column(vector: Any, places: range) -> Any:
    """Return entries of a vector as a column, also where there are none."""
    return vector[list(places)] if places else ca.SX(0, 1)
