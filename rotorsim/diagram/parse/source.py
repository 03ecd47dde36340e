"""Reading diagram JSON safely: limits first, then the fast parser, positions only when somebody asks.

`read_document` gives a `Source`; `Source.locate` finds line and column of any key or value.
"""

from __future__ import annotations

import json
import math
import re
from bisect import bisect_left
from functools import cached_property
from itertools import accumulate, islice
from pathlib import Path
from typing import Any

from rotorsim.errors import CONTROL, Place, Problem, RotorsimError

__all__ = [
    "MAX_BYTES",
    "MAX_DEPTH",
    "JsonPath",
    "LazyPlace",
    "Source",
    "is_too_deep",
    "parse_document",
    "read_document",
]

MAX_BYTES = 20_000_000
MAX_DEPTH = 64
MAX_DIGITS = 300

JsonPath = tuple[str | int, ...]
_STRING = r'"[^"\\]*+(?:\\.[^"\\]*+)*+"?'  # possessive: linear time also for hostile text
_STRINGS = re.compile(_STRING, re.DOTALL)
_OTHER = re.compile(r"[^\[\]{}]+")
_BRACKET_OR_STRING = re.compile(rf"[\[\]{{}}]|{_STRING}", re.DOTALL)
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")  # one half of a character: good only in pairs
_ESCAPED = re.compile(
    r"\\u(?:00[0-1789]|20|ff)|\\[bf]|[\x7f-\x9f\u202a-\u202e\u2066-\u2069\ufffe\uffff]", re.IGNORECASE
)
_TOKEN = re.compile(rf"\s*(?:({_STRING})|([\[\]{{}},:])|([^\s\[\]{{}},:\"]+))", re.DOTALL)


class Source:
    """A JSON document with its text, so that every part of it can be placed.

    data: the parsed document. text: "" for a document made in memory. file: name as shown to the user.
    """

    def __init__(self, data: Any, text: str = "", file: str = "", path: Path | None = None) -> None:
        self.data, self.text, self.file, self.path = data, text, file, path

    def locate(self, path: JsonPath = (), *, key: bool = False) -> Place:
        """Return the place of the value at ``path`` (of its key if ``key``), or of the nearest part above it."""
        if not self.text:
            return Place(self.file)
        node = self._positions
        for step in path:
            child = node[2].get(step)
            if child is None:
                break
            node = child
        offset = node[0] if key and node[0] >= 0 else node[1]
        return Place(self.file, *self._line_column(offset))

    def place(self, path: JsonPath, *, key: bool = False) -> Place:
        """Return a place like `locate`, whose line and column are found only when they are read."""
        return LazyPlace(self, path, key)

    def _line_column(self, offset: int) -> tuple[int, int]:
        line = bisect_left(self._line_ends, offset)
        return line + 1, offset - (self._line_ends[line - 1] if line else -1)

    @cached_property
    def _line_ends(self) -> list[int]:
        return [match.start() for match in re.finditer("\n", self.text)]

    @cached_property
    def _positions(self) -> Any:
        return _scan(self.text)[0]


class LazyPlace(Place):
    """A `Place` that looks up its line and column on first use (a large valid diagram needs none)."""

    _source: Source
    _path: JsonPath
    _key: bool

    def __init__(self, source: Source, path: JsonPath, key: bool = False) -> None:
        self.__dict__.update(_source=source, _path=path, _key=key)

    def part(self, *steps: str | int) -> LazyPlace:
        """Return the place of a part of the value at this place."""
        return LazyPlace(self._source, (*self._path, *steps))

    @property
    def _real(self) -> Place:
        if "_found" not in self.__dict__:
            self.__dict__["_found"] = self._source.locate(self._path, key=self._key)
        found: Place = self.__dict__["_found"]
        return found

    file = property(lambda self: self._source.file)
    line = property(lambda self: self._real.line)
    column = property(lambda self: self._real.column)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Place) and self._tuple == (other.file, other.line, other.column)

    def __hash__(self) -> int:
        return hash(self._tuple)

    def __repr__(self) -> str:
        return repr(self._real)

    def __reduce__(self) -> tuple[type[Place], tuple[str, int, int]]:
        return Place, self._tuple

    @property
    def _tuple(self) -> tuple[str, int, int]:
        return (self.file, self.line, self.column)


