"""How much of a residual is predictable, and hence no noise: a black-box model, judged on what was left out.

Features: every signal that the diagram simulates (inputs, wires), its magnitude, signed square, cube and sign, each
also behind first-order filters with the diagram's own poles and some more: rational orthonormal bases in front of which
static nonlinearities stand (a Hammerstein model). Nothing of the residual itself is among them, so that noise of one
channel, of whatever colour, is predicted by none. Ridge regression; penalty and share by cross-validation: whole runs
are left out, so that what is slow and by chance alike within a run (a drift) predicts nothing; of a single run,
stretches.

Source: Heuberger, Van den Hof & Wahlberg, Modelling and Identification with Rational Orthogonal Basis Functions (2005),
ch. 2; Hastie, Tibshirani & Friedman, The Elements of Statistical Learning (2009), 3.4.1 and 7.10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter
from scipy.stats import t as student

from rotorsim.criteria import CRITERIA

STRETCHES_OF_RUN = 4  # by which gains are compared; of a single run, they are left out one by one, of several the runs
MOST_SIGNALS = 12  # the least alike of what the diagram simulates
NEARLY_ONE = 0.9999  # correlation from which on two signals are one
STEEP = 0.05  # of its standard deviation: over which a signal changes its sign
FURTHER_POLES = 4  # real ones, from four in a run to a third of a radian in a sample
SLOWEST = 0.9999  # modulus of a discrete pole: filters settle within some ten thousand samples
PENALTIES = 10.0 ** np.arange(-9.0, 1.0)  # of the largest eigenvalue of the features' products


@dataclass(frozen=True, eq=False)
class Predictability:
    """share (c,): of the mean square of each residual that is predicted where it was left out.

    level (c,): probability of such gains, stretch by stretch, where there is nothing to predict (t-test of logarithms).
    rest: what is not predicted, (N, c) of each run.
    """

    share: np.ndarray
    level: np.ndarray
    rest: Sequence[np.ndarray]

    @property
    def structure(self) -> float:
        """The largest share that is neither chance nor hidden by noise of an unknown variance; 0: none."""
        counts = (self.share > 1 - 1 / CRITERIA.model_error) & (self.level < CRITERIA.false_alarm)
        return float(self.share[counts].max(initial=0.0))


def predictability(residuals: Sequence[np.ndarray], signals: Sequence[np.ndarray], poles: np.ndarray) -> Predictability:
    """Return what signals (N, s) of each run predict of residuals (N, c), NaN where nothing was measured.

    poles: discrete ones of the diagram.
    """
    features = _features(signals, poles)
    Y = np.concatenate(residuals)
    sizes = [len(part) for part in residuals]
    ends = [np.linspace(0, size, STRETCHES_OF_RUN + 1).astype(int) for size in sizes]
    stretch = np.concatenate([np.searchsorted(end, np.arange(end[-1]), "right") + 10 * r for r, end in enumerate(ends)])
    fold = stretch // 10 if len(residuals) > 1 else stretch
    predicted, there = np.full(Y.shape, np.nan), np.isfinite(Y)
    patterns = [there.all(axis=1)] if there.all() else [*np.unique(there, axis=1).T]
    for known in patterns:  # outputs that were measured at the same instants, as a rule all
        alike = (there == known[:, None]).all(axis=0)
        X = features if known.all() else features[known]
        predicted[np.ix_(known, alike)] = _left_out(X, Y[np.ix_(known, alike)], fold[known])
    squares = np.array(
        [[np.nansum(Y[here] ** 2, axis=0), np.nansum((Y - predicted)[here] ** 2, axis=0)] for here in _each(stretch)]
    )
    total = np.maximum(squares[:, 0].sum(axis=0), 1e-300)
    share = 1 - squares[:, 1].sum(axis=0) / total
    gains = np.log(np.maximum(squares[:, 0], 1e-300) / np.maximum(squares[:, 1], 1e-300))
    std = gains.std(axis=0, ddof=1) / np.sqrt(len(gains))
    level = student.sf(gains.mean(axis=0) / np.maximum(std, 1e-12), len(gains) - 1)
    rest = np.split(Y - np.where(share > 0, predicted, 0.0), np.cumsum(sizes)[:-1])
    return Predictability(np.maximum(share, 0.0), level, rest)


def _each(stretch: np.ndarray) -> list[slice]:
    """Return the places of every stretch; they follow one another."""
    ends = [*np.flatnonzero(np.diff(stretch)) + 1, len(stretch)]
    return [slice(first, last) for first, last in pairwise([0, *ends])]


def _left_out(X: np.ndarray, Y: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Return what a ridge regression from the other folds predicts of each, (n, c), at the best penalties."""
    predicted = np.zeros((len(PENALTIES), *Y.shape))
    folds = [(here, X[here], Y[here]) for here in _each(fold)]
    if not X.size or len(folds) < 2:  # nothing moves, or nothing is left to learn from
        return np.zeros(Y.shape)
    products, moments = [x.T @ x for _, x, _ in folds], [x.T @ y for _, x, y in folds]
    products_of_all, moments_of_all = sum(products), sum(moments)
    for (here, x, _), product, moment in zip(folds, products, moments, strict=True):
        values, vectors = np.linalg.eigh(products_of_all - product)
        along = vectors.T @ (moments_of_all - moment)
        stiff = np.maximum(values, 0.0) + PENALTIES[:, None] * values[-1]
        predicted[:, here] = x @ (vectors @ (along / stiff[:, :, None]))
    best = ((Y - predicted) ** 2).sum(axis=1).argmin(axis=0)
    return np.stack([predicted[k, :, j] for j, k in enumerate(best)], axis=1)


