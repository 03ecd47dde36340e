"""Whitened residuals of an experiment whose diagram is nonlinear in its states."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.identify.experiment import Experiment
from rotorsim.identify.likelihood import Evaluation, Likelihood, fitted_columns
from rotorsim.identify.nonlinear_motion import NonlinearMotion, Prediction
from rotorsim.recordings.harmonic_fit import real_vector

__all__ = ["NonlinearLikelihood", "likelihood_of"]

MOST_ROUNDS = 5
CLOSE = 1e-3  # of the whitened residual: its change by the means of slow states


def likelihood_of(experiment: Experiment) -> Likelihood:
    """Return the likelihood of an experiment, by the direct response of a linear diagram or by harmonic balance."""
    kind = NonlinearLikelihood if isinstance(experiment.motion, NonlinearMotion) else Likelihood
    return kind(experiment)


class NonlinearLikelihood(Likelihood):
    """Whitened residuals by harmonic balance; the means of slow states are fitted in every evaluation.

    Where no periodic motion is found the residual is not a number. Raises RotorsimError for signals taken as given.
    """

    def __init__(self, experiment: Experiment) -> None:
        super().__init__(experiment)
        if self.V:
            hint = "leave out --measured-input"
            raise RotorsimError(
                Problem("a nonlinear diagram takes no measured inputs", experiment.diagram.name, hint=hint)
            )
        self.means: list[np.ndarray] | None = None
        self.rounds = MOST_ROUNDS

    def rough(self) -> NonlinearLikelihood:
        """Return the likelihood with the effect of the slow states' means by linear theory: half the work."""
        other = copy(self)
        other.rounds = 1
        return other

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Return the whitened residual and its slopes at theta (m,)."""
        motion = self.experiment.motion
        assert isinstance(motion, NonlinearMotion)
        means = self.means or motion.first_means(theta)
        for _ in range(self.rounds):
            found = motion.predict(theta, means)
            parts = [self._run(found, r, means[r], motion.between[r]) for r in range(len(self.data))]
            if not found.settled.all() or all(_still(part.residual, part.gain) for part in parts):
                break
            means = [m + part.change for m, part in zip(means, parts, strict=True)]
        if found.settled.all():
            self.means = means
        many = [len(rows) for rows in self.data_rows]
        misfit = np.array([float(part.residual @ part.residual) for part in parts])
        counted = sum(many) - round(sum(part.freedom for part in parts))
        Y = np.pad(found.Y, ((0, 0), (0, self.beside), (0, 0)))
        # what is known of means comes after the data of all runs
        residuals = [part.residual[:n] for part, n in zip(parts, many, strict=True)]
        residuals += [part.residual[n:] for part, n in zip(parts, many, strict=True)]
        rows = [part.slopes[:n] for part, n in zip(parts, many, strict=True)]
        rows += [part.slopes[n:] for part, n in zip(parts, many, strict=True)]
        return Evaluation(np.concatenate(residuals), np.concatenate(rows), misfit, Y, counted)

    def _run(self, found: Prediction, r: int, means: np.ndarray, between: np.ndarray) -> _Part:
        """Return residual and slopes of a run without what the means of its slow states can explain.

        A mean that can only be between two ends counts as one of a normal distribution of the same mean and variance as
        all between them: an equation more, so that a law which is next to nothing explains nothing by it.
        """
        white = self.whiteners[r]
        more = (0, self.beside)  # nothing moves beside the harmonics
        e = self.data_rows[r] - white.apply(real_vector(np.pad(found.Y[r], (more, (0, 0)))))
        slopes = np.pad(found.slopes[r], (more, (0, 0), (0, 0)))
        j = -white.apply(np.moveaxis(real_vector(np.moveaxis(slopes, -1, 0)), 0, -1))
        columns = np.pad(found.by_means[r], (more, (0, 0), (0, 0)))
        if not columns.shape[-1] or not found.settled[r]:
            return _Part(e, j, np.zeros(columns.shape[-1]), np.zeros(0), 0.0)
        effects = white.apply(np.moveaxis(real_vector(np.moveaxis(columns, -1, 0)), 0, -1))
        known = np.flatnonzero(np.isfinite(between).all(axis=1))
        if len(known):
            std = np.ptp(between[known], axis=1) / np.sqrt(12)
            e = np.append(e, (between[known].mean(axis=1) - means[known]) / std)
            j = np.vstack([j, np.zeros((len(known), j.shape[1]))])
            effects = np.vstack([effects, np.zeros((len(known), effects.shape[1]))])
            effects[len(effects) - len(known) + np.arange(len(known)), known] = 1 / std
        q, best = fitted_columns(effects, e)
        gain = q.T @ e
        freedom = float((q[: len(self.data_rows[r])] ** 2).sum())
        return _Part(e - q @ gain, j - q @ (q.T @ j), best, gain, freedom)


@dataclass(frozen=True, eq=False)
class _Part:
    """One run: residual and slopes beside its means, what these change by and its size, and how many they count as."""

    residual: np.ndarray
    slopes: np.ndarray
    change: np.ndarray
    gain: np.ndarray
    freedom: float


def _still(residual: np.ndarray, gain: np.ndarray) -> bool:
    """Return whether a change of the means is small against what is left over beside it."""
    return bool(np.linalg.norm(gain) <= CLOSE * np.linalg.norm(residual))
