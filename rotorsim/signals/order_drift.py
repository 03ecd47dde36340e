"""How the vector of 1X drifts within the runs of a recording: a shaft that warms up, a part that works loose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from rotorsim.recordings.recording import Recording
from rotorsim.settled.growing import DEGREES
from rotorsim.signals.covariance import complex_values
from rotorsim.signals.harmonic_basis import Basis, harmonic_basis, wave_columns
from rotorsim.signals.harmonic_fit import FIT_ROUNDING
from rotorsim.signals.harmonics import RunHarmonics, samples_of
from rotorsim.signals.noise.noise import Noise, noise_of

KEPT_POWER = 0.9  # of a column that harmonics leave: the variance of those beside it grows by a ninth at most
LOUDER = 2.0  # variance of noise with a drift in it: five standard deviations of a spectrum averaged over 24 lines
LOOSE_ANGLE = 1.0  # rad: turning all channels alike, as a wrong angle does, is no drift of theirs


@dataclass(frozen=True, eq=False)
class OrderDrift:
    """The drift of 1X of the channels of one run: y_c = ... + 2 Re (sum over n of values[n-1, c] P_n(u)) e^{i theta}.

    u: from -1 to 1 over the run. values (DEGREES, C) [SI], complex. gram (DEGREES,): variance of the real and of the
    imaginary part for noise of variance one. leaked (K+1, C): what it adds to harmonics that are fitted without it.
    noise: beside the drift, of runs where the noise of their harmonics has it in it. told: False in runs of so few
    turns that it is not known: then it is zero.
    """

    values: np.ndarray
    gram: np.ndarray
    leaked: np.ndarray
    noise: Noise | None = None
    told: bool = True

    def covariance(self, item: RunHarmonics, columns: np.ndarray, degree: int, resolution: float) -> np.ndarray:
        """Return the covariance (2 c, 2 c) of real and imaginary parts of one degree in some channels of the run.

        That of 1X, in the ratio of their variances for white noise. resolution: see `HarmonicFit.covariance_at`.
        """
        fit = item.fit if self.noise is None else replace(item.fit, noise=self.noise)
        ratio = self.gram[degree - 1] / np.diag(fit.gram)[1:3].mean() / (1 - item.lost / len(item.run.time))
        first = 1j * LOOSE_ANGLE * fit.values[1, columns]
        turned = np.concatenate([first.real, first.imag])
        return np.asarray(ratio * fit.covariance_at(columns, [1], resolution) + np.outer(turned, turned))


@lru_cache(maxsize=64)
def drift_of_order(item: RunHarmonics, recording: Recording) -> OrderDrift:
    """Return the drift of 1X within a run, by least squares beside its harmonics."""
    samples = samples_of(recording, item.run, item.angle, item.lost)
    y = np.column_stack(list(samples.signals.values()))
    basis = harmonic_basis(samples.run, samples.time, samples.theta, orders=int(item.fit.orders[-1]))
    lines = [line.frequency for line in item.fit.lines]
    basis = basis.with_lines(samples.time, [*item.fit.pickups, *lines])
    if item.fit.beside is not None:
        told = item.fit.beside.orders[item.fit.beside.told]
        basis = basis.with_waves(int(k) * samples.theta + item.fit.beside.second * samples.time for k in told)
    u = 2 * (samples.time - samples.time[0]) / (samples.time[-1] - samples.time[0]) - 1
    if lines:  # their frequencies are read off spectra: what they err by is a slow change of the line
        slow = [u[:, None] * wave_columns(2 * np.pi * frequency * samples.time) for frequency in lines]
        basis = replace(basis, columns=np.column_stack([basis.columns, *slow]))
    wave = wave_columns(samples.theta)
    legendre = np.polynomial.legendre.legvander(u, DEGREES)[:, 1:]
    waves = np.column_stack([wave * p[:, None] for p in legendre.T])
    taken, columns = basis.solve(waves)
    products = columns.T @ columns
    if (np.diag(products) < KEPT_POWER * np.einsum("ij,ij->j", waves, waves)).any():
        none = np.zeros((DEGREES, y.shape[1]), complex)
        return OrderDrift(none, np.ones(DEGREES), np.zeros_like(item.fit.values), told=False)
    inverse = np.linalg.inv(products)
    left = basis.solve(y)[1]
    found = inverse @ (columns.T @ left)
    leaked = complex_values((taken @ found)[: 2 * basis.orders + 1].ravel(), y.shape[1])
    wider = replace(basis, columns=np.column_stack([basis.columns, waves]))
    noise = _noise(item, samples.time, wider.solve(y)[1], wider)
    about = [np.diag(one.at_order(1)).real for one in (item.fit.noise, noise)]
    quieter = noise if (about[0] > LOUDER * about[1]).any() else None
    gram = np.diag(inverse).reshape(-1, 2).mean(axis=1)
    return OrderDrift(found[::2] + 1j * found[1::2], gram, leaked, quieter)


def _noise(item: RunHarmonics, time: np.ndarray, left: np.ndarray, basis: Basis) -> Noise:
    """Return the noise in what a fit to some columns leaves of a run, (n, C)."""
    fit, freedom = item.fit, len(left) - basis.columns.shape[1]
    floor = FIT_ROUNDING * np.where(fit.rms > 0, fit.rms, 1.0)
    return noise_of(left, time, fit.speed, basis.orders, freedom, floor, fit.lines, basis.kept)
