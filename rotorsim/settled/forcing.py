"""The forcing of a diagram, dx/dt at x = 0, over a period: Fourier coefficients, exact also where it jumps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import casadi as ca
import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import Model
from rotorsim.settled.equations import (
    FIRST_SAMPLES,
    MOST_PERIOD_SAMPLES,
    RESOLVED,
    PortEquations,
    instants,
    without_inputs,
)

ZERO_COEFFICIENT = 1e-14  # coefficients below this part of the largest are rounding, not motion
NOISE_MARGIN = (
    4.0  # times the last coefficients of a series that has ended, below `RESOLVED`: as small ones are rounding
)
LARGEST_HARMONIC = 255  # kept by default
PROBE = 0.3819660112501051  # off-grid instant (part of a period) at which the series is checked
CROSSING_INTERVALS = 720  # intervals per period in which a crossing is looked for
NODES = 48  # Gauss-Legendre nodes beyond what the highest harmonic needs


@dataclass(frozen=True, eq=False)
class Series:
    """F (speeds, H+1, n_x), k = 0..H; samples per period; whether the series has ended there."""

    F: np.ndarray
    samples: int
    ended: bool


class Forcing:
    """The forcing of a model. jumps: whether it jumps, or has a kink, where an event of time only crosses zero."""

    def __init__(self, model: Model) -> None:
        trace = model.trace
        self.model, self.z = model, model.z0(model.p0)
        crossings = ca.vertsplit(without_inputs(model, trace.events)) if trace.events.numel() else []
        timed = [e for e in crossings if ca.depends_on(e, trace.t) and not ca.depends_on(e, trace.x)]
        self.jumps = bool(timed)
        column = ca.vertcat(*timed) if timed else ca.SX(0, 1)
        self._function = ca.Function("events", [trace.t, trace.z, trace.p], [ca.densify(column)])
        self._samples = FIRST_SAMPLES

    def series(self, equations: PortEquations, base: np.ndarray, p: np.ndarray, harmonics: int | None) -> Series:
        """Return the Fourier coefficients at base frequencies [rad/s] and p (speeds, n_p), at least ``harmonics``.

        The number of samples grows until the series has ended and agrees with the forcing at an instant between
        the samples. Forcing that jumps is integrated piecewise between its jumps by Gauss-Legendre quadrature.
        Raises RotorsimError when the forcing does not return after one period.
        """
        probes = 2 * np.pi / base[:, None] * np.array([PROBE, 1 + PROBE])
        probed = _sampled(equations, p, probes)
        self._check_period(probed, base)
        if self.jumps:
            return self._integrated(equations, base, p, harmonics or LARGEST_HARMONIC)
        m = self._samples
        while harmonics is not None and m < 2 * harmonics + 2:
            m *= 2
        while True:
            F = np.fft.rfft(_sampled(equations, p, instants(base, m)), axis=1)[:, : m // 2] / m
            size = np.abs(F).max(axis=0)
            largest = size.max(axis=0)
            wave = np.exp(2j * np.pi * PROBE * np.arange(m // 2))
            wave[1:] *= 2
            error = np.abs(np.tensordot(F, wave, (1, 0)).real - probed[:, 0]).max(axis=0)
            ended = bool(np.all(size[3 * m // 8 :] <= RESOLVED * largest) and np.all(error <= 1e-9 * largest))
            if ended or m >= MOST_PERIOD_SAMPLES:
                break
            m *= 2
        if ended and harmonics is None:
            self._samples = m
        rounding = NOISE_MARGIN * size[3 * m // 8 :].max(axis=0) if ended else 0.0
        F[np.abs(F) <= np.maximum(ZERO_COEFFICIENT * largest, rounding)] = 0.0
        return Series(F if ended else F[:, : max(harmonics or 0, LARGEST_HARMONIC) + 1], m, ended)

    def _check_period(self, f: np.ndarray, base: np.ndarray) -> None:
        """Raise unless forcing at two instants one period apart, (speeds, 2, n_x), is the same."""
        bad = np.abs(f[:, 1] - f[:, 0]) > 1e-7 * np.abs(f).max(axis=(0, 1))
        if bad.any():
            j, k = map(int, np.argwhere(bad)[0])
            raise RotorsimError(
                Problem(
                    what=f"the forcing at {base[j]:.6g} rad/s is not the same one period later: the motion is not "
                    "periodic",
                    subject=self.model.block_of_state(k),
                    hint="use a constant speed; for a longer period give its number of turns (subharmonic)",
                )
            )

    def _angles(self, base: float, p: np.ndarray) -> np.ndarray:
        """Return the instants of the jumps as parts of a period, ascending, in (0, 1]."""

        def positive(parts: np.ndarray) -> np.ndarray:
            return np.asarray(self._function(parts[None] * (2 * np.pi / base), self.z, p).full() > 0)

        grid = (
            np.arange(CROSSING_INTERVALS + 1) + 0.37
        ) / CROSSING_INTERVALS  # no sample exactly on a jump at a round angle
        signs = positive(grid)
        row, k = np.nonzero(signs[:, 1:] != signs[:, :-1])
        low, high, before = grid[k], grid[k + 1], signs[row, k]
        for _ in range(45 if len(k) else 0):
            middle = (low + high) / 2
            same = positive(middle)[row, np.arange(len(k))] == before
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return np.unique((low + high) / 2 % 1.0)

    def _integrated(self, equations: PortEquations, base: np.ndarray, p: np.ndarray, H: int) -> Series:
        """Return F_k, k = 0..H, integrated piece by piece between the jumps."""
        F = np.zeros((len(base), H + 1, equations.r), complex)
        most = 0
        for j, speed in enumerate(base):
            ends = self._angles(float(speed), p[j])
            ends = np.append(ends, ends[0] + 1) if len(ends) else np.array([0.0, 1.0])
            nodes, weights = _composite(ends, H)
            f = _sampled(equations, p[j : j + 1], nodes[None] * (2 * np.pi / speed))[0]
            F[j] = (np.exp(-2j * np.pi * np.outer(np.arange(H + 1), nodes)) * weights) @ f
            most = max(most, len(nodes))
        F[np.abs(F) <= ZERO_COEFFICIENT * np.abs(F).max(axis=(0, 1))] = (
            0.0  # the quadrature's error, of harmonics not there
        )
        return Series(F, most, False)


def _sampled(equations: PortEquations, p: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return dx/dt at x = 0, (speeds, instants, n_x), for times (speeds, instants)."""
    return equations.at_rest(p, np.zeros((len(p), 0)), times)


@lru_cache(maxsize=64)
def _legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(count)


def _composite(ends: np.ndarray, H: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss-Legendre nodes and weights over pieces of a period that resolve harmonics up to H."""
    nodes, weights = [], []
    for low, high in pairwise(ends):
        if high - low < 1e-12:
            continue
        count = int(np.ceil(np.pi * (high - low) * H)) + NODES  # half a phase per node, and a margin
        x, w = _legendre(count)
        nodes.append((low + high) / 2 + (high - low) / 2 * x)
        weights.append((high - low) / 2 * w)
    return np.concatenate(nodes), np.concatenate(weights)


def size_beyond(X: np.ndarray, H: int) -> np.ndarray:
    """Return the largest harmonic above order H relative to the largest but the mean, worst state, (speeds,)."""
    size = np.abs(X[:, 1:])
    largest = size.max(axis=1, initial=0.0)
    beyond = size[:, H:].max(axis=1, initial=0.0)
    moving = largest > ZERO_COEFFICIENT * largest.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(np.divide(beyond, largest, out=np.zeros_like(beyond), where=moving).max(axis=1, initial=0.0))
