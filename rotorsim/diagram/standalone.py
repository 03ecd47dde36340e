"""The document of a diagram that needs nothing beside it: removed blocks, settings and sub-diagrams are in place."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.grouping import Document, dissolve
from rotorsim.diagram.parse.document import free_name
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.settings import SET
from rotorsim.errors import Problem, RotorsimError

NAMES_TOLD = 8  # names in a message


@dataclass(frozen=True)
class Standalone:
    """A document, and what blocks and parameters of the diagram are called in it."""

    document: Document
    blocks: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, str] = field(default_factory=dict)

    def block(self, name: str) -> str:
        """Return what a block of the diagram is called here."""
        return self.blocks.get(name, name)

    def named(self, name: str) -> str:
        """Return what a parameter or signal of the diagram ("part/rotor.mass", "part/k", "amb.force[2]") is here."""
        base, bracket, inside = name.partition("[")
        block, dot, rest = base.partition(".")
        found = self.block(block) + dot + rest if dot else self.parameters.get(base, base)
        return found + bracket + inside

    @property
    def notes(self) -> list[Problem]:
        """Warnings of blocks and parameters that have another name here."""
        new = [f"{a} is {b}" for own in (self.blocks, self.parameters) for a, b in own.items() if a != b]
        what = f"its sub-diagrams are dissolved: {', '.join(new[:NAMES_TOLD])}"
        more = f", and {len(new) - NAMES_TOLD} more" if len(new) > NAMES_TOLD else ""
        return [Problem(what + more, self.document.get("name", "diagram"), severity="warning")] if new else []


def standalone(diagram: Diagram, within: Iterable[str] | None = None) -> Standalone:
    """Return a document of a diagram that loads as it is: removed blocks are left out, what was set is in it.

    Sub-diagrams in which one of the blocks or parameters ``within`` is are dissolved, and those in which a block was
    removed or set (default: all); their files stay as they are. Their parameters that blocks follow are parameters of
    the diagram then.
    Raises RotorsimError where the file of one is not known.
    """
    document = copy.deepcopy(dict(diagram.document))
    settings = {_flat_name(diagram, name): value for name, value in document.pop(SET, {}).items()}
    found = Standalone(document, {name: name for name in diagram.nodes}, {name: name for name in diagram.parameters})
    reached = None if within is None else [*within, *settings]
    while (part := _next(found, diagram, reached)) is not None:
        found = _dissolved(found, part, _inner(diagram, found.document, part))
    document = _without_removed(found)
    for name, value in settings.items():
        key = found.named(name)
        block, dot, parameter = key.rpartition(".")
        if dot:
            document["blocks"][block].setdefault("parameters", {})[parameter] = value
        elif "/" in key:
            part, _, parameter = key.partition("/")
            document["blocks"][part].setdefault("parameters", {})[parameter] = value
        else:
            document["parameters"][key] = value
    return Standalone(document, found.blocks, found.parameters)


def _flat_name(diagram: Diagram, name: str) -> str:
    """Return the flat name of what was set: a sub-diagram's parameter may be set as if that was a block."""
    block, _, key = name.rpartition(".")
    return name if block in diagram.nodes else f"{block}/{key}"


def _parts(document: Document) -> list[str]:
    """Return the sub-diagrams of a document."""
    return [name for name, block in document["blocks"].items() if block.get("type") == "diagram"]


def _next(found: Standalone, diagram: Diagram, within: list[str] | None) -> str | None:
    """Return a sub-diagram that is to be dissolved, None where none is left."""
    parts = _parts(found.document)
    if within is None:
        return next(iter(parts), None)
    for name in map(found.named, within):
        part, slash, rest = name.partition("/")
        if slash and part in parts and ("." in rest or "/" in rest):
            return part
    return next((part for part in parts if _lacks(found, diagram, part)), None)


