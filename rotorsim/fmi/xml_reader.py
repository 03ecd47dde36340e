"""Reading foreign XML within limits: no document type (so no entities), caps on size, depth, counts and text.

Elements know line and column, so that every mistake in a model description can be placed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NoReturn
from xml.parsers import expat

from rotorsim.errors import Place, Problem, RotorsimError

__all__ = ["Element", "XmlLimits", "read_xml"]


@dataclass(frozen=True)
class XmlLimits:
    """Caps on a document: bytes, depth, elements, attributes of one element, characters of one attribute or text."""

    bytes: int = 64 << 20
    depth: int = 32
    elements: int = 1_000_000
    attributes: int = 64
    characters: int = 1_000_000


@dataclass(slots=True)
class Element:
    """An element: name, attributes, children, text of its own, and its place."""

    tag: str
    attributes: dict[str, str]
    line: int
    column: int
    children: list[Element] = field(default_factory=list)
    text: str = ""

    def all(self, *tags: str) -> Iterator[Element]:
        """Yield the children with one of these names."""
        return (child for child in self.children if child.tag in tags)

    def first(self, tag: str) -> Element | None:
        """Return the first child of this name."""
        return next(self.all(tag), None)

    def get(self, name: str, default: str = "") -> str:
        """Return an attribute."""
        return self.attributes.get(name, default)


def read_xml(data: bytes, file: str, *, skip: frozenset[str] = frozenset(), limits: XmlLimits | None = None) -> Element:
    """Return the root element; what is inside elements named in ``skip`` is checked for its form and dropped.

    Raises RotorsimError with file:line:column.
    """
    return _Reader(file, skip, limits or XmlLimits()).read(data)


class _Reader:
    def __init__(self, file: str, skip: frozenset[str], limits: XmlLimits) -> None:
        self.file, self.skip, self.limits = file, skip, limits
        self.root: Element | None = None
        self.open: list[Element] = []
        self.depth = self.count = self.hidden = self.written = 0
        self.parser = expat.ParserCreate("utf-8")
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text
        self.parser.StartDoctypeDeclHandler = self._doctype
        self.parser.EntityDeclHandler = self._doctype
        self.parser.XmlDeclHandler = self._declaration

    def read(self, data: bytes) -> Element:
        if len(data) > self.limits.bytes:
            what = f"{len(data)} bytes of XML; {self.limits.bytes} are allowed"
            raise RotorsimError(Problem(what, place=Place(self.file)))
        try:
            self.parser.Parse(data, True)
        except expat.ExpatError as error:
            what = f"not XML: {expat.ErrorString(error.code)}"
            raise RotorsimError(Problem(what, place=Place(self.file, error.lineno, error.offset + 1))) from None
        except (ValueError, LookupError) as error:
            self._refuse(f"not XML: {' '.join(str(error).split())[:100]}")
        if self.root is None:
            self._refuse("not XML: no element")
        return self.root

    def _refuse(self, what: str, hint: str = "") -> NoReturn:
        place = Place(self.file, self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber + 1)
        raise RotorsimError(Problem(what, place=place, hint=hint))

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        self.count += 1
        if self.depth > self.limits.depth:
            self._refuse(f"elements are nested deeper than {self.limits.depth}")
        if self.count > self.limits.elements:
            self._refuse(f"more than {self.limits.elements} elements")
        if len(attributes) > self.limits.attributes:
            self._refuse(f"<{tag[:80]}> has more than {self.limits.attributes} attributes")
        if any(len(value) > self.limits.characters for value in attributes.values()):
            self._refuse(f"an attribute of <{tag[:80]}> has more than {self.limits.characters} characters")
        if self.hidden:
            self.hidden += 1
            return
        if tag in self.skip:
            self.hidden = 1
            return
        element = Element(tag, attributes, self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber + 1)
        if self.open:
            self.open[-1].children.append(element)
        elif self.root is None:
            self.root = element
        self.open.append(element)

    def _end(self, tag: str) -> None:
        self.depth -= 1
        if self.hidden:
            self.hidden -= 1
        else:
            self.open.pop()

    def _text(self, text: str) -> None:
        if self.hidden or not self.open or text.isspace():
            return
        self.written += len(text)
        if self.written > self.limits.characters:
            self._refuse(f"more than {self.limits.characters} characters of text")
        self.open[-1].text += text

    def _doctype(self, *_: Any) -> None:
        hint = "a model description needs none; document types can carry entities, which are refused"
        self._refuse("a document type (<!DOCTYPE ...>) is not allowed", hint)

    def _declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        if encoding and not re.fullmatch(r"utf-?8|us-ascii|ascii", encoding, re.IGNORECASE):
            self._refuse(f"the encoding is {encoding[:40]}; FMI wants UTF-8")
