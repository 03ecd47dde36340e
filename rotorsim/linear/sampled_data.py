"""Frequency response of sampled-data systems: s' = A s + B u between hits, s := J s + K u at a hit, exact to rounding.

Between hits s = R exp(i w t) + exp(A t) xi for an input u = exp(i w t), R = (i w - A)^-1 B; over a common period T of
all samplers s(T-) = M s(0-) + g(w), and settled motion has s(T-) = exp(i w T) s(0-). What an analyser shows is the
component of y at w, an integral over T in closed form; the images that sampling makes of it, at w + 2 pi j / T, are not
in it but act on it.

Source: Astrom and Wittenmark, Computer-Controlled Systems, sec. 7.5 (frequency response of sampled-data systems).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from rotorsim.linear.exponentials import Exponentials, exponential
from rotorsim.linear.linear_model import LinearModel, common_period
from rotorsim.linear.state_space import MANY, Resolvent, StateSpace

AT_A_POLE = 1e-7  # of |s|: a resolvent of a relative distance d is off by 1e-14 / d
CIRCLE, ON_CIRCLE = 1e-6, np.arange(8) / 8  # radius, of |s|, and turns of places on the circle
NO_MULTIPLIER = 1e-12  # a multiplier below is zero: its state forgets all within a period


@dataclass(frozen=True, eq=False)
class SampledData:
    """A linear system between hits, and the jumps J (n, n), K (n, m) at times from 0 to below a common period [s].

    shortest: period of the fastest sampler [s]. exponentials: of A, shared with other speeds.
    """

    flow: StateSpace
    times: tuple[float, ...]
    jumps: tuple[tuple[np.ndarray, np.ndarray], ...]
    period: float
    shortest: float = np.inf
    exponentials: Exponentials | None = None

    @classmethod
    def of(cls, model: LinearModel, exponentials: Exponentials | None = None) -> SampledData | None:
        """Return that of a linear model with samplers; None without a common period of at most 10000 hits."""
        if (period := common_period(model.periods)) is None:
            return None
        times = model.period_hits()
        flow = StateSpace(model.A, model.B, model.C, model.D)
        jumps = tuple(model.at_hit(t) for t in times)
        return cls(flow, tuple(times), jumps, period, min(model.periods), exponentials)

    @cached_property
    def lengths(self) -> np.ndarray:
        """Lengths of the intervals behind the hits [s]."""
        return np.diff([*self.times, self.period])

    def exponential(self, h: float) -> np.ndarray:
        """Return exp(A h), by which s changes without a hit within h [s]."""
        A = self.flow.A
        return exponential(A, h) if self.exponentials is None else self.exponentials.of(A, h)

    @cached_property
    def transitions(self) -> tuple[np.ndarray, ...]:
        """exp(A h) of these intervals, each length once."""
        known = {float(f"{h:.9e}"): h for h in self.lengths}
        made = {key: self.exponential(float(h)) for key, h in known.items()}
        return tuple(made[float(f"{h:.9e}")] for h in self.lengths)

    @cached_property
    def monodromy(self) -> np.ndarray:
        """M (n, n), by which s changes over a period without input."""
        M = np.eye(len(self.flow.A))
        for k, (P, (J, _)) in enumerate(zip(self.transitions, self.jumps, strict=True)):
            change = J - np.eye(len(J))
            jumping = np.any(change, axis=1)  # few: what is held between hits
            jumps = change[jumping] @ M if k else change[jumping]
            M = (P @ M if k else P) + P[:, jumping] @ jumps
        return M

    def poles(self) -> np.ndarray:
        """Return ln(mu) / T [1/s] of the multipliers mu that are not zero, with frequencies up to 1 / (2 T)."""
        found = np.linalg.eigvals(self.monodromy)
        return np.asarray(np.log(found[np.abs(found) > NO_MULTIPLIER].astype(complex)) / self.period)

    def amplified(self, gain: float, wires: Sequence[int]) -> SampledData:
        """Return it with what arrives at some wires amplified, see `StateSpace.amplified`."""
        F = self.flow.amplification(gain, wires)
        jumps = tuple((J + K @ F, K[:, :0]) for J, K in self.jumps)
        return replace(self, flow=self.flow.amplified(gain, wires), jumps=jumps, exponentials=None)

    def with_inputs(self, places: Sequence[int]) -> SampledData:
        """Return it with some of its inputs."""
        jumps = tuple((J, K[:, places]) for J, K in self.jumps)
        return replace(self, flow=self.flow.with_inputs(places), jumps=jumps)

    def with_outputs(self, places: Sequence[int]) -> SampledData:
        """Return it with some of its outputs."""
        return replace(self, flow=self.flow.with_outputs(places))

    def opened(self) -> SampledData:
        """Return it with the loops of the first outputs open, see `StateSpace.opened`."""
        F, G = self.flow.opening()
        jumps = tuple((J + K @ F, K @ G) for J, K in self.jumps)
        return replace(self, flow=self.flow.opened(), jumps=jumps, exponentials=None)

    def response(self, frequencies: Any) -> np.ndarray:
        """Return the component of y at f for inputs exp(i 2 pi f t), f [Hz] not 0, shape (len(f), k, m).

        It is analytic at an undamped pole between hits, where (i w - A)^-1 is not: there it is the mean over a circle.
        """
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequencies, float))
        solvers = self._solvers(s)
        at_a_pole = self._at_a_pole(s, solvers.flow)
        found = np.empty((len(s), len(self.flow.C), self.flow.B.shape[1]), complex)
        if not at_a_pole.any():
            return self._in_parts(s, solvers)
        if (~at_a_pole).any():
            found[~at_a_pole] = self._in_parts(s[~at_a_pole], self._solvers(s[~at_a_pole]))
        around = _circle(s[at_a_pole])
        values = self._in_parts(around.ravel(), self._solvers(around.ravel()))
        found[at_a_pole] = values.reshape(len(around), len(ON_CIRCLE), *found.shape[1:]).mean(axis=1)
        return found

    def clear_of_poles(self, s: complex) -> np.ndarray:
        """Return s alone, or at a pole of the flow places around it: over these what is analytic there is averaged."""
        at = np.array([s])
        return _circle(at)[0] if self._at_a_pole(at, self._solvers(at).flow)[0] else at

    def _at_a_pole(self, s: np.ndarray, flow: _Solver | None = None) -> np.ndarray:
        """Return which s (F,) are at a pole of the flow. Matrices that are far from singular have none there."""
        if isinstance(flow, _Few) and flow.away().min(initial=np.inf) > AT_A_POLE:
            return np.zeros(len(s), bool)
        return np.asarray(np.abs(s[:, None] - self._flow_poles).min(axis=1, initial=np.inf) < AT_A_POLE * np.abs(s))

    @cached_property
    def _flow_poles(self) -> np.ndarray:
        return self.flow.poles()

    @cached_property
    def _apart(self) -> tuple[_Apart, _Apart]:
        """A and M."""
        return _Apart.of(self.flow.A), _Apart.of(self.monodromy)

    def _solvers(self, s: np.ndarray) -> _Solvers:
        """Return what solves (s - A) X = B and (exp(s T) - M) X = B, by decompositions once there are many s."""
        kind = _Many if len(s) >= MANY else _Few
        return _Solvers(*(kind(one, at) for one, at in zip(self._apart, (s, np.exp(s * self.period)), strict=True)))

    def _in_parts(self, s: np.ndarray, solvers: _Solvers) -> np.ndarray:
        parts = 1 + len(s) * self.flow.B.size // 2_000_000
        if parts == 1:
            return self._response(s, solvers)
        return np.concatenate([self._response(part, self._solvers(part)) for part in np.array_split(s, parts)])

    def _response(self, s: np.ndarray, solvers: _Solvers) -> np.ndarray:
        motion = self.motion(s, self.flow.B[None], [K[None] for _, K in self.jumps], solvers)
        response = _times(self.flow.C, motion.mean) + self.flow.D
        response[np.isnan(response).any(axis=(1, 2))] = np.inf
        return np.asarray(response)

    def motion(
        self, s: np.ndarray, B: np.ndarray, K: Sequence[np.ndarray], solvers: _Solvers | None = None
    ) -> SettledMotion:
        """Return the settled motion for s' = A s + B exp(s t) between hits and s := J s + K exp(s t) at each.

        s (F,) [1/s], not 0; B and each K (F or 1, n, m). With jumps d_k at t_k, the component of s(t) at exp(s t) has
        (s - A) X = B + (1 / T) sum d_k exp(-s t_k): s' exp(-s t), integrated over T by parts.
        """
        flow, turn = solvers or self._solvers(s)
        R = flow.solved(B)
        waves = np.exp(s[:, None, None] * np.array([*self.times, self.period])[:, None, None, None])
        steps = list(zip(self.transitions, self.jumps, K, waves, waves[1:], strict=False))
        g = np.zeros_like(R)
        for P, (J, _), k, now, then in steps:
            g = _times(P, _times(J, g) + (k - R) * now) + R * then
        before = [turn.solved(g)]
        after, right = [], B + np.zeros_like(R)
        for P, (J, _), k, now, then in steps:
            after.append(_times(J, before[-1]) + k * now)
            right = right + (after[-1] - before[-1]) / (now * self.period)
            before.append(_times(P, after[-1] - R * now) + R * then)
        return SettledMotion(s, R, before[0], tuple(after), flow.solved(right))


def _times(real: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return real (k, n) times X (F, n, m) complex: as real products, without a complex copy of the first."""
    F, n, m = X.shape
    pairs = np.ascontiguousarray(X, complex).view(float) if m else np.zeros((F, n, 0))
    return np.asarray((real @ pairs).view(complex) if m else np.zeros((F, len(real), 0), complex))


