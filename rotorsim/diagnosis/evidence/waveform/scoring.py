"""How well a diagram predicts stretches and runs in time: normalised root mean square of the simulation's error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rotorsim.diagnosis.evidence.evidence import Score
from rotorsim.diagnosis.evidence.waveform.noise import Variance
from rotorsim.diagnosis.evidence.waveform.search import Point, TimeSearch
from rotorsim.diagnosis.evidence.waveform.views import WHOLE

__all__ = ["held_score", "left_out_score"]

FOLDS = 4  # stretches of all runs, each left out once
REFITTED = 15  # evaluations for a fit without a stretch
UNPREDICTED = Score({"": float("nan")}, {})

# squares of the error, squares of the signal about its mean, samples; by signal
Sums = Mapping[str, np.ndarray]


def held_score(search: TimeSearch, variance: Variance, units: Mapping[str, str]) -> Score:
    """Return the score of runs that a diagram is simulated for as it is; only their starts are fitted to them.

    NRMSE = sqrt(sum (y - y_model)^2 / sum (y - mean)^2) per signal; floor: by the variance that counts as noise.
    """
    search.hold = "theta"
    found = search.minimise(search.first())[1]
    if not np.isfinite(found.cost):
        return UNPREDICTED
    return _score([_errors(search, found.errors[0], [slice(None)] * len(search.runs))], variance, units)


def left_out_score(search: TimeSearch, first: Point, variance: Variance, units: Mapping[str, str]) -> Score:
    """Return the score of stretches that are left out one by one, the diagram refitted to the others each time.

    The states at first samples stay as all samples give them.
    """
    start, _ = search.minimise(first, REFITTED)
    weights, search.hold = search.weights, "starts"
    ends = [np.linspace(0, run.size, FOLDS + 1).astype(int) for run in search.runs]
    parts = []
    for fold in range(FOLDS):
        out = [slice(int(e[fold]), int(e[fold + 1])) for e in ends]
        search.weights = [
            [_without(np.broadcast_to(w, y.shape), part) for w, y, part in zip(each, measured, out, strict=True)]
            for each, measured in zip(weights, search.measured, strict=True)
        ]
        _, found = search.minimise(start, REFITTED)
        if not np.isfinite(found.cost):
            return UNPREDICTED
        parts.append(_errors(search, found.errors[0], out))
    return _score(parts, variance, units)


def _without(weights: np.ndarray, part: slice) -> np.ndarray:
    out = weights.copy()
    out[part] = 0.0
    return out


def _errors(search: TimeSearch, errors: Sequence[np.ndarray], parts: Sequence[slice]) -> Sums:
    """Return the sums over a part of each run; means are those of whole runs."""

    def of(c: int) -> Iterator[tuple[float, float, int]]:
        for y, error, part in zip(search.measured[0], errors, parts, strict=True):
            e, about = error[part, c], y[part, c] - y[:, c].mean()
            yield float(e @ e), float(about @ about), len(e)

    return {name: np.sum(list(of(c)), axis=0) for c, name in enumerate(search.views[0].outputs)}


def _score(parts: Sequence[Sums], variance: Variance, units: Mapping[str, str]) -> Score:
    sums = {name: np.sum([part[name] for part in parts], axis=0) for name in parts[0]}
    ports = {name: float(np.sqrt(s[0] / s[1])) for name, s in sums.items() if s[1] > 0}
    floor = {name: float(np.sqrt(variance[WHOLE, name] * s[2] / s[1])) for name, s in sums.items() if s[1] > 0}
    return Score(ports, floor, {name: (float(np.sqrt(s[0] / s[2])), units[name]) for name, s in sums.items()})
