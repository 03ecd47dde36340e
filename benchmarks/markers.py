"""Put what a command prints between its markers in a document: <!-- NAME --> and the next <!-- end -->."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

__all__ = ["expect", "fill", "refuse", "table_text"]


def table_text(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, *rows]
    first, *rest = ("|" + "|".join(f" {cell} " if cell else " " for cell in line) + "|" for line in lines)
    return "\n".join([first, "|" + "---|" * len(head), *rest])


def refuse(what: str) -> NoReturn:
    """Say what is wrong with what was given, and exit 2."""
    print(f"error: {what}", file=sys.stderr)
    sys.exit(2)


def expect(file: Path | None, *names: str) -> None:
    """Exit 2 unless the document has the markers: before a long measurement, not after it."""
    for name in names if file else ():
        assert file is not None
        _split(file, name)


def fill(file: Path, name: str, text: str) -> None:
    """Replace what stands between the markers; read and write at once: a person may edit while a command runs."""
    before, after = _split(file, name)
    file.write_text(f"{before}\n{text}\n{after}", encoding="utf-8")


def _split(file: Path, name: str) -> tuple[str, str]:
    """Return a document up to the first marker, and from the second on."""
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        refuse(f"{file}: {error.strerror}")
    before, begins, rest = text.partition(f"<!-- {name} -->")
    old, ends, after = rest.partition("<!-- end -->")
    if not begins or not ends or "<!--" in old:
        refuse(f"{file}: no <!-- {name} --> with an <!-- end --> after it")
    return before + begins, ends + after
