"""Multiple shooting: a start for output error where its own search ends in a local minimum.

Over a whole run a mode at a wrong frequency loses step with the measured one, and the error hardly depends on the
parameters any more. Over a short part of it that begins with states of its own it cannot. Parts are fitted that grow
fourfold until they are the runs. Source: H. G. Bock, in Modelling of Chemical Reaction Systems (1981) 102-125.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, product
from math import tau
from operator import itemgetter

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.identification.waveform.evaluation import Evaluation, Label
from rotorsim.identification.waveform.noise import variance_scale
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch

SHOT_SAMPLES = 8192  # of all runs, that are shot over
SHOT_PARTS = (64, 16, 4, 1)  # of all these samples
LEAST_SHOT = 20  # samples of a part, and as many as LEAST_PER_STATE times its states
LEAST_PER_STATE = 4
SHOTS = 15  # evaluations with parts of a length
ANGLE_STARTS = 6  # of which each is followed for a few steps
PARTS_OF_TURN = 6  # the best is within 30 deg, where the effect has still 87 % of its projection


def is_lost(search: OutputErrorSearch, evaluation: Evaluation) -> bool:
    """Return whether a fit leaves so much of a signal that its search may have ended in a local minimum."""
    if not np.isfinite(evaluation.cost):
        return True
    scale = variance_scale(search)
    return any(
        float(np.nanmean(np.concatenate(residuals)[:, c] ** 2)) > CRITERIA.noisy**2 * scale[signal]
        for system, residuals in zip(search.systems, evaluation.residuals, strict=True)
        for c, signal in enumerate(system.signals)
    )


def angle_starts(search: OutputErrorSearch, start: np.ndarray) -> list[np.ndarray]:
    """Return starts whose free angles are turned to where simulations leave least, the best first: pairs together.

    As many as `ANGLE_STARTS`, since magnitudes that are off turn the best angle. Angles that are bounded stay as they
    are; without others the start is the only one.
    """
    found, sub = [start], search.substeps(start)
    for pair in (search.angles[k : k + 2] for k in range(0, len(search.angles), 2)):
        first, trials = found[0][pair], []
        for parts in product(range(PARTS_OF_TURN), repeat=len(pair)):
            trial = found[0].copy()
            if any(parts):
                trial[pair] = (first + np.array(parts) * tau / PARTS_OF_TURN + tau / 2) % tau - tau / 2
            trials.append((search.evaluate(trial, sub, sensitivities=False).cost, trial))
        found = [trial for _, trial in sorted(trials, key=itemgetter(0))[:ANGLE_STARTS]]
    return found


def shot(search: OutputErrorSearch, start: np.ndarray) -> np.ndarray:
    """Return unknowns near which output error ends in the minimum that short parts of the runs lead to."""
    short = search.shortened(SHOT_SAMPLES)
    theta, known = start[: search.m], dict[tuple[Label, int], float]()
    for count in SHOT_PARTS:
        runs, places = _parts(short, count)
        parted = replace(short, runs=runs)
        unknowns = parted.first()
        unknowns[: search.m] = theta
        for j, (name, state, k) in enumerate(parted.labels, start=search.m):
            r, first = places[k]
            unknowns[j] = known.get(((name, state, r), first), unknowns[j])
        evaluation = parted.minimise(unknowns, SHOTS)
        if not np.isfinite(evaluation.cost):
            continue
        theta = evaluation.unknowns[: search.m]
        for (name, state, k), value in parted.starts(evaluation.unknowns).items():
            known[(name, state, places[k][0]), places[k][1]] = value
    found = start.copy()
    found[: search.m] = theta
    for j, label in enumerate(search.labels, start=search.m):
        found[j] = known.get((label, 0), found[j])
    return found


def _parts(search: OutputErrorSearch, count: int) -> tuple[list[SampledRun], Sequence[tuple[int, int]]]:
    """Return about ``count`` parts of the runs, and the run and first sample of each."""
    states = max(system.equations.n for system in search.systems)
    total = sum(run.size for run in search.runs)
    runs: list[SampledRun] = []
    places: list[tuple[int, int]] = []
    for r, run in enumerate(search.runs):
        most = run.size // max(LEAST_SHOT, LEAST_PER_STATE * states)
        own = int(np.clip(round(count * run.size / total), 1, max(most, 1)))
        ends = np.linspace(0, run.size, own + 1).astype(int).tolist()
        for first, last in pairwise(ends):
            runs.append(run.part(slice(first, last)))
            places.append((r, first))
    return runs, places
