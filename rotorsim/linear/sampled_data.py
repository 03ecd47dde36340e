"""Frequency response of sampled-data systems: s' = A s + B u between hits, s := J s + K u at a hit, exact to rounding.

Between hits s = R exp(i w t) + exp(A t) xi for an input u = exp(i w t), R = (i w - A)^-1 B; over a common period T of
all samplers s(T-) = M s(0-) + g(w), and settled motion has s(T-) = exp(i w T) s(0-). What an analyser shows is the
component of y at w, an integral over T in closed form; the images that sampling makes of it, at w + 2 pi k / T, are not
in it but act on it.

Source: Astrom and Wittenmark, Computer-Controlled Systems, sec. 7.5 (frequency response of sampled-data systems).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import lcm
from typing import Any

import numpy as np
from scipy.linalg import expm

from rotorsim.linear.linear_model import LinearModel
from rotorsim.linear.state_space import StateSpace, solved

AT_A_POLE = 1e-7  # of |s|: a resolvent of a relative distance d is off by 1e-14 / d
CIRCLE, ON_CIRCLE = 1e-6, np.arange(8) / 8  # radius, of |s|, and turns of places on the circle
NO_MULTIPLIER = 1e-12  # a multiplier below is zero: its state forgets all within a period
MOST_HITS = 10_000  # of a common period: so many matrices are multiplied for each frequency


@dataclass(frozen=True, eq=False)
class SampledData:
    """A linear system between hits, and the jumps J (n, n), K (n, m) at times from 0 to below a common period [s].

    shortest: period of the fastest sampler [s].
    """

    flow: StateSpace
    times: tuple[float, ...]
    jumps: tuple[tuple[np.ndarray, np.ndarray], ...]
    period: float
    shortest: float = np.inf

    @classmethod
    def of(cls, model: LinearModel) -> SampledData | None:
        """Return that of a linear model with samplers; None without a common period of at most 10000 hits."""
        if (period := common_period(model.periods)) is None:
            return None
        times = [0.0, *model.hits(0.0, period - min(model.periods) / 2)]
        flow = StateSpace(model.A, model.B, model.C, model.D)
        return cls(flow, tuple(times), tuple(model.at_hit(t) for t in times), period, min(model.periods))

    @cached_property
    def lengths(self) -> np.ndarray:
        """Lengths of the intervals behind the hits [s]."""
        return np.diff([*self.times, self.period])

    @cached_property
    def transitions(self) -> tuple[np.ndarray, ...]:
        """exp(A h) of these intervals, each length once."""
        known = {float(f"{h:.9e}"): h for h in self.lengths}
        made = {key: expm(self.flow.A * h) for key, h in known.items()}
        return tuple(made[float(f"{h:.9e}")] for h in self.lengths)

    @cached_property
    def monodromy(self) -> np.ndarray:
        """M (n, n), by which s changes over a period without input."""
        M = np.eye(len(self.flow.A))
        for P, (J, _) in zip(self.transitions, self.jumps, strict=True):
            M = P @ J @ M
        return M

    def poles(self) -> np.ndarray:
        """Return ln(mu) / T [1/s] of the multipliers mu that are not zero, with frequencies up to 1 / (2 T)."""
        found = np.linalg.eigvals(self.monodromy)
        return np.asarray(np.log(found[np.abs(found) > NO_MULTIPLIER].astype(complex)) / self.period)

    def amplified(self, gain: float, wires: Sequence[int]) -> SampledData:
        """Return it with what arrives at some wires amplified, see `StateSpace.amplified`."""
        F = self.flow.amplification(gain, wires)
        jumps = tuple((J + K @ F, K[:, :0]) for J, K in self.jumps)
        return replace(self, flow=self.flow.amplified(gain, wires), jumps=jumps)

    def response(self, frequencies: Any) -> np.ndarray:
        """Return the component of y at f for inputs exp(i 2 pi f t), f [Hz] not 0, shape (len(f), k, m).

        It is analytic at an undamped pole between hits, where (i w - A)^-1 is not: there it is the mean over a circle.
        """
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequencies, float))
        poles = np.linalg.eigvals(self.flow.A)
        distance = np.abs(s[:, None] - poles).min(axis=1, initial=np.inf)
        at_a_pole = distance < AT_A_POLE * np.abs(s)
        found = np.empty((len(s), len(self.flow.C), self.flow.B.shape[1]), complex)
        if (~at_a_pole).any():
            found[~at_a_pole] = self._in_parts(s[~at_a_pole])
        if at_a_pole.any():
            around = s[at_a_pole, None] + CIRCLE * np.abs(s[at_a_pole, None]) * np.exp(2j * np.pi * ON_CIRCLE)
            values = self._in_parts(around.ravel()).reshape(len(around), len(ON_CIRCLE), *found.shape[1:])
            found[at_a_pole] = values.mean(axis=1)
        return found

    def _in_parts(self, s: np.ndarray) -> np.ndarray:
        chunks = np.array_split(s, 1 + len(s) * len(self.flow.A) ** 2 // 2_000_000)
        return np.concatenate([self._response(part) for part in chunks])

    def _response(self, s: np.ndarray) -> np.ndarray:
        flow, n = self.flow, len(self.flow.A)
        resolvents = s[:, None, None] * np.eye(n) - flow.A
        R = solved(resolvents, flow.B)
        turn = np.exp(s[:, None, None] * np.array([*self.times, self.period])[:, None, None, None])
        M, g = np.eye(n), np.zeros_like(R)  # s = M s(0-) + g behind each interval
        starts = []  # of xi
        for k, (P, (J, K)) in enumerate(zip(self.transitions, self.jumps, strict=True)):
            starts.append((J @ M, J @ g + (K - R) * turn[k]))
            M, g = P @ starts[-1][0], P @ starts[-1][1] + R * turn[k + 1]
        s0 = solved(turn[-1] * np.eye(n) - M, g)
        total = R * self.period
        for k, (P, (by_s0, by_u)) in enumerate(zip(self.transitions, starts, strict=True)):
            xi = (by_s0 @ s0 + by_u) / turn[k]
            total = total + solved(resolvents, xi - (P @ xi) * np.exp(-s[:, None, None] * self.lengths[k]))
        response = flow.C @ total / self.period + flow.D
        response[np.isnan(response).any(axis=(1, 2))] = np.inf
        return np.asarray(response)


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
