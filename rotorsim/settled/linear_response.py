"""Settled motion of linear diagrams: X_k = (i k W I - A)^-1 F_k at many speeds in one batch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear import linearisation as linear
from rotorsim.linear.stability import growing
from rotorsim.model.compiled import Model
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.forcing import Jumps

__all__ = ["FIRST_SAMPLES", "LARGEST_HARMONIC", "Motion", "Setup", "solve"]

FIRST_SAMPLES = 32
MOST_SAMPLES = 4096
RESOLVED = 1e-11  # size of the last Fourier coefficients, relative to the largest, at which a series has ended
ROUNDING = 1e-14  # coefficients below this part of the largest are rounding, not motion
LARGEST_HARMONIC = 255  # kept by default
PROBE = 0.3819660112501051  # off-grid instant (part of a period) at which the series is checked


@dataclass
class Motion:
    """Coefficients X (speeds, H+1, n_x) of all states at orders 0..H, and how they were found.

    truncation (speeds,): size of the harmonics left out, relative to the largest but the mean, worst state.
    finer (speeds, 2H+2, n_x): the same with twice the orders, where leaving orders out changes those that are kept.
    """

    X: np.ndarray
    status: list[str]
    stable: tuple[bool | None, ...]
    seeds: list[int]
    drifting: list[int]
    method: str
    truncation: np.ndarray
    counters: Mapping[str, int] = field(default_factory=dict)
    finer: np.ndarray | None = None


@dataclass(frozen=True)
class Nonlinear:
    """Rows E and columns S in which the Jacobian is not constant; the whole of it, and that part."""

    E: np.ndarray
    S: np.ndarray
    jacobian: MatrixFunction
    part: MatrixFunction


def _varying(jacobian: Any, variables: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows and columns of the entries of a sparse Jacobian that depend on the variables."""
    if not jacobian.nnz():
        return np.zeros(0, int), np.zeros(0, int)
    depends = ca.Function("d", [variables], [jacobian.nz[:]], {"allow_free": True})
    entries = np.unique(np.array(depends.sparsity_jac(0, 0).row(), int))
    rows, columns = (np.array(places, int) for places in jacobian.sparsity().get_triplet())
    return np.unique(rows[entries]), np.unique(columns[entries])


class Setup:
    """What periodic motion needs of a model, made once: Jacobian over speeds, forcing, jumps."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.n_x = model.n_x
        self.z = model.z0(model.p0)
        entries = linear.speed_entries(model)
        self.speed_entries = np.zeros(model.n_p, bool) if entries is None else entries
        trace = model.trace
        self.jacobian = linear.functions(model).state_matrix()
        speed = trace.p[np.flatnonzero(self.speed_entries).tolist()]
        self.jacobian_varies = bool(ca.depends_on(model.jacobian_expression, speed))
        self.jumps = Jumps(model)
        self.samples = FIRST_SAMPLES
        self.returning: dict[tuple[str, ...] | None, tuple[str, ...]] = {}
        self._nonlinear: tuple[np.ndarray, Nonlinear] | None = None
        self._patterns: dict[bytes, tuple[list[int], list[int]]] = {}

    def instants(self, base: np.ndarray, n: int) -> np.ndarray:
        """Return n instants over one period of every base frequency [rad/s], shape (speeds, n)."""
        return np.asarray((2 * np.pi / n / base)[:, None] * np.arange(n))

    def state_matrices(self, p: np.ndarray) -> np.ndarray:
        """Return A of a linear model at every speed, shape (speeds, n_x, n_x), or (1, ...) where it is the same."""
        few = p if self.jacobian_varies else p[:1]
        return self.jacobian(0.0, np.zeros(self.n_x), self.z, few.T)

    def nonlinear(self, p: np.ndarray) -> Nonlinear:
        """Return the Jacobian along a motion, with every parameter of p but the speed as a number.

        What depends on parameters only, such as the inverse of a mass matrix, is then computed once.
        """
        fixed = np.where(self.speed_entries, 0.0, p)
        if self._nonlinear is None or not np.array_equal(self._nonlinear[0], fixed):
            self._nonlinear = (fixed, self._with_numbers(fixed))
        return self._nonlinear[1]

    def _with_numbers(self, fixed: np.ndarray) -> Nonlinear:
        trace = self.model.trace
        numbers = ca.SX(fixed)
        places = np.flatnonzero(self.speed_entries).tolist()
        numbers[places] = trace.p[places]
        jacobian = ca.sparsify(ca.substitute(self.model.jacobian_expression, trace.p, numbers))
        arguments = [trace.t, trace.x, trace.z, trace.p]
        E, S = _varying(jacobian, ca.vertcat(trace.x, trace.t))
        part = jacobian[E.tolist(), S.tolist()] if len(E) else ca.SX(0, 0)
        return Nonlinear(E, S, MatrixFunction(arguments, jacobian), MatrixFunction(arguments, part))

    def drift(self, A: np.ndarray) -> tuple[list[int], list[int]]:
        """Return the states without a mean and those that they drive (see `linear.drifting_states`)."""
        key = np.any(A != 0, axis=0).tobytes() + A[0].tobytes()
        if key not in self._patterns:
            self._patterns = {key: linear.drifting_states(A)}
        return self._patterns[key]

    def forcing(self, times: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return dx/dt at x = 0, shape (speeds, instants, n_x), for times (speeds, instants)."""
        n, m = times.shape
        x = np.zeros((n * m, self.n_x))
        return self.model.rhs_batch(times.ravel(), x, self.z, np.repeat(p, m, 0)).reshape(n, m, self.n_x)


