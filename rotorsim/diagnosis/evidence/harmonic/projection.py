"""Whitened columns beside each other: their bases, and the delay that all pulses share as one more of them."""

from __future__ import annotations

import numpy as np

from rotorsim.identification.harmonic.likelihood import Evaluation


def lengths_of(columns: np.ndarray) -> np.ndarray:
    """Return the lengths of columns (..., rows, k), one for those of zeros, (..., 1, k)."""
    size = np.linalg.norm(columns, axis=-2, keepdims=True)
    return np.where(size > 0, size, 1.0)


def basis_of(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of columns (rows, k), those of zeros left out."""
    used = columns[:, columns.any(axis=0)]
    return np.asarray(np.linalg.qr(used / lengths_of(used))[0])


def with_delay(evaluation: Evaluation) -> tuple[np.ndarray, np.ndarray]:
    """Return residual (n,) and Jacobian (n, m) of runs for a known delay of the pulses.

    Where there are pulses the delay is one more column, in units of its standard deviation, and one more row says so.
    """
    residual, jacobian = evaluation.apart()
    if evaluation.late is None:
        return residual, jacobian
    prior = np.zeros((1, jacobian.shape[1] + 1))
    prior[0, -1] = 1.0
    return np.append(residual, 0.0), np.vstack([np.column_stack([jacobian, evaluation.late]), prior])
