"""How well a diagram predicts runs: normalised root mean square of the residual, and its misfit, beside the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import HeldScore
from rotorsim.diagnosis.evidence.fit import FAILURES, reason_of
from rotorsim.diagnosis.evidence.harmonic.fitting import fit_document
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.diagnosis.evidence.harmonic.stability import unsettled
from rotorsim.identification import left_out
from rotorsim.identification.harmonic.drifting import likelihood_of
from rotorsim.identification.harmonic.experiment import Experiment
from rotorsim.identification.harmonic.likelihood import Evaluation, Likelihood

UNSETTLED = "it has no settled motion in the runs that were fitted"
BOUND_TOLERANCE = 1e-9  # relative: such a parameter takes no part in linear theory


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a diagram says about runs: experiment, likelihood and evaluation at its values."""

    experiment: Experiment
    likelihood: Likelihood
    evaluation: Evaluation


def predict(document: Mapping[str, Any], runs: HarmonicRuns) -> Prediction:
    """Return the prediction of runs by a diagram as it is, with the means of slow states at their best."""
    experiment = runs.open(runs.load(document))
    experiment.motion.sharpen()
    likelihood = likelihood_of(experiment)
    return Prediction(experiment, likelihood, likelihood.evaluate(experiment.theta0))


def held_score(document: Mapping[str, Any], runs: HarmonicRuns, held: Sequence[HarmonicRuns]) -> HeldScore:
    """Return NRMSE = sqrt(sum |x - x_model|^2 / sum |x - mean|^2) per port over hold-out runs, in time by Parseval.

    The residual of the harmonic fit of a signal counts as not explained, in ``ports`` and in ``floor``. misfit is that
    of `surprise`, the diagram being fitted to ``runs``.
    """
    try:
        parts = [predict(document, part) for part in held]
        fitted = predict(document, runs)
    except FAILURES as error:
        return _unpredicted(reason_of(error))
    reason = "; ".join(filter(None, (_unsettled_in(part) for part in parts)))
    if reason:
        return _unpredicted(reason)
    errors = _errors(parts)
    misfit = surprise(fitted, parts)
    rows = sum(part.evaluation.rows for part in parts)
    if misfit is None:
        return HeldScore(*errors, rows=rows, reason=UNSETTLED)
    pairs = [pair for part in parts for pair in _misfits(fitted, part)]
    return HeldScore(*errors, misfit=misfit, rows=rows, runs=tuple(pairs))


def left_out_score(document: Mapping[str, Any], runs: HarmonicRuns) -> HeldScore:
    """Return the score of runs that are left out one by one, the diagram refitted to the others each time.

    misfit is that of `standardised`.
    """
    parts = []
    for r, item in enumerate(runs.harmonics):
        others = replace(runs, harmonics=(*runs.harmonics[:r], *runs.harmonics[r + 1 :]))
        fit = fit_document(document, others, [[{}]], most=8)
        if fit.failure:
            return _unpredicted(f"without run {item.run.id} it cannot be fitted: {fit.failure}")
        try:
            part = predict(values_in(document, fit.values), replace(runs, harmonics=(item,)))
        except FAILURES as error:
            return _unpredicted(f"run {item.run.id}: {reason_of(error)}")
        reason = _unsettled_in(part)
        if reason:
            return _unpredicted(reason)
        parts.append(part)
    errors = _errors(parts)
    try:
        pairs = standardised(predict(document, runs))
    except FAILURES as error:
        return HeldScore(*errors, reason=reason_of(error))
    if pairs is None:
        return HeldScore(*errors, reason=UNSETTLED)
    misfit, rows = (float(sum(pair[k] for pair in pairs)) for k in (0, 1))
    return HeldScore(*errors, misfit=misfit, rows=max(round(rows), 1), runs=pairs)


def _unpredicted(reason: str) -> HeldScore:
    return HeldScore({"": float("nan")}, {}, reason=reason)


