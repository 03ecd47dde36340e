"""How well a diagram predicts stretches and runs in time: normalised root mean square of the simulation's error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorsim.diagnosis.evidence.evidence import Score
from rotorsim.diagnosis.evidence.waveform.noise import Variance
from rotorsim.diagnosis.evidence.waveform.search import Evaluation, OutputErrorSearch
from rotorsim.diagnosis.evidence.waveform.subsystems import WHOLE

__all__ = ["held_score", "left_out_score"]

FOLDS = 4  # stretches of all runs, each left out once
REFITTED = 15  # evaluations for a fit without a stretch
UNPREDICTED = Score({"": float("nan")}, {})


def held_score(search: OutputErrorSearch, variance: Variance, units: Mapping[str, str]) -> Score:
    """Return the score of runs of which a search finds only the starts.

    NRMSE = sqrt(sum (y - y_model)^2 / sum (y - mean)^2) per signal; floor: by the variance that counts as noise.
    """
    found = search.minimise(search.first())
    if not np.isfinite(found.cost):
        return UNPREDICTED
    return _score(search, _sums(search, found, [slice(None)] * len(search.runs)), variance, units)


def left_out_score(search: OutputErrorSearch, first: np.ndarray, variance: Variance, units: Mapping[str, str]) -> Score:
    """Return the score of stretches that are left out one by one, the diagram refitted to the others each time.

    The states at first samples stay as all samples give them.
    """
    start = search.minimise(first, REFITTED).unknowns
    ends = [np.linspace(0, run.size, FOLDS + 1).astype(int) for run in search.runs]
    sums = np.zeros((3, len(search.systems[0].outputs)))
    for fold in range(FOLDS):
        out = [slice(*end[fold : fold + 2]) for end in ends]
        found = replace(search, hold="starts", unused=out).minimise(start, REFITTED)
        if not np.isfinite(found.cost):
            return UNPREDICTED
        sums += _sums(search, found, out)
    return _score(search, sums, variance, units)


def _sums(search: OutputErrorSearch, found: Evaluation, parts: Sequence[slice]) -> np.ndarray:
    """Return squares of the error, squares of the signal about its mean and samples over a part of each run, (3, c)."""
    errors = np.concatenate([error[part] for error, part in zip(found.residuals[0], parts, strict=True)])
    signals = [(y - y.mean(axis=0))[part] for y, part in zip(search.measured[0], parts, strict=True)]
    squares = [(values**2).sum(axis=0) for values in (errors, np.concatenate(signals))]
    return np.array([*squares, np.full(errors.shape[1], len(errors))])


def _score(search: OutputErrorSearch, sums: np.ndarray, variance: Variance, units: Mapping[str, str]) -> Score:
    by_signal = dict(zip(search.systems[0].outputs, sums.T, strict=True))
    moving = {name: (error, total, n) for name, (error, total, n) in by_signal.items() if total > 0}
    return Score(
        {name: float(np.sqrt(error / total)) for name, (error, total, _) in moving.items()},
        {name: float(np.sqrt(variance[WHOLE, name] * n / total)) for name, (_, total, n) in moving.items()},
        {name: (float(np.sqrt(error / n)), units[name]) for name, (error, _, n) in by_signal.items()},
    )
