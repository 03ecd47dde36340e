"""How well a diagram predicts runs: normalised root mean square of what it leaves over, beside the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from rotorsim.diagnose.fitting import Source, fit_document
from rotorsim.diagnose.trials import MODEL_ERROR
from rotorsim.errors import RotorsimError
from rotorsim.identify.experiment import Experiment, open_experiment
from rotorsim.identify.likelihood import Evaluation, Likelihood
from rotorsim.identify.nonlinear_likelihood import likelihood_of
from rotorsim.identify.nonlinear_motion import NonlinearMotion
from rotorsim.recordings.harmonics import RunHarmonics
from rotorsim.recordings.recording import Recording

__all__ = ["Held", "HeldScore", "Prediction", "Score", "left_out_score", "predict", "predicts", "score", "surprise"]

SURPRISE = 0.01  # probability of what a diagram leaves in held-out runs, below which it does not predict them
DETAILS = 1e-4  # share of what was left unexplained there, that details of a law may leave
NOTHING = 1e-13  # of the largest eigenvalue: below, it is rounding


@dataclass(frozen=True)
class Held:
    """Runs that take no part in fitting: their recording and harmonics."""

    recording: Recording
    harmonics: tuple[RunHarmonics, ...]


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a diagram says about runs: experiment, likelihood and evaluation at its values."""

    experiment: Experiment
    likelihood: Likelihood
    evaluation: Evaluation


@dataclass(frozen=True)
class Score:
    """NRMSE per port and noise floor per port; None where no periodic motion is found. total: root mean square."""

    ports: Mapping[str, float]
    floor: Mapping[str, float]

    @property
    def total(self) -> float | None:
        """NRMSE over all ports."""
        return _mean(self.ports)

    @property
    def noise(self) -> float | None:
        """Noise floor over all ports."""
        return _mean(self.floor)


@dataclass(frozen=True)
class HeldScore(Score):
    """Score of runs that took no part. misfit: of their harmonics, by `surprise`; None: not known. rows: equations."""

    misfit: float | None
    rows: int


def _mean(values: Mapping[str, float]) -> float | None:
    found = np.array(list(values.values()))
    return float(np.sqrt(np.mean(found**2))) if found.size and np.isfinite(found).all() else None


def predicts(before: Score, after: Score, details: float = DETAILS) -> bool:
    """Return whether a repaired diagram predicts runs that took no part: noise and uncertain parameters make the rest.

    details: share of what was left unexplained before that may be left. True, too, where there is no settled motion.
    """
    if not (isinstance(before, HeldScore) and isinstance(after, HeldScore)):
        return True
    if before.misfit is None or after.misfit is None:
        return True
    probable = bool(chi2.sf(after.misfit, after.rows) >= SURPRISE) or after.misfit <= MODEL_ERROR * after.rows
    return probable or after.misfit - after.rows <= details * (before.misfit - before.rows)


def predict(document: Mapping[str, Any], source: Source, held: Held) -> Prediction:
    """Return the prediction of runs by a diagram as it is, with the means of slow states at their best."""
    diagram = source.load(document)
    runs = [item.run for item in held.harmonics]
    experiment = open_experiment(diagram, held.recording, runs=runs, harmonics=held.harmonics)
    if isinstance(experiment.motion, NonlinearMotion):
        experiment.motion.sharpen()
    likelihood = likelihood_of(experiment)
    return Prediction(experiment, likelihood, likelihood.evaluate(experiment.theta0))


def score(document: Mapping[str, Any], source: Source, held: Sequence[Held]) -> HeldScore:
    """Return NRMSE = sqrt(sum |x - x_model|^2 / sum |x - mean|^2) per port over runs, in time by Parseval.

    What the harmonics leave over of a signal counts as not explained, in ``ports`` and in ``floor``. misfit is that of
    `surprise`, the diagram being fitted to the runs of ``source``.
    """
    sums: dict[str, np.ndarray] = {}
    try:
        found = [predict(document, source, part) for part in held]
    except (RotorsimError, np.linalg.LinAlgError, ValueError):
        return HeldScore({"": float("nan")}, {}, None, 0)
    try:
        fitted = predict(document, source, Held(source.recording, source.harmonics))
    except (RotorsimError, np.linalg.LinAlgError, ValueError):
        fitted = None
    for part in found:
        _add(sums, part)
    ports = {name: float(np.sqrt(s[0] / s[2])) for name, s in sums.items() if s[2] > 0}
    floor = {name: float(np.sqrt(s[1] / s[2])) for name, s in sums.items() if s[2] > 0}
    misfit = None if fitted is None else surprise(fitted, found)
    return HeldScore(ports, floor, misfit, sum(part.evaluation.rows for part in found))


def surprise(fitted: Prediction, held: Sequence[Prediction]) -> float | None:
    """Return the misfit of runs that took no part, with the noise and the uncertainty of the fitted parameters.

    e^T (I + J (S^T S)^-1 J^T)^-1 e = |e|^2 - e^T J (S^T S + J^T J)^-1 J^T e, with the whitened residual e and slopes J
    of the held-out runs and the slopes S of the fitted ones and of what is known of parameters beforehand: chi-squared,
    if the structure is true. None where a run has no settled motion.
    """
    e = np.concatenate([part.evaluation.residual for part in held])
    J = np.concatenate([part.evaluation.slopes for part in held])
    priors = [0.0 if item.prior_std is None else 1 / item.prior_std for item in fitted.experiment.free]
    S = np.concatenate([fitted.evaluation.slopes, np.diag(priors)])
    if not (np.isfinite(e).all() and np.isfinite(J).all() and np.isfinite(S).all()):
        return None
    size = np.sqrt((S**2).sum(axis=0) + (J**2).sum(axis=0))
    size[size == 0] = 1.0
    S, J = S / size, J / size
    onto = J.T @ e
    known = np.linalg.pinv(S.T @ S + J.T @ J, rcond=NOTHING, hermitian=True)
    return float(e @ e - onto @ known @ onto)


def _add(sums: dict[str, np.ndarray], found: Prediction) -> None:
    experiment = found.experiment
    count = len(experiment.predicted)
    for r, item in enumerate(experiment.runs):
        columns = experiment.columns[r][:count]
        difference = np.abs(found.evaluation.Y[r] - found.likelihood.data[r][:, :count]) ** 2
        wrong = difference[0] * experiment.use_mean[:count] + 2 * difference[1:].sum(axis=0)
        for c, name in enumerate(experiment.predicted):
            left, total = item.fit.residual[columns[c]] ** 2, item.fit.rms[columns[c]] ** 2
            sums.setdefault(name.partition("[")[0], np.zeros(3))
            sums[name.partition("[")[0]] += (left + wrong[c], left, total)


def left_out_score(document: Mapping[str, Any], source: Source) -> Score:
    """Return the score of runs that are left out one by one, the diagram refitted to the others each time."""
    sums: dict[str, np.ndarray] = {}
    for r in range(len(source.harmonics)):
        others = tuple(item for k, item in enumerate(source.harmonics) if k != r)
        found = fit_document(document, replace(source, harmonics=others), [[{}]], most=8)
        if found.failure:
            return Score({"": float("nan")}, {})
        from rotorsim.diagnose.values import values_in

        held = Held(source.recording, (source.harmonics[r],))
        _add(sums, predict(values_in(document, found.values), source, held))
    ports = {name: float(np.sqrt(s[0] / s[2])) for name, s in sums.items() if s[2] > 0}
    floor = {name: float(np.sqrt(s[1] / s[2])) for name, s in sums.items() if s[2] > 0}
    return Score(ports, floor)
