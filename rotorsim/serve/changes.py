"""What differs between two versions of a document, entry by entry, and how it is put into a third."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rotorsim.errors import Problem, RotorsimError

Document = dict[str, Any]
Path = tuple[str, ...]
BY_ENTRY = ("parameters", "blocks", "solver", "measured", "identify", "layout")  # objects whose entries stand alone
LISTS = ("wires", "record")  # in which an entry is there or not


class _Absent:
    """What stands where nothing is."""

    def __repr__(self) -> str:
        return "nothing"


NOTHING: Any = _Absent()


@dataclass(frozen=True)
class Change:
    """An entry of a document: NOTHING before, it is added behind ``after_key`` entries; NOTHING after, it is removed.

    path: of an object's entry ("blocks", "rotor", "parameters", "mass"), or of a list's ("wires", source, target).
    place: how many entries stood before it, where it was, or is, there.
    """

    path: Path
    before: Any
    after: Any
    place: int = 0

    def undone(self) -> Change:
        """Return the change that takes this one back."""
        return replace(self, before=self.after, after=self.before)

    def as_data(self) -> dict[str, Any]:
        """Return it as JSON holds it; what is absent has no key."""
        ends = {"before": self.before, "after": self.after}
        present = {key: value for key, value in ends.items() if value is not NOTHING}
        return {"path": list(self.path), "place": self.place, **present}


@dataclass(frozen=True)
class Conflict:
    """An entry that was changed on both sides: what it is called, and both values."""

    path: Path
    mine: Any
    theirs: Any

    @property
    def name(self) -> str:
        """The entry in words."""
        if self.path[0] == "wires":
            return f"wires: {' -> '.join(self.path[1:])}"
        return ".".join(self.path)


class ConflictError(RotorsimError):
    """Entries of a document were changed on both sides."""

    exit_code = 1

    def __init__(self, conflicts: Sequence[Conflict]) -> None:
        self.conflicts = tuple(conflicts)
        super().__init__(*(Problem("was changed by others meanwhile", one.name) for one in conflicts))


def changes_of(data: Iterable[Any]) -> list[Change]:
    """Return changes that JSON holds. Raises RotorsimError for what are none."""
    found = []
    for one in data:
        path = one.get("path") if isinstance(one, Mapping) else None
        if not isinstance(path, list) or not path or not all(isinstance(step, str) for step in path):
            raise RotorsimError(Problem("is no change of a document", "edit"))
        place = one.get("place", 0)
        if (
            not isinstance(place, int)
            or len(path) > 4
            or (path[0] in LISTS and len(path) not in (1, 1 + _steps(path[0])))
        ):
            raise RotorsimError(Problem("is no change of a document", "edit"))
        found.append(Change(tuple(path), one.get("before", NOTHING), one.get("after", NOTHING), place))
    return found


def _steps(key: str) -> int:
    """Return how many steps name an entry of a list: both ends of a wire, or a signal."""
    return 2 if key == "wires" else 1


def differences(old: Document, new: Document) -> list[Change]:
    """Return the changes that lead from one version to another, removals first, added entries in their order."""
    found: list[Change] = []
    for key in [*old, *(key for key in new if key not in old)]:
        before, after = old.get(key, NOTHING), new.get(key, NOTHING)
        if key in BY_ENTRY and all(isinstance(one, dict) or one is NOTHING for one in (before, after)):
            found += _of_object((key,), {} if before is NOTHING else before, {} if after is NOTHING else after)
        elif key in LISTS and _is_listed(key, before) and _is_listed(key, after):
            found += _of_list(key, before, after)
        elif not _same(before, after):
            found.append(Change((key,), before, after, _place(new if after is not NOTHING else old, key)))
    return sorted(found, key=lambda change: (change.after is not NOTHING, change.before is NOTHING))


def _same(a: Any, b: Any) -> bool:
    """Return whether two values are written alike: 1, 1.0 and true are not."""
    return type(a) is type(b) and (a == b if not isinstance(a, dict | list) else repr(a) == repr(b))


def _place(entries: Mapping[str, Any], key: str) -> int:
    return list(entries).index(key)


def _of_object(path: Path, old: Document, new: Document) -> list[Change]:
    found: list[Change] = []
    for key in [*old, *(key for key in new if key not in old)]:
        before, after = old.get(key, NOTHING), new.get(key, NOTHING)
        if _same(before, after):
            continue
        one = (*path, key)
        if len(one) == 2 and path[0] == "blocks" and _are_alike(before, after):
            found += _of_block(one, before, after)
        else:
            found.append(Change(one, before, after, _place(new if after is not NOTHING else old, key)))
    return found


def _are_alike(before: Any, after: Any) -> bool:
    """Return whether both are blocks of one type, so that their parameters are compared one by one."""
    return isinstance(before, dict) and isinstance(after, dict) and before.get("type") == after.get("type")


def _of_block(path: Path, before: Document, after: Document) -> list[Change]:
    rest = [{key: value for key, value in one.items() if key != "parameters"} for one in (before, after)]
    parameters = [one.get("parameters", {}) for one in (before, after)]
    if not all(isinstance(one, dict) for one in parameters):
        return [Change(path, before, after)]
    found = _of_object(path, rest[0], rest[1])
    return found + _of_object((*path, "parameters"), parameters[0], parameters[1])


def _is_listed(key: str, value: Any) -> bool:
    """Return whether a list is there, and holds entries of the known form, each once."""
    if not isinstance(value, list):
        return False
    entries = [_entry(key, one) for one in value]
    return None not in entries and len(set(entries)) == len(entries)


def _entry(key: str, value: Any) -> Path | None:
    """Return the steps that name an entry of a list."""
    steps = value if key == "wires" and isinstance(value, list) else [value]
    good = len(steps) == _steps(key) and all(isinstance(step, str) for step in steps)
    return tuple(steps) if good else None


def _of_list(key: str, old: list[Any], new: list[Any]) -> list[Change]:
    before, after = ({_entry(key, one): k for k, one in enumerate(side)} for side in (old, new))
    gone = [Change((key, *steps), True, NOTHING, k) for steps, k in before.items() if steps and steps not in after]
    come = [Change((key, *steps), NOTHING, True, k) for steps, k in after.items() if steps and steps not in before]
    return gone + come


def with_changes(document: Document, changes: Iterable[Change], *, mine: bool = False) -> Document:
    """Return a document with changes made in it that were made in another version of it.

    mine: what was changed here meanwhile is written over. Raises ConflictError for entries that are neither as they
    were before nor as they are to be.
    """
    new: Document = copy.deepcopy(document)
    conflicts = []
    for change in changes:
        now = _value(new, change.path)
        if _same(now, change.after):
            continue
        if _same(now, change.before) or mine:
            _put(new, change)
        else:
            conflicts.append(Conflict(change.path, change.after, now))
    if conflicts:
        raise ConflictError(conflicts)
    return new


def _value(document: Document, path: Path) -> Any:
    if path[0] in LISTS and len(path) > 1:
        return True if any(_entry(path[0], one) == path[1:] for one in document.get(path[0], [])) else NOTHING
    value: Any = document
    for step in path:
        value = value.get(step, NOTHING) if isinstance(value, dict) else NOTHING
    return value


def _put(document: Document, change: Change) -> None:
    """Write, insert or remove one entry; objects that hold nothing any more go, lists stay."""
    key = change.path[0]
    if key in LISTS and len(change.path) > 1:
        _put_in_list(document, change)
        return
    holders = [document]
    for step in change.path[:-1]:
        inner = holders[-1].get(step)
        if not isinstance(inner, dict):
            if change.after is NOTHING:
                return
            inner = holders[-1][step] = {}
        holders.append(inner)
    _put_in_object(holders[-1], change)
    if change.after is NOTHING and len(change.path) > 1 and not holders[-1] and change.path[-2] != "blocks":
        del holders[-2][change.path[-2]]


def _put_in_object(holder: Document, change: Change) -> None:
    key = change.path[-1]
    if change.after is NOTHING:
        holder.pop(key, None)
    elif key in holder:
        holder[key] = copy.deepcopy(change.after)
    else:
        entries = list(holder.items())
        entries.insert(change.place, (key, copy.deepcopy(change.after)))
        holder.clear()
        holder.update(entries)


def _put_in_list(document: Document, change: Change) -> None:
    key, steps = change.path[0], change.path[1:]
    entries = document.setdefault(key, [])
    there = [k for k, one in enumerate(entries) if _entry(key, one) == steps]
    if change.after is NOTHING:
        for k in there[::-1]:
            del entries[k]
    elif not there:
        entries.insert(change.place, list(steps) if key == "wires" else steps[0])
