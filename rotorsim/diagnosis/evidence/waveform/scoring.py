"""How well a diagram predicts stretches and runs in time: normalised root mean square of the simulation's error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorsim.diagnosis.evidence.evidence import Score
from rotorsim.diagnosis.evidence.waveform.noise import Variance
from rotorsim.identification.waveform.search import REFIT_EVALUATIONS, Evaluation, OutputErrorSearch
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM

FOLDS = 4  # stretches of all runs, each left out once


def held_score(search: OutputErrorSearch, variance: Variance, units: Mapping[str, str]) -> Score:
    """Return the score of runs of which a search finds only the starts."""
    fits = [(search.minimise(search.first()), [slice(None)] * len(search.runs))]
    return _score(search, fits, variance, units)


def left_out_score(search: OutputErrorSearch, first: np.ndarray, variance: Variance, units: Mapping[str, str]) -> Score:
    """Return the score of stretches that are left out one by one, the diagram refitted to the others each time.

    The states at first samples stay as all samples give them.
    """
    start = search.minimise(first, REFIT_EVALUATIONS).unknowns
    ends = [np.linspace(0, run.size, FOLDS + 1).astype(int).tolist() for run in search.runs]
    folds = [[slice(*end[fold : fold + 2]) for end in ends] for fold in range(FOLDS)]
    fits = ((replace(search, hold="starts", unused=out).minimise(start, REFIT_EVALUATIONS), out) for out in folds)
    return _score(search, fits, variance, units)


def _score(
    search: OutputErrorSearch,
    fits: Iterable[tuple[Evaluation, Sequence[slice]]],
    variance: Variance,
    units: Mapping[str, str],
) -> Score:
    """Return the score of fits, each on a part of each run.

    NRMSE = sqrt(sum (y - y_model)^2 / sum (y - mean)^2) per signal; floor: by the variance that counts as noise.
    """
    outputs = search.systems[0].equations.outputs
    squares, totals, samples = np.zeros(len(outputs)), np.zeros(len(outputs)), 0
    for evaluation, parts in fits:
        if not np.isfinite(evaluation.cost):
            return Score({"": float("nan")}, {})
        for residual, y, part in zip(evaluation.residuals[0], search.measured[0], parts, strict=True):
            squares += (residual[part] ** 2).sum(axis=0)
            totals += ((y - y.mean(axis=0))[part] ** 2).sum(axis=0)
            samples += len(residual[part])
    moving = [(name, square, total) for name, square, total in zip(outputs, squares, totals, strict=True) if total > 0]
    return Score(
        {name: float(np.sqrt(square / total)) for name, square, total in moving},
        {name: float(np.sqrt(variance[WHOLE_DIAGRAM, name] * samples / total)) for name, _, total in moving},
        {name: (float(np.sqrt(square / samples)), units[name]) for name, square in zip(outputs, squares, strict=True)},
    )
