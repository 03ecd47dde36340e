"""The likelihood of measured harmonics: errors in all measured signals, nuisances profiled out, exact derivatives.

minus twice the logarithm = |r|^2,  r = P W (y - y(theta)):  W whitens with the covariance of the harmonics,
P projects out what is of no interest and enters linearly, or nearly so: the mean of slow states, and the true harmonics
of signals that are taken as measured inputs (so that their noise does not bias the parameters). A delay that all pulses
share, of standard deviation s, is marginalised: with the columns g = s P W dy/dtau of all runs, the covariance
I + g g^T of P W y has the inverse root I - g g^T / |g|^2 (1 - 1 / sqrt(1 + |g|^2)).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.experiment import Experiment
from rotorsim.identification.whitening import harmonics_of_time, whitened_at, whitener_of
from rotorsim.settled.motion import Prediction, Response
from rotorsim.signals.covariance import real_columns, real_vector

SLOW_MEAN_TOLERANCE = (
    1e-3  # of the whitened residual: its change by the means of slow states, where the motion is not linear in them
)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Whitened residual r (n,), its derivatives dr/dtheta (n, m), and the misfit |r|^2 of every run (R,).

    Y: predicted harmonics (R, K+1, c) with the nuisances at their best. rows: number of real equations left
    after the nuisances. late: (n,) whitened change by the common delay of the pulses, one standard deviation.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    misfit: np.ndarray
    Y: np.ndarray
    rows: int
    late: np.ndarray | None = None

    def apart(self) -> tuple[np.ndarray, np.ndarray]:
        """Return residual and derivatives of each run by itself, as they are for a known delay of the pulses."""
        if self.late is None or not self.late.any():
            return self.residual, self.jacobian
        size = float(self.late @ self.late)
        grown = (np.sqrt(1 + size) - 1) / size * self.late
        return (
            self.residual + grown * (self.late @ self.residual),
            self.jacobian + np.outer(grown, self.late @ self.jacobian),
        )


@dataclass(frozen=True, eq=False)
class _Profiled:
    """A run's whitened residual without its nuisances, an orthonormal base of these (n, j), the best changes of means
    and inputs, and the residual's part along the base (j,)."""

    residual: np.ndarray
    base: np.ndarray
    means: np.ndarray
    inputs: np.ndarray
    gain: np.ndarray


