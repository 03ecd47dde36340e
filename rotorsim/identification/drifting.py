"""The likelihood of measured harmonics together with how 1X drifts within the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from rotorsim.identification.experiment import Experiment
from rotorsim.identification.likelihood import Evaluation, Likelihood
from rotorsim.identification.whitening import harmonics_of_time
from rotorsim.settled.motion import Prediction, SettledMotion
from rotorsim.signals.covariance import real_columns, scaled_cholesky
from rotorsim.signals.order_drift import DEGREES, OrderDrift, drift_of_order

FURTHER = 1e-4  # relative, of a rate: for the derivative by it


@dataclass(frozen=True, eq=False)
class _Course:
    """What states that start with the run change at 1X by what decays of them, by Legendre coefficients, (R, 3, c).

    At degree 0 beyond what the motion has by their means. by_theta (R, 3, c, m).
    """

    values: np.ndarray
    by_theta: np.ndarray


class DriftingLikelihood(Likelihood):
    """Whitened residuals of harmonics and, run by run behind them, of the drift of 1X.

    A state that starts with the run is a constant and a part that decays as e^{-a t}, to which 1X answers at i W - a;
    how the machine settles to that is left out. A drift that turns all channels alike is one of the shaft angle, and
    counts for nothing.
    """

    def __init__(self, experiment: Experiment) -> None:
        super().__init__(experiment)
        self._drifts = [drift_of_order(item, experiment.recording) for item in experiment.runs]
        self.data = self.data.copy()
        for r, drift in enumerate(self._drifts):
            self.data[r, : self.K + 1, : self.c] -= self._of_time(r, drift.leaked[: self.K + 1])
        self.data_rows = self.white(real_columns(self.data[..., None]))[..., 0]
        self._roots = [self._root(r, drift) for r, drift in enumerate(self._drifts)]
        self.is_beside = np.concatenate([self.is_beside, np.zeros(2 * DEGREES * self.c, bool)])

    @property
    def sizes(self) -> list[int]:
        """The number of real equations of each run."""
        return [size + 2 * DEGREES * self.c for size in super().sizes]

    def predict(self, theta: np.ndarray, means: Sequence[np.ndarray], inputs: np.ndarray | None = None) -> Prediction:
        """Return the motion at theta (m,) with slow states at given means, and 1X with what lags behind them."""
        settled = super().predict(theta, means, inputs)
        course = self._course(theta, settled)
        if course is None:
            return settled
        Y = settled.Y.copy()
        Y[:, 1] += course.values[:, 0]

        def sensitivity() -> np.ndarray:
            dY = settled.sensitivity().copy()
            dY[:, 1] += course.by_theta[:, 0]
            return dY

        return replace(settled, Y=Y, sensitivity=sensitivity)

    def evaluated(self, theta: np.ndarray) -> tuple[Evaluation, Prediction]:
        """Return the whitened residual and its derivatives at theta (m,), and the motion with the best means."""
        found, prediction = super().evaluated(theta)
        course = self._course(theta, prediction)
        rest = np.array([self._of_time(r, own.values) for r, own in enumerate(self._drifts)])
        by_theta = np.zeros((*rest.shape, len(theta)), complex)
        if course is not None:
            rest, by_theta = rest - course.values[:, 1:], course.by_theta[:, 1:]
        e = self._white(rest[..., None])[..., 0]
        late = None if found.late is None else _behind(found.late, np.zeros_like(e))
        together = replace(
            found,
            residual=_behind(found.residual, e),
            jacobian=_behind(found.jacobian, -self._white(by_theta)),
            misfit=found.misfit + (e**2).sum(axis=1),
            rows=found.rows + e.size - len(rest) * DEGREES,  # less the turns of the angle
            late=late,
        )
        return together, prediction

    def _course(self, theta: np.ndarray, settled: Prediction) -> _Course | None:
        """Return what states that start with the run change at 1X beside a settled motion; None without any."""
        motion = self.experiment.motion
        fresh = motion.fresh_means(theta)
        most = max(len(known.places) for known in fresh)
        if not most:
            return None
        R, c, m = len(fresh), self.c, len(theta)
        values, by_theta = np.zeros((R, DEGREES + 1, c), complex), np.zeros((R, DEGREES + 1, c, m), complex)
        last = motion.last
        for k in range(most):
            places = [known.places[k] for known in fresh]
            rates = np.array([known.rates[k] for known in fresh])
            more = [own.copy() for own in settled.means]
            for own, place in zip(more, places, strict=True):
                own[place] += 1.0
            near, slopes = _answer(motion, theta, settled.means, more, places)
            there, there_slopes = _answer(motion.decaying(rates), theta, settled.means, more, places)
            further = motion.decaying(rates * (1 + FURTHER)).predict(theta, settled.means)
            by_rate = (_by_mean(further, places) - there) / (FURTHER * rates)[:, None]
            for r, known in enumerate(fresh):
                answers = [there[r] - near[r], *[there[r]] * DEGREES]
                bends = there_slopes[r] + np.outer(by_rate[r], known.by_rates[k])
                for n, answer in enumerate(answers):
                    values[r, n] += known.decaying[k, n] * answer
                    slope = bends if n else bends - slopes[r]
                    by_theta[r, n] += np.outer(answer, known.by_decaying[k, n]) + known.decaying[k, n] * slope
        motion.last = last
        return _Course(values, by_theta)

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


def _by_mean(prediction: Prediction, places: Sequence[int]) -> np.ndarray:
    """Return d 1X (R, c) by the mean of one slow state of each run."""
    return np.array([own[1][:, place] for own, place in zip(prediction.by_means, places, strict=True)])


def _answer(
    motion: SettledMotion,
    theta: np.ndarray,
    means: Sequence[np.ndarray],
    more: Sequence[np.ndarray],
    places: Sequence[int],
) -> tuple[np.ndarray, np.ndarray]:
    """Return what 1X (R, c) is by the mean of one slow state of each run, and its derivatives (R, c, m).

    more: means with one more of these: 1X is in proportion to them.
    """
    first = motion.predict(theta, means)
    return _by_mean(first, places), motion.predict(theta, more).sensitivity()[:, 1] - first.sensitivity()[:, 1]


def _whitened(roots: Sequence[tuple[np.ndarray, np.ndarray]], columns: np.ndarray) -> np.ndarray:
    pairs = zip(roots, columns, strict=True)
    return np.concatenate([solve_triangular(L, own / scale[:, None], lower=True) for (scale, L), own in pairs])


def _behind(rows: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Return rows of all runs, one after the other, with more (R, n, ...) behind those of each."""
    R = len(more)
    return np.concatenate([rows.reshape(R, -1, *rows.shape[1:]), more], axis=1).reshape(-1, *rows.shape[1:])