def solve(
    setup: Setup, base: np.ndarray, p: np.ndarray, harmonics: int | None, tolerance: float, stability: bool
) -> Motion:
    """Return the settled motion of a linear model at base frequencies [rad/s] with parameters p (speeds, n_p)."""
    with np.errstate(all="ignore"):
        A = setup.state_matrices(p)
    linear.require_finite(setup.model, A)
    F, samples, ended = forcing_series(setup, base, p, harmonics)
    seeds, drifting = setup.drift(A)
    X = _respond(setup, A, F, base, drifting)
    status = ["settled"] * len(base)
    for j in np.flatnonzero(~np.isfinite(X).all(axis=(1, 2))):
        X[j] = np.nan
        status[j] = "failed: undamped resonance, the motion grows without bound"
    stable: tuple[bool | None, ...] = (None,) * len(base)
    if stability:
        stable = tuple(np.broadcast_to([not growing(one) for one in A], len(base)).tolist())
        status = [
            "unstable: this motion is never reached" if ok is False and text == "settled" else text
            for text, ok in zip(status, stable, strict=True)
        ]
    H = needed_harmonics(X, tolerance) if harmonics is None else harmonics
    left_out = size_beyond(X, min(H, X.shape[1] - 1 if ended else 7 * X.shape[1] // 8))
    counters = {"samples": samples, "solves": X.shape[0] * X.shape[1]}
    return Motion(X[:, : H + 1], status, stable, seeds, drifting, "direct", left_out, counters)


def forcing_series(
    setup: Setup, base: np.ndarray, p: np.ndarray, harmonics: int | None
) -> tuple[np.ndarray, int, bool]:
    """Return the Fourier coefficients of dx/dt at x = 0, shape (speeds, H+1, n_x), samples per period, and
    whether the series has ended there. It is at least as long as ``harmonics`` asks.

    The number of samples grows until the series has ended and agrees with the forcing at an instant between
    the samples. Forcing that jumps is integrated piecewise between its jumps by Gauss-Legendre quadrature.
    Raises RotorsimError when the forcing does not return after one period.
    """
    period = 2 * np.pi / base
    m = setup.samples
    while harmonics is not None and m < 2 * harmonics + 2:
        m *= 2
    if setup.jumps.exist:
        _check_period(setup.forcing(np.stack([PROBE * period, (1 + PROBE) * period], axis=1), p), setup, base)
        return *setup.jumps.series(setup, base, p, harmonics or LARGEST_HARMONIC), False
    while True:
        times = np.concatenate(
            [setup.instants(base, m), (PROBE * period)[:, None], ((1 + PROBE) * period)[:, None]], axis=1
        )
        f = setup.forcing(times, p)
        if m == setup.samples:
            _check_period(f[:, m:], setup, base)
        F = np.fft.rfft(f[:, :m], axis=1)[:, : m // 2] / m
        size = np.abs(F).max(axis=0)
        largest = size.max(axis=0)
        wave = np.exp(2j * np.pi * PROBE * np.arange(m // 2))
        wave[1:] *= 2
        error = np.abs(np.tensordot(F, wave, (1, 0)).real - f[:, m]).max(axis=0)
        ended = np.all(size[3 * m // 8 :] <= RESOLVED * largest) and np.all(error <= 1e-9 * largest)
        if ended or m >= MOST_SAMPLES:
            break
        m *= 2
    if ended and harmonics is None:
        setup.samples = m
    F[np.abs(F) <= ROUNDING * largest] = 0.0
    return (F, m, True) if ended else (F[:, : max(harmonics or 0, LARGEST_HARMONIC) + 1], m, False)


def _check_period(f: np.ndarray, setup: Setup, base: np.ndarray) -> None:
    """Raise unless forcing at two instants one period apart, (speeds, 2, n_x), is the same."""
    change = np.abs(f[:, 1] - f[:, 0])
    size = np.abs(f).max(axis=(0, 1))
    bad = change > 1e-7 * size
    if bad.any():
        j, k = map(int, np.argwhere(bad)[0])
        raise RotorsimError(
            Problem(
                what=f"the forcing at {base[j]:.6g} rad/s is not the same one period later: the motion is not periodic",
                subject=setup.model.block_of_state(k),
                hint="use a constant speed; for a longer period give its number of turns (subharmonic)",
            )
        )


def _respond(setup: Setup, A: np.ndarray, F: np.ndarray, base: np.ndarray, drifting: list[int]) -> np.ndarray:
    """Return X_k = (i k W I - A)^-1 F_k, shape of F; the mean of drifting states is left at zero."""
    n, _, n_x = F.shape
    X = np.zeros(F.shape, complex)
    eye = np.eye(n_x)
    kept = np.setdiff1d(np.arange(n_x), drifting)
    if len(kept):
        mean = _solved(-A[:, kept[:, None], kept], F[:, 0, kept].real)
        X[:, 0, kept] = mean
    orders = 1 + np.flatnonzero(np.any(F[:, 1:] != 0, axis=(0, 2)))
    chunk = max(1, 4_000_000 // max(1, n * n_x * n_x))
    for start in range(0, len(orders), chunk):
        part = orders[start : start + chunk]
        s = 1j * part * base[:, None]
        X[:, part] = _solved(s[:, :, None, None] * eye - A[:, None], F[:, part])
    return X


def _solved(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solutions of a stack of systems; NaN where one is singular."""
    try:
        return np.linalg.solve(matrices, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        shape = np.broadcast_shapes(matrices.shape[:-2], right.shape[:-1])
        matrices = np.broadcast_to(matrices, (*shape, *matrices.shape[-2:]))
        out = np.full((*shape, right.shape[-1]), np.nan, dtype=np.result_type(matrices, right))
        for index in np.ndindex(*shape):
            try:
                out[index] = np.linalg.solve(matrices[index], right[index])
            except np.linalg.LinAlgError:
                continue
        return out


def size_beyond(X: np.ndarray, H: int) -> np.ndarray:
    """Return the largest harmonic above order H relative to the largest but the mean, worst state, (speeds,)."""
    size = np.abs(X[:, 1:])
    largest = size.max(axis=1, initial=0.0)
    beyond = size[:, H:].max(axis=1, initial=0.0)
    moving = largest > ROUNDING * largest.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(np.divide(beyond, largest, out=np.zeros_like(beyond), where=moving).max(axis=1, initial=0.0))


def needed_harmonics(X: np.ndarray, tolerance: float) -> int:
    """Return the order beyond which every state's harmonics are below tolerance of its largest, at all speeds."""
    size = np.nan_to_num(np.abs(X[:, 1:])).max(axis=0)
    above = np.flatnonzero((size > tolerance * size.max(axis=0)).any(axis=1))
    return int(above[-1]) + 1 if len(above) else 1
