"""The traced equations of a diagram, with their exact derivatives by states and free parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Free
from rotorsim.linear.state_space import reached
from rotorsim.model.compiled import Model
from rotorsim.model.linearity import is_affine, jacobian, pattern
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.laws import Laws, Matrix, Pair, Split, Together, column_of, points_of
from rotorsim.settled.slow_states import means_of

FIRST_SAMPLES = 32
MOST_PERIOD_SAMPLES = 4096
RESOLVED = 1e-11  # size of the last Fourier coefficients, relative to the largest, at which a series has ended


def is_linear(model: Model, outputs: Sequence[str]) -> bool:
    """Return whether dx/dt and the outputs (flat names as recorded) are linear in states with constant factors."""
    y = ca.vertcat(*[model.expression(model.diagram.as_measured(name)) for name in outputs])
    return _is_affine(model, model.trace.xdot, y)


def _is_affine(model: Model, f: Any, g: Any) -> bool:
    trace = model.trace
    return is_affine(ca.vertcat(f, g), ca.vertcat(trace.x, trace.v), trace.t)


def without_inputs(model: Model, expression: Any) -> Any:
    """Return an expression with the external inputs of the model at zero."""
    v = model.trace.v
    return ca.substitute(expression, v, ca.SX.zeros(*v.shape)) if v.numel() else expression


def slots_of(model: Model, free: Free) -> list[int]:
    """Return the entries of p that a free parameter sets (several when blocks share a diagram parameter)."""
    parts = model.references.get(free.base) if free.base in model.diagram.parameters else [model.parameters[free.base]]
    return [part.start + free.entry for part in parts or []]


def instants(speeds: np.ndarray, n: int) -> np.ndarray:
    """Return n instants of a turn at each speed, (R, n)."""
    return np.asarray(2 * np.pi / np.abs(speeds)[:, None] * np.arange(n) / n)


def reached_states(A: ca.Sparsity, C: ca.Sparsity) -> np.ndarray:
    """Return the states that the outputs depend on, directly or through others."""
    pattern = np.array(ca.DM(A, 1.0)) != 0
    return np.flatnonzero(reached(pattern.T, np.any(np.array(ca.DM(C, 1.0)) != 0, axis=0)))


class Equations:
    """dx/dt = f(t, x, v; p, theta), y = g(t, x, v; p, theta) of a diagram, theta the free parameters.

    Only the states that the outputs depend on are kept, ``kept`` (n,), unless every_state. v: external inputs of the
    model (`inject`, `replace`), zero but for linear equations. p (R, n_p): what is the same in all runs becomes a
    number, but for entries that vary, and all that follows from it; for other runs see `at`. linear: it is known that
    they are (`is_linear`).
    """

    def __init__(
        self,
        model: Model,
        outputs: Sequence[str],
        free: Sequence[Free] = (),
        p: np.ndarray | None = None,
        *,
        every_state: bool = False,
        varying: Sequence[int] = (),
        linear: bool = False,
    ) -> None:
        self.model, self.outputs, self.free = model, tuple(outputs), tuple(free)
        self._known_linear = linear
        self._moved: tuple[tuple[bytes, bytes], np.ndarray] | None = None
        trace = model.trace
        self.slots = [slots_of(model, item) for item in free]
        theta = ca.SX.sym("theta", len(free))
        self.known = _known_values(p, {*varying, *(slot for some in self.slots for slot in some)})
        y = ca.vertcat(*[model.expression(model.diagram.as_measured(name)) for name in outputs])
        with_inputs = self._with_values([trace.xdot, y], theta)
        self._affine = (model, *with_inputs)
        of = [*with_inputs, *(jacobian(of, trace.v) for of in with_inputs)]
        f, g, B, D = ca.substitute(of, [trace.v], [ca.SX.zeros(*trace.v.shape)])
        self.kept = np.arange(model.n_x)
        if not every_state:
            self.kept = reached_states(pattern(f, trace.x), pattern(g, trace.x))
        keep = self.kept.tolist()
        x = ca.SX.sym("x", len(keep))
        whole: Any = ca.SX(model.x0(model.p0))
        whole[keep] = x
        f, g, B, D = ca.substitute([f[keep], g, B[keep, :], D], [trace.x], [whole])
        self.n, self.n_v, self.m = len(keep), trace.v.numel(), len(free)
        self.whole = PortEquations((trace.t, trace.p, theta), x, f, g, B, D)
        self.theta0 = np.array([item.value for item in free])

    def _with_values(self, expressions: list[Any], theta: Any) -> list[Any]:
        """Return expressions with free parameters in their slots, numbers for what is known, and z as at the start."""
        trace = self.model.trace
        entries = ca.vertsplit(trace.p) if trace.p.numel() > 1 else [trace.p]
        for slot, value in self.known.items():
            entries[slot] = ca.SX(value)
        for j, own in enumerate(self.slots):
            for slot in own:
                entries[slot] = theta[j]
        new = [ca.vertcat(*entries), ca.SX(self.model.z0(self.model.p0))]
        return list(ca.substitute(expressions, [trace.p, trace.z], new))  # type: ignore[arg-type]

    def at(self, p: np.ndarray) -> Equations:
        """Return the equations for known parameters p (R, n_p), of which others may be the same in all runs."""
        return self if self.suit(p) else self._general

    def suit(self, p: np.ndarray) -> bool:
        """Return whether all runs of p (R, n_p) have the known values."""
        return all((p[:, slot] == value).all() for slot, value in self.known.items())

    @cached_property
    def _general(self) -> Equations:
        return Equations(self.model, self.outputs, self.free)

    @cached_property
    def means(self) -> np.ndarray:
        """What is known of the mean of every kept state, (n,), see `means_of`."""
        return means_of(self.model)[self.kept]

    @cached_property
    def linear(self) -> bool:
        """Whether f and g are linear in states and inputs, with factors that do not depend on time."""
        return self._known_linear or _is_affine(*self._affine)

    @cached_property
    def changing(self) -> np.ndarray:
        """The states that the outputs, or entries of df/dx that are not constant, stand for."""
        part = self.whole
        columns = np.unique(np.array(part.dg_dx.sparsity().get_triplet()[1], int))
        return np.union1d(_varying(part.df_dx, ca.vertcat(part.x, part.symbols[0], part.symbols[2]))[1], columns)

    def moved_by(self, p: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return which parameters change the equations themselves, not only their forcing, (m,); p (1, n_p)."""
        key = p.tobytes(), theta.tobytes()
        if self._moved is None or self._moved[0] != key:
            self._moved = key, self._moved_by(p, theta)
        return self._moved[1]

    def _moved_by(self, p: np.ndarray, theta: np.ndarray) -> np.ndarray:
        part = self.whole
        if self.linear:
            moved = [matrix(p, theta[None])[1].reshape(-1, self.m).any(axis=0) for matrix in part.matrices.values()]
            return np.asarray(np.any(moved, axis=0))
        entries = ca.vertcat(ca.vec(part.df_dx), ca.vec(part.dg_dx))
        return np.array([bool(ca.depends_on(entries, part.symbols[2][j])) for j in range(self.m)], bool)

    def at_ports(self, rows: np.ndarray, columns: np.ndarray) -> PortEquations:
        """Return some rows of f as functions of some states, the others at zero."""
        part, r, c = self.whole, rows.tolist(), columns.tolist()
        x = ca.SX.sym("x", len(c))
        full: Any = ca.SX.zeros(self.n)
        full[c] = x
        of = [part.rates[r], part.outputs, part.df_dv[r, :], part.dg_dv, part.df_dx[r, c], part.dg_dx[:, c]]
        f, g, B, D, *slopes = ca.substitute(of, [part.x], [full])
        at_rest = part.laws.of_rows([*r, *range(self.n, self.n + part.c)])
        return PortEquations(part.symbols, x, f, g, B, D, slopes, at_rest)


