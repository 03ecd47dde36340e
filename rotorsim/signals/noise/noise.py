"""Noise of a harmonic fit: the cross-spectrum of its residual, white, coloured or of an autoregression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import tau

import numpy as np

from rotorsim.signals.noise.colour import Bands, bands_of, colour_of, density, variance_of_mean
from rotorsim.signals.noise.lines import LEAST_KEPT, Line
from rotorsim.signals.noise.whitening import has_one_covariance, is_white

MOST_LAGS = 8  # of an autoregression
SMOOTHING = 12  # lines on each side over which a coloured spectrum is averaged, at least


@dataclass(frozen=True, eq=False)
class Noise:
    """Cross-spectrum of the noise at the harmonics: spectrum (K+1, C, C), or (1, C, C) where it is white.

    Scaled so that white noise of covariance S has spectrum S. freedom: degrees of freedom it was estimated with.
    colour: (C, 3) of the density that grows towards low frequencies (see `rotorsim.signals.noise.colour.density`), of
    noise that is not white. bands: where noise is white or so coloured, what that was estimated from, else None.
    """

    spectrum: np.ndarray
    white: bool
    freedom: float
    colour: np.ndarray | None = None
    bands: Bands | None = None

    def at_order(self, k: int) -> np.ndarray:
        """Return the cross-spectrum (C, C), Hermitian, at order k."""
        return np.asarray(self.spectrum[0 if self.white else k])

    def bands_of(self, channel: int) -> Bands | None:
        """Return the bands (B, 1) of one channel."""
        return None if self.bands is None else replace(self.bands, power=self.bands.power[:, [channel]])

    def colours(self) -> np.ndarray:
        """Return the densities (C, 3), `rotorsim.signals.noise.colour.density`; of noise without colour, white ones."""
        white = np.diag(self.spectrum[0].real)
        return np.column_stack([white, 0 * white, 0 * white + 1]) if self.colour is None else self.colour

    def of_drift(self, degree: int) -> np.ndarray:
        """Return n times the variance (C,) of a Legendre coefficient of n samples; degree 0: of their mean."""
        white = np.diag(self.at_order(0)).real
        if self.colour is not None:
            mean = variance_of_mean(self.colour)
            white = white * np.divide(
                variance_of_mean(self.colour, degree), mean, out=np.ones(len(white)), where=mean > 0
            )
        return np.asarray((2 * degree + 1) * white)

    def recoloured(self, colour: np.ndarray, turns: float, K: int) -> Noise:
        """Return noise of other densities a + b j^-c (C, 3), of a run of so many turns, that is correlated alike."""
        old = np.diag(self.spectrum[0].real)[None] if self.colour is None else _at_orders(self.colour, turns, K)
        scale = np.sqrt(np.divide(_at_orders(colour, turns, K), old, out=np.ones((K + 1, len(colour))), where=old > 0))
        return replace(self, spectrum=self.spectrum * scale[:, :, None] * scale[:, None, :], white=False, colour=colour)


def _at_orders(colour: np.ndarray, turns: float, K: int) -> np.ndarray:
    """Return the density (K+1, C) at orders 0..K of a run of so many turns."""
    return np.vstack([variance_of_mean(colour), density(colour, turns * np.arange(1, K + 1))])


def noise_of(
    left: np.ndarray,
    time: np.ndarray,
    speed: float,
    K: int,
    freedom: int,
    floor: np.ndarray,
    lines: Sequence[Line],
    kept: np.ndarray | None = None,
) -> Noise:
    """Return the noise in a residual (n, C) with the given degrees of freedom, at orders 0..K of the speed.

    White noise is one covariance. Coloured noise is white and flicker noise in each channel, or an autoregression of
    low order, whichever is more likely of those whose innovations are white; else its spectrum is averaged over lines
    about each order, asynchronous lines left out. floor: (C,) standard deviation never undercut (rounding of the data).
    kept: share of white noise that the fit leaves of each line of the spectrum, (n // 2 + 1,).
    """
    n, channels = left.shape
    at_least, freedom = np.diag(floor**2), max(freedom, 1)
    kept = np.full(n // 2 + 1, freedom / n) if kept is None else kept
    transform = np.fft.rfft(left, axis=0) / np.sqrt(n * np.maximum(kept, LEAST_KEPT))[:, None]
    step = (time[-1] - time[0]) / (n - 1)
    usable = kept > LEAST_KEPT
    usable[[0, -1]] = False
    for line in lines:
        at = round(line.frequency * n * step)
        usable[max(0, at - 2) : at + 3] = False
    inner, at_line = transform[usable], np.arange(len(transform))
    power = np.abs(inner) ** 2
    few = len(inner) < 8
    colour = np.zeros((channels, 3)) if few else colour_of(power, at_line[usable])
    bands = None if few else bands_of(power, at_line[usable], n * step, colour)
    if few or (is_white(power) and has_one_covariance(inner)):
        return Noise((left.T @ left / freedom + at_least)[None], True, float(freedom), bands=bands)
    spacing = abs(speed) / tau * n * step
    orders, shape = np.sqrt(_at_orders(colour, spacing, K)), np.sqrt(density(colour, at_line))
    alive = shape[-1] > 0
    orders[:, ~alive], shape[:, ~alive] = 1.0, 1.0
    transform = transform / shape
    inner = transform[usable]
    scale = orders[:, :, None] * orders[:, None, :]
    models: list[tuple[float, np.ndarray, Bands | None]] = []
    if is_white(np.abs(inner) ** 2) and has_one_covariance(inner):
        together = (inner.T @ inner.conj()).real / len(inner)
        level = 2 * float(np.log(shape[usable]).sum()) / len(inner)
        level += float(np.linalg.slogdet(together[np.ix_(alive, alive)])[1])
        models.append((n * level + 3 * channels * np.log(n), scale * together, bands))
    autoregressive = _autoregressive(left, np.arange(K + 1) * speed * step, freedom)
    if autoregressive is not None:
        models.append((*autoregressive, None))
    if models:
        _, likely, bands = min(models, key=lambda model: model[0])
        return Noise(likely + at_least, False, float(freedom), colour, bands)
    width = max(SMOOTHING, 2 * channels, round(spacing / 2))
    enough = min(max(2 * SMOOTHING, 4 * channels), usable.sum())
    spectrum = np.empty((K + 1, channels, channels), complex)
    for k in range(K + 1):
        for reach in (width << doubled for doubled in range(32)):
            near = usable & (at_line >= round(k * spacing - reach)) & (at_line <= round(k * spacing + reach))
            if near.sum() >= enough or reach > len(transform):
                break
        part = transform[near]
        # the inverse of a cross-spectrum estimated from N lines is too large by N / (N - channels) in the mean
        unbiased = max(len(part) - channels, 1)
        spectrum[k] = scale[k] * np.einsum("ni,nj->ij", part, part.conj()) / unbiased + at_least
    spectrum[0] = spectrum[0].real
    return Noise(spectrum, False, float(4 * width), colour)


def _autoregressive(left: np.ndarray, omega: np.ndarray, freedom: int) -> tuple[float, np.ndarray] | None:
    """Return an autoregression of the residual (n, C): its cross-spectrum (K+1, C, C) at angles per sample omega.

    e_n = A_1 e_(n-1) + ... + A_p e_(n-p) + w_n by least squares, the order p up to 8 by the Bayesian information
    criterion; None where w is not white or there are too few samples. First comes minus twice the logarithm of
    Whittle's likelihood, its constant left out, and what its parameters cost. Source: Lutkepohl, New Introduction to
    Multiple Time Series Analysis (2005), ch. 3-4.
    """
    size = np.sqrt(np.mean(left**2, axis=0))
    used = np.flatnonzero(size > 0)
    n, C = len(left), len(used)
    most = min(MOST_LAGS, (n // 20) // max(C, 1))
    if most < 1:
        return None
    e = left[:, used] / size[used]
    lagged = np.hstack([e[most - k : n - k] for k in range(1, most + 1)])
    target = e[most:]
    normal, right = lagged.T @ lagged, lagged.T @ target
    fits = []
    for p in range(1, most + 1):
        coefficients = np.linalg.lstsq(normal[: p * C, : p * C], right[: p * C], rcond=None)[0]
        innovations = target - lagged[:, : p * C] @ coefficients
        sign, logarithm = np.linalg.slogdet(innovations.T @ innovations / len(target))
        if sign <= 0:
            return None
        fits.append((len(target) * logarithm + p * C * C * np.log(len(target)), p, coefficients, innovations))
    _, p, coefficients, innovations = min(fits, key=lambda fit: fit[0])
    transform = np.fft.rfft(innovations, axis=0)[1:-1]
    if not (is_white(np.abs(transform) ** 2) and has_one_covariance(transform)):
        return None
    covariance = innovations.T @ innovations / max(freedom - most - p * C, 1)
    delays = np.exp(-1j * np.outer(omega, np.arange(1, p + 1)))
    through = np.eye(C) - np.einsum("kp,pij->kji", delays, coefficients.reshape(p, C, C))
    if np.linalg.cond(through).max() > 1 / np.finfo(float).eps:  # a pole on the unit circle: no noise
        return None
    transfer = np.linalg.inv(through)
    spectrum = np.zeros((len(omega), left.shape[1], left.shape[1]), complex)
    inner = transfer @ covariance @ transfer.conj().swapaxes(1, 2)
    spectrum[:, used[:, None], used] = inner * np.outer(size[used], size[used])
    spectrum[0] = spectrum[0].real
    level = float(np.linalg.slogdet(covariance)[1] + 2 * np.log(size[used]).sum())  # log det of the density, in mean
    return n * level + p * C * C * np.log(n), spectrum
