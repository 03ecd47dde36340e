"""Harmonic balance with alternating frequency/time, condensed to the states that enter nonlinearly, many runs at once.

The right-hand side is split, dx/dt = A x + F(t) + g(t, x), with A constant. Rows E and columns S of the few equations
and states that are nonlinear are where g and the Jacobian of g are not zero. The harmonics obey X_k = G_k (F_k + g_k),
G_k = (i k W I - A)^-1; only those of x_S are unknown, the others follow. Newton's method uses the exact Jacobian,
sampled over the period; derivatives of the motion follow from the same linear system (implicit function theorem).

Source: Cameron & Griffin, J. Appl. Mech. 56 (1989) 149-154 (alternating frequency/time); Krack & Gross,
Harmonic Balance for Nonlinear Vibration Problems (2019), ch. 2-4 (condensation, continuation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lu_solve
from scipy.linalg.lapack import dgetrf as getrf

MOST_NEWTON_STEPS = 60  # where a law has corners, as dry friction that nearly sticks, most of them are short
SMALLEST_LENGTH = 2.0**-6  # part of a Newton step
STALLED_RESIDUAL = 1e-9  # relative residual, below which rounding may keep it from falling
CHORD = 0.25  # of the residual, that a step with an earlier system may leave: six decades in ten steps, else a new one
NEAR = 1e-2  # relative residual, below which the linear system of an earlier motion is tried
SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.0)  # of a law, in steps, where Newton's method fails at once


@dataclass(frozen=True, eq=False)
class Solution:
    """Harmonics C (R, H+1, S) of x_S, those of g in the rows E (R, H+1, E), and whether each run has settled (R,).

    residual (R, H+1, S); steps of Newton's method; reason: why a run has not settled, if one has not.
    """

    C: np.ndarray
    forces: np.ndarray
    settled: np.ndarray
    residual: np.ndarray
    steps: int
    reason: str


@dataclass(frozen=True, eq=False)
class Balance:
    """C = base + share G g(C), for R runs, orders 0..H, at N samples of a period.

    rows, jacobian: return f in the rows E, (R, N, E), and its derivatives (R, N, E, S), at samples x_S (R, N, S).
    rest (R, N, E): f there at x = 0; A (R, E, S): the part of A. G (R, H+1, n, E): all states by forces in the rows E;
    base (R, H+1, n): all states without g. S: places of x_S in n.
    """

    rows: Callable[[np.ndarray], np.ndarray]
    jacobian: Callable[[np.ndarray], np.ndarray]
    rest: np.ndarray
    A: np.ndarray
    G: np.ndarray
    base: np.ndarray
    S: np.ndarray

    def states(self, solution: Solution) -> np.ndarray:
        """Return the harmonics of all states, (R, H+1, n)."""
        return np.asarray(self.base + (self.G @ solution.forces[..., None])[..., 0])

    def nearer(self, C: np.ndarray) -> np.ndarray:
        """Return C with the linear motion of those runs where it is the nearer one."""
        linear = self.base[:, :, self.S]
        near, far = (relative_size(self.residual(one)[0], one) for one in (linear, C))
        return np.where((near < far)[:, None, None], linear, C)

    def solve(self, start: np.ndarray, tolerance: float, *, grow: bool, known: Tangent | None = None) -> Solution:
        """Return the solution from a start (R, H+1, S); grow: where Newton's method fails, let g grow from nothing.

        known: the linear system about a motion nearby.
        """
        first = self.newton(start, tolerance, known=known)
        if first.settled.all() or not grow:
            return first
        linear = self.base[:, :, self.S]
        grown, steps = linear, first.steps
        for share in SHARES:
            last = self.newton(np.where(np.isfinite(grown), grown, linear), tolerance, share)
            grown, steps = last.C, steps + last.steps
        late = (last.settled & ~first.settled)[:, None, None]
        return Solution(
            C=np.where(late, last.C, first.C),
            forces=np.where(late, last.forces, first.forces),
            settled=first.settled | last.settled,
            residual=np.where(late, last.residual, first.residual),
            steps=steps,
            reason=first.reason,
        )

    def newton(self, C: np.ndarray, tolerance: float, share: float = 1.0, known: Tangent | None = None) -> Solution:
        """Return where Newton's method gets from C, its steps shortened until the residual falls; share: of g.

        A linear system is kept as long as the residual falls to CHORD of itself, since most of what it costs is its
        making. known: one to begin with, if C is near.
        """
        residual, forces = self.residual(C, share)
        size = relative_size(residual, C)
        settled = size <= tolerance
        tangent = known if known is not None and known.G.shape[:3] == C.shape and (size <= NEAR).all() else None
        reason = f"not done after {MOST_NEWTON_STEPS} Newton steps"
        for step in range(MOST_NEWTON_STEPS + 1):
            if settled.all() or step == MOST_NEWTON_STEPS:
                break
            fresh = tangent is None
            try:
                tangent = self.tangent(C, share) if tangent is None else tangent
                delta = tangent.solve(residual[..., None])[..., 0]
            except np.linalg.LinAlgError:
                if not fresh:
                    tangent = None
                    continue
                reason = "Newton's equations are singular: a fold or a branching of the motion"
                break
            length = np.where(settled, 0.0, 1.0)
            before = relative_size(residual, C)
            while fresh:
                new = C - length[:, None, None] * delta
                trial, trial_forces = self.residual(new, share)
                falls = (relative_size(trial, new) < (1 - 0.1 * length) * before) | (before <= STALLED_RESIDUAL)
                worse = ~falls & (length > SMALLEST_LENGTH) & ~settled
                if not worse.any():
                    break
                length[worse] /= 2
            if not fresh:
                new = C - length[:, None, None] * delta
                trial, trial_forces = self.residual(new, share)
                if (settled | (relative_size(trial, new) <= CHORD * before)).all():
                    C, residual, forces = new, trial, trial_forces
                    settled = settled | (relative_size(residual, C) <= tolerance)
                else:
                    tangent = None
                continue
            small = (relative_size(delta, C) <= tolerance) & (length == 1.0)
            C, residual, forces = new, trial, trial_forces
            if not (settled | (relative_size(residual, C) <= CHORD * before)).all():
                tangent = None
            stuck = (length <= SMALLEST_LENGTH) & ~settled
            settled = settled | small | (relative_size(residual, C) <= tolerance)
            if (stuck | settled).all() and not settled.all():
                reason = "Newton's method stalls in a minimum of the residual"
                break
        if not np.isfinite(residual).all():
            reason = "the motion is not finite any more"
        return Solution(C, forces, settled, residual, step, reason)

    def residual(self, C: np.ndarray, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return C less what it causes, (R, H+1, S), and the harmonics of g in the rows E, (R, H+1, E)."""
        with np.errstate(all="ignore"):
            x = samples_of(C, self.rest.shape[1])
            g = self.rows(x) - self.rest - x @ self.A.swapaxes(1, 2)
            forces = share * harmonics_of(g, C.shape[1] - 1)
            return C - self.base[:, :, self.S] - (self.G[:, :, self.S] @ forces[..., None])[..., 0], forces

    def tangent(self, C: np.ndarray, share: float = 1.0) -> Tangent:
        """Return the linear system about C."""
        J = self.jacobian(samples_of(C, self.rest.shape[1])) - self.A[:, None]
        return Tangent(self.G[:, :, self.S], share * J)


