"""What differs between two diagram documents, by meaning and not by text."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from rotorsim.block import Param
from rotorsim.diagram.resolve.registry import find
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.diagram.solver import Solver
from rotorsim.units import UnitError, compatible, parse_unit, split_quantity

_MISSING = object()
_DEFAULTS: Mapping[str, Any] = {"algebraic_loops": "refuse", "schema_version": 1, "solver": {}}
_FOR_READERS = ("layout", "description", "$schema")


@dataclass(frozen=True)
class Change:
    """One difference: kind "+" added, "-" removed, "~" changed; where; the old and the new value as written.

    As text both values of a quantity are in one unit: that of the old value, else of the new one.
    """

    kind: str
    where: str
    old: Any = None
    new: Any = None

    def __str__(self) -> str:
        if self.kind == "~":
            old, new = _in_one_unit(self.old, self.new)
            return f"~ {self.where}: {_show(old)} -> {_show(new)}"
        value = self.new if self.kind == "+" else self.old
        return f"{self.kind} {self.where}: {_show(value)}"


def diff(a: Mapping[str, Any], b: Mapping[str, Any], *, layout: bool = False) -> list[Change]:
    """Return the changes that lead from document a to b.

    Quantities that are equal in SI ("24 um", 2.4e-5) are equal, and so is a default written out or not; the
    order of blocks, wires and keys has no meaning, but a force wired twice counts twice. What is for readers
    ($schema, description, layout) is compared only with ``layout``.
    """
    changes: list[Change] = []
    for key in [key for key in _keys(a, b) if layout or key not in _FOR_READERS]:
        old, new = (document.get(key, _DEFAULTS.get(key, _MISSING)) for document in (a, b))
        if key == "blocks" and isinstance(old, Mapping) and isinstance(new, Mapping):
            for name in _keys(old, new):
                changes += _block(f"blocks.{name}", old.get(name, _MISSING), new.get(name, _MISSING), layout)
        elif key == "wires" and isinstance(old, list) and isinstance(new, list):
            before, after = (Counter(map(_wire, wires)) for wires in (old, new))
            changes += [Change("-", "wires", old=wire) for wire in (before - after).elements()]
            changes += [Change("+", "wires", new=wire) for wire in (after - before).elements()]
        elif key == "solver" and isinstance(old, Mapping) and isinstance(new, Mapping):
            changes += _entries("solver", old, new, asdict(Solver()))
        else:
            changes += _compared(key, old, new)
    return changes


def _keys(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    return list(dict.fromkeys([*a, *b]))


def _block(where: str, old: Any, new: Any, layout: bool) -> list[Change]:
    if not (isinstance(old, Mapping) and isinstance(new, Mapping)):
        return _compared(where, old, new)
    kind = find(str(new.get("type"))) if old.get("type") == new.get("type") else None
    declared: dict[str, Any] = {**kind.options, **kind.parameters} if kind else {}
    defaults = {name: item.default for name, item in declared.items() if item.default is not None}
    units = {name: item.unit for name, item in declared.items() if isinstance(item, Param) or item.unit != "1"}
    hidden = ("parameters",) if layout else ("parameters", "description")
    rest = ({key: value for key, value in block.items() if key not in hidden} for block in (old, new))
    before, after = old.get("parameters", {}), new.get("parameters", {})
    given = isinstance(before, Mapping) and isinstance(after, Mapping)
    changes = _entries(where, *rest)
    return [*changes, *(_entries(f"{where}.parameters", before, after, defaults, units) if given else ())]


def _entries(
    where: str,
    old: Mapping[str, Any],
    new: Mapping[str, Any],
    defaults: Mapping[str, Any] = {},
    units: Mapping[str, str | None] = {},
) -> list[Change]:
    """Return the changes of an object's entries; what is not written has its default."""
    changes: list[Change] = []
    for key in _keys(old, new):
        before, after = (entries.get(key, defaults.get(key, _MISSING)) for entries in (old, new))
        changes += _compared(f"{where}.{key}", before, after, units.get(key))
    return changes


def _wire(pair: Any) -> str:
    ends = [str(end).replace(" ", "") for end in pair] if isinstance(pair, list) else [str(pair)]
    return " -> ".join(ends)


def _compared(where: str, old: Any, new: Any, unit: str | None = None) -> list[Change]:
    if old is new:
        return []
    if old is _MISSING:
        return [Change("+", where, new=new)]
    if new is _MISSING:
        return [Change("-", where, old=old)]
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        return _entries(where, old, new)
    return [] if _equal(old, new, unit) else [Change("~", where, old, new)]


def _equal(old: Any, new: Any, unit: str | None) -> bool:
    if old == new and isinstance(old, bool) == isinstance(new, bool):
        return True
    if isinstance(old, bool) or isinstance(new, bool):
        return False
    try:
        a, b = numeric(old, unit), numeric(new, unit)
        if isinstance(old, str) and isinstance(new, str):  # 2 kg is not 2 m, whatever the block takes
            fit = compatible(split_quantity(old)[1] or None, split_quantity(new)[1] or None)
            return fit in ("same", "scaled") and bool(a == b)
    except (ValueProblem, UnitError):
        return False
    return a.shape == b.shape and bool((a == b).all())


def _in_one_unit(old: Any, new: Any) -> tuple[Any, Any]:
    """Return two values in the unit of the one that states a unit; as they are where that cannot be."""
    try:
        units = [split_quantity(value)[1] if isinstance(value, str) else "" for value in (old, new)]
        unit = units[0] or units[1]
        if not unit or units[0] == units[1]:
            return old, new
        factor = parse_unit(unit).factor
        shown = [
            value if own == unit else f"{float(numeric(value, None)) / factor:.10g} {unit}"
            for value, own in zip((old, new), units, strict=True)
        ]
    except (ValueProblem, UnitError, TypeError):
        return old, new
    fit = all(compatible(own or None, unit) in ("same", "scaled") for own in units if own)
    return (shown[0], shown[1]) if fit else (old, new)


def _show(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
