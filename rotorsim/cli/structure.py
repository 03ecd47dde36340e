"""``rotorsim diagnose DIAGRAM --sensors``: what sensors can tell, before anything is measured."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError
from rotorsim.units import format_quantity

if TYPE_CHECKING:
    from rotorsim.diagnosis.isolability.isolation import Isolation, Laws
    from rotorsim.diagnosis.isolability.structure import Gain
    from rotorsim.diagram.diagram import Diagram

__all__ = ["show_isolation"]

WIDTH = 110
SHOWN = 8  # sensors, pairs
FARTHEST = 10.0  # times the size from which a fault is seen: told apart only beyond, it is said


def show_isolation(
    diagram: Diagram,
    sensors: str,
    speeds: str | None,
    *,
    physics: Collection[str] | None = None,
    trust_blocks: bool,
    progress: bool | None,
    as_json: bool,
) -> None:
    """Print which faults of a diagram can be told apart with sensors ("rotor.displacement[3],controller.current").

    physics: only these faults (default: all).
    """
    from rotorsim.diagnosis.isolability.isolation import isolate, isolation_data

    wanted = list(dict.fromkeys(name.strip() for name in re.split(r",(?![^\[]*\])", sensors) if name.strip()))
    at = [] if speeds is None else [float(speed) for speed in common.speeds_of(speeds)]
    if any(speed == 0 for speed in at):
        raise RotorsimError(Problem(f"--speeds {speeds}: the shaft does not turn", hint="leave 0 out"))
    with common.progress_bar("signatures", progress) as show:
        found = isolate(diagram, wanted, speeds=at, physics=physics, trust_blocks=trust_blocks, progress=show)
    if as_json:
        common.echo_json(isolation_data(found))
    else:
        click.echo(_text(found))


def _text(found: Isolation) -> str:
    count = len({(item.physics, item.spot) for item in found.faults.values()})
    head = f"{found.diagram.name}, sensors {', '.join(found.sensors)}: {count} fault{'' if count == 1 else 's'}"
    if not count:
        return f"{head}\n\nNone of the declared faults fits into this diagram: rotorsim blocks says what each needs."
    parts = [head, *_structure(found)]
    if found.laws is None:
        parts.append(f"By their laws faults were not compared: {found.why}.")
    else:
        parts += _laws(found, found.laws)
    return "\n\n".join(parts)


def _structure(found: Isolation) -> list[str]:
    structure = found.structure
    more = structure.redundancy
    parts = [f"STRUCTURE (one run, faults of any form): {more} equation{'' if more == 1 else 's'} more than unknowns"]
    missed = [name for name in structure.faults if name not in structure.detectable]
    if missed:
        parts.append(_entry("Not seen", _names(found, missed)))
    parts += _groups(found)
    if found.placements:
        rows = [(item.sensors[0], *_counts(found, item.detected, _every(found, item))) for item in found.placements]
        parts.append(_table_of_sensors(rows))
        parts.append(_smallest(found, found.smallest))
    else:
        parts.append("No further sensor tells more.")
    return parts


def _groups(found: Isolation) -> list[str]:
    """Return the groups in words; those that differ in their node alone stand together."""
    alike: dict[object, list[tuple[int, Sequence[str]]]] = {}
    for k, group in enumerate(found.structure.groups, 1):
        spots = {found.faults[key].spot for key in group}
        ports = {(spot.block, spot.port) for spot in spots}
        one = len(spots) == 1 and next(iter(spots)).node is not None
        named = (*ports, *dict.fromkeys(_physics(found, key) for key in group)) if one else k
        alike.setdefault(named, []).append((k, group))
    parts = []
    for groups in alike.values():
        keys = [key for _, group in groups for key in group]
        numbers = _ranges([k for k, _ in groups])
        names = {_name(found, key) for key in groups[0][1]}
        told = "told from all others" + (" but not within" if len(names) > 1 else "")
        many = len(groups) > 1
        title = f"Group{'s' if many else ''} {numbers}, {'each node ' if many else ''}{told}"
        parts.append(_entry(title, _names(found, keys)))
    return parts


def _table_of_sensors(rows: Iterable[tuple[str, str, str]]) -> str:
    useful = [row for row in rows if row[1:] != ("0", "0")]
    if not useful:
        return "No further sensor tells more."
    shown = sorted(useful, key=lambda row: (-int(row[1]), -int(row[2])))[:SHOWN]
    text = common.table(("further sensor", "faults seen", "pairs told apart"), shown)
    if any(name.startswith("second ") for name, *_ in shown):
        text += "\n(second: the same signal measured once more, by a chain with faults of its own)"
    return text


def _smallest(found: Isolation, gain: Gain) -> str:
    pairs = _counts(found, gain.detected, _every(found, gain))[1]
    return f"All that sensors can tell is told with {' and '.join(gain.sensors)} ({pairs} pairs more)."


def _every(found: Isolation, gain: Gain) -> list[tuple[str, str]]:
    """Return all the pairs of faults that further sensors tell apart, of those that stand for their kinds."""
    alike = {some[0]: some for some in found.structure.kinds.values()}
    return [(a, b) for one, other in gain.isolated for a in alike[one] for b in alike[other]]


def _counts(found: Isolation, seen: Iterable[str], pairs: Iterable[tuple[str, str]]) -> tuple[str, str]:
    """Return how many faults, and pairs of them either way, whatever the ways in which a fault can be put in."""
    names = {key: (item.physics, item.spot) for key, item in found.faults.items()}
    different = {frozenset((names[a], names[b])) for a, b in pairs}
    return str(len({names[key] for key in seen})), str(sum(len(pair) == 2 for pair in different))


def _laws(found: Isolation, laws: Laws) -> list[str]:
    from rotorsim.diagnosis.isolability.signatures import NOISE, SIGMAS

    runs = laws.signatures.runs
    rpm = ", ".join(f"{common.rpm(float(speed)):.0f}" for speed in runs.speeds[runs.sets == 0])
    free = ", ".join(laws.signatures.parameters)
    head = f"LAWS (harmonics of runs at {rpm} rpm; free: {free})"
    parts = [fill(head, WIDTH, subsequent_indent="  ")]
    if laws.unseen:
        parts.append(_entry("Not seen: the free parameters imitate", _names(found, laws.unseen)))
    classes = _classes(found, laws.taken_for)
    if classes:
        parts.append(_entry("Not told apart, line by line", classes))
    wider = _wider(found, laws.taken_for)
    if wider:
        parts.append(_entry("Taken for another fault that can do all that it does", wider))
    parts += [*_seen_from(found, laws), *_sizes(found, laws)]
    gains = _gains(found, laws)
    if runs.gains:
        text = f"Runs with other gains as well ({runs.gains}): {gains or 'tell no more faults apart'}."
        parts.append(fill(text, WIDTH, subsequent_indent="  "))
    if laws.sensors:
        rows = [(name, *_counts(found, *both)) for name, both in laws.sensors.items()]
        parts.append(_table_of_sensors(rows))
    for why, names in _by_reason(laws.signatures.skipped).items():
        parts.append(_entry(f"Not judged ({why})", _names(found, names)))
    parts.append(
        f"Sizes are those that stand out by {SIGMAS:g} standard deviations of noise of {100 * NOISE:g} % of each "
        "signal's rms\nin every harmonic."
    )
    return parts


def _seen_from(found: Isolation, laws: Laws) -> list[str]:
    """Return the table of sizes from which faults are seen, where they are few."""
    rows: dict[tuple[str, str], tuple[float, str, float | None]] = {}
    for key in laws.one.names:
        size, seen = laws.signatures.sizes.get(key), laws.one.size(key)
        if size is not None and seen is not None and key in laws.one.seen:
            item = seen, size.unit, laws.two.size(key)
            name = _name(found, key), size.parameter
            rows[name] = min(rows.get(name, item), item, key=lambda some: some[0])
    if not rows or len({name for name, _ in rows}) > SHOWN:
        return []
    lines = [
        (*name, format_quantity(seen, unit, 3), "" if more is None else format_quantity(more, unit, 3))
        for name, (seen, unit, more) in rows.items()
    ]
    return [common.table(("fault", "its", "seen from", "with other gains"), lines)]


def _sizes(found: Isolation, laws: Laws) -> list[str]:
    """Return the table of faults that only a large size tells from another."""
    rows: dict[tuple[str, str], tuple[str, ...]] = {}
    for item in laws.hardly:
        seen, size = laws.one.size(item.fault), laws.signatures.sizes.get(item.fault)
        if item.size is None or seen is None or size is None or item.size < FARTHEST * seen:
            continue
        names = _name(found, item.fault), _name(found, item.other)
        if names[0] == names[1] or {names, names[::-1]} & set(rows):
            continue
        more = "" if item.size_with_gains is None else format_quantity(item.size_with_gains, size.unit, 3)
        rows[names] = (
            *names,
            size.parameter,
            format_quantity(seen, size.unit, 3),
            format_quantity(item.size, size.unit, 3),
            more,
        )
    if not rows:
        return []
    kept = list(rows.values())
    header = ("told apart only if large", "from", "its", "seen from", "told from", "with other gains")
    more = f"\n... and {len(kept) - SHOWN} pairs more (--json)" if len(kept) > SHOWN else ""
    return [common.table(header, kept[:SHOWN]) + more]


def _gains(found: Isolation, laws: Laws) -> str:
    """Return what a second set of gains tells, in words."""
    seen = [name for name in laws.unseen if name in laws.two.seen]
    after = laws.taken_for_with_gains
    apart = [(a, b) for a, others in laws.taken_for.items() for b in others if b not in after.get(a, ())]
    words = []
    if seen:
        words.append("show " + ", ".join(dict.fromkeys(_name(found, key) for key in seen)))
    if apart:
        pairs = dict.fromkeys(f"{_name(found, a)} from {_name(found, b)}" for a, b in apart)
        words.append("tell " + ", ".join(list(pairs)[:SHOWN]))
    sizes = []
    for name in laws.one.names:
        before, later = laws.one.size(name), laws.two.size(name)
        size = laws.signatures.sizes.get(name)
        if before and later and size and later < 0.5 * before:
            both = (format_quantity(value, size.unit, 3) for value in (before, later))
            sizes.append("{}: {} {} instead of {}".format(_name(found, name), size.parameter, *reversed(list(both))))
    if sizes:
        words.append("show smaller faults (" + ", ".join(dict.fromkeys(sizes)) + ")")
    return "; ".join(words)


# -- names -------------------------------------------------------------------------------------------------------------


def _physics(found: Isolation, key: str) -> str:
    """Return the name of a fault; of one in a wire also on which side of it the recording is, where both are tried."""
    item = found.faults[key]
    alike = [o for o in found.faults.values() if (o.physics, o.spot) == (item.physics, item.spot)]
    if item.fault.enters != "wire" or len({bool(o.measured) for o in alike}) < 2:
        return item.physics
    return f"{item.physics} ({'recorded after it' if item.measured else 'recorded before it'})"


def _name(found: Isolation, key: str) -> str:
    return f"{_physics(found, key)} at {found.faults[key].spot}"


def _names(found: Isolation, keys: Iterable[str]) -> list[str]:
    """Return faults by place: "rotor.force[2-5]: residual_bow, rub"; nodes with the same faults stand together."""
    at: dict[tuple[str, int | None], dict[str, None]] = {}
    for key in keys:
        item = found.faults[key]
        at.setdefault((f"{item.spot.block}.{item.spot.port}", item.spot.node), {})[_physics(found, key)] = None
    alike: dict[tuple[str, tuple[str, ...]], list[int | None]] = {}
    for (port, node), physics in at.items():
        alike.setdefault((port, tuple(physics)), []).append(node)
    return [f"{port}{_nodes(nodes)}: {', '.join(physics)}" for (port, physics), nodes in alike.items()]


def _nodes(nodes: Sequence[int | None]) -> str:
    numbers = sorted(node for node in nodes if node is not None)
    if not numbers:
        return ""
    return f"[{_ranges(numbers)}]"


def _ranges(numbers: Sequence[int]) -> str:
    """Return ascending numbers as "1-3, 5"."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def _entry(title: str, lines: Sequence[str]) -> str:
    return "\n".join([f"{title}:", *_folded([f"  {line}" for line in lines])])


