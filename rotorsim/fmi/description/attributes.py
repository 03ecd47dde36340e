"""Values of XML attributes: numbers, flags, choices and start values, each mistake placed."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import overload

from rotorsim.errors import near_miss
from rotorsim.fmi.description.model import FLOATS, INTEGERS, Value
from rotorsim.fmi.description.xml_reader import Element

__all__ = ["Attributes", "Values"]

_FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?INF|NaN")
_WHOLE = re.compile(r"[+-]?\d{1,20}")
_FLAGS = {"true": True, "1": True, "false": False, "0": False}

Report = Callable[[Element, str, str], None]


class Attributes:
    """Attributes of one element, converted; a mistake is reported and stands for the default."""

    def __init__(self, element: Element, subject: str, report: Report) -> None:
        self.element, self.subject, self._report = element, subject, report

    def wrong(self, name: str, what: str) -> None:
        self._report(self.element, f'{name}="{self.element.get(name)[:80]}" {what}', self.subject)

    def text(self, name: str, *, needed: bool = False) -> str:
        """Return text, "" where there is none."""
        value = self.element.attributes.get(name)
        if needed and not value:
            self._report(self.element, f"the attribute {name} is missing", self.subject)
        return value or ""

    def flag(self, name: str) -> bool:
        """Return true or false; false where there is none."""
        value = self.element.attributes.get(name)
        if value is None:
            return False
        if value.strip() not in _FLAGS:
            self.wrong(name, "is neither true nor false")
            return False
        return _FLAGS[value.strip()]

    @overload
    def number(self, name: str) -> float | None: ...
    @overload
    def number(self, name: str, default: float) -> float: ...
    def number(self, name: str, default: float | None = None) -> float | None:
        """Return a number."""
        value = self.element.attributes.get(name)
        if value is None:
            return default
        found = to_float(value.strip())
        if found is None:
            self.wrong(name, "is not a number")
            return default
        return found

    def whole(self, name: str, default: int | None, *, least: int = 0, most: int) -> int:
        """Return a whole number between least and most; without a default it must be there."""
        value = self.element.attributes.get(name)
        if value is None:
            if default is None:
                self._report(self.element, f"the attribute {name} is missing", self.subject)
            return default or 0
        found = int(value) if _WHOLE.fullmatch(value.strip()) else None
        if found is None or not least <= found <= most:
            self.wrong(name, f"is not a whole number between {least} and {most}")
            return default or 0
        return found

    def choice(self, name: str, known: Sequence[str], default: str) -> str:
        """Return one of the known words."""
        value = self.element.attributes.get(name, default)
        if value not in known and value != default:
            self.wrong(name, f"is unknown: {near_miss(value[:80], known)}")
            return default
        return value


class Values:
    """What a variable says of its values; what it does not say, its declared type says."""

    def __init__(self, own: Attributes, declared: Element | None, kind: str) -> None:
        self.own, self.kind = own, kind
        self.declared = declared

    def _source(self, name: str) -> Attributes:
        if name in self.own.element.attributes or self.declared is None:
            return self.own
        return Attributes(self.declared, self.own.subject, self.own._report)

    def text(self, name: str) -> str:
        return self._source(name).text(name)

    def number(self, name: str) -> float | None:
        return self._source(name).number(name)

    def flag(self, name: str) -> bool:
        return self._source(name).flag(name)

    def start(self, element: Element) -> Value | tuple[Value, ...] | None:
        """Return the start value; a tuple in FMI 3.0, where the shape is not known yet."""
        three = element is self.own.element
        if three and self.kind in ("String", "Binary"):
            found = tuple(child.get("value") for child in element.all("Start"))
            return found or None
        text = self.own.element.attributes.get("start")
        if text is None or self.kind == "Clock":
            return None
        if not three:
            return self._value(text.strip() if self.kind != "String" else text)
        values = tuple(self._value(word) for word in text.split())
        return values if all(value is not None for value in values) else None  # type: ignore[return-value]

    def _value(self, text: str) -> Value | None:
        value: Value | None
        if self.kind in FLOATS:
            value = to_float(text)
        elif self.kind in INTEGERS:
            value = int(text) if _WHOLE.fullmatch(text) else None
        elif self.kind == "Boolean":
            value = _FLAGS.get(text)
        else:
            return text
        if value is None:
            self.own.wrong("start", f"is not of type {self.kind}")
        return value


def to_float(text: str) -> float | None:
    """Return a number as XML Schema writes it, or None."""
    if not _FLOAT.fullmatch(text):
        return None
    return float(text)
