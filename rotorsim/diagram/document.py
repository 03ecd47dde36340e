"""The flat form of a diagram document: sub-diagrams inlined, references and wire ends resolved to text parts.

Only the form of the JSON is checked here (keys, names, kinds of values); what blocks allow is checked later.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Endpoint
from rotorsim.diagram.source import JsonPath, Source, read_document
from rotorsim.errors import Place, Problem, RotorsimError, near_miss

__all__ = ["FlatDocument", "Parameter", "RawBlock", "RawWire", "Scope", "endpoint", "flatten_document"]

MAX_SUB_DEPTH = 8
MAX_BLOCKS = 200_000
RESERVED = ("solver",)

_KEYS = (
    "$schema", "schema_version", "name", "description", "parameters", "blocks", "wires", "solver", "record",
    "algebraic_loops", "block_folders", "ports", "layout",
)  # fmt: skip
_BLOCK_KEYS = ("type", "parameters", "file", "description")
_KINDS = {
    "$schema": str, "schema_version": int, "name": str, "description": str, "parameters": dict, "blocks": dict,
    "wires": list, "solver": dict, "record": list, "algebraic_loops": str, "block_folders": list, "ports": dict,
    "layout": dict,
}  # fmt: skip
_WORDS = {str: "a text", int: "a whole number", dict: "an object {...}", list: "a list [...]"}
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_END = re.compile(
    r"([A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*)\.([A-Za-z_][A-Za-z0-9_]*)(?:\[\s*(\d{1,9}(?:\s*,\s*\d{1,9})*)\s*\])?"
)


@dataclass
class Parameter:
    """A diagram parameter: its JSON value, where it is, and (block, parameter) that follow it."""

    name: str
    value: Any
    place: Place
    users: list[tuple[str, str]] = field(default_factory=list)
    used: bool = False


@dataclass
class Scope:
    """The parameters that ``$name`` can mean inside one document, with the document's place of blocks."""

    prefix: str
    source: Source
    parameters: dict[str, Parameter]


@dataclass
class RawBlock:
    """A block as written: flat name, type, parameters and the scope of its references."""

    name: str
    type_name: str
    parameters: Mapping[str, Any]
    scope: Scope
    path: JsonPath
    file: str | None = None
    overrides: dict[str, Any] = field(default_factory=dict)

    def place(self, *more: str | int, key: bool = False) -> Place:
        """Return where (a part of) this block is written."""
        return self.scope.source.place((*self.path, *more), key=key)

    def place_of(self, parameter: str, *, key: bool = False) -> Place:
        """Return where a parameter of this block is written."""
        return Place("--set") if parameter in self.overrides else self.place("parameters", parameter, key=key)


@dataclass
class RawWire:
    """A wire between flat ends; ``written`` is the text of both ends."""

    source: Endpoint
    target: Endpoint
    place: Place


@dataclass
class FlatDocument:
    """What `flatten_document` found; ``problems`` has errors and warnings."""

    source: Source
    data: Mapping[str, Any]
    name: str
    parameters: dict[str, Parameter]
    blocks: dict[str, RawBlock] = field(default_factory=dict)
    wires: list[RawWire] = field(default_factory=list)
    record: list[tuple[Endpoint, Place]] | None = None
    exposed: dict[tuple[str, str], Place] = field(default_factory=dict)
    sub_diagrams: set[str] = field(default_factory=set)
    sub_ports: dict[str, _Ports] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)


@dataclass
class _Ports:
    """What the ports of a sub-diagram stand for inside."""

    inputs: dict[str, list[Endpoint]] = field(default_factory=dict)
    outputs: dict[str, Endpoint] = field(default_factory=dict)


def endpoint(text: Any, prefix: str = "") -> Endpoint | None:
    """Return the wire end that ``"block.port[i,j]"`` means (counted from 0), or None if it is malformed."""
    match = _END.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        return None
    block, port, inside = match.groups()
    if inside is None:
        return Endpoint(prefix + block, port)
    index = tuple(int(part) - 1 for part in inside.split(","))
    return None if min(index) < 0 else Endpoint(prefix + block, port, index)


