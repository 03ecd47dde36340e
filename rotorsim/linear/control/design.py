"""Design of an observer-based state feedback (LQG) from the linearised plant between current and displacement."""

from __future__ import annotations

import numpy as np
from scipy.linalg import schur, solve_continuous_are, solve_sylvester

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import LinearSystem, linearise
from rotorsim.linear.loop import controller_output
from rotorsim.linear.state_space import StateSpace, reached
from rotorsim.model.compiled import Model

MOST_STATES = 8
LARGEST_PEAK = 3.0  # zone A of ISO 14839-3:2006
WEIGHT_FACTORS = (1.0, 3.0, 0.3, 10.0, 0.1, 30.0, 100.0)  # tried in this order, times the weight asked for


def design_state_feedback(
    diagram: Diagram | Model,
    controller: str = "controller",
    *,
    current_weight: float = 1.0,
    noise_weight: float = 1.0,
    integral: bool = False,
    states: int = MOST_STATES,
    parameters: dict[str, float] | None = None,
) -> dict[str, np.ndarray]:
    """Return the matrices A, B, C, D of an LQG controller, displacement -> current, for `state_feedback`.

    The loop is opened at the controller's output and the rest linearised; the unstable and the slowest modes
    (at most ``states``) are kept. With a gain g of the plant near its first mode as the scale, the regulator
    minimises the integral of |u|^2 + (g current_weight / 10)^2 |i|^2, and the observer assumes a disturbance of
    1 A at the current and noise of g noise_weight / 10. integral: one further state per axis returns the mean
    displacement to zero. Weights are changed by up to 100 times until the loop with the full plant is stable and
    its sensitivity peak below 3; the best found is taken. Up to 8 more states are kept where fewer give none.

    Raises RotorsimError where no weights give a stable loop.
    Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods (1990), ch. 8; zones: ISO 14839-3:2006.
    """
    plant = plant_of(diagram, controller, parameters)
    best: tuple[float, tuple[np.ndarray, ...]] = (np.inf, ())
    for count in (states, states + 4, states + 8):
        reduced = reduce_modes(plant, count)
        scale = _scale(reduced)
        for factor in WEIGHT_FACTORS:
            try:
                trial = _lqg(reduced, scale, current_weight * factor, noise_weight * factor, integral)
            except np.linalg.LinAlgError:  # the Riccati equation has no stabilising solution with these weights
                continue
            peak = _peak(plant, trial)
            if peak < best[0]:
                best = (peak, trial)
            if peak < LARGEST_PEAK:
                break
        if np.isfinite(best[0]):
            break
    if not best[1]:
        raise RotorsimError(
            Problem(
                what="no state feedback found that makes the closed loop stable",
                subject=controller,
                hint="keep more modes (states), or check that current moves what the sensors see",
            ),
            exit_code=1,
        )
    return dict(zip("ABCD", best[1], strict=True))


def plant_of(diagram: Diagram | Model, controller: str, parameters: dict[str, float] | None = None) -> StateSpace:
    """Return d x/dt = A x + B i, u = C x + D i from a controller's output i to the signal u wired to its displacement.

    States that the current does not reach, or that do not reach the displacement, are left out.
    """
    port = controller_output(diagram, controller)
    wires = diagram.diagram.wires if isinstance(diagram, Model) else diagram.wires
    sources = [str(w.source) for w in wires if (w.target.block, w.target.port) == (controller, "displacement")]
    if len(sources) != 1:
        what = "the input 'displacement' of a controller needs one wire"
        raise RotorsimError(Problem(what=what, subject=f"{controller}.displacement"))
    system = linearise(diagram, parameters=parameters, inputs=(port,), outputs=(sources[0],), open_loop=True)
    return _connected(system, controller)


def _connected(system: LinearSystem, controller: str) -> StateSpace:
    driven = reached(system.A != 0, (system.B != 0).any(axis=1))
    seen = reached(system.A.T != 0, (system.C != 0).any(axis=0))
    keep = np.flatnonzero(driven & seen)
    if not len(keep):
        what = "its output does not act on its input 'displacement'"
        hint = "wire it to a bearing that moves what is measured; the force-current factor must not be zero"
        raise RotorsimError(Problem(what=what, subject=controller, hint=hint))
    return StateSpace(system.A[np.ix_(keep, keep)], system.B[keep], system.C[:, keep], system.D)


