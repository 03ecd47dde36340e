"""What sensors can tell, from which equation holds which unknown: tests, faults that are seen, faults told apart.

Where more equations than unknowns meet (the over-determined part of the Dulmage-Mendelsohn decomposition), the data
can contradict the model. A fault is seen if one of its equations lies there; it is told from another if that is so
with the signals of the other as further unknowns. A signal and its derivative count as one unknown.

Source: Dulmage & Mendelsohn, Can. J. Math. 10 (1958) 517; Krysander, Aslund & Nyberg, IEEE Trans. SMC-A 38 (2008)
197; Krysander & Frisk, IEEE Trans. SMC-A 38 (2008) 1398.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import networkx as nx
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

__all__ = ["Equation", "Gain", "Signal", "Structure"]

Equation = str
Signal = frozenset[Equation]  # the equations in which one signal of a fault stands


@dataclass(frozen=True)
class Gain:
    """What further sensors tell: faults that they make seen, and how many pairs (fault, other) they tell apart.

    isolated: these pairs, by the first fault of each kind.
    """

    sensors: tuple[str, ...]
    detected: frozenset[str]
    isolated: frozenset[tuple[str, str]]
    pairs: int


@dataclass(frozen=True, eq=False)
class Structure:
    """Equations with the unknowns in each, and faults with the equations in which each of their signals stands.

    sensors: sensor -> its equations that stand in the model; extra: sensor that could be added -> its unknowns.
    """

    equations: Mapping[Equation, frozenset[str]]
    faults: Mapping[str, tuple[Signal, ...]] = field(default_factory=dict)
    sensors: Mapping[str, tuple[Equation, ...]] = field(default_factory=dict)
    extra: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def graph(self) -> nx.Graph:
        """The bipartite graph of ("equation", name) and ("unknown", name)."""
        graph = nx.Graph()
        for name, unknowns in self.equations.items():
            graph.add_node(("equation", name), bipartite=0)
            graph.add_edges_from((("equation", name), ("unknown", unknown)) for unknown in unknowns)
        return graph

    def over_determined(self, unknown: Iterable[Signal] = ()) -> frozenset[Equation]:
        """Return the equations of the over-determined part, with some signals of faults as further unknowns."""
        rows = dict(self.equations)
        for k, signal in enumerate(unknown):
            for name in signal:
                rows[name] = rows[name] | {f"fault {k}"}
        return _over_determined(rows)

    @cached_property
    def kinds(self) -> dict[tuple[Signal, ...], tuple[str, ...]]:
        """Faults by their signals: those of one kind are never told apart."""
        found: dict[tuple[Signal, ...], list[str]] = {}
        for name, signals in self.faults.items():
            found.setdefault(tuple(sorted(signals, key=sorted)), []).append(name)
        return {signals: tuple(names) for signals, names in found.items()}

    @cached_property
    def _seen(self) -> tuple[frozenset[Equation], dict[tuple[Signal, ...], frozenset[Equation]]]:
        """The over-determined part, and that with the signals of each kind of fault unknown."""
        return self.over_determined(), {signals: self.over_determined(signals) for signals in self.kinds}

    @cached_property
    def detectable(self) -> frozenset[str]:
        """The faults that contradict the model in some equation that can be tested."""
        part = self._seen[0]
        return frozenset(name for signals, names in self.kinds.items() if _touches(signals, part) for name in names)

    @cached_property
    def taken_for(self) -> dict[str, frozenset[str]]:
        """Fault -> the others that explain all that it does, so that it is not told from them."""
        parts = self._seen[1]
        found = {}
        for signals, names in self.kinds.items():
            others = {o for other, some in self.kinds.items() if not _touches(signals, parts[other]) for o in some}
            for name in names:
                found[name] = frozenset(others - {name})
        return found

    @property
    def groups(self) -> list[tuple[str, ...]]:
        """Detectable faults in groups within which none is told from another, the largest first."""
        seen = [name for name in self.faults if name in self.detectable]
        graph = nx.Graph()
        graph.add_nodes_from(seen)
        graph.add_edges_from(
            (a, b) for a in seen for b in self.taken_for[a] if b in self.detectable and a in self.taken_for[b]
        )
        found = [tuple(n for n in seen if n in some) for some in nx.connected_components(graph)]
        return sorted(found, key=lambda some: (-len(some), seen.index(some[0])))

    def tests(self, most: int = 1000) -> list[frozenset[Equation]]:
        """Return the minimal over-determined sets (MSO), at most so many: each is one test of the model.

        Algorithm of Krysander, Aslund & Nyberg (2008), sec. V: equivalence classes of the part are removed in turn.
        """
        part = self.over_determined()
        rows = {name: self.equations[name] for name in part}
        found: list[frozenset[Equation]] = []
        if rows:
            for one in _minimal(rows, [frozenset({name}) for name in sorted(part)]):
                found.append(one)
                if len(found) >= most:
                    break
        return found

    @property
    def redundancy(self) -> int:
        """How many more equations than unknowns the over-determined part has."""
        return _redundancy({name: self.equations[name] for name in self.over_determined()})

    def with_sensors(self, names: Sequence[str]) -> Structure:
        """Return the structure with sensors of ``extra`` in place; they are taken to be right."""
        added = {f"sensor of {u}": frozenset({u}) for name in names for u in self.extra[name]}
        while set(added) & set(self.equations):
            added = {f"second {key}": unknowns for key, unknowns in added.items()}
        rest = {name: unknowns for name, unknowns in self.extra.items() if name not in names}
        return replace(self, equations={**self.equations, **added}, extra=rest)

    @cached_property
    def _apart(self) -> frozenset[tuple[str, str]]:
        """Pairs (fault, other) that are told apart, by the first fault of every kind."""
        parts = self._seen[1]
        return frozenset(
            (some[0], others[0])
            for signals, some in self.kinds.items()
            for other, others in self.kinds.items()
            if _touches(signals, parts[other])
        )

    def gain(self, names: Sequence[str]) -> Gain:
        """Return what further sensors tell."""
        new = self.with_sensors(names)
        apart = new._apart - self._apart
        size = {some[0]: len(some) for some in self.kinds.values()}
        return Gain(tuple(names), new.detectable - self.detectable, apart, sum(size[a] * size[b] for a, b in apart))

    def placements(self) -> list[Gain]:
        """Return what each further sensor tells alone, the most helpful first; useless ones are left out."""
        found = [self.gain([name]) for name in self.extra]
        useful = [item for item in found if item.detected or item.isolated]
        return sorted(useful, key=lambda item: (-item.pairs, -len(item.detected)))

    def smallest(self) -> Gain:
        """Return sensors that tell all that any sensors could: the best one at a time, superfluous ones taken out."""
        goal = self.gain(list(self.extra))
        chosen: list[str] = []
        best = self.gain(chosen)
        while (best.detected, best.isolated) != (goal.detected, goal.isolated):
            tried = [self.gain([*chosen, name]) for name in self.extra if name not in chosen]
            best = max(tried, key=lambda item: (item.pairs, len(item.detected)))
            chosen = list(best.sensors)
        for name in list(chosen):
            without = self.gain([n for n in chosen if n != name])
            if (without.detected, without.isolated) == (goal.detected, goal.isolated):
                chosen.remove(name)
        return self.gain(chosen)


def _touches(signals: Iterable[Signal], part: frozenset[Equation]) -> bool:
    return any(signal & part for signal in signals)


def _over_determined(rows: Mapping[Equation, frozenset[str]]) -> frozenset[Equation]:
    """Return the equations that alternating paths reach from those that a maximum matching leaves over."""
    names = list(rows)
    number: dict[str, int] = {}
    lists = [[number.setdefault(unknown, len(number)) for unknown in rows[name]] for name in names]
    if not number:
        return frozenset(names)  # equations without unknowns: each is a test
    ends = np.cumsum([0, *map(len, lists)])
    columns = np.array([c for some in lists for c in some], int)
    matrix = csr_matrix((np.ones(len(columns), np.int8), columns, ends), shape=(len(names), len(number)))
    partner = maximum_bipartite_matching(matrix, perm_type="row")  # column -> row
    owner = partner.tolist()
    free = set(range(len(names))) - {row for row in owner if row >= 0}
    reached, front = set(free), list(free)
    while front:
        for column in lists[front.pop()]:
            row = owner[column]
            if row not in reached:
                reached.add(row)
                front.append(row)
    return frozenset(names[k] for k in reached)


def _redundancy(rows: Mapping[Equation, frozenset[str]]) -> int:
    return len(rows) - len(frozenset().union(*rows.values())) if rows else 0


def _minimal(
    rows: Mapping[Equation, frozenset[str]], removable: Sequence[frozenset[Equation]]
) -> Iterator[frozenset[Equation]]:
    """Yield the minimal over-determined subsets of an over-determined set that lack only equations removable."""
    if _redundancy(rows) == 1:
        yield frozenset(rows)
        return
    allowed = frozenset().union(*removable)
    left = set(allowed)
    classes: list[tuple[frozenset[Equation], frozenset[Equation]]] = []
    for name in sorted(allowed):
        if name not in left:
            continue
        rest = _over_determined({key: unknowns for key, unknowns in rows.items() if key != name})
        together = frozenset(rows) - rest
        left -= together
        if together <= allowed:  # else it was or will be removed with one that another branch removes
            classes.append((together, rest))
    for k, (_, rest) in enumerate(classes):
        yield from _minimal({name: rows[name] for name in rest}, [one for one, _ in classes[k + 1 :]] or [frozenset()])
