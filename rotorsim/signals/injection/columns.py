"""What the test signal of one axis does to all: columns of S from runs, and whether signals and runs are consistent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.special import stdtrit

from rotorsim.recordings.injection import AFTER, BEFORE
from rotorsim.signals.injection.local_polynomial import response
from rotorsim.signals.injection.run_spectra import RunSpectra

DOUBTFUL = 0.3  # half width of the 90 % interval of |S|, of its value, from which on it is not measured
EXACT = 2e-3  # of |S|: a standard deviation below that is not believed, since windows bias it by as much
SCALED = 0.1  # standard deviation of (V1 - V2) / E, of its size: above, E is no test signal there
ISLAND = 8  # neighbours on the grid: where fewer together were measured, noise may have chosen them
NO_NOISE = 4.0  # standard deviations between runs, or between V1 - V2 and E, that are no noise
OF_BEST = ("smooth", "freedom", "coherence", "scale", "scale_std")  # of several runs, those of the best


@dataclass(frozen=True, eq=False)
class Column:
    """S (n, m) of all axes to the test signal of one, std (n, m), circular complex; freedom, coherence (n,) of it.

    smooth (n,): |S| of its own axis with less noise, see `Response`. scale (n,): (V1 - V2) / E, and its std.
    apart (n,): the largest difference between runs, of S, where that is more than their noise.
    """

    S: np.ndarray
    std: np.ndarray
    smooth: np.ndarray
    freedom: np.ndarray
    coherence: np.ndarray
    scale: np.ndarray
    scale_std: np.ndarray
    apart: np.ndarray

    def half_width(self, i: int) -> np.ndarray:
        """Return the half width (n,) of the 90 % interval of |S_i|: half of the variance of S is along it."""
        with np.errstate(invalid="ignore"):
            return np.asarray(stdtrit(2 * self.freedom, 0.95) * self.std[:, i] / np.sqrt(2))

    def measured(self, i: int) -> np.ndarray:
        """Return where |S_i| is told (n,), but for islands."""
        with np.errstate(invalid="ignore"):
            told = self.half_width(i) < DOUBTFUL * np.abs(self.S[:, i])
        edges = np.flatnonzero(np.diff(np.concatenate([[False], told, [False]]).astype(int)))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            told[first:last] &= last - first >= ISLAND
        return np.asarray(told)


def merged(hz: np.ndarray, column: Column, more_hz: np.ndarray, more: Column) -> tuple[np.ndarray, Column]:
    """Return two parts of a column in the order of their frequencies."""
    order = np.argsort(both := np.concatenate([hz, more_hz]))
    parts = ((getattr(column, item.name), getattr(more, item.name)) for item in fields(Column))
    return both[order], Column(*(np.concatenate(pair)[order] for pair in parts))


def column(group: Sequence[RunSpectra], name: str, names: Sequence[str], hz: np.ndarray) -> Column:
    """Return the column of an axis: of several runs their mean, weighed by variances, which hold their differences."""
    every = [_column_of(one, name, names, hz) for one in group if name in one.axes]
    if len(every) == 1:
        return every[0]
    weights = np.stack([np.where(np.isfinite(one.S) & (one.std > 0), 1 / one.std**2, 0.0) for one in every])
    total, i = weights.sum(axis=0), names.index(name)
    with np.errstate(invalid="ignore", divide="ignore"):
        S = sum(w * np.nan_to_num(one.S) for w, one in zip(weights, every, strict=True)) / total
        off = np.stack([np.where(np.isfinite(one.S), np.abs(one.S - S), 0.0) for one in every])
        beyond = off > NO_NOISE * np.stack([np.nan_to_num(one.std, nan=np.inf) for one in every])
        spread = np.where(beyond, off, 0.0).max(axis=0)
        std = np.hypot(np.where(total > 0, total, np.nan) ** -0.5, spread)
        apart = spread[:, i] / np.abs(S[:, i])
    best, at = np.argmax(weights[:, :, i], axis=0), np.arange(len(hz))
    of_best = {key: np.stack([getattr(one, key) for one in every])[best, at] for key in OF_BEST}
    return Column(np.where(total > 0, S, np.nan), std, apart=np.nan_to_num(apart), **of_best)


def _column_of(one: RunSpectra, name: str, names: Sequence[str], hz: np.ndarray) -> Column:
    """Return the column of an axis from one run: S_i = R1_i / (R1_j - R2_j)."""
    found = response(one.spectra, hz)
    j, v1, v2 = one.axes.index(name), one.outputs[name, AFTER], one.outputs[name, BEFORE]
    R, wide, C = found.S[:, :, j], found.smooth[:, :, j], found.covariance[:, j]
    to_scale = np.zeros(R.shape[1])
    to_scale[v1], to_scale[v2] = 1, -1
    scale = R @ to_scale
    lines = np.minimum(np.round(hz / one.spectra.step).astype(int), len(one.spectra.U) - 1)
    S, std = (np.full((len(hz), len(names)), np.nan, kind) for kind in (complex, float))
    with np.errstate(invalid="ignore", divide="ignore"):
        scale_std = np.sqrt(np.maximum((to_scale @ C @ to_scale).real, 0.0))
        told = (hz <= one.highest) & one.spectra.excited[lines, j] & (scale_std < SCALED * np.abs(scale))
        told &= ~one.rest[lines]
        wider = wide / (wide @ to_scale)[:, None]
        for i, other in enumerate(names):
            k = one.outputs.get((other, AFTER))
            if k is None:
                continue
            S[:, i] = R[:, k] / scale
            g = np.zeros(R.shape, complex)
            g[:, k] += 1
            g -= S[:, [i]] * to_scale
            variance = np.einsum("na,nab,nb->n", g, C, g.conj()).real / np.abs(scale) ** 2
            doubt = np.where(found.alone, np.abs(wider[:, k] - S[:, i]), 0.0)
            std[:, i] = np.hypot(np.maximum(np.sqrt(np.maximum(variance, 0.0)), EXACT * np.abs(S[:, i])), doubt)
            S[~told, i], std[~told, i] = np.nan, np.nan
    own = names.index(name)
    smooth = np.abs(np.where(found.alone, S[:, own], wider[:, v1]))
    return Column(S, std, smooth, found.freedom, found.coherence[:, v1, j], scale, scale_std, np.zeros(len(hz)))
