"""What an identification leaves behind: identification.json and the diagram with the values in it."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.standalone import Standalone, standalone
from rotorsim.errors import Problem, RotorsimError
from rotorsim.files import write_atomically
from rotorsim.identification.result import Identification
from rotorsim.identification.verdict import Verdict
from rotorsim.model.load import load
from rotorsim.simulation.stable_step import with_stable_step
from rotorsim.units import parse_quantity

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
        "provenance": {"diagram": identification.diagram.name, "diagram_sha256": identification.sha256},
    }


def _verdict(verdict: Verdict) -> dict[str, Any]:
    said: dict[str, Any] = {"identifiable": verdict.identifiable, "reason": verdict.reason}
    if verdict.combination is not None:
        said["combination"] = {"expression": verdict.combination.expression, **asdict(verdict.combination)}
    return said


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def with_values(diagram: Diagram, free: list[tuple[Free, float]]) -> Standalone:
    """Return the document of a diagram with values put in place of free parameters (SI, with their unit).

    Blocks that were removed (``--without``) are left out, with their wires and what was free in them. Sub-diagrams with
    free parameters of blocks inside are dissolved: their files stay as they are.
    Raises RotorsimError where the file of one is not known.
    """
    alone = standalone(diagram, [item.base for item, _ in free])
    document = alone.document
    for item, value in free:
        name = alone.named(item.base)
        block, dot, key = name.rpartition(".")
        if dot:
            parameters = document["blocks"][block].setdefault("parameters", {})
        elif "/" in name:
            part, _, key = name.partition("/")
            parameters = document["blocks"][part].setdefault("parameters", {})
        else:
            parameters, key = document["parameters"], name
        owner, _, own = item.base.rpartition(".")
        values = diagram.nodes[owner].values[own] if dot else diagram.parameters[item.base]
        parameters[key] = _replaced(values, item, _text(item, value), parameters.get(key))
    return alone


def _text(item: Free, value: float) -> Any:
    return value if item.unit in ("", "1") else f"{value!r} {item.unit}"


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


@lru_cache(maxsize=1)  # for what is written, and what is said of it
def identified_diagram(identification: Identification) -> tuple[dict[str, Any], tuple[Problem, ...]]:
    """Return the document of the diagram with the identified values in it, and warnings; see `as_written`."""
    known = {item.name: item for item in identification.diagram.free}
    values = [
        (known[name], item.value)
        for name, item in identification.parameters.items()
        if name in known and known[name].low <= item.value <= known[name].high  # else the diagram would be refused
    ]
    return as_written(identification.diagram, values)


def as_written(diagram: Diagram, values: list[tuple[Free, float]]) -> tuple[dict[str, Any], tuple[Problem, ...]]:
    """Return the document of a diagram with values in it and a solver that is stable with them, and warnings.

    Of new names, another solver (the modes of finer meshes are faster), and inputs that a removed block leaves open.
    """
    alone = with_values(diagram, values)
    try:
        loaded = load(alone.document, folder=diagram.folder, trust_blocks=diagram.trusted)
    except RotorsimError as error:
        first = error.problems[0]
        what = f"what is written does not load: {first.subject}: {first.what}"
        hint = "a block that feeds it was left out: put a constant in its place"
        return alone.document, (*alone.notes, Problem(what, diagram.name, hint=hint, severity="warning"))
    document = with_stable_step(alone.document, loaded)
    solver = document.get("solver", {})
    if solver == alone.document.get("solver", {}):
        return document, tuple(alone.notes)
    step = f"{parse_quantity(solver['step'], 's'):.4g} s"
    how = f"the step {step}" if solver.get("method", "rk4") == "rk4" else f"the method {solver['method']}"
    what = f"what is written has {how}: its modes are too fast for the step of the diagram as given"
    return document, (*alone.notes, Problem(what, diagram.name, severity="warning"))


def save_identification(identification: Identification, folder: str | Path) -> list[Path]:
    """Write identification.json and diagram.json into a folder (made if need be); return the files."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    document, _ = identified_diagram(identification)
    files = [folder / IDENTIFICATION_FILE, folder / DIAGRAM]
    write_atomically(files[0], json.dumps(identification_data(identification), indent=2, allow_nan=False) + "\n")
    write_atomically(files[1], format_document(document))
    return files
