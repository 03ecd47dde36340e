"""Reading diagram JSON safely: limits first, then the fast parser, positions only when somebody asks.

`read_document` gives a `Source`; `Source.locate` finds line and column of any key or value.
"""

from __future__ import annotations

import json
import math
import re
from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, islice
from pathlib import Path
from typing import Any

from rotorsim.errors import CONTROL, Place, Problem, RotorsimError

MAX_DIAGRAM_BYTES = 20_000_000
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


@dataclass(frozen=True)
class Expected:
    """What a document should be, for the hints: its form, and what to do where it is too deep or too large."""

    form: str
    deep: str
    large: str


DIAGRAM_FORM = Expected(
    'a diagram is a JSON object: {"blocks": {...}, "wires": [...]}',
    "a diagram needs no more than ten; use sub-diagrams",
    "split it by sub-diagrams",
)


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
        return Place(self.file, *self.line_column(offset))

    def place(self, path: JsonPath, *, key: bool = False) -> Place:
        """Return a place like `locate`, whose line and column are found only when they are read."""
        return LazyPlace(self, path, key)

    def line_column(self, offset: int) -> tuple[int, int]:
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

    def __init__(self, source: Source, path: JsonPath, key: bool = False) -> None:
        self._at = source, path, key

    def part(self, *steps: str | int) -> LazyPlace:
        """Return the place of a part of the value at this place."""
        source, path, _ = self._at
        return LazyPlace(source, (*path, *steps))

    @cached_property
    def _real(self) -> Place:
        source, path, key = self._at
        return source.locate(path, key=key)

    file = property(lambda self: self._at[0].file)
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


