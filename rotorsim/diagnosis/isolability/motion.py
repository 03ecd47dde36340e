"""The settled motion of a diagram without data, and its exact slopes, where the diagram is linear about it.

(i k W - A) X_k = F_k,  dX_k = (i k W - A)^-1 (df/dtheta)_k along the motion: exact at a fault of no size, also of a
nonlinear one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram, Endpoint, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import compile_diagram
from rotorsim.settled.equations import Equations
from rotorsim.settled.nonlinear import NonlinearMotion
from rotorsim.settled.resolvent import resolvent_of
from rotorsim.settled.slow_states import slow_states

__all__ = ["ORDERS", "SECOND", "LinearMotion", "NoSignatureError", "Runs"]

SECOND = "second "  # before the name of a signal that is measured once more
ORDERS = 14
H = 20  # orders of the motion itself
COUNT = 128  # samples of a turn
WINDOW = 10.0  # s: modes that decay slower leave the mean open
NEVER = 1e6  # s: within this a free integrator still does not settle
PROBES = (0.137, 0.618)  # instants, in turns, that are compared one turn later
CONSTANT = 1e-9


class NoSignatureError(Exception):
    """A fault has no signature; the text says why."""


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs that are compared: speeds (R,) [rad/s], settings of each, and which set of gains (R,); gains: in words."""

    speeds: np.ndarray
    settings: tuple[Mapping[str, float], ...]
    sets: np.ndarray
    gains: str = ""


