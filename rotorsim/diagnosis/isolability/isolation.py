"""Which faults can be told apart with which sensors, before anything is measured: by structure, and by their laws."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.isolability.equations import entries_of, structure_of
from rotorsim.diagnosis.isolability.motion import SECOND, LinearMotion
from rotorsim.diagnosis.isolability.signatures import ALIAS, HARDLY, Shares, Signatures, runs_of, signatures_of
from rotorsim.diagnosis.isolability.structure import Gain, Structure
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.errors import Problem, RotorsimError

__all__ = ["Hardly", "Isolation", "Laws", "isolate", "isolation_data"]

MOST_TESTS = 1000


@dataclass(frozen=True)
class Hardly:
    """A fault and another that leaves little of it, and the sizes from which it is told apart: one, two sets of gains.

    The sizes are None where the fault has not one size.
    """

    fault: str
    other: str
    share: float
    size: float | None
    size_with_gains: float | None


@dataclass(frozen=True, eq=False)
class Laws:
    """What the laws of faults tell over speeds: with the gains as they are (one), and with a second set too (two).

    sensors: sensor that could be added -> faults that it makes seen, pairs (fault, other) that it tells apart.
    """

    signatures: Signatures
    one: Shares
    two: Shares
    sensors: Mapping[str, tuple[frozenset[str], frozenset[tuple[str, str]]]] = field(default_factory=dict)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Faults that the free parameters imitate."""
        return tuple(name for name in self.one.names if name not in self.one.seen)

    @cached_property
    def taken_for(self) -> dict[str, frozenset[str]]:
        """Fault -> others that explain all that it does."""
        return _taken_for(self.one)

    @cached_property
    def taken_for_with_gains(self) -> dict[str, frozenset[str]]:
        """The same with two sets of gains."""
        return _taken_for(self.two)

    @cached_property
    def hardly(self) -> tuple[Hardly, ...]:
        """Pairs of faults of which only a large one is told from the other."""
        return tuple(
            Hardly(a, b, share, self.one.size(a, b), self.two.size(a, b))
            for (a, b), share in sorted(self.one.apart.items(), key=lambda pair: pair[1])
            if ALIAS < share < HARDLY
        )


def _taken_for(shares: Shares) -> dict[str, frozenset[str]]:
    found: dict[str, set[str]] = {name: set() for name in shares.names if name in shares.seen}
    for (a, b), share in shares.apart.items():
        if share <= ALIAS:
            found[a].add(b)
    return {name: frozenset(others) for name, others in found.items()}


@dataclass(frozen=True, eq=False)
class Isolation:
    """Faults (by key) and what sensors tell of them. laws: None where ``why`` says that they were not judged."""

    diagram: Diagram
    sensors: tuple[str, ...]
    faults: Mapping[str, Insertion]
    structure: Structure
    placements: tuple[Gain, ...]
    smallest: Gain
    laws: Laws | None = None
    why: str = ""