def _folded(lines: Iterable[str]) -> list[str]:
    return [fill(line, WIDTH, subsequent_indent="    ", break_on_hyphens=False) for line in lines]


def _alike(taken_for: Mapping[str, frozenset[str]]) -> list[list[str]]:
    """Return groups of faults that are each taken for one another."""
    found: list[list[str]] = []
    for name, others in taken_for.items():
        same = [name, *(other for other in taken_for if other in others and name in taken_for[other])]
        if len(same) > 1 and not any(name in group for group in found):
            found.append(same)
    return found


def _classes(found: Isolation, taken_for: Mapping[str, frozenset[str]]) -> list[str]:
    """Return classes of faults that are each taken for one another, a line each; like ones of several nodes in one."""
    lines: dict[object, list[list[str]]] = {}
    for group in _alike(taken_for):
        if len({_name(found, key) for key in group}) < 2:
            continue
        spots = {found.faults[key].spot for key in group}
        spot = next(iter(spots))
        one = len(spots) == 1 and spot.node is not None
        key = (spot.block, spot.port, tuple(_physics(found, k) for k in group)) if one else tuple(group)
        lines.setdefault(key, []).append(group)
    out = []
    for groups in lines.values():
        text = "; ".join(_names(found, [key for group in groups for key in group]))
        out.append(text + (" (at each node)" if len(groups) > 1 else ""))
    return out


