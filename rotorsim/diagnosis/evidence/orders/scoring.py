"""How well a diagram predicts order vectors of hold-out runs, or of stretches of speed left out, beside the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher

from rotorsim.diagnosis.evidence.evidence import HeldScore
from rotorsim.diagnosis.evidence.orders.fitting import known_rows, stretches_of
from rotorsim.diagnosis.evidence.orders.noise import RowNoise, WhitenedSearch, plain, whitened_search
from rotorsim.identification.left_out import standardised, surprise
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.noise import stacked
from rotorsim.identification.waveform.noise_model import SIMULATION_DIVERGES
from rotorsim.identification.waveform.order_tracking import TrackedOrders, vectors_of
from rotorsim.identification.waveform.search import REFIT_EVALUATIONS
from rotorsim.units import conversion

FOLDS = 4  # each leaves out every fourth stretch of speed
MISSING = complex(np.nan, np.nan)
LEAST_PROBABILITY = 1e-250  # below, a misfit is as it is: its distribution is not known so far out


@dataclass(frozen=True, eq=False)
class Predicted:
    """Order vectors of runs as measured, and as a diagram predicts them that was not fitted to them: (n, c) complex."""

    tracked: TrackedOrders
    vectors: Sequence[np.ndarray]


def held_score(
    fitted: WhitenedSearch, held: Sequence[TrackedOrders], at: Evaluation, noise: Mapping[str, RowNoise]
) -> HeldScore:
    """Return the score of hold-out runs of a diagram that is fitted to other runs; at: that fit."""
    searches = [whitened_search(tracked, noise) for tracked in held]
    ends = [search.evaluate(at.unknowns, search.substeps(at.unknowns)) for search in searches]
    if not all(np.isfinite(end.cost) for end in ends):
        return unpredicted(SIMULATION_DIVERGES)
    known, pairs, rows = _known(fitted, at), [], 0
    use = ~fitted.at_bound(at.unknowns)
    everything: list[tuple[np.ndarray, np.ndarray]] = []
    for search, end in zip(searches, ends, strict=True):
        for r, measured in enumerate(search.measured[0]):
            e, J, _ = stacked(search, end, [(r, 0, len(measured))])
            size = int(np.isfinite(measured).sum())
            everything.append((e, J))
            misfit = surprise(known[:, use], e, J[:, use])
            pairs.append((float("nan") if misfit is None else _chi_squared(misfit, size, noise), float(size)))
            rows += size
    e, J = (np.concatenate(part) for part in zip(*everything, strict=True))
    misfit = surprise(known[:, use], e, J[:, use])
    whole = None if misfit is None else _chi_squared(misfit, rows, noise)
    predicted = [
        Predicted(search.tracked, vectors_of(plain(search), end))
        for search, end in zip(searches, ends, strict=True)
        if search.tracked is not None
    ]
    return replace(_errors(predicted, noise), misfit=whole, rows=rows, runs=tuple(pairs))


def left_out_score(search: WhitenedSearch, at: Evaluation, noise: Mapping[str, RowNoise]) -> HeldScore:
    """Return the score of stretches of speed that are left out, the diagram refitted to the others each time.

    misfit is that of `standardised`, stretch by stretch.
    """
    tracked = search.tracked
    assert tracked is not None
    whole = [np.full(track.vectors.shape, MISSING) for track in tracked.tracks]
    stretches = stretches_of(search)
    for fold in range(FOLDS):
        out = [np.zeros(len(track.vectors), bool) for track in tracked.tracks]
        for r, first, last in stretches[fold::FOLDS]:
            out[r][first:last] = True
        rest = (
            replace(track, vectors=np.where(own[:, None], MISSING, track.vectors))
            for track, own in zip(tracked.tracks, out, strict=True)
        )
        other = whitened_search(replace(tracked, tracks=tuple(rest)), noise)
        end = other.minimise(at.unknowns, REFIT_EVALUATIONS)
        if not np.isfinite(end.cost):
            return unpredicted(SIMULATION_DIVERGES)
        for vectors, found, own in zip(whole, vectors_of(plain(other), end), out, strict=True):
            vectors[own] = found[own]
    e, _, sizes = stacked(search, at, stretches)
    use = ~search.at_bound(at.unknowns)
    pairs = []
    for (r, first, last), pair in zip(stretches, standardised(_known(search, at)[:, use], e, sizes), strict=True):
        missing = int((~np.isfinite(search.measured[0][r][first:last])).sum())
        pairs.append((pair[0], max(pair[1] - missing, 1.0)))
    misfit, rows = (sum(pair[k] for pair in pairs) for k in (0, 1))
    count = max(round(rows), 1)
    misfit = _chi_squared(misfit, count, noise)
    return replace(_errors([Predicted(tracked, whole)], noise), misfit=misfit, rows=count, runs=tuple(pairs))


def unpredicted(reason: str) -> HeldScore:
    """Return the score of a diagram that predicts nothing."""
    return HeldScore({"": float("nan")}, {}, reason=reason)


def _known(search: WhitenedSearch, at: Evaluation) -> np.ndarray:
    """Return the whitened Jacobian of the fitted rows, then that of priors, (n, q)."""
    _, J, _ = stacked(search, at, [(r, 0, len(y)) for r, y in enumerate(search.measured[0])])
    priors = np.zeros(len(at.unknowns))
    for j, item in enumerate(search.free):
        priors[j] = 0.0 if item.prior_std is None else 1 / item.prior_std
    return np.concatenate([J, np.diag(priors)])


def _chi_squared(misfit: float, rows: int, noise: Mapping[str, RowNoise]) -> float:
    """Return a misfit as likely, were the level of the noise known exactly: it is known from few rows itself (F)."""
    probability = float(fisher.sf(misfit / max(rows, 1), max(rows, 1), known_rows(noise)))
    likely = float(chi2.isf(probability, max(rows, 1))) if probability > LEAST_PROBABILITY else misfit
    return min(likely, misfit) if misfit > rows else misfit


def _errors(predicted: Sequence[Predicted], noise: Mapping[str, RowNoise]) -> HeldScore:
    """Return sqrt(sum |Y - Y_model|^2 / sum |Y - mean|^2) of every channel, what noise alone makes of it, and rms."""
    ports: dict[str, float] = {}
    floor: dict[str, float] = {}
    rms: dict[str, tuple[float, str]] = {}
    for c, channel in enumerate(predicted[0].tracked.channels):
        y = np.concatenate([track.vectors[:, c] for part in predicted for track in part.tracked.tracks])
        off = y - np.concatenate([vectors[:, c] for part in predicted for vectors in part.vectors])
        total = float(np.nansum(np.abs(y - np.nanmean(y)) ** 2)) if np.isfinite(y).any() else 0.0
        if total > 0:
            own = noise[channel.label]
            square = float(np.nansum(np.abs(off) ** 2))
            ports[channel.label] = float(np.sqrt(square / total))
            count = int(np.isfinite(y).sum())
            floor[channel.label] = float(own.std * np.sqrt(2 * count / total))
            rms[channel.label] = float(np.sqrt(square / count)) / conversion(channel.unit, None), channel.unit
    return HeldScore(ports, floor, rms)
