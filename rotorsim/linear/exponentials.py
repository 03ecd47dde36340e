"""exp(A h) at many speeds from that at a few: A = A_0 + W A_1 (gyroscopic, circulatory) makes it entire in W.

Interpolated at the extrema of Chebyshev polynomials it converges faster than any power: of A_1 of norm a over W_0 +- w,
the coefficient of T_k is below 2 (a w h / 2)^k / k! times a bound of exp(A h).

Source: Trefethen, Approximation Theory and Approximation Practice (2013), ch. 8; Parlett & Reinsch, Numer. Math. 13
(1969) 293.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm, matrix_balance

INTERVALS = (8, 16, 32)  # between the extrema; each has those before it, which are not computed again
CONVERGED = 1e-12  # of the largest in a row, balanced: the last coefficients; rounding of expm leaves 1e-14
ON_THE_LINE = 1e-14  # of the largest in a row, balanced: rounding of A itself


def exponential(A: np.ndarray, h: float) -> np.ndarray:
    """Return exp(A h) of A (n, n), balanced first: states have units of any size, and rounding is of the largest."""
    if not len(A):
        return A
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    return np.asarray(expm(balanced * h) * scale[:, None] / scale)


class Exponentials:
    """exp(A h) of matrices A (n, n) between two others, A = (1 - c) first + c last, of any number of lengths h."""

    def __init__(self, first: np.ndarray, last: np.ndarray) -> None:
        size = np.abs(first) + np.abs(last)
        scale = matrix_balance(size, permute=False, separate=True)[1][0]
        self._unscaled = scale[:, None] / scale
        self._middle, self._half = (first + last) / (2 * self._unscaled), (last - first) / (2 * self._unscaled)
        self._rounding = ON_THE_LINE * (size / self._unscaled).max(axis=1, keepdims=True)
        self._place = int(np.argmax(np.abs(self._half)))  # which tells where on the line a matrix is
        self._known: dict[str, np.ndarray | None] = {}

    def of(self, A: np.ndarray, h: float) -> np.ndarray:
        """Return exp(A h) (n, n); of a matrix that is not on the line, or where it has not converged, by itself."""
        balanced = A / self._unscaled
        furthest = self._half.flat[self._place]
        c = (balanced - self._middle).flat[self._place] / furthest if furthest else 0.0
        if not abs(c) <= 1 + ON_THE_LINE or (np.abs(balanced - self._middle - c * self._half) > self._rounding).any():
            return exponential(A, h)
        key = f"{h:.9e}"
        if key not in self._known:
            self._known[key] = self._coefficients(h)
        coefficients = self._known[key]
        if coefficients is None:
            return exponential(A, h)
        waves = np.cos(np.arange(len(coefficients)) * np.arccos(np.clip(c, -1.0, 1.0)))
        return np.asarray((waves @ coefficients.reshape(len(waves), -1)).reshape(A.shape) * self._unscaled)

    def _coefficients(self, h: float) -> np.ndarray | None:
        """Return those (k, n, n) of Chebyshev polynomials, balanced; None where they do not fall to rounding."""
        if not self._half.any():
            return np.asarray(expm(self._middle * h))[None]
        made: dict[float, np.ndarray] = {}
        for k in INTERVALS:
            angles = np.arange(k + 1) / k
            for angle in angles.tolist():
                if angle not in made:
                    made[angle] = expm((self._middle + np.cos(np.pi * angle) * self._half) * h)
            values = np.array([made[angle] for angle in angles.tolist()])
            found = np.fft.rfft(np.concatenate([values, values[-2:0:-1]]), axis=0).real / k
            found[[0, -1]] /= 2
            rows = np.abs(values).max(axis=(0, 2))
            if (np.abs(found[-2:]).max(axis=(0, 2)) <= CONVERGED * rows).all():
                return np.asarray(found)
        return None
