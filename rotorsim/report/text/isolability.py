"""Which faults sensors can detect and isolate, before anything is measured, as text."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from itertools import groupby
from textwrap import fill
from typing import TypeVar

import numpy as np

from rotorsim.diagnosis.isolability.isolation import Isolation, Laws
from rotorsim.diagnosis.isolability.signatures import RELATIVE_NOISE, SIGMAS
from rotorsim.diagnosis.isolability.structure import Gain
from rotorsim.report.text.table import counted, rpm, table
from rotorsim.units import format_quantity

PAGE_WIDTH = 110
LISTED_SENSORS = 8  # sensors, pairs
FARTHEST = 10.0  # times the size from which a fault is detected: isolated only beyond, it is said
NO_SENSOR = "No further sensor helps."

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


def isolability_text(isolation: Isolation) -> str:
    """Return which faults of a diagram sensors detect and isolate: by its structure, and by the laws of the faults."""
    count = len({(item.physics, item.spot) for item in isolation.faults.values()})
    head = f"{isolation.diagram.name}, sensors {', '.join(isolation.sensors)}: {counted(count, 'fault')}"
    if not count:
        return f"{head}\n\nNone of the declared faults fits into this diagram: rotorsim blocks says what each needs."
    unjudged = [f"By their laws faults were not compared: {isolation.why}."]
    laws = unjudged if isolation.laws is None else _laws(isolation, isolation.laws)
    return "\n\n".join(part for part in (head, *_structure(isolation), *laws) if part)


def _structure(isolation: Isolation) -> list[str]:
    structure = isolation.structure
    missed = [name for name in structure.faults if name not in structure.detectable]
    more = counted(structure.redundancy, "equation")
    parts = [
        f"STRUCTURE (one run, faults of any form): {more} more than unknowns",
        _entry("Not detectable", _names(isolation, missed)),
        *_groups(isolation),
    ]
    if not isolation.placements:
        return [*parts, NO_SENSOR]
    rows = [(gain.sensors[0], *_gained(isolation, gain)) for gain in isolation.placements]
    least = isolation.smallest
    _, pairs = _gained(isolation, least)
    best = f"All that any sensors isolate is isolable with {' and '.join(least.sensors)} ({pairs} pairs more)."
    return [*parts, _sensors_table(rows), best]


def _groups(isolation: Isolation) -> list[str]:
    """Return the equivalence classes in words; those that differ in their node alone stand together."""
    parts = []
    for groups in _alike_nodes(isolation, isolation.structure.groups):
        keys = [key for _, group in groups for key in group]
        within = " but not within" if len({_name(isolation, key) for key in groups[0][1]}) > 1 else ""
        plural, each = ("s", "each node ") if len(groups) > 1 else ("", "")
        numbers = _ranges([k for k, _ in groups])
        title = f"Group{plural} {numbers}, {each}isolable from all others{within}"
        parts.append(_entry(title, _names(isolation, keys)))
    return parts


def _sensors_table(rows: Iterable[tuple[str, str, str]]) -> str:
    useful = sorted((row for row in rows if row[1:] != ("0", "0")), key=lambda row: (-int(row[1]), -int(row[2])))
    if not useful:
        return NO_SENSOR
    text = table(("further sensor", "faults detected", "pairs isolated"), useful[:LISTED_SENSORS])
    if any(name.startswith("second ") for name, *_ in useful[:LISTED_SENSORS]):
        text += "\n(second: the same signal measured once more, by a chain with faults of its own)"
    return text


def _gained(isolation: Isolation, gain: Gain) -> tuple[str, str]:
    """Return how many faults further sensors detect, and pairs of them they isolate."""
    names = list(isolation.structure.faults)
    return _counts(isolation, gain.detected, ((names[a], names[b]) for a, b in np.argwhere(gain.isolated)))


def _counts(isolation: Isolation, detected: Iterable[str], pairs: Iterable[tuple[str, str]]) -> tuple[str, str]:
    """Return how many faults, and pairs of them either way, whatever the ways in which a fault can be put in."""
    names = {key: (item.physics, item.spot) for key, item in isolation.faults.items()}
    different = {frozenset((names[a], names[b])) for a, b in pairs}
    return str(len({names[key] for key in detected})), str(sum(len(pair) == 2 for pair in different))


def _laws(isolation: Isolation, laws: Laws) -> list[str]:
    runs, aliases = laws.signatures.runs, laws.one.not_isolable_from
    speeds = ", ".join(f"{rpm(float(speed)):.0f}" for speed in runs.speeds[runs.sets == 0])
    gains = f"Runs with other gains as well ({runs.gains}): {_gains(isolation, laws) or 'isolate no more faults'}."
    sensors = [(name, *_counts(isolation, *both)) for name, both in laws.sensors.items()]
    skipped = _grouped((why, name) for name, why in laws.signatures.skipped.items())
    return [
        _folded(f"LAWS (harmonics of runs at {speeds} rpm; free: {', '.join(laws.signatures.parameters)})"),
        _entry("Not detectable: the free parameters imitate", _names(isolation, laws.one.undetectable)),
        _entry("Not isolable, line by line", _classes(isolation, aliases)),
        _entry("Not isolable from another fault that can do all that it does", _wider(isolation, aliases)),
        _detected_from(isolation, laws),
        _isolated_from(isolation, laws),
        _folded(gains) if runs.gains else "",
        _sensors_table(sensors) if sensors else "",
        *(_entry(f"Not judged ({why})", _names(isolation, names)) for why, names in skipped.items()),
        f"Sizes are those that stand out by {SIGMAS:g} standard deviations of noise of {100 * RELATIVE_NOISE:g} % of "
        "each signal's rms\nin every harmonic.",
    ]


def _detected_from(isolation: Isolation, laws: Laws) -> str:
    """Return the table of sizes from which faults are detected, where they are few."""
    rows: dict[tuple[str, str], tuple[float, str, float | None]] = {}
    for key in laws.one.names:
        size, least = laws.signatures.sizes.get(key), laws.one.size(key)
        if size is not None and least is not None and key in laws.one.detectable:
            item, name = (least, size.unit, laws.two.size(key)), (_name(isolation, key), size.parameter)
            rows[name] = min(rows.get(name, item), item, key=lambda some: some[0])
    if not rows or len({name for name, _ in rows}) > LISTED_SENSORS:
        return ""
    lines = [(*name, format_quantity(least, unit, 3), _size(more, unit)) for name, (least, unit, more) in rows.items()]
    return table(("fault", "its", "detected from", "with other gains"), lines)


def _size(value: float | None, unit: str) -> str:
    return "" if value is None else format_quantity(value, unit, 3)


def _isolated_from(isolation: Isolation, laws: Laws) -> str:
    """Return the table of faults that only a large size isolates from another."""
    rows: dict[tuple[str, str], tuple[str, ...]] = {}
    for item in laws.weakly_isolable:
        least, size = laws.one.size(item.fault), laws.signatures.sizes.get(item.fault)
        if item.size is None or least is None or size is None or item.size < FARTHEST * least:
            continue
        names = _name(isolation, item.fault), _name(isolation, item.other)
        if names[0] != names[1] and not {names, names[::-1]} & set(rows):
            sizes = (_size(value, size.unit) for value in (least, item.size, item.size_with_gains))
            rows[names] = (*names, size.parameter, *sizes)
    if not rows:
        return ""
    header = ("isolable only if large", "from", "its", "detected from", "isolated from", "with other gains")
    more = f"\n... and {len(rows) - LISTED_SENSORS} pairs more (--json)" if len(rows) > LISTED_SENSORS else ""
    return table(header, list(rows.values())[:LISTED_SENSORS]) + more


def _gains(isolation: Isolation, laws: Laws) -> str:
    """Return what a second set of gains isolates, in words."""
    after = laws.two.not_isolable_from
    shown = [_name(isolation, key) for key in laws.one.undetectable if key in laws.two.detectable]
    apart = [
        f"{_name(isolation, a)} from {_name(isolation, b)}"
        for a, others in laws.one.not_isolable_from.items()
        for b in others
        if b not in after.get(a, ())
    ]
    smaller = []
    for key in laws.one.names:
        before, later, size = laws.one.size(key), laws.two.size(key), laws.signatures.sizes.get(key)
        if before and later and size and later < 0.5 * before:
            first, then = (format_quantity(value, size.unit, 3) for value in (before, later))
            smaller.append(f"{_name(isolation, key)}: {size.parameter} {then} instead of {first}")
    words = (
        ("show {}", list(dict.fromkeys(shown))),
        ("isolate {}", list(dict.fromkeys(apart))[:LISTED_SENSORS]),
        ("show smaller faults ({})", list(dict.fromkeys(smaller))),
    )
    return "; ".join(text.format(", ".join(names)) for text, names in words if names)


def _classes(isolation: Isolation, not_isolable: Mapping[str, frozenset[str]]) -> list[str]:
    """Return equivalence classes of faults, a line each; those that differ in their node alone in one."""
    classes: list[list[str]] = []
    for key, others in not_isolable.items():
        same = [key, *(other for other in not_isolable if other in others and key in not_isolable[other])]
        if len({_name(isolation, one) for one in same}) > 1 and not any(key in group for group in classes):
            classes.append(same)
    lines = []
    for groups in _alike_nodes(isolation, classes):
        text = "; ".join(_names(isolation, [key for _, group in groups for key in group]))
        lines.append(text + (" (at each node)" if len(groups) > 1 else ""))
    return lines


def _wider(isolation: Isolation, not_isolable: Mapping[str, frozenset[str]]) -> list[str]:
    """Return faults with those that can do all that each does, and more; those at several nodes in one line."""
    wider = _grouped(
        (_name(isolation, key), (key, other))
        for key, others in not_isolable.items()
        for other in not_isolable
        if other in others and key not in not_isolable[other] and _name(isolation, other) != _name(isolation, key)
    )
    lines: list[tuple[tuple[str, str], int | None]] = []
    for name, pairs in wider.items():
        key, others = pairs[0][0], list(dict.fromkeys(other for _, other in pairs))
        spot = isolation.faults[key].spot
        if all(isolation.faults[other].spot == spot for other in others):
            there = ", ".join(dict.fromkeys(_physics(isolation, other) for other in others))
            lines.append(((f"{_physics(isolation, key)} at {spot.block}.{spot.port}", f"{there} there"), spot.node))
        else:
            lines.append(((name, "; ".join(_names(isolation, others))), None))
    return [f"{head}{_nodes(nodes)} from {text}" for (head, text), nodes in _grouped(lines).items()]


# -- names -------------------------------------------------------------------------------------------------------------


def _grouped(pairs: Iterable[tuple[K, V]]) -> dict[K, list[V]]:
    """Return key -> its values, in the order in which they come."""
    groups: dict[K, list[V]] = {}
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups


def _alike_nodes(isolation: Isolation, groups: Sequence[Sequence[str]]) -> Iterable[list[tuple[int, Sequence[str]]]]:
    """Return numbered groups of faults; those that differ in their node alone together."""

    def kind(number: int, group: Sequence[str]) -> Hashable:
        spots = {isolation.faults[key].spot for key in group}
        spot = next(iter(spots))
        if len(spots) > 1 or spot.node is None:
            return number
        return spot.block, spot.port, *dict.fromkeys(_physics(isolation, key) for key in group)

    return _grouped((kind(k, group), (k, group)) for k, group in enumerate(groups, 1)).values()


def _physics(isolation: Isolation, key: str) -> str:
    """Return the name of a fault; of one in a wire also on which side of it the recording is, where both are tried."""
    item = isolation.faults[key]
    alike = [o for o in isolation.faults.values() if (o.physics, o.spot) == (item.physics, item.spot)]
    if item.fault.enters != "wire" or len({bool(o.measured) for o in alike}) < 2:
        return item.physics
    return f"{item.physics} ({'recorded after it' if item.measured else 'recorded before it'})"


def _name(isolation: Isolation, key: str) -> str:
    return f"{_physics(isolation, key)} at {isolation.faults[key].spot}"


def _names(isolation: Isolation, keys: Iterable[str]) -> list[str]:
    """Return faults by place: "rotor.force[2-5]: residual_bow, rub"; nodes with the same faults stand together."""
    at = _grouped((isolation.faults[key].spot, _physics(isolation, key)) for key in keys)
    alike = _grouped(
        ((f"{spot.block}.{spot.port}", tuple(dict.fromkeys(physics))), spot.node) for spot, physics in at.items()
    )
    return [f"{port}{_nodes(nodes)}: {', '.join(physics)}" for (port, physics), nodes in alike.items()]


def _nodes(nodes: Iterable[int | None]) -> str:
    numbers = sorted(node for node in nodes if node is not None)
    return f"[{_ranges(numbers)}]" if numbers else ""


def _ranges(numbers: Sequence[int]) -> str:
    """Return ascending numbers as "1-3, 5"."""
    runs = [[n for _, n in run] for _, run in groupby(enumerate(numbers), lambda item: item[1] - item[0])]
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def _entry(title: str, lines: Sequence[str]) -> str:
    """Return lines below their title; nothing for none."""
    return "\n".join([f"{title}:", *(_folded(f"  {line}", "    ") for line in lines)]) if lines else ""


def _folded(line: str, indent: str = "  ") -> str:
    return fill(line, PAGE_WIDTH, subsequent_indent=indent, break_on_hyphens=False)
