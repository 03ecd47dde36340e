"""One flat list of blocks and wires from a diagram document and its sub-diagrams.

A sub-diagram ``sub`` with a block ``gain`` gives the block ``sub/gain``; wires to its ports become wires to what
these stand for. Its files are read only from the folder of the outermost diagram.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Endpoint, SubPorts
from rotorsim.diagram.parse.document import NAME_PATTERN, FlatDocument, Parameter, RawBlock, RawWire, Scope, endpoint
from rotorsim.diagram.parse.form import checked_form, is_block
from rotorsim.diagram.parse.source import Source, read_document
from rotorsim.errors import Place, Problem, RotorsimError, near_miss

MAX_SUB_DEPTH = 8
MAX_BLOCKS = 200_000
MAX_WIRES = 1_000_000


def flatten_document(
    source: Source,
    folder: Path | None,
    parameter_overrides: Mapping[str, Any],
    block_overrides: Mapping[str, Mapping[str, Any]],
) -> FlatDocument:
    """Return the flat form of a document, with every mistake of form in its ``problems``.

    parameter_overrides: diagram parameter -> value; block_overrides: flat block name -> parameter -> value.
    Raises RotorsimError at once only where sub-diagrams multiply beyond all bounds.
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
        self.flat, self.overrides = flat, overrides
        self.folder = folder.resolve() if folder is not None else None
        self.problems = flat.problems
        self.files: dict[Path, Source] = {}

    def top(self, source: Source, overrides: Mapping[str, Any]) -> None:
        data = checked_form(source, self.problems)
        scope = Scope("", source, {})
        for name, value in data["parameters"].items():
            place = Place("--set") if name in overrides else source.place(("parameters", name))
            scope.parameters[name] = Parameter(name, overrides.get(name, value), place)
        self.flat.parameters.update(scope.parameters)
        self.document(data, scope, self.folder, ())
        if "record" in data:
            self.flat.record = self.record(data["record"], source)
        for name, ends in self.ports(data, scope).inputs.items():
            for end in ends:
                self.flat.exposed[end.block, end.port] = source.place(("ports", "inputs", name), key=True)

    def limit(self, count: int, most: int, what: str) -> None:
        if count > most:  # sub-diagrams of sub-diagrams multiply: stop at once
            raise RotorsimError(
                Problem(
                    f"more than {most} {what}",
                    place=Place(self.flat.source.file),
                    hint="sub-diagrams that hold many of one another multiply",
                )
            )

    def document(self, data: dict[str, Any], scope: Scope, folder: Path | None, chain: tuple[Path, ...]) -> None:
        source, prefix = scope.source, scope.prefix
        for name, block in data["blocks"].items():
            if not NAME_PATTERN.fullmatch(str(name)):
                continue
            flat_name = prefix + name
            if not is_block(source, name, block, self.problems):
                self.flat.broken.add(flat_name)
                continue
            parameters = block.get("parameters", {})
            for value in parameters.values():  # also what --set or --without puts aside counts as used
                parameter = scope.referred(value)
                if parameter is not None:
                    parameter.used = True
            own = dict(self.overrides.get(flat_name, {}))
            parameters = {**parameters, **own}
            raw = RawBlock(flat_name, block["type"], parameters, scope, ("blocks", name), block.get("file"), own)
            if block["type"] == "diagram":
                self.flat.sub_diagrams.add(flat_name)
                try:
                    path = self.sub_path(raw, folder, chain)
                    sub = self.files.get(path) or self.read(path, raw)
                except RotorsimError as error:
                    self.problems += error.problems
                    self.flat.broken.add(flat_name)
                else:
                    self.flat.sub_ports[flat_name] = self.sub_diagram(raw, sub, (*chain, path))
            else:
                self.flat.blocks[flat_name] = raw
            self.limit(len(self.flat.blocks) + len(self.flat.sub_diagrams), MAX_BLOCKS, "blocks")
        self.wires(data["wires"], scope)

    # --- sub-diagrams -------------------------------------------------------------------------------

    def sub_diagram(self, raw: RawBlock, source: Source, chain: tuple[Path, ...]) -> SubPorts:
        """Add the blocks and wires of a sub-diagram; return its ports. chain: of files, down to its own."""
        data = checked_form(source, self.problems)
        inner, follows = Scope(raw.name + "/", source, {}), {}
        for name, value in data["parameters"].items():
            given = raw.parameters.get(name, value)
            outer = raw.scope.referred(given) if name in raw.parameters else None
            if outer is None:
                place = raw.place_of(name) if name in raw.parameters else source.place(("parameters", name))
                outer = Parameter(inner.prefix + name, given, place)
                self.flat.parameters[outer.name] = outer
            else:
                follows[name] = ".".join(filter(None, (raw.scope.prefix.removesuffix("/"), given.removeprefix("$"))))
            inner.parameters[name] = outer
        for name in raw.parameters:
            if name not in data["parameters"]:
                self.problems.error(
                    f"sub-diagram has no parameter '{name}'",
                    f"{raw.name}.{name}",
                    raw.place_of(name, key=True),
                    near_miss(name, data["parameters"]) or "it declares no parameters",
                )
        self.document(data, inner, chain[-1].parent, chain)
        ports = self.ports(data, inner)
        ports.follows = follows
        return ports

    def read(self, path: Path, raw: RawBlock) -> Source:
        assert self.folder is not None
        shown = str(Path(self.flat.source.file).parent / path.relative_to(self.folder))
        hint = "the path is relative to the folder of the diagram that names it"
        try:
            source = read_document(path)
        except RotorsimError as error:
            place = raw.place("file")
            raise RotorsimError(
                *[
                    replace(p, place=replace(p.place, file=shown))
                    if p.place.line
                    else Problem(f"{shown}: {p.what}", raw.name, place, p.hint or hint)
                    for p in error.problems
                ]
            ) from None
        source.file = shown
        if not isinstance(source.data, dict):
            raise RotorsimError(Problem("a diagram is a JSON object {...}", raw.name, source.locate()))
        self.files[path] = source
        return source

    def sub_path(self, raw: RawBlock, folder: Path | None, chain: tuple[Path, ...]) -> Path:
        def refuse(what: str, hint: str) -> RotorsimError:
            return RotorsimError(Problem(what, raw.name, raw.place(*(() if raw.file is None else ("file",))), hint))

        if raw.file is None:
            raise refuse("key 'file' is missing", 'a sub-diagram is {"type": "diagram", "file": "sub.json"}')
        if folder is None or self.folder is None:
            raise refuse("a document in memory has no folder to read from", "pass folder=")
        outside = refuse(
            f"file '{raw.file}' is not inside the folder of the diagram",
            "name a file below that folder, such as 'parts/sub.json'",
        )
        if raw.file.startswith("/") or ".." in raw.file.split("/") or any(c in raw.file for c in "\\:\0"):
            raise outside
        try:
            path = (folder / raw.file).resolve()
        except (OSError, RuntimeError, ValueError) as error:
            raise refuse(f"file '{raw.file}' cannot be found: {error}", "") from None
        if not path.is_relative_to(self.folder):  # a symbolic link may lead out
            raise outside
        top = self.flat.source.path
        circle = [*([top.resolve()] if top is not None else []), *chain]
        if path in circle:
            files = [p.name for p in (*circle[circle.index(path) :], path)]
            raise refuse(f"sub-diagram contains itself: {' -> '.join(files)}", "remove one of these sub-diagrams")
        if len(chain) >= MAX_SUB_DEPTH:
            raise refuse(f"sub-diagrams are nested deeper than {MAX_SUB_DEPTH}", "make the nesting flatter")
        return path

    # --- ports and wires ----------------------------------------------------------------------------

    def ports(self, data: dict[str, Any], scope: Scope) -> SubPorts:
        result, source = SubPorts(), scope.source
        for key, group in data["ports"].items():
            if key not in ("inputs", "outputs"):
                self.problems.error(
                    f"unknown key '{key}'",
                    "ports",
                    source.locate(("ports", key), key=True),
                    near_miss(str(key), ("inputs", "outputs")),
                )
            elif not isinstance(group, dict):
                self.problems.error("must be an object {...}", f"ports.{key}", source.locate(("ports", key)))
            else:
                for name, written in group.items():
                    self.port(result, key == "inputs", name, written, scope)
        return result

    def port(self, ports: SubPorts, is_input: bool, name: str, written: Any, scope: Scope) -> None:
        place = scope.source.place(("ports", "inputs" if is_input else "outputs", name))
        subject = f"ports.{name}"
        if not NAME_PATTERN.fullmatch(str(name)):
            self.problems.error(f"'{name}' is not a name", subject, place, "letters, digits and _, not a digit first")
        ends: list[Endpoint] = []
        for text in written if isinstance(written, list) and is_input else [written]:
            end = self.end(text, scope, place, subject)
            if end is not None:
                ends += self.resolve(end, is_input, place)
                if end.block not in self.flat.sub_ports:
                    self.flat.port_ends.append((end, is_input, place))
            self.limit(len(ends), MAX_BLOCKS, "ends of one port")
        if is_input:
            ports.inputs[name] = ends
        elif ends:
            ports.outputs[name] = ends[0]

    def end(self, text: Any, scope: Scope, place: Place, subject: str) -> Endpoint | None:
        parsed = endpoint(text, scope.prefix)
        if parsed is not None and "/" not in parsed.block[len(scope.prefix) :]:
            return parsed
        shown = f"'{text}'" if isinstance(text, str) else "this"
        hint = "write 'block.port', or 'block.port[i]' counted from 1"
        if parsed is not None:
            hint = "inside a sub-diagram only its ports can be wired"
        self.problems.error(f"{shown} is not a port", subject, place, hint)
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
            hint = near_miss(end.port, known) if known else f'the sub-diagram declares no {kind}s in "ports"'
            if end.port in other:
                hint = f"it is an {'output' if is_input else 'input'}; wires run from an output to an input"
            self.problems.error(f"sub-diagram has no {kind} '{end.port}'", str(end), place, hint)
            return []
        inside: list[Endpoint] = known[end.port] if is_input else [known[end.port]]
        return [Endpoint(e.block, e.port, e.index + end.index) for e in inside] if end.index else inside

    def wires(self, wires: Iterable[Any], scope: Scope) -> None:
        source = scope.source
        add = self.flat.wires.append
        for k, pair in enumerate(wires):
            place = source.place(("wires", k))
            if not isinstance(pair, list | tuple) or len(pair) != 2:
                self.problems.error(
                    "a wire is a list of two ports", f"wires[{k + 1}]", place, 'write ["block.output", "block.input"]'
                )
                continue
            first, last = endpoint(pair[0], scope.prefix), endpoint(pair[1], scope.prefix)
            if first is None or last is None or "/" in pair[0] or "/" in pair[1]:
                for i, text in enumerate(pair):
                    self.end(text, scope, source.place(("wires", k, i)), f"wires[{k + 1}]")
            elif not self.flat.sub_ports:
                add(RawWire(first, last, place))
            else:
                stops = self.resolve(last, True, source.place(("wires", k, 1)))
                for start in self.resolve(first, False, source.place(("wires", k, 0))):
                    self.flat.wires += [RawWire(start, stop, place) for stop in stops]
                self.limit(len(self.flat.wires), MAX_WIRES, "wires")

    def record(self, names: list[Any], source: Source) -> list[tuple[Endpoint, Place]]:
        result: list[tuple[Endpoint, Place]] = []
        for k, text in enumerate(names):
            place = source.place(("record", k))
            end = endpoint(text)
            if end is None:
                shown = f"'{text}'" if isinstance(text, str) else "this"
                self.problems.error(f"{shown} is not a signal", "record", place, "write 'block.port'")
                continue
            result += [(inner, place) for inner in self.resolve(end, False, place)]
        return result
