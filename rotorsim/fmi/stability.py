"""What the coupling does to stability: the linearised loop with the master in it, one communication step as a matrix.

Coupling by held or extrapolated inputs adds delay. A magnetic bearing lives by the damping of its controller, so that a
run can be stable and still be wrong: the damping that the coupling costs is computed, and the largest stable step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import expm

from rotorsim.errors import RotorsimError
from rotorsim.fmi.coupling import Coupling
from rotorsim.fmi.masters import Iterative, make_master
from rotorsim.fmi.participant import CompiledParticipant, InputHistory

__all__ = ["CouplingStability", "LinearParticipant", "coupling_stability", "largest_stable_step", "linear_coupling"]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
OSCILLATES = 0.05  # modes with a smaller part of oscillation are not judged by their damping ratio
GRID = 60


class LinearParticipant:
    """x' = A x + B u, y = C x + D u, advanced exactly for polynomial inputs."""

    can_restore = True
    has_rates = True

    def __init__(
        self, name: str, inputs: Sequence[str], outputs: Sequence[str], matrices: tuple[np.ndarray, ...]
    ) -> None:  # fmt: skip
        self.name, self.inputs, self.outputs = name, tuple(inputs), tuple(outputs)
        self.A, self.B, self.C, self.D = matrices
        self.feedthrough = self.D != 0
        self.x = np.zeros(len(self.A))
        self._known: dict[float, tuple[np.ndarray, list[np.ndarray]]] = {}

    def initialise(self, t: float, u: np.ndarray) -> None:
        self.x = np.zeros(len(self.A))

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        return np.asarray(self.C @ self.x + self.D @ u)

    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        return np.asarray(self.C @ (self.A @ self.x + self.B @ u) + self.D @ rate)

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        if h not in self._known:
            taus = h * (1 + NODES) / 2
            kernels = [w * h / 2 * expm(self.A * (h - tau)) @ self.B for tau, w in zip(taus, WEIGHTS, strict=True)]
            self._known = {h: (expm(self.A * h), kernels)}
        transition, kernels = self._known[h]
        x = transition @ self.x
        for kernel, node in zip(kernels, NODES, strict=True):
            x = x + kernel @ u(h * (1 + node) / 2)
        self.x = x
        return self.output(t + h, u(h))

    def save(self) -> Any:
        return self.x.copy()

    def restore(self, saved: Any) -> None:
        self.x = saved.copy()

    def close(self) -> None:
        """Nothing is held."""


@dataclass(frozen=True)
class CouplingStability:
    """The loop with the master in it, against the loop as a whole.

    radius: largest size of an eigenvalue of one communication step (stable below 1). whole, coupled: the eigenvalue
    [1/s] of the whole loop that loses most damping, and what the coupling makes of it; kept: share of its damping
    ratio that is left. largest_step: the step above which it is unstable [s].
    """

    radius: float
    whole: complex
    coupled: complex
    kept: float
    largest_step: float

    @property
    def stable(self) -> bool:
        """Whether the coupled loop is stable."""
        return self.radius < 1 + 1e-9


def linear_coupling(coupling: Coupling) -> Coupling | None:
    """Return a coupling of linearised participants, or None when one of them cannot be linearised."""
    made = []
    for participant in coupling.participants:
        matrices = getattr(participant, "linear", None)
        found = _linear_part(participant) if isinstance(participant, CompiledParticipant) else matrices and matrices()
        if found is None:
            return None
        made.append(LinearParticipant(participant.name, participant.inputs, participant.outputs, found))
    return Coupling(tuple(made), coupling.L, np.zeros_like(coupling.u0))


def _linear_part(participant: CompiledParticipant) -> tuple[np.ndarray, ...] | None:
    part = participant.part
    if participant.n_z:
        return None
    trace = part.trace
    x, z = part.initial(participant.p)
    record = [name.partition("[")[0] for name in participant.outputs]
    y = ca.vertcat(*[part.expression(port) for port in dict.fromkeys(record)])
    if y.numel() != len(participant.outputs):
        y = ca.vertcat(*[part.expression(name) for name in participant.outputs])
    jacobians = [ca.jacobian(of, by) for of in (trace.xdot, y) for by in (trace.x, trace.z)]
    function = ca.Function("linear", [trace.t, trace.x, trace.z, trace.p], jacobians)
    A, B, C, D = (np.array(m.full()) for m in function(0.0, x, z, participant.p))
    return A, B, C, D


