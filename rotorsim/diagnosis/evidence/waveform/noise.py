"""Noise of recordings in time: what a model leaves of every signal, stretch by stretch, and how that scatters.

Nothing is known of the noise of a measured run, and what a good model leaves is as a rule its own error. Hence:

- Every measured signal is weighed by what a flexible model leaves of it: the diagram with a force that may be any
  smooth law of displacement and velocity (`ForceMap`) where motion was measured, but not by less than ``resolution``.
- A misfit is that of ``rows`` independent samples: as many as would scatter between stretches of the runs as the
  residual of the flexible model does, and MOST_ROWS at most, so that what explains less than a percent counts as
  nothing.
- A model is adequate unless it predicts stretches left out of the fit worse than ``no_worse`` times the flexible one
  does, or than that by ``flexible_share`` of the square that the diagram left at first, by a t-test over the stretches.
- Covariances are those of the stretches' own scatter (sandwich), so that they hold for coloured errors.

The misfits of all fits to one evidence are in the same units, and so are their criteria.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.evidence.fit import left_out
from rotorsim.diagnosis.evidence.waveform.data import TimeRun
from rotorsim.diagnosis.evidence.waveform.search import Evaluation, Point, TimeSearch
from rotorsim.diagnosis.evidence.waveform.views import View

__all__ = [
    "Stretch",
    "Variance",
    "block_misfit",
    "independent",
    "misfits_left_out",
    "reweigh",
    "reweighted",
    "scale_of",
    "stacked",
    "stretches_of",
    "variance_of",
    "variances",
    "weights_of",
]

STRETCHES = 20  # of all runs together; 4 of each run at least
MOST_ROWS = 2000
LEAST_ROWS = 4  # times the stretches
REWEIGHTED = 4  # times that a fit and the weights follow one another
FLEXIBLE_EVALUATIONS = 15

Stretch = tuple[int, int, int]  # run, first sample, last sample but one
Variance = Mapping[tuple[str, str], float]  # (view, output) -> mean square that counts as noise


def weights_of(views: Sequence[View], runs: Sequence[TimeRun], variance: Variance, rows: int) -> list[list[np.ndarray]]:
    """Return the weights of squares that make a misfit that of ``rows`` independent samples of unit variance."""
    samples = sum(run.size for run in runs) * len(variance)
    return [
        [np.array([rows / samples / variance[view.name, name] for name in view.outputs])] * len(runs) for view in views
    ]


def variances(search: TimeSearch, found: Evaluation) -> dict[tuple[str, str], float]:
    """Return the mean square of the residual of every output of every view, that of `variance_of`."""
    return {
        (view.name, name): float(value)
        for k, view in enumerate(search.views)
        for name, value in zip(view.outputs, variance_of(search, found, k), strict=True)
    }


def misfits_left_out(search: TimeSearch, found: Evaluation, stretches: Sequence[Stretch]) -> np.ndarray:
    """Return the misfits of stretches left out, (B,)."""
    errors, jacobian, counts = stacked(search, found, stretches)
    return left_out(errors, jacobian[:, : search.m], counts)


def scale_of(search: TimeSearch, k: int) -> np.ndarray:
    """Return the mean squares of the outputs of a view less their regression on its inputs at the same instant.

    A position that follows its reference is no larger than the distance between them.
    """
    y = np.concatenate(search.measured[k])
    given = [run.inputs(search.views[k].equations.inputs, 1)[:, 0] for run in search.runs]
    inputs = np.column_stack([np.ones(len(y)), np.concatenate(given)])
    left = y - inputs @ np.linalg.lstsq(inputs, y, rcond=None)[0]
    return np.asarray(np.maximum((left**2).mean(axis=0), 1e-300))


def variance_of(search: TimeSearch, found: Evaluation, k: int) -> np.ndarray:
    """Return the mean square of the residual of each output of a view, ``resolution`` of its scale at least."""
    errors = np.concatenate(found.errors[k])
    return np.asarray(np.maximum((errors**2).mean(axis=0), CRITERIA.resolution**2 * scale_of(search, k)))


def reweigh(search: TimeSearch, found: Evaluation, only: Sequence[int] | None = None) -> None:
    """Weigh the outputs of all views (or some only) by the residual of a fit."""
    for k in range(len(search.views)) if only is None else only:
        search.weights[k] = [1 / variance_of(search, found, k)] * len(search.runs)


def reweighted(search: TimeSearch, point: Point) -> tuple[Point, Evaluation]:
    """Return a fit and its residual; the weights of the whole follow that, in turns."""
    found = search.evaluate(point)
    for _ in range(REWEIGHTED):
        point, found = search.minimise(point, FLEXIBLE_EVALUATIONS)
        if not np.isfinite(found.cost):
            break
        reweigh(search, found, [0])
    return point, found


def stretches_of(runs: Sequence[TimeRun]) -> tuple[Stretch, ...]:
    """Return the stretches into which runs are divided."""
    total = sum(run.size for run in runs)
    found: list[Stretch] = []
    for r, run in enumerate(runs):
        count = max(4, round(STRETCHES * run.size / total))
        ends = np.linspace(0, run.size, count + 1).astype(int)
        found += [(r, int(a), int(b)) for a, b in pairwise(ends)]
    return tuple(found)


def independent(energies: np.ndarray, stretches: Sequence[Stretch]) -> int:
    """Return the number of independent samples whose sums of squares would scatter as those of the stretches do.

    The sum over one of B stretches of n independent samples has the relative variance 2 B / n.
    """
    lengths = np.array([last - first for _, first, last in stretches])
    level = energies / lengths
    spread = float((level.std(ddof=1) / level.mean()) ** 2) if level.mean() > 0 else 0.0
    count = 2 * len(level) / max(spread, 1e-9)
    return int(np.clip(count, LEAST_ROWS * len(level), min(MOST_ROWS, lengths.sum())))


def block_misfit(search: TimeSearch, found: Evaluation, stretches: Sequence[Stretch]) -> np.ndarray:
    """Return the weighted sum of squares of each stretch, (B,)."""
    out = np.zeros(len(stretches))
    for k, errors in enumerate(found.errors):
        for b, (r, first, last) in enumerate(stretches):
            weights = np.broadcast_to(search.weights[k][r], errors[r].shape)[first:last]
            out[b] += float((weights * errors[r][first:last] ** 2).sum())
    return out


def stacked(
    search: TimeSearch, found: Evaluation, stretches: Sequence[Stretch]
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return weighted errors (n,) and their Jacobian (n, q) by all unknowns, stretch by stretch, and the rows of each.

    Starts of runs are among the unknowns, after the parameters.
    """
    size = len(found.gradient)
    parts, slopes, sizes = [], [], []
    offsets, at = [], search.m
    for view in search.views:
        offsets.append(at)
        at += len(search.runs) * view.equations.n
    for r, first, last in stretches:
        count = 0
        for k, view in enumerate(search.views):
            eq = view.equations
            error = found.errors[k][r][first:last]
            root = np.sqrt(np.broadcast_to(search.weights[k][r], found.errors[k][r].shape)[first:last])
            parts.append((root * error).ravel())
            J = np.zeros((error.size, size))
            where = np.r_[0 : eq.m, offsets[k] + r * eq.n : offsets[k] + (r + 1) * eq.n]
            J[:, where] = (root[:, :, None] * found.slopes[k][r][first:last]).reshape(error.size, -1)
            slopes.append(J)
            count += error.size
        sizes.append(count)
    return np.concatenate(parts), np.concatenate(slopes), sizes
