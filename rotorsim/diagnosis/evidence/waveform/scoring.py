"""How well a diagram predicts stretches and runs in time: normalised root mean square of the simulation's error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorsim.diagnosis.evidence.scoring import Score
from rotorsim.diagnosis.evidence.waveform.data import TimeRun
from rotorsim.diagnosis.evidence.waveform.search import Evaluation, TimeSearch
from rotorsim.diagnosis.evidence.waveform.source import TimeSource
from rotorsim.diagnosis.evidence.waveform.views import WHOLE, views_of
from rotorsim.errors import RotorsimError

__all__ = ["TimeScore", "left_out_in_time", "score_in_time"]

FOLDS = 4  # stretches of all runs, each left out once
REFITTED = 15  # evaluations for a fit without a stretch

Sums = dict[str, np.ndarray]  # squares of the error, squares of the signal about its mean, samples


@dataclass(frozen=True)
class TimeScore(Score):
    """NRMSE = sqrt(sum (y - y_model)^2 / sum (y - mean)^2) per signal; floor: what the flexible model leaves.

    rms: of the error, per signal, in its unit.
    """

    rms: Mapping[str, float]


def score_in_time(document: Mapping[str, Any], source: TimeSource, runs: Sequence[TimeRun]) -> TimeScore:
    """Return the score of runs that a diagram is simulated for as it is; only their starts are fitted to them."""
    try:
        found = _simulated(document, source, runs)
    except RotorsimError:
        return _none()
    if found is None:
        return _none()
    search, evaluation = found
    sums: Sums = {}
    _add(sums, search, evaluation, [slice(None)] * len(runs))
    return _score(sums, source)


def left_out_in_time(document: Mapping[str, Any], source: TimeSource) -> TimeScore:
    """Return the score of stretches that are left out one by one, the diagram refitted to the others each time.

    The states at first samples stay as all samples give them.
    """
    try:
        full = source.search(document)
    except RotorsimError:
        return _none()
    start, _ = full.minimise(full.first(source.starts), REFITTED)
    sums: Sums = {}
    weights, full.hold = full.weights, "starts"
    ends = [np.linspace(0, run.size, FOLDS + 1).astype(int) for run in source.runs]
    for fold in range(FOLDS):
        parts = [slice(int(e[fold]), int(e[fold + 1])) for e in ends]
        full.weights = [
            [_without(np.broadcast_to(w, y.shape), part) for w, y, part in zip(each, measured, parts, strict=True)]
            for each, measured in zip(weights, full.measured, strict=True)
        ]
        _, found = full.minimise(start, REFITTED)
        if not np.isfinite(found.cost):
            return _none()
        _add(sums, full, found, parts)
    return _score(sums, source)


def _without(weights: np.ndarray, part: slice) -> np.ndarray:
    out = weights.copy()
    out[part] = 0.0
    return out


def _simulated(
    document: Mapping[str, Any], source: TimeSource, runs: Sequence[TimeRun]
) -> tuple[TimeSearch, Evaluation] | None:
    view = views_of(source.load(document), source.channels)[0]
    weights = np.array([1 / source.variance[WHOLE, name] for name in view.outputs])
    search = TimeSearch([view], runs, [[weights] * len(runs)], least=source.least, hold="theta")
    found = search.minimise(search.first())[1]
    return (search, found) if np.isfinite(found.cost) else None


def _add(sums: Sums, search: TimeSearch, found: Evaluation, parts: Sequence[slice]) -> None:
    """Add the errors of the whole diagram over a part of each run; means are those of whole runs."""
    for r, part in enumerate(parts):
        y, error = search.measured[0][r], found.errors[0][r]
        for c, name in enumerate(search.views[0].outputs):
            e, about = error[part, c], y[part, c] - y[:, c].mean()
            sums.setdefault(name, np.zeros(3))
            sums[name] += (float(e @ e), float(about @ about), len(e))


def _score(sums: Sums, source: TimeSource) -> TimeScore:
    ports = {name: float(np.sqrt(s[0] / s[1])) for name, s in sums.items() if s[1] > 0}
    floor = {name: float(np.sqrt(source.variance[WHOLE, name] * s[2] / s[1])) for name, s in sums.items() if s[1] > 0}
    return TimeScore(ports, floor, {name: float(np.sqrt(s[0] / s[2])) for name, s in sums.items()})


def _none() -> TimeScore:
    return TimeScore({"": float("nan")}, {}, {})
