"""The periodic motion of a diagram at many speeds: directly where it is linear, else by continuation over speed.

Every speed starts from its neighbour's motion; where that fails the step in speed is halved; else from rest.
Source: Krack & Gross, Harmonic Balance for Nonlinear Vibration Problems (2019), ch. 4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from rotorsim.linear import linearisation as linear
from rotorsim.linear.drift import drifting_states
from rotorsim.linear.stability import growing
from rotorsim.linear.state_space import solved
from rotorsim.model.compiled import Model
from rotorsim.settled.balance import Balance, Solution, harmonics_of, samples_of
from rotorsim.settled.equations import Equations, PortEquations
from rotorsim.settled.floquet import STABLE_MULTIPLIER, largest_multiplier
from rotorsim.settled.forcing import Forcing, size_beyond
from rotorsim.settled.resolvent import shifted

FIRST_HARMONICS = 15
MOST_HARMONICS = 127
TOLERANCE = 1e-11  # relative residual of a motion, or relative step of Newton's method
HALVINGS = 3  # of a step in speed, before a speed is given up
UNSTABLE = "unstable: this motion is never reached"


@dataclass(frozen=True)
class Settings:
    """harmonics: fixed number, or None for as many as ``tolerance`` asks; stability: examine it.

    progress: is told the share that is done, of harmonic balance.
    """

    harmonics: int | None
    tolerance: float
    stability: bool
    progress: Callable[[float], None] | None = None

    def tell(self, share: float) -> None:
        if self.progress is not None:
            self.progress(share / (2 if self.stability else 1))


@dataclass(eq=False)
class Orbits:
    """Coefficients X (speeds, H+1, n_x) of all states at orders 0..H, and how they were computed.

    seeds, drifting: states without a mean, and all that these drive. truncation (speeds,): size of the harmonics left
    out, relative to the largest but the mean, worst state. finer (speeds, 2H+2, n_x): the same with twice the orders,
    where leaving orders out changes those that are kept.
    """

    X: np.ndarray
    status: list[str]
    stable: tuple[bool | None, ...]
    seeds: list[int]
    drifting: list[int]
    method: str
    truncation: np.ndarray
    counters: Mapping[str, int]
    finer: np.ndarray | None = None


class Setup:
    """What periodic motion needs of a model, made once: its equations over speeds, and its forcing."""

    def __init__(self, model: Model) -> None:
        self.model, self.z = model, model.z0(model.p0)
        entries = linear.speed_entries(model)
        self.speed_entries = np.zeros(model.n_p, bool) if entries is None else entries
        self.forcing = Forcing(model)
        self._equations: Equations | None = None

    def equations(self, p: np.ndarray) -> PortEquations:
        """Return the equations of all states, every parameter of p (speeds, n_p) but the speed a number.

        What depends on parameters only, such as the inverse of a mass matrix, is then computed once.
        """
        if self._equations is None or not self._equations.suit(p):
            varying = np.flatnonzero(self.speed_entries).tolist()
            self._equations = Equations(self.model, (), (), p, every_state=True, varying=varying)
        return self._equations.whole


def orbits(setup: Setup, base: np.ndarray, p: np.ndarray, settings: Settings) -> Orbits:
    """Return the periodic motion at base frequencies [rad/s] with parameters p (speeds, n_p)."""
    return (_direct if setup.model.linear else _balanced)(setup, base, p, settings)


# -- linear diagrams ---------------------------------------------------------------------------------------------------


def _direct(setup: Setup, base: np.ndarray, p: np.ndarray, settings: Settings) -> Orbits:
    """Return X_k = (i k W I - A)^-1 F_k at all speeds in one batch."""
    equations = setup.equations(p)
    with np.errstate(all="ignore"):
        A = equations.J(0.0, np.zeros(equations.n), p.T, np.zeros(0))
    linear.require_finite(setup.model, A)
    if (A[:1] == A).all():
        A = A[:1]
    series = setup.forcing.series(equations, base, p, settings.harmonics)
    seeds, drifting = drifting_states(A)
    X = _responses(A, series.F, base, drifting)
    status = ["settled"] * len(base)
    for j in np.flatnonzero(~np.isfinite(X).all(axis=(1, 2))):
        X[j] = np.nan
        status[j] = "failed: undamped resonance, the motion grows without bound"
    stable: tuple[bool | None, ...] = (None,) * len(base)
    if settings.stability:
        stable = tuple(np.broadcast_to([not growing(one) for one in A], len(base)).tolist())
        pairs = zip(stable, status, strict=True)
        status = [UNSTABLE if ok is False and text == "settled" else text for ok, text in pairs]
    H = _needed_harmonics(X, settings.tolerance) if settings.harmonics is None else settings.harmonics
    count = X.shape[1]
    left_out = size_beyond(X, min(H, count - 1 if series.ended else 7 * count // 8))
    counters = {"samples": series.samples, "solves": X.shape[0] * int(np.any(series.F != 0, axis=(0, 2)).sum())}
    return Orbits(X[:, : H + 1], status, stable, seeds, drifting, "direct", left_out, counters)


def _responses(A: np.ndarray, F: np.ndarray, base: np.ndarray, drifting: list[int]) -> np.ndarray:
    """Return X_k = (i k W I - A)^-1 F_k, shape of F; the mean of drifting states is left at zero; A (speeds or 1)."""
    n, _, n_x = F.shape
    X = np.zeros(F.shape, complex)
    A = np.broadcast_to(A, (n, n_x, n_x))
    kept = np.setdiff1d(np.arange(n_x), drifting)
    X[:, 0, kept] = solved(-A[:, kept[:, None], kept], F[:, 0, kept, None].real)[..., 0]
    orders = 1 + np.flatnonzero(np.any(F[:, 1:] != 0, axis=(0, 2)))
    for part in np.array_split(orders, 1 + len(orders) * n * n_x * n_x // 4_000_000):
        X[:, part] = solved(shifted(A, 1j * part * base[:, None], ()), F[:, part, :, None])[..., 0]
    return X


def _needed_harmonics(X: np.ndarray, tolerance: float) -> int:
    """Return the order beyond which every state's harmonics are below tolerance of its largest, at all speeds."""
    size = np.nan_to_num(np.abs(X[:, 1:])).max(axis=0)
    above = np.flatnonzero((size > tolerance * size.max(axis=0)).any(axis=1))
    return int(above[-1]) + 1 if len(above) else 1


