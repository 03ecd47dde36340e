"""Vold-Kalman filter, second generation: complex envelopes of orders that change slowly, all of them together.

y = sum_k Re x_k exp(i theta_k) + noise,  and the differences of order p of each x_k are next to nothing:

min  sum_n (y_n - sum_k Re x_kn exp(i theta_kn))^2 + sum_kn r_kn^2 |(D^p x_k)_n|^2

Angular-displacement form: theta_k is the angle itself, k times that of the shaft or 2 pi f t of a steady line; orders
that cross are told apart, since all are found at once. About its own frequency an order passes by
H(w) = 1 / (1 + 2 r^2 (2 sin(w dt / 2))^(2 p)), which is 1 / sqrt 2 at half of the bandwidth B [Hz], so that

r = sqrt((sqrt 2 - 1) / 2) / (2 sin(pi B dt / 2))^p.

Real and imaginary parts are unknowns of their own: y is real, and the image at -theta_k takes no part. (With complex
data the factor 2 is missing.) The normal equations are banded, positive definite, and the same for all channels.
Source: H. Vold and J. Leuridan, SAE paper 931288 (1993); J. Tuma, Setting the passband width in the Vold-Kalman order
tracking filter, ICSV 12 (2005).
"""

from __future__ import annotations

from math import comb, sqrt

import numpy as np
from scipy.linalg import solveh_banded

from rotorsim.errors import Problem, RotorsimError

POLES = 2  # differences of order p that are next to nothing
MOST_BAND_ENTRIES = 60_000_000  # of the band: 480 MB
REFINEMENTS = 3  # of the solution, by what it leaves: a narrow filter is badly conditioned
NARROWEST = 2e-4  # bandwidth over sample rate: below, rounding is 1e-3 of an envelope


def vold_kalman(
    y: np.ndarray, angles: np.ndarray, bandwidths: np.ndarray, step: float, *, poles: int = POLES
) -> np.ndarray:
    """Return the complex envelopes (K, N, c), 0-peak, of samples y (N, c) at angles (K, N) [rad].

    bandwidths (K, N) [Hz]: of -3 dB, both sides together. step [s]: between samples. NaN samples take no part.
    Raises RotorsimError for a bandwidth that is too narrow for the sample rate, and for a run that is too long.
    """
    K, N = angles.shape
    u = 2 * K
    if (bandwidths * step).min() < NARROWEST:
        least = NARROWEST / step
        what = f"a bandwidth of {bandwidths.min():.3g} Hz is too narrow for samples of {1 / step:.5g} Hz"
        raise RotorsimError(Problem(what, "vold-kalman", hint=f"at least {least:.3g} Hz, or fewer samples a second"))
    if (poles * u + 1) * u * N > MOST_BAND_ENTRIES:
        what = f"{N} samples of {K} orders are too many at once"
        raise RotorsimError(Problem(what, "vold-kalman", hint="a part of the run, or fewer samples a second"))
    r = sqrt((sqrt(2.0) - 1) / 2) / (2 * np.sin(np.pi * bandwidths * step / 2)) ** poles
    weights = r[:, : N - poles] ** 2  # of the difference that begins there
    basis = np.empty((N, u))
    basis[:, 0::2], basis[:, 1::2] = np.cos(angles).T, -np.sin(angles).T
    known = np.isfinite(y)
    if not (known == known[:, :1]).all():
        return np.concatenate(
            [vold_kalman(y[:, c : c + 1], angles, bandwidths, step, poles=poles) for c in range(y.shape[1])], axis=2
        )
    basis[~known[:, 0]] = 0.0
    signs = np.array([(-1) ** j * comb(poles, j) for j in range(poles + 1)], float)
    band = np.zeros((poles * u + 1, N, u))  # lower form: entry (n, a) with (n + i // u, ..)
    for a in range(u):
        for b in range(a + 1):
            band[a - b, :, b] += basis[:, a] * basis[:, b]
    for i in range(poles + 1):
        for j in range(i + 1):
            band[(i - j) * u, j : N - poles + j] += (signs[i] * signs[j] * np.repeat(weights, 2, axis=0)).T
    flat = band.reshape(poles * u + 1, N * u)
    right = (basis[:, :, None] * np.nan_to_num(y)[:, None]).reshape(N * u, -1)
    found = solveh_banded(flat, right, lower=True)
    for _ in range(REFINEMENTS):
        x = found.reshape(N, u, -1)
        left = np.nan_to_num(y) - np.einsum("nu,nuc->nc", basis, x)
        bent = sum(signs[j] * x[j : N - poles + j] for j in range(poles + 1))
        bent = bent * np.repeat(weights, 2, axis=0).T[:, :, None]
        pulled = np.zeros_like(x)
        for j in range(poles + 1):
            pulled[j : N - poles + j] += signs[j] * bent
        rest = basis[:, :, None] * left[:, None] - pulled
        found = found + solveh_banded(flat, rest.reshape(N * u, -1), lower=True)
    x = found.reshape(N, K, 2, -1)
    return np.asarray(np.moveaxis(x[:, :, 0] + 1j * x[:, :, 1], 1, 0))
