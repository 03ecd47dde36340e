"""The settled motion of a nonlinear diagram at many runs at once, by harmonic balance through the ports of the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.settled.balance import Balance, Tangent, harmonics_of, samples_of
from rotorsim.settled.equations import Equations, PortEquations
from rotorsim.settled.floquet import growth_rate
from rotorsim.settled.laws import Pair, by_parameters, column_of
from rotorsim.settled.motion import FreshMeans, Prediction, SettledMotion
from rotorsim.settled.ports import Ports, open_ports
from rotorsim.settled.resolvent import Resolvent
from rotorsim.settled.slow_states import FRESH, slow_states
from rotorsim.settled.torus import Torus

EXTRA_ORDERS, SHARP_ORDERS = 8, 40  # beyond those compared with data
BALANCE_TOLERANCE = 1e-9  # relative residual of a settled motion
SIZES = (1e-6, 1e-4, 1e-2, 1.0, 1e2)  # of states at which it is seen what a law moves: gaps and limits are passed
POINTS_PER_SIZE = 4  # points of each size
PARAMETER_SPREAD = 0.1  # relative, of the parameters there
TOLD_FORCES = 1e-6  # of the largest singular value: of directions of forces that outputs tell


@dataclass(eq=False)
class NonlinearMotion(SettledMotion):
    """The settled motion of a nonlinear diagram; each solution is the start of the next.

    measured (R, K+1, c): harmonics of the outputs as they were measured; the first solution may start with these.
    """

    measured: np.ndarray | None = None

    is_linear = False
    corrections = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        self._resolve(EXTRA_ORDERS)

    def _resolve(self, extra: int) -> None:
        self.H = self.K + extra
        self.count = 1 << int(np.ceil(np.log2(4 * (self.H + 1))))
        step = 2 * np.pi / np.abs(self.speeds) / self.count
        self.start = -np.sign(self.speeds) * self.phase / np.abs(self.speeds)
        self.times = self.start[:, None] + step[:, None] * np.arange(self.count)
        self._p = np.repeat(self.p, self.count, 0).T
        self.ports: Ports | None = None
        self.tangent: Tangent | None = None  # about the last motion

    def sharpen(self) -> bool:
        """Take SHARP_ORDERS more orders from now on: for laws with corners, where it matters."""
        self._resolve(SHARP_ORDERS)
        self.last = None if self.last is None else self._padded(self.last)
        return True

    def _padded(self, C: np.ndarray) -> np.ndarray:
        C = C[:, : self.H + 1]
        return np.pad(C, ((0, 0), (0, self.H + 1 - C.shape[1]), (0, 0)))

    def elsewhere(self, p: np.ndarray, speeds: np.ndarray, K: int, r: int, beside: Torus | None) -> NonlinearMotion:
        """Return the motion of other runs, which were not measured; see `SettledMotion`."""
        return replace(super().elsewhere(p, speeds, K, r, beside), measured=None)

    def reading(self, equations: Equations) -> NonlinearMotion:
        """Return the motion with other outputs, which were not measured."""
        return replace(self, equations=equations, measured=None)

    def begin_from(self, other: SettledMotion, runs: np.ndarray, theta: np.ndarray) -> None:
        """Start the search for each motion from that of a run (R,) of another one, where it has the same states."""
        self.opened(theta)
        if other.last is not None and other.last.shape[2] == len(self.inner.places[1]):
            self.last = self._padded(other.last[runs])

    def predict(
        self, theta: np.ndarray, means: Sequence[np.ndarray] | None = None, inputs: np.ndarray | None = None
    ) -> Prediction:
        """Return the motion at theta (m,); there are no measured inputs."""
        ports = self.opened(theta)
        laws = self.inner.split.steady(self.p, np.repeat(theta[None], len(self.p), 0))
        balance, response = self._balance(ports, theta, means or (), laws)
        X, settled = balance.base, np.ones(len(self.p), bool)
        if len(balance.S):
            start = self._start(balance, theta) if self.last is None else balance.nearer(self.last)
            solution = balance.solve(start, BALANCE_TOLERANCE, grow=self.last is None, known=self.tangent)
            X, settled = balance.states(solution), solution.settled
            X[~settled] = np.nan
        C = X[:, :, balance.S]
        if settled.all():
            self.last = C
        elif self.last is not None:
            self.last = np.where(settled[:, None, None], C, self.last)
        return self._linearised(balance, response, X, settled, theta, means or (), laws)

    def _start(self, balance: Balance, theta: np.ndarray) -> np.ndarray:
        """Return states (R, H+1, S) to begin with: of the linear motion and the measured one that which is nearer.

        Measured: with the forces in the rows of the nonlinear laws that explain most of the outputs that are linear in
        the states. Where an amplifier is saturated for half of a turn the linear motion leads nowhere.
        """
        linear = balance.base[:, :, balance.S]
        if self.measured is None:
            return linear
        inner, (R, _, n) = self.inner, balance.base.shape
        at_rest = self._points(np.zeros((R, self.count, n)), theta)
        C = inner.C(*at_rest).reshape(R, self.count, inner.c, n)[:, 0]
        Y = (C[:, None] @ balance.base[..., None])[..., 0]
        Y += harmonics_of(inner.g(*at_rest).reshape(R, self.count, -1), self.H)
        plain = [k for k in range(inner.c) if k not in inner.changing_outputs]
        orders = slice(1, self.K + 1)  # means are seldom those of the sensors
        effect = C[:, None, plain] @ balance.G[:, orders]
        measured = self.measured[:, orders, plain]
        size = np.linalg.norm(measured, axis=1, keepdims=True)[..., None]  # metres beside amperes
        size = np.where(size > 0, size, 1.0)
        missing = (measured - Y[:, orders, plain])[..., None] / size
        forces = np.linalg.pinv(effect / size, rcond=TOLD_FORCES) @ missing
        near = linear.copy()
        near[:, orders] += (balance.G[:, orders, balance.S] @ forces)[..., 0]
        return balance.nearer(near)

    def slow_states(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return the slow states of each run, as they are where the ports were opened."""
        self.opened(theta)
        return self.slow

    def fresh_means(self, theta: np.ndarray) -> list[FreshMeans]:
        """Return the means of slow states that start with the run.

        x' = f - a x from x_0 on has over a window T the mean x_0 g + f T (1 - g) / u,  g = (1 - e^-u) / u,  u = a T.
        """
        self.opened(theta)
        equations, whole = self.equations, self.equations.whole
        x_0 = equations.model.x0(equations.model.p0)[equations.kept]
        every = []
        for r, (slow, T) in enumerate(zip(self.slow, self.windows, strict=True)):
            places = np.flatnonzero(equations.means[slow] == FRESH)
            values, jacobian = np.zeros(len(places)), np.zeros((len(places), len(theta)))
            laws = np.zeros((len(places), 3))
            for k, state in enumerate(slow[places]):
                x = np.zeros((equations.n, 2))
                x[state, 1] = 1.0
                point = self.times[r, :1], x, self.p[r], theta
                f, df = whole.f(*point)[:, state, 0], whole.f_theta(*point)[:, state]
                u, du = (f[0] - f[1]) * T, (df[0] - df[1]) * T
                g, rest = _settling(u)
                values[k] = x_0[state] * g[0] + f[0] * T * rest[0]
                jacobian[k] = (x_0[state] * g[1] + f[0] * T * rest[1]) * du + df[0] * T * rest[0]
                laws[k] = x_0[state], f[0], u / T
            every.append(FreshMeans(len(slow), places, values, jacobian, slow[places], laws))
        return every

    def growth(self, theta: np.ndarray) -> np.ndarray:
        """Return the largest growth rate [1/s] of a disturbance of the motions that were found last, (R,)."""
        rates = np.full(len(self.p), -np.inf)
        if self.last is None or self.ports is None:
            return rates
        X = self.nonlinear_states(self.last)
        for r, speed in enumerate(np.abs(self.speeds)):
            rates[r] = growth_rate(self.equations.whole, float(speed), self.p[r], X[r], theta, float(self.start[r]))
        return rates

    def nonlinear_states(self, last: np.ndarray) -> np.ndarray:
        """Return harmonics (R, H+1, n) of states: of those that enter nonlinearly, last (R, H+1, S), others zero."""
        assert self.ports is not None
        X = np.zeros((*last.shape[:2], self.equations.n), complex)
        X[:, :, self.ports.columns[self.inner.places[1]]] = last
        return X

    def opened(self, theta: np.ndarray) -> Ports:
        """Return the ports of all that no parameter and no nonlinear law moves, seen at the first theta (m,)."""
        if self.ports is not None:
            return self.ports
        R, n = len(self.p), self.equations.n
        whole = self.equations.whole
        A = whole.J(self.times[:, 0][None], np.zeros((n, R)), self.p.T, np.repeat(theta[None], R, 0).T)
        if not np.isfinite(A).all():
            raise ValueError("the equations are not finite at rest")
        runs = zip(A, self.windows, strict=True)
        self.slow = [slow_states(matrix, window, self.equations.means) for matrix, window in runs]
        values = whole.sampled(self.p, np.repeat(theta[None], R, 0), self.times[:, ::8])
        moved = [np.moveaxis(part[:, :, :n], 2, 0).reshape(n, -1) for part in values]
        moved.append(_side_by_side(whole.B(self.times[:, 0][None], np.zeros((n, R)), self.p.T, theta)))
        rng = np.random.default_rng(0)
        changing, changed = self.equations.changing, []
        few = np.repeat(np.arange(R), POINTS_PER_SIZE)
        for size in SIZES:
            other = theta * (1 + PARAMETER_SPREAD * rng.uniform(-1, 1, (len(few), len(theta)))) + PARAMETER_SPREAD * (
                theta == 0
            )
            times = rng.choice(self.times.ravel(), len(few))[None]
            point = times, size * rng.standard_normal((n, len(few))), self.p[few].T, other.T
            with np.errstate(all="ignore"):
                change = whole.J(*point)[:, :, changing] - A[few][:, :, changing]
                moved.append(_side_by_side(whole.f_theta(*point)))
                if whole.inputs_change:
                    moved.append(_side_by_side(whole.B(*point)))
            changed.append(_side_by_side(change))
        s = 1j * np.abs(self.speeds)[:, None] * np.arange(self.H + 1)
        self.ports = open_ports(A, s, self.slow, changing, moved, changed)
        self.inner: PortEquations = self.equations.at_ports(self.ports.rows, self.ports.columns)
        return self.ports

    def _points(self, x: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the arguments of the equations at the samples of motion x (R, count, n)."""
        return self.times.reshape(1, -1), x.reshape(-1, x.shape[2]).T, self._p, theta

    def _balance(
        self, ports: Ports, theta: np.ndarray, means: Sequence[np.ndarray], laws: dict[str, Pair]
    ) -> tuple[Balance, Resolvent]:
        """Return the equations at theta, to be balanced about the mean Jacobian of the last motion."""
        inner, R, count = self.inner, len(self.p), self.count
        E, S = inner.places
        split = inner.split
        all_A, all_B = (laws[key][0] for key in "AB")
        A_part, B_part = all_A[:, E[:, None], S], all_B[:, E[:, None], split.moving]

        def whole(x_S: np.ndarray) -> tuple[np.ndarray, ...]:
            x = np.zeros((R, count, inner.n))
            x[:, :, S] = x_S
            return self._points(x, theta)

        def moving(x_S: np.ndarray) -> np.ndarray:
            return split.w_moving(*whole(x_S)).reshape(R, count, -1)

        def jacobian(x_S: np.ndarray) -> np.ndarray:
            slopes = split.w_x(*whole(x_S))[:, :, S].reshape(R, count, -1, len(S))
            return np.asarray(A_part[:, None] + B_part[:, None] @ slopes)

        w = split.w(*whole(np.zeros((R, count, len(S))))).reshape(R, count, -1)
        at_rest, still = w @ all_B.swapaxes(1, 2), w[:, :, split.moving]
        A = inner.J(self.times[:, 0][None], np.zeros((inner.n, R)), self.p.T, theta)
        if len(S):
            near = np.zeros((R, self.H + 1, len(S)), complex) if self.last is None else np.nan_to_num(self.last)
            A[:, E[:, None], S] = jacobian(samples_of(near, count)).mean(axis=1)
        response = ports.closed(A - ports.within)
        base = (response.gain @ harmonics_of(at_rest, self.H)[..., None])[..., 0]
        for r, values in enumerate(means):
            base[r, 0] += response.slow[r] @ values

        def rows(x_S: np.ndarray) -> np.ndarray:
            return np.asarray(x_S @ A_part.swapaxes(1, 2) + (moving(x_S) - still) @ B_part.swapaxes(1, 2))

        part, none = A[:, E[:, None], S], np.zeros((R, count, len(E)))
        return Balance(rows, jacobian, none, part, response.gain[:, :, :, E], base, S), response

    def _linearised(
        self,
        balance: Balance,
        response: Resolvent,
        X: np.ndarray,
        settled: np.ndarray,
        theta: np.ndarray,
        means: Sequence[np.ndarray],
        laws: dict[str, Pair],
    ) -> Prediction:
        """Return outputs and their derivatives about the motion X (R, H+1, n)."""
        inner, R, K, count = self.inner, len(self.p), self.K, self.count
        safe = np.where(np.isfinite(X), X, 0.0)
        x = samples_of(safe, count)
        points = self._points(x, theta)
        C = inner.C(*points).reshape(R, count, inner.c, inner.n)
        tangent = balance.tangent(safe[:, :, balance.S]) if len(balance.S) else None
        self.tangent = tangent if settled.all() else None

        def outputs(moved: np.ndarray, direct: np.ndarray | float = 0.0) -> np.ndarray:
            """Return harmonics of outputs (R, K+1, c, j) where states would move by (R, H+1, n, j) without the law."""
            if tangent is not None:
                moved = moved + balance.G @ tangent.forces(moved[:, :, balance.S])
            in_time = samples_of(moved.reshape(R, self.H + 1, -1), count).reshape(R, count, inner.n, -1)
            return harmonics_of(C @ in_time + direct, K)

        def sensitivity() -> np.ndarray:
            w = inner.split.w(*points).reshape(R, count, -1)
            w_theta = inner.split.w_theta(*points).reshape(*w.shape, -1)
            moved = by_parameters(laws["A"][1], x) + column_of(laws["B"], w, w_theta)[1]
            by_theta = harmonics_of(moved, self.H)
            return outputs(response.gain @ by_theta, inner.g_theta(*points).reshape(R, count, inner.c, -1))

        def answers(added: np.ndarray, which: Sequence[int]) -> np.ndarray:
            there = points if inner.inputs_change else (self.times[:, :1].T, np.zeros((inner.n, R)), self.p.T, theta)
            B, D = (slopes(*there)[:, :, [*which]].reshape(R, -1, rows, len(which)) for slopes, rows in by_inputs)
            in_time = samples_of(added.reshape(R, added.shape[1], -1), count).reshape(R, count, len(which), -1)
            return outputs(response.gain @ harmonics_of(B @ in_time, self.H), D @ in_time)

        by_inputs = (inner.B, inner.r), (inner.D, inner.c)
        Y = harmonics_of(inner.g(*points).reshape(R, count, -1), K)
        Y[~settled] = np.nan
        by_means = [np.zeros((K + 1, inner.c, 0), complex)] * R
        if any(columns.shape[1] for columns in response.slow):
            rested = np.zeros((R, self.H + 1, inner.n, max(columns.shape[1] for columns in response.slow)), complex)
            for r, columns in enumerate(response.slow):
                rested[r, 0, :, : columns.shape[1]] = columns
            widths = (columns.shape[1] for columns in response.slow)
            by_means = [own[..., :width] for own, width in zip(outputs(rested), widths, strict=True)]
        none = np.zeros((*Y.shape, 0), complex)
        return Prediction(Y, settled, means, by_means, sensitivity, answers, lambda: none)


def _side_by_side(matrices: np.ndarray) -> np.ndarray:
    """Return the columns of matrices (N, n, k), (n, N k)."""
    return np.asarray(matrices.transpose(1, 0, 2).reshape(matrices.shape[1], -1))


def _settling(u: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return g = (1 - e^-u) / u and (1 - g) / u, each with its derivative by u."""
    if abs(u) < 1e-3:  # three terms of the series: 1e-12
        g, rest = 1 - u / 2 + u**2 / 6 - u**3 / 24, 1 / 2 - u / 6 + u**2 / 24 - u**3 / 120
        return (g, -1 / 2 + u / 3 - u**2 / 8), (rest, -1 / 6 + u / 12 - u**2 / 40)
    g = -np.expm1(-u) / u
    dg = (np.exp(-u) - g) / u
    rest = (1 - g) / u
    return (g, dg), (rest, -(dg + rest) / u)
