"""Values of parameters in the document of a diagram."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["values_in"]


def values_in(document: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """Return a document with SI values in place of those of parameters ("e", "rub.gap", "bearing.k[2]") that it has."""
    new = {**document, "parameters": dict(document.get("parameters", {})), "blocks": dict(document["blocks"])}
    for name, value in values.items():
        base, _, inside = name.partition("[")
        block, _, key = base.rpartition(".")
        if not block:
            if base in new["parameters"]:
                new["parameters"][base] = _replaced(new["parameters"][base], inside, float(value))
        elif block in new["blocks"]:
            changed = dict(new["blocks"][block])
            parameters = dict(changed.get("parameters", {}))
            parameters[key] = _replaced(parameters.get(key), inside, float(value))
            new["blocks"][block] = {**changed, "parameters": parameters}
    return new


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
