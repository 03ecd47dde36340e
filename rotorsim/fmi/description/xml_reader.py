"""Reading foreign XML within limits: no document type (so no entities), caps on size, depth, counts and text.

It is decoded as it declares, before anything else is looked at, so that the limits hold in every encoding.

Elements know line and column, so that every mistake in a model description can be placed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NoReturn
from xml.parsers import expat

from rotorsim.errors import Place, Problem, RotorsimError


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


_STARTS = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be", b"<\0": "utf-16-le", b"\0<": "utf-16-be"}
_DECLARED = re.compile(r"""<\?xml\s[^>]*?encoding\s*=\s*["']([^"']*)["']""")


def _codec(name: str) -> str:
    """Return Python's codec for the name of an encoding, "" for one that is not read."""
    plain = name.lower().replace("_", "-")
    if plain in ("utf-8", "utf8", "us-ascii", "ascii"):
        return "utf-8"
    if re.fullmatch(r"utf-?16(-?[lb]e)?", plain):
        return "utf-16"
    if match := re.fullmatch(r"(?:iso-?8859-?|latin-?(?=1$))(\d{1,2})", plain):
        return f"iso8859-{int(match[1])}" if int(match[1]) in range(1, 17) and int(match[1]) != 12 else ""
    match = re.fullmatch(r"(?:windows-|cp-?)(125[0-8])", plain)
    return f"cp{match[1]}" if match else ""


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

    def read(self, data: bytes) -> Element:
        if len(data) > self.limits.bytes:
            what = f"{len(data)} bytes of XML; {self.limits.bytes} are allowed"
            raise RotorsimError(Problem(what, place=Place(self.file)))
        data = self._in_utf8(data)
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
        longest = max(map(len, attributes.values()), default=0)
        for size, most, what in (
            (self.depth, self.limits.depth, "elements are nested deeper than {0}"),
            (self.count, self.limits.elements, "more than {0} elements"),
            (len(attributes), self.limits.attributes, "<{1}> has more than {0} attributes"),
            (longest, self.limits.characters, "an attribute of <{1}> has more than {0} characters"),
        ):
            if size > most:
                self._refuse(what.format(most, tag[:80]))
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

    def _in_utf8(self, data: bytes) -> bytes:
        """Return a document in UTF-8, decoded as its first bytes and its declaration say (XML 1.0, appendix F)."""
        wide = next((name for start, name in _STARTS.items() if data.startswith(start)), "")
        declared = _DECLARED.match(data[:400].decode(wide or "ascii", "replace").lstrip("\ufeff"))
        name = declared[1] if declared else wide or "utf-8"
        codec = _codec(name)
        if not codec:
            self._refuse(
                f"the encoding is {name[:40]}; read are UTF-8, UTF-16, ISO-8859-1 to 16 and windows-1250 to 1258"
            )
        if codec.startswith("utf-16") != bool(wide):
            self._refuse(f"the encoding is said to be {name[:40]}, but its first bytes are {wide or 'not'}")
        if codec == "utf-8":
            return data
        try:
            return data.decode(wide or codec).lstrip("\ufeff").encode()
        except UnicodeError as error:
            start = data[: getattr(error, "start", 0)].decode(wide or codec, "replace")
            place = Place(self.file, start.count("\n") + 1, len(start) - start.rfind("\n"))
            raise RotorsimError(Problem(f"not {name}: it does not know this character", place=place)) from None