def _unsettled_in(prediction: Prediction) -> str:
    """Return in which runs a prediction is no settled motion, and why; empty where it is one everywhere."""
    experiment = prediction.experiment
    lost = [r for r, Y in enumerate(prediction.evaluation.Y) if not np.isfinite(Y).all()]
    if lost:
        return f"no periodic motion was found in {_runs(experiment, lost)}"
    grown = unsettled(experiment)
    return f"its motion is not stable in {_runs(experiment, grown)}" if grown else ""


def _runs(experiment: Experiment, which: Sequence[int]) -> str:
    names = [str(experiment.runs[r].run.id) for r in which]
    return f"run {names[0]}" if len(names) == 1 else f"runs {', '.join(names)}"


def surprise(fitted: Prediction, held: Sequence[Prediction]) -> float | None:
    """Return the misfit of hold-out runs, see `left_out.surprise`; None where a run has no settled motion."""
    e = np.concatenate([part.evaluation.residual for part in held])
    J = np.concatenate([part.evaluation.jacobian for part in held])
    return left_out.surprise(_known(fitted), e, J)


def _known(fitted: Prediction) -> np.ndarray:
    """Return the Jacobian of the fitted runs and of what is known of parameters beforehand, (n, m)."""
    priors = [0.0 if item.prior_std is None else 1 / item.prior_std for item in fitted.experiment.free]
    return np.concatenate([fitted.evaluation.jacobian, np.diag(priors)])


def _misfits(fitted: Prediction, part: Prediction) -> list[tuple[float, float]]:
    """Return the surprise and the equations of each held-out run by itself."""
    S, sizes = _known(fitted), part.likelihood.sizes
    lost = (sum(sizes) - part.evaluation.rows) / len(sizes)  # nuisances of a run
    out, at = [], 0
    for size in sizes:
        own = slice(at, at + size)
        at += size
        misfit = left_out.surprise(S, part.evaluation.residual[own], part.evaluation.jacobian[own])
        out.append((float("nan") if misfit is None else misfit, size - lost))
    return out


def standardised(fitted: Prediction) -> tuple[tuple[float, float], ...] | None:
    """Return of each fitted run the misfit when it is predicted from the others, and its equations.

    See `left_out.standardised`; None where a run has no settled motion.
    """
    sizes = fitted.likelihood.sizes
    S, residual = _known(fitted), fitted.evaluation.residual
    if not (np.isfinite(S).all() and np.isfinite(residual).all()):
        return None
    theta, free = fitted.experiment.theta0, fitted.experiment.free
    S = S[:, [not _at_bound(v, item.low, item.high) for v, item in zip(theta, free, strict=True)]]
    lost = (sum(sizes) - fitted.evaluation.rows) / len(sizes)
    return tuple((misfit, equations - lost) for misfit, equations in left_out.standardised(S, residual, sizes))


def _at_bound(value: float, low: float, high: float) -> bool:
    return any(np.isfinite(end) and abs(value - end) <= BOUND_TOLERANCE * max(abs(end), 1e-300) for end in (low, high))


def _errors(parts: Sequence[Prediction]) -> tuple[dict[str, float], dict[str, float]]:
    """Return NRMSE and noise floor of each port: of mean squares |X_0|^2 + 2 sum |X_k|^2 (Parseval) over all runs."""
    sums: dict[str, np.ndarray] = {}  # of residual, noise, signal
    for part in parts:
        experiment = part.experiment
        count = len(experiment.predicted)
        for r, item in enumerate(experiment.runs):
            columns = experiment.columns[r][:count]
            difference = np.abs(part.evaluation.Y[r] - part.likelihood.data[r][:, :count]) ** 2
            wrong = difference[0] * experiment.use_mean[:count] + 2 * difference[1:].sum(axis=0)
            noise, signal = (of[columns] ** 2 for of in (item.fit.residual, item.fit.rms))
            for c, name in enumerate(experiment.predicted):
                port = name.partition("[")[0]
                sums[port] = sums.get(port, 0.0) + np.array([noise[c] + wrong[c], noise[c], signal[c]])
    ports, floor = ({name: float(np.sqrt(s[k] / s[2])) for name, s in sums.items() if s[2] > 0} for k in (0, 1))
    return ports, floor
