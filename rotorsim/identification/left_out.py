"""Misfits of parts of the data, each predicted from the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

RANK_TOLERANCE = 1e-12  # of the largest eigenvalue of a scaled information matrix


def left_out(residual: np.ndarray, jacobian: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the misfit of each run when it is predicted from the others, (R,), by linear theory.

    e_r = (I - J_r (J^T J)^-1 J_r^T)^-1 r_r,  with  (I - J C J^T)^-1 = I + J (C^-1 - J^T J)^-1 J^T  (Woodbury)
    """
    norm = np.linalg.norm(jacobian, axis=0)
    J = jacobian / np.where(norm > 0, norm, 1.0)
    information = J.T @ J
    ends = np.cumsum(sizes)[:-1]
    out = []
    for rows, r in zip(np.split(J, ends), np.split(residual, ends), strict=True):
        others = np.linalg.pinv(information - rows.T @ rows, rcond=RANK_TOLERANCE, hermitian=True)
        predicted = r + rows @ (others @ (rows.T @ r))
        out.append(float(predicted @ predicted))
    return np.array(out)
