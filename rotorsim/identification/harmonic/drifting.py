"""The likelihood of measured harmonics together with how 1X drifts within the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from rotorsim.identification.harmonic.experiment import Experiment
from rotorsim.identification.harmonic.likelihood import Evaluation, Likelihood
from rotorsim.identification.harmonic.whitening import harmonics_of_time
from rotorsim.settled.growing import DEGREES, Machine, forces
from rotorsim.settled.motion import Prediction
from rotorsim.settled.nonlinear import NonlinearMotion
from rotorsim.signals.covariance import real_columns, scaled_cholesky
from rotorsim.signals.harmonic_fit import RESOLUTION
from rotorsim.signals.order_drift import OrderDrift, drift_of_order

STEP = 1e-6  # relative, of a parameter of what grows: for the derivative by it


@dataclass(frozen=True, eq=False)
class _Course:
    """Legendre coefficients (R, DEGREES + 1, c) of 1X over the runs, at degree 0 beyond the mean's; see `Machine`.

    by_theta (R, DEGREES + 1, c, m): by the parameters of what grows. Those of the machine are known from its harmonics.
    """

    values: np.ndarray
    by_theta: np.ndarray


def likelihood_of(experiment: Experiment) -> Likelihood:
    """Return the likelihood of harmonics: `LaggingLikelihood` where states start with the run."""
    fresh = experiment.motion.fresh_means(experiment.theta0)
    return LaggingLikelihood(experiment) if any(len(known.states) for known in fresh) else Likelihood(experiment)


class LaggingLikelihood(Likelihood):
    """Whitened residuals of harmonics, 1X as it lags behind states that start with the run, without its drift."""

    def __init__(self, experiment: Experiment) -> None:
        super().__init__(experiment)
        self._known: tuple[bytes, _Course | None] | None = None
        self.drifts = [drift_of_order(item, experiment.recording) for item in experiment.runs]
        self.data = self.data.copy()
        for r, drift in enumerate(self.drifts):
            self.data[r, : self.K + 1, : self.c] -= self._of_time(r, drift.leaked[: self.K + 1])
        self.data_rows = self.white(real_columns(self.data[..., None]))[..., 0]

    def predict(self, theta: np.ndarray, means: Sequence[np.ndarray], inputs: np.ndarray | None = None) -> Prediction:
        """Return the motion at theta (m,) with slow states at given means, and 1X with what lags behind them."""
        settled = super().predict(theta, means, inputs)
        course = self._course(theta)
        if course is None:
            return settled
        Y = settled.Y.copy()
        Y[:, 1] += course.values[:, 0]

        def sensitivity() -> np.ndarray:
            dY = settled.sensitivity().copy()
            dY[:, 1] += course.by_theta[:, 0]
            return dY

        return replace(settled, Y=Y, sensitivity=sensitivity)

    def _course(self, theta: np.ndarray) -> _Course | None:
        """Return the course of 1X by states that start with the run; None without any."""
        if self._known is None or self._known[0] != theta.tobytes():
            self._known = theta.tobytes(), self._courses(theta)
        return self._known[1]

    def _courses(self, theta: np.ndarray) -> _Course | None:
        motion = self.experiment.motion
        if not isinstance(motion, NonlinearMotion):
            return None
        fresh = motion.fresh_means(theta)
        most = max(len(known.states) for known in fresh)
        if not most:
            return None
        values = np.zeros((len(fresh), DEGREES + 1, self.c), complex)
        by_theta = np.zeros((*values.shape, len(theta)), complex)
        for k in range(most):
            states = np.array([known.states[k] for known in fresh])
            machine = Machine.of(motion, theta, states)

            def course(theta: np.ndarray, k: int = k, states: np.ndarray = states, of: Machine = machine) -> np.ndarray:
                laws = np.array([known.laws[k] for known in motion.fresh_means(theta)])
                return of.courses(forces(motion, theta, states), laws)

            here = course(theta)
            values += here
            for j in self._parameters_of(int(states[0])):
                step = STEP * max(abs(theta[j]), STEP)
                by_theta[..., j] += (course(theta + step * (np.arange(len(theta)) == j)) - here) / step
        return _Course(values, by_theta)

    def _parameters_of(self, state: int) -> list[int]:
        """Return the free parameters of the block that has a state, and those of the diagram that it follows."""
        equations = self.experiment.motion.equations
        at = equations.kept[state]
        parts = ((name, range(*signal.part.indices(at + 1))) for name, signal in equations.model.states.items())
        block = next(name.rpartition(".")[0] for name, part in parts if at in part)
        node = self.experiment.diagram.nodes.get(block)
        shared = [] if node is None else [*node.references.values()]
        bases = (item.base for item in self.experiment.free)
        return [j for j, base in enumerate(bases) if base.rpartition(".")[0] == block or base in shared]

    def _of_time(self, r: int, values: np.ndarray) -> np.ndarray:
        return harmonics_of_time(values[:, self._columns(r)], self.experiment.fits[r].speed)

    def _columns(self, r: int) -> np.ndarray:
        return np.asarray(self.experiment.columns[r][: self.c])


class DriftingLikelihood(LaggingLikelihood):
    """Whitened residuals of harmonics and, run by run behind them, of the drift of 1X: zero in runs that tell none.

    A drift that turns all channels alike is one of the shaft angle, and counts for nothing. variance: of the drift, as
    a multiple of what noise makes.
    """

    def __init__(self, experiment: Experiment, variance: float = 1.0) -> None:
        super().__init__(experiment)
        self.variance = variance
        self._roots = [self._root(r, drift) for r, drift in enumerate(self.drifts)]
        self.is_beside = np.concatenate([self.is_beside, np.zeros(2 * DEGREES * self.c, bool)])

    @property
    def sizes(self) -> list[int]:
        """The number of real equations of each run."""
        return [size + 2 * DEGREES * self.c for size in super().sizes]

    def evaluated(self, theta: np.ndarray) -> tuple[Evaluation, Prediction]:
        """Return the whitened residual and its derivatives at theta (m,), and the motion with the best means."""
        found, prediction = super().evaluated(theta)
        course = self._course(theta)
        rest = self.drift - self.grown(theta)
        by_theta = np.zeros((*rest.shape, len(theta)), complex) if course is None else course.by_theta[:, 1:]
        e = self.white_drift(rest)
        told = sum(drift.told for drift in self.drifts)
        together = replace(
            found,
            residual=_behind(found.residual, e),
            jacobian=_behind(found.jacobian, -self._white(by_theta)),
            misfit=found.misfit + (e**2).sum(axis=1),
            rows=found.rows + told * DEGREES * (2 * self.c - 1),  # of each degree less the turn of the angle
            late=None if found.late is None else _behind(found.late, np.zeros_like(e)),
        )
        return together, prediction

    @cached_property
    def drift(self) -> np.ndarray:
        """The measured drift of 1X, (R, DEGREES, c)."""
        return np.array([self._of_time(r, own.values) for r, own in enumerate(self.drifts)])

    def grown(self, theta: np.ndarray) -> np.ndarray:
        """Return the drift of 1X by states that start with the run, (R, DEGREES, c)."""
        course = self._course(theta)
        return np.zeros_like(self.drift) if course is None else course.values[:, 1:]

    def white_drift(self, values: np.ndarray) -> np.ndarray:
        """Return the drift of 1X (R, DEGREES, c), complex, whitened (R, 2 DEGREES c)."""
        return self._white(values[..., None])[..., 0]

    def _root(self, r: int, drift: OrderDrift) -> list[tuple[np.ndarray, np.ndarray]]:
        item, sign = self.experiment.runs[r], np.ones(2 * self.c)
        sign[self.c :] = np.sign(item.fit.speed)
        found = []
        for degree in range(1, DEGREES + 1 if drift.told else 1):
            covariance = self.variance * drift.covariance(item, self._columns(r), degree, RESOLUTION)
            found.append(scaled_cholesky(covariance * np.outer(sign, sign)))
        return found

    def _white(self, columns: np.ndarray) -> np.ndarray:
        """Return complex columns (R, DEGREES, c, j) whitened, (R, 2 DEGREES c, j)."""
        real = np.concatenate([columns.real, columns.imag], axis=2)
        white = np.zeros(real.shape)
        for r, roots in enumerate(self._roots):
            for n, (scale, L) in enumerate(roots):
                white[r, n] = solve_triangular(L, real[r, n] / scale[:, None], lower=True)
        return white.reshape(len(real), -1, real.shape[3])


def _behind(rows: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Return rows of all runs, one after the other, with more (R, n, ...) behind those of each."""
    R = len(more)
    return np.concatenate([rows.reshape(R, -1, *rows.shape[1:]), more], axis=1).reshape(-1, *rows.shape[1:])