def isolate(
    diagram: Diagram,
    sensors: Sequence[str],
    *,
    speeds: Sequence[float] = (),
    physics: Collection[str] | None = None,
    trust_blocks: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Isolation:
    """Return which declared faults of a diagram can be told apart with some sensors, and which sensors would help.

    sensors: signals that are measured ("rotor.displacement", "rotor.displacement[3]"). speeds [rad/s] of the runs for
    which laws are compared (default: five about that of the diagram). physics: only these faults.
    The structural answer holds for one run and faults of any form; that by laws for runs at all speeds, harmonics of
    the shaft, and diagrams that are linear.
    Raises RotorsimError for sensors that the diagram does not have.
    """
    recorded = entries_of(diagram, sensors)
    folders = diagram.document.get("block_folders", []) if trust_blocks and diagram.file else []
    registry = Registry([Path(diagram.file).parent / name for name in folders])
    every = [item for item in insertions(diagram, recorded, registry) if not item.from_steps]  # readings show those
    faults = {item.key: item for item in every if physics is None or item.physics in physics}
    structure = structure_of(diagram, sensors, faults.values())
    laws, why = None, ""
    try:
        laws = _laws(diagram, recorded, structure, list(faults.values()), speeds, trust_blocks, progress)
    except RotorsimError as error:
        why = error.problems[0].what
    return Isolation(
        diagram, tuple(sensors), faults, structure, tuple(structure.placements()), structure.smallest(), laws, why
    )


def _laws(
    diagram: Diagram,
    recorded: Sequence[str],
    structure: Structure,
    faults: Sequence[Insertion],
    speeds: Sequence[float],
    trust_blocks: bool,
    progress: Callable[[float], None] | None,
) -> Laws:
    runs = runs_of(diagram, speeds)
    entries = {name: _entries(diagram, name) for name in structure.extra}
    signals = list(dict.fromkeys([*recorded, *(entry for some in entries.values() for entry in some)]))
    lost = LinearMotion(diagram, signals, runs, (), {}).wandering(np.zeros(0))
    if lost & set(recorded):
        names = ", ".join(name for name in recorded if name in lost)
        raise RotorsimError(Problem(f"{names} does not repeat from turn to turn", diagram.name))
    entries = {name: some for name, some in entries.items() if not lost & set(some)}
    signals = [name for name in signals if name not in lost]
    found = signatures_of(diagram, faults, signals, runs, trust_blocks=trust_blocks, progress=progress)
    laws = Laws(found, found.shares(recorded, both=False), found.shares(recorded, both=True))
    wrong = [(a, b) for a, others in laws.taken_for.items() for b in others] + [(i.fault, i.other) for i in laws.hardly]
    only = {*laws.unseen, *(name for pair in wrong for name in pair)}
    sensors = {}
    for name, some in entries.items():
        more = found.shares([*recorded, *some], both=False, only=only)
        seen = frozenset(laws.unseen) & more.seen
        apart = frozenset((a, b) for a, b in wrong if more.share(a, b) > HARDLY)
        if seen or apart:
            sensors[name] = seen, apart
    order = sorted(sensors, key=lambda name: (-len(sensors[name][0]), -len(sensors[name][1])))
    return Laws(found, laws.one, laws.two, {name: sensors[name] for name in order})


def _entries(diagram: Diagram, sensor: str) -> list[str]:
    plain = sensor.removeprefix(SECOND)
    prefix = SECOND if plain != sensor else ""
    return [prefix + entry for entry in entries_of(diagram, [plain])]


# -- as plain data ---------------------------------------------------------------------------------------------------


def isolation_data(found: Isolation) -> dict[str, Any]:
    """Return the answer as plain data."""
    structure = found.structure
    tests = structure.tests(MOST_TESTS)
    return {
        "diagram": found.diagram.name,
        "sensors": list(found.sensors),
        "faults": {
            key: {"physics": item.physics, "at": str(item.spot), "enters": item.fault.enters}
            for key, item in found.faults.items()
        },
        "structure": {
            "redundancy": structure.redundancy,
            "tests": len(tests) if len(tests) < MOST_TESTS else None,
            "undetectable": [name for name in structure.faults if name not in structure.detectable],
            "groups": [list(group) for group in structure.groups],
            "taken_for": _lists(structure.taken_for),
            "add": [_gain(item) for item in found.placements],
            "smallest": _gain(found.smallest),
        },
        "laws": None if found.laws is None else _laws_data(found.laws),
        "laws_not_judged": found.why,
    }


def _gain(item: Gain) -> dict[str, Any]:
    return {"sensors": list(item.sensors), "detected": sorted(item.detected), "pairs_told_apart": item.pairs}


def _lists(found: Mapping[str, Iterable[str]]) -> dict[str, list[str]]:
    return {name: sorted(others) for name, others in found.items() if others}


def _laws_data(laws: Laws) -> dict[str, Any]:
    signatures, runs = laws.signatures, laws.signatures.runs
    return {
        "speeds": runs.speeds[runs.sets == 0].tolist(),
        "second_gains": runs.gains or None,
        "free": list(signatures.parameters),
        "faults": {name: _fault_data(laws, name) for name in laws.one.names},
        "unseen": list(laws.unseen),
        "taken_for": _lists(laws.taken_for),
        "hardly": [vars(item) for item in laws.hardly],
        "with_second_gains": {
            "unseen": [name for name in laws.two.names if name not in laws.two.seen],
            "taken_for": _lists(laws.taken_for_with_gains),
        },
        "add": [
            {"sensor": name, "detected": sorted(seen), "told_apart": sorted(map(list, pairs))}
            for name, (seen, pairs) in laws.sensors.items()
        ],
        "not_judged": dict(signatures.skipped),
    }


def _fault_data(laws: Laws, name: str) -> dict[str, Any]:
    size = laws.signatures.sizes.get(name)
    return {
        "share": laws.one.part(name),
        "seen_from": laws.one.size(name),
        "seen_from_with_gains": laws.two.size(name),
        "size": None if size is None else size.parameter,
        "unit": None if size is None else size.unit,
    }
