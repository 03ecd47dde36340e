"""The JSON Schema of diagrams, generated from the declarations of all blocks, so that editors complete."""

from __future__ import annotations

import json
from typing import Any

from rotorsim.block import Block, Option, Param
from rotorsim.diagram.resolve.registry import all_types
from rotorsim.diagram.solver import SOLVER_METHODS

_NAME = "^[A-Za-z_][A-Za-z0-9_]*$"
_PORT = r"^[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*\.[A-Za-z_][A-Za-z0-9_]*(\[\s*[0-9]+(\s*,\s*[0-9]+)*\s*\])?$"
_JSON_TYPE = {bool: "boolean", int: "integer", float: "number", str: "string"}
_REFERENCE = {"type": "string", "pattern": r"^\$"}


def json_schema() -> dict[str, Any]:
    """Return the schema (draft 2020-12) of diagram documents with all built-in block types."""
    blocks = [_block(kind) for kind in all_types().values()]
    sub = {
        "properties": {
            "type": {"const": "diagram", "description": "A diagram in a file of its own."},
            "file": {"type": "string", "description": "File inside the folder of this diagram."},
            "parameters": {"type": "object"},
            "description": {"type": "string"},
        },
        "required": ["type", "file"],
        "additionalProperties": False,
    }
    # of types that are not built in: user files, entry points
    foreign = {"properties": {"type": {"type": "string", "not": {"enum": [*all_types(), "diagram"]}}}}
    quantity = {"$ref": "#/$defs/quantity"}
    top: dict[str, Any] = {
        "$schema": {"type": "string"},
        "schema_version": {"const": 1},
        "name": {"type": "string"},
        "description": {"type": "string"},
        "parameters": {"type": "object", "propertyNames": {"pattern": _NAME}},
        "blocks": {
            "type": "object",
            "propertyNames": {"pattern": _NAME},
            "additionalProperties": {"type": "object", "required": ["type"], "anyOf": [*blocks, sub, foreign]},
        },
        "wires": {
            "type": "array",
            "items": {"type": "array", "items": {"$ref": "#/$defs/port"}, "minItems": 2, "maxItems": 2},
        },
        "solver": {
            "type": "object",
            "additionalProperties": False,
            "properties": {
                "method": {"enum": list(SOLVER_METHODS)},
                "record_every": {"type": "integer", "minimum": 1},
                **dict.fromkeys(("step", "stop", "rtol", "atol"), quantity),
            },
        },
        "record": {"type": "array", "items": {"$ref": "#/$defs/port"}},
        "measured": {
            "type": "object",
            "description": "What a recording calls the first signal is the second one in this diagram.",
            "propertyNames": {"pattern": _PORT},
            "additionalProperties": {"$ref": "#/$defs/port"},
        },
        "algebraic_loops": {"enum": ["refuse", "solve"]},
        "block_folders": {"type": "array", "items": {"type": "string"}},
        "ports": {
            "type": "object",
            "additionalProperties": False,
            "properties": {"inputs": {"type": "object"}, "outputs": {"type": "object"}},
        },
        "identify": {
            "type": "object",
            "description": "Parameters left free: estimated from recordings by `rotorsim identify`.",
            "additionalProperties": {
                "type": "object",
                "additionalProperties": False,
                "properties": {
                    "low": quantity,
                    "high": quantity,
                    "description": {"type": "string"},
                    "prior": {
                        "type": "object",
                        "additionalProperties": False,
                        "properties": {"mean": quantity, "std": quantity},
                        "required": ["std"],
                    },
                },
            },
        },
        "layout": {
            "type": "object",
            "additionalProperties": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
        },
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "rotorsim diagram",
        "type": "object",
        "required": ["blocks"],
        "additionalProperties": False,
        "properties": top,
        "$defs": {
            "quantity": {"type": ["number", "string"], "description": "SI number, or text with a unit such as '24 um'"},
            "port": {"type": "string", "pattern": _PORT, "description": "block.port or block.port[i], counted from 1"},
        },
    }


def schema_text() -> str:
    """Return the schema as the text of diagrams/diagram.schema.json."""
    return json.dumps(json_schema(), indent=1, ensure_ascii=False) + "\n"


def _block(kind: type[Block]) -> dict[str, Any]:
    properties: dict[str, Any] = {name: _option(option) for name, option in kind.options.items()}
    properties.update({name: _parameter(parameter) for name, parameter in kind.parameters.items()})
    required = [name for name, option in kind.options.items() if option.default is None and option.kind is not None]
    required += [name for name, p in kind.parameters.items() if p.default is None]
    summary = (kind.__doc__ or "").strip().splitlines()
    parameters: dict[str, Any] = {"type": "object", "additionalProperties": False, "properties": properties}
    if required:
        parameters["required"] = required
    return {
        "properties": {
            "type": {"const": kind.type_name, "description": summary[0] if summary else kind.type_name},
            "parameters": parameters,
            "file": {"type": "string"},
            "description": {"type": "string"},
        },
        "required": ["type", *(["parameters"] if required else [])],
        "additionalProperties": False,
    }


def _parameter(parameter: Param) -> dict[str, Any]:
    unit = "" if parameter.unit in (None, "1") else f" [{parameter.unit}]"
    number: dict[str, Any] = {"type": "number"}
    for key, bound in (("minimum", parameter.low), ("maximum", parameter.high), ("exclusiveMinimum", parameter.above)):
        if bound is not None:
            number[key] = bound
    kinds: list[Any] = [number, {"type": "string"}]
    if parameter.shape != ():
        kinds.append({"type": "array"})
    described: dict[str, Any] = {"description": f"{parameter.doc}{unit}", "anyOf": kinds}
    if parameter.default is not None:
        described["default"] = parameter.default
    return described


def _option(option: Option) -> dict[str, Any]:
    unit = "" if option.unit in (None, "1") else f" [{option.unit}]"
    described: dict[str, Any] = {"description": f"{option.doc}{unit}"}
    if option.default is not None or option.kind is None:
        described["default"] = option.default
    if option.choices is not None and not option.is_list:
        return {**described, "anyOf": [{"enum": list(option.choices)}, _REFERENCE]}
    kinds = option.kind if isinstance(option.kind, tuple) else (option.kind,) if option.kind else ()
    entry: dict[str, Any] = {"type": [_JSON_TYPE[k] for k in kinds if k in _JSON_TYPE]} if kinds else {}
    for key, bound in (("minimum", option.low), ("maximum", option.high), ("exclusiveMinimum", option.above)):
        if bound is not None:
            entry[key] = bound
    if float in kinds and str not in kinds:
        entry = {"anyOf": [entry, {"type": "string"}]}  # a quantity
    if option.is_list:
        entry = {"type": "array", "items": entry}
    return {**described, "anyOf": [entry, _REFERENCE]} if entry else described