def _wider(found: Isolation, taken_for: Mapping[str, frozenset[str]]) -> list[str]:
    """Return faults with those that can do all that each does, and more; like ones of several nodes in one line."""
    out: dict[str, dict[str, None]] = {}
    first: dict[str, str] = {}
    for key, others in taken_for.items():
        for other in taken_for:
            if other in others and key not in taken_for[other] and _name(found, other) != _name(found, key):
                out.setdefault(_name(found, key), {})[other] = None
                first.setdefault(_name(found, key), key)
    lines: dict[tuple[str, str], list[str]] = {}
    for name, others_of in out.items():
        spot = found.faults[first[name]].spot
        here = all(found.faults[other].spot == spot for other in others_of)
        names = ", ".join(dict.fromkeys(_physics(found, o) for o in others_of)) if here else ""
        text = f"{names} there" if here else "; ".join(_names(found, others_of))
        head = f"{_physics(found, first[name])} at {spot.block}.{spot.port}" if here else name
        lines.setdefault((head, text), []).append(name)
    merged = []
    for (head, text), names_of in lines.items():
        nodes = _nodes([found.faults[first[name]].spot.node for name in names_of]) if text.endswith(" there") else ""
        merged.append(f"{head}{nodes} for {text}")
    return merged


def _by_reason(skipped: Mapping[str, str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, why in skipped.items():
        found.setdefault(why, []).append(name)
    return found
