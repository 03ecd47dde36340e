"""Equations of a turning shaft in their linear part, with matrices of numbers, and laws of the rest.

x' = A x + E q,   y = C x + D q,   q = q(t, z, v; p)

A law reads the states themselves, or z = X x + Y q of laws before it. Of a structure whose fast modes follow their
forces at once (`rotorsim.identification.waveform.driven.slow_modes`) the matrices are those of all modes, computed and
then reduced at a speed: as expressions they would be full, and laws of states within laws many times as long.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.identification.waveform.driven.equations import OF_THE_ANGLE, DrivenEquations, clock_ports
from rotorsim.identification.waveform.driven.slow_modes import Structure
from rotorsim.linear.sampled import Tangent
from rotorsim.model.linearity import jacobian, pattern, semi_linear
from rotorsim.model.matrix_function import MatrixFunction

MOST_LAWS_OF_STATES = 0.5  # that depend on them otherwise than linearly: beyond, steps of the whole cost less


@dataclass(frozen=True, eq=False)
class Level:
    """Laws q (r,) of t, z, v and p; rows: of z, that they are the first to read, and that follow from `before` laws."""

    q: Any
    rows: range = range(0)
    before: int = 0


@dataclass(frozen=True, eq=False)
class _Whole:
    """L of [f; g] = L [x; 1; w] at inputs and parameters; moves: which of the m parameters L depends on."""

    values: MatrixFunction
    with_slopes: MatrixFunction
    states: int
    moves: tuple[int, ...]

    def __call__(self, v: np.ndarray, p: np.ndarray, slopes: bool) -> dict[str, Tangent]:
        """Return A, E, C and D at inputs v (n_v, N), p (n_p,) or (n_p, N), with derivatives by `moves` or none."""
        count, function = (1 + len(self.moves), self.with_slopes) if slopes else (1, self.values)
        rows, columns = self.values.shape
        at = function(v, p.reshape(len(p), -1)).reshape(-1, rows, count, columns).transpose(2, 0, 1, 3)
        L, states, rest = Tangent(at[0], at[1:]), slice(self.states), slice(self.states, None)
        parts = {"A": (states, states), "E": (states, rest), "C": (rest, states), "D": (rest, rest)}
        return {key: L.part(*part) for key, part in parts.items()}


@dataclass(frozen=True, eq=False)
class Split:
    """Equations x' = A x + E q, y = C x + D q; q (r,): laws of their levels one after another, the first of them 1.

    arguments: t, x or z, v, p of the laws. laws: how many depend on x or z. slow: the places in v that A, E, C and D
    depend on. whole: all of these, before any modes are left out.
    """

    levels: tuple[Level, ...]
    arguments: tuple[Any, Any, Any, Any]
    laws: int
    slow: tuple[int, ...]
    whole: _Whole

    @property
    def r(self) -> int:
        """The number of laws."""
        return sum(int(level.q.numel()) for level in self.levels)

    @property
    def read(self) -> int:
        """The number of what laws read that are not states."""
        return max(level.rows.stop for level in self.levels)

    @classmethod
    def of(cls, eq: DrivenEquations) -> Split | None:
        """Return the parts of equations; None where no shaft turns, or too little is linear."""
        ports = clock_ports(eq.model.diagram)
        turning = [k for k, name in enumerate(eq.inputs) if name in ports]
        slow = [k for k in turning if eq.inputs[k].rpartition(".")[2] in OF_THE_ANGLE[1:]]
        if not turning or not eq.n:
            return None
        of = eq if eq.structure is None else eq.structure
        t, x, v, p = of.arguments
        fast = ca.vertcat(t, *[v[k] for k in range(v.numel()) if k not in slow])
        found = semi_linear(ca.vertcat(of.f, of.g), x, fast, v[slow])
        moving = [k for k, law in enumerate(ca.vertsplit(found.phi)) if ca.depends_on(law, x)]
        if len(moving) > MOST_LAWS_OF_STATES * eq.n:
            return None
        free = [k for k in range(found.w.numel()) if k not in moving]
        still = ca.substitute(found.of, ca.vertcat(x, found.w), ca.SX.zeros(x.numel() + found.w.numel()))
        L = ca.sparsify(ca.horzcat(jacobian(found.of, x), still, jacobian(found.of, found.w[[*free, *moving]])))
        there = {symbol.element_hash() for symbol in ca.symvar(L)}
        used = tuple(k for k in slow if v[k].element_hash() in there)
        slopes = ca.sparsify(jacobian(L.nz[:], p[[slot for own in eq.slots for slot in own]]))
        ends = np.cumsum([0, *map(len, eq.slots)]).tolist()
        by = [ca.sum2(slopes[:, first:last]) for first, last in pairwise(ends)]
        moves = tuple(k for k, column in enumerate(by) if column.nnz())
        every = ca.horzcat(L, *(ca.SX(L.sparsity(), ca.densify(by[k])) for k in moves))
        whole = _Whole(MatrixFunction([v, p], L), MatrixFunction([v, p], every), x.numel(), moves)
        laws = ca.vertcat(*[found.phi[k] for k in free]), ca.vertcat(*[found.phi[k] for k in moving])
        if eq.structure is None:
            return cls((Level(ca.vertcat(1, *laws)),), of.arguments, len(moving), used, whole)
        return _OfStructure.split(eq.structure, laws, L, (len(moving), used, whole))

    def matrices(self, v: np.ndarray, p: np.ndarray, slopes: bool) -> Mapping[str, Tangent]:
        """Return A, E, C and D at inputs v (n_v, N), p (n_p,) or (n_p, N), with derivatives by `whole.moves` or none.

        With those that laws read, X and Y and the number of their level: rows of z = X x + Y q.
        """
        return self.whole(v, p, slopes)

    def jacobians(self, t: np.ndarray, x: np.ndarray, v: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return A, and what laws add to dx'/dx, (N, n, n), at times (1, N), states (n, N), inputs and parameters."""
        found = self.matrices(v, p, False)
        return found["A"].value, found["E"].value @ self._slopes(t, x, v, p)

    @cached_property
    def _slopes(self) -> MatrixFunction:
        return MatrixFunction(self.arguments, jacobian(self.levels[0].q, self.arguments[1]))


