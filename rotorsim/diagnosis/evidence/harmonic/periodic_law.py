"""One law alone, driven by periodic signals of several runs: what it adds at the ports that its outputs go to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.identification.waveform.driven.equations import DrivenEquations
from rotorsim.model.linearity import is_affine
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.balance import harmonics_of, samples_of

STEPPED_TURNS = 20  # of a law with corners, at most: until then, what it began with has died out
STEPPED_SETTLED = 1e-3  # relative change from turn to turn: the steps err by more
STEPPED_NEWTON = 20  # Newton steps in each of them
MOST_SETTLINGS = 12  # of the motion of a law's own states, which are linear but for small terms
SETTLED_STATE = 1e-6  # relative change of these states in an iteration, below which it was the last
NO_STATE = 1e-9  # of the largest of them: a smaller one is rounding of the others


@dataclass(frozen=True, eq=False)
class PeriodicLaw:
    """A law alone, of c outputs, n states and m free parameters, x' = f(t, x, v), y = g(t, x, v).

    Its settled motion is iterated about the mean A of df/dx: x <- (i k W - A)^-1 (f(t, x, v) - A x), order by order;
    in one step where A is constant. Where that does not settle, for a rate has corners, by implicit steps in time.

    taken (c,): of each output the signal whose place it takes, -1 where it is added to what is there.
    """

    equations: DrivenEquations
    taken: np.ndarray

    @cached_property
    def bounds(self) -> np.ndarray:
        """The bounds of its free parameters, (2, m)."""
        return np.array([(item.low, item.high) for item in self.equations.free]).reshape(-1, 2).T

    def is_affine(self, inputs: Sequence[int]) -> bool:
        """Return whether what it adds is linear in some of its inputs, with a factor that may follow the others."""
        _, x, v, _ = self.equations.arguments
        return is_affine(ca.vertcat(self.equations.f, self.equations.g), ca.vertcat(x, *(v[k] for k in inputs)))

    def linear_in(self) -> np.ndarray:
        """Return in which of its parameters, (m,), what it adds is linear, in all of them at once.

        Of a product, as stiffness times friction, it is the first. A step of any size is told then.
        """
        _, x, _, p = self.equations.arguments
        of, linear, found = ca.vertcat(self.equations.f, self.equations.g), list[int](), []
        for slots in self.equations.slots:
            found.append(is_affine(of, p[[*linear, *slots]], x))
            linear += slots if found[-1] else []
        return np.array(found, bool)

    def within(self, eta: np.ndarray) -> np.ndarray:
        """Return parameters within their bounds."""
        return np.asarray(np.clip(eta, *self.bounds))

    def added(self, eta: np.ndarray, times: np.ndarray, signals: np.ndarray, speeds: np.ndarray, K: int) -> np.ndarray:
        """Return harmonics 0..K of what it adds, and their derivatives by its parameters, (R, K+1, c, 1 + m).

        times (R, N), signals (R, N, s): at equal instants of a period, those that drive it and then others that
        ``taken`` counts; speeds (R,) [rad/s]. Raises LinAlgError where its states do not settle.
        """
        n, m, p = self.equations.n, self.equations.m, self.equations.parameters(self._p, eta)
        (R, N), n_v = times.shape, len(self.equations.inputs)

        def at(functions: MatrixFunction, x: np.ndarray) -> np.ndarray:
            points = times.reshape(1, -1), x.reshape(R * N, n).T, signals[:, :, :n_v].reshape(R * N, n_v).T, p
            return functions(*points).reshape(R, N, *functions.shape)

        x, x_eta = np.zeros((R, N, n)), np.zeros((R, N, n, m))
        if n:
            A = at(self._rates, x)[..., 1 : 1 + n].mean(axis=1)
            try:
                x = _settled(lambda x: at(self._rates, x)[..., :1], x[..., None], A, speeds)[..., 0]
                by = at(self._rates, x)[..., 1:]
                x_eta = _settled(lambda moved: by[..., :n] @ moved + by[..., n:], x_eta, A, speeds)
            except np.linalg.LinAlgError:
                driven = [(times[:, k][None], signals[:, k, :n_v].T) for k in range(N)]
                x, x_eta = _stepped(lambda k, x: self._rates(driven[k][0], x.T, driven[k][1], p), x, x_eta, times)
        y = at(self._outputs, x)
        slopes = y[..., 1 + n :] + y[..., 1 : 1 + n] @ x_eta
        found = harmonics_of(np.concatenate([y[..., :1], slopes], axis=3), K)
        replaces = self.taken >= 0
        found[:, :, replaces, 0] -= harmonics_of(signals[:, :, self.taken[replaces]], K)
        return found

    @cached_property
    def _p(self) -> np.ndarray:
        return self.equations.model.parameter_vector()

    @cached_property
    def _rates(self) -> MatrixFunction:
        return self._with_slopes(self.equations.f)

    @cached_property
    def _outputs(self) -> MatrixFunction:
        return self._with_slopes(self.equations.g)

    def _with_slopes(self, of: Any) -> MatrixFunction:
        """Return an expression with its derivatives by states and parameters, (k, 1 + n + m)."""
        return MatrixFunction(self.equations.arguments, ca.horzcat(of, self.equations.jacobian(of)))


def _settled(rates: Callable[[np.ndarray], np.ndarray], x: np.ndarray, A: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Return the settled motion (R, N, n, count) of states from a guess, with A (R, n, n). Raises LinAlgError."""
    R, N, n, _ = x.shape
    s = 1j * np.abs(speeds)[:, None, None, None] * np.arange(N // 2 + 1)[:, None, None]
    gain = np.linalg.inv(s * np.eye(n) - A[:, None])
    for _ in range(MOST_SETTLINGS):
        waves = gain @ harmonics_of(rates(x) - A[:, None] @ x, N // 2)
        before, x = x, samples_of(waves.reshape(R, N // 2 + 1, -1), N).reshape(x.shape)
        change, size = (np.abs(part).max(axis=(0, 1)) for part in (x - before, x))
        if (change <= SETTLED_STATE * np.maximum(size, NO_STATE * size.max(initial=0.0))).all():
            return x
    raise np.linalg.LinAlgError("its states do not settle")


def _stepped(
    rates: Callable[[int, np.ndarray], np.ndarray], x: np.ndarray, x_eta: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the settled motion (R, N, n) of states and its derivatives (R, N, n, m), by steps that damp what is stiff.

    x_k = 4/3 x_k-1 - 1/3 x_k-2 + 2/3 h f_k, the backward formula of order two.

    rates: at an instant k, of states (R, n), with derivatives by states and parameters, (R, n, 1 + n + m). Raises
    LinAlgError.
    """
    (_, N, n), h = x.shape, 2 / 3 * (times[:, 1] - times[:, 0])[:, None, None]
    last, last_eta, eye = x[:, 0].copy(), x_eta[:, 0].copy(), np.eye(n)
    now, by_eta = last, last_eta
    for turn in range(STEPPED_TURNS):
        before = x.copy()
        for k in range(N):
            behind, behind_eta = (4 * now - last) / 3, (4 * by_eta - last_eta) / 3
            last, last_eta = now, by_eta
            tried, from_here, least = now, now, np.full(now.shape, np.inf)
            for _ in range(STEPPED_NEWTON):
                found = rates(k, tried)
                rest = behind - tried + h[..., 0] * found[..., 0]
                worse = np.abs(rest) > least  # beyond a corner: half of the way
                system = eye - h * found[..., 1 : 1 + n]
                full = tried + np.linalg.solve(system, rest[..., None])[..., 0]
                least = np.where(worse, least, np.abs(rest))
                from_here, tried = np.where(worse, from_here, tried), np.where(worse, (from_here + tried) / 2, full)
                if (np.abs(rest) <= SETTLED_STATE * np.abs(tried).max()).all():
                    break
            now = tried
            by_eta = np.linalg.solve(system, behind_eta + h * found[..., 1 + n :])
            x[:, k], x_eta[:, k] = now, by_eta
        if turn and (np.abs(x - before) <= STEPPED_SETTLED * np.abs(x).max(axis=(0, 1))).all():
            return x, x_eta
    raise np.linalg.LinAlgError("its states do not settle")
