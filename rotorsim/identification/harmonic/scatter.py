"""Scatter and bias of the regression under the noise of the recording, by drawing that noise again."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.identification.harmonic.estimate import Estimate, Search
from rotorsim.identification.harmonic.regression import Regression
from rotorsim.identification.harmonic.whitening import noise_root
from rotorsim.signals.covariance import complex_values

DRAWS = 40
UNDETERMINED = 1e-8  # singular value, of the largest, below which a combination of parameters is not determined at all
ZERO_SENSITIVITY = 1e-9  # of the largest: a derivative that is rounding
FREE_WIDTHS = 1e3  # widths of its own that a parameter gets along such a combination


@dataclass(frozen=True, eq=False)
class Scatter:
    """covariance (m, m) and bias (m,) of the parameters; adequate: the residual is what noise can make of it."""

    covariance: np.ndarray
    bias: np.ndarray
    adequate: bool


def scatter_of(regression: Regression, search: Search, result: Estimate) -> Scatter:
    """Return scatter and bias of a regression.

    Noise drawn with the covariance of the harmonics is added to the measured ones and the regression repeated (one
    Gauss-Newton step): noise in its columns biases it as much again. Combinations of parameters that the equations
    do not hold get a scatter that says so.
    """
    random = np.random.default_rng(0)
    measured = regression.data
    pairs = zip(regression.experiment.fits, regression.experiment.columns, strict=True)
    roots = [noise_root(fit, columns, regression.K) for fit, columns in pairs]
    jacobian = search.coordinates.jacobian(result.theta)
    at_hand = regression.evaluate(result.theta)
    estimates = np.empty((DRAWS, len(result.theta)))
    made = np.empty(DRAWS)
    in_columns = np.zeros((len(result.theta), len(result.theta)))
    for k in range(DRAWS):
        noise = [root @ random.standard_normal(root.shape[1]) for root in roots]
        regression.data = measured + np.array([complex_values(vector, measured.shape[-1]) for vector in noise])
        found = regression.evaluate(result.theta)
        step = np.linalg.lstsq(found.jacobian @ jacobian, -found.residual, rcond=None)[0]
        estimates[k] = result.theta + jacobian @ step
        columns = (found.jacobian - at_hand.jacobian) @ jacobian
        in_columns += columns.T @ columns
        change = found.residual - at_hand.residual
        made[k] = float(change @ change)
    regression.data = measured
    undetermined = _undetermined(
        at_hand.jacobian @ jacobian, in_columns / DRAWS, jacobian, search.coordinates.inside(result.theta)
    )
    covariance = np.cov(estimates.T).reshape(len(result.theta), -1) + undetermined
    adequate = float(at_hand.residual @ at_hand.residual) <= CRITERIA.scatter * float(made.max())
    return Scatter(covariance, estimates.mean(axis=0) - result.theta, adequate)


def _undetermined(J: np.ndarray, noise: np.ndarray, jacobian: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the covariance along combinations of parameters that the equations do not hold, or only by their noise.

    J: columns of the regression in q, at (m,). noise (m, m): the part of J^T J that is noise. A combination v with
    v^T noise v above a quarter of |J v|^2 is pulled to zero by about as much: it may be wrong by all of itself.
    """
    size = np.linalg.norm(J, axis=0)
    nothing = size <= ZERO_SENSITIVITY * size.max(initial=0.0)
    used = np.where(nothing, 0.0, J)
    scale = np.where(nothing, 1.0, size)
    _, values, vectors = np.linalg.svd(used / scale, full_matrices=True)
    padded = np.zeros(J.shape[1])
    padded[: len(values)] = values
    total = np.zeros((len(jacobian), len(jacobian)))
    for value, vector in zip(padded, vectors, strict=True):
        direction = vector / scale
        direction /= np.linalg.norm(direction)
        image = float(np.sum((used @ direction) ** 2))
        null = value <= UNDETERMINED * padded.max(initial=1e-300)
        reach = max(1.0, float(np.abs(direction @ at)))
        if null or direction @ noise @ direction > CRITERIA.attenuated * image:
            moved = jacobian @ ((FREE_WIDTHS if null else 1.0) * reach * direction)
            total += np.outer(moved, moved)
    return total


def with_covariance(result: Estimate, covariance: np.ndarray) -> Estimate:
    """Return an estimate whose information is the inverse of a covariance of theta."""
    jacobian = result.coordinates.jacobian(result.theta)
    information = jacobian.T @ np.linalg.pinv(covariance, hermitian=True) @ jacobian
    free = np.zeros(len(result.theta), bool)
    return replace(result, information=information, at_bound=free, scatter=covariance)
