"""What differs between two diagram documents, by meaning and not by text."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rotorsim.diagram.registry import find
from rotorsim.diagram.values import ValueProblem, numeric

__all__ = ["Change", "diff"]

_MISSING = object()


@dataclass(frozen=True)
class Change:
    """One difference: kind "+" added, "-" removed, "~" changed; where; the old and the new value."""

    kind: str
    where: str
    old: Any = None
    new: Any = None

    def __str__(self) -> str:
        if self.kind == "~":
            return f"~ {self.where}: {_show(self.old)} -> {_show(self.new)}"
        value = self.new if self.kind == "+" else self.old
        return f"{self.kind} {self.where}: {_show(value)}"


def diff(a: Mapping[str, Any], b: Mapping[str, Any], *, layout: bool = False) -> list[Change]:
    """Return the changes that lead from document a to b.

    Quantities that are equal in SI ("24 um", 2.4e-5) are equal; the order of blocks, wires and keys has
    no meaning; texts for readers (description, layout) are compared only with ``layout``.
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
        else:
            _compare(key, old, new, changes, None)
    return changes


def _block(where: str, old: Any, new: Any, changes: list[Change]) -> None:
    if not (isinstance(old, Mapping) and isinstance(new, Mapping)):
        _compare(where, old, new, changes, None)
        return
    _compare(f"{where}.type", old.get("type", _MISSING), new.get("type", _MISSING), changes, None)
    kind = find(str(new.get("type"))) if old.get("type") == new.get("type") else None
    before, after = old.get("parameters", {}), new.get("parameters", {})
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for name in dict.fromkeys([*before, *after]):
            declared = kind.parameters.get(name) if kind else None
            unit = declared.unit if declared else None
            fallback = declared.default if declared and declared.default is not None else _MISSING
            values = before.get(name, fallback), after.get(name, fallback)
            _compare(f"{where}.parameters.{name}", *values, changes, unit)
    rest = [key for key in dict.fromkeys([*old, *new]) if key not in ("type", "parameters", "description")]
    for key in rest:
        _compare(f"{where}.{key}", old.get(key, _MISSING), new.get(key, _MISSING), changes, None)


def _wires(old: list[Any], new: list[Any], changes: list[Change]) -> None:
    before, after = ([_wire(pair) for pair in wires] for wires in (old, new))
    changes += [Change("-", "wires", old=wire) for wire in dict.fromkeys(before) if wire not in set(after)]
    changes += [Change("+", "wires", new=wire) for wire in dict.fromkeys(after) if wire not in set(before)]


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
    except ValueProblem:
        return False
    return a.shape == b.shape and bool((a == b).all())


def _show(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
