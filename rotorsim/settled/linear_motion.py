"""Settled motion of a linear diagram and its derivatives by the free parameters, harmonic by harmonic.

(i k W - A) X_k = F_k + B V_k,  Y_k = C X_k + G_k + D V_k;  all of it differentiated exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rotorsim.settled.linear_equations import Equations
from rotorsim.settled.ports import DENSE, open_ports, slow_states
from rotorsim.settled.resolvent import PortResolvent, Resolvent

__all__ = ["Motion", "PortMotion", "Response", "Torus", "condensed"]

PROBES = 2  # other values of the parameters at which it is seen what they move
WIDE = 0.1  # relative
SAMPLES = 16  # of a turn
CONSTANT = 1e-6  # relative difference of second frequencies that are one
POINTS, TURNS = 3, 50.0  # samples for each coefficient on a torus, over so many turns of the slowest of all
SINGULAR = 1e-12  # part of the largest eigenvalue: combinations so near to each other that samples do not tell them
TOLD = 5.0  # largest logarithm between diagonal entries of a Cholesky factor of combinations that are told well
SWINGS = 3  # multiples of a second frequency that are told apart: an angle that swings by m makes J_n(k m) of order k


@dataclass(eq=False)
class Response:
    """What the equations say at one value of the free parameters, for R runs and orders 0..K.

    A (R, n, n), B (R, n, V), C (R, c, n), D (R, c, V); dA, dB, dC, dD with a last axis m; F (R, K+1, n + c) and dF:
    Fourier coefficients of the forcing of states and outputs.
    resolvent: (i k W - A)^-1; at order 0 of the part without slow states. With ports (`rotorsim.settled.ports`) rows
    of A, B and F are those that carry w, columns the states that matter, and A counts from the reference.
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
    resolvent: Resolvent | PortResolvent
    slow: list[np.ndarray]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Runs, states, outputs."""
        return (self.A.shape[0], self.A.shape[2], self.C.shape[1])

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
        return self.resolvent.slow_columns(r)

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


class Torus:
    """Combinations k W + nu of the shaft with a second frequency, beside the harmonics of R runs.

    orders (L,): k. frequencies (R, L) [rad/s]. forced: whether the diagram moves there; then projection
    (R, K+1+L, N) gives the coefficients at harmonics and combinations of samples at times (R, N).
    """

    def __init__(self, speeds: np.ndarray, K: int, second: np.ndarray, orders: np.ndarray, forced: bool) -> None:
        self.orders, self.forced = orders, forced
        self.K, self.speeds, self.second = K, speeds, second
        self.frequencies = orders * speeds[:, None] + second[:, None]
        if not forced:
            return
        ways = tuple(int(order) for order in orders)
        found = [_projection(float(W), float(nu), K, ways) for W, nu in zip(speeds, second, strict=True)]
        self.times, self.projection = (np.array(parts) for parts in zip(*found, strict=True))

    def at(self, speeds: np.ndarray) -> Torus:
        """Return the combinations at other speeds: the second frequency is constant, or a part of the speed."""
        parts = self.second / np.abs(self.speeds)
        same = np.ptp(self.second) <= CONSTANT * self.second.max()
        second = np.full(len(speeds), self.second.mean()) if same else parts.mean() * np.abs(speeds)
        return Torus(speeds, self.K, second, self.orders, self.forced)


@lru_cache(maxsize=64)
def _projection(speed: float, nu: float, K: int, orders: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return random times (N,), and what gives harmonics and combinations of samples at these, (K+1+L, N)."""
    k, multiples = np.arange(-K, K + 1), np.arange(-SWINGS, SWINGS + 1)
    every = np.array([(order, multiple) for multiple in multiples for order in k])
    zero, first = SWINGS * len(k) + K, (SWINGS + 1) * len(k) + K
    rows = [zero + order for order in range(K + 1)] + [first + int(np.sign(speed)) * order for order in orders]
    speed = abs(speed)
    slowest = min(speed, nu, *np.abs(speed * np.arange(1, 4) - nu))
    longest = 2 * np.pi * TURNS / max(slowest, 1e-3 * speed)
    times = np.random.default_rng(0).uniform(0, longest, POINTS * len(every))
    waves = np.exp(1j * times[:, None] * (every @ (speed, nu)))
    normal = waves.conj().T @ waves
    try:
        factor = cho_factor(normal)
        if np.ptp(np.log(np.abs(np.diag(factor[0])))) < TOLD:
            return times, cho_solve(factor, waves.conj().T)[rows]
    except np.linalg.LinAlgError:
        pass
    return times, np.linalg.pinv(normal, rcond=SINGULAR, hermitian=True)[rows] @ waves.conj().T


