"""Fit a diagram to harmonics of recordings from several starts."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np

from rotorsim.diagnosis.evidence.fit import DEFERRED, FAILURES, Fit, Starts, failed_fit
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.identification.harmonic.drifting import LaggingLikelihood, likelihood_of
from rotorsim.identification.harmonic.estimate import MOST_EVALUATIONS, Estimate, Search, is_least, summary
from rotorsim.identification.harmonic.experiment import Experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.harmonic.profile import linear_intervals
from rotorsim.identification.left_out import RANK_TOLERANCE, left_out
from rotorsim.model.heard import surviving

START_ANGLES = 8  # values over a turn of a new angle that enters in more than one way
NONLINEAR_TRIALS = 8  # of a group, of which the best is followed
PROMISE_TRIALS = 2  # of a nonlinear diagram, twice as many of a linear one
LINEAR_EVALUATIONS = 12  # for one of a nonlinear diagram
FOLLOWED_FROM = 15  # evaluations after which what leaves too much is no rival
LINEAR_STARTS = 2  # that are followed to the end
LINEAR_FOLLOWED = 4  # one more of a group, from the most promising on, for so many starts that a fault declares
CORNERS, SHARP_EVALUATIONS = 20.0, 8  # misfit per degree of freedom that more orders of a law with corners explain
TURN = 2 * np.pi
ROUNDED = 1e6  # parts of a radian in which angles are compared


def fit_document(
    document: Mapping[str, Any],
    runs: HarmonicRuns,
    starts: Starts,
    *,
    most: int | None = None,
    linear_only: bool = False,
    beyond: float = np.inf,
) -> Fit:
    """Return the best fit of a diagram from the best of each group of starts {free parameter: SI value}.

    What a start does not name begins as written; angles that it names are tried all around. most: evaluations of a
    nonlinear diagram from each start, times LINEAR_EVALUATIONS of a linear one (default: until it has converged).
    linear_only: a nonlinear diagram is not fitted, its failure is DEFERRED. beyond: a misfit; what leaves more after
    FOLLOWED_FROM evaluations is not followed.
    """
    began = process_time()
    nonlinear = False
    try:
        experiment = runs.open(runs.load(document))
        nonlinear = not experiment.motion.is_linear
        if nonlinear and linear_only:
            return Fit(document, failure=DEFERRED, nonlinear=True, seconds=process_time() - began)
        search = Search(runs.likelihood(experiment))
        best = _best(search, experiment, starts, most, beyond)
        if nonlinear and most is None and not is_least(best.evaluation) and best.excess < CORNERS:
            best = _sharpened(search, best, runs)
    except FAILURES as error:
        return failed_fit(document, error, nonlinear=nonlinear, seconds=process_time() - began)
    seconds = process_time() - began
    return replace(_fit_of(document, search, best), nonlinear=nonlinear, seconds=seconds, standing=runs.standing)


def promise_of(document: Mapping[str, Any], runs: HarmonicRuns, starts: Starts) -> float:
    """Return the misfit that linear theory promises after one step of all parameters from the best start."""
    try:
        experiment = runs.open(runs.load(document))
        search = Search(Likelihood(experiment))
        least = np.inf
        for group in starts[:1]:
            trials = _different([t for start in group for t in _trials(search, experiment.theta0, start)], search)
            most = 2 * PROMISE_TRIALS if experiment.motion.is_linear else PROMISE_TRIALS
            for theta in trials[:: max(1, -(-len(trials) // most))]:
                least = min(least, search.promise(search.coordinates.inside(theta)))
    except FAILURES:
        return np.inf
    return least


def without_drift(fit: Fit, runs: HarmonicRuns) -> Fit:
    """Return a fit to harmonics and the drift of 1X with the misfit of the harmonics alone, at the same parameters.

    Those of drifting runs have what the drift adds to them taken out, as in the fit.
    """
    try:
        experiment = runs.open(runs.load(fit.document))
        search = Search(LaggingLikelihood(experiment) if runs.drifting else likelihood_of(experiment))
        found = _fit_of(fit.document, search, summary(search, search.coordinates.inside(fit.theta)))
    except FAILURES as error:
        return failed_fit(fit.document, error, nonlinear=fit.nonlinear)
    if found.failure:
        return found
    kept = ("theta", "covariance", "at_bound", "ends", "alone", "nonlinear", "seconds", "standing")
    return replace(found, **{name: getattr(fit, name) for name in kept})


def _fit_of(document: Mapping[str, Any], search: Search, best: Estimate) -> Fit:
    evaluation = best.evaluation
    if not np.isfinite(best.misfit):
        return Fit(document, failure="no periodic motion was found")
    assert isinstance(search.likelihood, Likelihood)
    sizes = search.likelihood.sizes
    lines = np.tile(search.likelihood.is_beside, len(sizes))
    q = search.coordinates.inside(best.theta)
    covariance = best.covariance.copy()
    covariance[best.undetermined, best.undetermined] = np.inf
    loo = left_out(evaluation.residual, search.jacobian(q)[: len(evaluation.residual)], sizes)
    return Fit(
        document=document,
        free=best.free,
        theta=best.theta,
        covariance=covariance,
        at_bound=best.at_bound,
        misfit=best.misfit,
        rows=evaluation.rows,
        equations=sum(sizes),
        run_misfit=evaluation.misfit,
        left_out=loo,
        goodness=best.goodness,
        ends=linear_intervals(search, best),
        alone=_alone(best),
        line_rows=int(lines.sum()),
        line_misfit=float((evaluation.residual[: len(lines)][lines] ** 2).sum()),
    )


def _alone(estimate: Estimate) -> np.ndarray:
    """Return the standard deviations (m,) with all other parameters of the same block known, and no others.

    Where only a combination is determined, as of the size and the time constant of a drift, each still has one.
    """
    back = np.linalg.inv(estimate.coordinates.jacobian(estimate.theta))
    information = back.T @ estimate.information @ back
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    unit = np.where(size > 0, size, 1.0)
    scaled = information / np.outer(unit, unit)
    blocks = [item.base.rpartition(".")[0] or item.name for item in estimate.free]
    out = np.full(len(blocks), np.inf)
    for j, block in enumerate(blocks):
        rest = [k for k, other in enumerate(blocks) if other != block and not estimate.at_bound[k]]
        known = np.linalg.pinv(scaled[np.ix_(rest, rest)], rcond=RANK_TOLERANCE, hermitian=True)
        left = float(scaled[j, j] - scaled[j, rest] @ known @ scaled[rest, j])
        if size[j] > 0 and left > RANK_TOLERANCE:
            out[j] = 1 / (size[j] * np.sqrt(left))
    return out


def _best(search: Search, experiment: Experiment, starts: Starts, most: int | None, beyond: float) -> Estimate:
    nonlinear = not experiment.motion.is_linear
    chosen: list[np.ndarray] = []
    assert isinstance(search.likelihood, Likelihood)
    ranking = search.again(search.likelihood.rough())
    for group in starts or ([[{}]] if nonlinear else []):
        trials = _different([t for start in group for t in _trials(search, experiment.theta0, start)], search)
        if nonlinear:
            trials = trials[:: max(1, len(trials) // NONLINEAR_TRIALS)]
        steps = surviving(lambda theta: ranking.force_step(search.coordinates.inside(theta), []), trials)
        ranked = sorted((item for item in steps if np.isfinite(item[0])), key=lambda item: item[0])
        chosen += [q for _, q in ranked[: 1 if nonlinear else 1 + len(group) // LINEAR_FOLLOWED]]
    if not nonlinear and (most is None or not starts):  # a step costs little: look all around for unknown angles
        chosen += search.starts()[:LINEAR_STARTS]
    best: np.ndarray | None = None
    least = np.inf
    limit = MOST_EVALUATIONS if most is None else most if nonlinear else LINEAR_EVALUATIONS * most

    def followed(q: np.ndarray) -> np.ndarray | None:
        if not np.isfinite(search.residual(q)).all():
            return None
        if limit > FOLLOWED_FROM and beyond < np.inf:
            q = search.minimise(q, most=FOLLOWED_FROM)
            if float(search.residual(q) @ search.residual(q)) > beyond:
                return q
        return search.minimise(q, most=limit)

    for found in surviving(followed, chosen):
        if found is None:
            continue
        r = search.residual(found)
        cost = float(r @ r) * search.preference(found)
        if cost < least * (1 - 1e-9):
            best, least = found, cost
        if is_least(search.evaluation(found)):
            break
    if best is None:
        raise ValueError("no periodic motion was found")
    return summary(search, best)


def _sharpened(search: Search, best: Estimate, runs: HarmonicRuns) -> Estimate:
    """Return a fit carried on with more orders: the residual may be theirs, where a law has corners."""
    search.likelihood.experiment.motion.sharpen()
    again = search.again(runs.likelihood(search.likelihood.experiment))
    q = again.coordinates.inside(best.theta)
    if not np.isfinite(again.residual(q)).all():
        return best
    found = summary(again, again.minimise(q, most=SHARP_EVALUATIONS))
    return found if found.misfit < best.misfit else best


def _trials(search: Search, theta0: np.ndarray, start: Mapping[str, float]) -> list[np.ndarray]:
    """Return a start, with the angles named in it that are not part of an amplitude pair all around."""
    theta = theta0.copy()
    names = [item.name for item in search.free]
    for name, value in start.items():
        if name in names:
            item = search.free[names.index(name)]
            theta[names.index(name)] = np.clip(value, item.low, item.high)
    paired = {j for pair in search.coordinates.pairs for j in pair}
    angles = [
        j
        for j, item in enumerate(search.free)
        if item.unit == ANGLE_UNIT and j not in paired and item.name in start and item.low == -np.inf
    ][:2]
    found = []
    for turns in itertools.product(range(START_ANGLES), repeat=len(angles)):
        trial = theta.copy()
        trial[angles] = theta[angles] + np.array(turns) * TURN / START_ANGLES
        found.append(trial)
    return found


def _different(trials: Sequence[np.ndarray], search: Search) -> list[np.ndarray]:
    """Return the trials without those that are one already but for whole turns.

    In a linear diagram one step finds the forces, from anywhere: trials that differ in them only are one.
    """
    angles = np.array([item.unit == ANGLE_UNIT for item in search.free], bool)
    same = np.zeros(len(angles), bool)
    if search.likelihood.experiment.motion.is_linear:
        same[[j for pair in search.coordinates.pairs for j in pair]] = True
    kept: dict[bytes, np.ndarray] = {}
    for trial in trials:
        turned = np.where(angles, np.mod(np.round(trial * ROUNDED), np.round(TURN * ROUNDED)), trial)
        kept.setdefault(np.where(same, 0.0, turned).tobytes(), trial)
    return list(kept.values())
