"""The flat form of a diagram document: what its JSON says, with sub-diagrams inlined.

See `parse.flatten` for how it is made, and `parse.form` for what is checked on the way.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rotorsim.diagram.diagram import Endpoint, SubPorts
from rotorsim.diagram.parse.source import JsonPath, Source
from rotorsim.errors import Place, Problems

NAME_PATTERN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NUMBER_BEHIND = re.compile(r"\d+$")
_END = re.compile(
    r"([A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*)\.([A-Za-z_][A-Za-z0-9_]*)(?:\[\s*([0-9]{1,9}(?:\s*,\s*[0-9]{1,9})*)\s*\])?"
)


@dataclass
class Parameter:
    """A diagram parameter: its JSON value, where it is, and the block parameters that follow it."""

    name: str
    value: Any
    place: Place
    users: list[str] = field(default_factory=list)
    used: bool = False


@dataclass
class Scope:
    """The parameters that ``$name`` can mean inside one document, with the document's place of blocks."""

    prefix: str
    source: Source
    parameters: dict[str, Parameter]

    def referred(self, value: Any) -> Parameter | None:
        """Return the parameter that ``"$name"`` means here, None for any other value."""
        return self.parameters.get(value[1:]) if isinstance(value, str) and value.startswith("$") else None


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
    """A wire between flat ends, and where it is written."""

    source: Endpoint
    target: Endpoint
    place: Place

    def end_place(self, k: int) -> Place:
        """Return where the source (0) or the target (1) is written."""
        return self.place.part(k)


@dataclass
class FlatDocument:
    """What `flatten_document` found; ``problems`` has errors and warnings.

    broken: blocks of a wrong form, and sub-diagrams that could not be read. exposed: inputs that the ``ports``
    of the outermost diagram name. port_ends: every end that ``ports`` name, and whether it is an input.
    sub_ports: of every sub-diagram, by its flat name.
    """

    source: Source
    data: Mapping[str, Any]
    name: str
    parameters: dict[str, Parameter]
    blocks: dict[str, RawBlock] = field(default_factory=dict)
    wires: list[RawWire] = field(default_factory=list)
    record: list[tuple[Endpoint, Place]] | None = None
    exposed: dict[tuple[str, str], Place] = field(default_factory=dict)
    port_ends: list[tuple[Endpoint, bool, Place]] = field(default_factory=list)
    sub_diagrams: set[str] = field(default_factory=set)
    broken: set[str] = field(default_factory=set)
    sub_ports: dict[str, SubPorts] = field(default_factory=dict)
    problems: Problems = field(default_factory=Problems)


def endpoint(text: Any, prefix: str = "") -> Endpoint | None:
    """Return the wire end that ``"block.port[i,j]"`` means (counted from 0), or None if it is malformed."""
    match = _END.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        return None
    block, port, inside = match.groups()
    index = tuple(int(part) - 1 for part in inside.split(",")) if inside else ()
    return None if -1 in index else Endpoint(prefix + block, port, index)


def free_name(wanted: str, taken: Iterable[str]) -> str:
    """Return a name that is not taken: the one wanted, else it with the next number behind it."""
    names, stem = set(taken), _NUMBER_BEHIND.sub("", wanted)
    return next(name for name in (wanted, *(f"{stem}{k}" for k in range(2, len(names) + 3))) if name not in names)
