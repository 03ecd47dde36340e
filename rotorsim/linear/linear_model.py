"""Linear models with jumps: x' = A x + B u, y = C x + D u; at a hit of some samplers x := J x + K u.

Discrete states stand behind the continuous ones in x, with zero rate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import lcm
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.model.linearity import jacobian
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.model.part import Part

MOST_HITS = 10_000  # of a common period: so many matrices are multiplied for each frequency
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

    def period_hits(self) -> list[float]:
        """Return the times of hits from 0 to below the common period of all samplers; none without one."""
        period = common_period(self.periods)
        return [] if period is None else [0.0, *self.hits(0.0, period - min(self.periods) / 2)]

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
        self._by = ca.vertcat(trace.x, z), u
        rate = ca.vertcat(trace.xdot, ca.SX.zeros(n_z, 1))
        after = ca.vertcat(trace.x, _column(trace.z_next, range(n_z)))
        self._point = [trace.t, trace.x, trace.z, trace.p]
        self._rates = [jacobian(rate, by) for by in self._by]
        self._jumps = [jacobian(after, by) for by in self._by]
        self._rate_functions = [MatrixFunction(self._point, J) for J in self._rates]
        self._jump = [MatrixFunction([*self._point, trace.w, trace.hit], J) for J in self._jumps]
        self._driven = [rate, after]
        self._read(outputs)

    def reading(self, outputs: Sequence[str]) -> LinearPart:
        """Return it with other outputs; its rates, which take long to derive, are shared."""
        other = copy(self)
        other._read(outputs)
        return other

    def _read(self, outputs: Sequence[str]) -> None:
        trace, (s, u), (rate, after) = self.part.trace, self._by, self._driven
        y = ca.vertcat(*[self.part.expression(name) for name in outputs]) if outputs else ca.SX(0, 1)
        seen = [jacobian(y, by) for by in self._by]
        varying = ca.vertcat(trace.t, s, u)
        self.exact = not any(ca.depends_on(J, varying) for J in (*self._rates, *seen, *self._jumps))
        self._flow = [*self._rate_functions, *(MatrixFunction(self._point, J) for J in seen)]
        still = [ca.SX.zeros(*one.shape) for one in (trace.x, trace.z, trace.w)]
        driving = ca.substitute([rate, y, after], [trace.x, trace.z, trace.w], still)
        self._driving = [MatrixFunction([trace.t, trace.p], column) for column in driving[:2]]
        self._driving_hit = MatrixFunction([trace.t, trace.p, trace.hit], driving[2])
        n, n_u, n_y = s.numel(), u.numel(), y.numel()
        self._shapes = ((n, n), (n, n_u), (n_y, n), (n_y, n_u))  # CasADi has shapes of its own for what is empty

    def at(self, p: np.ndarray) -> LinearModel:
        """Return the matrices with parameters p, where the part starts."""
        trace = self.part.trace
        x0, z0 = self.part.initial(p)
        found = zip(self._flow, self._shapes, strict=True)
        A, B, C, D = (function(0.0, x0, z0, p)[0].reshape(shape) for function, shape in found)

        @cache
        def jump(due: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
            hit = np.isin(np.arange(len(trace.samplers)), due).astype(float)
            given = 0.0, x0, z0, p, np.zeros(trace.w.numel()), hit
            J, K = (function(*given)[0] for function in self._jump)
            return J.reshape(A.shape), K.reshape(B.shape)

        periods = tuple(float(p[sampler.period]) for sampler in trace.samplers)
        return LinearModel(A, B, C, D, periods, jump if periods else None, self.exact)

    def forcing(self, p: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rates (N, n) and the outputs (N, n_y) that time alone makes at instants (N,)."""
        rates, outputs = (function(times[None], p)[..., 0] for function in self._driving)
        return np.broadcast_to(rates, (len(times), rates.shape[1])), np.broadcast_to(
            outputs, (len(times), outputs.shape[1])
        )

    def forcing_at_hit(self, p: np.ndarray, times: np.ndarray, due: tuple[int, ...]) -> np.ndarray:
        """Return what states (N, n) become at a hit of some samplers at instants (N,), of time alone."""
        hit = np.isin(np.arange(len(self.part.trace.samplers)), due).astype(float)
        return self._driving_hit(times[None], p, hit)[..., 0]


def common_period(periods: Sequence[float]) -> float | None:
    """Return the shortest time [s] of which all periods are whole fractions; None where it has too many hits."""
    base = min(periods)
    ratios = [Fraction(T / base).limit_denominator(1000) for T in periods]
    if any(abs(float(r) * base / T - 1) > 1e-9 for r, T in zip(ratios, periods, strict=True)):
        return None
    tick = lcm(*(r.denominator for r in ratios))  # base / tick: periods are whole numbers of it
    counts = [int(r * tick) for r in ratios]
    whole = lcm(*counts)
    return None if sum(whole // count for count in counts) > MOST_HITS else whole * base / tick


def _column(vector: Any, places: range) -> Any:
    """Return entries of a vector as a column, also where there are none."""
    return vector[list(places)] if places else ca.SX(0, 1)