class LinearMotion:
    """The settled motion of a diagram in all runs, as a function of some free parameters theta (m,)."""

    def __init__(
        self,
        diagram: Diagram,
        signals: Sequence[str],
        runs: Runs,
        free: Sequence[Free],
        responses: dict[bytes, np.ndarray],
    ) -> None:
        ports = {name.partition("[")[0].removeprefix(SECOND) for name in signals if name.startswith(SECOND)}
        ends = [Endpoint(block, port) for block, _, port in (name.rpartition(".") for name in ports)]
        said = {Endpoint(SECOND + end.block, end.port): end for end in ends}
        named = replace(diagram, measured={**diagram.measured, **said})
        self.model = compile_diagram(named)
        if self.model.n_z:
            raise RotorsimError(Problem("has a sample time, which harmonics of linear equations do not show"))
        self.all, self.signals = Equations(self.model, signals, free), tuple(signals)
        self.equations = self.all.whole
        self.p = np.array([self.model.parameter_vector(one) for one in runs.settings])
        self.speeds, self.responses = np.abs(runs.speeds), responses
        self.times = 2 * np.pi / self.speeds[:, None] * np.arange(COUNT) / COUNT

    def _points(self, x: np.ndarray, theta: np.ndarray, which: Any = slice(None)) -> tuple[np.ndarray, ...]:
        """Return the arguments of the equations at some samples of the motion x (R, count, n)."""
        times, x = self.times[:, which], x[:, which]
        N = times.size
        many = np.repeat(self.p, times.shape[1], 0).T, np.repeat(theta[None], N, 0).T
        return times.reshape(1, N), x.reshape(N, -1).T, *many

    def is_periodic(self, theta: np.ndarray) -> bool:
        """Return whether the forcing of the first run is the same one turn later."""
        return bool(self._repeats(theta).all())

    def wandering(self, theta: np.ndarray) -> frozenset[str]:
        """Return the signals that do not repeat turn by turn whatever the states do, such as angles."""
        repeats = self._repeats(theta)[self.equations.n :]
        return frozenset(name for name, same in zip(self.signals, repeats, strict=True) if not same)

    def _repeats(self, theta: np.ndarray) -> np.ndarray:
        """Return whether each rate and signal of the first run is the same one turn later, states at zero, (n + c,)."""
        at = np.array([k + probe for k in (0, 1) for probe in PROBES]) * 2 * np.pi / self.speeds[0]
        few = at[None], np.zeros((self.equations.n, 4)), np.repeat(self.p[:1], 4, 0).T, np.repeat(theta[None], 4, 0).T
        f = np.concatenate([self.equations.f(*few), self.equations.g(*few)], axis=1)
        size = np.abs(f).max(axis=0)
        least = 1e-6 * np.maximum(size, 1e-9 * size.max(initial=0.0))
        return np.asarray(np.abs(f[2:] - f[:2]).max(axis=0) <= least)

    def linear(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return Y (R, K+1, c) and dY (R, K+1, c, m); None where the equations are not linear about this motion."""
        equations, R = self.equations, len(self.p)
        with np.errstate(all="ignore"):
            f0 = equations.f(*self._points(np.zeros((R, COUNT, equations.n)), theta)).reshape(R, COUNT, -1)
            A = self._jacobian(theta)
            if not (np.isfinite(f0).all() and np.isfinite(A).all()):
                return None
            G = self._response(A)
            x = np.fft.irfft(np.einsum("rkij,rkj->rki", G, _harmonics(f0)) * COUNT, COUNT, axis=1)
            points = self._points(x, theta)
            if not self._stays(points, f0, A, x):
                return None
        f_theta = _harmonics(equations.f_theta(*points).reshape(R, COUNT, equations.n, -1))
        some = equations.C(*self._points(x, theta, [0, COUNT // 3])).reshape(R, 2, equations.c, -1)
        if not np.allclose(some[:, 0], some[:, 1], rtol=CONSTANT, atol=0.0):
            return None
        dY = some[:, :1] @ (G @ f_theta)[:, : ORDERS + 1]
        dY = dY + _harmonics(equations.g_theta(*points).reshape(R, COUNT, equations.c, -1))[:, : ORDERS + 1]
        return _harmonics(equations.g(*points).reshape(R, COUNT, -1))[:, : ORDERS + 1], dY

    def nonlinear(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return Y and dY by harmonic balance, None where no settled motion is found."""
        runs = len(self.p)
        motion = NonlinearMotion(self.all, self.p, self.speeds, ORDERS, np.full(runs, WINDOW), np.zeros(runs))
        try:
            with np.errstate(all="ignore"):
                found = motion.predict(theta)
        except np.linalg.LinAlgError:  # a fault that lets nothing settle at these speeds
            return None
        dY = found.sensitivity()
        good = found.settled.all() and np.isfinite(found.Y).all() and np.isfinite(dY).all()
        return (found.Y, dY) if good else None

    def open_means(self, theta: np.ndarray) -> np.ndarray:
        """Return dY (R, K+1, c, s) by the means of states that have no time to settle."""
        A = self._jacobian(theta)
        zero = np.zeros((len(A), COUNT, self.equations.n))
        C = self.equations.C(*self._points(zero, theta, [0]))
        found = []
        for r in range(len(A)):
            slow = slow_states(A[r], WINDOW, self.all.means)
            rest = np.setdiff1d(np.arange(A.shape[1]), slow)
            states = np.zeros((A.shape[1], len(slow)))
            states[slow, np.arange(len(slow))] = 1.0
            states[rest] = -np.linalg.solve(A[r][np.ix_(rest, rest)], A[r][np.ix_(rest, slow)])
            column = np.zeros((len(A), ORDERS + 1, self.equations.c, len(slow)), complex)
            column[r, 0] = C[r] @ states
            found.append(column)
        return np.concatenate(found, axis=3)

    def _jacobian(self, theta: np.ndarray) -> np.ndarray:
        R = len(self.p)
        at = self.times[:, 0][None], np.zeros((self.equations.n, R)), self.p.T, np.repeat(theta[None], R, 0).T
        return self.equations.J(*at)

    def _stays(self, points: tuple[np.ndarray, ...], f0: np.ndarray, A: np.ndarray, x: np.ndarray) -> bool:
        """Return whether f = f0 + A x with the same A all along the motion."""
        equations, shape = self.equations, x.shape[:2]
        size = np.einsum("rij,rtj->rti", np.abs(A), np.abs(x)) + np.abs(f0)
        wrong = np.abs(equations.f(*points).reshape(f0.shape) - f0 - np.einsum("rij,rtj->rti", A, x))
        if not (wrong.max(axis=(0, 1)) <= CONSTANT * size.max(axis=(0, 1))).all():
            return False
        E, S = equations.places
        part = equations.J_part(*points).reshape(*shape, len(E), len(S))
        expected = A[:, E[:, None], S][:, None]
        return bool((np.abs(part - expected) <= CONSTANT * np.abs(A).max(initial=0.0)).all())

    def _response(self, A: np.ndarray) -> np.ndarray:
        """Return (i k W - A)^-1, (R, H+1, n, n), at order 0 without states that never settle."""
        key = A.tobytes()
        if key not in self.responses:
            s = 1j * self.speeds[:, None] * np.arange(H + 1)
            if len(self.responses) > 8:
                self.responses.pop(list(self.responses)[1])  # the first is that of the diagram itself
            self.responses[key] = resolvent_of(A, s, [slow_states(one, NEVER) for one in A]).gain
        return self.responses[key]


def _harmonics(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.fft.rfft(values, axis=1)[:, : H + 1] / COUNT)