def _lacks(found: Standalone, diagram: Diagram, part: str) -> bool:
    """Return whether a block was removed inside of a sub-diagram."""
    there = {*found.blocks.values()}
    if not any(name.startswith(f"{part}/") for name in there):
        return False  # as a whole
    inner = _inner(diagram, found.document, part)["blocks"]
    return any(
        f"{part}/{name}" not in there and not any(one.startswith(f"{part}/{name}/") for one in there) for name in inner
    )


def _inner(diagram: Diagram, document: Document, part: str) -> Document:
    """Return the document of a sub-diagram's file. Raises RotorsimError where it is not known."""
    if diagram.folder is None:
        what = "is inside of a sub-diagram, whose file is not known"
        raise RotorsimError(Problem(what, part, hint="load the diagram from its file"))
    inner: Document = read_document(Path(diagram.folder) / document["blocks"][part]["file"]).data
    return inner


def _dissolved(found: Standalone, part: str, inner: Document) -> Standalone:
    """Return a document with the blocks of a sub-diagram in its place; its parameters are those of the diagram."""
    document, lifted = _lifted(found.document, part, inner)
    document, moved = dissolve(document, part, inner)

    def outside(name: str) -> str:
        owner, _, rest = name.partition("/")
        first, slash, more = rest.partition("/")
        return moved.get(first, first) + slash + more if owner == part and rest else name

    def parameter(name: str) -> str:
        return lifted.get(name) or (outside(name) if name.count("/") > 1 else name)

    blocks = {name: outside(here) for name, here in found.blocks.items()}
    return Standalone(document, blocks, {name: parameter(here) for name, here in found.parameters.items()})


def _lifted(document: Document, part: str, inner: Document) -> tuple[Document, dict[str, str]]:
    """Return a document with parameters that those of a sub-diagram follow, and their names by those inside."""
    entry, outer = document["blocks"][part], document.get("parameters", {})
    followed = {
        value for block in inner.get("blocks", {}).values() for value in block.get("parameters", {}).values()
        if isinstance(value, str)
    }  # fmt: skip
    names: dict[str, str] = {}
    given, added = dict(entry.get("parameters", {})), dict(outer)
    for key, value in inner.get("parameters", {}).items():
        own: Any = given.get(key, value)
        if f"${key}" in followed and not (isinstance(own, str) and own.startswith("$") and key in given):
            names[f"{part}/{key}"] = new = free_name(key if key not in added else f"{part}_{key}", added)
            added[new], given[key] = own, f"${new}"
    blocks = {**document["blocks"], part: {**entry, "parameters": given}}
    free = {
        names.get(base, base) + bracket + rest: held
        for name, held in document.get("identify", {}).items()
        for base, bracket, rest in [name.partition("[")]
    }
    changed = {**document, "blocks": blocks, **({"parameters": added} if added else {})}
    return changed | ({"identify": free} if free else {}), names


def _without_removed(found: Standalone) -> Document:
    """Return the document without blocks that are not in the diagram, and what belongs to them alone."""
    document, there = found.document, {*found.blocks.values()}
    owners = {name.partition("/")[0] for name in there}
    removed = {name for name in document["blocks"] if name not in owners}
    if not removed:
        return document

    def touches(end: Any) -> bool:
        return str(end).partition(".")[0].partition("/")[0] in removed

    blocks = {name: block for name, block in document["blocks"].items() if name not in removed}
    texts = (value for block in blocks.values() for value in block.get("parameters", {}).values())
    followed = {value[1:] for value in texts if isinstance(value, str) and value.startswith("$")}
    idle = {name for name in document.get("parameters", {}) if name not in followed}
    document = {**document, "blocks": blocks}
    document["wires"] = [wire for wire in document.get("wires", []) if not any(touches(end) for end in wire)]
    if "record" in document:
        document["record"] = [name for name in document["record"] if not touches(name)]
    if "parameters" in document:
        document["parameters"] = {n: v for n, v in document["parameters"].items() if n not in idle}
    for key in ("identify", "layout"):
        if key in document:
            document[key] = {n: v for n, v in document[key].items() if not touches(n) and n not in idle}
    return document