class PortEquations:
    """Rows of f (r,) and outputs g (c,) as functions of states x (n,), with their derivatives.

    f, J = df/dx, f_theta = df/dtheta, g, C = dg/dx, g_theta, B = df/dv and D = dg/dv of the external inputs, and
    f_rows, J_part at the ``places`` E in r and S in n where J varies with x or t, take (times, x, p, theta) as columns,
    one for each of N points. matrices: A, B, C, D of linear equations, dx/dt = A x + B v + f(t), y = C x + D v + g(t),
    as functions of p and theta.
    """

    def __init__(
        self,
        symbols: tuple[Any, Any, Any],
        x: Any,
        f: Any,
        g: Any,
        B: Any,
        D: Any,
        slopes: Sequence[Any] = (),
        laws: Laws | None = None,
    ) -> None:
        """slopes: df/dx and dg/dx, laws: those of [f; g] at rest, where they are known."""
        self.symbols, self.x, self.rates, self.outputs = symbols, x, f, g
        self.df_dx, self.dg_dx = slopes or (jacobian(f, x), jacobian(g, x))
        self.df_dv, self.dg_dv = B, D
        self.r, self.n, self.c, self.m = f.numel(), x.numel(), g.numel(), symbols[2].numel()
        self.samples = FIRST_SAMPLES
        self._known_laws = laws
        t, p, theta = symbols
        points = [t, x, p, theta]
        self.f, self.g = MatrixFunction(points, f), MatrixFunction(points, g)
        self.J, self.C = MatrixFunction(points, self.df_dx), MatrixFunction(points, self.dg_dx)
        self.B, self.D = MatrixFunction(points, B), MatrixFunction(points, D)
        self.f_theta = MatrixFunction(points, lambda: jacobian(f, theta))
        self.g_theta = MatrixFunction(points, lambda: jacobian(g, theta))
        self.f_rows = MatrixFunction(points, lambda: f[self.places[0].tolist(), :])
        self.J_part = MatrixFunction(points, lambda: self.df_dx[self.places[0].tolist(), self.places[1].tolist()])

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows E of f that are not linear in x with constant factors, and states S that these are not linear in."""
        return _varying(self.df_dx, ca.vertcat(self.x, self.symbols[0]))

    @cached_property
    def inputs_change(self) -> bool:
        """Whether B or D vary with x or t."""
        return bool(
            ca.depends_on(ca.vertcat(ca.vec(self.df_dv), ca.vec(self.dg_dv)), ca.vertcat(self.x, self.symbols[0]))
        )

    @cached_property
    def changing_outputs(self) -> set[int]:
        """The outputs that are not linear in x with constant factors."""
        return {int(k) for k in _varying(self.dg_dx, ca.vertcat(self.x, self.symbols[0]))[0]}

    @cached_property
    def matrices(self) -> dict[str, Matrix]:
        """A, B, C, D of linear equations."""
        slopes = zip("ABCD", (self.df_dx, self.df_dv, self.dg_dx, self.dg_dv), strict=True)
        return {key: Matrix.of(matrix, *self.symbols[1:]) for key, matrix in slopes}

    def values(self, key: str, p: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return a matrix of linear equations, (R, rows, columns), for p (R, n_p) and one theta (m,)."""
        return self.matrices[key].value(p.T, np.repeat(theta[None], len(p), 0).T)

    @cached_property
    def split(self) -> Split:
        """f by its laws."""
        return Split(self.symbols, self.x, self.rates)

    @cached_property
    def _together(self) -> Together:
        return Together({**self.matrices, "L": self.laws.L})

    def steady(self, p: np.ndarray, theta: np.ndarray) -> dict[str, Pair]:
        """Return ``matrices`` and L of ``laws`` with their derivatives, see `Matrix`."""
        return self._together(p, theta)

    @cached_property
    def laws(self) -> Laws:
        """The laws of [f; g] at rest."""
        return self._known_laws or Laws.of(ca.vertcat(*self._rest), self.symbols)

    def moved_at_rest(self) -> np.ndarray:
        """Return which of [f; g] at rest each parameter may move, (r + c, m)."""
        rows = [np.array(ca.DM(pattern(at, self.symbols[2]), 1.0)) != 0 for at in self._rest]
        return np.concatenate(rows)

    @cached_property
    def _rest(self) -> list[Any]:
        return list(ca.substitute([self.rates, self.outputs], [self.x], [ca.SX.zeros(*self.x.shape)]))

    def at_rest(self, p: np.ndarray, theta: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return [f; g] at rest at times (R, N), for p (R, n_p), theta (R, m): (R, N, r + c)."""
        return self._at_rest(*points_of(p, theta, times)).reshape(*times.shape, -1)

    @cached_property
    def _at_rest(self) -> MatrixFunction:
        return MatrixFunction(self.symbols, ca.vertcat(*self._rest))

    def sampled(self, p: np.ndarray, theta: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `at_rest` and its derivatives (R, N, r + c, m)."""
        return column_of(self.laws.L(p, theta), *self.laws.at(p, theta, times))

    def forcing(
        self, p: np.ndarray, theta: np.ndarray, speeds: np.ndarray, K: int, L: Pair | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return Fourier coefficients of [f; g] at rest and their derivatives, orders 0..K.

        p (R, n_p), theta (R, m), speeds (R,) [rad/s] -> (R, K+1, r + c) and (R, K+1, r + c, m), complex. L: that of
        the laws, where it is known.
        """
        L = L or self.laws.L(p, theta)
        n = max(self.samples, 1 << (2 * K + 2).bit_length())
        while True:
            w, w_theta = self.laws.at(p, theta, instants(speeds, n))
            waves = np.fft.rfft(w, axis=1) / n
            size = np.abs(waves @ L[0].swapaxes(1, 2))
            tail = size[:, -n // 8 :].max(initial=0.0)
            if n >= MOST_PERIOD_SAMPLES or tail <= RESOLVED * size.max(initial=0.0):
                break
            n *= 2
        self.samples = n
        return column_of(L, waves[:, : K + 1], np.fft.rfft(w_theta, axis=1)[:, : K + 1] / n)


def _known_values(p: np.ndarray | None, varying: set[int]) -> Mapping[int, float]:
    """Return what is the same in all runs of p (R, n_p), by its entry: but for what varies."""
    if p is None:
        return {}
    same = np.flatnonzero((p == p[:1]).all(axis=0)).tolist()
    return {slot: float(p[0, slot]) for slot in same if slot not in varying}


def _varying(jacobian: Any, variables: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows and columns of the entries of a sparse Jacobian that depend on the variables."""
    if not jacobian.nnz():
        return np.zeros(0, int), np.zeros(0, int)
    depends = ca.Function("d", [variables], [jacobian.nz[:]], {"allow_free": True})
    entries = np.unique(np.array(depends.sparsity_jac(0, 0).row(), int))
    rows, columns = (np.array(places, int) for places in jacobian.sparsity().get_triplet())
    return np.unique(rows[entries]), np.unique(columns[entries])