def reduce_modes(plant: StateSpace, states: int = MOST_STATES) -> StateSpace:
    """Return the plant with its unstable and slowest modes only; the others give their static part to D.

    An ordered real Schur form and a Sylvester equation part the two groups, also where modes are defective.
    """
    n = len(plant.A)
    if n <= states:
        return plant
    poles = np.linalg.eigvals(plant.A)
    rank = np.where(poles.real > 0, 0.0, np.abs(poles))
    order = np.sort(rank)
    count = min(states, n - 1)
    while count > 1 and order[count] - order[count - 1] <= 1e-6 * order[count]:
        count -= 1  # never part a conjugate pair, nor the like modes of two axes
    limit = (order[count - 1] + order[count]) / 2
    T, Z, kept = schur(plant.A, output="real", sort=lambda re, im=0.0: re > 0 or abs(complex(re, im)) <= limit)
    T11, T12, T22 = T[:kept, :kept], T[:kept, kept:], T[kept:, kept:]
    X = solve_sylvester(T11, -T22, -T12)
    B, C = Z.T @ plant.B, plant.C @ Z
    B1, B2 = B[:kept] - X @ B[kept:], B[kept:]
    C1, C2 = C[:, :kept], C[:, kept:] + C[:, :kept] @ X
    return StateSpace(T11, B1, C1, plant.D - C2 @ np.linalg.solve(T22, B2))


def _scale(plant: StateSpace) -> float:
    """Return the size of the plant's gain near its first mode, away from the peak [m/A]."""
    poles = np.abs(np.linalg.eigvals(plant.A))
    first = float(poles[poles > 1e-6 * poles.max()].min())
    return float(np.linalg.norm(plant.response(1.5 * first / (2 * np.pi))[0], 2))


def _lqg(plant: StateSpace, scale: float, rho: float, nu: float, integral: bool) -> tuple[np.ndarray, ...]:
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    n, m, k = len(A), B.shape[1], C.shape[0]
    R = (scale * rho / 10) ** 2 * np.eye(m)
    V = (scale * nu / 10) ** 2 * np.eye(k)
    # states scaled so that the Riccati equations are well conditioned
    size = np.linalg.norm(np.linalg.eigvals(A), np.inf)
    if integral:
        rate = 0.05 * size  # q' = rate u, weighted as u
        A1 = np.block([[A, np.zeros((n, k))], [rate * C, np.zeros((k, k))]])
        B1 = np.vstack([B, rate * D])
        C1 = np.block([[C, np.zeros((k, k))], [np.zeros((k, n)), np.eye(k)]])
    else:
        A1, B1, C1 = A, B, C
    tiny = 1e-9 * np.trace(C1.T @ C1) / len(A1) * np.eye(len(A1))
    K = np.linalg.solve(R, B1.T @ solve_continuous_are(A1, B1, C1.T @ C1 + tiny, R))
    noise = B @ B.T + 1e-9 * np.trace(B @ B.T) / n * np.eye(n)
    L = np.linalg.solve(V, C @ solve_continuous_are(A.T, C.T, noise, V)).T
    Kx, Kq = K[:, :n], K[:, n:]
    observer = A - B @ Kx - L @ C + L @ D @ Kx
    if not integral:
        return observer, L, -Kx, np.zeros((m, k))
    A_c = np.block([[observer, (L @ D - B) @ Kq], [np.zeros((k, n + k))]])
    return A_c, np.vstack([L, rate * np.eye(k)]), -K, np.zeros((m, k))


def closed_loop(plant: StateSpace, controller: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the state matrix of plant and strictly proper controller joined."""
    A, B, C, _ = controller
    return np.block([[plant.A, plant.B @ C], [B @ plant.C, A + B @ plant.D @ C]])


def _peak(plant: StateSpace, controller: tuple[np.ndarray, ...]) -> float:
    """Return the largest singular value of the sensitivity with the full plant; infinite for an unstable loop."""
    whole = closed_loop(plant, controller)
    poles = np.linalg.eigvals(whole)
    if not np.isfinite(poles).all() or poles.real.max() >= 0:
        return np.inf
    w = np.unique(np.abs(np.concatenate([poles, np.linalg.eigvals(plant.A)])))
    w = w[w > 0]
    grid = np.unique(np.concatenate([w, np.geomspace(w.min() / 10, 10 * w.max(), 200)]))
    B, C = controller[1:3]
    n, m = len(plant.A), plant.B.shape[1]
    inputs = np.vstack([plant.B, B @ plant.D])
    outputs = np.hstack([np.zeros((m, n)), C])
    system = StateSpace(whole, inputs, outputs, np.eye(m))
    return float(np.linalg.norm(system.response(grid / (2 * np.pi)), 2, axis=(1, 2)).max())
