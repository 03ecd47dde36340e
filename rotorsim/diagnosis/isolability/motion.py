"""The settled motion of a diagram without data and its exact sensitivities, where the diagram is linear about it.

(i k W - A) X_k = F_k,  dX_k = (i k W - A)^-1 (df/dtheta)_k along the motion: exact at a fault of no size, also of a
nonlinear one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorsim.diagnosis.isolability.runs import Runs
from rotorsim.diagram.diagram import Diagram, Endpoint, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.equations import Equations
from rotorsim.settled.nonlinear import NonlinearMotion
from rotorsim.settled.resolvent import resolvent_of
from rotorsim.settled.slow_states import slow_states

REPEATED_SENSOR = "second "  # before the name of a signal that is measured once more
CONSIDERED_ORDERS = 14
H = 20  # orders of the motion itself
COUNT = 128  # samples of a turn
MEAN_WINDOW = 10.0  # s: modes that decay slower leave the mean open
NEVER = 1e6  # s: within this a free integrator still does not settle
PERIODICITY_INSTANTS = (0.137, 0.618)  # instants, in turns, that are compared one turn later
FORCING_TOLERANCE = 1e-9
CACHED_RESOLVENTS = 8  # resolvents: many faults do not change the diagram's own


class LinearMotion:
    """The settled motion of a diagram in R runs, as a function of m free parameters theta (m,).

    resolvents: those of equal diagrams, by their Jacobians; shared by the motions of many faults.
    """

    def __init__(
        self,
        diagram: Diagram,
        signals: Sequence[str],
        runs: Runs,
        free: Sequence[Free],
        resolvents: dict[bytes, np.ndarray],
    ) -> None:
        ports = (
            name.partition("[")[0].removeprefix(REPEATED_SENSOR) for name in signals if name.startswith(REPEATED_SENSOR)
        )
        ends = [Endpoint(block, port) for block, _, port in (name.rpartition(".") for name in ports)]
        second = {Endpoint(REPEATED_SENSOR + end.block, end.port): end for end in ends}
        model = compile_diagram(replace(diagram, measured={**diagram.measured, **second}))
        if model.n_z:
            raise RotorsimError(Problem("has a sample time, which harmonics of linear equations do not show"))
        self.all, self.signals = Equations(model, signals, free), tuple(signals)
        self.equations, self.resolvents = self.all.whole, resolvents
        self.p = np.array([model.parameter_vector(one) for one in runs.settings])
        self.speeds = np.abs(runs.speeds)
        self.times = 2 * np.pi / self.speeds[:, None] * np.arange(COUNT) / COUNT

    def _values(
        self, function: MatrixFunction, theta: np.ndarray, times: np.ndarray, x: np.ndarray | None = None
    ) -> np.ndarray:
        """Return a function of the equations (R, N, rows, columns) at times (R, N) of the first R runs.

        x (R, N, n): states, default zero.
        """
        R, N = times.shape
        states = np.zeros((self.equations.n, R * N)) if x is None else x.reshape(R * N, -1).T
        values = function(times.reshape(1, -1), states, np.repeat(self.p[:R], N, 0).T, theta)
        return values.reshape(R, N, *function.shape)

    def is_periodic(self, theta: np.ndarray) -> bool:
        """Return whether the forcing of the first run is the same one turn later."""
        return bool(self._repeats(theta).all())

    def aperiodic(self, theta: np.ndarray) -> frozenset[str]:
        """Return the signals that do not repeat turn by turn whatever the states do, such as angles."""
        repeats = self._repeats(theta)[self.equations.n :]
        return frozenset(name for name, same in zip(self.signals, repeats, strict=True) if not same)

    def _repeats(self, theta: np.ndarray) -> np.ndarray:
        """Return whether each rate and signal of the first run is the same one turn later, states at zero, (n + c,)."""
        times = (
            np.array([[turn + probe for turn in (0, 1) for probe in PERIODICITY_INSTANTS]]) * 2 * np.pi / self.speeds[0]
        )
        values = [self._values(function, theta, times) for function in (self.equations.f, self.equations.g)]
        f = np.concatenate(values, axis=2)[0, :, :, 0]
        size = np.abs(f).max(axis=0)
        least = 1e-6 * np.maximum(size, 1e-9 * size.max(initial=0.0))
        return np.asarray(np.abs(f[2:] - f[:2]).max(axis=0) <= least)

    def linear(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return Y (R, K+1, c) and dY (R, K+1, c, m); None where equations are not linear there, or singular."""
        equations, times = self.equations, self.times
        with np.errstate(all="ignore"):
            f0, A = self._values(equations.f, theta, times)[..., 0], self._jacobian(theta)
            if not (np.isfinite(f0).all() and np.isfinite(A).all()):
                return None
            try:
                gain = self._resolvent(A)
            except np.linalg.LinAlgError:  # a constant state, or one at an order, that nothing determines
                return None
            x = np.fft.irfft((gain @ _harmonics(f0, H)[..., None])[..., 0] * COUNT, COUNT, axis=1)
            if not self._is_linear(theta, f0, A, x):
                return None
        few = [0, COUNT // 3]
        C = self._values(equations.C, theta, times[:, few], x[:, few])
        if not np.allclose(C[:, 0], C[:, 1], rtol=FORCING_TOLERANCE, atol=0.0):
            return None
        f_theta, g_theta = (self._values(part, theta, times, x) for part in (equations.f_theta, equations.g_theta))
        dY = C[:, :1] @ (gain[:, : CONSIDERED_ORDERS + 1] @ _harmonics(f_theta, CONSIDERED_ORDERS)) + _harmonics(
            g_theta, CONSIDERED_ORDERS
        )
        return _harmonics(self._values(equations.g, theta, times, x)[..., 0], CONSIDERED_ORDERS), dY

    def _is_linear(self, theta: np.ndarray, f0: np.ndarray, A: np.ndarray, x: np.ndarray) -> bool:
        """Return whether f = f0 + A x with the same A all along the motion x (R, N, n)."""
        transposed, (E, S) = A.swapaxes(1, 2), self.equations.places
        size = np.abs(x) @ np.abs(transposed) + np.abs(f0)
        wrong = np.abs(self._values(self.equations.f, theta, self.times, x)[..., 0] - f0 - x @ transposed)
        if not (wrong.max(axis=(0, 1)) <= FORCING_TOLERANCE * size.max(axis=(0, 1))).all():
            return False
        change = self._values(self.equations.J_part, theta, self.times, x) - A[:, None, E[:, None], S]
        return bool((np.abs(change) <= FORCING_TOLERANCE * np.abs(A).max(initial=0.0)).all())

    def nonlinear(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return Y and dY by harmonic balance, None where no settled motion is found."""
        runs = len(self.p)
        motion = NonlinearMotion(self.all, self.p, self.speeds, CONSIDERED_ORDERS, np.full(runs, NEVER), np.zeros(runs))
        try:
            with np.errstate(all="ignore"):
                predicted = motion.predict(theta)
        except np.linalg.LinAlgError:  # a fault that lets nothing settle at these speeds
            return None
        Y, dY = predicted.Y, predicted.sensitivity()
        return (Y, dY) if predicted.settled.all() and np.isfinite(Y).all() and np.isfinite(dY).all() else None

    def open_means(self, theta: np.ndarray) -> np.ndarray:
        """Return dY (R, K+1, c, s) by the means of states that have no time to settle."""
        A = self._jacobian(theta)
        resolvent = resolvent_of(A, np.zeros((len(A), 1)), [slow_states(one, MEAN_WINDOW, self.all.means) for one in A])
        C = self._values(self.equations.C, theta, self.times[:, :1])[:, 0]
        columns = [C[r] @ resolvent.slow[r] for r in range(len(A))]
        dY = np.zeros((len(A), CONSIDERED_ORDERS + 1, self.equations.c, sum(own.shape[1] for own in columns)), complex)
        ends = np.cumsum([0, *(own.shape[1] for own in columns)])
        for r, own in enumerate(columns):
            dY[r, 0, :, ends[r] : ends[r + 1]] = own
        return dY

    def _jacobian(self, theta: np.ndarray) -> np.ndarray:
        return self._values(self.equations.J, theta, self.times[:, :1])[:, 0]

    def _resolvent(self, A: np.ndarray) -> np.ndarray:
        """Return (i k W - A)^-1, (R, H+1, n, n), at order 0 without states that never settle."""
        key = A.tobytes()
        if key not in self.resolvents:
            if len(self.resolvents) >= CACHED_RESOLVENTS:
                self.resolvents.popitem()
            s = 1j * self.speeds[:, None] * np.arange(H + 1)
            self.resolvents[key] = resolvent_of(A, s, [slow_states(one, NEVER) for one in A]).gain
        return self.resolvents[key]


def _harmonics(values: np.ndarray, orders: int) -> np.ndarray:
    """Return the harmonics 0..orders of samples of a turn (R, N, ...)."""
    return np.asarray(np.fft.rfft(values, axis=1)[:, : orders + 1] / COUNT)
