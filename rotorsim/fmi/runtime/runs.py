"""Runs of variables that one FMI call can set or get: plain data for `Session`.

A run: {"type", "refs": value references, "n": values in all, "offset": of its first entry among all entries,
"index": places of its entries among the n values (None: all, in order), "discrete": set at events only}.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.model import FLOATS, INTEGERS, NUMERIC, Entry, FmuVariable, ModelDescription

__all__ = ["make_run", "make_runs"]


def make_runs(entries: Sequence[Entry], use: str) -> list[dict[str, Any]]:
    """Return the runs that entries make, in their order.

    use: "input" or "output" (numbers only, inputs can be set), "float" (floating point numbers only), "" (any).
    Raises RotorsimError with every entry that cannot be used so.
    """
    problems = [problem for entry in entries if (problem := _unfit(entry.variable, use))]
    if use == "input":
        names = [entry.name for entry in entries]
        twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
        problems += [Problem("is an input twice", name) for name in twice]
    if problems:
        raise RotorsimError(*dict.fromkeys(problems))
    runs: list[list[Entry]] = []
    for entry in entries:
        if not runs or _group(runs[-1][0], use) != _group(entry, use):
            runs.append([])
        runs[-1].append(entry)
    offset = 0
    made = []
    for run in runs:
        made.append(_run(run, offset))
        offset += len(run)
    return made


def make_run(
    description: ModelDescription, name: str, value: Any, *, sizes: bool = False
) -> tuple[dict[str, Any], list[Any]]:
    """Return the run of one variable and its values, converted to its type; sizes: structural parameters too.

    Raises RotorsimError.
    """
    entries = description.resolve([name])
    variable = entries[0].variable
    wrong = _unfit(variable, "")
    if wrong is None and variable.causality in ("independent", "calculatedParameter"):
        wrong = Problem(f"is of causality {variable.causality}: it cannot be set", name)
    if wrong is None and variable.variability == "constant":
        wrong = Problem("is a constant: it cannot be set", name)
    if wrong is None and variable.causality == "structuralParameter" and not sizes:
        hint = "give it when the FMU is opened: open_fmu(path, sizes={...}), or among the parameters of a block"
        wrong = Problem("is a structural parameter, which gives arrays their shapes", name, hint=hint)
    if wrong:
        raise RotorsimError(wrong)
    given = [value] * len(entries) if np.ndim(value) == 0 else list(np.ravel(value))
    if len(given) != len(entries):
        shape = list(variable.dimensions)
        raise RotorsimError(Problem(f"{len(given)} values for an array of shape {shape}", name))
    return _run(entries, 0), [_converted(variable, name, v) for v in given]


def _run(entries: Sequence[Entry], offset: int) -> dict[str, Any]:
    variables = list({id(entry.variable): entry.variable for entry in entries}.values())
    first, at = {}, 0
    for variable in variables:
        first[id(variable)] = at
        at += variable.size
    index = [first[id(entry.variable)] + entry.index for entry in entries]
    variable = variables[0]
    return {
        "type": variable.type,
        "refs": [v.reference for v in variables],
        "n": at,
        "offset": offset,
        "index": None if index == list(range(at)) else index,
        "discrete": variable.variability != "continuous",
    }


def _group(entry: Entry, use: str) -> tuple[str, bool]:
    """Return what entries of one run share; only of inputs some are set at other times than others."""
    return entry.variable.type, use == "input" and entry.variable.variability == "continuous"


def _unfit(variable: FmuVariable, use: str) -> Problem | None:
    """Return why a variable cannot be used so, or None."""
    name, place = variable.name, variable.place
    if variable.type == "Clock" or variable.clocked:
        what = "is a clock" if variable.type == "Clock" else "belongs to a clock"
        return Problem(f"{what}: clocks are not supported", name, place)
    if variable.type == "Binary":
        return Problem("is binary data, which is not supported", name, place)
    if use in ("input", "output") and variable.type not in NUMERIC:
        return Problem(f"is of type {variable.type}: only numbers can be exchanged", name, place)
    if use == "float" and variable.type not in FLOATS:
        return Problem(f"is of type {variable.type}: it has no derivatives", name, place)
    settable = variable.causality == "input" or (
        variable.causality == "parameter" and variable.variability == "tunable"
    )
    if use == "input" and not settable:
        return Problem(f"is of causality {variable.causality}, not an input", name, place)
    return None


def _converted(variable: FmuVariable, name: str, value: Any) -> Any:
    """Return a value as the type of the variable wants it. Raises RotorsimError."""
    value = value.item() if isinstance(value, np.generic) else value
    good: Any = None
    if variable.type in FLOATS and isinstance(value, int | float):
        good = float(value)
    elif variable.type in INTEGERS and isinstance(value, int | float) and float(value).is_integer():
        good = int(value)
    elif variable.type == "Boolean" and value in (False, True):
        good = bool(value)
    elif variable.type == "String" and isinstance(value, str):
        good = value
    if good is None or (isinstance(good, float) and not np.isfinite(good)):
        raise RotorsimError(Problem(f"{value!r} is not a value of type {variable.type}", name))
    return good
