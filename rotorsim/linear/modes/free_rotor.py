"""The rotor of a diagram without its bearings and without damping: what critical speed maps and mode shapes are of.

q'' = W G q' - S q + B f,   u = C q

S = M^-1 K, W: speed, G: gyroscopic, B = M^-1 T. f: forces of the bearings, opened; all else in the diagram stays. From
the exact Jacobians of the traced diagram at rest and at a speed; what does not turn sign with the speed is damping, and
is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eig

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import as_model, entry_names, flat_names, jacobians, require_finite, speed_of
from rotorsim.linear.loop import arriving
from rotorsim.linear.state_space import reached
from rotorsim.model.compiled import Model

ENDS = ("bearing", "rotor", "casing", "controller")  # categories at which the way of a signal ends
FORCE, SEEN = "force", "displacement"  # ports of a bearing
REFERENCE_SPEED = 100.0  # rad/s: gyroscopic terms are proportional to the speed
ONE_FREQUENCY = 1e-6  # relative distance of squared natural frequencies that belong to one mode in several planes
RIGID = 2 * np.pi  # rad/s, 1 Hz: below, a body that nothing holds is free but for rounding


@dataclass(frozen=True)
class Bearing:
    """A bearing that acts on a rotor: its block, the output of its force, and the signals (x, y) that it sees."""

    name: str
    force: str
    seen: tuple[str, str]


def bearings_of(diagram: Diagram) -> tuple[Bearing, ...]:
    """Return the bearings of a diagram: blocks of the category ``bearing`` with two axes whose force acts on a rotor.

    Directly or through elementary blocks; one between a housing and the ground is none of the rotor's.
    """
    found = []
    for name, node in diagram.nodes.items():
        if node.block.category != "bearing" or SEEN not in node.inputs or FORCE not in node.outputs:
            continue
        if not any(diagram.nodes[other].block.category == "rotor" for other in downstream(diagram, name)):
            continue
        seen = arriving(diagram, name, SEEN)
        if seen is not None and len(seen) == 2 and node.outputs[FORCE].shape == (2,):
            found.append(Bearing(name, f"{name}.{FORCE}", (seen[0], seen[1])))
    return tuple(found)


def downstream(diagram: Diagram, block: str) -> list[str]:
    """Return the blocks behind one, in the order of the parts of its outputs, through elementary blocks and faults."""
    found: dict[str, None] = {}
    waiting = [block]
    while waiting:
        at = waiting.pop(0)
        for wire in sorted((wire for wire in diagram.wires if wire.source.block == at), key=lambda w: w.source.index):
            other = wire.target.block
            if other not in found:
                found[other] = None
                if diagram.nodes[other].block.category not in ENDS:
                    waiting.append(other)
    return list(found)


@dataclass(frozen=True, eq=False)
class FreeRotor:
    """Matrices of the equation above; B (n, m), C (k, n), rows of C by name; units of the rows of C.

    bearings: the j-th has the columns 2 j and 2 j + 1 of B.
    """

    S: np.ndarray
    G: np.ndarray
    B: np.ndarray
    C: np.ndarray
    names: tuple[str, ...]
    bearings: tuple[Bearing, ...]
    forces: tuple[str, ...]

    def rows(self, names: Sequence[str]) -> np.ndarray:
        """Return the rows of C of some signals."""
        return self.C[[self.names.index(name) for name in names]]

    def column(self, force: str) -> np.ndarray:
        """Return the column of B of one entry of a force."""
        return np.asarray(self.B[:, self.forces.index(force)])

    @property
    def springs(self) -> np.ndarray:
        """Return what a spring of 1 N/m at every bearing, in both axes, adds to S, shape (n, n): f = -u."""
        added = np.zeros_like(self.S)
        for bearing in self.bearings:
            forces = [self.column(name) for name in entry_names(bearing.force, (2,))]
            added += np.column_stack(forces) @ self.rows(bearing.seen)
        return added

    def modes(self) -> list[RotorMode]:
        """Return the modes in the plane of x at rest, ascending, rigid ones first."""
        values, left, right = eig(self.S, left=True)
        order = np.argsort(values.real)
        values, left, right = values.real[order], left[:, order], right[:, order]
        first = int(np.count_nonzero(values < RIGID**2))
        bent = np.arange(first, len(values))
        starts = np.flatnonzero(np.diff(values[bent]) > ONE_FREQUENCY * np.abs(values[bent][1:])) + 1
        groups = [np.arange(first), *np.split(bent, starts)]
        made = []
        for k, group in enumerate(groups):
            if len(group):
                V, W = real_basis(right[:, group]), real_basis(left[:, group])
                frequency = 0.0 if k == 0 else float(np.sqrt(max(values[group].mean(), 0.0)))
                made.append(RotorMode(frequency, V, np.linalg.solve(W.T @ V, W.T), k == 0))
        return made


def real_basis(vectors: np.ndarray) -> np.ndarray:
    """Return as many real vectors that span the same: equal eigenvalues may come as a complex pair by rounding."""
    both = np.column_stack([vectors.real, vectors.imag])
    return np.asarray(np.linalg.svd(both / np.abs(both).max(), full_matrices=False)[0][:, : vectors.shape[1]])


@dataclass(frozen=True, eq=False)
class RotorMode:
    """A natural frequency [rad/s], its vectors V (n, c) in all planes and W^T (c, n), W^T V = 1. rigid: of a body."""

    frequency: float
    V: np.ndarray
    WT: np.ndarray
    rigid: bool

    def residue(self, c: np.ndarray, b: np.ndarray) -> float:
        """Return the residue of a row c of C and a column b of B: c (s^2 I + S)^-1 b = sum of R / (s^2 + w^2)."""
        return float((c @ self.V) @ (self.WT @ b))


def free_rotor(
    diagram: Diagram | Model,
    *,
    signals: Sequence[str] = (),
    forces: Sequence[str] = (),
    parameters: Mapping[str, Any] | None = None,
) -> FreeRotor:
    """Return the rotor of a diagram without its bearings and without damping, at rest.

    signals: rows of C beside what the bearings see. forces: input ports whose entries are columns of B beside those of
    the bearings. A diagram parameter ``speed`` tells the gyroscopic terms; without one there are none.

    Raises RotorsimError without bearings, and where what they act on is not of second order.
    """
    drawn = diagram.diagram if isinstance(diagram, Model) else diagram
    bearings = bearings_of(drawn)
    if not bearings:
        what = "no bearing: no block of the category 'bearing' has its force wired"
        raise RotorsimError(Problem(what, drawn.name, hint="`rotorsim blocks` lists them: amb, support, ..."))
    opened = [bearing.force for bearing in bearings]
    model = as_model(drawn, tuple(forces), tuple(opened))
    rows = dict.fromkeys([name for bearing in bearings for name in bearing.seen])
    outputs = tuple(dict.fromkeys([*rows, *signals]))
    ports = (*opened, *forces)
    A, B, C = _opened(model, ports, outputs, parameters, 0.0)
    pattern = A != 0
    there = reached(pattern, (B != 0).any(axis=1)) & reached(pattern.T, (C != 0).any(axis=0))
    place = [k for k in np.flatnonzero(there).tolist() if np.count_nonzero(A[k]) == 1 and A[k].max() == 1.0]
    rate = [int(np.flatnonzero(A[k])[0]) for k in place]
    if sorted([*place, *rate]) != np.flatnonzero(there).tolist() or not place:
        odd = sorted({model.block_of_state(k) for k in np.flatnonzero(there).tolist() if k not in {*place, *rate}})
        what = "not of second order: states between the bearings' forces and what they see are no position and no rate"
        raise RotorsimError(Problem(what, ", ".join(odd) or drawn.name))
    turning = np.zeros_like(A)
    if speed_of(model, model.p0) is not None:
        turning = (_opened(model, ports, outputs, parameters, REFERENCE_SPEED)[0] - A) / REFERENCE_SPEED
    return FreeRotor(
        S=-A[np.ix_(rate, place)],
        G=turning[np.ix_(rate, rate)],
        B=B[rate],
        C=C[:, place],
        names=tuple(name for output in outputs for name in flat_names(model, output)),
        bearings=bearings,
        forces=tuple(name for port in ports for name in entry_names(port, model.trace.external[port].shape)),
    )


def _opened(
    model: Model, ports: Sequence[str], outputs: tuple[str, ...], parameters: Mapping[str, Any] | None, speed: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, C at a speed from forces that are put in; samplers hold what they have, and no force is theirs."""
    turns = {} if speed_of(model, model.p0) is None else {"speed": speed}
    p = model.parameter_vector({**(parameters or {}), **turns})
    made = jacobians(model, outputs)
    columns = [k for port in ports for k in np.arange(model.trace.v.numel())[model.trace.external[port].part]]
    A, B, C = (made[key](np.zeros((1, 1)), model.x0(p), model.z0(p), p)[0] for key in "ABC")
    require_finite(model, A)
    return A, B[:, columns], C
