"""The likelihood of measured harmonics: errors in all measured signals, nuisances profiled out, exact slopes.

minus twice the logarithm = |r|^2,  r = P W (y - y(theta)):  W whitens with the covariance of the harmonics,
P projects out what is of no interest and enters linearly: the mean of slow states, and the true harmonics of
signals that are taken as measured inputs (so that their noise does not bias the parameters). A delay that all pulses
share, of standard deviation s, is marginalised: with the columns g = s P W dy/dtau of all runs, the covariance
I + g g^T of P W y has the inverse root I - g g^T / |g|^2 (1 - 1 / sqrt(1 + |g|^2)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from rotorsim.identification.experiment import Experiment
from rotorsim.settled.linear_motion import Motion, PortMotion, Response, condensed
from rotorsim.signals.covariance import real_columns, real_vector, scaled_cholesky
from rotorsim.signals.harmonic_fit import HarmonicFit

__all__ = ["Evaluation", "Likelihood", "fitted_columns", "harmonics_of_time"]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Whitened residual r (n,), slopes dr/dtheta (n, m), and the misfit |r|^2 of every run (R,).

    Y: predicted harmonics (R, K+1, c) with the nuisances at their best. rows: number of real equations left
    after the nuisances. late: (n,) whitened change by the common delay of the pulses, one standard deviation.
    """

    residual: np.ndarray
    slopes: np.ndarray
    misfit: np.ndarray
    Y: np.ndarray
    rows: int
    late: np.ndarray | None = None

    def apart(self) -> tuple[np.ndarray, np.ndarray]:
        """Return residual and slopes of each run by itself, as they are for a known delay of the pulses."""
        if self.late is None or not self.late.any():
            return self.residual, self.slopes
        size = float(self.late @ self.late)
        grown = (np.sqrt(1 + size) - 1) / size * self.late
        return (
            self.residual + grown * (self.late @ self.residual),
            self.slopes + np.outer(grown, self.late @ self.slopes),
        )