# -- nonlinear and time-variant diagrams -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Point:
    """One speed: base frequency [rad/s] and parameters p (n_p,)."""

    setup: Setup
    base: float
    p: np.ndarray

    def towards(self, other: _Point, share: float) -> _Point:
        """Return the speed at a share of the way to another."""
        return replace(self, base=self.base + share * (other.base - self.base), p=self.p + share * (other.p - self.p))


@dataclass(eq=False)
class _Orbit:
    """Coefficients of x_S (H+1, S) and of all states (H+1, n_x); why it failed, if it did; Newton steps."""

    S: np.ndarray
    X: np.ndarray
    failure: str = ""
    steps: int = 0
    seeds: list[int] = field(default_factory=list)
    drifting: list[int] = field(default_factory=list)


def _balanced(setup: Setup, base: np.ndarray, p: np.ndarray, settings: Settings) -> Orbits:
    """Return the motions by harmonic balance, the speeds in ascending order, then those that failed from above."""
    equations = setup.equations(p)
    setup.forcing.series(equations, base[:1], p[:1], 1 if setup.forcing.jumps else None)  # refuses what is not periodic
    points = [_Point(setup, float(W), parameters) for W, parameters in zip(base, p, strict=True)]
    orbit_of: dict[int, _Orbit] = {}
    order = np.argsort(base, kind="stable").tolist()
    _sweep(points, order, orbit_of, settings)
    if any(orbit.failure for orbit in orbit_of.values()):
        _sweep(points, order[::-1], orbit_of, settings)  # past a fold the other branch may be reached from above
    every = [orbit_of[j] for j in range(len(points))]
    stable: list[bool | None] = [None] * len(every)
    count = max(len(orbit.X) for orbit in every)
    X = np.full((len(base), count, setup.model.n_x), np.nan + 0j)
    for j, (point, orbit) in enumerate(zip(points, every, strict=True)):
        if not orbit.failure:
            X[j] = 0.0
            X[j, : len(orbit.X)] = orbit.X
            if settings.stability:
                stable[j] = largest_multiplier(equations, point.base, point.p, orbit.X) <= STABLE_MULTIPLIER
                settings.tell(1.0 + (j + 1) / len(every))
    pairs = zip(stable, every, strict=True)
    H = _needed_harmonics(X, settings.tolerance) if settings.harmonics is None else count - 1
    finer = None
    if settings.harmonics is not None and settings.harmonics <= MOST_HARMONICS:
        finer = np.array([_finer(point, orbit) for point, orbit in zip(points, every, strict=True)])
    done = [orbit for orbit in every if not orbit.failure]
    return Orbits(
        X=X[:, : H + 1],
        status=[f"failed: {o.failure}" if o.failure else UNSTABLE if ok is False else "settled" for ok, o in pairs],
        stable=tuple(stable),
        seeds=sorted({k for orbit in done for k in orbit.seeds}),
        drifting=sorted({k for orbit in done for k in orbit.drifting}),
        method="harmonic balance",
        truncation=size_beyond(X, min(H, 7 * count // 8)),
        counters={"newton_steps": sum(orbit.steps for orbit in every)},
        finer=finer,
    )


def _finer(point: _Point, orbit: _Orbit) -> np.ndarray:
    """Return the coefficients of all states with twice the orders, (2H+2, n_x), NaN where there are none."""
    H = 2 * len(orbit.X) - 1
    again = orbit if orbit.failure else _newton(point, orbit.S, H)
    return np.full((H + 1, orbit.X.shape[1]), np.nan + 0j) if again.failure else again.X


def _sweep(points: list[_Point], order: list[int], orbit_of: dict[int, _Orbit], settings: Settings) -> None:
    """Solve the speeds in this order, each from the one before; what is already solved stays."""
    guess: tuple[_Point, _Orbit] | None = None
    near = False  # whether the speed before settled: only then a failure is worth smaller steps
    for j in order:
        before = orbit_of.get(j)
        if before is None or (before.failure and near):
            orbit_of[j] = _reach(points[j], guess, settings, near)
            orbit_of[j].steps += before.steps if before else 0
        settings.tell(len(orbit_of) / len(points))
        near = not orbit_of[j].failure
        if near:
            guess = points[j], orbit_of[j]


def _reach(point: _Point, guess: tuple[_Point, _Orbit] | None, settings: Settings, near: bool) -> _Orbit:
    """Solve at a point: from a neighbour's motion, else in smaller steps, else from rest."""
    steps, length, halvings = 0, 1.0, 0
    while guess is not None and halvings <= (HALVINGS + 1 if near else 0):
        here, start = guess
        there = point if length >= 1.0 else here.towards(point, length)
        orbit = _refined(there, start.S, settings)
        steps += orbit.steps
        if orbit.failure:
            length, halvings = length / 2, halvings + 1
        elif there is point:
            orbit.steps = steps
            return orbit
        else:
            guess, length = (there, orbit), 1.0
    orbit = _refined(point, None, settings)
    orbit.steps += steps
    return orbit


def _refined(point: _Point, start: np.ndarray | None, settings: Settings) -> _Orbit:
    """Solve with more and more harmonics until those left out are small."""
    H = settings.harmonics or max(FIRST_HARMONICS, 0 if start is None else len(start) - 1)
    steps = 0
    while True:
        orbit = _newton(point, start, H)
        steps += orbit.steps
        orbit.steps = steps
        if orbit.failure or settings.harmonics is not None:
            return orbit
        size = np.abs(orbit.X[1:])
        largest = np.maximum(size.max(axis=0), 1e-300)
        tail = (size[-max(2, H // 8) :] / largest)[:, largest > 1e-12 * largest.max()].max(initial=0.0)
        if tail <= settings.tolerance or 2 * H + 1 > MOST_HARMONICS:
            return orbit
        H, start = 2 * H + 1, orbit.S


def _newton(point: _Point, start: np.ndarray | None, H: int) -> _Orbit:
    """Solve for the harmonics 0..H of x_S from a start (any orders, S), None: from rest."""
    setup, p = point.setup, point.p
    equations = setup.equations(p[None])
    (E, S), n = equations.places, equations.n
    m = 1 << max(7, int(np.ceil(np.log2(6 * (H + 1)))))
    times = np.arange(m) * (2 * np.pi / point.base / m)

    def points(x_S: np.ndarray) -> tuple[np.ndarray, ...]:
        x = np.zeros((n, m))
        x[S] = x_S[0].T
        return times[None], x, p, np.zeros(0)

    def jacobian(x_S: np.ndarray) -> np.ndarray:
        return equations.J_part(*points(x_S))[None]

    C = np.zeros((1, H + 1, len(S)), complex)
    if start is None:
        C[0, 0] = setup.model.x0(p)[S]
    else:
        C[0, : len(start)] = start[: H + 1]
    along = jacobian(samples_of(C, m))[0]
    A = equations.J(0.0, np.zeros(n), p, np.zeros(0))[0]
    pattern = A.copy()
    A[np.ix_(E, S)] = along.mean(axis=0)  # so that (i k W I - A) is regular where the motion itself is
    pattern[np.ix_(E, S)] = np.abs(along).max(axis=0)
    seeds, drifting = drifting_states(np.array([A, pattern]))
    nothing = np.zeros((H + 1, n), complex)
    if np.isin(S, drifting).any():
        names = linear.state_names(setup.model)
        drifters = ", ".join(names[k] for k in seeds)
        return _Orbit(C[0], nothing, f"{drifters} drifts and acts on a nonlinear block")
    at_rest = equations.f(*points(np.zeros((1, m, len(S)))))[None, :, :, 0]
    F = harmonics_of(at_rest, H)[0]
    if setup.forcing.jumps:  # from its exact series; only what is continuous is sampled
        F = setup.forcing.series(equations, np.array([point.base]), p[None], H).F[0, : H + 1]
    right = np.concatenate([np.repeat(np.eye(n)[None, :, E], H + 1, 0), F[:, :, None]], axis=2)
    right[0, drifting] = 0.0
    s = 1j * point.base * np.arange(H + 1)
    try:
        gain = np.linalg.solve(shifted(A[None], s[None], [np.array(drifting, int)]), right[None])
    except np.linalg.LinAlgError:
        return _Orbit(C[0], nothing, "undamped resonance of the mean linear system")
    balance = Balance(
        rows=lambda x_S: equations.f_rows(*points(x_S))[None, :, :, 0],
        jacobian=jacobian,
        rest=at_rest[:, :, E],
        A=A[None, E[:, None], S],
        G=gain[..., :-1],
        base=gain[..., -1],
        S=S,
    )
    first = balance.residual(C)[0]
    if start is None and np.isfinite(first).all():  # the response of the mean linear system is a better start than rest
        trial = balance.residual(C - first)[0]
        C, first = (C - first, trial) if np.isfinite(trial).all() else (C, first)
    solution = balance.solve(C, TOLERANCE, grow=start is None)
    failure = "" if solution.settled.all() else _reason(point, S, C[0], first[0], solution)
    return _Orbit(solution.C[0], balance.states(solution)[0], failure, solution.steps, seeds, drifting)


def _reason(point: _Point, S: np.ndarray, C: np.ndarray, first: np.ndarray, solution: Solution) -> str:
    """Return how far the search from C with its first residual (H+1, S) got, and where it failed."""
    model, R = point.setup.model, solution.residual[0]
    worst = int(S[int(np.argmax(np.where(np.isfinite(R), np.abs(R), np.inf).max(axis=0)))]) if len(S) else 0
    steps = f"{solution.steps} step{'s' * (solution.steps != 1)} at {len(C) - 1} harmonics"
    return (
        f"no periodic motion found at {point.base:.6g} rad/s; {solution.reason}; {steps} took the residual from "
        f"{_share(C, first)} to {_share(solution.C[0], R)}, the most in block '{model.block_of_state(worst)}' "
        f"({linear.state_names(model)[worst]}): a motion may exist all the same; try speeds nearer to one that "
        "settled, or `rotorsim run`, which needs no start"
    )


def _share(C: np.ndarray, R: np.ndarray) -> str:
    """Return the largest residual, relative to the motion of its state, as text."""
    size = np.maximum(np.abs(C).max(axis=0), 1e-300)
    share = float((np.abs(R) / size).max(initial=0.0)) if np.isfinite(R).all() else np.inf
    return f"{100 * share:.2g} % of the motion" if np.isfinite(share) else "what is not finite"
