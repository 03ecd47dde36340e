"""One law alone, driven by periodic signals of several runs: what it adds at the ports that its outputs go to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.identification.waveform.driven.equations import DrivenEquations
from rotorsim.model.linearity import is_affine, jacobian
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.balance import harmonics_of, samples_of


@dataclass(frozen=True, eq=False)
class PeriodicLaw:
    """A law alone, of c outputs, n states and m free parameters, x' = A x + b(t, v), y = g(t, x, v).

    taken (c,): of each output the signal whose place it takes, -1 where it is added to what is there.
    """

    equations: DrivenEquations
    taken: np.ndarray

    @cached_property
    def bounds(self) -> np.ndarray:
        """The bounds of its free parameters, (2, m)."""
        return np.array([(item.low, item.high) for item in self.equations.free]).reshape(-1, 2).T

    @cached_property
    def is_known(self) -> bool:
        """Whether its settled motion follows at once: it is linear in its states."""
        return not ca.depends_on(ca.vertcat(0, ca.vec(self._factors)), self.equations.arguments[1])

    def is_affine(self, inputs: Sequence[int]) -> bool:
        """Return whether what it adds is linear in some of its inputs, with a factor that may follow the others."""
        _, x, v, _ = self.equations.arguments
        return is_affine(ca.vertcat(self.equations.f, self.equations.g), ca.vertcat(x, *(v[k] for k in inputs)))

    def within(self, eta: np.ndarray) -> np.ndarray:
        """Return parameters within their bounds."""
        return np.asarray(np.clip(eta, *self.bounds))

    def added(self, eta: np.ndarray, times: np.ndarray, signals: np.ndarray, speeds: np.ndarray, K: int) -> np.ndarray:
        """Return harmonics 0..K of what it adds, and their derivatives by its parameters, (R, K+1, c, 1 + m).

        times (R, N), signals (R, N, s): at equal instants of a period, those that drive it and then others that
        ``taken`` counts; speeds (R,) [rad/s]. Raises LinAlgError where A changes in a turn, or a state does not settle.
        """
        n, m, p = self.equations.n, self.equations.m, self.equations.parameters(self._p, eta)
        (R, N), n_v = times.shape, len(self.equations.inputs)
        x, x_eta = np.zeros((R, N, n)), np.zeros((R, N, n, m))

        def at(functions: MatrixFunction) -> np.ndarray:
            points = times.reshape(1, -1), x.reshape(R * N, n).T, signals[:, :, :n_v].reshape(R * N, n_v).T, p
            return functions(*points).reshape(R, N, *functions.shape)

        if n:
            A = at(self._matrix)
            if np.ptp(A, axis=1).any():
                raise np.linalg.LinAlgError("the factors change in a turn")
            s = 1j * np.abs(speeds)[:, None, None, None] * np.arange(N // 2 + 1)[:, None, None]
            gain = np.linalg.inv(s * np.eye(n) - A[:, :1])
            x = samples_of((gain @ harmonics_of(at(self._rates), N // 2)[:, :, :, :1])[..., 0], N)
            moved = gain @ harmonics_of(at(self._rates)[..., 1 + n :], N // 2)
            x_eta = samples_of(moved.reshape(R, N // 2 + 1, n * m), N).reshape(R, N, n, m)
        y = at(self._outputs)
        slopes = y[..., 1 + n :] + y[..., 1 : 1 + n] @ x_eta
        found = harmonics_of(np.concatenate([y[..., :1], slopes], axis=3), K)
        replaces = self.taken >= 0
        found[:, :, replaces, 0] -= harmonics_of(signals[:, :, self.taken[replaces]], K)
        return found

    @cached_property
    def _p(self) -> np.ndarray:
        return self.equations.model.parameter_vector()

    @cached_property
    def _factors(self) -> Any:
        return jacobian(self.equations.f, self.equations.arguments[1])

    @cached_property
    def _matrix(self) -> MatrixFunction:
        return MatrixFunction(self.equations.arguments, self._factors)

    @cached_property
    def _rates(self) -> MatrixFunction:
        return self._with_slopes(self.equations.f)

    @cached_property
    def _outputs(self) -> MatrixFunction:
        return self._with_slopes(self.equations.g)

    def _with_slopes(self, of: Any) -> MatrixFunction:
        """Return an expression with its derivatives by states and parameters, (k, 1 + n + m)."""
        return MatrixFunction(self.equations.arguments, ca.horzcat(of, self.equations.jacobian(of)))