class Likelihood:
    """Whitened residuals of an experiment: in units of their standard deviation."""

    absolute = True

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self._motion: Motion | PortMotion | None = None
        self.K = experiment.motion.K
        self.beside = len(experiment.beside_orders)
        self.orders = self.K + 1 + self.beside
        self.c, self.V = len(experiment.predicted), len(experiment.given)
        self.data = np.array(
            [
                np.concatenate(
                    [
                        harmonics_of_time(item.fit.values[: self.K + 1, columns], item.fit.speed),
                        *([item.fit.beside.values[:, columns]] if self.beside and item.fit.beside is not None else []),
                    ]
                )
                for item, columns in zip(experiment.runs, experiment.columns, strict=True)
            ]
        )
        keep = np.ones((2 * self.orders - 1, self.c + self.V), bool)
        keep[0] = experiment.use_mean
        self.keep = np.flatnonzero(keep.ravel())
        self.is_beside = self.keep >= (2 * self.K + 1) * (self.c + self.V)  # which rows of a run are of such lines
        self.whiteners = [self._whitener(r) for r in range(len(experiment.runs))]
        self.data_rows = [self.whiteners[r].apply(real_vector(self.data[r])) for r in range(len(self.data))]

    def _whitener(self, r: int) -> _Whitener:
        fit, columns = self.experiment.runs[r].fit, self.experiment.columns[r]
        return _Whitener(
            _inverse_root(
                fit,
                tuple(columns.tolist()),
                self.K,
                tuple(self.keep.tolist()),
                self.experiment.resolution,
                self.beside > 0,
            ),
            self.keep,
        )

    def rough(self) -> Likelihood:
        """Return the likelihood by fewer steps where it takes several, good enough to compare starts."""
        return self

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Return the whitened residual and its slopes at theta (m,)."""
        response = self.response(theta)
        given = self.data[:, :, self.c :]
        X = response.states(given)
        Y = response.outputs(X, given)
        turn = self._turned(Y)
        Y = Y * turn[:, :, None]
        blocks = [self.nuisances(response, r, Y[r]) for r in range(len(self.data))]
        inputs = given.copy()
        residuals = []
        spanned: dict[int, np.ndarray] = {}
        predicted = real_vector(np.concatenate([Y, given], axis=2))
        for r, (white, raw) in enumerate(blocks):
            e = self.data_rows[r] - self.whiteners[r].apply(predicted[r])
            if white.shape[1]:
                q, best = fitted_columns(white, e)
                X[r], inputs[r] = self._moved(response, r, raw, best, X[r], given[r])
                e = e - q @ (q.T @ e)
                spanned[r] = q
            residuals.append(e)
        if any(raw.size or self.V for _, raw in blocks):
            Y = response.outputs(X, inputs) * turn[:, :, None]
        slopes = response.sensitivity(X, inputs if self.V else None) * turn[:, :, None, None]
        slopes = real_columns(np.pad(slopes, ((0, 0), (0, 0), (0, self.V), (0, 0))) if self.V else slopes)
        rows = []
        counted = 0
        for r in range(len(blocks)):
            j = -self.whiteners[r].apply(slopes[r])
            if r in spanned:
                j = j - spanned[r] @ (spanned[r].T @ j)
                counted -= spanned[r].shape[1]
            rows.append(j)
            counted += len(j)
        return self.together(residuals, rows, spanned, Y, counted)

    def together(
        self,
        residuals: Sequence[np.ndarray],
        slopes: Sequence[np.ndarray],
        spanned: Mapping[int, np.ndarray],
        Y: np.ndarray,
        rows: int,
    ) -> Evaluation:
        """Return the evaluation of runs that share the delay of their pulses.

        residuals, slopes: of each run, what its own nuisances explain, the columns of spanned (n_r, j), taken off. Y is
        turned by the best delay.
        """
        e, J = np.concatenate(residuals), np.concatenate(slopes)
        late = None
        if any(item.fit.stamp for item in self.experiment.runs) and np.isfinite(e).all():
            parts = list(self.late)
            for r, q in spanned.items():
                parts[r] = parts[r] - q @ (q.T @ parts[r])
            late = np.concatenate(parts)
            size = float(late @ late)
            if size > 0:
                best = float(late @ e) / (1 + size)
                shrunk = (1 - 1 / np.sqrt(1 + size)) / size * late
                e, J = e - shrunk * (late @ e), J - np.outer(shrunk, late @ J)
                angle = best * np.array([abs(item.fit.speed) * item.fit.stamp for item in self.experiment.runs])
                turn = np.zeros(Y.shape[:2])
                turn[:, : self.K + 1] = np.outer(angle, np.arange(self.K + 1))
                Y = Y * np.exp(1j * turn)[:, :, None]
        ends = np.cumsum([len(part) for part in residuals])[:-1]
        misfit = np.array([float(part @ part) for part in np.split(e, ends)])
        return Evaluation(e, J, misfit, Y, rows, late)

    @cached_property
    def late(self) -> list[np.ndarray]:
        """Whitened change of each run by the common delay of the pulses, one standard deviation."""
        found = []
        for r, (item, columns) in enumerate(zip(self.experiment.runs, self.experiment.columns, strict=True)):
            change = np.zeros((self.orders, self.c + self.V), complex)
            change[: self.K + 1] = harmonics_of_time(item.fit.stamped[: self.K + 1, columns], item.fit.speed)
            found.append(self.whiteners[r].apply(real_vector(change)))
        return found

    def response(self, theta: np.ndarray) -> Response:
        """Return what the equations say at theta (m,)."""
        if self._motion is None:
            self._motion = condensed(self.experiment.linear, theta)
        return self._motion.response(theta)

    def expected(self, theta: np.ndarray) -> np.ndarray:
        """Return the slopes (n, m) that runs of these settings would have if they were as the model says.

        Only the measured means stay: where slow states have not settled, they say how far they have come.
        """
        response = self.response(theta)
        self.data[:, 1:, : self.c] = response.outputs(response.states())[:, 1:]
        self.data_rows = [self.whiteners[r].apply(real_vector(self.data[r])) for r in range(len(self.data))]
        return self.evaluate(theta).slopes

    def white_at(self, r: int, order: int, values: np.ndarray) -> np.ndarray:
        """Return complex columns (c, m) at one order of run r as whitened real rows (2 c, m), other orders ignored.

        order: from K + 1 on the lines beside the harmonics.
        """
        fit, columns = self.experiment.runs[r].fit, self.experiment.columns[r][: self.c]
        if order > self.K:
            part = slice(2 * self.c * (order - self.K - 1), 2 * self.c * (order - self.K))
            covariance = fit.covariance_beside(columns, self.experiment.resolution)[part, part]
        else:
            covariance = fit.covariance_at(columns, [order], self.experiment.resolution)
        scale, factor = scaled_cholesky(covariance)
        return np.asarray(
            solve_triangular(factor, np.concatenate([values.real, values.imag]) / scale[:, None], lower=True)
        )

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

    def nuisances(self, response: Response, r: int, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the whitened columns of the nuisances of one run at outputs Y, and dX_0 by the slow states (n, s)."""
        slow = response.slow_states(r)
        orders, width = self.orders, self.c + self.V
        columns = []
        for k in range(slow.shape[1]):
            effect = np.zeros((orders, width), complex)
            effect[0, : self.c] = response.C[r] @ slow[:, k]
            columns.append(real_vector(effect))
        if self.V:
            transfer = response.transfer()[r]
            for k in range(orders):
                for v in range(self.V):
                    for part in (1.0, 1j) if k else (1.0,):
                        effect = np.zeros((orders, width), complex)
                        effect[k, : self.c] = transfer[k, :, v] * part
                        effect[k, self.c + v] = part
                        columns.append(real_vector(effect))
        if self.beside and Y[self.K + 1 :].any():
            effect = np.zeros((orders, width), complex)
            effect[self.K + 1 :, : self.c] = 1j * Y[self.K + 1 :]
            columns.append(real_vector(effect))
        if not columns:
            return np.zeros((len(self.keep), 0)), slow
        return self.whiteners[r].apply(np.array(columns).T), slow

    def _moved(
        self, response: Response, r: int, slow: np.ndarray, best: np.ndarray, X: np.ndarray, given: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return states and inputs of one run with the nuisances at their best values."""
        s = slow.shape[1]
        X = X.copy()
        X[0] += slow @ best[:s]
        inputs = given.copy()
        if self.V:
            change = np.zeros_like(given)
            rest = best[s:]
            change[0] = rest[: self.V]
            pairs = rest[self.V :].reshape(self.K, self.V, 2)
            change[1:] = pairs[..., 0] + 1j * pairs[..., 1]
            inputs = given + change
            X = X + response.resolvent.apply_to_run(r, change @ response.B[r].T)
        return X, inputs


def fitted_columns(columns: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal base of columns and their best factors; columns that are zero have none."""
    size = np.linalg.norm(columns, axis=0)
    used = size > 0
    unit = columns[:, used] / size[used]
    q, triangle = (unit, np.eye(1)) if unit.shape[1] == 1 else np.linalg.qr(unit)
    best = np.zeros(columns.shape[1])
    best[used] = np.linalg.solve(triangle, q.T @ e) / size[used]
    return q, best


@lru_cache(maxsize=64)
def _inverse_root(
    fit: HarmonicFit, columns: tuple[int, ...], K: int, keep: tuple[int, ...], resolution: float, beside: bool
) -> np.ndarray:
    """Return the inverse of the Cholesky factor of the covariance of kept rows, as harmonics of time have them."""
    kept = np.array(keep)
    covariance = fit.covariance_at(np.array(columns), range(K + 1), resolution, stamp=False)
    if fit.speed < 0:
        sign = np.ones((2 * K + 1, len(columns)))
        sign[2::2] = -1
        covariance = covariance * np.outer(sign.ravel(), sign.ravel())
    if beside:
        covariance = block_diag(covariance, fit.covariance_beside(np.array(columns), resolution))
    covariance = covariance[np.ix_(kept, kept)]
    scale, factor = scaled_cholesky(covariance)
    return np.asarray(solve_triangular(factor, np.diag(1 / scale), lower=True))


class _Whitener:
    """Applies the inverse of the Cholesky factor of a covariance to kept rows."""

    def __init__(self, matrix: np.ndarray, keep: np.ndarray) -> None:
        self.matrix, self.keep = matrix, keep

    def apply(self, rows: np.ndarray) -> np.ndarray:
        """Return whitened rows of a vector (all,) or of columns (all, j)."""
        return np.asarray(self.matrix @ rows[self.keep])


def harmonics_of_time(values: np.ndarray, speed: float) -> np.ndarray:
    """Return harmonics of time, from harmonics of the angle: a shaft that turns back counts them the other way."""
    return values if speed > 0 else values.conj()
