"""Misfits of parts of the data, each predicted from the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

RANK_TOLERANCE = 1e-12  # of the largest eigenvalue of a scaled information matrix
ZERO_EIGENVALUE = 1e-13  # of the largest eigenvalue: below, it is rounding
HELD_BY_NONE = 1e-8  # 1 - leverage of a direction that no other run determines: it is not predicted from them


@dataclass(frozen=True, eq=False)
class Products:
    """What parts of the data say: of whitened residuals r and Jacobians J of B parts r^T r, J^T r and J^T J.

    squares (B,), gradients (B, m), information (B, m, m).
    """

    squares: np.ndarray
    gradients: np.ndarray
    information: np.ndarray

    def of(self, which: np.ndarray) -> Products:
        """Return those of some parameters."""
        return Products(self.squares, self.gradients[:, which], self.information[:, which][:, :, which])

    def left_out(self) -> np.ndarray:
        """Return the misfit of each part when it is predicted from the others, (B,), by linear theory.

        e_r = (I - J_r (J^T J)^-1 J_r^T)^-1 r_r,  with  (I - J C J^T)^-1 = I + J (C^-1 - J^T J)^-1 J^T  (Woodbury)
        """
        size = np.sqrt(np.einsum("bjj->j", self.information))
        size = np.where(size > 0, size, 1.0)
        gradients, information = self.gradients / size, self.information / np.outer(size, size)
        out = []
        for square, g, own in zip(self.squares, gradients, information, strict=True):
            others = np.linalg.pinv(information.sum(axis=0) - own, rcond=RANK_TOLERANCE, hermitian=True)
            step = others @ g
            out.append(float(square + 2 * step @ g + step @ own @ step))
        return np.array(out)


def left_out(residual: np.ndarray, jacobian: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Return the misfit of each run when it is predicted from the others, (R,); sizes: equations of each."""
    ends = np.cumsum(sizes)[:-1]
    pairs = [*zip(np.split(residual, ends), np.split(jacobian, ends), strict=True)]
    m = jacobian.shape[1]
    return Products(
        np.array([float(r @ r) for r, _ in pairs]),
        np.array([J.T @ r for r, J in pairs]).reshape(len(pairs), m),
        np.array([J.T @ J for _, J in pairs]).reshape(len(pairs), m, m),
    ).left_out()


def surprise(known: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> float | None:
    """Return the misfit of data that took no part in a fit, with the noise and the uncertainty of its parameters.

    e^T (I + J (S^T S)^-1 J^T)^-1 e = |e|^2 - e^T J (S^T S + J^T J)^-1 J^T e, with the whitened residual e (n,) and
    Jacobian J (n, m), and the Jacobian S of the fitted data and of priors, known (k, m): chi-squared, if the structure
    is true. None where anything is not finite.
    """
    S, e, J = known, residual, jacobian
    if not (np.isfinite(e).all() and np.isfinite(J).all() and np.isfinite(S).all()):
        return None
    size = np.sqrt((S**2).sum(axis=0) + (J**2).sum(axis=0))
    size[size == 0] = 1.0
    S, J = S / size, J / size
    onto = J.T @ e
    inverse = np.linalg.pinv(S.T @ S + J.T @ J, rcond=ZERO_EIGENVALUE, hermitian=True)
    return float(e @ e - onto @ inverse @ onto)


def standardised(known: np.ndarray, residual: np.ndarray, sizes: Sequence[int]) -> list[tuple[float, float]]:
    """Return of each run of fitted data the misfit when it is predicted from the others, and its equations.

    By linear theory e_r = (I - H_r)^-1 r_r with covariance (I - H_r)^-1, H_r = J_r (J^T J)^-1 J_r^T, so that the misfit
    r_r^T (I - H_r)^-1 r_r is chi-squared, if the structure is true (Cook & Weisberg, Residuals and Influence in
    Regression, 1982, ch. 2). Directions that only this run determines count neither as misfit nor as equations. known:
    the whitened Jacobian (n, m) of all runs, then that of priors; sizes: equations of each run.
    """
    norm = np.linalg.norm(known, axis=0)
    S = known[:, norm > 0] / norm[norm > 0]
    inverse = np.linalg.pinv(S.T @ S, rcond=ZERO_EIGENVALUE, hermitian=True)
    out, at = [], 0
    for size in sizes:
        J, e = S[at : at + size], residual[at : at + size]
        at += size
        values, vectors = np.linalg.eigh(np.eye(size) - J @ inverse @ J.T)
        shared = values > HELD_BY_NONE
        parts = vectors[:, shared].T @ e
        out.append((float((parts**2 / values[shared]).sum()), float(shared.sum())))
    return out
