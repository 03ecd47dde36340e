"""The document of a diagram that needs nothing beside it: removed blocks, settings and sub-diagrams are in place."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.grouping import Document, dissolve, listed, names_followed
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
    removed or set (default: all); their files stay as they are. Their parameters are parameters of the diagram then,
    unless they follow such.
    Raises RotorsimError where the file of one is not known.
    """
    document = copy.deepcopy(dict(diagram.document))
    settings = {_flat_name(diagram, name): value for name, value in document.pop(SET, {}).items()}
    blocks = {name: name for name in (*diagram.nodes, *diagram.removed)}
    found = Standalone(document, blocks, {name: name for name in diagram.parameters})
    changed = bool(settings or diagram.removed)
    left = {name.partition("/")[0] for name in diagram.nodes}
    inside = [name for name in diagram.removed if name.partition("/")[0] in left]
    ends = [str(end) for wire in document.get("wires", []) for end in wire]  # that were added to what is flat
    reached = None if within is None else [*within, *settings, *inside, *ends]
    while True:
        settings = _put(found.document, settings)
        part = _next(found, reached)
        if part is None:
            break
        changed = True
        found, outside = _dissolved(found, part, _inner(diagram, found.document, part))
        settings = {outside(name): value for name, value in settings.items()}
    document = _without_removed(found.document, *_named(found.blocks, diagram))
    blocks = {name: here for name, here in found.blocks.items() if name in diagram.nodes}
    return replace(found, document=document, blocks=blocks, changed=changed)


def _named(blocks: Mapping[str, str], diagram: Diagram) -> tuple[list[str], list[str]]:
    """Return what blocks that are there are called, and those that were removed."""
    return [blocks[name] for name in diagram.nodes], [blocks[name] for name in diagram.removed]


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


def _next(found: Standalone, within: list[str] | None) -> str | None:
    """Return a sub-diagram that is to be dissolved, None where none is left."""
    parts = _parts(found.document)
    if within is None:
        return next(iter(parts), None)
    for name in within:
        block = found.blocks.get(name)
        part, slash, rest = (block or found.named(name)).partition("/")
        if slash and part in parts and (block or "." in rest or "/" in rest):
            return part
    return None


def _inner(diagram: Diagram, document: Document, part: str) -> Document:
    """Return the document of a sub-diagram's file. Raises RotorsimError where it is not known."""
    if diagram.folder is None:
        what = "is inside of a sub-diagram, whose file is not known"
        raise RotorsimError(Problem(what, part, hint="load the diagram from its file"))
    inner: Document = read_document(Path(diagram.folder) / document["blocks"][part]["file"]).data
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

    document["wires"] = [[outside(str(end)) for end in wire] for wire in document["wires"]]
    blocks = {name: outside(here) for name, here in found.blocks.items()}
    parameters = {name: parameter(here) for name, here in found.parameters.items()}
    return Standalone(document, blocks, parameters), outside


def _lifted(document: Document, part: str, inner: Document) -> tuple[Document, dict[str, str]]:
    """Return a document with the parameters of a sub-diagram among its own, and their names by those inside.

    Not of those that follow one outside.
    """
    entry, outer = document["blocks"][part], document.get("parameters", {})
    names: dict[str, str] = {}
    given, added = dict(entry.get("parameters", {})), dict(outer)
    for key, value in inner.get("parameters", {}).items():
        own: Any = given.get(key, value)
        if not (isinstance(own, str) and own.startswith("$") and key in given):
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


def _without_removed(document: Document, there: Collection[str], gone: Collection[str]) -> Document:
    """Return a document without blocks that are gone, and what it says of them; there: those that are not.

    Parameters that nothing follows any more stay, but are not free: runs of a recording may set them.
    """

    def holds(name: str, blocks: Collection[str]) -> bool:
        return any(one == name or one.startswith(f"{name}/") for one in blocks)

    removed = {name for name in document["blocks"] if holds(name, gone) and not holds(name, there)}
    if not removed:
        return document

    def touches(end: Any) -> bool:
        owner, inside, _ = re.split(r"([./])", f"{end}.", maxsplit=1)
        return owner in removed and (inside == "/" or "." in str(end))

    def idle(name: str) -> bool:
        return name.partition("[")[0] in document.get("parameters", {}).keys() - followed

    blocks = {name: block for name, block in document["blocks"].items() if name not in removed}
    followed = {*names_followed(blocks)}
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
