"""The canonical form of a diagram document: one wire a line, so that differences are small."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from rotorsim.diagram.parse.form import BLOCK_KEYS, DOCUMENT_KEYS
from rotorsim.errors import Problem, RotorsimError

LINE_WIDTH = 120


def format_document(data: Mapping[str, Any]) -> str:
    """Return the canonical text of a document; values and the order of blocks and wires stay as they are.

    Raises RotorsimError for what JSON cannot hold (NaN, an array).
    """
    lines = []
    for key in _ordered(data, DOCUMENT_KEYS):
        value = data[key]
        if key == "blocks" and isinstance(value, Mapping):
            value = {name: _block(block) for name, block in value.items()}
        by_line = key in ("parameters", "blocks", "layout", "wires", "ports", "identify")
        lines.append(f"  {_text(key)}: {_value(value, '  ', len(key) + 6, by_line)}")
    return "{\n" + ",\n".join(lines) + "\n}\n" if lines else "{}\n"


def _ordered(data: Mapping[str, Any], known: Iterable[str]) -> list[str]:
    return [*(k for k in known if k in data), *(k for k in data if k not in known)]


def _block(block: Any) -> Any:
    return {key: block[key] for key in _ordered(block, BLOCK_KEYS)} if isinstance(block, Mapping) else block


def _text(value: Any) -> str:
    try:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise RotorsimError(
            Problem(f"cannot be written as JSON: {error}", hint="use finite numbers, texts, lists and mappings")
        ) from None


def _value(value: Any, indent: str, used: int, by_line: bool = False) -> str:
    """Return a value on one line if it fits (and need not be broken), else one entry a line."""
    flat = _text(value)
    if not isinstance(value, Mapping | list) or not value or (len(flat) + used + 1 <= LINE_WIDTH and not by_line):
        return flat
    inner = indent + "  "
    if isinstance(value, Mapping):
        entries = [f"{inner}{_text(k)}: {_value(v, inner, len(inner) + len(k) + 4)}" for k, v in value.items()]
        return "{\n" + ",\n".join(entries) + f"\n{indent}}}"
    entries = [inner + _value(v, inner, len(inner)) for v in value]
    return "[\n" + ",\n".join(entries) + f"\n{indent}]"
