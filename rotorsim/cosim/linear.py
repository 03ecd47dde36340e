"""Linear models as participants, and their coupling: many runs at once, exact between hits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import block_diag, expm

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.inputs import InputHistory
from rotorsim.cosim.participant import Participant
from rotorsim.linear.linear_model import HIT, LinearModel

NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


class LinearParticipant(Participant):
    """A linear model as a participant, advanced exactly for inputs that are polynomials between hits.

    It starts from zero right behind the hits at the start. x (n,), or (n, runs): many runs at once.
    """

    def __init__(self, name: str, inputs: Sequence[str], outputs: Sequence[str], model: LinearModel) -> None:
        self.name, self.inputs, self.outputs, self.model = name, tuple(inputs), tuple(outputs), model
        self.feedthrough = self.following = model.D != 0
        self.moving = np.ones(len(model.C), bool)
        self.x = np.zeros(len(model.A))
        self._known: dict[float, tuple[np.ndarray, list[np.ndarray]]] = {}

    def initialise(self, t: float, u: np.ndarray) -> None:
        self.x = np.zeros(len(self.model.A))

    def start(self, t: float, u: np.ndarray) -> None:
        """Nothing is left to be done."""

    def output(self, t: float, u: np.ndarray) -> np.ndarray:
        return np.asarray(self.model.C @ self.x + self.model.D @ u)

    def output_rate(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        m = self.model
        return np.asarray(m.C @ (m.A @ self.x + m.B @ u) + m.D @ rate)

    def step(self, t: float, h: float, u: InputHistory) -> np.ndarray:
        at = t
        for hit in self.model.hits(t, t + h) if self.model.periods else ():
            self._flow(at - t, hit - at, u)
            J, K = self.model.at_hit(hit)
            self.x = J @ self.x + K @ u(hit - t)
            at = hit
        if t + h - at > HIT * h:
            self._flow(at - t, t + h - at, u)
        return self.output(t + h, u(h))

    def _flow(self, start: float, h: float, u: InputHistory) -> None:
        key = float(f"{h:.9e}")
        if key not in self._known:
            A, B = self.model.A, self.model.B
            taus = h * (1 + NODES) / 2
            kernels = [w * h / 2 * expm(A * (h - tau)) @ B for tau, w in zip(taus, WEIGHTS, strict=True)]
            self._known[key] = (expm(A * h), kernels)
        transition, kernels = self._known[key]
        x = transition @ self.x
        for kernel, node in zip(kernels, NODES, strict=True):
            x = x + kernel @ u(start + h * (1 + node) / 2)
        self.x = x

    def next_hit(self, t: float) -> float:
        return min((T * (np.floor(t / T + HIT) + 1) for T in self.model.periods), default=np.inf)

    def forget(self) -> None:
        """Drop the matrices of step widths that will not come again."""
        self._known.clear()

    def save(self) -> Any:
        return self.x.copy()

    def restore(self, saved: Any) -> None:
        self.x = saved.copy()

    def linear(self, used: np.ndarray) -> LinearModel | str:
        return self.model


class LinearCoupling(Coupling[LinearParticipant]):
    """A coupling of linear participants, whose vectors may be matrices: a column for each of many runs at once."""

    def consistent(
        self, t: float, u: np.ndarray, y: np.ndarray | None = None, due: Sequence[int] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return u and y that agree: (I - L D) u = L C x + u0."""
        own = list(zip(self.participants, self.y_parts, strict=True))
        turn = range(len(own)) if due is None else due
        D = block_diag(*(p.model.D * (k in turn) for k, (p, _) in enumerate(own)))
        free = [p.model.C @ p.x if k in turn or y is None else y[part] for k, (p, part) in enumerate(own)]
        known = np.concatenate(free)
        u = np.linalg.solve(np.eye(len(self.L)) - self.L @ D, self.inputs_of(known))
        return u, known + D @ u
