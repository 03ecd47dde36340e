"""What a page does to a diagram document: wire, set, add, ...; each a function from a document to a new one."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rotorsim.block import Block
from rotorsim.diagram import edit
from rotorsim.diagram.grouping import dissolve, group, listed
from rotorsim.diagram.parse.document import NAME_PATTERN, endpoint, free_name
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.serve.changes import changes_of, with_changes

Document = dict[str, Any]
Operation = Mapping[str, Any]


@dataclass(frozen=True)
class Editing:
    """What operations need to know. cells: block -> [column, row] of those that the picture places by itself.

    mine: patches write over what was changed meanwhile. recorded: what is recorded where the document does not say.
    folder: of the file; created: name of a new file there -> the document of a sub-diagram for it.
    """

    registry: Registry
    cells: Mapping[str, Sequence[float]]
    folder: Path
    mine: bool = False
    recorded: Sequence[str] = ()
    created: dict[str, Document] = field(default_factory=dict)


def applied(document: Document, operations: Iterable[Operation], editing: Editing) -> Document:
    """Return a document after operations, one after the other; the one given stays as it is.

    Raises RotorsimError for operations that are malformed or cannot be done.
    """
    new = copy.deepcopy(document)
    for operation in operations:
        if not isinstance(operation, Mapping) or operation.get("op") not in OPERATIONS:
            name = operation.get("op") if isinstance(operation, Mapping) else operation
            raise RotorsimError(Problem(f"unknown operation '{name}'", "edit", hint=near_miss(str(name), OPERATIONS)))
        needed = KEYS_NEEDED[operation["op"]]
        for key, kind in needed.items():
            if not isinstance(operation.get(key), kind):
                raise RotorsimError(Problem(f"operation '{operation['op']}' needs '{key}'", "edit"))
        new = OPERATIONS[operation["op"]](new, operation, editing)
    return new


def _block(document: Document, name: str) -> Document:
    """Return the entry of a block. Raises RotorsimError for one that is not in this file."""
    found = document.get("blocks", {}).get(name)
    if isinstance(found, dict):
        return found
    if "/" in name:
        part = name.partition("/")[0]
        raise RotorsimError(
            Problem(f"it is a part of the sub-diagram '{part}'", name, hint=f"enter {part}: it has a file of its own")
        )
    raise RotorsimError(Problem(f"no block '{name}'", name, hint=near_miss(name, document.get("blocks", {}))))


def _move(document: Document, operation: Operation, editing: Editing) -> Document:
    name = operation["block"]
    _block(document, name)
    _whole_layout(document, editing)[name] = _cell_of(operation["to"], name)
    return document


def _cell_of(to: Any, name: str) -> list[float]:
    numbers = isinstance(to, list) and len(to) == 2
    if not numbers or not all(isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < 1e9 for x in to):
        raise RotorsimError(Problem("a block moves to two numbers, [column, row]", name))
    return [_plain(x) for x in to]


def _whole_layout(document: Document, editing: Editing) -> Document:
    """Return the layout, with all blocks in it: without one of them the picture would place all by itself."""
    layout: Document = document.setdefault("layout", {})
    for name in document.get("blocks", {}):
        if name not in layout and name in editing.cells:
            layout[name] = [_plain(x) for x in editing.cells[name]]
    return layout


def _plain(x: float) -> float:
    """Return a coordinate as short as it can be written."""
    value = round(float(x), 6)
    return int(value) if value == int(value) else value


def _wire(document: Document, operation: Operation, editing: Editing) -> Document:
    source, target = operation["source"], operation["target"]
    for end in (source, target):
        if endpoint(end) is None:
            raise RotorsimError(Problem("is no end of a wire", end, hint='write "block.port"'))
    wires = document.setdefault("wires", [])
    if [source, target] in wires:
        raise RotorsimError(Problem("is wired already", f"{source} -> {target}"))
    wires.append([source, target])
    return document


def _cut(document: Document, operation: Operation, editing: Editing) -> Document:
    source, target = operation["source"], operation["target"]
    wires = document.get("wires", [])
    if [source, target] not in wires:
        inside = "/" in source.partition(".")[0] and "/" in target.partition(".")[0]
        hint = "it is inside a sub-diagram: enter that" if inside else ""
        raise RotorsimError(Problem("there is no such wire in this file", f"{source} -> {target}", hint=hint))
    wires.remove([source, target])
    return document


def _set(document: Document, operation: Operation, editing: Editing) -> Document:
    name = operation["name"]
    if "value" not in operation:
        raise RotorsimError(Problem("operation 'set' needs 'value'", "edit"))
    value = operation["value"]
    block, dot, key = name.rpartition(".")
    if not dot:
        parameters = document.get("parameters", {})
        if key not in parameters:
            raise RotorsimError(Problem(f"no diagram parameter '{key}'", key, hint=near_miss(key, parameters)))
        if value is None:
            raise RotorsimError(Problem("a parameter of the diagram has no default", key, hint="give it a value"))
        parameters[key] = value
        return document
    if block == "solver":
        settings = document.setdefault("solver", {})
        settings.pop(key, None) if value is None else settings.update({key: value})
        return document
    entry = _block(document, block)
    parameters = entry.setdefault("parameters", {})
    if value is None:
        parameters.pop(key, None)
    else:
        parameters[key] = value
    if not parameters:
        del entry["parameters"]
    return document


def _swap(document: Document, operation: Operation, editing: Editing) -> Document:
    _block(document, operation["block"])
    return edit.swap(document, operation["block"], operation["type"], None, editing.registry)


def _add(document: Document, operation: Operation, editing: Editing) -> Document:
    type_name, given = operation["type"], operation.get("parameters") or {}
    kind = editing.registry.find(type_name)
    if kind is None:
        what = f"unknown block type '{type_name}'"
        raise RotorsimError(Problem(what, type_name, hint=editing.registry.hint(type_name)))
    blocks = document.setdefault("blocks", {})
    name = operation.get("name") or free_name(type_name, blocks)
    if name in blocks or not NAME_PATTERN.fullmatch(str(name)):
        raise RotorsimError(_bad_name(str(name), blocks))
    layout = _whole_layout(document, editing)
    values = _ones(kind) | dict(given)
    blocks[name] = {"type": type_name, **({"parameters": values} if values else {})}
    layout[name] = _cell_of(operation["at"], name)
    return document


def _ones(kind: type[Block]) -> Document:
    """Return what a block has to be given: 1 in its unit each, one of that in a list."""
    given: Document = {
        key: _one(declared.unit) for key, declared in kind.parameters.items() if declared.default is None
    }
    for key, option in kind.options.items():
        if option.default is None and option.kind is not None:
            given[key] = [_one(option.unit)] if option.is_list else _one(option.unit)
    return given


def _one(unit: str | None) -> str | int:
    return f"1 {unit}" if unit not in (None, "1") else 1


def _insert(document: Document, operation: Operation, editing: Editing) -> Document:
    """Add copies of blocks, and of the wires among them; at: block -> [column, row]."""
    given = operation["blocks"]
    if not given or not all(isinstance(one, Mapping) for one in given.values()):
        raise RotorsimError(Problem("these are no blocks", "edit"))
    blocks = document.setdefault("blocks", {})
    layout = _whole_layout(document, editing)
    names: dict[str, str] = {}
    for old, entry in given.items():
        new = names[old] = free_name(old, blocks)
        if not NAME_PATTERN.fullmatch(new):
            raise RotorsimError(_bad_name(new, blocks))
        blocks[new] = copy.deepcopy(dict(entry))
        layout[new] = _cell_of(operation["at"].get(old), new)
    for wire in operation["wires"]:
        ends = [endpoint(end) for end in wire] if isinstance(wire, list) and len(wire) == 2 else []
        if not ends or any(end is None or end.block not in names for end in ends):
            raise RotorsimError(Problem("this is no wire among these blocks", "edit"))
        copied = [names[text.partition(".")[0]] + text[text.index(".") :] for text in wire]
        document.setdefault("wires", []).append(copied)
    return document


def _group(document: Document, operation: Operation, editing: Editing) -> Document:
    _whole_layout(document, editing)
    name = operation["name"]
    for one in operation["blocks"]:
        _block(document, str(one))
    taken = {one.stem for one in editing.folder.glob("*.json")} | {Path(one).stem for one in editing.created}
    file = f"{free_name(name, taken)}.json"
    outer, inner = group(document, operation["blocks"], name, file)
    outer["layout"][name] = [_plain(x) for x in outer["layout"][name]]
    editing.created[file] = inner
    return outer


def _dissolve(document: Document, operation: Operation, editing: Editing) -> Document:
    name = operation["block"]
    file = _block(document, name).get("file")
    if not isinstance(file, str):
        raise RotorsimError(Problem("is no sub-diagram", name))
    inner = read_document(editing.folder / file).data  # below the folder: the diagram could be drawn
    _whole_layout(document, editing)
    outer, _ = dissolve(document, name, inner)
    outer["layout"] = {one: [_plain(x) for x in at] for one, at in outer["layout"].items()}
    return outer


def _port(document: Document, operation: Operation, editing: Editing) -> Document:
    """Lead an input or output of a block out of the diagram, or no longer."""
    side, end = operation["side"], operation["end"]
    found = endpoint(end)
    if side not in ("inputs", "outputs") or found is None:
        raise RotorsimError(Problem("a port leads to 'block.port', on the side of inputs or outputs", "edit"))
    _block(document, found.block)
    ports = document.setdefault("ports", {})
    ends = ports.setdefault(side, {})
    named = [port for port, one in ends.items() if end in listed(one)]
    if operation["on"] and not named:
        ends[free_name(found.port, [*ports.get("inputs", {}), *ports.get("outputs", {})])] = end
    for port in [] if operation["on"] else named:
        _keep_ends(ends, port, [one for one in listed(ends[port]) if one != end])
    return _trimmed(document)


def _bad_name(name: str, blocks: Mapping[str, Any]) -> Problem:
    if name in blocks:
        return Problem("there is a block of this name", name, hint="choose another name")
    return Problem(f"'{name}' is not a name", "edit", hint="letters, digits and _, not a digit first")


def _remove(document: Document, operation: Operation, editing: Editing) -> Document:
    name = operation["block"]
    _block(document, name)
    del document["blocks"][name]
    document["wires"] = [wire for wire in document.get("wires", []) if not any(_is_of(end, name) for end in wire)]
    for key in ("layout", "identify", "measured"):
        held = document.get(key, {})
        for gone in [one for one in held if one == name or _is_of(one, name) or _is_of(held[one], name)]:
            del held[gone]
    if "record" in document:
        document["record"] = [signal for signal in document["record"] if not _is_of(signal, name)]
    for ends in document.get("ports", {}).values():
        for port, end in list(ends.items()):
            _keep_ends(ends, port, [one for one in listed(end) if not _is_of(one, name)])
    return _trimmed(document)


def _keep_ends(ends: Document, port: str, kept: list[Any]) -> None:
    """Leave a port of the diagram what it still leads to, or remove it."""
    if not kept:
        del ends[port]
    elif kept != listed(ends[port]):
        ends[port] = kept


def _trimmed(document: Document) -> Document:
    """Return a document without keys that hold nothing any more."""
    if "ports" in document:
        document["ports"] = {side: ends for side, ends in document["ports"].items() if ends}
    for key in ("layout", "identify", "measured", "ports"):
        if key in document and not document[key]:
            del document[key]
    return document


def _is_of(text: Any, block: str) -> bool:
    """Return whether a wire end, a signal or the name of a parameter is of a block, or inside of a sub-diagram."""
    owner = text.partition(".")[0].strip() if isinstance(text, str) else ""
    if not owner or ("." not in text and "/" not in text):  # "drive/k" is a parameter of a sub-diagram
        return False
    return owner == block or owner.startswith(f"{block}/")


def _rename(document: Document, operation: Operation, editing: Editing) -> Document:
    old, new = operation["block"], operation["to"]
    _block(document, old)
    if new == old:
        return document
    if new in document["blocks"] or not NAME_PATTERN.fullmatch(new):
        raise RotorsimError(_bad_name(new, document["blocks"]))

    def named(text: Any) -> Any:
        return new + text[len(old) :] if _is_of(text, old) and text.startswith(old) else text

    document["blocks"] = {new if name == old else name: entry for name, entry in document["blocks"].items()}
    document["wires"] = [[named(end) for end in wire] for wire in document.get("wires", [])]
    if "layout" in document:
        document["layout"] = {new if name == old else name: at for name, at in document["layout"].items()}
    for key in ("identify", "measured"):
        if key in document:
            document[key] = {named(name): named(value) for name, value in document[key].items()}
    if "record" in document:
        document["record"] = [named(signal) for signal in document["record"]]
    if "ports" in document:
        document["ports"] = {
            side: {
                port: [named(one) for one in end] if isinstance(end, list) else named(end) for port, end in ends.items()
            }
            for side, ends in document["ports"].items()
        }
    return document


def _record(document: Document, operation: Operation, editing: Editing) -> Document:
    signal, record = operation["signal"], document.setdefault("record", [*editing.recorded])
    if operation["on"] and signal not in record:
        record.append(signal)
    elif not operation["on"] and signal in record:
        record.remove(signal)
    return document


def _patch(document: Document, operation: Operation, editing: Editing) -> Document:
    """Return a document with changes made or undone that an earlier version was told of; none where one conflicts."""
    return with_changes(document, changes_of(operation["changes"]), mine=editing.mine)


OPERATIONS: dict[str, Callable[[Document, Operation, Editing], Document]] = {
    "move": _move,
    "wire": _wire,
    "cut": _cut,
    "set": _set,
    "swap": _swap,
    "add": _add,
    "remove": _remove,
    "rename": _rename,
    "record": _record,
    "insert": _insert,
    "group": _group,
    "dissolve": _dissolve,
    "port": _port,
    "patch": _patch,
}
KEYS_NEEDED: dict[str, dict[str, type]] = {
    "move": {"block": str, "to": list},
    "wire": {"source": str, "target": str},
    "cut": {"source": str, "target": str},
    "set": {"name": str},
    "swap": {"block": str, "type": str},
    "add": {"type": str, "at": list},
    "remove": {"block": str},
    "rename": {"block": str, "to": str},
    "record": {"signal": str, "on": bool},
    "insert": {"blocks": dict, "wires": list, "at": dict},
    "group": {"blocks": list, "name": str},
    "dissolve": {"block": str},
    "port": {"side": str, "end": str, "on": bool},
    "patch": {"changes": list},
}
