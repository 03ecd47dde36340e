"""The likelihood of measured harmonics together with how 1X drifts within the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from rotorsim.identification.experiment import Experiment
from rotorsim.identification.likelihood import Evaluation, Likelihood
from rotorsim.identification.whitening import harmonics_of_time
from rotorsim.settled.motion import Prediction
from rotorsim.signals.covariance import scaled_cholesky
from rotorsim.signals.order_drift import DEGREES, OrderDrift, drift_of_order


class DriftingLikelihood(Likelihood):
    """Whitened residuals of harmonics and, run by run behind them, of the drift of 1X.

    What moves it are states that start with the run: the motion has settled beside them, so that 1X is at every instant
    that of the state as it is. A drift that turns all channels alike is one of the shaft angle, and counts for nothing.
    """

    def __init__(self, experiment: Experiment) -> None:
        super().__init__(experiment)
        self._drifts = [drift_of_order(item, experiment.recording) for item in experiment.runs]
        self._roots = [self._root(r, drift) for r, drift in enumerate(self._drifts)]
        self.is_beside = np.concatenate([self.is_beside, np.zeros(2 * DEGREES * self.c, bool)])

    @property
    def sizes(self) -> list[int]:
        """The number of real equations of each run."""
        return [size + 2 * DEGREES * self.c for size in super().sizes]

    def evaluated(self, theta: np.ndarray) -> tuple[Evaluation, Prediction]:
        """Return the whitened residual and its derivatives at theta (m,), and the motion with the best means."""
        found, prediction = super().evaluated(theta)
        drift, by_theta = self._predicted(theta, prediction)
        rest = np.array([self._of_time(r, own.values) for r, own in enumerate(self._drifts)]) - drift
        e = self._white(rest[..., None])[..., 0]
        R = len(rest)
        late = None if found.late is None else _behind(found.late, np.zeros_like(e))
        together = replace(
            found,
            residual=_behind(found.residual, e),
            jacobian=_behind(found.jacobian, -self._white(by_theta)),
            misfit=found.misfit + (e**2).sum(axis=1),
            rows=found.rows + e.size - R * DEGREES,  # less the turns of the angle
            late=late,
        )
        return together, prediction

    def _predicted(self, theta: np.ndarray, still: Prediction) -> tuple[np.ndarray, np.ndarray]:
        """Return the drift (R, DEGREES, c) of 1X and its derivatives (R, DEGREES, c, m)."""
        motion, R = self.experiment.motion, len(self.experiment.runs)
        drift, by_theta = np.zeros((R, DEGREES, self.c), complex), np.zeros((R, DEGREES, self.c, len(theta)), complex)
        fresh = motion.fresh_means(theta)
        if not any(len(known.places) for known in fresh):
            return drift, by_theta
        before, last = still.sensitivity()[:, 1], motion.last
        for n in range(DEGREES):
            means = [own.copy() for own in still.means]
            for own, known in zip(means, fresh, strict=True):
                own[known.places] += known.courses[:, n]
            there = motion.predict(theta, means)
            drift[:, n] = there.Y[:, 1] - still.Y[:, 1]
            by_theta[:, n] = there.sensitivity()[:, 1] - before
            for r, known in enumerate(fresh):
                moved, unmoved = (each.by_means[r][1][:, known.places] for each in (there, still))
                by_theta[r, n] += moved @ known.by_courses[:, n] + (moved - unmoved) @ known.jacobian
        motion.last = last
        return drift, by_theta

    def _of_time(self, r: int, values: np.ndarray) -> np.ndarray:
        return harmonics_of_time(values[:, self._columns(r)], self.experiment.fits[r].speed)

    def _columns(self, r: int) -> np.ndarray:
        return np.asarray(self.experiment.columns[r][: self.c])

    def _root(self, r: int, drift: OrderDrift) -> list[tuple[np.ndarray, np.ndarray]]:
        item, sign = self.experiment.runs[r], np.ones(2 * self.c)
        sign[self.c :] = np.sign(item.fit.speed)
        found = []
        for degree in range(1, DEGREES + 1):
            covariance = drift.covariance(item, self._columns(r), degree, self.experiment.resolution)
            found.append(scaled_cholesky(covariance * np.outer(sign, sign)))
        return found

    def _white(self, columns: np.ndarray) -> np.ndarray:
        """Return complex columns (R, DEGREES, c, j) whitened, (R, 2 DEGREES c, j)."""
        real = np.concatenate([columns.real, columns.imag], axis=2)
        return np.array([_whitened(roots, own) for roots, own in zip(self._roots, real, strict=True)])


def _whitened(roots: Sequence[tuple[np.ndarray, np.ndarray]], columns: np.ndarray) -> np.ndarray:
    pairs = zip(roots, columns, strict=True)
    return np.concatenate([solve_triangular(L, own / scale[:, None], lower=True) for (scale, L), own in pairs])


def _behind(rows: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Return rows of all runs, one after the other, with more (R, n, ...) behind those of each."""
    R = len(more)
    return np.concatenate([rows.reshape(R, -1, *rows.shape[1:]), more], axis=1).reshape(-1, *rows.shape[1:])
