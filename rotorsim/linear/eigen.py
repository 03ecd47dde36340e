"""Eigenvalues of linear systems, with and without samplers, their vectors, and what is seen of them."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, pi

import numpy as np

from rotorsim.linear.drift import eigenvectors
from rotorsim.linear.sampled_data import NO_MULTIPLIER, SampledData
from rotorsim.linear.state_space import StateSpace

REAL_POLE = 1e-8  # imaginary part, relative to the largest |eigenvalue|, above which a pole oscillates
MOST_IMAGES = 16  # of a frequency, above and below, among which that of a mode is looked for
UNDECIDED = 0.5  # share of the largest image that another one has, from which on either may be meant
ALIKE = 1e-9  # relative difference of images that are one but for rounding
INSTANTS = 4  # in a period of the highest of them


@dataclass(frozen=True)
class Eigen:
    """Oscillating eigenvalues (imaginary part positive, ascending), their vectors, and the real poles [1/s].

    shapes (k, m): of outputs y = Re(shape exp(value t)). right, left (n, m): vectors, left^H right = 1, of A, or of the
    monodromy at t = 0 where there are samplers. modulo (m,): frequency [Hz], NaN or that of the samplers, up to whole
    multiples of which a frequency is known: another image shows at least half as much.
    """

    values: np.ndarray
    right: np.ndarray
    left: np.ndarray
    real: np.ndarray
    shapes: np.ndarray
    modulo: np.ndarray


def eigen(system: StateSpace | SampledData) -> Eigen:
    """Return the eigenvalues of a system apart by kind, with their vectors and shapes.

    Those of free bodies and of integrators without feedback are zero, see `eigenvectors`. With samplers s(T) = mu s(0)
    over a common period T, s(t) = v(t) exp(s t) with v periodic: s = ln(mu) / T + 2 pi i j / T is that j of which v
    shows most in the outputs. It may lie above half of the sample rate: a bent mode that the samplers hardly touch.
    """
    if isinstance(system, SampledData):
        return _sampled(system)
    values, left, right = eigenvectors(system.A)
    limit = REAL_POLE * np.abs(values).max(initial=0.0)
    real = np.sort(values[np.abs(values.imag) <= limit].real)
    keep = np.flatnonzero(values.imag > limit)
    sure = np.full(len(keep), np.nan)
    return _ordered(values[keep], left[:, keep], right[:, keep], real, system.C @ right[:, keep], sure)


def unfolded(system: SampledData, pole: complex) -> tuple[float, float]:
    """Return the frequency [Hz] of a pole ln(mu) / T at the image that shows most; and modulo what, NaN if sure."""
    found = eigen(system)
    turns = np.exp(np.multiply.outer((-pole, -pole.conjugate()), np.ones(1)) * system.period)
    away = np.abs(np.exp(found.values * system.period) * turns - 1).min(axis=0)
    real = np.abs(np.exp((found.real - pole) * system.period) - 1)
    if not len(away) or real.min(initial=np.inf) <= away.min():
        return 0.0, np.nan
    k = int(away.argmin())
    return float(found.values[k].imag / (2 * pi)), float(found.modulo[k])


def _ordered(
    s: np.ndarray, left: np.ndarray, right: np.ndarray, real: np.ndarray, shapes: np.ndarray, modulo: np.ndarray
) -> Eigen:
    order = np.argsort(s.imag, kind="stable")
    s, left, right = s[order], left[:, order], right[:, order]
    products = np.sum(left.conj() * right, axis=0)
    products = np.where(np.abs(products) > 0, products, 1.0)
    return Eigen(s, right, left / products.conj(), real, shapes[:, order], modulo[order])


def multipliers(system: SampledData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the multipliers (m,) over a period, and left and right vectors (n, r) of the first r: the others are 1."""
    M = system.monodromy
    values, left, right = eigenvectors(M - np.eye(len(M)), about=1.0)
    return 1 + values.astype(complex), left, right


def _sampled(system: SampledData) -> Eigen:
    mu, left, right = multipliers(system)
    known = np.flatnonzero((np.abs(mu[: right.shape[1]]) > NO_MULTIPLIER) & (mu.imag[: right.shape[1]] >= 0))
    s, v, w = np.log(mu[known]) / system.period, right[:, known], left[:, known]
    images, shapes = _images(system, s, v)
    seen = np.linalg.norm(shapes, axis=1)
    rate = 2 * pi / system.period
    seen[images == 0] *= 1 + ALIKE  # of what is not seen, or at half of the rate, where both images are alike
    place = np.where(s.imag == 0, len(images) // 2, np.argmax(seen, axis=0))
    largest = np.take_along_axis(seen, place[None], 0)[0]
    np.put_along_axis(seen, place[None], 0.0, 0)
    half = np.abs(s.imag * system.period - pi) < ALIKE  # its image at minus half of the rate is its conjugate
    np.put_along_axis(seen, np.where(half, len(images) - 2 - place, place)[None], 0.0, 0)
    modulo = np.where(seen.max(axis=0, initial=0.0) >= UNDECIDED * largest, 1 / system.period, np.nan)
    s = s + 1j * rate * images[place]
    shapes = np.take_along_axis(shapes, place[None, None], 0)[0]
    mirrored = s.imag < 0
    s, shapes = np.where(mirrored, s.conj(), s), np.where(mirrored, shapes.conj(), shapes)
    v, w = np.where(mirrored, v.conj(), v), np.where(mirrored, w.conj(), w)
    limit = REAL_POLE * np.abs(s).max(initial=0.0)
    real = np.concatenate([s[np.abs(s.imag) <= limit].real, np.zeros(len(mu) - right.shape[1])])
    keep = np.flatnonzero(s.imag > limit)
    return _ordered(s[keep], w[:, keep], v[:, keep], np.sort(real), shapes[:, keep], modulo[keep])


def _images(system: SampledData, s: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers j (J,), and the components of y at s + 2 pi i j / T, (J, k, m), of motions v (n, m) at t = 0.

    (1 / T) integral over T of C s(t) exp(-(s + 2 pi i j / T) t), by the trapezoidal rule between hits.
    """
    T, highest = system.period, float(np.abs(system.flow.poles().imag).max(initial=0.0))
    most = min(ceil(highest * T / (2 * pi)), MOST_IMAGES * round(T / system.shortest))
    images = np.arange(-most, most + 1)
    parts = max(ceil(INSTANTS * (most + 1) / len(system.times)), INSTANTS)
    found = np.zeros((len(images), len(system.flow.C), len(s)), complex)
    seen: dict[str, np.ndarray] = {}  # C exp(A k h) of the parts of an interval, by its length
    state = v.astype(complex)
    for start, length, P, (J, _) in zip(system.times, system.lengths, system.transitions, system.jumps, strict=True):
        state, key = J @ state, f"{length:.9e}"
        if key not in seen:
            step, rows = system.exponential(float(length) / parts), [system.flow.C]
            for _ in range(parts):
                rows.append(rows[-1] @ step)
            seen[key] = np.array(rows)
        y = seen[key].reshape(-1, len(state)) @ state
        weights = np.full(parts + 1, length / parts / T)
        weights[[0, -1]] /= 2
        times = start + np.arange(parts + 1) * (length / parts)
        waves = np.exp(-2j * np.pi / T * np.multiply.outer(images, times)) * weights
        y = y.reshape(parts + 1, -1, len(s)) * np.exp(-np.multiply.outer(times, s))[:, None]
        found += (waves @ y.reshape(parts + 1, -1)).reshape(found.shape)
        state = P @ state
    return images, found
