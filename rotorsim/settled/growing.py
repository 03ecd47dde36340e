"""What a machine does at 1X while a state that starts with the run grows: exactly, by the poles of the machine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ive

from rotorsim.settled.balance import harmonics_of, samples_of
from rotorsim.settled.nonlinear import NonlinearMotion

DEGREES = 4  # of the Legendre polynomials by which a course over a run is known
FORCE_INSTANTS = 16  # of a turn: its orders up to seven do not alias
MODES = 1e-9  # of the largest entry of A: what its modes make of it
FAST = 1e4  # argument of Bessel functions from which two terms of their series are good to 1e-6
LEAST_RATE = 1e-6  # over the window of a run: slower growth is a ramp


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine of R runs linearised about its last motion, beside one state of it that grows.

    speeds, windows (R,). x' = A x + 2 Re F e^{i theta} (that state): poles (R, n - 1) [rad/s] of A, V^-1 A V =
    diag(poles); outputs (R, c, n - 1): C V, of the means of A and C over a turn; inverse (R, n - 1, n - 1): V^-1.
    """

    speeds: np.ndarray
    windows: np.ndarray
    poles: np.ndarray
    outputs: np.ndarray
    inverse: np.ndarray

    @classmethod
    def of(cls, motion: NonlinearMotion, theta: np.ndarray, states: np.ndarray) -> Machine:
        """Return the machine beside one state of each run, states (R,): their places among those of the equations.

        Raises LinAlgError where its modes are no base: two in a chain have one pole.
        """
        whole, n = motion.equations.whole, motion.equations.n
        times, x = _instants(motion)
        every = []
        for r, state in enumerate(states):
            point = times[r][None], x[r].T, np.repeat(motion.p[r][:, None], FORCE_INSTANTS, 1), theta
            others = np.delete(np.arange(n), state)
            A = whole.J(*point).reshape(-1, n, n).mean(axis=0)[np.ix_(others, others)]
            C = whole.C(*point).reshape(FORCE_INSTANTS, -1, n).mean(axis=0)[:, others]
            poles, V, inverse = _modes(np.ascontiguousarray(A).tobytes(), n - 1)
            every.append((poles, C @ V, inverse))
        return cls(np.abs(motion.speeds), motion.windows, *(np.array([part[k] for part in every]) for k in range(3)))

    def courses(self, F: np.ndarray, laws: np.ndarray) -> np.ndarray:
        """Return the Legendre coefficients (R, DEGREES + 1, c) of 1X over the runs; at degree 0 beyond the mean's.

        A state x' = f - a x from x_0 on is f / a + d e^{-a t},  d = x_0 - f / a. 1X of each pole p answers to it with
        d [e^{-a t} / (i W - a - p) + e^{-(i W - p) t} (1 / (i W - p) - 1 / (i W - a - p))], the second of which is how
        it settles from what it was before. F (R, n): `forces`. laws (R, 3): x_0, f and a of each run.
        """
        x_0, f, rate = laws.T
        rate = np.where(np.abs(rate) * self.windows < LEAST_RATE, LEAST_RATE / self.windows, rate)
        d, away = x_0 - f / rate, 1j * self.speeds[:, None] - self.poles
        shares = self.outputs * (self.inverse @ F[..., None])[:, None, :, 0]
        lag = 1 / (away - rate[:, None]) - 1 / away
        found = np.empty((len(F), DEGREES + 1, shares.shape[1]), complex)
        for n in range(DEGREES + 1):
            decay, settling = (decay_course(u * self.windows[:, None], n) for u in (rate[:, None] + 0j, away))
            course = (decay - settling) * lag + (decay / away if n else 0.0)
            found[:, n] = d[:, None] * (shares @ course[..., None])[..., 0]
        return found


def forces(motion: NonlinearMotion, theta: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return the force F (R, n - 1) of a state of one in the rows of the other states: 2 Re F e^{i theta}."""
    whole, n, R = motion.equations.whole, motion.equations.n, len(motion.p)
    times, x = _instants(motion)
    more = x.copy()
    more[np.arange(R), :, states] += 1.0
    p = np.repeat(motion.p, FORCE_INSTANTS, 0).T
    with_more, without = (whole.f(times.reshape(1, -1), of.reshape(-1, n).T, p, theta) for of in (more, x))
    F = harmonics_of((with_more - without).reshape(R, FORCE_INSTANTS, n), 1)[:, 1]
    return np.array([np.delete(F[r], state) for r, state in enumerate(states)])


def _instants(motion: NonlinearMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return instants (R, N) of a turn and the states (R, N, n) of the last motion that enter nonlinearly there."""
    every = motion.count // FORCE_INSTANTS
    times = motion.times[:, ::every]
    if motion.last is None:
        return times, np.zeros((*times.shape, motion.equations.n))
    return times, samples_of(motion.nonlinear_states(motion.last), motion.count)[:, ::every]


@lru_cache(maxsize=64)
def _modes(matrix: bytes, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    A = np.frombuffer(matrix).reshape(n, n)
    poles, V = np.linalg.eig(A)
    inverse = np.linalg.inv(V)
    if np.abs((V * poles) @ inverse - A).max() > MODES * np.abs(A).max():
        raise np.linalg.LinAlgError("modes of the machine are no base of its motion")
    return poles + 0j, V + 0j, inverse + 0j


def decay_course(u: np.ndarray, n: int) -> np.ndarray:
    """Return the Legendre coefficient of degree n of e^{-u t}, t from 0 to 1, for complex u.

    (2 n + 1) (-1)^n e^{-u/2} i_n(u / 2),  i_n: modified spherical Bessel function of the first kind.
    """
    z = np.where(np.abs(u) < LEAST_RATE, LEAST_RATE, u) / 2
    side = np.where(z.real < 0, -1.0, 1.0)  # i_n(-z) = (-1)^n i_n(z)
    w, far = side * z, np.abs(z) > FAST
    near = np.where(far, 1.0, w)
    scaled = np.sqrt(np.pi / (2 * near)) * ive(n + 0.5, near) * np.exp(-1j * near.imag)  # e^-w i_n(w)
    first = n * (n + 1) / (2 * w)
    scaled = np.where(far, (1 - first - (-1) ** n * np.exp(-2 * w) * (1 + first)) / (2 * w), scaled)
    return np.asarray((2 * n + 1) * (-1) ** n * side**n * np.exp(w - z) * scaled)
