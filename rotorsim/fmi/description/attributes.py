"""Values of XML attributes: numbers, flags, choices and start values, each mistake placed."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.fmi.description.model import BASE_UNITS, FLOATS, INTEGERS, FmuUnit, Value
from rotorsim.fmi.description.xml_reader import Element

_FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?INF|NaN")
_WHOLE = re.compile(r"[+-]?\d{1,20}")
_FLAGS = {"true": True, "1": True, "false": False, "0": False}
_Default = TypeVar("_Default", float, None)


@dataclass
class Mistakes:
    """The mistakes in a document, each with file, line and column. file: the name to be shown."""

    file: str
    problems: list[Problem] = field(default_factory=list)

    def place(self, element: Element) -> Place:
        """Return where an element is."""
        return Place(self.file, element.line, element.column)

    def wrong(self, element: Element, what: str, subject: str = "", hint: str = "") -> None:
        """Note a mistake at an element."""
        self.problems.append(Problem(what, subject[:200], self.place(element), hint))

    def attributes(self, element: Element, subject: str = "", declared: Element | None = None) -> Attributes:
        """Return the attributes of an element, to be converted."""
        return Attributes(element, subject, self, declared)

    def unit(self, element: Element) -> FmuUnit:
        """Return the unit that a <Unit> and its <BaseUnit> define."""
        name, base = element.get("name"), element.first("BaseUnit")
        read = self.attributes(base or element, f"unit {name[:80]}")
        powers = {key: read.whole(key, 0, least=-99, most=99) for key in BASE_UNITS if base and key in base.attributes}
        factor, offset = read.factor(), read.number("offset", 0.0)
        if not math.isfinite(offset):
            read.wrong("offset", "is not finite")
        return FmuUnit(name, factor, offset, powers, defined=base is not None)

    def refuse(self, most: int, place: Place) -> None:
        """Raise RotorsimError with the first mistakes, if there are any."""
        if self.problems:
            more = len(self.problems) - most
            rest = [Problem(f"... and {more} more mistakes", place=place)] if more > 0 else []
            raise RotorsimError(*self.problems[:most], *rest)


class Attributes:
    """Attributes of an element, converted; what it does not say, its declared type says.

    A mistake is noted and stands for the default.
    """

    def __init__(self, element: Element, subject: str, mistakes: Mistakes, declared: Element | None = None) -> None:
        self.element, self.subject, self.mistakes, self.declared = element, subject, mistakes, declared

    def _holder(self, name: str) -> Element:
        """Return the element that has an attribute."""
        return self.element if self.declared is None or name in self.element.attributes else self.declared

    def _raw(self, name: str) -> str | None:
        return self._holder(name).attributes.get(name)

    def wrong(self, name: str, what: str) -> None:
        """Note a mistake in an attribute."""
        holder = self._holder(name)
        self.mistakes.wrong(holder, f'{name}="{holder.get(name)[:80]}" {what}', self.subject)

    def _missing(self, name: str) -> None:
        self.mistakes.wrong(self.element, f"the attribute {name} is missing", self.subject)

    def text(self, name: str, *, needed: bool = False) -> str:
        """Return text, "" where there is none."""
        value = self._raw(name)
        if needed and not value:
            self._missing(name)
        return value or ""

    def flag(self, name: str) -> bool:
        """Return true or false; false where there is none."""
        text = self._raw(name)
        value = False if text is None else _FLAGS.get(text.strip())
        if value is None:
            self.wrong(name, "is neither true nor false")
        return bool(value)

    def number(self, name: str, default: _Default) -> float | _Default:
        """Return a number."""
        text = self._raw(name)
        value = default if text is None else parse_float(text.strip())
        if value is None and text is not None:
            self.wrong(name, "is not a number")
        return default if value is None else value

    def factor(self) -> float:
        """Return the attribute "factor", which is neither zero nor infinite."""
        factor = self.number("factor", 1.0)
        if not 0.0 < abs(factor) < math.inf:
            self.wrong("factor", "is no factor")
        return factor

    def whole(self, name: str, default: int | None, *, least: int = 0, most: int) -> int:
        """Return a whole number between least and most; without a default it must be there."""
        text = self._raw(name)
        value = int(text) if text is not None and _WHOLE.fullmatch(text.strip()) else None
        if value is not None and least <= value <= most:
            return value
        if text is not None:
            self.wrong(name, f"is not a whole number between {least} and {most}")
        elif default is None:
            self._missing(name)
        return default or 0

    def choice(self, name: str, known: Sequence[str], default: str) -> str:
        """Return one of the known words."""
        text = self._raw(name)
        value = default if text is None else text
        if value in (*known, default):
            return value
        self.wrong(name, f"is unknown: {near_miss(value[:80], known)}")
        return default

    def value(self, name: str, kind: str, text: str) -> Value | None:
        """Return a text of an attribute as a value of a type."""
        value = parse_value(text, kind)
        if value is None:
            self.wrong(name, f"is not of type {kind}")
        return value


def parse_value(text: str, kind: str) -> Value | None:
    """Return a value of a type as XML Schema writes it, or None."""
    plain = text.strip()
    if kind in FLOATS:
        return parse_float(plain)
    if kind in INTEGERS:
        return int(plain) if _WHOLE.fullmatch(plain) else None
    return _FLAGS.get(plain) if kind == "Boolean" else text


def parse_float(text: str) -> float | None:
    """Return a number as XML Schema writes it, or None."""
    return float(text) if _FLOAT.fullmatch(text) else None
