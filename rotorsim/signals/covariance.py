"""Covariance of complex harmonics: their order as real numbers, and real forms of complex matrices."""

from __future__ import annotations

import numpy as np


def real_vector(values: np.ndarray) -> np.ndarray:
    """Return harmonics (..., K+1, C) as real numbers (..., (2K+1) C): order 0, then real, imaginary per order."""
    return real_columns(values[..., None])[..., 0]


def real_columns(values: np.ndarray) -> np.ndarray:
    """Return harmonics (..., K+1, C, j) as real columns (..., (2K+1) C, j); see `real_vector`."""
    *lead, orders, channels, count = values.shape
    out = np.empty((*lead, 2 * orders - 1, channels, count))
    out[..., 0, :, :] = values[..., 0, :, :].real
    out[..., 1::2, :, :] = values[..., 1:, :, :].real
    out[..., 2::2, :, :] = values[..., 1:, :, :].imag
    return out.reshape(*lead, (2 * orders - 1) * channels, count)


def complex_values(vector: np.ndarray, channels: int) -> np.ndarray:
    """Return the harmonics (K+1, C) that a real vector holds."""
    rows = vector.reshape(-1, channels)
    return np.concatenate([rows[:1] + 0j, rows[1::2] + 1j * rows[2::2]])


def real_form(cross_spectrum: np.ndarray) -> np.ndarray:
    """Return the covariance (2C, 2C) of real and imaginary parts whose cross-spectrum is S (C, C), Hermitian."""
    return np.block([[cross_spectrum.real, -cross_spectrum.imag], [cross_spectrum.imag, cross_spectrum.real]])


def scaled_cholesky(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return standard deviations s (m,) and the lower factor L (m, m) of a covariance diag(s) L L^T diag(s)."""
    scale = np.sqrt(np.diag(covariance))
    return scale, np.linalg.cholesky(covariance / np.outer(scale, scale))
