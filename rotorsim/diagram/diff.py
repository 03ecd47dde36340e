"""What differs between two diagram documents, by meaning and not by text."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rotorsim.diagram.diagram import Solver
from rotorsim.diagram.resolve.registry import find
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.units import UnitError, compatible, parse_unit, split_quantity

__all__ = ["Change", "diff"]

_MISSING = object()
_DEFAULTS: Mapping[str, Any] = {"algebraic_loops": "refuse", "schema_version": 1}


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
    readers = {"layout", "description", "$schema"}
    keys = [key for key in dict.fromkeys([*a, *b]) if layout or key not in readers]
    for key in keys:
        old, new = a.get(key, _MISSING), b.get(key, _MISSING)
        if key == "blocks" and isinstance(old, Mapping) and isinstance(new, Mapping):
            for name in dict.fromkeys([*old, *new]):
                _block(f"blocks.{name}", old.get(name, _MISSING), new.get(name, _MISSING), changes)
        elif key == "wires" and isinstance(old, list) and isinstance(new, list):
            _wires(old, new, changes)
        elif key == "solver" and all(value is _MISSING or isinstance(value, Mapping) for value in (old, new)):
            _solver({} if old is _MISSING else old, {} if new is _MISSING else new, changes)
        else:
            fallback = _DEFAULTS.get(key, _MISSING)
            _compare(key, a.get(key, fallback), b.get(key, fallback), changes, None)
    if layout:
        for name, (old, new) in _both(a.get("blocks"), b.get("blocks")).items():
            if isinstance(old, Mapping) and isinstance(new, Mapping):
                before, after = (block.get("description", _MISSING) for block in (old, new))
                _compare(f"blocks.{name}.description", before, after, changes, None)
    return changes


def _both(a: Any, b: Any) -> dict[str, tuple[Any, Any]]:
    if not (isinstance(a, Mapping) and isinstance(b, Mapping)):
        return {}
    return {name: (a[name], b[name]) for name in a if name in b}


def _solver(old: Mapping[str, Any], new: Mapping[str, Any], changes: list[Change]) -> None:
    for key in dict.fromkeys([*old, *new]):
        fallback = getattr(Solver, key, _MISSING)
        values = old.get(key, fallback), new.get(key, fallback)
        _compare(f"solver.{key}", *values, changes, None)


def _block(where: str, old: Any, new: Any, changes: list[Change]) -> None:
    if not (isinstance(old, Mapping) and isinstance(new, Mapping)):
        _compare(where, old, new, changes, None)
        return
    _compare(f"{where}.type", old.get("type", _MISSING), new.get("type", _MISSING), changes, None)
    kind = find(str(new.get("type"))) if old.get("type") == new.get("type") else None
    before, after = old.get("parameters", {}), new.get("parameters", {})
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for name in dict.fromkeys([*before, *after]):
            declared = (kind.parameters.get(name) or kind.options.get(name)) if kind else None
            unit = declared.unit if declared and kind and name in kind.parameters else None
            fallback = declared.default if declared and declared.default is not None else _MISSING
            values = before.get(name, fallback), after.get(name, fallback)
            _compare(f"{where}.parameters.{name}", *values, changes, unit)
    rest = [key for key in dict.fromkeys([*old, *new]) if key not in ("type", "parameters", "description")]
    for key in rest:
        _compare(f"{where}.{key}", old.get(key, _MISSING), new.get(key, _MISSING), changes, None)


def _wires(old: list[Any], new: list[Any], changes: list[Change]) -> None:
    before, after = (Counter(_wire(pair) for pair in wires) for wires in (old, new))
    changes += [Change("-", "wires", old=wire) for wire in (before - after).elements()]
    changes += [Change("+", "wires", new=wire) for wire in (after - before).elements()]


def _wire(pair: Any) -> str:
    ends = [str(end).replace(" ", "") for end in pair] if isinstance(pair, list) else [str(pair)]
    return " -> ".join(ends)


def _compare(where: str, old: Any, new: Any, changes: list[Change], unit: str | None) -> None:
    if old is _MISSING or new is _MISSING:
        if old is not new:
            changes.append(Change("+", where, new=new) if old is _MISSING else Change("-", where, old=old))
    elif isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys([*old, *new]):
            _compare(f"{where}.{key}", old.get(key, _MISSING), new.get(key, _MISSING), changes, None)
    elif not _equal(old, new, unit):
        changes.append(Change("~", where, old, new))


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