def coupling_stability(
    coupling: Coupling, step: float, *, master: str, order: int | None = None, limit: bool = True
) -> CouplingStability | None:  # fmt: skip
    """Return how stable the coupled loop is with this communication step, or None when it cannot be linearised."""
    linear = linear_coupling(coupling)
    if linear is None:
        return None
    whole = _whole(linear)
    discrete = np.linalg.eigvals(step_matrix(linear, step, master, order))
    radius = float(np.abs(discrete).max(initial=0.0))
    reference, changed, kept = _most_hurt(whole, discrete, step)
    largest = largest_stable_step(linear, master=master, order=order) if limit else np.nan
    return CouplingStability(radius, reference, changed, kept, largest)


def _whole(coupling: Coupling) -> np.ndarray:
    """Return the eigenvalues of the loop without coupling error."""
    parts = [p for p in coupling.participants if isinstance(p, LinearParticipant)]
    A, B, C, D = (_diagonal([getattr(p, key) for p in parts]) for key in "ABCD")
    closed = np.linalg.solve(np.eye(len(coupling.u0)) - coupling.L @ D, coupling.L @ C)
    return np.asarray(np.linalg.eigvals(A + B @ closed))


def _diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    out = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
    row = column = 0
    for block in blocks:
        out[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return out


def step_matrix(coupling: Coupling, step: float, master: str, order: int | None = None) -> np.ndarray:
    """Return the matrix of one communication step, on the states and the inputs at the two points before.

    It is found by letting the master itself take one step from every unit state.
    """
    worker = make_master(master, coupling, order=order, tolerance=1e-12)
    parts = [p for p in coupling.participants if isinstance(p, LinearParticipant)]
    sizes = [len(p.x) for p in parts]
    n, m = sum(sizes), len(coupling.u0)
    memory = worker.order if master != "iterative" else worker.order - 1
    columns = []
    for k in range(n + memory * m):
        state = np.zeros(n + memory * m)
        state[k] = 1.0
        at = 0
        for part, size in zip(parts, sizes, strict=True):
            part.x = state[at : at + size].copy()
            at += size
        u, _ = coupling.consistent(0.0, np.zeros(m))
        past = [state[n + j * m : n + (j + 1) * m] for j in range(memory)]
        worker.past = [*((-(j + 1) * step, past[j]) for j in reversed(range(memory))), (0.0, u)]
        if isinstance(worker, Iterative):
            worker.begin(0.0, u)
        worker.step(0.0, step)
        now = [v for _, v in worker.past][-1 - memory : -1][::-1]
        columns.append(np.concatenate([*(p.x for p in parts), *now]))
    return np.array(columns).T


def _most_hurt(whole: np.ndarray, discrete: np.ndarray, step: float) -> tuple[complex, complex, float]:
    """Return the mode that loses most damping: its eigenvalue, what it becomes, the share of damping ratio kept."""
    with np.errstate(divide="ignore", invalid="ignore"):
        coupled = np.log(discrete.astype(complex)) / step
    worst: tuple[complex, complex, float] = (0j, 0j, 1.0)
    for value in whole:
        if value.imag < OSCILLATES * abs(value) or abs(value.imag) * step > np.pi or not value.real < 0:
            continue
        near = coupled[np.argmin(np.abs(coupled - value))]
        kept = float((-near.real / abs(near)) / (-value.real / abs(value)))
        if kept < worst[2] or worst[0] == 0:
            worst = (complex(value), complex(near), kept)
    return worst


def largest_stable_step(coupling: Coupling, *, master: str, order: int | None = None) -> float:
    """Return the communication step [s] above which the coupled loop is unstable (infinite if none is found).

    The whole loop's fastest mode sets where to look. A loop that is unstable as a whole has none: 0.
    """
    whole = _whole(coupling)
    slowest_rise = 1e-9 * np.abs(whole).max(initial=1.0)
    if (whole.real > slowest_rise).any():
        return 0.0
    fastest = float(np.abs(whole).max(initial=0.0))
    if fastest == 0.0:
        return np.inf

    def stable(step: float) -> bool:
        try:
            matrix = step_matrix(coupling, step, master, order)
        except (RotorsimError, np.linalg.LinAlgError):  # the iteration itself may not converge there
            return False
        return bool(np.isfinite(matrix).all() and np.abs(np.linalg.eigvals(matrix)).max(initial=0.0) < 1 + 1e-7)

    steps = np.geomspace(1e-3, 1e2, GRID) / fastest
    below = steps[0]
    for step in steps:
        if not stable(float(step)):
            above = float(step)
            break
        below = float(step)
    else:
        return np.inf
    for _ in range(20):
        middle = (below + above) / 2
        below, above = (middle, above) if stable(middle) else (below, middle)
    return float(below)