@dataclass(frozen=True, eq=False)
class _OfStructure(Split):
    """Of a structure some modes of which stay: laws see what it does without the flexibility of the others first, and
    then what it does with that, which follows from them.

    q: 1 and laws of what drives, with their rates where outputs read velocities; laws of x = T z, with modes T; laws of
    x = T z + F (A T z + E q), with the flexibility F; and, where outputs read velocities, rates of the former. own: the
    states that laws read. What the speed changes of A within a period of the modes left out is not in their rates.
    """

    structure: Structure
    own: tuple[int, ...]
    rated: bool

    @classmethod
    def split(
        cls, structure: Structure, laws: tuple[Any, Any], L: Any, rest: tuple[int, tuple[int, ...], _Whole]
    ) -> Split:
        """Return the parts of laws of what drives, and of the states; L: see `_Whole`."""
        t, x, v, p = structure.arguments
        free, moving = (ca.SX(of) for of in laws)
        rated = bool(L[x.numel() :, structure.rate].nnz())

        def rate(of: Any, by: Sequence[tuple[Any, Any]]) -> Any:
            pairs = (*by, (v, structure.rates), (t, ca.SX(1)))
            return sum((ca.jtimes(of, symbol, moves) for symbol, moves in pairs), ca.SX(*of.shape))

        levels = [Level(ca.vertcat(1, free, *([rate(free, ())] if rated else [])))]
        own = tuple(sorted(set(pattern(moving, x).get_triplet()[1])))
        k, r, before = len(own), moving.numel(), levels[0].q.numel()
        z = ca.SX.sym("z", k * (3 if rated else 2) if r else 0)
        if r:
            first, second = (ca.substitute(moving, x[[*own]], z[j * k : (j + 1) * k]) for j in range(2))
            levels += [Level(first, range(k)), Level(second, range(k, 2 * k), before + r)]
        if r and rated:
            turned = rate(first, [(z[:k], z[2 * k :])])
            levels.append(Level(turned, range(2 * k, 3 * k), before + 2 * r))
        return cls(tuple(levels), (t, z, v, p), *rest, structure, own, rated)

    def matrices(self, v: np.ndarray, p: np.ndarray, slopes: bool) -> Mapping[str, Tangent]:
        """Return the matrices of the states that stay, see `Split`."""
        one, every, r = self.structure, self.whole(v, p, slopes), self.laws
        A, E, T, own = every["A"], every["E"], one.whole, [*self.own]
        free, before = E.value.shape[-1] - r, self.levels[0].q.numel()
        moved, turned = np.zeros((2, len(T), len(one.q)))
        moved[one.q], turned[one.rate] = one.flexible, one.flexible

        def laid(level: int, first: int = 0) -> np.ndarray:
            """Return what puts columns of free laws from a place on, and of the others as those of a level."""
            out = np.zeros((free + r, self.r))
            if first:
                out[1:free, first : first + free - 1] = np.eye(free - 1)
            else:
                out[:free, :free] = np.eye(free)
            if r:
                out[free:, before + level * r : before + (level + 1) * r] = np.eye(r)
            return out

        pushed, forced = A.part(one.rate) @ T, E.part(one.rate)
        X, Y = moved @ pushed + T, moved @ (forced @ laid(0))
        found = {"A": one.onto @ (A @ X), "E": one.onto @ (A @ Y + E @ laid(1 if r else 0))}
        shown, beside = X, Y
        if self.rated:
            shown = shown + turned @ (pushed @ found["A"])
            beside = beside + turned @ (pushed @ found["E"] + forced @ laid(2, free))
        found |= {"C": every["C"] @ shown, "D": every["C"] @ beside + every["D"] @ laid(1 if r else 0)}
        still = Tangent(np.broadcast_to(T, X.value.shape), np.zeros_like(X.slopes)), Y  # of Y nothing is read
        reads = [still, (X, Y), (T @ found["A"], T @ found["E"])]
        for k, (level, (of_states, of_laws)) in enumerate(zip(self.levels[1:], reads, strict=False), 1):
            found |= {f"X{k}": of_states.part(own), f"Y{k}": of_laws.part(own, slice(level.before))}
        return found

    def jacobians(self, t: np.ndarray, x: np.ndarray, v: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return A and what laws add, see `Split`: at the states without the flexibility of modes that are left out."""
        found = self.matrices(v, p, False)
        A, E, read = found["A"].value, found["E"].value, self.structure.whole[[*self.own]]
        first = self.levels[0].q.numel()
        slopes = self._slopes(t, read @ x, v, p) @ read
        return A, (E[..., first : first + self.laws] + E[..., first + self.laws : first + 2 * self.laws]) @ slopes

    @cached_property
    def _slopes(self) -> MatrixFunction:
        t, z, v, p = self.arguments
        own = z[: len(self.own)]
        return MatrixFunction([t, own, v, p], jacobian(self.levels[1].q, own))