def _circle(s: np.ndarray) -> np.ndarray:
    """Return places around each s (F,), (F, 8)."""
    return np.asarray(s[:, None] + CIRCLE * np.abs(s[:, None]) * np.exp(2j * np.pi * ON_CIRCLE))


@dataclass(frozen=True, eq=False)
class SettledMotion:
    """s(t) = R exp(s t) + exp(A (t - t_k)) (after[k] - R exp(s t_k)) behind the hit at t_k; (F, n, m) each.

    mean: of s(t) exp(-s t) over a period, which is the component at s. Those at s + 2 pi i j / T are its images.
    before: s(t) before the hit at 0.
    """

    s: np.ndarray
    R: np.ndarray
    before: np.ndarray
    after: tuple[np.ndarray, ...]
    mean: np.ndarray


@dataclass(frozen=True, eq=False)
class _Apart:
    """A matrix, its states that are held (A_j = 0) apart; the others balanced: moving = scale^-1 A scale, and driven by
    the held ones."""

    places: np.ndarray
    held: np.ndarray
    moving: np.ndarray
    scale: np.ndarray
    driven: np.ndarray

    @classmethod
    def of(cls, A: np.ndarray) -> _Apart:
        from scipy.linalg import matrix_balance  # as long to load as a short run takes

        moves = np.any(A, axis=1)
        balanced, (scale, _) = matrix_balance(A[np.ix_(moves, moves)], permute=False, separate=True)
        return cls(np.flatnonzero(moves), np.flatnonzero(~moves), balanced, scale[:, None], A[np.ix_(moves, ~moves)])

    @cached_property
    def resolvent(self) -> Resolvent:
        """(s - moving)^-1 at many s."""
        return Resolvent(self.moving)


