"""Which faults sensors detect and isolate, from which equation of a model holds which unknown.

Where more equations than unknowns meet (the over-determined part of the Dulmage-Mendelsohn decomposition), the data
can contradict the model. A fault is detectable if one of its equations lies there; it is isolable from another if that
is so with the signals of the other as further unknowns. A signal and its derivative count as one unknown.

Source: Dulmage & Mendelsohn, Can. J. Math. 10 (1958) 517; Krysander, Aslund & Nyberg, IEEE Trans. SMC-A 38 (2008)
197; Krysander & Frisk, IEEE Trans. SMC-A 38 (2008) 1398.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress, islice

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_bipartite_matching

Equation = str
Signal = frozenset[Equation]  # the equations in which one signal of a fault stands


@dataclass(frozen=True, eq=False)
class Gain:
    """What further sensors add: faults that become detectable, and pairs (fault, other) that become isolable.

    isolated (faults, faults): whether each fault (row) becomes isolable from another (column).
    """

    sensors: tuple[str, ...]
    detected: frozenset[str]
    isolated: np.ndarray

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of pairs and of faults: sensors that add to others never have less."""
        return int(self.isolated.sum()), len(self.detected)


@dataclass(frozen=True, eq=False)
class Structure:
    """Equations with the unknowns in each, and faults with the equations in which each of their signals stands.

    sensors: sensor -> its equations that stand in the model; extra: sensor that could be added -> its unknowns.
    """

    equations: Mapping[Equation, frozenset[str]]
    faults: Mapping[str, tuple[Signal, ...]] = field(default_factory=dict)
    sensors: Mapping[str, tuple[Equation, ...]] = field(default_factory=dict)
    extra: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def over_determined(self, unknown: Iterable[Signal] = ()) -> frozenset[Equation]:
        """Return the equations of the over-determined part, with some signals of faults as further unknowns."""
        rows = dict(self.equations)
        for k, signal in enumerate(unknown):
            for name in signal:
                rows[name] = rows[name] | {f"fault {k}"}
        return _over_determined(rows)

    @cached_property
    def _verdicts(self) -> np.ndarray:
        """Whether each fault is isolable from each other one and, in the last column, detectable: (F, F+1)."""
        classes = [tuple(sorted(signals, key=sorted)) for signals in self.faults.values()]
        number = {signals: k for k, signals in enumerate(dict.fromkeys(classes))}
        parts = [*map(self.over_determined, number), self.over_determined()]
        verdicts = np.array([[any(signal & part for signal in own) for part in parts] for own in number], bool)
        rows = [number[signals] for signals in classes]
        return verdicts.reshape(-1, len(parts))[np.ix_(rows, [*rows, len(number)])]

    @cached_property
    def detectable(self) -> frozenset[str]:
        """The faults that contradict the model in some equation that can be tested."""
        return frozenset(compress(self.faults, self._verdicts[:, -1]))

    @cached_property
    def not_isolable_from(self) -> dict[str, frozenset[str]]:
        """Fault -> the others that explain all that it does."""
        rows = zip(self.faults, self._verdicts[:, :-1], strict=True)
        return {name: frozenset(compress(self.faults, ~isolable)) - {name} for name, isolable in rows}

    @property
    def groups(self) -> list[tuple[str, ...]]:
        """Detectable faults in groups within which none is isolable from another, the largest first."""
        names = [name for name in self.faults if name in self.detectable]
        at = np.flatnonzero(self._verdicts[:, -1])
        isolable = self._verdicts[np.ix_(at, at)]
        _, labels = connected_components(csr_matrix(~(isolable | isolable.T)))
        groups: dict[int, list[str]] = {}
        for name, label in zip(names, labels, strict=True):
            groups.setdefault(int(label), []).append(name)
        return sorted(map(tuple, groups.values()), key=len, reverse=True)

    def tests(self, most: int = 1000) -> list[frozenset[Equation]]:
        """Return the minimal structurally over-determined sets (MSO), at most so many: each is one test of the model.

        Algorithm of Krysander, Aslund & Nyberg (2008), sec. V: equivalence classes of the part are removed in turn.
        """
        rows = {name: self.equations[name] for name in self.over_determined()}
        return list(islice(_minimal(rows, [frozenset({name}) for name in sorted(rows)]), most)) if rows else []

    @property
    def redundancy(self) -> int:
        """How many more equations than unknowns the over-determined part has."""
        return _redundancy({name: self.equations[name] for name in self.over_determined()})

    def with_sensors(self, names: Sequence[str]) -> Structure:
        """Return the structure with sensors of ``extra`` in place; they are taken to be right."""
        added = {f"sensor of {u}": frozenset({u}) for name in names for u in self.extra[name]}
        while set(added) & set(self.equations):
            added = {f"second {key}": unknowns for key, unknowns in added.items()}
        others = {name: unknowns for name, unknowns in self.extra.items() if name not in names}
        return replace(self, equations={**self.equations, **added}, extra=others)

    def gain(self, names: Iterable[str]) -> Gain:
        """Return what further sensors add."""
        sensors = tuple(names)
        more = self.with_sensors(sensors)._verdicts & ~self._verdicts
        return Gain(sensors, frozenset(compress(self.faults, more[:, -1])), more[:, :-1])

    def placements(self) -> list[Gain]:
        """Return what each further sensor adds alone, the most helpful first; useless ones are left out."""
        gains = [self.gain([name]) for name in self.extra]
        return sorted((gain for gain in gains if any(gain.counts)), key=lambda gain: gain.counts, reverse=True)

    def smallest(self) -> Gain:
        """Return sensors that add all that any sensors could: the best one at a time, superfluous ones taken out."""
        goal = self.gain(self.extra).counts
        best = self.gain([])
        while best.counts != goal:
            chosen = best.sensors
            others = (name for name in self.extra if name not in chosen)
            best = max((self.gain([*chosen, name]) for name in others), key=lambda gain: gain.counts)
        for name in best.sensors:
            fewer = self.gain(other for other in best.sensors if other != name)
            if fewer.counts == goal:
                best = fewer
        return best


