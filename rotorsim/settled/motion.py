"""The settled motion of many runs and its exact derivatives by the free parameters; directly where it is linear.

(i k W - A) X_k = F_k + B V_k,  Y_k = C X_k + G_k + D V_k;  all of it differentiated exactly.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.settled.equations import Equations, PortEquations, instants
from rotorsim.settled.laws import Pair, by_parameters, column_of
from rotorsim.settled.ports import Ports, open_ports
from rotorsim.settled.resolvent import Resolvent, resolvent_of
from rotorsim.settled.slow_states import slow_states
from rotorsim.settled.torus import Torus

DENSE = 24  # states up to which matrices of all states are as fast as ports
PARAMETER_POINTS = 2  # other values of the parameters at which it is seen what they move
PARAMETER_SPREAD = 0.1  # relative
SAMPLES = 16  # of a turn


@dataclass(frozen=True, eq=False)
class Prediction:
    """The settled motion at one value of the free parameters, at orders 0..K and the lines beside them, (R, lines, ..).

    Y (R, lines, c): outputs. settled (R,): whether a periodic motion exists. means: of each run, those of its slow
    states (s,), as they were given; by_means: dY by them, (lines, c, s). sensitivity: returns dY/dtheta
    (R, lines, c, m). answers: returns what small harmonics (R, K+1, v, j) of some external inputs, v of V, change at
    orders 0..K, (R, K+1, c, j): linear in their real and imaginary parts. by_inputs: returns dY by the inputs of a
    linear diagram, (R, lines, c, V), order by order.
    """

    Y: np.ndarray
    settled: np.ndarray
    means: Sequence[np.ndarray]
    by_means: Sequence[np.ndarray]
    sensitivity: Callable[[], np.ndarray]
    answers: Callable[[np.ndarray, Sequence[int]], np.ndarray]
    by_inputs: Callable[[], np.ndarray]


@dataclass(frozen=True, eq=False)
class FreshMeans:
    """Slow states of one run that start with it: their places (k,), means (k,) and d mean / d theta (k, m).

    count: of all slow states of the run. states (k,): the same places among all states. laws (k, 3): x_0, f and a of
    x' = f - a x.
    """

    count: int
    places: np.ndarray
    values: np.ndarray
    jacobian: np.ndarray
    states: np.ndarray
    laws: np.ndarray

    def start(self, near: np.ndarray | None) -> np.ndarray:
        """Return means (count,) to begin with: those known, the others as they were before, or zero."""
        means = np.zeros(self.count) if near is None else near.copy()
        means[self.places] = self.values
        return means


@dataclass(eq=False)
class SettledMotion(ABC):
    """The settled motion of R runs as a function of the free parameters theta (m,).

    p (R, n_p): settings and speed of each run; speeds (R,) [rad/s]; orders 0..K; windows (R,) [s]; phase (R,): shaft
    angle at t = 0. Modes that are slow against the window need not have settled: the mean of one state for each such
    mode is given. beside: lines of an asynchronous frequency. last (R, H+1, S): harmonics of the states that enter
    nonlinearly, as they were found last.
    """

    equations: Equations
    p: np.ndarray
    speeds: np.ndarray
    K: int
    windows: np.ndarray
    phase: np.ndarray
    beside: Torus | None = None
    last: np.ndarray | None = field(default=None, init=False)

    is_linear: ClassVar[bool]
    corrections: ClassVar[int]  # of means and inputs until they are right: one where the motion is linear in them

    def __post_init__(self) -> None:
        self.equations = self.equations.at(self.p)

    def at(self, p: np.ndarray) -> Self:
        """Return the motion at other known parameters p (R, n_p)."""
        return replace(self, p=p)

    def elsewhere(self, p: np.ndarray, speeds: np.ndarray, K: int, r: int, beside: Torus | None) -> Self:
        """Return the motion of other runs, which were not measured: p (n, n_p), speeds (n,), as long as run r."""
        windows, phase = (np.full(len(speeds), values[r]) for values in (self.windows, self.phase))
        return replace(self, p=p, speeds=speeds, K=K, windows=windows, phase=phase, beside=beside)

    def reading(self, equations: Equations) -> Self:
        """Return the motion with other outputs; equations: of the same diagram and parameters, with these."""
        return replace(self, equations=equations)

    @abstractmethod
    def predict(
        self, theta: np.ndarray, means: Sequence[np.ndarray] | None = None, inputs: np.ndarray | None = None
    ) -> Prediction:
        """Return the motion with slow states at given means, and measured inputs (R, lines, V); default: zero."""

    @abstractmethod
    def slow_states(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return the slow states of each run, of those that the equations keep, as they are at the first theta (m,)."""

    @abstractmethod
    def fresh_means(self, theta: np.ndarray) -> list[FreshMeans]:
        """Return the means that are known of the slow states of each run: of those that start with it."""

    @abstractmethod
    def growth(self, theta: np.ndarray) -> np.ndarray:
        """Return the largest growth rate [1/s] of a disturbance of the motion of every run, (R,)."""

    def sharpen(self) -> bool:
        """Take more orders from now on, for laws with corners; return whether that changes anything."""
        return False

    def begin_from(self, other: SettledMotion, runs: np.ndarray, theta: np.ndarray) -> None:  # noqa: B027
        """Start the search for each motion from that of a run (R,) of another one, where a search is needed."""

    def linear(self) -> LinearMotion | None:
        """Return the motion, for what only a linear diagram allows; None for others."""
        return None


