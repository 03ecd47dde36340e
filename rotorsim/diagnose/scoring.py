"""How well a diagram predicts runs: normalised root mean square of what it leaves over, beside the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.diagnose.fitting import Source, fit_document
from rotorsim.errors import RotorsimError
from rotorsim.identify.experiment import Experiment, open_experiment
from rotorsim.identify.likelihood import Evaluation, Likelihood
from rotorsim.identify.nonlinear_likelihood import likelihood_of
from rotorsim.identify.nonlinear_motion import NonlinearMotion
from rotorsim.recordings.harmonics import RunHarmonics
from rotorsim.recordings.recording import Recording

__all__ = ["Held", "Prediction", "Score", "left_out_score", "predict", "predicts", "score"]

NOISE = 1.1  # times the noise floor: what a diagram leaves over that predicts all there is to predict
PROVED = 0.9  # share of the mean square left unexplained before that a repaired diagram predicts
SMALL = 1.5  # times the noise floor: of what is left unexplained below, errors of mesh and parameters are a large share


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


def _mean(values: Mapping[str, float]) -> float | None:
    found = np.array(list(values.values()))
    return float(np.sqrt(np.mean(found**2))) if found.size and np.isfinite(found).all() else None


def predicts(before: Score, after: Score) -> bool:
    """Return whether a repaired diagram predicts runs that took no part: noise is left, or a tenth of what was.

    Where little was to be explained it must not be worse. True, too, where one of them has no settled motion.
    """
    if before.total is None or after.total is None or after.noise is None:
        return True
    left, unexplained = after.total**2 - after.noise**2, before.total**2 - after.noise**2
    if before.total <= SMALL * after.noise and after.total <= before.total:
        return True
    return after.total <= NOISE * after.noise or left <= (1 - PROVED) * unexplained


def predict(document: Mapping[str, Any], source: Source, held: Held) -> Prediction:
    """Return the prediction of runs by a diagram as it is, with the means of slow states at their best."""
    diagram = source.load(document)
    runs = [item.run for item in held.harmonics]
    experiment = open_experiment(diagram, held.recording, runs=runs, harmonics=held.harmonics)
    if isinstance(experiment.motion, NonlinearMotion):
        experiment.motion.sharpen()
    likelihood = likelihood_of(experiment)
    return Prediction(experiment, likelihood, likelihood.evaluate(experiment.theta0))


def score(document: Mapping[str, Any], source: Source, held: Sequence[Held]) -> Score:
    """Return NRMSE = sqrt(sum |x - x_model|^2 / sum |x - mean|^2) per port over runs, in time by Parseval.

    What the harmonics leave over of a signal counts as not explained, in ``ports`` and in ``floor``.
    """
    sums: dict[str, np.ndarray] = {}
    for part in held:
        try:
            found = predict(document, source, part)
        except (RotorsimError, np.linalg.LinAlgError, ValueError):
            return Score({"": float("nan")}, {})
        _add(sums, found)
    ports = {name: float(np.sqrt(s[0] / s[2])) for name, s in sums.items() if s[2] > 0}
    floor = {name: float(np.sqrt(s[1] / s[2])) for name, s in sums.items() if s[2] > 0}
    return Score(ports, floor)


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
