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
from rotorsim.identification.harmonic.experiment import Experiment
from rotorsim.identification.harmonic.whitening import harmonics_of_time, whitened_at, whitener_of
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
    """Whitened residuals of all runs without their nuisances (R, n), an orthonormal base of these (R, n, j).

    count: of the columns of the bases that are not zero. means, inputs (R, orders, V): the best changes of both; gain
    (R, j): the part of the residuals along the base.
    """

    residual: np.ndarray
    base: np.ndarray
    count: int
    means: list[np.ndarray]
    inputs: np.ndarray
    gain: np.ndarray

    def without(self, columns: np.ndarray) -> np.ndarray:
        """Return whitened columns (R, n, m) without what the nuisances take up."""
        return np.asarray(columns - self.base @ (self.base.swapaxes(1, 2) @ columns))


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
            whitener_of(fit, columns, self.K, self.keep, beside=self.beside > 0)
            for fit, columns in zip(experiment.fits, experiment.columns, strict=True)
        ]
        self.data_rows = self.white(real_columns(self.data[..., None]))[..., 0]
        self._means: list[np.ndarray] | None = None

    @property
    def sizes(self) -> list[int]:
        """The number of real equations of each run."""
        return [len(white.keep) for white in self.whiteners]

    def white(self, columns: np.ndarray) -> np.ndarray:
        """Return real columns (R, all, j) of each run whitened, (R, n, j)."""
        kept = columns[:, self.keep]
        used = np.flatnonzero(kept.any(axis=(0, 2)))
        last = int(used[-1]) + 1 if len(used) else 0  # means of states move the lowest order alone
        pairs = zip(self.whiteners, kept[:, :last], strict=True)
        return np.array([white.apply_kept(own) for white, own in pairs])

    def rough(self) -> Likelihood:
        """Return the likelihood with slow means by linear theory where it takes several steps: to compare starts."""
        if self.experiment.motion.is_linear:
            return self
        other = copy(self)
        other.rounds = 1
        return other

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Return the whitened residual and its derivatives at theta (m,)."""
        return self.evaluated(theta)[0]

    def evaluated(self, theta: np.ndarray) -> tuple[Evaluation, Prediction]:
        """Return the whitened residual and its derivatives at theta (m,), and the motion with the best means."""
        motion = self.experiment.motion
        tolerance = 0.0 if motion.is_linear else SLOW_MEAN_TOLERANCE
        fresh = motion.fresh_means(theta)
        means = [known.start(own) for known, own in zip(fresh, self._means or itertools.repeat(None), strict=False)]
        inputs = self.data[:, :, self.c :]
        for _ in range(self.rounds):
            prediction = self.predict(theta, means, inputs)
            Y = self._padded(prediction.Y)
            turn = self._turned(Y)
            Y = Y * turn[:, :, None]
            runs = self._profiled(prediction, Y, inputs, [known.places for known in fresh])
            gain, left = (np.linalg.norm(part, axis=1) for part in (runs.gain, runs.residual))
            if (gain <= tolerance * left).all() or not prediction.settled.all():
                break
            means = [own + change for own, change in zip(means, runs.means, strict=True)]
            inputs = inputs + runs.inputs
        if self._shifts:
            prediction = self.predict(theta, runs.means)
            Y = self._padded(prediction.Y) * turn[:, :, None]
        elif prediction.settled.all():
            self._means = means
        derivatives = prediction.sensitivity()
        for r, known in enumerate(fresh):
            if len(known.places):
                derivatives[r] += prediction.by_means[r][..., known.places] @ known.jacobian
        derivatives = self._padded(derivatives) * turn[:, :, None, None]
        if self.V:
            derivatives = np.pad(derivatives, ((0, 0), (0, 0), (0, self.V), (0, 0)))
        return self._together(runs, runs.without(-self.white(real_columns(derivatives))), Y), prediction

    def predict(self, theta: np.ndarray, means: Sequence[np.ndarray], inputs: np.ndarray | None = None) -> Prediction:
        """Return the motion at theta (m,) with slow states at given means."""
        return self.experiment.motion.predict(theta, means, inputs)

    def _padded(self, harmonics: np.ndarray) -> np.ndarray:
        """Return harmonics (R, K+1 or orders, ...) with nothing on the lines beside them, where there is none."""
        if harmonics.shape[1] == self.orders:
            return harmonics
        return np.pad(harmonics, ((0, 0), (0, self.orders - harmonics.shape[1]), *[(0, 0)] * (harmonics.ndim - 2)))

    def _together(self, runs: _Profiled, jacobian: np.ndarray, Y: np.ndarray) -> Evaluation:
        """Return the evaluation of runs that share the delay of their pulses; Y is turned by the best delay."""
        e, J = runs.residual.ravel(), jacobian.reshape(-1, jacobian.shape[2])
        late = None
        if any(fit.stamp for fit in self.experiment.fits) and np.isfinite(e).all():
            late = runs.without(self.late[..., None]).ravel()
            size = float(late @ late)
            if size > 0:
                best = float(late @ e) / (1 + size)
                shrunk = (1 - 1 / np.sqrt(1 + size)) / size * late
                e, J = e - shrunk * (late @ e), J - np.outer(shrunk, late @ J)
                angle = best * np.array([abs(fit.speed) * fit.stamp for fit in self.experiment.fits])
                turn = np.zeros(Y.shape[:2])
                turn[:, : self.K + 1] = np.outer(angle, np.arange(self.K + 1))
                Y = Y * np.exp(1j * turn)[:, :, None]
        misfit = (e.reshape(len(Y), -1) ** 2).sum(axis=1)
        return Evaluation(e, J, misfit, Y, len(e) - runs.count, late)

    @cached_property
    def late(self) -> np.ndarray:
        """Whitened change of each run by the common delay of the pulses, one standard deviation, (R, n)."""
        pairs = zip(self.experiment.fits, self.experiment.columns, strict=True)
        stamped = [harmonics_of_time(fit.stamped[: self.K + 1, columns], fit.speed) for fit, columns in pairs]
        return self.white(real_columns(self._padded(np.array(stamped))[..., None]))[..., 0]

    def response(self, theta: np.ndarray) -> Response:
        """Return what the equations of a linear diagram say at theta (m,)."""
        return self.experiment.linear.condensed(theta)

    def expected(self, theta: np.ndarray) -> np.ndarray:
        """Return the derivatives (n, m) that runs of these settings would have if they were as the model says.

        Only the measured means stay: where slow states have not settled, they say how far they have come.
        """
        response = self.response(theta)
        self.data[:, 1:, : self.c] = response.outputs(response.states())[:, 1:]
        self.data_rows = self.white(real_columns(self.data[..., None]))[..., 0]
        return self.evaluate(theta).jacobian

    def white_at(self, r: int, order: int, values: np.ndarray) -> np.ndarray:
        """Return complex columns (c, m) at one order of run r, `whitened_at`; from K + 1 on lines beside."""
        columns = self.experiment.columns[r][: self.c]
        return whitened_at(self.experiment.fits[r], columns, self.K, order, values)

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

    def nuisances(self, prediction: Prediction, Y: np.ndarray) -> np.ndarray:
        """Return the whitened columns (R, n, j) of the nuisances at outputs Y (R, orders, c), zero where there is none.

        See `_nuisances`.
        """
        return self.white(self._nuisances(prediction, Y))

    def _nuisances(self, prediction: Prediction, Y: np.ndarray, known: Sequence[np.ndarray] = ()) -> np.ndarray:
        """Return the columns (R, all, j) of the nuisances at outputs Y (R, orders, c), zero where there is none.

        First the means of slow states but for the known ones of each run, then inputs, order by order, real and
        imaginary part (the mean: real), then the phase of the lines beside the harmonics.
        """
        R, most = len(Y), max(own.shape[-1] for own in prediction.by_means)
        columns = np.zeros((R, self.orders, self.c + self.V, most), complex)
        for r, own in enumerate(prediction.by_means):
            columns[r, : len(own), : self.c, : own.shape[-1]] = own
        for r, places in enumerate(known):
            columns[r, ..., places] = 0.0
        if self.V:
            orders, phases = np.arange(self.orders), np.array([1.0, 1j])
            effect = np.zeros((R, self.orders, self.c + self.V, self.orders, self.V, 2), complex)
            by_inputs = prediction.by_inputs().swapaxes(0, 1)
            effect[:, orders, : self.c, orders] = by_inputs[..., None] * phases
            for v in range(self.V):
                effect[:, orders, self.c + v, orders, v] = phases
            shape = (*columns.shape[:3], -1)
            columns = np.concatenate([columns, effect[..., 0, :, 0], effect[..., 1:, :, :].reshape(shape)], axis=3)
        if self.beside and Y[:, self.K + 1 :].any():
            phase = np.zeros((*columns.shape[:3], 1), complex)
            phase[:, self.K + 1 :, : self.c, 0] = 1j * Y[:, self.K + 1 :]
            columns = np.concatenate([columns, phase], axis=3)
        return real_columns(columns)

    def _profiled(
        self, prediction: Prediction, Y: np.ndarray, inputs: np.ndarray, known: Sequence[np.ndarray]
    ) -> _Profiled:
        """Return all runs without their nuisances, at outputs Y (R, orders, c) and inputs (R, orders, V).

        known: of each run, slow states whose means are given.
        """
        rows = real_columns(np.concatenate([Y, inputs], axis=2)[..., None])
        e = self.data_rows - self.white(rows)[..., 0]
        columns = self.white(self._nuisances(prediction, Y, known))
        columns[~prediction.settled] = 0.0
        base, count, gain, best = _best_factors(columns, e)
        widths = [own.shape[-1] for own in prediction.by_means]
        change = np.zeros_like(inputs)
        if self.V:
            rest = best[:, max(widths) :]
            change[:, 0] = rest[:, : self.V]
            pairs = rest[:, self.V :][:, : 2 * self.V * (self.orders - 1)].reshape(len(Y), -1, self.V, 2)
            change[:, 1:] = pairs[..., 0] + 1j * pairs[..., 1]
        means = [own[:width] for own, width in zip(best, widths, strict=True)]
        return _Profiled(e - (base @ gain[..., None])[..., 0], base, count, means, change, gain)


def _best_factors(columns: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, int, np.ndarray, np.ndarray]:
    """Return orthonormal bases of columns (R, n, j), how many columns they have in all, e (R, n) along them, factors.

    Columns that are zero have zero bases, and zero factors (R, j).
    """
    size = np.linalg.norm(columns, axis=1)
    used = size > 0
    last = np.argsort(~used, axis=1, kind="stable")[:, None]  # those that are zero: the others are a base of their own
    used, scale = (np.take_along_axis(part[:, None], last, 2) for part in (used, np.where(used, size, 1.0)))
    base, triangle = np.linalg.qr(np.take_along_axis(columns, last, 2) / scale)
    base = base * used
    gain = (base.swapaxes(1, 2) @ e[..., None])[..., 0]
    factors = np.linalg.solve(triangle + np.eye(size.shape[1]) * ~used, gain[..., None])[..., 0] / scale[:, 0]
    best = np.zeros_like(size)
    np.put_along_axis(best, last[:, 0], np.where(used[:, 0], factors, 0.0), 1)
    return base, int(used.sum()), gain, best