class _Solver:
    """(s - A)^-1 at each s."""

    def __init__(self, A: _Apart, s: np.ndarray) -> None:
        self._A, self._s = A, s[:, None, None]

    def solved(self, right: np.ndarray) -> np.ndarray:
        """Return (s - A)^-1 right, (F, n, m); NaN on a pole."""
        found, A = np.zeros((len(self._s), *right.shape[1:]), complex), self._A
        columns = right[:, A.places]
        if right[:, A.held].any():  # else what is constant stays so
            found[:, A.held] = right[:, A.held] / self._s
            columns = columns + A.driven @ found[:, A.held]
        found[:, A.places] = self._moving(columns / A.scale) * A.scale
        return found

    def _moving(self, columns: np.ndarray) -> np.ndarray:
        raise NotImplementedError


class _Many(_Solver):
    """By one decomposition of A."""

    def _moving(self, columns: np.ndarray) -> np.ndarray:
        return self._A.resolvent.times(columns if len(columns) > 1 else columns[0], self._s.ravel())


class _Few(_Solver):
    """By triangular factors at each s."""

    def __init__(self, A: _Apart, s: np.ndarray) -> None:
        from scipy.linalg.lapack import zgetrf

        super().__init__(A, s)
        self._factors = []
        for at in s:
            matrix = np.array(-A.moving, complex, order="F")
            np.fill_diagonal(matrix, matrix.diagonal() + at)
            self._factors.append(zgetrf(matrix, overwrite_a=1))

    def _moving(self, columns: np.ndarray) -> np.ndarray:
        from scipy.linalg.lapack import zgetrs

        columns = np.broadcast_to(columns, (len(self._factors), *columns.shape[1:]))
        found = np.full(columns.shape, np.nan, complex)
        for k, (lu, pivots, info) in enumerate(self._factors):
            if not info:
                found[k] = zgetrs(lu, pivots, columns[k])[0]
        return found

    def away(self) -> np.ndarray:
        """Return 1 / |(s - A)^-1| of each s, in parts of |s|: from any pole it is at least as far away."""
        from scipy.linalg.lapack import zgecon

        factors = zip(self._factors, np.abs(self._s.ravel()), strict=True)
        return np.array([0.0 if info else zgecon(lu, size)[0] for (lu, _, info), size in factors])


class _Solvers(NamedTuple):
    flow: _Solver
    turn: _Solver
