"""Constant tables in C."""

from __future__ import annotations

from collections.abc import Iterable


def number(value: float) -> str:
    """Return a number in C."""
    if value != value:
        return "NAN"
    if value in (float("inf"), float("-inf")):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


def text(value: str) -> str:
    """Return a text in C, of its bytes in UTF-8."""
    shown = (chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in value.encode())
    return '"' + "".join(shown) + '"'


def table(kind: str, name: str, entries: Iterable[str], empty: str = "0") -> str:
    """Return a constant array, never empty."""
    given = list(entries) or [empty]
    lines = [", ".join(given[k : k + 12]) for k in range(0, len(given), 12)]
    return f"static const {kind} {name}[] = {{\n  " + ",\n  ".join(lines) + "\n};"