def flatten_document(
    source: Source,
    folder: Path | None,
    parameter_overrides: Mapping[str, Any],
    block_overrides: Mapping[str, Mapping[str, Any]],
) -> FlatDocument:
    """Return the flat form of a document.

    parameter_overrides: diagram parameter -> value; block_overrides: flat block name -> parameter -> value.
    """
    data = source.data if isinstance(source.data, dict) else {}
    stem = Path(source.file).stem if source.file else "diagram"
    flat = FlatDocument(source, data, str(data.get("name", stem)), {})
    if not isinstance(source.data, dict):
        flat.problems.append(Problem("a diagram is a JSON object {...}", place=source.locate()))
        return flat
    _Flattener(flat, folder, block_overrides).top(source, parameter_overrides)
    return flat


class _Flattener:
    def __init__(self, flat: FlatDocument, folder: Path | None, overrides: Mapping[str, Mapping[str, Any]]) -> None:
        self.flat, self.root, self.overrides = flat, folder, overrides
        self.problems = flat.problems
        self.files: dict[Path, Source] = {}

    def top(self, source: Source, overrides: Mapping[str, Any]) -> None:
        data = self.form(source)
        scope = Scope("", source, {})
        for name, value in data["parameters"].items():
            place = Place("--set") if name in overrides else source.place(("parameters", name))
            scope.parameters[name] = Parameter(name, overrides.get(name, value), place)
        self.flat.parameters.update(scope.parameters)
        self.document(data, scope, self.root, ())
        if "record" in data:
            self.flat.record = self.record(data["record"], source)
        for name, ends in self.ports(data, scope).inputs.items():
            for end in ends:
                self.flat.exposed[end.block, end.port] = source.place(("ports", "inputs", name))

    def error(self, what: str, place: Place, subject: str = "", hint: str = "") -> None:
        self.problems.append(Problem(what, subject=subject, place=place, hint=hint))

    def limit(self, count: int, most: int, what: str) -> None:
        if count > most:  # sub-diagrams of sub-diagrams multiply: stop at once
            raise RotorsimError(Problem(f"more than {most} {what}", place=Place(self.flat.source.file)))

    def form(self, source: Source) -> dict[str, Any]:
        """Check the keys of a document and return it with every key present and of the right kind."""
        given: Any = source.data
        data: dict[str, Any] = {}
        for key, value in given.items():
            if key not in _KEYS:
                self.error(f"unknown key '{key}'", source.locate((key,), key=True), hint=near_miss(str(key), _KEYS))
            elif not isinstance(value, _KINDS[key]) or isinstance(value, bool):
                self.error(f"must be {_WORDS[_KINDS[key]]}", source.locate((key,)), subject=key)
            else:
                data[key] = value
        if "blocks" not in given:
            self.error("key 'blocks' is missing", source.locate(), hint='"blocks": {"name": {"type": "..."}}')
        if data.get("schema_version", 1) != 1:
            what = f"schema_version {data['schema_version']} is not known"
            self.error(what, source.locate(("schema_version",)), hint="this version of rotorsim reads schema_version 1")
        if data.get("algebraic_loops", "refuse") not in ("refuse", "solve"):
            what = f"algebraic_loops is '{data['algebraic_loops']}'"
            self.error(what, source.locate(("algebraic_loops",)), hint="it is 'refuse' or 'solve'")
        for key, empty in (("parameters", {}), ("blocks", {}), ("wires", []), ("ports", {})):
            data.setdefault(key, empty)
        for key in ("parameters", "blocks"):
            for name in [name for name in data[key] if not NAME.fullmatch(str(name))]:
                hint = "names are letters, digits and _, and do not start with a digit"
                self.error(f"'{name}' is not a name", source.locate((key, name), key=True), subject=key, hint=hint)
        for name in RESERVED:
            if name in data["blocks"]:
                hint = f"'{name}' would not be told from the settings in --set {name}.step=..."
                self.error(f"'{name}' is reserved", source.locate(("blocks", name), key=True), subject=name, hint=hint)
        return data

    def document(self, data: dict[str, Any], scope: Scope, folder: Path | None, chain: tuple[Path, ...]) -> None:
        source, prefix = scope.source, scope.prefix
        ports: dict[str, _Ports] = self.flat.sub_ports
        for name, block in data["blocks"].items():
            path: JsonPath = ("blocks", name)
            if not NAME.fullmatch(str(name)) or not self.block_form(name, block, source):
                continue
            flat_name = prefix + name
            overrides = dict(self.overrides.get(flat_name, {}))
            parameters = {**block.get("parameters", {}), **overrides} if overrides else block.get("parameters", {})
            raw = RawBlock(flat_name, block["type"], parameters, scope, path, block.get("file"), overrides)
            if block["type"] == "diagram":
                self.flat.sub_diagrams.add(flat_name)
                ports[flat_name] = self.sub_diagram(raw, folder, chain) or _Ports()
            else:
                self.flat.blocks[flat_name] = raw
            self.limit(len(self.flat.blocks) + len(self.flat.sub_diagrams), MAX_BLOCKS, "blocks")
        self.wires(data["wires"], scope)

    def block_form(self, name: str, block: Any, source: Source) -> bool:
        path: JsonPath = ("blocks", name)
        if not isinstance(block, dict):
            self.error('must be an object {"type": ...}', source.locate(path), subject=name)
            return False
        good = True
        for key in block:
            if key not in _BLOCK_KEYS:
                hint = near_miss(str(key), _BLOCK_KEYS)
                if not hint.startswith("did"):
                    hint = 'parameters of the block go into "parameters": {...}'
                self.error(f"unknown key '{key}'", source.locate((*path, key), key=True), subject=name, hint=hint)
        for key, kind in (("type", str), ("parameters", dict), ("file", str), ("description", str)):
            if key in block and not isinstance(block[key], kind):
                self.error(f"'{key}' must be {_WORDS[kind]}", source.locate((*path, key)), subject=name)
                good = False
        if "type" not in block:
            self.error("key 'type' is missing", source.locate(path), subject=name)
            good = False
        return good

    def sub_diagram(self, raw: RawBlock, folder: Path | None, chain: tuple[Path, ...]) -> _Ports | None:
        try:
            path = self.sub_path(raw, folder, chain)
            source = self.files.get(path)
            if source is None:
                source = self.files[path] = read_document(path)
                source.file = self.shown(path)
        except RotorsimError as error:
            for problem in error.problems:
                place = problem.place if problem.place.line else raw.place("file")
                what = problem.what if problem.place.line else f"{problem.what}: {raw.file}"
                self.error(what, place, raw.name, problem.hint)
            return None
        if not isinstance(source.data, dict):
            self.error("a diagram is a JSON object {...}", source.locate(), raw.name)
            return None
        before = len(self.problems)
        data = self.form(source)
        inner = Scope(raw.name + "/", source, {})
        for name, value in data["parameters"].items():
            if name in raw.parameters:
                given = raw.parameters[name]
                outer = self.reference(given, raw.scope)
                if outer is None:
                    outer = Parameter(inner.prefix + name, given, raw.place_of(name))
                    self.flat.parameters[outer.name] = outer
            else:
                outer = Parameter(inner.prefix + name, value, source.place(("parameters", name)))
                self.flat.parameters[outer.name] = outer
            inner.parameters[name] = outer
        for name in raw.parameters:
            if name not in data["parameters"]:
                what, hint = f"sub-diagram has no parameter '{name}'", near_miss(name, data["parameters"])
                self.error(what, raw.place_of(name, key=True), f"{raw.name}.{name}", hint)
        if len(self.problems) > before and path in chain:
            return None
        self.document(data, inner, path.parent, (*chain, path))
        return self.ports(data, inner)

    def shown(self, path: Path) -> str:
        outer = Path(self.flat.source.file).parent
        assert self.root is not None
        return str(outer / path.relative_to(self.root.resolve()))

    def sub_path(self, raw: RawBlock, folder: Path | None, chain: tuple[Path, ...]) -> Path:
        if raw.file is None:
            raise RotorsimError(Problem("sub-diagram without key 'file'", raw.name, raw.place()))
        if folder is None or self.root is None:
            raise RotorsimError(
                Problem("a document in memory has no folder to read from", raw.name, hint="pass folder=")
            )
        hint = "name a file inside the folder of the diagram, such as 'parts/sub.json'"
        parts = re.split(r"[/\\]", raw.file)
        if ".." in parts or "\\" in raw.file or Path(raw.file).is_absolute() or ":" in raw.file or "\0" in raw.file:
            raise RotorsimError(Problem("file is outside the folder of the diagram", raw.name, hint=hint))
        path = (folder / raw.file).resolve()
        if not path.is_relative_to(self.root.resolve()):  # a symbolic link may lead out
            raise RotorsimError(Problem("file is outside the folder of the diagram", raw.name, hint=hint))
        top = self.flat.source.path
        if path in chain or (top is not None and path == top.resolve()):
            raise RotorsimError(Problem("sub-diagram contains itself", raw.name, hint="remove the circle of files"))
        if len(chain) >= MAX_SUB_DEPTH:
            raise RotorsimError(Problem(f"sub-diagrams are nested deeper than {MAX_SUB_DEPTH}", raw.name))
        return path

    def reference(self, value: Any, scope: Scope) -> Parameter | None:
        """Return the parameter that ``"$name"`` means in a scope, None for any other value."""
        if not isinstance(value, str) or not value.startswith("$"):
            return None
        found = scope.parameters.get(value[1:])
        if found is not None:
            found.used = True
        return found

    def ports(self, data: dict[str, Any], scope: Scope) -> _Ports:
        result, source = _Ports(), scope.source
        for key, group in data["ports"].items():
            path: JsonPath = ("ports", key)
            if key not in ("inputs", "outputs"):
                self.error(
                    f"unknown key '{key}'",
                    source.locate(path, key=True),
                    "ports",
                    near_miss(key, ("inputs", "outputs")),
                )
                continue
            if not isinstance(group, dict):
                self.error("must be an object {...}", source.locate(path), f"ports.{key}")
                continue
            for name, written in group.items():
                texts = written if isinstance(written, list) and key == "inputs" else [written]
                ends: list[Endpoint] = []
                for text in texts:
                    end = self.end(text, scope, source.place((*path, name)), f"ports.{name}")
                    if end is not None:
                        ends += self.resolve(end, key == "inputs", source.place((*path, name)))
                    self.limit(len(ends), MAX_BLOCKS, "ends of one port")
                if key == "inputs":
                    result.inputs[name] = ends
                elif ends:
                    result.outputs[name] = ends[0]
        return result

    def end(self, text: Any, scope: Scope, place: Place, subject: str) -> Endpoint | None:
        found = endpoint(text, scope.prefix)
        if found is not None and "/" not in found.block[len(scope.prefix) :]:
            return found
        shown = f"'{text}'" if isinstance(text, str) else "this"
        hint = "write 'block.port', or 'block.port[i]' counted from 1"
        if found is not None:
            hint = "inside a sub-diagram only its ports can be wired"
        self.error(f"{shown} is not a port", place, subject, hint)
        return None

    def resolve(self, end: Endpoint, is_input: bool, place: Place) -> list[Endpoint]:
        """Return what an end means when its block is a sub-diagram, else the end itself."""
        ports = self.flat.sub_ports.get(end.block)
        if ports is None:
            return [end]
        known: Mapping[str, Any] = ports.inputs if is_input else ports.outputs
        if end.port not in known:
            other: Mapping[str, Any] = ports.outputs if is_input else ports.inputs
            kind = "input" if is_input else "output"
            hint = near_miss(end.port, known) if known else 'the sub-diagram declares none in "ports"'
            if end.port in other:
                hint = f"it is an {'output' if is_input else 'input'}: the wire runs backwards?"
            self.error(f"sub-diagram has no {kind} '{end.port}'", place, str(end), hint)
            return []
        inside: list[Endpoint] = known[end.port] if is_input else [known[end.port]]
        return [Endpoint(e.block, e.port, e.index + end.index) for e in inside]

    def wires(self, wires: Iterable[Any], scope: Scope) -> None:
        source = scope.source
        add = self.flat.wires.append
        for k, pair in enumerate(wires):
            place = source.place(("wires", k))
            if not isinstance(pair, list) or len(pair) != 2:
                hint = '["block.output", "block.input"]'
                self.error("a wire is a list of two ports", place, f"wires[{k + 1}]", hint)
                continue
            ends = [
                self.end(text, scope, source.place(("wires", k, i)), f"wires[{k + 1}]") for i, text in enumerate(pair)
            ]
            if ends[0] is None or ends[1] is None:
                continue
            if not self.flat.sub_ports:
                add(RawWire(ends[0], ends[1], place))
                continue
            for start in self.resolve(ends[0], False, place):
                for stop in self.resolve(ends[1], True, place):
                    add(RawWire(start, stop, place))
            self.limit(len(self.flat.wires), 5 * MAX_BLOCKS, "wires")

    def record(self, names: list[Any], source: Source) -> list[tuple[Endpoint, Place]]:
        result: list[tuple[Endpoint, Place]] = []
        for k, text in enumerate(names):
            place = source.place(("record", k))
            end = endpoint(text)
            if end is None:
                self.error(f"'{text}' is not a signal", place, "record", "write 'block.port'")
                continue
            result += [(inner, place) for inner in self.resolve(end, False, place)]
        return result
