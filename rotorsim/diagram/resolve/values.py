"""JSON values to option values and SI numbers, with every mistake said by kind, unit and bound."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from rotorsim.block import Option, Param
from rotorsim.errors import near_miss
from rotorsim.units import UnitError, format_quantity, parse_quantity

MAX_DIMENSIONS = 8


class ValueProblem(Exception):  # noqa: N818 - it carries a problem, and is caught where it can be placed
    """What is wrong with a value, where in it (indices), and a hint."""

    def __init__(self, what: str, hint: str = "", path: tuple[int, ...] = ()) -> None:
        super().__init__(what)
        self.what, self.hint, self.path = what, hint, path


def numeric(value: Any, unit: str | None, *, bare: bool = False, path: tuple[int, ...] = ()) -> np.ndarray:
    """Return a number, a text with a unit, or a nested list of those as an SI array.

    bare: a text without a unit is a number in ``unit`` (values from the command line).
    Raises ValueProblem.
    """
    if isinstance(value, float | int) and not isinstance(value, bool):
        return _finite(value, path)
    if isinstance(value, list | tuple):
        if len(path) >= MAX_DIMENSIONS:
            raise ValueProblem("the list is nested too deeply", "write one number, [...] or [[...], ...]", path)
        if all(type(item) is float and math.isfinite(item) for item in value) and value:
            return np.array(value)
        parts = [numeric(item, unit, bare=bare, path=(*path, k)) for k, item in enumerate(value)]
        if not parts:
            raise ValueProblem("the list is empty", path=path)
        shapes = {np.shape(part) for part in parts}
        if len(shapes) > 1:
            raise ValueProblem("the rows of the list differ in length", path=path)
        return np.array(parts, dtype=float)
    if isinstance(value, str):
        try:
            return np.array(parse_quantity(value, unit, bare=bare))
        except UnitError as error:
            raise ValueProblem(error.what, error.hint, path) from None
    if isinstance(value, np.ndarray | np.number):
        return numeric(value.tolist(), unit, path=path)
    shown = {"NoneType": "null", "bool": str(value).lower(), "dict": "an object"}.get(type(value).__name__, "this")
    fitting = "" if unit in (None, "1") else f", or a text such as '1 {unit}'"
    raise ValueProblem(f"must be a number, not {shown}", f"write a number{fitting}", path)


def _finite(value: float, path: tuple[int, ...]) -> np.ndarray:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueProblem("must be a finite number", path=path)
    return np.array(number)


def bounds_problem(value: np.ndarray, declared: Param | Option) -> ValueProblem | None:
    """Return what is wrong if an entry is outside the declared bounds."""
    for bound, is_outside, extreme, words in (
        (declared.above, np.less_equal, np.min, "greater than"),
        (declared.low, np.less, np.min, "at least"),
        (declared.high, np.greater, np.max, "at most"),
    ):
        if bound is not None and is_outside(value, bound).any():
            given, limit = (format_quantity(float(v), declared.unit) for v in (extreme(value), bound))
            return ValueProblem(f"{given} must be {words} {limit}")
    return None


_KIND_WORDS = {
    int: "a whole number",
    float: "a number",
    str: "a text",
    bool: "true or false",
    list: "a list",
    dict: "an object",
}


def option_value(value: Any, declared: Option, *, bare: bool = False) -> Any:
    """Return an option value of the declared kind, choices and bounds, in SI; raise ValueProblem.

    bare: a text without a unit is a number in the declared unit (values from the command line).
    """
    is_list = declared.is_list
    kinds = declared.kind
    if kinds is None:
        sample = declared.default[0] if is_list and declared.default else declared.default
        kinds = () if is_list and not declared.default else type(sample) if sample is not None else ()
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    if is_list and not (list in kinds and declared.kind is not None):
        if not isinstance(value, list | tuple):
            raise ValueProblem(f"must be a list, not {_kind_of(value)}", "write [...]")
        return [_entry(item, kinds, declared, (k,), bare) for k, item in enumerate(value)]
    return _entry(value, kinds, declared, (), bare)


def _entry(value: Any, kinds: tuple[type, ...], declared: Option, path: tuple[int, ...], bare: bool) -> Any:
    is_number = isinstance(value, int | float | str) and not isinstance(value, bool)
    if float in kinds and str not in kinds and is_number:
        number = numeric(value, declared.unit, bare=bare, path=path)
        outside = bounds_problem(number, declared)
        if outside is not None:
            raise ValueProblem(outside.what, outside.hint, path)
        value = float(number)
    fits = not kinds or (type(value) in kinds) or (isinstance(value, tuple) and list in kinds)
    if not fits:
        words = " or ".join(_KIND_WORDS.get(kind, kind.__name__) for kind in kinds)
        raise ValueProblem(
            f"must be {words}, not {_kind_of(value)}",
            f"write {int(value)}" if isinstance(value, float) and int in kinds and value.is_integer() else "",
            path,
        )
    if declared.choices is not None and value not in declared.choices:
        shown = ", ".join(str(choice) for choice in declared.choices)
        raise ValueProblem(
            f"'{value}' is not a choice",
            near_miss(str(value), [str(c) for c in declared.choices], list_all=False) or f"one of: {shown}",
            path,
        )
    if isinstance(value, int | float) and not isinstance(value, bool):
        if declared.low is not None and value < declared.low:
            raise ValueProblem(f"{value} must be at least {declared.low}", path=path)
        if declared.high is not None and value > declared.high:
            raise ValueProblem(f"{value} must be at most {declared.high}", path=path)
    return value


def _kind_of(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, str):
        return f"the text '{value if len(value) < 40 else value[:37] + '...'}'"
    if isinstance(value, int | float):
        return f"the number {value}"
    return "a list" if isinstance(value, list | tuple) else "an object" if isinstance(value, dict) else "this"
