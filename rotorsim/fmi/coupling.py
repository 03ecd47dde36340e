"""How participants are coupled: which output goes to which input, in which order they are best advanced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import networkx as nx
import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.participant import Participant

__all__ = ["Coupling"]

NEWTON_STEPS = 20
CLOSE = 1e-10


@dataclass(frozen=True, eq=False)
class Coupling:
    """Participants and the matrix L (inputs, outputs) of their wires: u = L y + u0.

    u and y hold the inputs and outputs of all participants, one after the other. held (inputs,): fed by sampled
    outputs only, which are held and not extrapolated.
    """

    participants: tuple[Participant, ...]
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

    def inputs_of(self, y: np.ndarray) -> np.ndarray:
        """Return u for outputs y."""
        return np.asarray(self.L @ y + self.u0)

    @cached_property
    def graph(self) -> nx.DiGraph:
        """Participants as nodes; an edge a -> b carries the number of signals that a gives to b."""
        graph = nx.DiGraph()
        graph.add_nodes_from(range(len(self.participants)))
        for b, rows in enumerate(self.u_parts):
            for a, columns in enumerate(self.y_parts):
                count = int((self.L[rows, columns] != 0).sum())
                if count and a != b:
                    graph.add_edge(a, b, signals=count)
        return graph

    @cached_property
    def order(self) -> list[int]:
        """The order for Gauss-Seidel: as few signals as possible go backward against it."""
        order: list[int] = []
        condensed = nx.condensation(self.graph)
        for component in nx.topological_sort(condensed):
            members = sorted(condensed.nodes[component]["members"])
            inner = self.graph.subgraph(members)
            while members:
                best = max(members, key=lambda k: (_out(inner, k, members) - _in(inner, k, members), -k))
                order.append(best)
                members = [k for k in members if k != best]
        return order

    @cached_property
    def feedthrough(self) -> np.ndarray:
        """Whether an output follows an input at the same instant, (outputs, inputs)."""
        D = np.zeros((self.L.shape[1], self.L.shape[0]), bool)
        for participant, y, u in zip(self.participants, self.y_parts, self.u_parts, strict=True):
            D[y, u] = participant.feedthrough
        return D

    @property
    def has_loop(self) -> bool:
        """Whether outputs and inputs make an algebraic loop across participants."""
        pattern = (self.L != 0).astype(int) @ self.feedthrough.astype(int)
        graph = nx.from_numpy_array(pattern, create_using=nx.DiGraph)
        return not nx.is_directed_acyclic_graph(graph)

    def consistent(self, t: float, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return u and y that agree at time t: u = L y(u) + u0, by sweeps, or by Newton's method in a loop.

        Raises RotorsimError when they cannot be made to agree.
        """
        y = self._outputs(t, u)
        if not self.has_loop:
            for _ in range(len(u) + 1):
                new = self.inputs_of(y)
                if np.array_equal(new, u):
                    break
                u, y = new, self._outputs(t, new)
            return u, y
        scale = np.maximum(np.abs(u), 1e-6)
        for _ in range(NEWTON_STEPS):
            residual = self.inputs_of(y) - u
            if np.abs(residual).max(initial=0.0) <= CLOSE * (1 + np.abs(u).max(initial=0.0)):
                return u, y
            J = np.empty((len(u), len(u)))
            for k in range(len(u)):
                moved = u.copy()
                moved[k] += 1e-6 * scale[k]
                J[:, k] = (self.inputs_of(self._outputs(t, moved)) - moved - residual) / (1e-6 * scale[k])
            u = u - np.linalg.solve(J, residual)
            y = self._outputs(t, u)
        hint = "put a delay or a dynamic block into the loop"
        raise RotorsimError(Problem(f"inputs and outputs cannot be made to agree at t = {t:g} s", hint=hint))

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
            new = self.L @ np.concatenate(y)
            if np.allclose(new, rate, rtol=1e-12, atol=0.0):
                break
            rate = new
        return rate

    def _outputs(self, t: float, u: np.ndarray) -> np.ndarray:
        return np.concatenate([p.output(t, u[part]) for p, part in zip(self.participants, self.u_parts, strict=True)])


def _parts(sizes: Sequence[int]) -> list[slice]:
    ends = [0, *np.cumsum(sizes).tolist()]
    return [slice(a, b) for a, b in pairwise(ends)]


def _out(graph: nx.DiGraph, k: int, members: Sequence[int]) -> int:
    return sum(graph.edges[k, b]["signals"] for b in graph.successors(k) if b in members)


def _in(graph: nx.DiGraph, k: int, members: Sequence[int]) -> int:
    return sum(graph.edges[a, k]["signals"] for a in graph.predecessors(k) if a in members)
