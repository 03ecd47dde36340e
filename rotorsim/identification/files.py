"""What an identification leaves behind: identification.json and the diagram with the values in it."""

from __future__ import annotations

import copy
import json
import math
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.diagram.grouping import dissolve
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.parse.source import read_document
from rotorsim.errors import Problem, RotorsimError
from rotorsim.files import write_atomically
from rotorsim.identification.result import Identification
from rotorsim.identification.verdict import Verdict

DIAGRAM = "diagram.json"
IDENTIFICATION_FILE = "identification.json"


def identification_data(identification: Identification, *, diagram_file: str = DIAGRAM) -> dict[str, Any]:
    """Return an identification as plain data, in the form of identification.json."""
    names = list(identification.parameters)
    parameters = {
        name: {
            "value": item.value,
            "std": _finite(item.std),
            "interval90": [_finite(end) for end in item.interval90],
            "joint90": [_finite(end) for end in item.joint90],
            "unit": item.unit,
            "at_bound": item.at_bound,
        }
        for name, item in identification.parameters.items()
    }
    advice = [
        {
            "change": item.change,
            "solves": list(item.solves),
            "expected_std": {name: _finite(value) for name, value in zip(names, item.std, strict=True)},
        }
        for item in identification.advice
    ]
    return {
        "method": identification.method,
        "diagram": diagram_file,
        "parameters": parameters,
        "correlation": {"names": names, "matrix": np.asarray(identification.correlation).tolist()},
        "identifiable": {name: _verdict(item.verdict) for name, item in identification.parameters.items()},
        "fit": {use: dict(values) for use, values in identification.fit.items()},
        "noise_floor": dict(identification.noise_floor),
        "adequate": identification.adequate,
        **identification.misfit_data(),
        "next_experiment": advice,
        "statement": identification.statement,
        "warnings": [f"{problem.subject}: {problem.what}" for problem in identification.warnings],
        "runs": identification.run_ids,
        "settings": dict(identification.settings),
        "provenance": {"diagram": identification.diagram.name, "diagram_sha256": identification.diagram.sha256},
    }


def _verdict(verdict: Verdict) -> dict[str, Any]:
    said: dict[str, Any] = {"identifiable": verdict.identifiable, "reason": verdict.reason}
    if verdict.combination is not None:
        said["combination"] = {"expression": verdict.combination.expression, **asdict(verdict.combination)}
    return said


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def with_values(diagram: Diagram, free: list[tuple[Free, float]]) -> dict[str, Any]:
    """Return the document of a diagram with values put in place of free parameters (SI, with their unit).

    Blocks that were removed (``--without``) are left out, with their wires and what was free in them. Sub-diagrams with
    free parameters of blocks inside are dissolved: their files stay as they are.
    Raises RotorsimError where the file of one is not known.
    """
    document = _without_removed(copy.deepcopy(dict(diagram.document)), diagram)
    names = {item.base: item.base for item, _ in free}
    document = _with_inner(document, diagram, free, names)
    for item, value in free:
        block, _, key = names[item.base].rpartition(".")
        if item.base in diagram.parameters and "/" not in item.base:
            before, values = document["parameters"].get(item.base), diagram.parameters[item.base]
            document["parameters"][item.base] = _replaced(values, item, _text(item, value), before)
        elif block:
            parameters = document["blocks"][block].setdefault("parameters", {})
            values = diagram.nodes[item.base.rpartition(".")[0]].values[item.base.rpartition(".")[2]]
            parameters[key] = _replaced(values, item, _text(item, value), parameters.get(key))
    return document


def _text(item: Free, value: float) -> Any:
    return value if item.unit in ("", "1") else f"{value!r} {item.unit}"


def _with_inner(
    document: dict[str, Any], diagram: Diagram, free: list[tuple[Free, float]], names: dict[str, str]
) -> dict[str, Any]:
    """Put values of parameters of sub-diagrams ("drive/k") in place, and dissolve those with other free ones.

    names: free parameter -> its name in the document, which is changed.
    """
    while True:
        for item, value in free:
            part, slash, key = names[item.base].partition("/")
            if slash and "." not in key and "/" not in key:
                given = document["blocks"][part].setdefault("parameters", {})
                given[key] = _replaced(diagram.parameters[item.base], item, _text(item, value), given.get(key))
                names[item.base] = key  # it is in place
        inside = next((name for name in names.values() if "/" in name), None)
        if inside is None:
            return document
        part = inside.partition("/")[0]
        if diagram.folder is None:
            what = "is inside of a sub-diagram, whose file is not known"
            raise RotorsimError(Problem(what, inside, hint="load the diagram from its file"))
        inner = read_document(Path(diagram.folder) / document["blocks"][part]["file"]).data
        document, moved = dissolve(document, part, inner)
        for base, name in names.items():
            owner, _, rest = name.partition("/")
            if owner == part and rest:
                block = re.split(r"[./]", rest, maxsplit=1)[0]
                names[base] = moved.get(block, block) + rest[len(block) :]


def _without_removed(document: dict[str, Any], diagram: Diagram) -> dict[str, Any]:
    def is_there(name: str) -> bool:
        return name in diagram.nodes or any(node.startswith(f"{name}/") for node in diagram.nodes)

    removed = {name for name in document["blocks"] if not is_there(name)}
    if not removed:
        return document

    def touches(end: Any) -> bool:
        return str(end).partition(".")[0].partition("/")[0] in removed

    followed = {reference for node in diagram.nodes.values() for reference in node.references.values()}
    document["blocks"] = {name: block for name, block in document["blocks"].items() if name not in removed}
    document["wires"] = [wire for wire in document.get("wires", []) if not any(touches(end) for end in wire)]
    for key in ("record",):
        if key in document:
            document[key] = [name for name in document[key] if not touches(name)]
    idle = {name for name in document.get("parameters", {}) if name not in followed}
    if "parameters" in document:
        document["parameters"] = {n: v for n, v in document["parameters"].items() if n not in idle}
    for key in ("identify", "layout"):
        if key in document:
            document[key] = {n: v for n, v in document[key].items() if not touches(n) and n not in idle}
    return document


def _replaced(values: np.ndarray, free: Free, text: Any, before: Any) -> Any:
    """Return a parameter's JSON value with one entry replaced."""
    if values.ndim == 0:
        return text
    unit = free.unit
    if not (isinstance(before, list) and np.shape(before) == values.shape):
        before = (
            [float(v) if unit in ("", "1") else f"{float(v)!r} {unit}" for v in values]
            if values.ndim == 1
            else (values.tolist())
        )
    index = np.unravel_index(free.entry, values.shape)
    inner = before = copy.deepcopy(before)
    for k in index[:-1]:
        inner = inner[int(k)]
    inner[int(index[-1])] = text
    return before


def save_identification(identification: Identification, folder: str | Path) -> list[Path]:
    """Write identification.json and diagram.json into a folder (made if need be); return the files."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    known = {item.name: item for item in identification.diagram.free}
    values = [
        (known[name], item.value)
        for name, item in identification.parameters.items()
        if name in known and known[name].low <= item.value <= known[name].high  # else the diagram would be refused
    ]
    document = with_values(identification.diagram, values)
    files = [folder / IDENTIFICATION_FILE, folder / DIAGRAM]
    write_atomically(files[0], json.dumps(identification_data(identification), indent=2, allow_nan=False) + "\n")
    write_atomically(files[1], format_document(document))
    return files
