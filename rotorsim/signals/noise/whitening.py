"""Whitening of residuals and tests for whiteness: one power, and one covariance, in all bands of frequency."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

FALSE_ALARM = 1e-3  # probability that noise alone is taken for something, in a run or a recording
BANDS = 16
LEAST_BAND = 7  # lines of the narrowest
NOT_WHITE = 1e-4  # probability below which noise is not called white
NO_VARIANCE = 1e-9  # of the variance of channels: what is less carries the noise of others


def independent(x: np.ndarray) -> np.ndarray:
    """Return uncorrelated columns (n, m), m <= C, of mean square one, made of channels x (n, C), real or complex.

    Channels that are zero are left out, and combinations of them that have next to no variance.
    """
    size = np.sqrt(np.mean(np.abs(x) ** 2, axis=0))
    scaled = x[:, size > 0] / size[size > 0]
    values, vectors = np.linalg.eigh((scaled.T @ scaled.conj()).real / len(x))
    kept = values > NO_VARIANCE
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))


def is_white(power: np.ndarray) -> bool:
    """Return whether the power (n, C) of every channel is the same in all bands of frequency (chi-squared test).

    Bands have one width, but for the lowest, which is divided into octaves: flicker noise that fills a few lines only
    moves the harmonics of a slow shaft all the same.
    """
    if len(power) < 4 * BANDS:
        return True
    width = len(power) / BANDS
    octaves = [int(width / 2**k) for k in range(1, 32) if width / 2**k >= LEAST_BAND]
    starts = np.unique([0, *octaves, *np.linspace(0, len(power), BANDS, endpoint=False).astype(int)])
    sizes = np.diff(np.append(starts, len(power)))
    sums = np.add.reduceat(power, starts, axis=0)
    means, overall = sums / sizes[:, None], sums.sum(axis=0) / len(power)
    with np.errstate(invalid="ignore", divide="ignore"):
        statistic = np.nansum(sizes[:, None] * (means / overall - 1) ** 2, axis=0)
    return bool((statistic < chi2.isf(NOT_WHITE / power.shape[1], len(starts) - 1)).all())


def has_one_covariance(transform: np.ndarray) -> bool:
    """Return whether white channels have the same cross-spectrum in all bands of their Fourier transform (n, C).

    Noise that comes later in one channel, as behind a sampled controller, has a phase that turns with frequency.
    """
    channels = int(transform.any(axis=0).sum())
    starts = np.linspace(0, len(transform), BANDS, endpoint=False).astype(int)
    counts = np.diff(np.append(starts, len(transform)))
    if channels < 2 or counts[0] < 4:
        return True
    uncorrelated = independent(transform)
    if uncorrelated.shape[1] < channels:  # two channels carry the same noise: nothing is left to be tested
        return True
    i, j = np.triu_indices(channels, 1)
    bands = np.add.reduceat(uncorrelated[:, i] * uncorrelated[:, j].conj(), starts, axis=0) / counts[:, None]
    statistic = 2 * (counts[:, None] * np.abs(bands) ** 2).sum(axis=0)
    return bool((statistic < chi2.isf(NOT_WHITE / transform.shape[1] ** 2, 2 * BANDS)).all())
