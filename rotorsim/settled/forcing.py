"""Forcing that jumps at known angles (a crack that switches): exact Fourier coefficients of each piece."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from rotorsim.model.compiled import Model

if TYPE_CHECKING:
    from rotorsim.settled.linear_response import Setup

__all__ = ["Jumps"]

GRID = 720  # intervals per period in which a crossing is looked for
NODES = 48  # Gauss-Legendre nodes beyond what the highest harmonic needs


class Jumps:
    """Zero crossings of a model's events that depend on time only: there the forcing jumps or has a kink."""

    def __init__(self, model: Model) -> None:
        trace = model.trace
        crossings = ca.vertsplit(model.closed(trace.events)) if trace.events.numel() else []
        timed = [e for e in crossings if ca.depends_on(e, trace.t) and not ca.depends_on(e, trace.x)]
        self.exist = bool(timed)
        column = ca.vertcat(*timed) if timed else ca.SX(0, 1)
        self._function = ca.Function("events", [trace.t, trace.z, trace.p], [ca.densify(column)])

    def _values(self, times: np.ndarray, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        return np.asarray(self._function(times[None, :], z, p).full())

    def angles(self, base: float, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the instants of the jumps as parts of a period, ascending, in (0, 1]."""
        period = 2 * np.pi / base
        offset = 0.37 / GRID  # no sample exactly on a jump at a round angle
        grid = (np.arange(GRID + 1) + offset) / GRID
        positive = self._values(grid * period, z, p) > 0
        found = []
        for row, signs in enumerate(positive):
            k = np.flatnonzero(signs[1:] != signs[:-1])
            low, high, before = grid[k].copy(), grid[k + 1].copy(), signs[k]
            for _ in range(45 if len(k) else 0):
                middle = (low + high) / 2
                same = (self._values(middle * period, z, p)[row] > 0) == before
                low, high = np.where(same, middle, low), np.where(same, high, middle)
            found.append((low + high) / 2 % 1.0)
        return np.unique(np.concatenate(found)) if found else np.zeros(0)

    def series(self, setup: Setup, base: np.ndarray, p: np.ndarray, H: int) -> tuple[np.ndarray, int]:
        """Return F_k (speeds, H+1, n_x), k = 0..H, integrated piece by piece, and the nodes per period."""
        F = np.zeros((len(base), H + 1, setup.n_x), complex)
        most = 0
        for j, speed in enumerate(base):
            ends = self.angles(float(speed), setup.z, p[j])
            ends = np.append(ends, ends[0] + 1) if len(ends) else np.array([0.0, 1.0])
            nodes, weights = _composite(ends, H)
            f = setup.forcing((nodes * 2 * np.pi / speed)[None], p[j : j + 1])[0]
            wave = np.exp(-2j * np.pi * np.outer(np.arange(H + 1), nodes)) * weights
            F[j] = wave @ f
            most = max(most, len(nodes))
        # what the quadrature leaves of harmonics that are absent
        F[np.abs(F) <= 1e-14 * np.abs(F).max(axis=(0, 1))] = 0.0
        return F, most


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
