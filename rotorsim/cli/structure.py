"""``rotorsim diagnose DIAGRAM --sensors``: what sensors can tell, before anything is measured."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError
from rotorsim.units import format_quantity

if TYPE_CHECKING:
    from rotorsim.diagnose.isolation import Isolation, Laws
    from rotorsim.diagnose.structure import Gain
    from rotorsim.diagram.diagram import Diagram

__all__ = ["show_isolation"]

WIDTH = 110
SHOWN = 8  # sensors, pairs
FARTHEST = 10.0  # times the size from which a fault is seen: told apart only beyond, it is said


def show_isolation(
    diagram: Diagram, sensors: str, speeds: str | None, *, trust_blocks: bool, progress: bool | None, as_json: bool
) -> None:  # fmt: skip
    """Print which faults of a diagram can be told apart with sensors ("rotor.displacement[3],controller.current")."""
    from rotorsim.diagnose.isolation import isolate, isolation_data

    wanted = [name.strip() for name in re.split(r",(?![^\[]*\])", sensors) if name.strip()]
    at = [] if speeds is None else [float(speed) for speed in common.speeds_of(speeds)]
    if any(speed == 0 for speed in at):
        raise RotorsimError(Problem(f"--speeds {speeds}: the shaft does not turn", hint="leave 0 out"))
    with common.progress_bar("signatures", progress) as show:
        found = isolate(diagram, wanted, speeds=at, trust_blocks=trust_blocks, progress=show)
    if as_json:
        common.echo_json(isolation_data(found))
    else:
        click.echo(_text(found))


def _text(found: Isolation) -> str:
    count = len({(item.physics, item.spot) for item in found.faults.values()})
    head = f"{found.diagram.name}, sensors {', '.join(found.sensors)}: {count} faults"
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
    for k, group in enumerate(structure.groups, 1):
        parts.append(_entry(f"Group {k}, told from all others but not within", _names(found, group)))
    if found.placements:
        rows = [(item.sensors[0], str(len(item.detected)), str(item.pairs)) for item in found.placements[:SHOWN]]
        parts.append(common.table(("further sensor", "faults seen", "pairs told apart"), rows))
        parts.append(_smallest(found.smallest))
    else:
        parts.append("No further sensor tells more.")
    return parts


def _smallest(gain: Gain) -> str:
    return f"All that sensors can tell is told with {' and '.join(gain.sensors)} ({gain.pairs} pairs more)."


def _laws(found: Isolation, laws: Laws) -> list[str]:
    from rotorsim.diagnose.signatures import NOISE, SIGMAS

    runs = laws.signatures.runs
    rpm = ", ".join(f"{common.rpm(float(speed)):.0f}" for speed in runs.speeds[runs.sets == 0])
    free = ", ".join(laws.signatures.parameters)
    head = f"LAWS (harmonics of runs at {rpm} rpm; free: {free})"
    parts = [fill(head, WIDTH, subsequent_indent="  ")]
    if laws.unseen:
        parts.append(_entry("Not seen: the free parameters imitate", _names(found, laws.unseen)))
    groups = [_names(found, group) for group in _alike(laws.taken_for)]
    parts += [_entry("Not told apart", names) for names in groups if len(names) > 1 or ", " in names[0]]
    wider = _wider(found, laws.taken_for)
    if wider:
        parts.append(_entry("Taken for a fault that can do all that it does", wider))
    parts += _sizes(found, laws)
    gains = _gains(found, laws)
    if runs.gains:
        text = f"Runs with other gains as well ({runs.gains}): {gains or 'tell no more faults apart'}."
        parts.append(fill(text, WIDTH, subsequent_indent="  "))
    if laws.sensors:
        rows = [(name, str(len(seen)), str(len(pairs))) for name, (seen, pairs) in list(laws.sensors.items())[:SHOWN]]
        parts.append(common.table(("further sensor", "faults seen", "pairs told apart"), rows))
    for why, names in _by_reason(laws.signatures.skipped).items():
        parts.append(_entry(f"Not judged ({why})", _names(found, names)))
    parts.append(
        f"Sizes are those that stand out by {SIGMAS:g} standard deviations of noise of {100 * NOISE:g} % of each "
        "signal's rms\nin every harmonic."
    )
    return parts


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
            *names, size.parameter, format_quantity(seen, size.unit, 3), format_quantity(item.size, size.unit, 3), more,
        )  # fmt: skip
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
        words.append("show " + "; ".join(_names(found, seen)))
    if apart:
        pairs = dict.fromkeys(f"{_name(found, a)} from {_name(found, b)}" for a, b in apart)
        words.append("tell " + ", ".join(list(pairs)[:SHOWN]))
    sizes = []
    for name in laws.one.names:
        before, later = laws.one.size(name), laws.two.size(name)
        size = laws.signatures.sizes.get(name)
        if before and later and size and later < 0.5 * before:
            both = (format_quantity(value, size.unit, 3) for value in (before, later))
            sizes.append("{}: {} instead of {}".format(_name(found, name), *reversed(list(both))))
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
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return "[" + ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs) + "]"


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


def _wider(found: Isolation, taken_for: Mapping[str, frozenset[str]]) -> list[str]:
    """Return faults with those that can do all that each does, and more."""
    out: dict[str, dict[str, None]] = {}
    for key, others in taken_for.items():
        for other in taken_for:
            if other in others and key not in taken_for[other] and _name(found, other) != _name(found, key):
                out.setdefault(_name(found, key), {})[other] = None
    return [f"{name} for {'; '.join(_names(found, others))}" for name, others in out.items()]


def _by_reason(skipped: Mapping[str, str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, why in skipped.items():
        found.setdefault(why, []).append(name)
    return found
