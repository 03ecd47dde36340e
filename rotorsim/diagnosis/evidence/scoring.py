"""How well a diagram predicts runs: normalised root mean square of what it leaves over, beside the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.harmonic import Source, fit_document
from rotorsim.diagnosis.evidence.stability import unsettled
from rotorsim.errors import RotorsimError
from rotorsim.identification.experiment import Experiment, open_experiment
from rotorsim.identification.likelihood import Evaluation, Likelihood
from rotorsim.recordings.recording import Recording
from rotorsim.signals.harmonics import RunHarmonics

__all__ = ["Held", "HeldScore", "Prediction", "Score", "left_out_score", "predict", "score", "standardised", "surprise"]

NOTHING = 1e-13  # of the largest eigenvalue: below, it is rounding
HELD_BY_NONE = 1e-8  # 1 - leverage of a direction that no other run determines: it is not predicted from them
AT_BOUND = 1e-9  # relative: such a parameter takes no part in linear theory


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
    """Score of runs that took no part, each or all of them.

    misfit: of their harmonics, by `surprise` or `standardised`; None: not known, reason: why. rows: equations. runs:
    (misfit, equations) of each run.
    """

    misfit: float | None
    rows: int
    runs: tuple[tuple[float, float], ...] = ()
    reason: str = ""


def _mean(values: Mapping[str, float]) -> float | None:
    found = np.array(list(values.values()))
    return float(np.sqrt(np.mean(found**2))) if found.size and np.isfinite(found).all() else None


def predict(document: Mapping[str, Any], source: Source, held: Held) -> Prediction:
    """Return the prediction of runs by a diagram as it is, with the means of slow states at their best."""
    diagram = source.load(document)
    runs = [item.run for item in held.harmonics]
    experiment = open_experiment(diagram, held.recording, runs=runs, harmonics=held.harmonics)
    experiment.motion.sharpen()
    likelihood = Likelihood(experiment)
    return Prediction(experiment, likelihood, likelihood.evaluate(experiment.theta0))


def score(document: Mapping[str, Any], source: Source, held: Sequence[Held]) -> HeldScore:
    """Return NRMSE = sqrt(sum |x - x_model|^2 / sum |x - mean|^2) per port over runs, in time by Parseval.

    What the harmonics leave over of a signal counts as not explained, in ``ports`` and in ``floor``. misfit is that of
    `surprise`, the diagram being fitted to the runs of ``source``.
    """
    sums: dict[str, np.ndarray] = {}
    try:
        found = [predict(document, source, part) for part in held]
        fitted = predict(document, source, Held(source.recording, source.harmonics))
    except (RotorsimError, np.linalg.LinAlgError, ValueError) as error:
        return _unknown(_said(error))
    reason = "; ".join(filter(None, (_restless(part) for part in found)))
    if reason:
        return _unknown(reason)
    for part in found:
        _add(sums, part)
    misfit = surprise(fitted, found)
    runs = [pair for part in found for pair in _of_runs(fitted, part)]
    reason = "" if misfit is not None else "it has no settled motion in the runs that were fitted"
    rows = sum(part.evaluation.rows for part in found)
    return HeldScore(*_errors(sums), misfit, rows, tuple(runs) if misfit is not None else (), reason)


def left_out_score(document: Mapping[str, Any], source: Source) -> HeldScore:
    """Return the score of runs that are left out one by one, the diagram refitted to the others each time.

    misfit is that of `standardised`.
    """
    sums: dict[str, np.ndarray] = {}
    for r, item in enumerate(source.harmonics):
        others = tuple(other for k, other in enumerate(source.harmonics) if k != r)
        found = fit_document(document, replace(source, harmonics=others), [[{}]], most=8)
        if found.failure:
            return _unknown(f"without run {item.run.id} it cannot be fitted: {found.failure}")
        held = Held(source.recording, (item,))
        try:
            part = predict(values_in(document, found.values), source, held)
        except (RotorsimError, np.linalg.LinAlgError, ValueError) as error:
            return _unknown(f"run {item.run.id}: {_said(error)}")
        reason = _restless(part)
        if reason:
            return _unknown(reason)
        _add(sums, part)
    try:
        fitted = predict(document, source, Held(source.recording, source.harmonics))
    except (RotorsimError, np.linalg.LinAlgError, ValueError) as error:
        return HeldScore(*_errors(sums), None, 0, reason=_said(error))
    runs = standardised(fitted)
    if runs is None:
        return HeldScore(*_errors(sums), None, 0, reason="it has no settled motion in the runs that were fitted")
    misfit, rows = (float(sum(pair[k] for pair in runs)) for k in (0, 1))
    return HeldScore(*_errors(sums), misfit, max(round(rows), 1), runs)


def _unknown(reason: str) -> HeldScore:
    return HeldScore({"": float("nan")}, {}, None, 0, reason=reason)


def _said(error: Exception) -> str:
    return error.problems[0].what if isinstance(error, RotorsimError) else str(error) or type(error).__name__


def _restless(found: Prediction) -> str:
    """Return in which runs a prediction is no settled motion, and why; empty where it is one everywhere."""
    experiment = found.experiment
    lost = [r for r, Y in enumerate(found.evaluation.Y) if not np.isfinite(Y).all()]
    if lost:
        return f"no periodic motion was found in {_runs(experiment, lost)}"
    grown = unsettled(experiment)
    return f"its motion is not stable in {_runs(experiment, grown)}" if grown else ""


def _runs(experiment: Experiment, which: Sequence[int]) -> str:
    names = [str(experiment.runs[r].run.id) for r in which]
    return f"run {names[0]}" if len(names) == 1 else f"runs {', '.join(names)}"


def surprise(fitted: Prediction, held: Sequence[Prediction]) -> float | None:
    """Return the misfit of runs that took no part, with the noise and the uncertainty of the fitted parameters.

    e^T (I + J (S^T S)^-1 J^T)^-1 e = |e|^2 - e^T J (S^T S + J^T J)^-1 J^T e, with the whitened residual e and slopes J
    of the held-out runs and the slopes S of the fitted ones and of what is known of parameters beforehand: chi-squared,
    if the structure is true. None where a run has no settled motion.
    """
    e = np.concatenate([part.evaluation.residual for part in held])
    J = np.concatenate([part.evaluation.jacobian for part in held])
    return _surprise(_known(fitted), e, J)


def _known(fitted: Prediction) -> np.ndarray:
    """Return the slopes of the fitted runs and of what is known of parameters beforehand, (n, m)."""
    priors = [0.0 if item.prior_std is None else 1 / item.prior_std for item in fitted.experiment.free]
    return np.concatenate([fitted.evaluation.jacobian, np.diag(priors)])


def _surprise(S: np.ndarray, e: np.ndarray, J: np.ndarray) -> float | None:
    if not (np.isfinite(e).all() and np.isfinite(J).all() and np.isfinite(S).all()):
        return None
    size = np.sqrt((S**2).sum(axis=0) + (J**2).sum(axis=0))
    size[size == 0] = 1.0
    S, J = S / size, J / size
    onto = J.T @ e
    known = np.linalg.pinv(S.T @ S + J.T @ J, rcond=NOTHING, hermitian=True)
    return float(e @ e - onto @ known @ onto)


def _of_runs(fitted: Prediction, part: Prediction) -> list[tuple[float, float]]:
    """Return the surprise and the equations of each held-out run by itself."""
    S, sizes = _known(fitted), [len(white.keep) for white in part.likelihood.whiteners]
    lost = (sum(sizes) - part.evaluation.rows) / len(sizes)  # nuisances of a run
    out, at = [], 0
    for size in sizes:
        own = slice(at, at + size)
        at += size
        misfit = _surprise(S, part.evaluation.residual[own], part.evaluation.jacobian[own])
        out.append((float("nan") if misfit is None else misfit, size - lost))
    return out


def standardised(fitted: Prediction) -> tuple[tuple[float, float], ...] | None:
    """Return of each fitted run the misfit when it is predicted from the others, and its equations.

    By linear theory e_r = (I - H_r)^-1 r_r with covariance (I - H_r)^-1, H_r = J_r (J^T J)^-1 J_r^T, so that the misfit
    r_r^T (I - H_r)^-1 r_r is chi-squared, if the structure is true (Cook & Weisberg, Residuals and Influence in
    Regression, 1982, ch. 2). Directions that only this run determines count neither as misfit nor as equations.
    """
    sizes = [len(white.keep) for white in fitted.likelihood.whiteners]
    S, residual = _known(fitted), fitted.evaluation.residual
    if not (np.isfinite(S).all() and np.isfinite(residual).all()):
        return None
    theta, free = fitted.experiment.theta0, fitted.experiment.free
    S = S[:, [not _at_bound(v, item.low, item.high) for v, item in zip(theta, free, strict=True)]]
    norm = np.linalg.norm(S, axis=0)
    S = S[:, norm > 0] / norm[norm > 0]
    inverse = np.linalg.pinv(S.T @ S, rcond=NOTHING, hermitian=True)
    lost = (sum(sizes) - fitted.evaluation.rows) / len(sizes)
    out, at = [], 0
    for size in sizes:
        J, e = S[at : at + size], residual[at : at + size]
        at += size
        values, vectors = np.linalg.eigh(np.eye(size) - J @ inverse @ J.T)
        told = values > HELD_BY_NONE
        parts = vectors[:, told].T @ e
        out.append((float((parts**2 / values[told]).sum()), float(told.sum()) - lost))
    return tuple(out)


def _at_bound(value: float, low: float, high: float) -> bool:
    return any(np.isfinite(end) and abs(value - end) <= AT_BOUND * max(abs(end), 1e-300) for end in (low, high))


def _add(sums: dict[str, np.ndarray], found: Prediction) -> None:
    """Add mean squares of what is left over, of the noise, and of the signal: |X_0|^2 + 2 sum |X_k|^2 (Parseval)."""
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


def _errors(sums: Mapping[str, np.ndarray]) -> tuple[dict[str, float], dict[str, float]]:
    """Return NRMSE and noise floor of each port."""
    ports = {name: float(np.sqrt(s[0] / s[2])) for name, s in sums.items() if s[2] > 0}
    return ports, {name: float(np.sqrt(s[1] / s[2])) for name, s in sums.items() if s[2] > 0}
