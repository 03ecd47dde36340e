"""How well a diagram predicts stretches and runs in time: normalised root mean square of the simulation's error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorsim.diagnosis.evidence.evidence import Score
from rotorsim.identification.waveform.errors import errors_of
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.noise import Variance
from rotorsim.identification.waveform.search import REFIT_EVALUATIONS, OutputErrorSearch
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM

FOLDS = 4  # stretches of all runs, each left out once


def held_score(
    search: OutputErrorSearch, evaluation: Evaluation, variance: Variance, units: Mapping[str, str]
) -> Score:
    """Return the score of runs of which only the starts were searched."""
    return _score(search, [(evaluation, [slice(None)] * len(search.runs))], variance, units)


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
    """Return the score of fits, each on a part of each run; floor: by the variance that counts as noise."""
    errors = errors_of(search, fits)
    if errors is None:
        return Score({"": float("nan")}, {})
    return Score(
        errors.nrmse,
        errors.floor({name: variance[WHOLE_DIAGRAM, name] for name in errors.outputs}),
        {name: (value, units[name]) for name, value in errors.rms.items()},
    )
