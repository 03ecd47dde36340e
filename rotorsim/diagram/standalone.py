"""The document of a diagram that needs nothing beside it: removed blocks, settings and sub-diagrams are in place."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.grouping import Document, dissolve, listed
from rotorsim.diagram.parse.document import free_name
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.settings import SET
from rotorsim.errors import Problem, RotorsimError

NAMES_TOLD = 8  # names in a message


@dataclass(frozen=True)
class Standalone:
    """A document, and what blocks and parameters of the diagram are called in it.

    changed: whether it is another than that of the diagram.
    """

    document: Document
    blocks: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, str] = field(default_factory=dict)
    changed: bool = False

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
    changed = bool(settings) or any(_lacks(diagram, document, part) for part in ("", *_parts(document)))
    found = Standalone(document, {name: name for name in diagram.nodes}, {name: name for name in diagram.parameters})
    reached = None if within is None else [*within, *settings]
    while True:
        settings = _put(found.document, settings)
        part = _next(found, diagram, reached)
        if part is None:
            break
        changed = True
        found, outside = _dissolved(found, part, _inner(diagram, found.document, part))
        settings = {outside(name): value for name, value in settings.items()}
    return replace(found, document=_without_removed(found), changed=changed)


def _flat_name(diagram: Diagram, name: str) -> str:
    """Return the flat name of what was set: a sub-diagram's parameter may be set as if that was a block."""
    block, _, key = name.rpartition(".")
    return name if block in diagram.nodes else f"{block}/{key}"


def _put(document: Document, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Put what was set of blocks and sub-diagrams of a document in it; return what was set inside of these."""
    inside = {}
    for name, value in settings.items():
        block, _, key = name.rpartition("." if "." in name else "/")
        if block in document["blocks"]:
            document["blocks"][block].setdefault("parameters", {})[key] = value
        else:
            inside[name] = value
    return inside


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
    there = {*found.blocks.values()}
    return next((part for part in parts if _lacks(diagram, found.document, part, there)), None)


def _lacks(diagram: Diagram, document: Document, part: str, there: Collection[str] | None = None) -> bool:
    """Return whether a block was removed inside of a sub-diagram, of the whole without a name, but not all of it."""
    there = diagram.nodes if there is None else there
    if not part:
        return any(not _is_there(name, there) for name in document["blocks"])
    return _is_there(part, there) and _lacks_inside(diagram, document["blocks"][part], part, there)


def _lacks_inside(diagram: Diagram, entry: Mapping[str, Any], part: str, there: Collection[str]) -> bool:
    inner, folder = _read(diagram, entry, part), PurePosixPath(entry["file"]).parent
    for name, block in inner["blocks"].items():
        flat = f"{part}/{name}"
        if not _is_there(flat, there):
            return True
        if block.get("type") == "diagram" and _lacks_inside(
            diagram, {**block, "file": str(folder / block["file"])}, flat, there
        ):
            return True
    return False


def _is_there(name: str, there: Collection[str]) -> bool:
    return name in there or any(one.startswith(f"{name}/") for one in there)


def _inner(diagram: Diagram, document: Document, part: str) -> Document:
    """Return the document of a sub-diagram's file. Raises RotorsimError where it is not known."""
    return _read(diagram, document["blocks"][part], part)


def _read(diagram: Diagram, entry: Mapping[str, Any], part: str) -> Document:
    if diagram.folder is None:
        what = "is inside of a sub-diagram, whose file is not known"
        raise RotorsimError(Problem(what, part, hint="load the diagram from its file"))
    inner: Document = read_document(Path(diagram.folder) / entry["file"]).data
    return inner


def _dissolved(found: Standalone, part: str, inner: Document) -> tuple[Standalone, Callable[[str], str]]:
    """Return a document with the blocks of a sub-diagram in its place; its parameters are those of the diagram.

    With what gives names inside of it as they are then.
    """
    document, lifted = _lifted(found.document, part, inner)
    document, moved = dissolve(document, part, inner)

    def outside(name: str) -> str:
        owner, _, rest = name.partition("/")
        first = re.split(r"[./]", rest, maxsplit=1)[0]
        return moved.get(first, first) + rest[len(first) :] if owner == part and rest else name

    def parameter(name: str) -> str:
        return lifted.get(name) or (outside(name) if name.count("/") > 1 else name)

    blocks = {name: outside(here) for name, here in found.blocks.items()}
    parameters = {name: parameter(here) for name, here in found.parameters.items()}
    return Standalone(document, blocks, parameters), outside


def _lifted(document: Document, part: str, inner: Document) -> tuple[Document, dict[str, str]]:
    """Return a document with parameters that those of a sub-diagram follow, and their names by those inside."""
    entry, outer = document["blocks"][part], document.get("parameters", {})
    followed = _followed(inner.get("blocks", {}))
    names: dict[str, str] = {}
    given, added = dict(entry.get("parameters", {})), dict(outer)
    for key, value in inner.get("parameters", {}).items():
        own: Any = given.get(key, value)
        if key in followed and not (isinstance(own, str) and own.startswith("$") and key in given):
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


def _followed(blocks: Mapping[str, Any]) -> set[str]:
    """Return the names of the parameters that those of blocks follow."""
    values = (value for block in blocks.values() for value in block.get("parameters", {}).values())
    return {value[1:] for value in values if isinstance(value, str) and value.startswith("$")}


def _without_removed(found: Standalone) -> Document:
    """Return the document without blocks that are not in the diagram, and what it says of them.

    Parameters that nothing follows any more stay, but are not free: runs of a recording may set them.
    """
    document, there = found.document, {*found.blocks.values()}
    removed = {name for name in document["blocks"] if not _is_there(name, there)}
    if not removed:
        return document

    def touches(end: Any) -> bool:
        block, dot, _ = str(end).partition(".")
        return bool(dot) and block.partition("/")[0] in removed

    def idle(name: str) -> bool:
        return name.partition("[")[0] in document.get("parameters", {}).keys() - followed

    blocks = {name: block for name, block in document["blocks"].items() if name not in removed}
    followed = _followed(blocks)
    kept = {**document, "blocks": blocks}
    kept["wires"] = [wire for wire in document.get("wires", []) if not any(map(touches, wire))]
    if "record" in document:
        kept["record"] = [name for name in document["record"] if not touches(name)]
    if "layout" in document:
        kept["layout"] = {name: at for name, at in document["layout"].items() if name not in removed}
    if "identify" in document:
        kept["identify"] = {n: v for n, v in document["identify"].items() if not touches(n) and not idle(n)}
    if "measured" in document:
        kept["measured"] = {n: v for n, v in document["measured"].items() if not touches(n) and not touches(v)}
    for side, ports in document.get("ports", {}).items():
        ends = {name: [end for end in listed(written) if not touches(end)] for name, written in ports.items()}
        left = {name: own[0] if len(own) == 1 else own for name, own in ends.items() if own}
        kept["ports"] = {**kept["ports"], side: left}
    return kept
