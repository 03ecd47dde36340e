"""A rotor saved by ROSS as tables of elements, with the place of every value: TOML (ROSS 1.0 and newer) or JSON."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rotorsim.diagram.parse.source import MAX_DIAGRAM_BYTES, Expected, read_document
from rotorsim.errors import Place, Problem, Problems, RotorsimError, near_miss

FORM = "a rotor that ROSS has saved with rotor.save(FILE)"
OLD = "ross before 1.0"
SMALLEST, LARGEST = 1e-9, 1e30  # of lengths and moduli, of any number: beyond them products leave floating point
ELEMENT = re.compile(r"([A-Za-z][A-Za-z0-9]*)_(.*)", re.DOTALL)  # CLASS_TAG
_HEADER = re.compile(r'^[ \t]*\[[ \t]*(?:"((?:[^"\\\n]|\\.)*)"|([A-Za-z0-9_-]+))[ \t]*(\.[^\]\n]*)?\]', re.MULTILINE)
_POSITION = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)")
_DOCUMENT = Expected(
    form=FORM, deep="a rotor of ROSS has three levels", large="a rotor of ROSS has a table for each element"
)


@dataclass(frozen=True)
class Table:
    """One element of the file: class and tag as ROSS writes them, its values, and where they are."""

    name: str
    kind: str
    tag: str
    values: Mapping[str, Any]
    locate: Callable[[str], Place]

    @property
    def place(self) -> Place:
        """Where the table begins."""
        return self.locate("")


@dataclass(frozen=True)
class RossFile:
    """The tables of elements in the order of the file, the version that wrote it ("" before 2.1), its parameters."""

    path: Path
    tables: tuple[Table, ...]
    version: str
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def place(self) -> Place:
        """The file."""
        return Place(str(self.path))


def read_ross(file: str | Path) -> RossFile:
    """Read a rotor that ROSS has saved, and tell its elements apart. Raises RotorsimError."""
    path = Path(file)
    data, locate = _json(path) if path.suffix.lower() == ".json" else _toml(path)
    place = Place(str(path))
    if not isinstance(data, dict):
        raise RotorsimError(Problem("is no table of elements", place=place, hint=f"give {FORM}"))
    tables, problems = [], Problems()
    for name, values in data.items():
        if name in ("parameters", "ross_version") or name.startswith("_"):
            continue
        found = ELEMENT.fullmatch(name)
        if found is None or not isinstance(values, dict):
            _refuse(problems, name, values, locate((name,)))
            continue
        tables.append(Table(name, found[1], found[2], values, _within(locate, name)))
    parameters = data.get("parameters", {})
    if not tables and not any(problem.code == OLD for problem in problems):
        problems.clear()  # it is something else: one word for all of it
    if not any(table.kind.startswith("ShaftElement") for table in tables) and not problems:
        problems.error("has no shaft element: it is no rotor saved by ROSS", place=place, hint=f"give {FORM}")
    if not isinstance(parameters, dict):
        problems.error("must be a table", "parameters", locate(("parameters",)), "write [parameters]")
        parameters = {}
    if problems:
        raise RotorsimError(*problems)
    return RossFile(path, tuple(tables), str(data.get("ross_version", "")), parameters)


def _within(locate: Callable[[tuple[str, ...]], Place], name: str) -> Callable[[str], Place]:
    return lambda key: locate((name, key) if key else (name,))


def _refuse(problems: Problems, name: str, values: Any, place: Place) -> None:
    """Say why a key of the file is no element."""
    if isinstance(values, dict) and re.fullmatch(r"\w*(Element|PointMass)\w*", name):
        hint = "load it with the ROSS that saved it, and save it with ROSS 1.0 or newer"
        problems.append(Problem("is the layout of ROSS before 1.0", name, place, hint, code=OLD))
        return
    hint = near_miss(name, ("parameters", "ross_version"), list_all=False) or f"give {FORM}"
    problems.error("is no element: a table named CLASS_TAG is expected", name, place, hint)


# -- the two formats ---------------------------------------------------------------------------------------------------


def _json(path: Path) -> tuple[Any, Callable[[tuple[str, ...]], Place]]:
    source = read_document(path, _DOCUMENT)
    return source.data, lambda steps: source.locate(steps, key=True)


def _toml(path: Path) -> tuple[Any, Callable[[tuple[str, ...]], Place]]:
    file = str(path)
    text = _text(path)
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RotorsimError(_syntax(str(error), text, file)) from None
    places = _Places(text, file)
    return data, places.locate


def _text(path: Path) -> str:
    file = Place(str(path))
    try:
        if path.is_dir():
            hint = "ROSS before 1.0 saved folders: load it with that ROSS, and save it with ROSS 1.0 or newer"
            raise RotorsimError(Problem("is a folder", place=file, hint=hint))
        with path.open("rb") as stream:
            content = stream.read(MAX_DIAGRAM_BYTES + 1)
    except FileNotFoundError:
        raise RotorsimError(Problem("file does not exist", place=file)) from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise RotorsimError(Problem(f"file cannot be read: {why}", place=file)) from None
    if len(content) > MAX_DIAGRAM_BYTES:
        what = f"file is larger than {MAX_DIAGRAM_BYTES // 1_000_000} MB"
        raise RotorsimError(Problem(what, place=file, hint=_DOCUMENT.large))
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise RotorsimError(Problem("file is not UTF-8 text", place=file, hint=f"give {FORM}")) from None


def _syntax(said: str, text: str, file: str) -> Problem:
    """Return what tomllib says, with its place."""
    at = _POSITION.search(said)
    words = _POSITION.sub("", said) or "the file ends too early"
    line, column = (int(at[1]), int(at[2])) if at and at[1] else (text.count("\n") + 1, 1)
    place = Place(file, line, column) if at else Place(file)
    return Problem(f"not valid TOML: {words[:1].lower()}{words[1:]}", place=place, hint=f"give {FORM}")


class _Places:
    """Places of tables and keys in TOML text, found by their headers: tomllib gives none."""

    def __init__(self, text: str, file: str) -> None:
        self._text, self._file = text, file
        self._headers: list[tuple[int, int, str, bool]] | None = None

    def locate(self, steps: tuple[str, ...]) -> Place:
        """Return the place of a key of a table, or else of the header of the table, or else of the file."""
        if self._headers is None:
            found = list(_HEADER.finditer(self._text))
            ends = [match.start() for match in found[1:]] + [len(self._text)]
            self._headers = [
                (match.start(), end, _name(match), bool(match[3])) for match, end in zip(found, ends, strict=True)
            ]
        mine = [entry for entry in self._headers if entry[2] == steps[0]]
        if len(steps) > 1:
            key = re.compile(rf'^[ \t]*"?{re.escape(steps[1])}"?[ \t]*=', re.MULTILINE)
            for start, end, _, inner in mine:
                if not inner and (found_key := key.search(self._text, start, end)):
                    return self._place(found_key.start())
        if mine:
            return self._place(min(mine, key=lambda entry: entry[3])[0])
        top = re.search(rf'^[ \t]*"?{re.escape(steps[0])}"?[ \t]*=', self._text, re.MULTILINE)
        return self._place(top.start()) if top else Place(self._file)

    def _place(self, offset: int) -> Place:
        while self._text[offset] in " \t":
            offset += 1
        begin = self._text.rfind("\n", 0, offset) + 1
        return Place(self._file, self._text.count("\n", 0, offset) + 1, offset - begin + 1)


def _name(header: re.Match[str]) -> str:
    """Return the name in a header, its escapes read."""
    if header[1] is None:
        return header[2]
    try:
        return str(next(iter(tomllib.loads(f'"{header[1]}" = 0'))))
    except tomllib.TOMLDecodeError:
        return header[1]


# -- values ------------------------------------------------------------------------------------------------------------


def number(table: Table, key: str, problems: Problems, default: float | None = None, **limits: Any) -> float:
    """Return a number of a table; a mistake goes to ``problems`` and gives nan.

    default: where the key is not there (None: it must be). limits: low (at least), above (greater than).
    """
    if key not in table.values or table.values[key] is None:
        if default is None:
            problems.error(f"{key} is missing", table.name, table.place, "a number is expected")
            return math.nan
        return default
    return _checked(table, key, table.values[key], problems, **limits)


def numbers(table: Table, key: str, problems: Problems, **limits: Any) -> list[float] | None:
    """Return a number or a list of them as a list, None where the key is not there."""
    value = table.values.get(key)
    if value is None:
        return None
    if not isinstance(value, list):
        return [_checked(table, key, value, problems, **limits)]
    if not value:
        problems.error(f"{key} is an empty list", table.name, table.locate(key), "numbers are expected")
        return None
    return [_checked(table, f"{key}[{k}]", item, problems, key=key, **limits) for k, item in enumerate(value)]


def whole(table: Table, key: str, problems: Problems, default: int | None = None) -> int:
    """Return a node or an element, counted from 0; a mistake goes to ``problems`` and gives -1."""
    value = table.values.get(key, default)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    if value is None:
        problems.error(f"{key} is missing", table.name, table.place, "a node, counted from 0, is expected")
    else:
        what = f"{key} must be a whole number of at least 0, not {_shown(value)}"
        problems.error(what, table.name, table.locate(key), "nodes are counted from 0")
    return -1


def flag(table: Table, key: str, problems: Problems, default: bool) -> bool:
    """Return a truth value."""
    value = table.values.get(key, default)
    if not isinstance(value, bool):
        what = f"{key} must be true or false, not {_shown(value)}"
        problems.error(what, table.name, table.locate(key), "write true or false")
        return default
    return value


def _checked(
    table: Table,
    shown: str,
    value: Any,
    problems: Problems,
    *,
    key: str = "",
    low: float | None = None,
    above: float | None = None,
) -> float:
    place = table.locate(key or shown)
    if not isinstance(value, int | float) or isinstance(value, bool):
        what = f"{shown} must be a number, not {_shown(value)}"
        problems.error(what, table.name, place, "write a number in SI units")
        return math.nan
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        what, hint = f"{shown} is {number:g}", "numbers must be finite"
    elif abs(number) > LARGEST:
        what, hint = f"{shown} is {number:g}", f"numbers are at most {LARGEST:g}"
    elif low is not None and number < low:
        what, hint = f"{shown} is {number:g}", f"it must be at least {low:g}"
    elif above is not None and number <= above:
        what, hint = f"{shown} is {number:g}", f"it must be greater than {above:g}"
    elif above == 0.0 and number < SMALLEST:
        what, hint = f"{shown} is {number:g}", f"it must be at least {SMALLEST:g}"
    else:
        return number
    problems.error(what, table.name, place, hint)
    return math.nan


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return f"the text '{value[:40]}'"
    kinds = {bool: str(value).lower(), list: "a list", dict: "a table"}
    return kinds.get(type(value), str(value)[:40])
