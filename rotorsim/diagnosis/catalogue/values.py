"""Values of parameters in the document of a diagram."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def values_in(document: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """Return a document with SI values in place of those of parameters ("e", "rub.gap", "bearing.k[2]") that it has."""
    parameters, blocks = dict(document.get("parameters", {})), dict(document["blocks"])
    for name, value in values.items():
        base, _, inside = name.partition("[")
        block, _, key = base.rpartition(".")
        if base in parameters:
            parameters[base] = _replaced(parameters[base], inside, float(value))
        elif block in blocks:
            own = blocks[block].get("parameters", {})
            changed = {**own, key: _replaced(own.get(key), inside, float(value))}
            blocks[block] = {**blocks[block], "parameters": changed}
    return {**document, "parameters": parameters, "blocks": blocks}


def value_at(document: Mapping[str, Any], name: str) -> float:
    """Return the number that a document states for a parameter of a block ("play.width")."""
    block, _, key = name.rpartition(".")
    return float(document["blocks"][block]["parameters"][key])


def structure_of(document: Mapping[str, Any]) -> str:
    """Return what is the same of documents that differ in values alone: types and laws of blocks, and all wires."""
    blocks = {
        name: [block["type"], {k: v for k, v in block.get("parameters", {}).items() if k == "law"}]
        for name, block in document.get("blocks", {}).items()
    }
    return json.dumps([blocks, document.get("wires"), document.get("measured")], sort_keys=True)


def _replaced(before: Any, inside: str, value: float) -> Any:
    """Return a parameter's JSON value with one entry ("2" or "3,1]" of it, counted from 1) replaced."""
    if not inside:
        return value
    if not isinstance(before, list):
        return before  # one value for all entries: each is found again from there
    head, _, rest = inside.rstrip("]").partition(",")
    out = list(before)
    out[int(head) - 1] = _replaced(out[int(head) - 1], rest, value)
    return out
