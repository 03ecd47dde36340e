"""How participants are coupled: which output goes to which input, in which order they are best advanced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Generic, TypeVar

import networkx as nx
import numpy as np

from rotorsim.cosim.participant import Participant
from rotorsim.errors import Problem, RotorsimError, near_miss

NEWTON_STEPS = 20
NEWTON_TOLERANCE = 1e-10


P_co = TypeVar("P_co", bound=Participant, covariant=True)


@dataclass(frozen=True, eq=False)
class Coupling(Generic[P_co]):
    """Participants and the matrix L (inputs, outputs) of their wires: u = L y + u0.

    u and y hold the inputs and outputs of all participants, one after the other. held (outputs,): those that are
    piecewise constant (sampled), which are held and never extrapolated.
    """

    participants: tuple[P_co, ...]
    L: np.ndarray
    u0: np.ndarray
    held: np.ndarray | None = None

    @cached_property
    def u_parts(self) -> list[slice]:
        """Where the inputs of each participant lie in u."""
        return _parts([len(p.inputs) for p in self.participants])

    @cached_property
    def y_parts(self) -> list[slice]:
        """Where the outputs of each participant lie in y."""
        return _parts([len(p.outputs) for p in self.participants])

    @cached_property
    def scales(self) -> tuple[np.ndarray, np.ndarray]:
        """Factors and offsets (2, n) of all inputs and of all outputs: SI = factor * value in loop.c + offset."""
        of_u = [
            np.tile((1.0, 0.0), (len(p.inputs), 1)) if p.u_scales is None else p.u_scales for p in self.participants
        ]
        of_y = [
            np.tile((1.0, 0.0), (len(p.outputs), 1)) if p.y_scales is None else p.y_scales for p in self.participants
        ]
        return np.concatenate(of_u).T, np.concatenate(of_y).T

    def inputs_of(self, y: np.ndarray) -> np.ndarray:
        """Return u for outputs y."""
        return np.asarray(self.L @ y + self.u0)

    @cached_property
    def is_held(self) -> np.ndarray:
        """Which outputs (n_y,) are held."""
        return np.zeros(self.L.shape[1], bool) if self.held is None else self.held

    @cached_property
    def moving_wires(self) -> np.ndarray:
        """L of the outputs that move between communication points."""
        return np.where(self.is_held, 0.0, self.L)

    @cached_property
    def held_wires(self) -> np.ndarray:
        """L of the outputs that are held."""
        return np.where(self.is_held, self.L, 0.0)

    @cached_property
    def order(self) -> list[int]:
        """The order for Gauss-Seidel: as few signals as possible go backward against it.

        Nobody waits for a signal that is held from the start of the step: sampled controllers come last.
        """
        given = np.array(
            [[np.count_nonzero(self.moving_wires[rows, columns]) for rows in self.u_parts] for columns in self.y_parts]
        )  # signals that a gives to b, at [a, b]
        np.fill_diagonal(given, 0)
        order: list[int] = []
        condensed = nx.condensation(nx.from_numpy_array(given, create_using=nx.DiGraph))
        for component in nx.topological_sort(condensed):
            members = sorted(condensed.nodes[component]["members"])
            while members:
                balance = given[np.ix_(members, members)]
                order.append(members.pop(int(np.argmax(balance.sum(axis=1) - balance.sum(axis=0)))))
        return order

    @cached_property
    def feedthrough(self) -> np.ndarray:
        """Whether an output follows an input at the same instant, (outputs, inputs)."""
        D = np.zeros((self.L.shape[1], self.L.shape[0]), bool)
        for participant, y, u in zip(self.participants, self.y_parts, self.u_parts, strict=True):
            D[y, u] = participant.feedthrough
        return D

    @cached_property
    def passes(self) -> bool:
        """Whether any output follows an input at the same instant."""
        return bool(self.feedthrough.any())

    @cached_property
    def has_loop(self) -> bool:
        """Whether outputs and inputs make an algebraic loop across participants."""
        pattern = (self.L != 0).astype(int) @ self.feedthrough.astype(int)
        return not nx.is_directed_acyclic_graph(nx.from_numpy_array(pattern, create_using=nx.DiGraph))

    def consistent(
        self, t: float, u: np.ndarray, y: np.ndarray | None = None, due: Sequence[int] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return u and y that agree at time t: u = L y(u) + u0, by sweeps, or by Newton's method in a loop.

        due: participants that are at time t, default all; the outputs of the others stay as they are in y.
        Raises RotorsimError when they cannot be made to agree.
        """
        y = self._outputs(t, u, y, due)
        if not self.has_loop:
            for _ in range(len(u) + 1):
                new = self.inputs_of(y)
                if np.array_equal(new, u):
                    break
                u, y = new, self._outputs(t, new, y, due)
            return u, y
        scale = np.maximum(np.abs(u), 1e-6)
        for _ in range(NEWTON_STEPS):
            residual = self.inputs_of(y) - u
            if np.abs(residual).max(initial=0.0) <= NEWTON_TOLERANCE * (1 + np.abs(u).max(initial=0.0)):
                return u, y
            moves = np.diag(1e-6 * scale)
            moved = [self.inputs_of(self._outputs(t, u + move, y, due)) - (u + move) for move in moves]
            J = (np.column_stack(moved) - residual[:, None]) / (1e-6 * scale)
            try:
                u = u - np.linalg.solve(J, residual)
            except np.linalg.LinAlgError:
                break
            y = self._outputs(t, u, y, due)
        hint = "put a delay or a dynamic block into the loop"
        raise RotorsimError(Problem(f"inputs and outputs cannot be made to agree at t = {t:g} s", hint=hint))

    def rates_of(self, rates: Mapping[str, int]) -> tuple[int, ...]:
        """Return of every participant how many base steps it takes at once; names: participants, or blocks in them.

        Raises RotorsimError with every name and number that does not fit.
        """
        known = {block: k for k, p in enumerate(self.participants) for block in (p.name, *p.blocks)}
        chosen = [1] * len(self.participants)
        problems = []
        for name, rate in rates.items():
            k = known.get(name)
            if k is None:
                problems.append(Problem("no such participant", name, hint=near_miss(name, known)))
            elif rate < 1 or rate != int(rate):
                problems.append(Problem(f"rate {rate:g}: not a whole number of base steps", name, hint="1 or more"))
            elif chosen[k] not in (1, rate):
                what = f"rates {chosen[k]} and {rate:g} for one participant"
                problems.append(Problem(what, name, hint="its blocks step together: give one rate"))
            else:
                chosen[k] = int(rate)
        if problems:
            raise RotorsimError(*problems)
        return tuple(chosen)

    def close(self) -> None:
        """Close all participants."""
        for participant in self.participants:
            participant.close()

    @property
    def has_rates(self) -> bool:
        """Whether every participant tells the rates of its outputs."""
        return all(participant.has_rates for participant in self.participants)

    def consistent_rates(self, t: float, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return the rates of the inputs at time t that agree with the rates of the outputs."""
        for _ in range(NEWTON_STEPS if self.has_loop else len(u) + 1):
            y = [p.output_rate(t, u[part], rate[part]) for p, part in zip(self.participants, self.u_parts, strict=True)]
            new = self.moving_wires @ np.concatenate(y)
            if np.allclose(new, rate, rtol=1e-12, atol=0.0):
                break
            rate = new
        return rate

    def _outputs(
        self, t: float, u: np.ndarray, y: np.ndarray | None = None, due: Sequence[int] | None = None
    ) -> np.ndarray:
        made = np.empty(self.L.shape[1]) if y is None else y.copy()
        for k in range(len(self.participants)) if due is None else due:
            made[self.y_parts[k]] = self.participants[k].output(t, u[self.u_parts[k]])
        return made


def _parts(sizes: Sequence[int]) -> list[slice]:
    ends = [0, *np.cumsum(sizes).tolist()]
    return [slice(a, b) for a, b in pairwise(ends)]
