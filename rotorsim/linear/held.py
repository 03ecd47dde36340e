"""Linear systems with sampled blocks: s' = A s + B u between hits, s := J s + K u at a hit, exact to rounding.

s: continuous states, and behind them discrete ones, with zero rate. Between hits s = R exp(i w t) + exp(A t) xi for an
input u = exp(i w t), R = (i w - A)^-1 B; over a common period T of all samplers s(T-) = M s(0-) + g(w), and settled
motion has s(T-) = exp(i w T) s(0-). What an analyser shows is the component of y at w, an integral over T in closed
form; the images that sampling makes of it, at w + 2 pi k / T, are not in it but act on it.

Source: Astrom and Wittenmark, Computer-Controlled Systems, sec. 7.5 (frequency response of sampled systems).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import lcm
from typing import Any

import numpy as np
from scipy.linalg import expm

from rotorsim.linear.state_space import StateSpace, solved

MOST_HITS = 10_000  # of a common period: more is no ratio of periods that anybody chose


@dataclass(frozen=True, eq=False)
class HeldSystem:
    """A linear system with hits: flow (A, B, C, D over s), and J (n, n), K (n, m) of the hit at each of times [s].

    times: from 0, ascending, below the common period [s].
    """

    flow: StateSpace
    times: tuple[float, ...]
    jumps: tuple[tuple[np.ndarray, np.ndarray], ...]
    period: float

    @cached_property
    def lengths(self) -> np.ndarray:
        """Lengths of the intervals behind the hits [s]."""
        return np.diff([*self.times, self.period])

    @cached_property
    def _flows(self) -> tuple[np.ndarray, ...]:
        known = {float(f"{h:.9e}"): h for h in self.lengths}
        made = {key: expm(self.flow.A * h) for key, h in known.items()}
        return tuple(made[float(f"{h:.9e}")] for h in self.lengths)

    @cached_property
    def monodromy(self) -> np.ndarray:
        """M (n, n), by which s changes over a period without input."""
        M = np.eye(len(self.flow.A))
        for P, (J, _) in zip(self._flows, self.jumps, strict=True):
            M = P @ J @ M
        return M

    def multipliers(self) -> np.ndarray:
        """Return the eigenvalues of M, shape (n,): the motion decays if all are below 1."""
        return np.asarray(np.linalg.eigvals(self.monodromy))

    def poles(self) -> np.ndarray:
        """Return ln(multiplier) / T [1/s] of those that are not zero, with frequencies up to 1 / (2 T)."""
        found = self.multipliers()
        return np.asarray(np.log(found[np.abs(found) > 1e-12].astype(complex)) / self.period)

    def with_gain(self, gain: float, inputs: list[int]) -> HeldSystem:
        """Return it with its outputs fed back to inputs of the same number, times gain - 1: that wire amplified."""
        f, n = self.flow, len(self.flow.A)
        F = np.zeros((f.B.shape[1], len(f.C)))
        F[inputs, inputs] = gain - 1
        inside = np.linalg.solve(np.eye(len(F)) - F @ f.D, F @ f.C)
        closed = StateSpace(f.A + f.B @ inside, f.B[:, :0], f.C, f.D[:, :0])
        jumps = tuple((J + K @ inside, np.zeros((n, 0))) for J, K in self.jumps)
        return HeldSystem(closed, self.times, jumps, self.period)

    def response(self, frequencies: Any) -> np.ndarray:
        """Return the component of y at f for inputs exp(i 2 pi f t), f [Hz] not 0, shape (len(f), k, m)."""
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequencies, float))
        chunks = np.array_split(s, 1 + len(s) * len(self.flow.A) ** 2 // 2_000_000)
        return np.concatenate([self._response(part) for part in chunks])

    def _response(self, s: np.ndarray) -> np.ndarray:
        f, n = self.flow, len(self.flow.A)
        resolvents = s[:, None, None] * np.eye(n) - f.A
        R = solved(resolvents, f.B)
        M, g = np.eye(n)[None], np.zeros_like(R)  # s behind each interval, by s at first and by the input
        starts = []
        turn = np.exp(s[:, None, None] * np.array([*self.times, self.period])[:, None, None, None])
        for k, (P, (J, K)) in enumerate(zip(self._flows, self.jumps, strict=True)):
            first, rest = J @ M, J @ g + (K - R) * turn[k]
            starts.append((first, rest))
            M, g = P @ first, P @ rest + R * turn[k + 1]
        s0 = solved(turn[-1] * np.eye(n) - M, g)
        total = R * self.period
        for k, (P, (first, rest)) in enumerate(zip(self._flows, starts, strict=True)):
            xi = (first @ s0 + rest) / turn[k]
            length = np.exp(-s[:, None, None] * self.lengths[k])
            total = total + solved(resolvents, xi - (P @ xi) * length)
        response = f.C @ total / self.period + f.D
        response[np.isnan(response).any(axis=(1, 2))] = np.inf
        return np.asarray(response)


def common_period(periods: tuple[float, ...]) -> tuple[float, tuple[tuple[float, tuple[int, ...]], ...]] | None:
    """Return the common period of samplers [s] and the hits in it (time, samplers due); None without one."""
    base = min(periods)
    ratios = [Fraction(T / base).limit_denominator(1000) for T in periods]
    if any(abs(float(r) * base / T - 1) > 1e-9 for r, T in zip(ratios, periods, strict=True)):
        return None
    tick = lcm(*(r.denominator for r in ratios))  # of which whole numbers are the periods
    counts = [int(r * tick) for r in ratios]
    whole = lcm(*counts)
    if sum(whole // c for c in counts) > MOST_HITS:
        return None
    due: dict[int, list[int]] = {}
    for k, count in enumerate(counts):
        for at in range(0, whole, count):
            due.setdefault(at, []).append(k)
    return whole * base / tick, tuple((at * base / tick, tuple(who)) for at, who in sorted(due.items()))
