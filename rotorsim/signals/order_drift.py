"""How the vector of 1X drifts within the runs of a recording: a shaft that warms up, a part that works loose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from rotorsim.recordings.recording import Recording
from rotorsim.signals.covariance import complex_values, real_form
from rotorsim.signals.harmonic_basis import harmonic_basis, wave_columns
from rotorsim.signals.harmonics import RunHarmonics, samples_of

DEGREES = 2  # of Legendre polynomials: a drift and its bend
LOOSE_ANGLE = 1.0  # rad: turning all channels alike, as a wrong angle does, is no drift of theirs


@dataclass(frozen=True, eq=False)
class OrderDrift:
    """The drift of 1X of the channels of one run: y_c = ... + 2 Re (sum over n of values[n-1, c] P_n(u)) e^{i theta}.

    u: from -1 to 1 over the run. values (DEGREES, C) [SI], complex. gram (DEGREES,): variance of the real and of the
    imaginary part for noise of variance one. leaked (K+1, C): what it adds to harmonics that are fitted without it.
    """

    values: np.ndarray
    gram: np.ndarray
    leaked: np.ndarray

    def covariance(self, item: RunHarmonics, columns: np.ndarray, degree: int, resolution: float) -> np.ndarray:
        """Return the covariance (2 c, 2 c) of real and imaginary parts of one degree in some channels of the run.

        resolution: of the measuring chain, as a share of a channel's rms.
        """
        fit = item.fit
        size = np.where(fit.rms[columns] > 0, fit.rms[columns], 1.0)
        noise = self.gram[degree - 1] * fit.noise.at_order(1)[np.ix_(columns, columns)]
        first = 1j * LOOSE_ANGLE * fit.values[1, columns]
        turned = np.concatenate([first.real, first.imag])
        return np.asarray(real_form(noise) + np.diag(np.tile((resolution * size) ** 2, 2)) + np.outer(turned, turned))


@lru_cache(maxsize=64)
def drift_of_order(item: RunHarmonics, recording: Recording) -> OrderDrift:
    """Return the drift of 1X within a run, by least squares beside its harmonics."""
    samples = samples_of(recording, item.run, item.angle, item.lost)
    y = np.column_stack(list(samples.signals.values()))
    basis = harmonic_basis(samples.run, samples.time, samples.theta, orders=int(item.fit.orders[-1]))
    u = 2 * (samples.time - samples.time[0]) / (samples.time[-1] - samples.time[0]) - 1
    wave = wave_columns(samples.theta)
    legendre = np.polynomial.legendre.legvander(u, DEGREES)[:, 1:]
    taken, columns = basis.solve(np.column_stack([wave * p[:, None] for p in legendre.T]))
    inverse = np.linalg.inv(columns.T @ columns)
    found = inverse @ (columns.T @ basis.solve(y)[1])
    leaked = complex_values((taken @ found)[: 2 * basis.orders + 1].ravel(), y.shape[1])
    return OrderDrift(found[::2] + 1j * found[1::2], np.diag(inverse).reshape(-1, 2).mean(axis=1), leaked)
