"""The form of a diagram document: known keys, kinds of values, names. What blocks allow is checked later."""

from __future__ import annotations

from typing import Any

from rotorsim.diagram.parse.document import NAME_PATTERN
from rotorsim.diagram.parse.source import JsonPath, Source
from rotorsim.errors import CONTROL, Problems, near_miss

RESERVED = ("solver",)
DOCUMENT_KEYS: dict[str, type] = {  # in the order of the canonical form
    "$schema": str,
    "schema_version": int,
    "name": str,
    "description": str,
    "parameters": dict,
    "blocks": dict,
    "wires": list,
    "solver": dict,
    "record": list,
    "measured": dict,
    "algebraic_loops": str,
    "block_folders": list,
    "ports": dict,
    "identify": dict,
    "layout": dict,
}
BLOCK_KEYS: dict[str, type] = {"type": str, "file": str, "description": str, "parameters": dict}
MAX_HINTS = 1000  # a near miss takes a look at every known word
_WORDS = {str: "a text", int: "a whole number", dict: "an object {...}", list: "a list [...]"}
_NAMES = "names are letters, digits and _, and do not start with a digit"


class _Form:
    def __init__(self, source: Source, problems: Problems) -> None:
        self.source, self.problems = source, problems

    def error(self, what: str, path: JsonPath, subject: str = "", hint: str = "", *, key: bool = False) -> None:
        self.problems.error(what, subject, self.source.locate(path, key=key), hint)

    def document(self) -> dict[str, Any]:
        data: dict[str, Any] = {}
        unknown = 0
        for key, value in self.source.data.items():
            if key not in DOCUMENT_KEYS:
                unknown += 1
                self.error(
                    f"unknown key '{key}'",
                    (key,),
                    hint=near_miss(str(key), DOCUMENT_KEYS) if unknown <= MAX_HINTS else "see docs/diagrams.md",
                    key=True,
                )
            elif not isinstance(value, DOCUMENT_KEYS[key]) or isinstance(value, bool):
                self.error(f"must be {_WORDS[DOCUMENT_KEYS[key]]}", (key,), key)
            else:
                data[key] = value
        for key in ("name", "description"):
            if CONTROL.search(data.get(key, "")):  # of a document in memory: `parse_document` refuses them in a file
                self.error("holds a control character", (key,), key, "remove it")
        if "blocks" not in self.source.data:
            self.error("key 'blocks' is missing", (), hint='"blocks": {"name": {"type": "..."}}')
        version = data.get("schema_version", 1)
        if version != 1:
            self.error(
                f"schema_version {version} is not known",
                ("schema_version",),
                hint="this version of rotorsim reads schema_version 1",
            )
        loops = data.get("algebraic_loops", "refuse")
        if loops not in ("refuse", "solve"):
            self.error(f"algebraic_loops is '{loops}'", ("algebraic_loops",), hint="it is 'refuse' or 'solve'")
        for key, empty in (("parameters", {}), ("blocks", {}), ("wires", []), ("ports", {}), ("layout", {})):
            data.setdefault(key, empty)
        for key in ("parameters", "blocks"):
            for name in [name for name in data[key] if not NAME_PATTERN.fullmatch(str(name))]:
                self.error(f"'{name}' is not a name", (key, name), key, _NAMES, key=True)
        for name in RESERVED:
            if name in data["blocks"]:
                self.error(
                    f"'{name}' is reserved",
                    ("blocks", name),
                    name,
                    f"'{name}' would not be told from the settings in --set {name}.step=...",
                    key=True,
                )

        self.layout(data)
        return data

    def layout(self, data: dict[str, Any]) -> None:
        for name, at in data["layout"].items():
            subject = f"layout.{name}"
            if name not in data["blocks"]:
                place = self.source.locate(("layout", name), key=True)
                self.problems.warning(f"no block '{name}'", subject, place, near_miss(str(name), data["blocks"]))
            numbers = isinstance(at, list | tuple) and all(
                isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < 1e9 for x in at
            )
            if not numbers or len(at) != 2:
                self.error("must be two numbers", ("layout", name), subject, "write [column, row]")

    def block(self, name: str, block: Any) -> bool:
        path: JsonPath = ("blocks", name)
        if not isinstance(block, dict):
            self.error('must be an object {"type": ...}', path, name, 'for example {"type": "gain"}')
            return False
        good = "type" in block
        if not good:
            self.error("key 'type' is missing", path, name, '"type": "gain"; `rotorsim blocks` lists the types')
        for key, value in block.items():
            kind = BLOCK_KEYS.get(key)
            if kind is None:
                near = near_miss(str(key), BLOCK_KEYS)
                hint = near if near.startswith("did") else 'parameters of the block go into "parameters": {...}'
                self.error(f"unknown key '{key}'", (*path, key), name, hint, key=True)
            elif not isinstance(value, kind):
                self.error(f"'{key}' must be {_WORDS[kind]}", (*path, key), name)
                good = False
        return good


def checked_form(source: Source, problems: Problems) -> dict[str, Any]:
    """Return the keys of a document that are known and of the right kind, with empty ones for what is missing.

    ``source.data`` is an object. Mistakes are added to ``problems``.
    """
    return _Form(source, problems).document()


def is_block(source: Source, name: str, block: Any, problems: Problems) -> bool:
    """Return whether a block of a document has the right form; add what is wrong to ``problems``."""
    return _Form(source, problems).block(name, block)