class Tangent:
    """(I - G D) delta = right, D the derivatives of g, in real coefficients: a_0 + a_k cos k tau + b_k sin k tau.

    By Woodbury's identity over the rank of D = U V: delta = right + G U w, (I - V G U) w = V right.
    G (R, H+1, S, E); samples of the derivatives J (R, N, E, S).
    """

    def __init__(self, G: np.ndarray, J: np.ndarray) -> None:
        self.U, V = _factors(J)
        self.G = G @ self.U
        R, rank, H = len(V), V.shape[2], G.shape[1] - 1
        size = 2 * H + 1
        self.T = _product(V.transpose(0, 2, 3, 1), H)
        a, b = self.T[..., 1 : H + 1], self.T[..., H + 1 :]
        P, Q = self.G.real, self.G.imag  # (R, H+1, S, rank)
        matrix = np.empty((R, rank, size, rank, size))
        matrix[..., 0] = np.einsum("resq,rsf->reqf", self.T[..., 0], P[:, 0])
        matrix[..., 1 : H + 1] = _paired(a, P[:, 1:]) - _paired(b, Q[:, 1:])
        matrix[..., H + 1 :] = _paired(a, Q[:, 1:]) + _paired(b, P[:, 1:])
        whole = np.eye(rank * size) - matrix.reshape(R, rank * size, rank * size)
        self.matrix = np.where(np.isfinite(whole), whole, 0.0)

    @cached_property
    def _lu(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The factors of I - V G U of each run, for all right-hand sides. Raises LinAlgError."""
        factors = [getrf(one) for one in self.matrix]
        if any(info > 0 for *_, info in factors):
            raise np.linalg.LinAlgError("singular matrix")
        return [(lu, pivots) for lu, pivots, _ in factors]

    def forces(self, right: np.ndarray) -> np.ndarray:
        """Return D delta in the rows E for right (R, H+1, S, j): complex harmonics (R, H+1, E, j)."""
        return np.asarray(self.U @ self._w(right))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return delta (R, H+1, S, j)."""
        return np.asarray(right + self.G @ self._w(right))

    def _w(self, right: np.ndarray) -> np.ndarray:
        H, (R, _, S, j) = right.shape[1] - 1, right.shape
        real = np.concatenate([right[:, :1].real, 2 * right[:, 1:].real, -2 * right[:, 1:].imag], axis=1)
        rank, size = self.T.shape[1], self.T.shape[3]
        flat = self.T.transpose(0, 1, 3, 2, 4).reshape(R, rank * size, S * size)
        V_right = flat @ real.transpose(0, 2, 1, 3).reshape(R, S * size, j)
        w = np.stack([lu_solve(lu, own, check_finite=False) for lu, own in zip(self._lu, V_right, strict=True)])
        w = w.reshape(R, rank, size, j)
        out = w[:, :, : H + 1].astype(complex)
        out[:, :, 1:] = (w[:, :, 1 : H + 1] - 1j * w[:, :, H + 1 :]) / 2
        return np.asarray(out.transpose(0, 2, 1, 3))


def _product(values: np.ndarray, H: int) -> np.ndarray:
    """Return the matrices by which a factor with these samples (..., N) multiplies real coefficients 0..H.

    (..., 2H+1, 2H+1); with V the Fourier coefficients of the factor, v cos l has (V_(k-l) + V_(k+l)) / 2 at order k.
    """
    V = np.fft.fft(values, axis=-1) / values.shape[-1]
    k, orders = np.arange(1, H + 1)[:, None], np.arange(1, H + 1)
    minus, plus = V[..., k - orders], V[..., k + orders]
    alone = V[..., 1 : H + 1]
    T = np.empty((*values.shape[:-1], 2 * H + 1, 2 * H + 1))
    T[..., 0, 0] = V[..., 0].real
    T[..., 1 : H + 1, 0], T[..., H + 1 :, 0] = 2 * alone.real, -2 * alone.imag
    T[..., 0, 1 : H + 1], T[..., 0, H + 1 :] = alone.real, -alone.imag
    T[..., 1 : H + 1, 1 : H + 1] = (minus + plus).real
    T[..., H + 1 :, 1 : H + 1] = -(minus + plus).imag
    T[..., 1 : H + 1, H + 1 :] = (minus - plus).imag
    T[..., H + 1 :, H + 1 :] = (minus - plus).real
    return T


def _paired(T: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Return sum over s of T (R, e, s, q, k) G (R, k, s, f), as (R, e, q, f, k)."""
    return np.asarray(np.einsum("resqk,rksf->reqfk", T, G, optimize=True))


def _factors(J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return U (E, r), V (R, N, r, S) with J = U V: one force may act in many rows (a coupled mass matrix)."""
    R, count, E, S = J.shape
    rows = J.transpose(2, 0, 1, 3).reshape(E, -1)
    size = np.linalg.norm(rows, axis=1)
    scaled = rows / np.where(size > 0, size, 1.0)[:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    kept = vectors[:, values > 1e-14 * max(values.max(initial=0.0), 1e-300)]
    V = (kept.T @ scaled).reshape(kept.shape[1], R, count, S).transpose(1, 2, 0, 3)
    return size[:, None] * kept, V


def samples_of(C: np.ndarray, count: int) -> np.ndarray:
    """Return the signals of harmonics C (R, H+1, n) at equal instants of a period, (R, count, n)."""
    return np.asarray(np.fft.irfft(C * count, count, axis=1))


def harmonics_of(values: np.ndarray, H: int) -> np.ndarray:
    """Return the harmonics 0..H of samples of a period (R, N, ...)."""
    return np.asarray(np.fft.rfft(values, axis=1)[:, : H + 1] / values.shape[1])


def relative_size(residual: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Return the largest residual of each run as part of the largest harmonic of its state, (R,)."""
    scale = np.maximum(np.abs(C).max(axis=1, keepdims=True), 1e-300)
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.abs(residual / scale).max(axis=(1, 2), initial=0.0)
    return np.where(np.isfinite(size), size, np.inf)
