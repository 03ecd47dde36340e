"""Harmonic balance with alternating frequency/time for nonlinear and time-variant diagrams.

The right-hand side is split, dx/dt = A x + g(t, x), with A constant. Where the Jacobian is not constant
lie the rows E and columns S of the few equations and states that are nonlinear, so that g in the rows E
depends on x_S only and elsewhere on time only. The harmonics obey X_k = (i k W I - A)^-1 g_k; only those of
x_S are unknown, the others follow. Newton's method uses the exact Jacobian, sampled over the period.

Source: Cameron & Griffin, J. Appl. Mech. 56 (1989) 149-154 (alternating frequency/time); Krack & Gross,
Harmonic Balance for Nonlinear Vibration Problems (2019), ch. 2-4 (condensation, continuation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from rotorsim.linear import linearisation as linear
from rotorsim.settled.floquet import is_stable
from rotorsim.settled.linear_response import Motion, Setup, forcing_series, needed_harmonics, size_beyond

__all__ = ["Settings", "balance"]

FIRST_HARMONICS = 15
MOST_HARMONICS = 127
MOST_STEPS = 25
SMALLEST_LENGTH = 2.0**-7
HALVINGS = 3  # of a step in speed, before a speed is given up


@dataclass(frozen=True)
class Settings:
    """harmonics: fixed number, or None for as many as ``tolerance`` asks; stability: Floquet multipliers."""

    harmonics: int | None
    tolerance: float
    stability: bool


@dataclass
class _Solution:
    """Coefficients of x_S (H+1, S) and of all states (H+1, n_x); why it failed, if it did; Newton steps."""

    S: np.ndarray
    X: np.ndarray
    failure: str = ""
    steps: int = 0


@dataclass
class _Problem:
    """One speed: A, the nonlinear rows and columns, and the functions that are balanced."""

    setup: Setup
    base: float
    p: np.ndarray
    E: np.ndarray
    S: np.ndarray
    A: np.ndarray
    seeds: list[int] = field(default_factory=list)
    drifting: list[int] = field(default_factory=list)

    def rates(self, x: np.ndarray) -> np.ndarray:
        """Return dx/dt at equal instants over the period, x (m, n_x) -> (m, n_x)."""
        m = len(x)
        times = np.arange(m) * (2 * np.pi / self.base / m)
        return self.setup.model.rhs_batch(times, x, self.setup.z, np.repeat(self.p[None], m, 0))

    def jacobians(self, x: np.ndarray) -> np.ndarray:
        """Return d(dx/dt)/dx at equal instants over the period, (m, n_x, n_x)."""
        times = np.arange(len(x)) * (2 * np.pi / self.base / len(x))
        return self.setup.nonlinear(self.p).jacobian(times[None, :], x.T, self.setup.z, self.p)

    def forced(self, H: int) -> np.ndarray:
        """Return the exact Fourier coefficients of dx/dt at x = 0, (H+1, n_x)."""
        return forcing_series(self.setup, np.array([self.base]), self.p[None], H)[0][0, : H + 1]

    def local_jacobians(self, x: np.ndarray) -> np.ndarray:
        """Return the rows E and columns S of `jacobians`, (m, E, S)."""
        times = np.arange(len(x)) * (2 * np.pi / self.base / len(x))
        return self.setup.nonlinear(self.p).part(times[None, :], x.T, self.setup.z, self.p)

    def set_linear_part(self, J: np.ndarray) -> None:
        """Take the mean Jacobian as A, so that (i k W I - A) is regular where the motion itself is."""
        self.A = J.mean(axis=0)
        self.seeds, self.drifting = linear.drifting_states(np.concatenate([self.A[None], J]))

    def transfer(self, H: int) -> np.ndarray:
        """Return (i k W I - A)^-1 for k = 0..H, (H+1, n_x, n_x); zero rows for the mean of drifting states."""
        n_x = len(self.A)
        out = np.zeros((H + 1, n_x, n_x), complex)
        kept = np.setdiff1d(np.arange(n_x), self.drifting)
        out[0][np.ix_(kept, kept)] = np.linalg.inv(-self.A[np.ix_(kept, kept)])
        s = 1j * self.base * np.arange(1, H + 1)
        out[1:] = np.linalg.inv(s[:, None, None] * np.eye(n_x) - self.A)
        return out


def balance(setup: Setup, base: np.ndarray, p: np.ndarray, settings: Settings) -> Motion:
    """Return the settled motion at base frequencies [rad/s] with parameters p (speeds, n_p).

    Every speed starts from its neighbour's motion; where that fails the step in speed is halved.
    """
    jumps = setup.jumps.exist
    forcing_series(setup, base[:1], p[:1], 1 if jumps else None)  # refuses forcing that is not periodic
    parts = setup.nonlinear(p[0])
    problems = [
        _Problem(setup, float(W), parameters, parts.E, parts.S, np.zeros((setup.n_x, setup.n_x)))
        for W, parameters in zip(base, p, strict=True)
    ]
    solved: dict[int, _Solution] = {}
    order = np.argsort(base, kind="stable").tolist()
    _sweep(problems, order, solved, settings)
    if any(found.failure for found in solved.values()):
        _sweep(problems, order[::-1], solved, settings)  # past a fold the other branch may be reached from above

    status: list[str] = []
    stable: list[bool | None] = []
    for j, problem in enumerate(problems):
        found = solved[j]
        ok = is_stable(setup, problem.base, problem.p, found.X) if settings.stability and not found.failure else None
        stable.append(ok)
        text = "settled" if ok is not False else "unstable: this motion is never reached"
        status.append(f"failed: {found.failure}" if found.failure else text)
    count = max(len(found.X) for found in solved.values())
    X = np.zeros((len(base), count, setup.n_x), complex)
    for j, found in solved.items():
        X[j, : len(found.X)] = np.nan if found.failure else found.X
    H = needed_harmonics(X, settings.tolerance) if settings.harmonics is None else count - 1
    left_out = size_beyond(X, min(H, 7 * count // 8))
    done = [problem for j, problem in enumerate(problems) if not solved[j].failure]
    fixed = settings.harmonics is not None and settings.harmonics <= MOST_HARMONICS
    return Motion(
        X=X[:, : H + 1],
        status=status,
        stable=tuple(stable),
        seeds=sorted({k for problem in done for k in problem.seeds}),
        drifting=sorted({k for problem in done for k in problem.drifting}),
        method="harmonic balance",
        truncation=left_out,
        finer=np.array([_finer(problems[j], solved[j]) for j in range(len(base))]) if fixed else None,
        counters={"newton_steps": sum(found.steps for found in solved.values())},
    )


def _finer(problem: _Problem, found: _Solution) -> np.ndarray:
    """Return the coefficients of all states with twice the orders, (2H+2, n_x), NaN where there are none."""
    H = 2 * len(found.X) - 1
    again = found if found.failure else _newton(problem, _resized(found.S, H), H)
    return np.full((H + 1, found.X.shape[1]), np.nan + 0j) if again.failure else again.X


def _sweep(problems: list[_Problem], order: list[int], solved: dict[int, _Solution], settings: Settings) -> None:
    """Solve the speeds in this order, each from the one before; what is already solved stays."""
    guess: _Solution | None = None
    at = (problems[order[0]].base, problems[order[0]].p)
    near = False  # whether the speed before settled: only then a failure is worth smaller steps
    for j in order:
        before = solved.get(j)
        if before is None or (before.failure and near):
            found = _reach(problems[j], guess, at, settings, near)
            found.steps += before.steps if before else 0
            solved[j] = found
        near = not solved[j].failure
        if near:
            guess, at = solved[j], (problems[j].base, problems[j].p)


def _reach(
    problem: _Problem, guess: _Solution | None, at: tuple[float, np.ndarray], settings: Settings, near: bool
) -> _Solution:
    """Solve at the problem's speed: from a neighbour's motion, else in smaller steps, else from rest."""
    steps = 0
    if guess is not None:
        found = _refined(problem, guess.S, settings)
        if not found.failure:
            return found
        steps += found.steps
        here: tuple[float, np.ndarray, _Solution] = (*at, guess)
        length, halvings = 0.5, 0
        while near and halvings <= HALVINGS:
            W0, p0, start = here
            W = W0 + length * (problem.base - W0)
            between = p0 + length * (problem.p - p0)
            last = length >= 1.0
            trial = (
                problem if last else _Problem(problem.setup, W, between, problem.E, problem.S, np.zeros_like(problem.A))
            )
            found = _refined(trial, start.S, settings)
            steps += found.steps
            if found.failure:
                length, halvings = length / 2, halvings + 1
            elif last:
                found.steps = steps
                return found
            else:
                here, length = (W, between, found), 1.0
    found = _refined(problem, None, settings)
    found.steps += steps
    return found


def _refined(problem: _Problem, start: np.ndarray | None, settings: Settings) -> _Solution:
    """Solve with more and more harmonics until those left out are small."""
    H = settings.harmonics or max(FIRST_HARMONICS, 0 if start is None else len(start) - 1)
    steps = 0
    while True:
        found = _newton(problem, _resized(start, H), H)
        steps += found.steps
        found.steps = steps
        if found.failure or settings.harmonics is not None:
            return found
        size = np.abs(found.X[1:])
        largest = np.maximum(size.max(axis=0), 1e-300)
        tail = (size[-max(2, H // 8) :] / largest)[:, largest > 1e-12 * largest.max()].max(initial=0.0)
        if tail <= settings.tolerance or 2 * H + 1 > MOST_HARMONICS:
            return found
        H, start = 2 * H + 1, found.S


def _resized(S: np.ndarray | None, H: int) -> np.ndarray | None:
    if S is None:
        return None
    out = np.zeros((H + 1, S.shape[1]), complex)
    out[: len(S)] = S[: H + 1]
    return out


def _newton(problem: _Problem, start: np.ndarray | None, H: int) -> _Solution:
    """Solve for the harmonics 0..H of x_S by Newton's method with a shortened step where it overshoots."""
    n_x, S = len(problem.A), problem.S
    m = 1 << max(7, int(np.ceil(np.log2(6 * (H + 1)))))
    x = np.zeros((m, n_x))
    zero = np.zeros((H + 1, len(S)), complex)
    rest = problem.setup.model.x0(problem.p)
    C = zero if start is None else start
    if start is None:
        C = zero.copy()
        C[0] = rest[S]
    x[:, S] = _samples(C, m)
    J = problem.jacobians(x)
    problem.set_linear_part(J)
    if np.isin(problem.S, problem.drifting).any():
        names = linear.state_names(problem.setup.model)
        drifting = ", ".join(names[k] for k in problem.seeds)
        return _Solution(zero, np.zeros((H + 1, n_x), complex), f"{drifting} drifts and acts on a nonlinear block")
    try:
        G = problem.transfer(H)
    except np.linalg.LinAlgError:
        return _Solution(zero, np.zeros((H + 1, n_x), complex), "undamped resonance of the mean linear system")
    real = _Real(H, m)
    # forcing that jumps is taken from its exact series; what is left to be sampled is continuous
    at_rest: np.ndarray | float = problem.rates(np.zeros((m, n_x))) if problem.setup.jumps.exist else 0.0
    forced: np.ndarray | float = problem.forced(H) if problem.setup.jumps.exist else 0.0

    def residual(C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = np.zeros((m, n_x))
        x[:, S] = _samples(C, m)
        g = problem.rates(x) - at_rest - x[:, S] @ problem.A[:, S].T
        g_k = np.fft.rfft(g, axis=0)[: H + 1] / m + forced
        X = np.einsum("kij,kj->ki", G, g_k)
        return C - X[:, S], X, x

    R, X, x = residual(C)
    if start is None:  # the response of the mean linear system to the forcing is a better start than rest
        with np.errstate(all="ignore"):
            trial = X[:, S]
            R1, X1, x1 = residual(trial)
        if np.isfinite(R1).all():
            C, R, X, x = trial, R1, X1, x1
    first, why, step = _share(C, R), f"not done after {MOST_STEPS} Newton steps", 0
    for step in range(1, MOST_STEPS + 1):
        if not np.isfinite(R).all():
            why = "the motion is not finite any more"
            break
        J = problem.local_jacobians(x) - problem.A[problem.E[:, None], S]
        try:
            U, J = _compressed(J)
            delta = real.newton_step(G[:, S[:, None], problem.E] @ U, J, R)
        except np.linalg.LinAlgError:
            why = "Newton's equations are singular: a fold or a branching of the motion"
            break
        scale = np.maximum(np.abs(C).max(axis=0), 1e-300)
        size = np.abs(delta / scale).max(initial=0.0)
        C, R, X, x, length = _shortened(residual, C, R, delta, scale)
        if length <= SMALLEST_LENGTH:
            why = "Newton's method stalls in a minimum of the residual"
            break
        if size <= 1e-11 or (size <= 1e-7 and np.abs(R / scale).max(initial=0.0) <= 1e-11):
            return _Solution(C, X, "", step)
    got = f"{why}; {step} step{'s' * (step != 1)} at {H} harmonics took the residual from {first} to {_share(C, R)}"
    return _Solution(C, X, _reason(problem, R, got), step)


def _share(C: np.ndarray, R: np.ndarray) -> str:
    """Return the largest residual, relative to the motion of its state, as text."""
    size = np.maximum(np.abs(C).max(axis=0), 1e-300)
    share = float((np.abs(R) / size).max(initial=0.0)) if np.isfinite(R).all() else np.inf
    return f"{100 * share:.2g} % of the motion" if np.isfinite(share) else "what is not finite"


def _shortened(
    residual: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]],
    C: np.ndarray,
    R: np.ndarray,
    delta: np.ndarray,
    scale: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the point after a Newton step, halved until the residual falls, and the part of the step taken."""
    before = np.linalg.norm(R / scale)
    length = 1.0
    while True:
        with np.errstate(all="ignore"):
            new = C - length * delta
            R1, X1, x1 = residual(new)
            after = np.linalg.norm(R1 / scale)
        if after < (1 - 0.1 * length) * before or length <= SMALLEST_LENGTH or before <= 1e-9:
            return new, R1, X1, x1, length
        length /= 2


def _compressed(J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return U (E, r) and V (m, r, S) with J = U V: one force may act in many rows (a coupled mass matrix)."""
    rows = J.transpose(1, 0, 2).reshape(J.shape[1], -1)
    size = np.linalg.norm(rows, axis=1)
    scaled = rows / np.where(size > 0, size, 1.0)[:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    kept = vectors[:, values > 1e-14 * values.max(initial=0.0)]
    V = (kept.T @ scaled).reshape(kept.shape[1], J.shape[0], J.shape[2]).transpose(1, 0, 2)
    return size[:, None] * kept, V


def _samples(C: np.ndarray, m: int) -> np.ndarray:
    """Return the signal of coefficients C (H+1, n) at m equal instants, (m, n)."""
    return np.asarray(np.fft.irfft(C * m, m, axis=0))


def _reason(problem: _Problem, R: np.ndarray, got: str) -> str:
    size = np.where(np.isfinite(R), np.abs(R), np.inf).max(axis=0)
    scale = np.maximum(size.max(initial=0.0), 1e-300)
    worst = int(problem.S[int(np.argmax(size / scale))]) if len(problem.S) else 0
    name = linear.state_names(problem.setup.model)[worst]
    block = problem.setup.model.block_of_state(worst)
    return (
        f"no periodic motion found at {problem.base:.6g} rad/s; {got}, the most in block '{block}' ({name}): a motion "
        "may exist all the same; try speeds nearer to one that settled, or `rotorsim run`, which needs no start"
    )


class _Real:
    """Newton's linear system in real coefficients a_0, a_k, b_k: x = a_0 + sum a_k cos k tau + b_k sin k tau."""

    def __init__(self, H: int, m: int) -> None:
        self.H, self.m = H, m
        angle = 2 * np.pi / m * np.outer(np.arange(m), np.arange(1, H + 1))
        self.basis = np.concatenate([np.ones((m, 1)), np.cos(angle), np.sin(angle)], axis=1)
        self.project = self.basis.T * (2.0 / m)
        self.project[0] /= 2

    def newton_step(self, G: np.ndarray, J: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Solve (I - G D) delta = R, D = dg_E/dx_S; G (H+1, S, E), J (m, E, S), R (H+1, S) complex.

        By Woodbury's identity delta = R + G w with (I - D G) w = D R: only the rows E are solved for.
        """
        H, n_s, n_e = self.H, G.shape[1], G.shape[2]
        size = 2 * H + 1
        D = np.zeros((size, n_s, size, n_e))  # [coefficient of x_S, s, coefficient of g_E, e]
        for e, s in np.argwhere(np.any(J != 0, axis=0)):
            D[:, s, :, e] = (self.project @ (J[:, e, s, None] * self.basis)).T
        flat = D.reshape(size, n_s, size * n_e)
        # (a - ib) of x = G (a - ib) of g: a_x = P a + Q b, b_x = P b - Q a with G = P + iQ
        P, Q = G.real.transpose(0, 2, 1), G.imag.transpose(0, 2, 1)
        a, b = flat[1 : H + 1], flat[H + 1 :]
        DG = np.concatenate([P[:1] @ flat[:1], P[1:] @ a - Q[1:] @ b, Q[1:] @ a + P[1:] @ b])
        matrix = np.eye(size * n_e) - DG.reshape(size * n_e, size * n_e).T
        right = np.concatenate([R[:1].real, 2 * R[1:].real, -2 * R[1:].imag])
        w = np.linalg.solve(matrix, right.ravel() @ flat.reshape(size * n_s, -1)).reshape(size, n_e)
        w_k = w[: H + 1].astype(complex)
        w_k[1:] = (w[1 : H + 1] - 1j * w[H + 1 :]) / 2
        return np.asarray(R + np.einsum("kse,ke->ks", G, w_k))
