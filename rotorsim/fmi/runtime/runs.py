"""Runs of variables that one FMI call can set or get: plain data for `Session`.

A run: {"type", "refs": value references, "n": values in all, "offset": of its first entry among all entries,
"index": places of its entries among the n values (None: all, in order), "discrete": set at events only}.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from itertools import accumulate, groupby
from typing import Any

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.model import FLOATS, INTEGERS, NUMERIC, Entry, FmuVariable, ModelDescription

_PYTHON: dict[str, Callable[[Any], Any]] = {**dict.fromkeys(FLOATS, float), "Boolean": bool, "String": str}  # else int


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
    runs = [list(run) for _, run in groupby(entries, key=lambda entry: _group(entry, use))]
    offsets = accumulate(map(len, runs), initial=0)
    return [_run(run, offset) for run, offset in zip(runs, offsets, strict=False)]


def make_run(
    description: ModelDescription, name: str, value: Any, *, sizes: bool = False
) -> tuple[dict[str, Any], list[Any]]:
    """Return the run of one variable and its values, converted to its type; sizes: structural parameters too.

    Raises RotorsimError.
    """
    entries = description.resolve([name])
    variable = entries[0].variable
    structural = "is a structural parameter, which gives arrays their shapes"
    reasons = {
        f"is of causality {variable.causality}: it cannot be set": variable.causality
        in ("independent", "calculatedParameter"),
        "is a constant: it cannot be set": variable.variability == "constant",
        structural: variable.causality == "structuralParameter" and not sizes,
    }
    why = next((why for why, is_so in reasons.items() if is_so), "")
    hint = "give it when the FMU is opened: open_fmu(path, sizes={...}), or among the parameters of a block"
    wrong = _unfit(variable, "") or (Problem(why, name, hint=hint if why == structural else "") if why else None)
    if wrong:
        raise RotorsimError(wrong)
    given = [value] * len(entries) if np.ndim(value) == 0 else list(np.ravel(value))
    if len(given) != len(entries):
        shape = list(variable.dimensions)
        raise RotorsimError(Problem(f"{len(given)} values for an array of shape {shape}", name))
    return _run(entries, 0), [_converted(variable, name, v) for v in given]


def _run(entries: Sequence[Entry], offset: int) -> dict[str, Any]:
    variables = list({id(entry.variable): entry.variable for entry in entries}.values())
    ends = list(accumulate((variable.size for variable in variables), initial=0))
    first = {id(variable): at for variable, at in zip(variables, ends, strict=False)}
    index = [first[id(entry.variable)] + entry.index for entry in entries]
    variable = variables[0]
    return {
        "type": variable.type,
        "refs": [v.reference for v in variables],
        "n": ends[-1],
        "offset": offset,
        "index": None if index == list(range(ends[-1])) else index,
        "discrete": variable.variability != "continuous",
    }


def _group(entry: Entry, use: str) -> tuple[str, bool]:
    """Return what entries of one run share; only of inputs some are set at other times than others."""
    return entry.variable.type, use == "input" and entry.variable.variability == "continuous"


def _unfit(variable: FmuVariable, use: str) -> Problem | None:
    """Return why a variable cannot be used so, or None."""
    settable = variable.causality == "input" or (
        variable.causality == "parameter" and variable.variability == "tunable"
    )
    reasons = {
        "is a clock: clocks are not supported": variable.type == "Clock",
        "belongs to a clock: clocks are not supported": variable.clocked,
        "is binary data, which is not supported": variable.type == "Binary",
        f"is of type {variable.type}: only numbers can be exchanged": use in ("input", "output")
        and variable.type not in NUMERIC,
        f"is of type {variable.type}: it has no derivatives": use == "float" and variable.type not in FLOATS,
        f"is of causality {variable.causality}, not an input": use == "input" and not settable,
    }
    return next((Problem(why, variable.name, variable.place) for why, is_so in reasons.items() if is_so), None)


def _converted(variable: FmuVariable, name: str, value: Any) -> Any:
    """Return a value as the type of the variable wants it. Raises RotorsimError."""
    value = value.item() if isinstance(value, np.generic) else value
    number = isinstance(value, int | float) and abs(value) <= sys.float_info.max
    good = {
        **dict.fromkeys(FLOATS, number),
        **dict.fromkeys(INTEGERS, number and float(value).is_integer()),
        "Boolean": value in (False, True),
        "String": isinstance(value, str),
    }
    if not good.get(variable.type):
        raise RotorsimError(Problem(f"{value!r} is not a value of type {variable.type}", name))
    return _PYTHON.get(variable.type, int)(value)