@dataclass(eq=False)
class Response:
    """What linear equations say at one value of the free parameters, for R runs and orders 0..K.

    A (R, n, n), B (R, n, V), C (R, c, n), D (R, c, V); derivatives: of each (..., m); F (R, K+1, n + c) and dF: Fourier
    coefficients of the forcing of states and outputs. resolvent: (i k W - A)^-1; at order 0 of the part without slow
    states. With ports (`rotorsim.settled.ports`) rows of A, B and F are those that carry w, columns the states that
    matter, and A counts from the reference.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    derivatives: dict[str, np.ndarray]
    F: np.ndarray
    dF: np.ndarray
    resolvent: Resolvent

    def states(self, inputs: np.ndarray | None = None, means: Sequence[np.ndarray] | None = None) -> np.ndarray:
        """Return X (R, K+1, n) for inputs V (R, K+1, V) and means of slow states (default: zero)."""
        right = self.F[:, :, : self.A.shape[1]]
        if inputs is not None and inputs.shape[2]:
            right = right + inputs @ self.B.swapaxes(1, 2)
        X = np.asarray((self.resolvent.gain @ right[..., None])[..., 0])
        for r, values in enumerate(means or ()):
            X[r, 0] += self.resolvent.slow[r] @ values
        return X

    def outputs(self, X: np.ndarray, inputs: np.ndarray | None = None) -> np.ndarray:
        """Return Y (R, K+1, c) of states X."""
        Y = X @ self.C.swapaxes(1, 2) + self.F[:, :, self.A.shape[1] :]
        if inputs is not None and inputs.shape[2]:
            Y = Y + inputs @ self.D.swapaxes(1, 2)
        return np.asarray(Y)

    def transfer(self) -> np.ndarray:
        """Return dY/dV (R, K+1, c, V)."""
        return self._transfer

    @cached_property
    def _transfer(self) -> np.ndarray:
        return np.asarray(self.C[:, None] @ (self.resolvent.gain @ self.B[:, None].astype(complex)) + self.D[:, None])

    def slow_states(self, r: int) -> np.ndarray:
        """Return dX_0/dx_s of the slow states of run r, shape (n, s)."""
        return self.resolvent.slow[r]

    def sensitivity(self, X: np.ndarray, inputs: np.ndarray | None = None) -> np.ndarray:
        """Return dY (R, K+1, c, m) by the free parameters at states X and inputs, which stay as they are."""
        n = self.A.shape[1]
        right = self.dF[:, :, :n] + by_parameters(self.derivatives["A"], X)
        direct = self.dF[:, :, n:] + by_parameters(self.derivatives["C"], X)
        if inputs is not None and inputs.shape[2]:
            right = right + by_parameters(self.derivatives["B"], inputs)
            direct = direct + by_parameters(self.derivatives["D"], inputs)
        return np.asarray(self.C[:, None] @ (self.resolvent.gain @ right) + direct)


@dataclass(eq=False)
class LinearMotion(SettledMotion):
    """The settled motion of a linear diagram. Raises RotorsimError for diagrams that are not linear in their states."""

    slow: list[np.ndarray] | None = field(default=None, init=False)
    _ports: tuple[Ports, PortEquations] | None = field(default=None, init=False)
    _known: tuple[bytes, Response] | None = field(default=None, init=False)  # the last one

    is_linear = True
    corrections = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.equations.linear:
            raise RotorsimError(Problem("the diagram is not linear in its states", self.equations.model.diagram.name))

    def begin_from(self, other: SettledMotion, runs: np.ndarray, theta: np.ndarray) -> None:
        """Take the slow states of these runs of another motion."""
        linear = other.linear()
        if linear is not None and linear.slow is not None:
            self.slow = [linear.slow[r] for r in runs]

    def linear(self) -> LinearMotion:
        """Return the motion itself."""
        return self

    def predict(
        self, theta: np.ndarray, means: Sequence[np.ndarray] | None = None, inputs: np.ndarray | None = None
    ) -> Prediction:
        """Return the motion at theta (m,), which always exists."""
        response = self.condensed(theta)
        X = response.states(inputs, means)
        Y = response.outputs(X, inputs)
        by_means = []
        for r, columns in enumerate(response.resolvent.slow):
            effect = np.zeros((*Y.shape[1:], columns.shape[1]), complex)
            effect[0] = response.C[r] @ columns
            by_means.append(effect)
        settled = np.ones(len(Y), bool)

        def answers(moved: np.ndarray, which: Sequence[int]) -> np.ndarray:
            return np.asarray(response.transfer()[:, : moved.shape[1], :, [*which]] @ moved)

        return Prediction(
            Y, settled, means or (), by_means, lambda: response.sensitivity(X, inputs), answers, response.transfer
        )

    def fresh_means(self, theta: np.ndarray) -> list[FreshMeans]:
        """Return that no mean is known: the data say how far each has come."""
        none = np.zeros(0, int)
        nothing = none, np.zeros(0), np.zeros((0, len(theta))), none, np.zeros((0, 3))
        return [FreshMeans(len(slow), *nothing) for slow in self.slow_states(theta)]

    def growth(self, theta: np.ndarray) -> np.ndarray:
        """Return the largest real part of an eigenvalue of A of every run, (R,)."""
        A = self.equations.whole.values("A", self.p, theta)
        return np.asarray(np.linalg.eigvals(A).real.max(axis=1, initial=-np.inf))

    def response(self, theta: np.ndarray, K: int | None = None, *, forced: bool = True) -> Response:
        """Return the equations at theta (m,), for orders 0..K (default: all); not forced: F and dF are zero."""
        K = self.K if K is None else K
        part, many = self.equations.whole, np.repeat(theta[None], len(self.p), 0)
        slow = self.slow_states(theta)
        return self._response(part, many, K, lambda A: resolvent_of(A, self.grid(K), slow), forced)

    def slow_states(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return the slow states of each run, as they are at the first theta (m,)."""
        if self.slow is None:
            A = self.equations.whole.values("A", self.p, theta)
            runs = zip(A, self.windows, strict=True)
            self.slow = [slow_states(matrix, window, self.equations.means) for matrix, window in runs]
        return self.slow

    def condensed(self, theta: np.ndarray) -> Response:
        """Return the equations at theta (m,), by the ports of all that no parameter moves where states are many."""
        key = theta.tobytes()
        if self._known is not None and self._known[0] == key:
            return self._known[1]
        if self.equations.n <= DENSE:
            response = self.response(theta)
        else:
            if self._ports is None:
                self._ports = self.open_ports(theta)
            ports, part = self._ports
            many = np.repeat(theta[None], len(self.p), 0)
            response = self._response(part, many, self.K, ports.closed, within=ports.within)
        self._known = key, response
        return response

    def _response(
        self,
        part: PortEquations,
        many: np.ndarray,
        K: int,
        resolvent: Callable[[np.ndarray], Resolvent],
        forced: bool = True,
        within: np.ndarray | float = 0.0,
    ) -> Response:
        """Return the equations of some rows and states; many: theta of each run (R, m)."""
        found = part.steady(self.p, many)
        L = found.pop("L")
        values, derivatives = ({key: pair[k] for key, pair in found.items()} for k in (0, 1))
        values["A"] = values["A"] - within
        if forced:
            F, dF = self._forcing(part, many, K, L)
        else:
            F = np.zeros((*self.grid(K).shape, part.r + part.c), complex)
            dF = np.zeros((*F.shape, many.shape[1]), complex)
        return Response(**values, derivatives=derivatives, F=F, dF=dF, resolvent=resolvent(values["A"]))

    def open_ports(self, theta: np.ndarray) -> tuple[Ports, PortEquations]:
        """Return the ports of all that no parameter moves, and the equations there, seen about theta (m,)."""
        part, p = self.equations.whole, self.p
        A, C = (part.values(key, p, theta) for key in "AC")
        many = np.repeat(theta[None], len(p), 0)
        samples = part.sampled(p, many, instants(self.speeds, SAMPLES))
        moved = [_columns(np.moveaxis(values[:, :, : part.r], 2, 1)) for values in samples]
        columns = [np.any(C, axis=(0, 1))]
        rng = np.random.default_rng(0)
        for _ in range(PARAMETER_POINTS):
            other = theta * (1 + PARAMETER_SPREAD * rng.uniform(-1, 1, len(theta))) + PARAMETER_SPREAD * (theta == 0)
            many = np.repeat(other[None], len(p), 0)
            A_there, B, C = (part.values(key, p, other) for key in "ABC")
            slopes, own = part.matrices["A"].slopes(p, many)
            columns += [np.any(matrix, axis=(0, 1)) for matrix in (A_there - A, C)]
            columns.append(np.isin(np.arange(part.n), own))
            moved += [_columns(matrix) for matrix in (B, slopes)]
        seen = np.flatnonzero(np.any(columns, axis=0))
        ports = open_ports(A, self.grid(self.K), self.slow_states(theta), seen, moved)
        return ports, self.equations.at_ports(ports.rows, ports.columns)

    def grid(self, K: int) -> np.ndarray:
        """Return i k W at orders 0..K and, with all of them, at the combinations with an asynchronous frequency."""
        s = 1j * np.abs(self.speeds)[:, None] * np.arange(K + 1)
        if self.beside is None or self.K != K:
            return np.asarray(s)
        return np.concatenate([s, 1j * self.beside.frequencies], axis=1)

    def _forcing(self, part: PortEquations, many: np.ndarray, K: int, L: Pair) -> tuple[np.ndarray, np.ndarray]:
        """Return the forcing of equations and its derivatives, from shaft angle zero."""
        beside = self.beside if K == self.K else None
        if beside is not None and beside.forced:
            w, w_theta = part.laws.at(self.p, many, beside.times)
            waves = beside.projection @ w
            moved = (beside.projection @ w_theta.reshape(*w.shape[:2], -1)).reshape(*waves.shape, -1)
            F, dF = column_of(L, waves, moved)
        else:
            F, dF = part.forcing(self.p, many, self.speeds, K, L)
            if beside is not None:
                more = ((0, 0), (0, len(beside.orders)), (0, 0))
                F, dF = np.pad(F, more), np.pad(dF, (*more, (0, 0)))
        if self.phase.any():  # harmonics count from shaft angle zero, which the clock need not pass at t = 0
            turned = np.sign(self.speeds)[:, None] * np.arange(K + 1)
            if beside is not None:
                turned = np.concatenate([turned, np.tile(beside.orders, (len(turned), 1))], axis=1)
            turn = np.exp(-1j * self.phase[:, None] * turned)
            F, dF = F * turn[:, :, None], dF * turn[:, :, None, None]
        return F, dF


def _columns(matrices: np.ndarray) -> np.ndarray:
    """Return the columns of matrices (R, n, ...) side by side, those of zeros left out, (n, N)."""
    flat = np.moveaxis(matrices, 1, 0).reshape(matrices.shape[1], -1)
    return np.asarray(flat[:, np.any(flat, axis=0)])