class Motion:
    """The settled motion of R runs as a function of the free parameters.

    p: (R, n_p), with the settings and the speed of each run; speeds (R,) [rad/s]; windows (R,) [s]. Modes
    that are slow against the window need not have settled: the mean of one state for each such mode is left free.
    """

    def __init__(
        self,
        equations: Equations,
        p: np.ndarray,
        speeds: np.ndarray,
        K: int,
        windows: Sequence[float],
        phase: np.ndarray,
        beside: Torus | None = None,
    ) -> None:
        self.equations, self.p, self.speeds, self.K = equations.at(p), p, speeds, K
        self.windows, self.phase, self.beside = np.asarray(windows, float), phase, beside
        self.slow: list[np.ndarray] | None = None

    def at(self, p: np.ndarray) -> Motion:
        """Return the motion at other known parameters p (R, n_p)."""
        return Motion(self.equations, p, self.speeds, self.K, list(self.windows), self.phase, self.beside)

    def response(self, theta: np.ndarray, K: int | None = None, *, forced: bool = True) -> Response:
        """Return the equations at theta (m,), for orders 0..K (default: all); not forced: F and dF are zero."""
        K = self.K if K is None else K
        R = len(self.p)
        many = np.repeat(theta[None], R, 0)
        found = {key: matrix(self.p, many) for key, matrix in self.equations.matrices.items()}
        A = found["A"][0]
        n = A.shape[1] + found["C"][0].shape[1]
        rows = self.grid(K).shape[1]
        F, dF = np.zeros((R, rows, n), complex), np.zeros((R, rows, n, len(theta)), complex)
        if forced:
            F, dF = self.forcing(self.equations, many, K)
        if self.slow is None:
            self.slow = [slow_states(A[r], self.windows[r], self.equations.means) for r in range(R)]
        return Response(
            A=A,
            B=found["B"][0],
            C=found["C"][0],
            D=found["D"][0],
            dA=found["A"][1],
            dB=found["B"][1],
            dC=found["C"][1],
            dD=found["D"][1],
            F=F,
            dF=dF,
            resolvent=self._resolvent(A, K),
            slow=self.slow,
        )

    def grid(self, K: int) -> np.ndarray:
        """Return i k W at orders 0..K and, with all of them, at the combinations with a second frequency."""
        s = 1j * np.abs(self.speeds)[:, None] * np.arange(K + 1)
        if self.beside is None or self.K != K:
            return np.asarray(s)
        return np.concatenate([s, 1j * self.beside.frequencies], axis=1)

    def forcing(self, equations: Equations, many: np.ndarray, K: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the forcing of equations and its slopes, from shaft angle zero; many: theta of each run (R, m)."""
        beside = self.beside if K == self.K else None
        if beside is not None and beside.forced:
            F, dF = equations.forcing_beside(self.p, many, beside.projection, beside.times)
        else:
            F, dF = equations.forcing(self.p, many, self.speeds, K)
            more = ((0, 0), (0, 0 if beside is None else beside.orders.shape[0]), (0, 0))
            F, dF = np.pad(F, more), np.pad(dF, (*more, (0, 0)))
        if self.phase.any():  # harmonics count from shaft angle zero, which the clock need not pass at t = 0
            turned = np.sign(self.speeds)[:, None] * np.arange(K + 1)
            if beside is not None:
                turned = np.concatenate([turned, np.tile(beside.orders, (len(turned), 1))], axis=1)
            turn = np.exp(-1j * self.phase[:, None] * turned)
            F, dF = F * turn[:, :, None], dF * turn[:, :, None, None]
        return F, dF

    def _resolvent(self, A: np.ndarray, K: int) -> Resolvent:
        return Resolvent(A, self.grid(K), self.slow or [])


class PortMotion:
    """The same motion by way of the ports of all that no parameter moves: for diagrams of many states.

    Its states are those that matter: `Ports.columns`.
    """

    def __init__(self, motion: Motion, theta: np.ndarray) -> None:
        self.motion, equations = motion, motion.equations
        whole = motion.response(theta, forced=False)
        moved, columns = self._forces(theta), [np.any(whole.C, axis=(0, 1))]
        rng = np.random.default_rng(0)
        for _ in range(PROBES):
            other = theta * (1 + WIDE * rng.uniform(-1, 1, len(theta))) + WIDE * (theta == 0)
            many = np.repeat(other[None], len(motion.p), 0)
            (A, dA), (B, _), (C, _) = (equations.matrices[key](motion.p, many) for key in "ABC")
            columns += [np.any(part, axis=(0, 1)) for part in (A - whole.A, np.any(dA, axis=3), C)]
            moved += [_flat(part) for part in (B, *np.moveaxis(dA, 3, 0))]
        seen = np.flatnonzero(np.any(columns, axis=0))
        self.ports = open_ports(whole.A, motion.grid(motion.K), whole.slow, seen, moved)
        self.equations = equations.at_ports(self.ports.rows, self.ports.columns)

    def _forces(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return samples of the forcing and its slopes, as columns (n, N)."""
        motion, n = self.motion, self.motion.equations.n
        many = np.repeat(theta[None], len(motion.p), 0)
        values, slopes = motion.equations.sampled(motion.p, many, motion.speeds, SAMPLES)
        return [part[:, :, :n].transpose(2, 0, 1, *range(3, part.ndim)).reshape(n, -1) for part in (values, slopes)]

    def response(self, theta: np.ndarray) -> Response:
        """Return the equations at theta (m,)."""
        motion, ports = self.motion, self.ports
        many = np.repeat(theta[None], len(motion.p), 0)
        found = {key: matrix(motion.p, many) for key, matrix in self.equations.matrices.items()}
        F, dF = motion.forcing(self.equations, many, motion.K)
        A = found["A"][0] - ports.within
        return Response(
            A=A,
            B=found["B"][0],
            C=found["C"][0],
            D=found["D"][0],
            dA=found["A"][1],
            dB=found["B"][1],
            dC=found["C"][1],
            dD=found["D"][1],
            F=F,
            dF=dF,
            resolvent=PortResolvent(ports, A),
            slow=[np.arange(m.shape[1]) for m in ports.slow],
        )


def condensed(motion: Motion, theta: np.ndarray) -> Motion | PortMotion:
    """Return the motion by way of its ports, where it has so many states that this is faster."""
    return PortMotion(motion, theta) if motion.equations.n > DENSE else motion


def _flat(matrices: np.ndarray) -> np.ndarray:
    """Return the columns of matrices (R, n, j) side by side, those of zeros left out, (n, N)."""
    flat = matrices.transpose(1, 0, 2).reshape(matrices.shape[1], -1)
    return np.asarray(flat[:, np.any(flat, axis=0)])