def _over_determined(rows: Mapping[Equation, frozenset[str]]) -> frozenset[Equation]:
    """Return the equations that alternating paths reach from those that a maximum matching leaves unmatched."""
    names = list(rows)
    number = {unknown: k for k, unknown in enumerate(frozenset().union(*rows.values()))}
    if not number:
        return frozenset(names)  # equations without unknowns: each is a test
    columns = np.array([number[unknown] for some in rows.values() for unknown in some])
    ends = np.cumsum([0, *map(len, rows.values())])
    matrix = csr_matrix((np.ones(len(columns), np.int8), columns, ends), shape=(len(names), len(number)))
    owner = maximum_bipartite_matching(matrix, perm_type="row")  # column -> row
    unmatched = np.flatnonzero(np.isin(np.arange(len(names)), owner, invert=True))
    # row -> rows that are matched with its unknowns; what an unknown without a row leads to is never reached
    follow = np.concatenate([owner[columns].clip(0), unmatched])
    graph = csr_matrix((np.ones(len(follow)), follow, [*ends, len(follow)]), shape=2 * (len(names) + 1,))
    reached = breadth_first_order(graph, len(names), return_predecessors=False)[1:]
    return frozenset(names[k] for k in reached)


def _redundancy(rows: Mapping[Equation, frozenset[str]]) -> int:
    return len(rows) - len(frozenset().union(*rows.values()))


def _minimal(
    rows: Mapping[Equation, frozenset[str]], removable: Sequence[frozenset[Equation]]
) -> Iterator[frozenset[Equation]]:
    """Yield the minimal over-determined subsets of an over-determined set that lack only equations removable."""
    if _redundancy(rows) == 1:
        yield frozenset(rows)
        return
    allowed = frozenset().union(*removable)
    tried: set[Equation] = set()
    classes: list[tuple[frozenset[Equation], frozenset[Equation]]] = []
    for name in sorted(allowed):
        if name in tried:
            continue
        others = _over_determined({key: unknowns for key, unknowns in rows.items() if key != name})
        together = frozenset(rows) - others
        tried |= together
        if together <= allowed:  # else it was or will be removed with one that another branch removes
            classes.append((together, others))
    for k, (_, others) in enumerate(classes):
        later = [together for together, _ in classes[k + 1 :]]
        yield from _minimal({name: rows[name] for name in others}, later or [frozenset()])