def _features(signals: Sequence[np.ndarray], poles: np.ndarray) -> np.ndarray:
    """Return the features of all samples, of unit mean square, (n, F)."""
    whole = np.concatenate(signals)
    mean, size = whole.mean(axis=0), whole.std(axis=0)
    kept = _unlike((whole - mean) / np.where(size > 0, size, 1.0), size)
    length = max(len(part) for part in signals)
    further = np.exp(-np.geomspace(4 / length, 1 / 3, FURTHER_POLES))
    every = [*further, *poles[poles.imag >= 0]]
    every = [z if abs(z) < SLOWEST else SLOWEST * z / abs(z) for z in every]
    parts = [_filtered(_nonlinear((part[:, kept] - mean[kept]) / size[kept]), every) for part in signals]
    X = np.concatenate(parts)
    X -= X.mean(axis=0)
    scale = np.sqrt(np.einsum("nf,nf->f", X, X))
    moving = scale > 1e-9 * scale.max(initial=0.0)
    if not moving.all():
        X, scale = X[:, moving], scale[moving]
    X /= scale
    return X


def _unlike(z: np.ndarray, size: np.ndarray) -> list[int]:
    """Return the signals of which none is nearly a multiple of another, each the least like those before."""
    open_ = [k for k in range(z.shape[1]) if size[k] > 0]
    alike = np.abs(z.T @ z) / len(z)
    kept: list[int] = []
    while open_ and len(kept) < MOST_SIGNALS:
        nearest = [max((alike[k, other] for other in kept), default=0.0) for k in open_]
        if min(nearest) > NEARLY_ONE:
            break
        kept.append(open_.pop(int(np.argmin(nearest))))
    return kept


def _nonlinear(z: np.ndarray) -> np.ndarray:
    return np.concatenate([z, np.abs(z), z * np.abs(z), z**3, np.tanh(z / STEEP)], axis=1)


def _filtered(F: np.ndarray, poles: Sequence[complex]) -> np.ndarray:
    """Return signals and what is behind a first-order filter with each pole, real and imaginary parts."""
    parts = [F]
    for z in poles:
        gain, damped = 1 - abs(z), [1.0, -z.real]
        if abs(z.imag) <= 1e-9:
            parts.append(lfilter([gain], damped, F, axis=0))
            continue
        both = [1.0, -2 * z.real, abs(z) ** 2]
        parts += [lfilter(gain * np.array(b), both, F, axis=0) for b in (damped, [0.0, z.imag])]
    return np.concatenate(parts, axis=1)