def read_document(path: str | Path, expected: Expected = DIAGRAM_FORM) -> Source:
    """Read and parse a JSON file: at most 20 MB, 64 levels, finite numbers, no key twice.

    Raises RotorsimError with file:line:col and a hint.
    """
    file, path = str(path), Path(path)
    try:
        if not path.is_file():
            why = "is a folder" if path.is_dir() else "is not a file" if path.exists() else "does not exist"
            raise RotorsimError(Problem(f"file {why}", place=Place(file)))
        with path.open("rb") as stream:  # one read with a limit: the size on disk may change meanwhile
            content = stream.read(MAX_DIAGRAM_BYTES + 1)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise RotorsimError(Problem(f"file cannot be read: {why}", place=Place(file))) from None
    if len(content) > MAX_DIAGRAM_BYTES:
        raise RotorsimError(
            Problem(f"file is larger than {MAX_DIAGRAM_BYTES // 1_000_000} MB", place=Place(file), hint=expected.large)
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - (content.rfind(b"\n", 0, error.start) + 1) + 1
        raise RotorsimError(
            Problem("file is not UTF-8 text", place=Place(file, line, column), hint="save it as UTF-8")
        ) from None
    return parse_document(text, file, path, expected)


def parse_document(text: str, file: str = "", path: Path | None = None, expected: Expected = DIAGRAM_FORM) -> Source:
    """Parse JSON text under the limits of `read_document`."""
    source = Source(None, text, file, path)
    deep = _first_too_deep(text)
    if deep is not None:
        place = Place(file, *source.line_column(deep))
        raise RotorsimError(Problem(f"JSON is nested deeper than {MAX_DEPTH} levels", place=place, hint=expected.deep))
    suspects: list[str] = []

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        result = dict(items)
        suspects.extend(["duplicate"] if len(result) != len(items) else [])
        return result

    def number(digits: str) -> float:
        value = float(digits)
        suspects.extend([] if math.isfinite(value) else [digits])
        return value

    def whole(digits: str) -> float:
        return int(digits) if len(digits) <= MAX_DIGITS else number("inf")

    try:
        source.data = json.loads(
            text, object_pairs_hook=pairs, parse_float=number, parse_int=whole, parse_constant=number
        )
    except json.JSONDecodeError as error:
        raise RotorsimError(_syntax_problem(error, source, expected)) from None
    if suspects or _SURROGATE.search(text) or _ESCAPED.search(text):
        mistakes = _scan(text)[1]
        problems = [Problem(what, place=Place(file, *source.line_column(at)), hint=hint) for at, what, hint in mistakes]
        if problems:
            raise RotorsimError(*problems)
    return source


def _first_too_deep(text: str) -> int | None:
    """Return the offset of the first bracket that is nested too deeply."""
    brackets = _OTHER.sub("", _STRINGS.sub("", text))
    levels = accumulate(map({"[": 1, "{": 1, "]": -1, "}": -1}.__getitem__, brackets))
    number = next((k for k, level in enumerate(levels) if level > MAX_DEPTH), None)
    opened = (match.start() for match in _BRACKET_OR_STRING.finditer(text) if match[0][0] != '"')
    return None if number is None else next(islice(opened, number, None))


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
    root: dict[int | str, Any] = {}
    stack: list[tuple[list[Any], bool]] = []  # open containers: node, is it an object?
    problems: list[tuple[int, str, str]] = []
    key: tuple[str, int] | None = None
    for match in _TOKEN.finditer(text):
        string, mark, word = match.groups()
        if mark in ("]", "}"):
            stack.pop()
        if mark in (",", ":", "]", "}"):
            continue
        offset = match.start(match.lastindex or 0)
        if string and _SURROGATE.search(string) and re.search("[\ud800-\udfff]", json.loads(string)):
            problems.append((offset, "half a character (\\ud800 to \\udfff)", "write the character itself"))
        elif string and _ESCAPED.search(string) and (found := CONTROL.search(json.loads(string).replace("\r", ""))):
            problems.append((offset, f"control character (\\u{ord(found[0]):04x})", "remove it"))
        if stack and stack[-1][1] and key is None:
            key = (json.loads(string), offset)
            if key[0] in stack[-1][0][2]:
                problems.append((offset, f"key '{key[0]}' is given twice", "remove or rename one of them"))
            continue
        node: list[Any] = [-1 if key is None else key[1], offset, {}]
        children = stack[-1][0][2] if stack else root
        children[len(children) if key is None else key[0]] = node
        key = None
        if mark:
            stack.append((node, mark == "{"))
        elif word and word not in ("true", "false", "null"):
            _check_number(word, offset, problems)
    return root.get(0, [-1, 0, {}]), problems


def _check_number(word: str, offset: int, problems: list[tuple[int, str, str]]) -> None:
    if word.lstrip("-") in ("NaN", "Infinity"):
        problems.append((offset, f"{word} is not allowed", "numbers must be finite"))
    elif len(word) > MAX_DIGITS:
        problems.append((offset, f"number of {len(word)} digits is too long", "numbers must fit a float"))
    elif not math.isfinite(float(word)):
        problems.append((offset, f"number {word} is too large", "numbers must be finite"))


_PYTHON_WORDS = {"True": "true", "False": "false", "None": "null"}
# what the decoder says, what stands before and what follows (patterns of their starts, of the end for what is before)
# -> where the mistake is seen, what it is and how to cure it; the first that fits is it
_SYNTAX = (
    ("", r"\A\Z", r"\Z", "here", "file is empty", "{form}"),
    ("Unterminated string", "", "", "here", "text is not closed", 'close it with "'),
    ("Extra data", "", "", "here", "something follows the end of the document", "a bracket is closed too early?"),
    (
        "Invalid control character",
        "",
        "",
        "here",
        "line break or control character in a text",
        'close the text with ", or write \\n',
    ),
    ("Invalid|Unterminated", "", "", "here", "wrong escape in a text", "write \\\\ for a backslash"),
    ("", "", r"\Z", "before", "file ends too early", "a bracket is not closed"),
    ("", "", r"//|/\*|#", "here", "comment", 'JSON has no comments; use a "description"'),
    ("", "", "'", "here", "single quotes", 'write texts in double quotes "..."'),
    ("", r",\Z", ",", "here", "comma before ','", "remove the comma"),
    ("", r",\Z", r"[\]}]", "comma", "comma before '{next}'", "remove the comma"),
    ("Illegal trailing comma", "", "", "here", "comma before '{after}'", "remove the comma"),
    ("Expecting ','", "", r'["{\[\-0-9tfn]', "before", "comma or closing bracket expected", "a comma is missing?"),
    ("Expecting ','", "", "", "here", "comma or closing bracket expected", "a comma is missing?"),
    ("Expecting ':'", "", "", "here", "':' expected after the key", 'write "key": value'),
    ("Expecting property name", "", "", "here", "key expected", "write keys in double quotes"),
    ("Expecting value", "", r"(True|False|None)\b", "here", "value expected, found '{word}'", "write {json}"),
    ("Expecting value", "", "", "here", "value expected, found '{word}'", 'write texts in double quotes "..."'),
)


def _syntax_problem(error: json.JSONDecodeError, source: Source, expected: Expected) -> Problem:
    text = source.text
    in_text = error.msg.startswith(("Invalid", "Unterminated"))
    rest = text[error.pos :] if in_text else text[error.pos :].lstrip()
    at = len(text) - len(rest)
    before = text[:at].rstrip()
    rules = (
        rule
        for rule in _SYNTAX
        if re.match(rule[0], error.msg) and re.search(rule[1], before) and re.match(rule[2], rest)
    )
    *_, place, what, hint = next(rules, ("here", f"{error.msg[0].lower()}{error.msg[1:]}", ""))
    word = re.match(r"\w+", rest)
    words = {"next": rest[:1], "after": rest.lstrip(", ")[:1], "word": word[0] if word else rest[:1]}
    words["form"] = expected.form
    words["json"] = _PYTHON_WORDS.get(words["word"], "")
    what, hint = (text.format(**words) for text in (what, hint))
    offset = {"here": at, "before": len(before), "comma": len(before) - 1}[place]
    what = what if what == "file is empty" else f"not valid JSON: {what}"
    return Problem(what, place=Place(source.file, *source.line_column(offset)), hint=hint)
