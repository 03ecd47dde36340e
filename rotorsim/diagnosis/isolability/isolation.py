"""Which faults sensors detect and isolate, before anything is measured: by structure, and by the laws of the faults."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.isolability.equations import entries_of, structure_of
from rotorsim.diagnosis.isolability.motion import REPEATED_SENSOR, LinearMotion
from rotorsim.diagnosis.isolability.runs import Runs, runs_of
from rotorsim.diagnosis.isolability.signatures import ALIAS, HARDLY, Shares, Signatures, signatures_of
from rotorsim.diagnosis.isolability.structure import Gain, Structure
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.standalone import Standalone
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.load import load_standalone

MOST_TESTS = 1000


@dataclass(frozen=True)
class WeaklyIsolable:
    """A fault and another that leaves little of it, and the sizes from which it is isolable: one, two sets of gains.

    The sizes are None where the fault has not one size.
    """

    fault: str
    other: str
    share: float
    size: float | None
    size_with_gains: float | None


@dataclass(frozen=True, eq=False)
class Laws:
    """What the laws of faults isolate over speeds: with the gains as they are (one), and with a second set too (two).

    sensors: sensor that could be added -> faults that it makes detectable, pairs (fault, other) that it isolates.
    """

    signatures: Signatures
    one: Shares
    two: Shares
    sensors: Mapping[str, tuple[frozenset[str], frozenset[tuple[str, str]]]] = field(default_factory=dict)

    @cached_property
    def weakly_isolable(self) -> tuple[WeaklyIsolable, ...]:
        """Pairs of faults of which only a large one is isolable from the other."""
        return tuple(
            WeaklyIsolable(a, b, share, self.one.size(a, b), self.two.size(a, b))
            for (a, b), share in sorted(self.one.isolable_shares.items(), key=lambda pair: pair[1])
            if ALIAS < share < HARDLY
        )


@dataclass(frozen=True, eq=False)
class Isolation:
    """Faults (by key), and which of them sensors isolate. laws: None where ``why`` says that they were not judged."""

    diagram: Diagram
    sensors: tuple[str, ...]
    faults: Mapping[str, Insertion]
    structure: Structure
    placements: tuple[Gain, ...]
    smallest: Gain
    laws: Laws | None = None
    why: str = ""
    warnings: tuple[Problem, ...] = ()


def isolate(
    diagram: Diagram,
    sensors: Sequence[str],
    *,
    speeds: Sequence[float] = (),
    physics: Collection[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Isolation:
    """Return which declared faults of a diagram are isolable with some sensors, and which sensors would help.

    sensors: signals that are measured ("rotor.displacement", "rotor.displacement[3]"). speeds [rad/s] of the runs for
    which laws are compared (default: five about that of the diagram). physics: only these faults.
    The structural answer holds for one run and faults of any form; that by laws for runs at all speeds, harmonics of
    the shaft, and diagrams that are linear.
    Raises RotorsimError for sensors that the diagram does not have.
    """
    alone, why = Standalone({}), ""
    try:
        diagram, alone = load_standalone(diagram)
    except RotorsimError as error:  # what is left without some blocks is no document, and laws are those of documents
        why = error.problems[0].what
    sensors = [*map(alone.named, sensors)]
    recorded = entries_of(diagram, sensors)
    candidates = Catalogue.of(diagram, physics).candidates(diagram, recorded)
    faults = {item.key: item for item in candidates if not item.read_off}  # the data themselves show those
    structure = structure_of(diagram, sensors, faults.values())
    laws = None
    try:
        if not why:
            runs = runs_of(diagram, speeds)
            extra = _periodic(diagram, recorded, structure.extra, runs)
            signals = list(dict.fromkeys([*recorded, *chain.from_iterable(extra.values())]))
            signatures = signatures_of(diagram, list(faults.values()), signals, runs, progress=progress)
            laws = _laws(signatures, recorded, extra)
    except RotorsimError as error:
        why = error.problems[0].what
    placements, smallest = tuple(structure.placements()), structure.smallest()
    return Isolation(diagram, tuple(sensors), faults, structure, placements, smallest, laws, why, tuple(alone.notes))


def _periodic(
    diagram: Diagram, recorded: Sequence[str], sensors: Iterable[str], runs: Runs
) -> dict[str, tuple[str, ...]]:
    """Return the entries of sensors that could be added, of those that repeat from turn to turn.

    Raises RotorsimError where a recorded signal does not.
    """
    entries = {}
    for name in sensors:
        prefix = REPEATED_SENSOR if name.startswith(REPEATED_SENSOR) else ""
        entries[name] = tuple(prefix + entry for entry in entries_of(diagram, [name.removeprefix(REPEATED_SENSOR)]))
    signals = list(dict.fromkeys([*recorded, *chain.from_iterable(entries.values())]))
    aperiodic = LinearMotion(diagram, signals, runs, (), {}).aperiodic(np.zeros(0))
    if not aperiodic.isdisjoint(recorded):
        names = ", ".join(name for name in recorded if name in aperiodic)
        raise RotorsimError(Problem(f"{names} does not repeat from turn to turn", diagram.name))
    return {name: some for name, some in entries.items() if aperiodic.isdisjoint(some)}


def _laws(signatures: Signatures, recorded: Sequence[str], extra: Mapping[str, Sequence[str]]) -> Laws:
    """Return what the recorded signals isolate, and what each sensor that could be added would: name -> its entries."""
    one, two = signatures.shares(recorded, both=False), signatures.shares(recorded, both=True)
    close = [pair for pair, share in one.isolable_shares.items() if share < HARDLY]
    only = {*one.undetectable, *chain.from_iterable(close)}
    sensors = {}
    for name, entries in extra.items():
        more = signatures.shares([*recorded, *entries], both=False, only=only)
        detected = more.detectable.intersection(one.undetectable)
        isolated = frozenset(pair for pair in close if more.share(*pair) > HARDLY)
        if detected or isolated:
            sensors[name] = detected, isolated
    ordered = sorted(sensors.items(), key=lambda item: [len(some) for some in item[1]], reverse=True)
    return Laws(signatures, one, two, dict(ordered))


# -- as plain data ---------------------------------------------------------------------------------------------------


def isolation_data(isolation: Isolation) -> dict[str, Any]:
    """Return the answer as plain data."""
    structure = isolation.structure
    tests = structure.tests(MOST_TESTS)
    return {
        "diagram": isolation.diagram.name,
        "sensors": list(isolation.sensors),
        "faults": {
            key: {"physics": item.physics, "at": str(item.spot), "enters": item.fault.enters}
            for key, item in isolation.faults.items()
        },
        "structure": {
            "redundancy": structure.redundancy,
            "tests": len(tests) if len(tests) < MOST_TESTS else None,
            "undetectable": [name for name in structure.faults if name not in structure.detectable],
            "groups": [list(group) for group in structure.groups],
            "taken_for": _lists(structure.not_isolable_from),
            "add": [_gain(item) for item in isolation.placements],
            "smallest": _gain(isolation.smallest),
        },
        "laws": None if isolation.laws is None else _laws_data(isolation.laws),
        "laws_not_judged": isolation.why,
    }


def _gain(item: Gain) -> dict[str, Any]:
    return {"sensors": list(item.sensors), "detected": sorted(item.detected), "pairs_told_apart": item.counts[0]}


def _lists(others: Mapping[str, Iterable[str]]) -> dict[str, list[str]]:
    return {name: sorted(some) for name, some in others.items() if some}


def _laws_data(laws: Laws) -> dict[str, Any]:
    signatures, runs = laws.signatures, laws.signatures.runs
    return {
        "speeds": runs.speeds[runs.sets == 0].tolist(),
        "second_gains": runs.gains or None,
        "free": list(signatures.parameters),
        "faults": {name: _fault_data(laws, name) for name in laws.one.names},
        "unseen": list(laws.one.undetectable),
        "taken_for": _lists(laws.one.not_isolable_from),
        "hardly": [vars(item) for item in laws.weakly_isolable],
        "with_second_gains": {"unseen": list(laws.two.undetectable), "taken_for": _lists(laws.two.not_isolable_from)},
        "add": [
            {"sensor": name, "detected": sorted(detected), "told_apart": sorted(map(list, isolated))}
            for name, (detected, isolated) in laws.sensors.items()
        ],
        "not_judged": dict(signatures.skipped),
    }


def _fault_data(laws: Laws, name: str) -> dict[str, Any]:
    size = laws.signatures.sizes.get(name)
    return {
        "share": laws.one.detectable_share(name),
        "seen_from": laws.one.size(name),
        "seen_from_with_gains": laws.two.size(name),
        "size": None if size is None else size.parameter,
        "unit": None if size is None else size.unit,
    }
