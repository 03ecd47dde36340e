"""Settled motion of a linear diagram and its derivatives by the free parameters, harmonic by harmonic.

(i k W - A) X_k = F_k + B V_k,  Y_k = C X_k + G_k + D V_k;  all of it differentiated exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.identify.functions import Equations
from rotorsim.identify.resolvent import Resolvent

__all__ = ["Motion", "Response"]

SLOW = 5.0  # a mode that decays by less than e^-5 over the window may still move the mean


@dataclass(eq=False)
class Response:
    """What the equations say at one value of the free parameters, for R runs and orders 0..K.

    A (R, n, n), B (R, n, V), C (R, c, n), D (R, c, V); dA, dB, dC, dD with a last axis m; F (R, K+1, n + c) and dF:
    Fourier coefficients of the forcing of states and outputs.
    resolvent: (i k W - A)^-1; at order 0 of the part without slow states.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dA: np.ndarray
    dB: np.ndarray
    dC: np.ndarray
    dD: np.ndarray
    F: np.ndarray
    dF: np.ndarray
    resolvent: Resolvent
    slow: list[np.ndarray]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Runs, states, outputs."""
        return (*self.A.shape[:2], self.C.shape[1])

    def states(self, inputs: np.ndarray | None = None) -> np.ndarray:
        """Return X (R, K+1, n) for inputs V (R, K+1, V), slow states at zero mean."""
        n = self.A.shape[1]
        right = self.F[:, :, :n]
        if inputs is not None and inputs.shape[2]:
            right = right + np.einsum("rnv,rkv->rkn", self.B, inputs)
        return np.asarray(self.resolvent.apply(right[..., None])[..., 0])

    def outputs(self, X: np.ndarray, inputs: np.ndarray | None = None) -> np.ndarray:
        """Return Y (R, K+1, c) of states X."""
        n = self.A.shape[1]
        Y = np.einsum("rcn,rkn->rkc", self.C, X) + self.F[:, :, n:]
        if inputs is not None and inputs.shape[2]:
            Y = Y + np.einsum("rcv,rkv->rkc", self.D, inputs)
        return np.asarray(Y)

    def transfer(self) -> np.ndarray:
        """Return dY/dV (R, K+1, c, V)."""
        return np.asarray(self.C[:, None] @ self.resolvent.apply(self.B[:, None].astype(complex)) + self.D[:, None])

    def slow_states(self, r: int) -> np.ndarray:
        """Return dX_0/dx_s of the slow states of run r, shape (n, s)."""
        slow = self.slow[r]
        columns = np.zeros((self.A.shape[1], len(slow)))
        if len(slow):
            columns = (self.resolvent.at_zero[r] @ self.A[r][:, slow]).real
            columns[slow, np.arange(len(slow))] = 1.0
        return columns

    def sensitivity(self, X: np.ndarray, inputs: np.ndarray | None = None) -> np.ndarray:
        """Return dY (R, K+1, c, m) by the free parameters at states X and inputs, which stay as they are."""
        n = self.A.shape[1]
        right = self.dF[:, :, :n] + _by_parameters(self.dA, X)
        direct = self.dF[:, :, n:] + _by_parameters(self.dC, X)
        if inputs is not None and inputs.shape[2]:
            right = right + _by_parameters(self.dB, inputs)
            direct = direct + _by_parameters(self.dD, inputs)
        dX = self.resolvent.apply(right)
        return np.asarray(self.C[:, None] @ dX + direct)


def _by_parameters(slopes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return sum over j of slopes (R, i, j, m) values (R, k, j), as (R, k, i, m)."""
    R, rows, columns, m = slopes.shape
    flat = slopes.transpose(0, 1, 3, 2).reshape(R, rows * m, columns)
    return np.asarray((values @ flat.transpose(0, 2, 1)).reshape(R, values.shape[1], rows, m))


class Motion:
    """The settled motion of R runs as a function of the free parameters.

    p: (R, n_p), with the settings and the speed of each run; speeds (R,) [rad/s]; windows (R,) [s]. Modes
    that are slow against the window need not have settled: the mean of one state for each such mode is left free.
    """

    def __init__(
        self, equations: Equations, p: np.ndarray, speeds: np.ndarray, K: int, windows: Sequence[float],
        phase: np.ndarray,
    ) -> None:  # fmt: skip
        self.equations, self.p, self.speeds, self.K = equations, p, speeds, K
        self.windows, self.phase = np.asarray(windows, float), phase
        self.slow: list[np.ndarray] | None = None

    def at(self, p: np.ndarray) -> Motion:
        """Return the motion at other known parameters p (R, n_p)."""
        return Motion(self.equations, p, self.speeds, self.K, list(self.windows), self.phase)

    def response(self, theta: np.ndarray, K: int | None = None, *, forced: bool = True) -> Response:
        """Return the equations at theta (m,), for orders 0..K (default: all); not forced: F and dF are zero."""
        K = self.K if K is None else K
        R = len(self.p)
        many = np.repeat(theta[None], R, 0)
        found = {key: matrix(self.p, many) for key, matrix in self.equations.matrices.items()}
        A = found["A"][0]
        n = A.shape[1] + found["C"][0].shape[1]
        F, dF = np.zeros((R, K + 1, n), complex), np.zeros((R, K + 1, n, len(theta)), complex)
        if forced:
            F, dF = self.equations.forcing(self.p, many, self.speeds, K)
            if self.phase.any():  # harmonics count from shaft angle zero, which the clock need not pass at t = 0
                turn = np.exp(-1j * (np.sign(self.speeds) * self.phase)[:, None] * np.arange(K + 1))
                F, dF = F * turn[:, :, None], dF * turn[:, :, None, None]
        if self.slow is None:
            self.slow = [slow_states(A[r], self.windows[r]) for r in range(R)]
        return Response(
            A=A, B=found["B"][0], C=found["C"][0], D=found["D"][0],
            dA=found["A"][1], dB=found["B"][1], dC=found["C"][1], dD=found["D"][1],
            F=F, dF=dF, resolvent=self._resolvent(A, K), slow=self.slow,
        )  # fmt: skip

    def _resolvent(self, A: np.ndarray, K: int) -> Resolvent:
        s = 1j * np.abs(self.speeds)[:, None] * np.arange(K + 1)
        return Resolvent(A, s, self.slow or [])


def slow_states(A: np.ndarray, window: float) -> np.ndarray:
    """Return one state for each mode that is slow against the window: those that take part in them most.

    Their mean may be anything after a start at any time; a free integrator has no mean at all.
    """
    values, right = np.linalg.eig(A)
    slow = np.flatnonzero(np.abs(values) < SLOW / window)
    if not len(slow):
        return np.zeros(0, int)
    left = np.linalg.pinv(right)
    share = np.abs(right * left.T)[:, slow].sum(axis=1)
    return np.sort(np.argsort(-share, kind="stable")[: len(slow)])
