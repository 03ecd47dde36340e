"""Whitened residuals of an experiment whose diagram is nonlinear in its states."""

from __future__ import annotations

from copy import copy

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.experiment import Experiment
from rotorsim.identification.likelihood import Evaluation, Likelihood, fitted_columns
from rotorsim.settled.motion import NonlinearMotion, Prediction
from rotorsim.signals.covariance import real_columns, real_vector

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
        fresh = motion.fresh_means(theta)
        means = [m.copy() for m in self.means or motion.means_of_zero(theta)]
        for m, (places, values, _) in zip(means, fresh, strict=True):
            m[places] = values
        for _ in range(self.rounds):
            found = motion.predict(theta, means)
            parts = [self._run(found, r, *fresh[r]) for r in range(len(self.data))]
            if not found.settled.all() or all(_still(e, gain) for e, _, _, gain, _ in parts):
                break
            means = [m + best for m, (_, _, best, _, _) in zip(means, parts, strict=True)]
        if found.settled.all():
            self.means = means
        residuals, rows = [part[0] for part in parts], [part[1] for part in parts]
        counted = sum(len(e) for e in residuals) - sum(len(part[3]) for part in parts)
        Y = np.pad(found.Y, ((0, 0), (0, self.beside), (0, 0)))
        return self.together(residuals, rows, {r: part[4] for r, part in enumerate(parts)}, Y, counted)

    def _run(
        self, found: Prediction, r: int, places: np.ndarray, _: np.ndarray, by_theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return residual and slopes of a run without what the means can explain, their change, its size and columns.

        places: slow states whose means are known, by_theta (k, m): how these follow the parameters.
        """
        white = self.whiteners[r]
        more = (0, self.beside)  # nothing moves beside the harmonics
        e = self.data_rows[r] - white.apply(real_vector(np.pad(found.Y[r], (more, (0, 0)))))
        slopes = found.slopes[r] + found.by_means[r][..., places] @ by_theta
        slopes = np.pad(slopes, (more, (0, 0), (0, 0)))
        j = -white.apply(real_columns(slopes))
        open_ones = np.setdiff1d(np.arange(found.by_means[r].shape[-1]), places)
        columns = np.pad(found.by_means[r][..., open_ones], (more, (0, 0), (0, 0)))
        change = np.zeros(found.by_means[r].shape[-1])
        if not len(open_ones) or not found.settled[r]:
            return e, j, change, np.zeros(0), np.zeros((len(e), 0))
        q, change[open_ones] = fitted_columns(white.apply(real_columns(columns)), e)
        gain = q.T @ e
        return e - q @ gain, j - q @ (q.T @ j), change, gain, q


def _still(residual: np.ndarray, gain: np.ndarray) -> bool:
    """Return whether a change of the means is small against what is left over beside it."""
    return bool(np.linalg.norm(gain) <= CLOSE * np.linalg.norm(residual))