class Likelihood:
    """Whitened residuals of an experiment: in units of their standard deviation.

    Where no periodic motion exists the residual is not a number. Raises RotorsimError for signals taken as given where
    the diagram is not linear.
    """

    absolute = True

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        motion = experiment.motion
        self.K = motion.K
        self.beside = len(experiment.beside_orders)
        self.orders = self.K + 1 + self.beside
        self.c, self.V = len(experiment.predicted), len(experiment.given)
        self._shifts = motion.is_linear and not self.V  # the residual is the same at all slow means
        self.rounds = 1 if self._shifts else motion.corrections + 1
        if self.V and not motion.is_linear:
            what, hint = "a nonlinear diagram takes no measured inputs", "leave out --measured-input"
            raise RotorsimError(Problem(what, experiment.diagram.name, hint=hint))
        self.data = experiment.measured(self.K)
        if self.beside:
            pairs = zip(experiment.fits, experiment.columns, strict=True)
            lines = [fit.beside.values[:, columns] for fit, columns in pairs if fit.beside is not None]
            self.data = np.concatenate([self.data, lines], axis=1)
        keep = np.ones((2 * self.orders - 1, self.c + self.V), bool)
        keep[0] = experiment.use_mean
        self.keep = np.flatnonzero(keep.ravel())
        self.is_beside = self.keep >= (2 * self.K + 1) * (self.c + self.V)  # which rows of a run are of such lines
        self.whiteners = [
            whitener_of(fit, columns, self.K, self.keep, experiment.resolution, beside=self.beside > 0)
            for fit, columns in zip(experiment.fits, experiment.columns, strict=True)
        ]
        self.data_rows = self._white(self.data)
        self._means: list[np.ndarray] | None = None

    def _white(self, harmonics: np.ndarray) -> list[np.ndarray]:
        """Return harmonics (R, orders, c + V) as whitened rows of each run."""
        rows = real_vector(harmonics)
        return [white.apply(own) for white, own in zip(self.whiteners, rows, strict=True)]

    def rough(self) -> Likelihood:
        """Return the likelihood with slow means by linear theory where it takes several steps: to compare starts."""
        if self.experiment.motion.is_linear:
            return self
        other = copy(self)
        other.rounds = 1
        return other

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Return the whitened residual and its derivatives at theta (m,)."""
        motion = self.experiment.motion
        tolerance = 0.0 if motion.is_linear else SLOW_MEAN_TOLERANCE
        fresh = motion.fresh_means(theta)
        means = [known.start(own) for known, own in zip(fresh, self._means or itertools.repeat(None), strict=False)]
        inputs = self.data[:, :, self.c :]
        for _ in range(self.rounds):
            prediction = motion.predict(theta, means, inputs)
            Y = self._padded(prediction.Y)
            turn = self._turned(Y)
            Y = Y * turn[:, :, None]
            rows = real_vector(np.concatenate([Y, inputs], axis=2))
            runs = [self._profiled(prediction, r, Y[r], own, fresh[r].places) for r, own in enumerate(rows)]
            still = all(np.linalg.norm(run.gain) <= tolerance * np.linalg.norm(run.residual) for run in runs)
            if still or not prediction.settled.all():
                break
            means = [own + run.means for own, run in zip(means, runs, strict=True)]
            inputs = inputs + np.array([run.inputs for run in runs])
        if self._shifts:
            prediction = motion.predict(theta, [run.means for run in runs])
            Y = self._padded(prediction.Y) * turn[:, :, None]
        elif prediction.settled.all():
            self._means = means
        derivatives = prediction.sensitivity()
        for r, known in enumerate(fresh):
            derivatives[r] += prediction.by_means[r][..., known.places] @ known.jacobian
        derivatives = self._padded(derivatives) * turn[:, :, None, None]
        columns = real_columns(np.pad(derivatives, ((0, 0), (0, 0), (0, self.V), (0, 0))))
        jacobian = [-white.apply(own) for white, own in zip(self.whiteners, columns, strict=True)]
        jacobian = [J - run.base @ (run.base.T @ J) for J, run in zip(jacobian, runs, strict=True)]
        return self._together(runs, jacobian, Y)

    def _padded(self, harmonics: np.ndarray) -> np.ndarray:
        """Return harmonics (R, K+1 or orders, ...) with nothing on the lines beside them, where there is none."""
        return np.pad(harmonics, ((0, 0), (0, self.orders - harmonics.shape[1]), *[(0, 0)] * (harmonics.ndim - 2)))

    def _together(self, runs: Sequence[_Profiled], jacobian: Sequence[np.ndarray], Y: np.ndarray) -> Evaluation:
        """Return the evaluation of runs that share the delay of their pulses; Y is turned by the best delay."""
        e, J = np.concatenate([run.residual for run in runs]), np.concatenate(jacobian)
        late = None
        if any(fit.stamp for fit in self.experiment.fits) and np.isfinite(e).all():
            own = zip(self.late, runs, strict=True)
            late = np.concatenate([part - run.base @ (run.base.T @ part) for part, run in own])
            size = float(late @ late)
            if size > 0:
                best = float(late @ e) / (1 + size)
                shrunk = (1 - 1 / np.sqrt(1 + size)) / size * late
                e, J = e - shrunk * (late @ e), J - np.outer(shrunk, late @ J)
                angle = best * np.array([abs(fit.speed) * fit.stamp for fit in self.experiment.fits])
                turn = np.zeros(Y.shape[:2])
                turn[:, : self.K + 1] = np.outer(angle, np.arange(self.K + 1))
                Y = Y * np.exp(1j * turn)[:, :, None]
        ends = np.cumsum([len(run.residual) for run in runs])[:-1]
        misfit = np.array([float(part @ part) for part in np.split(e, ends)])
        return Evaluation(e, J, misfit, Y, len(e) - sum(run.base.shape[1] for run in runs), late)

    @cached_property
    def late(self) -> list[np.ndarray]:
        """Whitened change of each run by the common delay of the pulses, one standard deviation."""
        pairs = zip(self.experiment.fits, self.experiment.columns, strict=True)
        stamped = [harmonics_of_time(fit.stamped[: self.K + 1, columns], fit.speed) for fit, columns in pairs]
        return self._white(self._padded(np.array(stamped)))

    def response(self, theta: np.ndarray) -> Response:
        """Return what the equations of a linear diagram say at theta (m,)."""
        return self.experiment.linear.condensed(theta)

    def expected(self, theta: np.ndarray) -> np.ndarray:
        """Return the derivatives (n, m) that runs of these settings would have if they were as the model says.

        Only the measured means stay: where slow states have not settled, they say how far they have come.
        """
        response = self.response(theta)
        self.data[:, 1:, : self.c] = response.outputs(response.states())[:, 1:]
        self.data_rows = self._white(self.data)
        return self.evaluate(theta).jacobian

    def white_at(self, r: int, order: int, values: np.ndarray) -> np.ndarray:
        """Return complex columns (c, m) at one order of run r, `whitened_at`; from K + 1 on lines beside."""
        columns = self.experiment.columns[r][: self.c]
        return whitened_at(self.experiment.fits[r], columns, self.K, order, values, self.experiment.resolution)

    def _turned(self, Y: np.ndarray) -> np.ndarray:
        """Return the factors (R, orders) that turn lines beside the harmonics to the phase at which they were met."""
        turn = np.ones(Y.shape[:2], complex)
        for r, white in enumerate(self.whiteners):
            if self.beside and Y[r, self.K + 1 :].any():
                lines = np.zeros((2, *self.data[r].shape), complex)
                lines[0, self.K + 1 :, : self.c] = Y[r, self.K + 1 :]
                lines[1] = 1j * lines[0]
                onto = white.apply(real_vector(lines).T).T @ self.data_rows[r]
                turn[r, self.K + 1 :] = np.exp(1j * np.arctan2(onto[1], onto[0]))
        return turn

    def nuisances(
        self, prediction: Prediction, r: int, Y: np.ndarray, known: Sequence[int] | np.ndarray = ()
    ) -> np.ndarray:
        """Return the whitened columns of the nuisances of run r at outputs Y (orders, c), see `_nuisances`."""
        return self.whiteners[r].apply(self._nuisances(prediction, r, Y, known))

    def _nuisances(
        self, prediction: Prediction, r: int, Y: np.ndarray, known: Sequence[int] | np.ndarray = ()
    ) -> np.ndarray:
        """Return the columns (all, j) of the nuisances of run r at outputs Y (orders, c).

        First the means of slow states but for the known ones, then inputs, order by order, real and imaginary part
        (the mean: real), then the phase of the lines beside the harmonics.
        """
        by_means = np.delete(prediction.by_means[r], list(known), axis=-1)
        columns = np.zeros((by_means.shape[-1], self.orders, self.c + self.V), complex)
        columns[:, : len(by_means), : self.c] = np.moveaxis(by_means, -1, 0)
        if self.V:
            orders, phases = np.arange(self.orders), np.array([1.0, 1j])
            effect = np.zeros((self.orders, self.V, 2, self.orders, self.c + self.V), complex)
            by_inputs = prediction.by_inputs()[r].transpose(0, 2, 1)
            effect[orders, :, :, orders, : self.c] = by_inputs[:, :, None] * phases[:, None]
            for v in range(self.V):
                effect[orders, v, :, orders, self.c + v] = phases
            columns = np.concatenate([columns, effect[0, :, 0], effect[1:].reshape(-1, *columns.shape[1:])])
        if self.beside and Y[self.K + 1 :].any():
            phase = np.zeros((1, *columns.shape[1:]), complex)
            phase[0, self.K + 1 :, : self.c] = 1j * Y[self.K + 1 :]
            columns = np.concatenate([columns, phase])
        return real_vector(columns).T if len(columns) else np.zeros(((2 * self.orders - 1) * (self.c + self.V), 0))

    def _profiled(
        self, prediction: Prediction, r: int, Y: np.ndarray, rows: np.ndarray, known: np.ndarray
    ) -> _Profiled:
        """Return run r without its nuisances, at outputs Y (orders, c), in rows (all,) with the inputs.

        known: slow states whose means are given.
        """
        means, inputs = np.zeros(prediction.by_means[r].shape[-1]), np.zeros((self.orders, self.V), complex)
        columns = np.column_stack([rows, self._nuisances(prediction, r, Y, known)])
        whitened = self.whiteners[r].apply(columns)
        e, columns = self.data_rows[r] - whitened[:, 0], whitened[:, 1:]
        if not columns.shape[1] or not prediction.settled[r]:
            return _Profiled(e, np.zeros((len(e), 0)), means, inputs, np.zeros(0))
        base, best = _best_factors(columns, e)
        free = np.setdiff1d(np.arange(len(means)), known)
        means[free] = best[: len(free)]
        if self.V:
            rest = best[len(free) :]
            pairs = rest[self.V :][: 2 * self.V * (self.orders - 1)].reshape(-1, self.V, 2)
            inputs[0], inputs[1:] = rest[: self.V], pairs[..., 0] + 1j * pairs[..., 1]
        gain = base.T @ e
        return _Profiled(e - base @ gain, base, means, inputs, gain)


def _best_factors(columns: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal base of columns and their best factors; columns that are zero have none."""
    size = np.linalg.norm(columns, axis=0)
    used = size > 0
    base, triangle = np.linalg.qr(columns[:, used] / size[used])
    best = np.zeros(columns.shape[1])
    best[used] = np.linalg.solve(triangle, base.T @ e) / size[used]
    return base, best
