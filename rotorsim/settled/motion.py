"""Settled motion of a nonlinear diagram at many runs at once, and its exact derivatives by the free parameters.

Harmonic balance with alternating frequency/time, condensed to the states that enter nonlinearly, by way of the ports
of all the others: X_k = G_k (F_k + g_k),  g = f(t, x) - f(t, 0) - A x. Derivatives follow from the same linear system.

Source: Cameron & Griffin, J. Appl. Mech. 56 (1989) 149-154; Krack & Gross (2019), ch. 2-4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.settled.equations import NonlinearEquations, PortEquations
from rotorsim.settled.ports import FRESH, Ports, open_ports, slow_states

__all__ = ["NonlinearMotion", "Prediction"]

EXTRA_ORDERS, SHARP_ORDERS = 8, 40  # beyond those compared with data
MOST_STEPS = 60  # where a law has corners, as dry friction that nearly sticks, most of them are short
SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.0)  # of a law, in steps, where Newton's method fails at once
SMALLEST_LENGTH = 2.0**-6
CLOSE = 1e-9
SIZES = (1e-6, 1e-4, 1e-2, 1.0, 1e2)  # of states at which it is seen what a law moves: gaps and limits are passed
PROBES = 4  # points of each size
WIDE = 0.1  # relative, of the parameters there


@dataclass(frozen=True, eq=False)
class Prediction:
    """Y (R, K+1, c); slopes dY/dtheta (R, K+1, c, m); dY by the means of slow states of each run, (K+1, c, s).

    settled (R,): whether a periodic motion was found.
    """

    Y: np.ndarray
    slopes: np.ndarray
    by_means: list[np.ndarray]
    settled: np.ndarray


class NonlinearMotion:
    """The settled motion of R runs as a function of the free parameters.

    p (R, n_p), speeds (R,) [rad/s], windows (R,) [s], phase (R,): shaft angle at t = 0. Each solution is the start of
    the next. Modes that are slow against the window need not have settled: the mean of one state for each is given.
    """

    def __init__(
        self,
        equations: NonlinearEquations,
        p: np.ndarray,
        speeds: np.ndarray,
        K: int,
        windows: Sequence[float],
        phase: np.ndarray,
    ) -> None:
        self.equations, self.p, self.speeds, self.K = equations.at(p), p, speeds, K
        self.windows, self.phase = np.asarray(windows, float), phase
        self._resolve(EXTRA_ORDERS)

    def _resolve(self, extra: int) -> None:
        self.H = self.K + extra
        self.count = 1 << int(np.ceil(np.log2(4 * (self.H + 1))))
        step = 2 * np.pi / np.abs(self.speeds) / self.count
        start = -np.sign(self.speeds) * self.phase / np.abs(self.speeds)
        self.times = start[:, None] + step[:, None] * np.arange(self.count)
        self.ports: Ports | None = None
        self.last: np.ndarray | None = None

    def sharpen(self) -> None:
        """Take SHARP_ORDERS more orders from now on: for laws with corners, where it matters."""
        last = self.last
        self._resolve(SHARP_ORDERS)
        if last is not None:
            self.last = np.pad(last, ((0, 0), (0, self.H + 1 - last.shape[1]), (0, 0)))

    def at(self, p: np.ndarray) -> NonlinearMotion:
        """Return the motion at other known parameters p (R, n_p)."""
        return NonlinearMotion(self.equations, p, self.speeds, self.K, list(self.windows), self.phase)

    def predict(self, theta: np.ndarray, means: Sequence[np.ndarray] | None = None) -> Prediction:
        """Return the motion at theta (m,) with slow states at given means (default: zero)."""
        at = _Point(self, self.opened(theta), theta)
        X, settled = self._settle(at, means)
        found = X[:, :, self.inner.S]
        if settled.all():
            self.last = found
        elif self.last is not None:
            self.last = np.where(settled[:, None, None], found, self.last)
        return self._linearised(at, X, settled)

    def means_of_zero(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return zero means of the slow states of each run."""
        return [np.zeros(slow.shape[1]) for slow in self.opened(theta).slow]

    def fresh_means(self, theta: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return which slow states of each run start with it (k,), their means (k,) and d mean / d theta (k, m).

        x' = f - a x from x_0 on has over a window T the mean x_0 g + f T (1 - g) / u,  g = (1 - e^-u) / u,  u = a T.
        """
        self.opened(theta)
        equations, whole = self.equations, self.equations.whole
        x_0 = equations.model.x0(equations.model.p0)[equations.kept]
        found = []
        for r, (slow, T) in enumerate(zip(self.slow, self.windows, strict=True)):
            places = np.flatnonzero(equations.means[slow] == FRESH)
            values, slopes = np.zeros(len(places)), np.zeros((len(places), len(theta)))
            for k, state in enumerate(slow[places]):
                x = np.zeros((equations.n, 2))
                x[state, 1] = 1.0
                point = (
                    self.times[r, :1].repeat(2)[None],
                    x,
                    self.p[r, :, None].repeat(2, 1),
                    theta[:, None].repeat(2, 1),
                )
                f, df = whole.f(*point)[:, state, 0], whole.f_theta(*point)[:, state]
                u, du = (f[0] - f[1]) * T, (df[0] - df[1]) * T
                g, rest = _settling(u)
                values[k] = x_0[state] * g[0] + f[0] * T * rest[0]
                slopes[k] = (x_0[state] * g[1] + f[0] * T * rest[1]) * du + df[0] * T * rest[0]
            found.append((places, values, slopes))
        return found

    def opened(self, theta: np.ndarray) -> Ports:
        """Return the ports of all that no parameter and no nonlinear law moves, found at the first theta (m,)."""
        if self.ports is not None:
            return self.ports
        R, n = len(self.p), self.equations.n
        whole = self.equations.whole
        many = np.repeat(theta[None], R, 0).T
        A = whole.J(self.times[:, 0][None], np.zeros((n, R)), self.p.T, many)
        if not np.isfinite(A).all():
            raise ValueError("the equations are not finite at rest")
        slow = [slow_states(A[r], self.windows[r], self.equations.means) for r in range(R)]
        self.slow = slow
        times = self.times[:, ::8]
        count = times.shape[1]
        at_rest = (np.zeros((n, R * count)), np.repeat(self.p, count, 0).T, np.repeat(theta[None], R * count, 0).T)
        moved = [f(times.reshape(1, -1), *at_rest) for f in (whole.f, whole.f_theta)]
        groups = [values.reshape(len(values), n, -1).transpose(1, 0, 2).reshape(n, -1) for values in moved]
        rng = np.random.default_rng(0)
        changing, changed = self.equations.changing, []
        for size in SIZES:
            few = np.repeat(np.arange(R), PROBES)
            other = theta * (1 + WIDE * rng.uniform(-1, 1, (len(few), len(theta)))) + WIDE * (theta == 0)
            point = (
                rng.choice(self.times.ravel(), len(few))[None],
                size * rng.standard_normal((n, len(few))),
                self.p[few].T,
                other.T,
            )
            with np.errstate(all="ignore"):
                slopes = whole.J(*point)[:, :, changing] - A[few][:, :, changing]
                by_theta = whole.f_theta(*point)
            groups.append(by_theta.transpose(1, 0, 2).reshape(n, -1))
            changed.append(slopes.transpose(1, 0, 2).reshape(n, -1))
        s = 1j * np.abs(self.speeds)[:, None] * np.arange(self.H + 1)
        self.ports = open_ports(A, s, slow, changing, groups, changed)
        self.inner: PortEquations = self.equations.at_ports(self.ports.rows, self.ports.columns)
        return self.ports

    def _settle(self, at: _Point, means: Sequence[np.ndarray] | None) -> tuple[np.ndarray, np.ndarray]:
        """Return X (R, H+1, n) by Newton's method, all runs at once, and whether each has settled."""
        S = self.inner.S
        offset = at.slow_part(means)
        base = np.einsum("rkij,rkj->rki", at.G, at.F) + offset
        if not len(S):
            return base, np.ones(len(self.p), bool)
        C = base[:, :, S].copy() if self.last is None else self.last.copy()
        if self.last is not None:  # a neighbour's motion, or the linear one: whichever is nearer
            fresh = base[:, :, S]
            near, far = (_size(self._residual(at, one, base)[0], one) for one in (fresh, C))
            C[near < far] = fresh[near < far]
        C, forces, settled = self._newton(at, C, base, 1.0)
        if self.last is None and not settled.all():  # let the law grow from nothing
            grown = base[:, :, S].copy()
            for share in SHARES:
                grown = np.where(np.isfinite(grown), grown, base[:, :, S])
                grown, more, found = self._newton(at, grown, base, share)
            late = found & ~settled
            C[late], forces[late], settled = grown[late], more[late], settled | late
        X: np.ndarray = base + np.einsum("rkie,rke->rki", at.G[:, :, :, self.inner.E], forces)
        X[~settled] = np.nan
        return X, settled

    def _newton(
        self, at: _Point, C: np.ndarray, base: np.ndarray, share: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return C, the harmonics of the nonlinear rest, and whether each run has settled; share: of the rest."""
        residual, forces = self._residual(at, C, base, share)
        settled = _size(residual, C) <= CLOSE
        for _ in range(MOST_STEPS):
            if settled.all():
                break
            delta = at.solver(share * self._slopes(at, C)).solve(residual[..., None])[..., 0]
            length = np.where(settled, 0.0, 1.0)
            before = _size(residual, C)
            while True:
                new = C - length[:, None, None] * delta
                trial, trial_forces = self._residual(at, new, base, share)
                worse = ~(_size(trial, new) < (1 - 0.1 * length) * before) & (length > SMALLEST_LENGTH) & ~settled
                if not worse.any():
                    break
                length[worse] /= 2
            C, residual, forces = new, trial, trial_forces
            stuck = (length <= SMALLEST_LENGTH) & ~settled
            settled = settled | (_size(residual, C) <= CLOSE)
            if (stuck | settled).all():
                break
        return C, forces, settled

    def _residual(
        self, at: _Point, C: np.ndarray, base: np.ndarray, share: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return C less what it causes, (R, H+1, S), and the harmonics of the nonlinear rest, (R, H+1, E)."""
        E, S = self.inner.E, self.inner.S
        with np.errstate(all="ignore"):
            x = self._samples(C)
            g = at.rows(x) - at.rest - np.einsum("rms,res->rme", x, at.A_part)
            forces = share * self._harmonics(g)
            found = base[:, :, S] + np.einsum("rkse,rke->rks", at.G[:, :, S[:, None], E], forces)
        return C - found, forces

    def _slopes(self, at: _Point, C: np.ndarray) -> np.ndarray:
        """Return d(rest)/dx_S at the samples, (R, count, E, S)."""
        return np.asarray(at.part(self._samples(C)) - at.A_part[:, None])

    def _linearised(self, at: _Point, X: np.ndarray, settled: np.ndarray) -> Prediction:
        """Return outputs and their derivatives about the motion X (R, H+1, n)."""
        equations, R, K = self.inner, len(self.p), self.K
        safe = np.where(np.isfinite(X), X, 0.0)
        x = self._samples(safe)
        points = at.points(x)
        y = equations.g(*points).reshape(R, self.count, -1)
        C = equations.C(*points).reshape(R, self.count, equations.c, equations.n)
        by_theta = self._harmonics(equations.f_theta(*points).reshape(R, self.count, equations.r, -1))
        widths = [slow.shape[1] for slow in at.ports.slow]
        most = max(widths, default=0)
        direct = np.einsum("rkij,rkjm->rkim", at.G, by_theta)
        direct = np.concatenate([direct, np.zeros((*direct.shape[:3], most), complex)], axis=3)
        for r, width in enumerate(widths):
            direct[r, 0, :, equations.m : equations.m + width] = at.slow_columns(r)
        moved = direct
        if len(equations.S):
            solver = at.solver(self._slopes(at, safe[:, :, equations.S]))
            forces = solver.forces(direct[:, :, equations.S])
            moved = direct + np.einsum("rkie,rkem->rkim", at.G[:, :, :, equations.E], forces)
        in_time = self._samples(moved.reshape(R, self.H + 1, -1)).reshape(R, self.count, equations.n, -1)
        dy = np.einsum("rtcn,rtnm->rtcm", C, in_time)
        dy[..., : equations.m] += equations.g_theta(*points).reshape(R, self.count, equations.c, -1)
        Y = self._harmonics(y)[:, : K + 1]
        dY = self._harmonics(dy)[:, : K + 1]
        Y[~settled] = np.nan
        by_means = [dY[r, :, :, equations.m : equations.m + width] for r, width in enumerate(widths)]
        return Prediction(Y, dY[..., : equations.m], by_means, settled)

    def _samples(self, C: np.ndarray) -> np.ndarray:
        return np.asarray(np.fft.irfft(C * self.count, self.count, axis=1))

    def _harmonics(self, values: np.ndarray) -> np.ndarray:
        return np.asarray(np.fft.rfft(values, axis=1)[:, : self.H + 1] / self.count)


def _settling(u: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return g = (1 - e^-u) / u and (1 - g) / u, each with its derivative by u."""
    if abs(u) < 1e-3:  # three terms of the series: 1e-12
        g, rest = 1 - u / 2 + u**2 / 6 - u**3 / 24, 1 / 2 - u / 6 + u**2 / 24 - u**3 / 120
        return (g, -1 / 2 + u / 3 - u**2 / 8), (rest, -1 / 6 + u / 12 - u**2 / 40)
    g = -np.expm1(-u) / u
    dg = (np.exp(-u) - g) / u
    rest = (1 - g) / u
    return (g, dg), (rest, -(dg + rest) / u)


def _size(residual: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Return the largest residual of each run as part of the largest harmonic of its state, (R,)."""
    scale = np.maximum(np.abs(C).max(axis=1, keepdims=True), 1e-300)
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.abs(residual / scale).max(axis=(1, 2), initial=0.0)
    return np.where(np.isfinite(size), size, np.inf)


class _Point:
    """What the equations are at one theta: A, forcing, and the response G of every run from ports to states."""

    def __init__(self, motion: NonlinearMotion, ports: Ports, theta: np.ndarray) -> None:
        equations, R = motion.inner, len(motion.p)
        self.motion, self.ports, self.equations = motion, ports, equations
        count = motion.count
        self._p = np.repeat(motion.p, count, 0).T
        self._theta = np.repeat(theta[None], R * count, 0).T
        rest = self.points(np.zeros((R, count, equations.n)))
        at_rest = equations.f(*rest).reshape(R, count, equations.r)
        self.F = motion._harmonics(at_rest)
        self.rest = at_rest[:, :, equations.E]
        few = (motion.times[:, 0][None], np.zeros((equations.n, R)), motion.p.T, np.repeat(theta[None], R, 0).T)
        A = equations.J(*few)
        if len(equations.S):
            start = np.zeros((R, motion.H + 1, len(equations.S)), complex) if motion.last is None else motion.last
            start = np.where(np.isfinite(start), start, 0.0)
            mean = self.part(motion._samples(start)).mean(axis=1)
            A[:, equations.E[:, None], equations.S] = mean
        self.A_part = A[:, equations.E[:, None], equations.S]
        self.change = A - ports.within
        self.G = ports.closed(self.change)

    def points(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the arguments of the equations at the samples of motion x (R, count, n)."""
        return self.motion.times.reshape(1, -1), x.reshape(-1, x.shape[2]).T, self._p, self._theta

    def _whole(self, x_S: np.ndarray) -> tuple[np.ndarray, ...]:
        x = np.zeros((*x_S.shape[:2], self.equations.n))
        x[:, :, self.equations.S] = x_S
        return self.points(x)

    def rows(self, x_S: np.ndarray) -> np.ndarray:
        """Return the nonlinear rows of f at samples x_S (R, count, S), (R, count, E)."""
        return self.equations.f_rows(*self._whole(x_S)).reshape(*x_S.shape[:2], -1)

    def part(self, x_S: np.ndarray) -> np.ndarray:
        """Return their Jacobian, (R, count, E, S)."""
        shape = (*x_S.shape[:2], len(self.equations.E), len(self.equations.S))
        return self.equations.J_part(*self._whole(x_S)).reshape(shape)

    def slow_columns(self, r: int) -> np.ndarray:
        """Return dX_0 by the means of slow states of run r, of the linear part, (n, s)."""
        own = self.ports.slow[r]
        return np.asarray(own + self.G[r, 0] @ (self.change[r] @ own))

    def slow_part(self, means: Sequence[np.ndarray] | None) -> np.ndarray:
        """Return what given means of slow states add to X, (R, H+1, n)."""
        out = np.zeros((*self.F.shape[:2], self.equations.n), complex)
        for r in range(len(out)):
            if means is not None and len(means[r]):
                out[r, 0] = self.slow_columns(r) @ means[r]
        return out

    def solver(self, slopes: np.ndarray) -> _Solver:
        """Return the linear system (I - G D) about a motion with these slopes (R, count, E, S)."""
        E, S = self.equations.E, self.equations.S
        return _Solver(self.motion, self.G[:, :, S[:, None], E], slopes)


class _Solver:
    """(I - G D) delta = right in real coefficients a_0, a_k, b_k, by Woodbury's identity over the rank of D.

    delta = right + G U w,  (I - V G U) w = V right,  D = U V.
    """

    def __init__(self, motion: NonlinearMotion, G: np.ndarray, slopes: np.ndarray) -> None:
        self.motion, H = motion, motion.H
        self.U, V = _compressed(slopes)
        self.G = G @ self.U
        R, rank = len(V), V.shape[2]
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

    def forces(self, right: np.ndarray) -> np.ndarray:
        """Return D delta in the rows E for right (R, H+1, S, j): complex harmonics (R, H+1, E, j)."""
        return np.asarray(np.einsum("er,zkrj->zkej", self.U, self._w(right)))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return delta (R, H+1, S, j)."""
        return np.asarray(right + np.einsum("zksr,zkrj->zksj", self.G, self._w(right)))

    def _w(self, right: np.ndarray) -> np.ndarray:
        H = self.motion.H
        R, _, S, j = right.shape
        real = np.concatenate([right[:, :1].real, 2 * right[:, 1:].real, -2 * right[:, 1:].imag], axis=1)
        rank, size = self.T.shape[1], self.T.shape[3]
        flat = self.T.transpose(0, 1, 3, 2, 4).reshape(R, rank * size, S * size)
        w = np.linalg.solve(self.matrix, flat @ real.transpose(0, 2, 1, 3).reshape(R, S * size, j))
        w = w.reshape(R, rank, size, j)
        out = w[:, :, : H + 1].astype(complex)
        out[:, :, 1:] = (w[:, :, 1 : H + 1] - 1j * w[:, :, H + 1 :]) / 2
        return np.asarray(out.transpose(0, 2, 1, 3))


def _product(values: np.ndarray, H: int) -> np.ndarray:
    """Return the matrices by which a factor with these samples (..., count) multiplies real coefficients 0..H.

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


def _compressed(J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return U (E, r), V (R, count, r, S) with J = U V: one force may act in many rows (a coupled mass matrix)."""
    R, count, E, S = J.shape
    rows = J.transpose(2, 0, 1, 3).reshape(E, -1)
    size = np.linalg.norm(rows, axis=1)
    scaled = rows / np.where(size > 0, size, 1.0)[:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    kept = vectors[:, values > 1e-14 * max(values.max(initial=0.0), 1e-300)]
    V = (kept.T @ scaled).reshape(kept.shape[1], R, count, S).transpose(1, 2, 0, 3)
    return size[:, None] * kept, V
