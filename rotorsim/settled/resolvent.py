"""The response X = (s I - A)^-1 F of many runs at many orders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Resolvent:
    """What forces do to states: gain (R, K+1, n, r), states by forces in rows of dx/dt at order 0 first.

    slow: of each run, dX_0 by the means of its slow states, (n, s).
    """

    gain: np.ndarray
    slow: Sequence[np.ndarray]


def resolvent_of(A: np.ndarray, s: np.ndarray, slow: Sequence[np.ndarray]) -> Resolvent:
    """Return (s I - A)^-1 for A (R, n, n) and s (R, K+1); slow states (indices of each run) rest at order 0."""
    gain = np.linalg.inv(shifted(A, s, slow))
    columns = []
    for r, states in enumerate(slow):
        gain[r, 0, states, :] = 0.0
        column = (gain[r, 0] @ A[r][:, states]).real
        column[states, np.arange(len(states))] = 1.0
        columns.append(column)
    return Resolvent(gain, columns)


def shifted(A: np.ndarray, s: np.ndarray, resting: Sequence[np.ndarray]) -> np.ndarray:
    """Return s I - A, (R, K+1, n, n), for A (R, n, n), s (R, K+1); at order 0 without the states of a run that rest."""
    matrices = np.asarray(s[:, :, None, None] * np.eye(A.shape[-1]) - A[:, None])
    for r, states in enumerate(resting):
        matrices[r, 0, states, :] = 0.0
        matrices[r, 0, :, states] = 0.0
        matrices[r, 0, states, states] = 1.0
    return matrices