def read_document(path: str | Path) -> Source:
    """Read and parse a JSON file: at most 20 MB, 64 levels, finite numbers, no key twice.

    Raises RotorsimError with file:line:col and a hint.
    """
    file, path = str(path), Path(path)
    try:
        if not path.is_file():
            why = "is a folder" if path.is_dir() else "is not a file" if path.exists() else "does not exist"
            raise RotorsimError(Problem(f"file {why}", place=Place(file)))
        with path.open("rb") as stream:  # one read with a limit: the size on disk may change meanwhile
            content = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise RotorsimError(Problem(f"file cannot be read: {why}", place=Place(file))) from None
    if len(content) > MAX_BYTES:
        raise RotorsimError(
            Problem(
                f"file is larger than {MAX_BYTES // 1_000_000} MB", place=Place(file), hint="split it by sub-diagrams"
            )
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - (content.rfind(b"\n", 0, error.start) + 1) + 1
        raise RotorsimError(
            Problem("file is not UTF-8 text", place=Place(file, line, column), hint="save it as UTF-8")
        ) from None
    return parse_document(text, file, path)


def parse_document(text: str, file: str = "", path: Path | None = None) -> Source:
    """Parse JSON text under the limits of `read_document`."""
    source = Source(None, text, file, path)
    deep = _first_too_deep(text)
    if deep is not None:
        what = f"JSON is nested deeper than {MAX_DEPTH} levels"
        hint = "a diagram needs no more than ten; use sub-diagrams"
        raise RotorsimError(Problem(what, place=Place(file, *source._line_column(deep)), hint=hint))
    suspects: list[str] = []

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        result = dict(items)
        if len(result) != len(items):
            suspects.append("duplicate")
        return result

    def number(digits: str) -> float:
        value = float(digits)
        if not math.isfinite(value):
            suspects.append(digits)
        return value

    def whole(digits: str) -> int:
        if len(digits) > MAX_DIGITS:
            suspects.append(digits)
            return 0
        return int(digits)

    def constant(name: str) -> float:
        suspects.append(name)
        return 0.0

    try:
        source.data = json.loads(
            text, object_pairs_hook=pairs, parse_float=number, parse_int=whole, parse_constant=constant
        )
    except json.JSONDecodeError as error:
        raise RotorsimError(_syntax_problem(error, source)) from None
    if suspects or _SURROGATE.search(text) or _ESCAPED.search(text):
        problems = _scan(text)[1]
        if problems:
            raise RotorsimError(
                *[Problem(what, place=Place(file, *source._line_column(at)), hint=hint) for at, what, hint in problems]
            )
    return source


def _first_too_deep(text: str) -> int | None:
    """Return the offset of the first bracket that is nested too deeply."""
    brackets = _OTHER.sub("", _STRINGS.sub("", text))
    levels = accumulate(map({"[": 1, "{": 1, "]": -1, "}": -1}.__getitem__, brackets))
    number = next((k for k, level in enumerate(levels) if level > MAX_DEPTH), None)
    if number is None:
        return None
    found = (match for match in _BRACKET_OR_STRING.finditer(text) if match[0][0] != '"')
    return next(islice(found, number, None)).start()


def is_too_deep(value: Any) -> bool:
    """Return whether a value made in memory is nested deeper than a file may be (or holds itself)."""
    level = [value]
    for _ in range(MAX_DEPTH + 1):
        level = [
            item
            for part in level
            if isinstance(part, dict | list | tuple)
            for item in (part.values() if isinstance(part, dict) else part)
        ]
        if not level:
            return False
    return True


def _scan(text: str) -> tuple[Any, list[tuple[int, str, str]]]:
    """Return the tree of positions of valid JSON text, and the (offset, problem, hint) of what is refused.

    A node is [offset of the key (-1: none), offset of the value, {key or index: node}].
    """
    root: list[Any] = [-1, 0, {}]
    stack: list[tuple[list[Any], bool]] = []  # open containers: node, is it an object?
    problems: list[tuple[int, str, str]] = []
    key: tuple[str, int] | None = None
    for match in _TOKEN.finditer(text):
        string, mark, word = match.groups()
        if mark in (",", ":"):
            continue
        if mark in ("]", "}"):
            stack.pop()
            continue
        offset = match.start(1) if string else match.start(2) if mark else match.start(3)
        if string and _SURROGATE.search(string) and not _is_text(json.loads(string)):
            problems.append((offset, "half a character (\\ud800 to \\udfff)", "write the character itself"))
        elif string and _ESCAPED.search(string) and (found := CONTROL.search(json.loads(string).replace("\r", ""))):
            problems.append((offset, f"control character (\\u{ord(found[0]):04x})", "remove it"))
        if stack and stack[-1][1] and key is None:
            key = (json.loads(string), offset)
            if key[0] in stack[-1][0][2]:
                problems.append((offset, f"key '{key[0]}' is given twice", "remove or rename one of them"))
            continue
        node: list[Any] = [-1 if key is None else key[1], offset, {}]
        if stack:
            children = stack[-1][0][2]
            children[len(children) if key is None else key[0]] = node
        else:
            root = node
        key = None
        if mark:
            stack.append((node, mark == "{"))
        elif word and word not in ("true", "false", "null"):
            _check_number(word, offset, problems)
    return root, problems


def _is_text(value: str) -> bool:
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def _check_number(word: str, offset: int, problems: list[tuple[int, str, str]]) -> None:
    if word.lstrip("-") in ("NaN", "Infinity"):
        problems.append((offset, f"{word} is not allowed", "numbers must be finite"))
    elif len(word) > MAX_DIGITS:
        problems.append((offset, f"number of {len(word)} digits is too long", "numbers must fit a float"))
    elif not math.isfinite(float(word)):
        problems.append((offset, f"number {word} is too large", "numbers must be finite"))


def _syntax_problem(error: json.JSONDecodeError, source: Source) -> Problem:
    text, at = source.text, error.pos
    in_text = error.msg.startswith(("Invalid", "Unterminated"))
    rest = text[at:] if in_text else text[at:].lstrip()
    at = len(text) - len(rest)
    before = text[:at].rstrip()
    what, hint = f"not valid JSON: {error.msg[0].lower()}{error.msg[1:]}", ""
    if not text.strip():
        what, hint = "file is empty", 'a diagram is a JSON object: {"blocks": {...}, "wires": [...]}'
    elif error.msg.startswith("Unterminated string"):
        what, hint = "not valid JSON: text is not closed", 'close it with "'
    elif error.msg.startswith("Extra data"):
        what, hint = "not valid JSON: something follows the end of the document", "a bracket is closed too early?"
    elif error.msg.startswith("Invalid control character"):
        what, hint = "not valid JSON: line break or control character in a text", 'close the text with ", or write \\n'
    elif in_text:
        what, hint = "not valid JSON: wrong escape in a text", "write \\\\ for a backslash"
    elif not rest:
        at = len(before)
        what, hint = "not valid JSON: file ends too early", "a bracket is not closed"
    elif rest.startswith(("//", "/*", "#")):
        what, hint = "not valid JSON: comment", 'JSON has no comments; use a "description"'
    elif rest[0] == "'":
        what, hint = "not valid JSON: single quotes", 'write texts in double quotes "..."'
    elif before.endswith(",") and rest[0] in ",]}":
        at = len(before) - 1 if rest[0] != "," else at
        what, hint = f"not valid JSON: comma before '{rest[0]}'", "remove the comma"
    elif error.msg.startswith("Illegal trailing comma"):
        what, hint = f"not valid JSON: comma before '{rest.lstrip(', ')[:1]}'", "remove the comma"
    elif error.msg.startswith("Expecting ',' delimiter"):
        at = len(before) if rest[0] in '"{[-0123456789tfn' else at
        what, hint = "not valid JSON: comma or closing bracket expected", "a comma is missing?"
    elif error.msg.startswith("Expecting ':' delimiter"):
        what, hint = "not valid JSON: ':' expected after the key", 'write "key": value'
    elif error.msg.startswith("Expecting property name"):
        what, hint = "not valid JSON: key expected", "write keys in double quotes"
    elif error.msg.startswith("Expecting value"):
        words = {"True": "true", "False": "false", "None": "null"}
        word = re.match(r"\w+", rest)
        what = f"not valid JSON: value expected, found '{word[0] if word else rest[0]}'"
        hint = f"write {words[word[0]]}" if word and word[0] in words else 'write texts in double quotes "..."'
    return Problem(what, place=Place(source.file, *source._line_column(at)), hint=hint)
