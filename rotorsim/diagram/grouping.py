"""Group blocks of a diagram document into a sub-diagram with a file of its own, and put its blocks back."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Mapping
from pathlib import PurePosixPath
from typing import Any

from rotorsim.diagram.diagram import Endpoint
from rotorsim.diagram.parse.document import NAME_PATTERN, endpoint, free_name
from rotorsim.errors import Problem, RotorsimError, near_miss

Document = dict[str, Any]


def group(data: Mapping[str, Any], blocks: Collection[str], name: str, file: str) -> tuple[Document, Document]:
    """Return a document with ``blocks`` replaced by the sub-diagram ``name``, and the document of its file.

    Every signal that crosses the border gets a port. Parameters of the diagram that the blocks follow are parameters of
    the sub-diagram, which follow those outside. file: its path as the document names it, in the same folder.
    Raises RotorsimError for blocks that are not there, and a name that is taken or none.
    """
    outer: Document = copy.deepcopy(dict(data))
    entries, chosen = outer.get("blocks", {}), list(dict.fromkeys(blocks))
    problems = [Problem(f"no block '{one}'", one, hint=near_miss(one, entries)) for one in chosen if one not in entries]
    if not chosen:
        problems.append(Problem("no block is chosen", "group"))
    if not NAME_PATTERN.fullmatch(name):
        problems.append(Problem(f"'{name}' is not a name", "group", hint="letters, digits and _, not a digit first"))
    elif name in entries and name not in chosen:
        problems.append(Problem("there is a block of this name", name, hint="choose another name"))
    if problems:
        raise RotorsimError(*problems)
    own = {one: entries[one] for one in entries if one in chosen}
    border = _Border(own)
    if "wires" in outer:
        kept: dict[tuple[str, ...], None] = {}
        for source, target in outer["wires"]:
            wire = tuple(border.wire(source, target, name) or ())
            if wire == (source, target):  # stays where it stood, also where others have become the same
                kept.pop(wire, None)
            kept |= {wire: None} if wire and wire not in kept else {}
        outer["wires"] = [list(wire) for wire in kept]
    for side, ends in outer.get("ports", {}).items():
        ends.update({port: border.exposed(written, side == "inputs", name) for port, written in ends.items()})
    outer["blocks"] = _with_entries(entries, own, {name: {"type": "diagram", "file": file, **_followed(own)}}, name)
    _rename(outer, lambda block: f"{name}/{block}" if block.partition("/")[0] in own else block)
    inner: Document = {"schema_version": 1, "name": name}
    parameters = {key: outer["parameters"][key] for key in names_followed(own) if key in outer.get("parameters", {})}
    inner |= {"parameters": parameters} if parameters else {}
    inner |= {"blocks": own, "wires": border.inside}
    inner |= {"block_folders": copy.deepcopy(outer["block_folders"])} if "block_folders" in outer else {}
    ports = {"inputs": border.inputs, "outputs": border.outputs}
    inner |= {"ports": {side: ends for side, ends in ports.items() if ends}} if any(ports.values()) else {}
    places = {one: at for one, at in outer.get("layout", {}).items() if one in own}
    if places:
        inner["layout"] = places
        middle = [sum(at[k] for at in places.values()) / len(places) for k in (0, 1)]
        outer["layout"] = _with_entries(outer["layout"], places, {name: middle}, name)
    return outer, inner


def dissolve(data: Mapping[str, Any], name: str, inner: Mapping[str, Any]) -> tuple[Document, dict[str, str]]:
    """Return a document with the blocks of the sub-diagram ``name`` in its place, and their names there.

    inner: what its file holds. Blocks keep their names, with the sub-diagram's in front where one is taken. Its
    parameters are replaced by the values that they are given, or by their own.
    Raises RotorsimError where the block is no sub-diagram.
    """
    outer: Document = copy.deepcopy(dict(data))
    entries = outer.get("blocks", {})
    entry = entries.get(name)
    if not isinstance(entry, dict) or entry.get("type") != "diagram":
        raise RotorsimError(Problem("is no sub-diagram", name, hint=near_miss(name, entries)))
    taken = [one for one in entries if one != name]
    names: dict[str, str] = {}
    for one in inner.get("blocks", {}):
        new = free_name(one if one not in taken else f"{name}_{one}", [*taken, *names.values()])
        names[one] = new
    values = {**inner.get("parameters", {}), **entry.get("parameters", {})}
    own = {names[one]: _with_values(block, values) for one, block in copy.deepcopy(inner.get("blocks", {})).items()}

    def renamed(text: str) -> str:
        end = endpoint(text)
        return text if end is None or end.block not in names else names[end.block] + text[text.index(".") :]

    ports = inner.get("ports", {})
    outer["wires"] = [
        [source, target]
        for wire in outer.get("wires", [])
        for source in _ends_inside(wire[0], name, ports.get("outputs", {}), renamed)
        for target in _ends_inside(wire[1], name, ports.get("inputs", {}), renamed)
    ] + [[renamed(end) for end in wire] for wire in inner.get("wires", [])]
    for side, ends in outer.get("ports", {}).items():
        for port, written in ends.items():
            known = ports.get(side, {})
            inside = [end for one in listed(written) for end in _ends_inside(one, name, known, renamed)]
            ends[port] = inside[0] if len(inside) == 1 else inside
    folder = PurePosixPath(str(entry.get("file", ""))).parent
    for block in own.values():
        block |= {"file": (folder / block["file"]).as_posix()} if "file" in block else {}
    outer["blocks"] = _with_entries(entries, [name], own, name)
    if "record" in outer:
        signals = (_ends_inside(one, name, ports.get("outputs", {}), renamed) for one in outer["record"])
        outer["record"] = [signal for ends in signals for signal in ends]

    free = outer.get("identify", {})
    for key in [one for one in free if one.partition("/")[0] == name and one.count("/") == 1 and "." not in one]:
        held = free.pop(key)  # a parameter of the sub-diagram: what follows it inside
        followed = f"${key.partition('/')[2]}"
        for one, block in inner.get("blocks", {}).items():
            values, dot = block.get("parameters", {}), "/" if block.get("type") == "diagram" else "."
            free |= {f"{name}/{one}{dot}{each}": held for each, value in values.items() if value == followed}

    def out(block: str) -> str:
        part, _, rest = block.partition("/")
        first, slash, more = rest.partition("/")
        return names.get(first, first) + slash + more if part == name and rest else block

    _rename(outer, out)
    at, places = outer.get("layout", {}).get(name), inner.get("layout", {})
    if at is not None:
        moved: Document = {new: [at[0], at[1] + k] for k, new in enumerate(names.values())}
        if set(places) >= set(names):
            middle = [sum(place[k] for place in places.values()) / len(places) for k in (0, 1)]
            moved = {new: [at[k] + places[one][k] - middle[k] for k in (0, 1)] for one, new in names.items()}
        outer["layout"] = _with_entries(outer["layout"], [name], moved, name)
    return outer, names


class _Border:
    """What crosses the border of a group: ports by the signal that comes in, or by the output that goes out."""

    def __init__(self, own: Collection[str]) -> None:
        self.own = own
        self.inside: list[list[str]] = []
        self.inputs: dict[str, Any] = {}
        self.outputs: dict[str, Any] = {}
        self._entered: dict[str, str] = {}  # signal outside -> port
        self._left: dict[str, str] = {}  # output inside -> port

    def has(self, text: str) -> bool:
        end = endpoint(text)
        return end is not None and end.block in self.own

    def wire(self, source: str, target: str, name: str) -> list[str] | None:
        """Return what a wire is outside of the group, None inside, where it is kept."""
        if self.has(source) and self.has(target):
            self.inside.append([source, target])
            return None
        if self.has(target):
            return [source, f"{name}.{self.enter(source, target)}"]
        return [f"{name}.{self.leave(source)}", target] if self.has(source) else [source, target]

    def exposed(self, written: Any, is_input: bool, name: str) -> Any:
        """Return what a port of the diagram leads to, with a port of the group for ends inside of it."""
        if not is_input:
            return f"{name}.{self.leave(written)}" if isinstance(written, str) and self.has(written) else written
        ends = [f"{name}.{self.enter(f'port {written}', end)}" if self.has(end) else end for end in listed(written)]
        ends = list(dict.fromkeys(ends))
        return ends[0] if len(ends) == 1 else ends

    def enter(self, source: str, target: str) -> str:
        if source not in self._entered:
            self._entered[source] = self._free(target)
            self.inputs[self._entered[source]] = target
        else:
            port = self._entered[source]
            self.inputs[port] = [*listed(self.inputs[port]), target]
        return self._entered[source]

    def leave(self, source: str) -> str:
        if source not in self._left:
            self._left[source] = self._free(source)
            self.outputs[self._left[source]] = source
        return self._left[source]

    def _free(self, text: str) -> str:
        """Return a name for a port: that of the block's port, else with the block's name before it."""
        end = endpoint(text)
        assert isinstance(end, Endpoint)
        taken = [*self.inputs, *self.outputs]
        plain = end.port.rstrip("0123456789") in ("input", "output")  # says nothing: the block's name does
        wanted = end.block if plain else end.port
        return free_name(wanted if wanted not in taken else f"{end.block}_{end.port}", taken)


def listed(written: Any) -> list[Any]:
    """Return what a port of a diagram leads to, one end or several, as a list."""
    return list(written) if isinstance(written, list) else [written]


def names_followed(blocks: Mapping[str, Any]) -> list[str]:
    """Return the parameters of a diagram that those of blocks follow."""
    values = [value for block in blocks.values() for value in block.get("parameters", {}).values()]
    return list(dict.fromkeys(value[1:] for value in values if isinstance(value, str) and value.startswith("$")))


def _followed(blocks: Mapping[str, Any]) -> Document:
    names = names_followed(blocks)
    return {"parameters": {name: f"${name}" for name in names}} if names else {}


def _with_values(block: Document, values: Mapping[str, Any]) -> Document:
    """Return a block whose references to parameters are what these are given."""
    for key, value in block.get("parameters", {}).items():
        if isinstance(value, str) and value.startswith("$") and value[1:] in values:
            block["parameters"][key] = values[value[1:]]
    return block


def _with_entries(entries: Mapping[str, Any], gone: Collection[str], new: Mapping[str, Any], name: str) -> Document:
    """Return entries without some; what comes for them stands where that of ``name`` stood, else the first of them."""
    at = name if name in gone and name in entries else next(one for one in entries if one in gone)
    found: Document = {}
    for one, held in entries.items():
        found |= new if one == at else {} if one in gone or one in new else {one: held}
    return found


def _ends_inside(text: Any, name: str, ports: Mapping[str, Any], renamed: Callable[[str], str]) -> list[Any]:
    """Return what a wire end means inside of a sub-diagram, the end itself where it is another block's."""
    end = endpoint(text)
    if end is None or end.block != name:
        return [text]
    index = text[text.index("[") :] if "[" in text else ""
    return [_indexed(renamed(one), index) for one in listed(ports.get(end.port, []))]


def _indexed(text: str, index: str) -> str:
    """Return a wire end with one more index behind its own."""
    return f"{text[:-1]},{index[1:]}" if index and text.endswith("]") else text + index


def _rename(document: Document, named: Callable[[str], str]) -> None:
    """Give blocks other names in what a document records, measures and leaves free; wires are not looked at."""

    def one(text: Any) -> Any:
        block, dot, rest = text.partition(".") if isinstance(text, str) else ("", "", "")
        return named(block) + dot + rest if dot or "/" in block else text  # "drive/k": a parameter of a sub-diagram

    if "record" in document:
        document["record"] = [one(signal) for signal in document["record"]]
    for key in ("identify", "measured"):
        if isinstance(document.get(key), dict):
            document[key] = {one(name): one(value) for name, value in document[key].items()}
