"""Free parameters: what the ``identify`` key of a diagram leaves to be estimated from recordings."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorsim.block import Param
from rotorsim.diagram.diagram import Diagram, Free, Node
from rotorsim.diagram.parse.source import JsonPath, Source
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.errors import Problem, Problems, near_miss

FREE_KEYS = ("low", "high", "prior", "description")
PRIOR_KEYS = ("mean", "std")
MOST = 1e100
COLLAPSED = 1e-3  # of what is usual: a value below says nothing of its size (an earlier fit may have ended at a bound)
_NAME = re.compile(r"([A-Za-z_][\w./]*?)(?:\[\s*(\d{1,6}(?:\s*,\s*\d{1,6})*)\s*\])?")
_PERCENT = re.compile(r"\s*([0-9.eE+-]+)\s*%\s*")


@dataclass
class _Quantity:
    """What a name stands for: its value, unit, the declarations that bound it, and sizes that are usual."""

    value: np.ndarray
    unit: str
    declared: list[Param]
    usual: list[float]


class _Reader:
    def __init__(
        self,
        source: Source,
        parameters: Mapping[str, np.ndarray],
        units: Mapping[str, str],
        nodes: Mapping[str, Node],
        structural: Mapping[str, str],
    ) -> None:
        self.source, self.parameters, self.units, self.nodes = source, parameters, units, nodes
        self.structural = structural
        self.problems = Problems()

    def error(self, what: str, path: JsonPath, hint: str = "", *, key: bool = False) -> None:
        subject = f"identify.{path[1]}" if len(path) > 1 else "identify"
        self.problems.error(what, subject, self.source.place(path, key=key), hint)

    def unknown_keys(self, given: Mapping[str, Any], known: tuple[str, ...], path: JsonPath) -> None:
        for key in [key for key in given if key not in known]:
            self.error(f"unknown key '{key}'", (*path, key), near_miss(str(key), known), key=True)

    def quantity(self, base: str) -> _Quantity | None:
        if base in self.parameters:
            nodes = self.nodes.values()
            followers = [(node, key) for node in nodes for key, followed in node.references.items() if followed == base]
            declared = [node.block.parameters[key] for node, key in followers]
            usual = [size for node, key in followers for size in _usual(node, key)]
            return _Quantity(self.parameters[base], self.units.get(base, "1"), declared, usual)
        block, _, key = base.rpartition(".")
        if block not in self.nodes or key not in self.nodes[block].values:
            return None
        node = self.nodes[block]
        own = node.block.parameters[key]
        return _Quantity(node.values[key], own.unit or "1", [own], _usual(node, key))

    def is_speed(self, base: str) -> bool:
        """Return whether a parameter is the speed of a shaft: a recording measures it."""
        clocks = {name: node for name, node in self.nodes.items() if node.block.category == "clock"}
        followed = [node.references.get("speed") for node in clocks.values()]
        return base in followed or base in [f"{name}.speed" for name in clocks]

    def one(self, name: str, given: Any) -> list[Free]:
        """Return the entries that a name leaves free."""
        path: JsonPath = ("identify", name)
        match = _NAME.fullmatch(name)
        base, inside = match.groups() if match else ("", None)
        quantity = self.quantity(base)
        if quantity is None:
            blocks = (f"{block}.{key}" for block, node in self.nodes.items() for key in node.values)
            hint = near_miss(name, [*self.parameters, *blocks], list_all=False)
            self.error("no such parameter", path, hint, key=True)
            return []
        if self.is_speed(base):
            self.error("is measured, so that it cannot be free", path, key=True)
            return []
        if base in self.structural:
            hint = "free a parameter of the block: options stay as they are"
            self.error(f"is followed by the option {self.structural[base]}", path, hint, key=True)
            return []
        if not isinstance(given, Mapping):
            self.error("must be an object", path, '{} leaves it free; {"low": 0, "prior": {"std": "5 %"}} says more')
            return []
        self.unknown_keys(given, FREE_KEYS, path)
        block, _, key = base.rpartition(".")
        followed = self.nodes[block].references.get(key) if block else None
        if followed:
            self.error(f"follows the diagram parameter '{followed}'", path, f'write "{followed}" here', key=True)
            return []
        free = (self.entry(base, index, quantity, given, path) for index in self.entries(inside, quantity, path))
        return [item for item in free if item is not None]

    def entries(self, inside: str | None, quantity: _Quantity, path: JsonPath) -> list[tuple[int, ...]]:
        shape = quantity.value.shape
        if inside is None:
            return list(np.ndindex(*shape)) if shape else [()]
        index = tuple(int(part) - 1 for part in inside.split(","))
        if len(index) != len(shape) or any(not 0 <= i < n for i, n in zip(index, shape, strict=True)):
            size = " x ".join(map(str, shape)) or "a single number"
            self.error(f"no such entry; the parameter is {size}, counted from 1", path, key=True)
            return []
        return [index]

    def entry(
        self, base: str, index: tuple[int, ...], quantity: _Quantity, given: Mapping[str, Any], path: JsonPath
    ) -> Free | None:
        value = float(quantity.value[index])
        low = max((bound for d in quantity.declared if (bound := _lowest(d, value)) is not None), default=-math.inf)
        high = min((d.high for d in quantity.declared if d.high is not None), default=math.inf)
        before = len(self.problems)
        declared = low, high
        low = self.number(given, "low", quantity.unit, path, low)
        high = self.number(given, "high", quantity.unit, path, high)
        if low < declared[0] or high > declared[1]:
            end = "low" if low < declared[0] else "high"
            self.error(
                f"the block allows {declared[0]:g} .. {declared[1]:g} {quantity.unit}",
                (*path, end),
                f"bounds can only be narrowed: leave '{end}' out of identify, for the block has its own",
            )
        if not isinstance(given.get("description", ""), str):
            self.error("must be a text", (*path, "description"))
        mean = std = None
        if "prior" in given:
            mean, std = self.prior(given["prior"], value, quantity.unit, (*path, "prior"))
        name = f"{base}[{','.join(str(i + 1) for i in index)}]" if index else base
        if len(self.problems) > before:
            return None
        if not low < high:
            self.error(f"low {low:g} is not below high {high:g}", path)
        elif mean is not None and not low <= mean <= high:
            self.error(f"its mean {mean:g} {quantity.unit} is outside the bounds {low:g} .. {high:g}", (*path, "prior"))
        elif not low <= value <= high:
            self.error(f"the value {value:g} {quantity.unit} is outside its bounds {low:g} .. {high:g}", path)
        else:
            flat = int(np.ravel_multi_index(index, quantity.value.shape)) if index else 0
            usual = std or next((size for size in quantity.usual if size), 0.0)
            scale = abs(value) if abs(value) > COLLAPSED * usual else usual
            series = bool(quantity.declared) and all(declared.series for declared in quantity.declared)
            return Free(name, base, flat, value, quantity.unit, low, high, mean, std, scale, series)
        return None

    def number(self, given: Mapping[str, Any], key: str, unit: str, path: JsonPath, default: float) -> float:
        if key not in given:
            return default
        try:
            value = numeric(given[key], unit)
            if value.ndim:
                raise ValueProblem("must be one number")
            return float(value)
        except ValueProblem as problem:
            self.error(problem.what, (*path, key), problem.hint)
            return default

    def prior(self, given: Any, value: float, unit: str, path: JsonPath) -> tuple[float | None, float | None]:
        """Return mean and standard deviation of a normal prior."""
        hint = 'for example {"mean": "2 kg", "std": "1 %"}; the mean is the value in the diagram unless it is given'
        if not isinstance(given, Mapping) or "std" not in given:
            self.error("a prior is an object with 'std'", path, hint)
            return None, None
        self.unknown_keys(given, PRIOR_KEYS, path)
        mean = self.number(given, "mean", unit, path, value)
        percent = _PERCENT.fullmatch(given["std"]) if isinstance(given["std"], str) else None
        try:
            std = abs(mean) * float(percent[1]) / 100 if percent else self.number(given, "std", unit, path, math.nan)
        except ValueError:
            self.error(f"cannot read '{given['std']}'", (*path, "std"), hint)
            return None, None
        if std <= 0 or std > MOST:
            self.error(f"the standard deviation must be {'positive' if std <= 0 else 'finite'}", (*path, "std"))
        return mean, std


def _usual(node: Node, key: str) -> list[float]:
    """Return the sizes that a block declares for a parameter: its default, and where a diagnosis starts."""
    default = node.block.parameters[key].default
    starts = [start for fault in node.block.faults for start in fault.free.get(key, ())]
    sizes = [*(np.ravel(default).tolist() if default is not None else []), *starts]
    return [abs(float(size)) for size in sizes if isinstance(size, int | float)]


def _lowest(declared: Param, value: float) -> float | None:
    """Return the closed lower bound; an open one is left by a thousandth of the way to the value."""
    if declared.above is not None:
        return declared.above + 1e-3 * max(value - declared.above, 0.0)
    return declared.low


def unknown_names(
    source: Source, given: Mapping[str, Any], parameters: Collection[str], blocks: Mapping[str, Collection[str]]
) -> list[Problem]:
    """Return the names under ``identify`` that cannot be right, before blocks have values.

    blocks: block -> names of its parameters; blocks that are not in it (broken, removed) are passed over.
    """
    problems = Problems()
    known = [*parameters, *(f"{block}.{key}" for block, keys in blocks.items() for key in keys)]
    for name in given:
        match = _NAME.fullmatch(str(name))
        base = match[1] if match else ""
        block, dot, key = base.rpartition(".")
        if base in parameters or (dot and (block not in blocks or key in blocks[block])):
            continue
        place = source.place(("identify", name), key=True)
        hint = near_miss(str(name), known, list_all=False)
        problems.error("no such parameter", f"identify.{name}", place, hint)
    return problems


def free_parameters(
    source: Source,
    given: Mapping[str, Any],
    parameters: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    nodes: Mapping[str, Node],
    removed: Collection[str] = (),
    structural: Mapping[str, str] | None = None,
) -> tuple[tuple[Free, ...], list[Problem]]:
    """Return the free parameters that ``identify`` of a document names, and what is wrong with them.

    A name is a diagram parameter, ``block.parameter``, or an entry of one (``support.stiffness[2]``); a name
    without an index stands for all entries. Bounds are those that the block declares unless they are narrowed.
    Parameters of blocks that were removed are passed over. structural: diagram parameter -> an option that follows it.
    """
    reader = _Reader(source, parameters, units, nodes, structural or {})
    free: dict[str, Free] = {}
    for name, value in given.items():
        followed = any(name in node.references.values() for node in nodes.values())
        if str(name).rpartition(".")[0] in removed or (removed and name in parameters and not followed):
            continue
        for item in reader.one(str(name), value):
            if item.name in free:
                reader.error(f"'{item.name}' is named twice", ("identify", name), key=True)
            free[item.name] = item
    return tuple(free.values()), reader.problems


def uncertain(diagram: Diagram) -> dict[str, float]:
    """Return the parameters that blocks declare with a tolerance, which nobody measured, and are not free; with it.

    Of a parameter that is free in part, the other entries.
    """
    free = {(item.base, item.entry) for item in diagram.free}
    found: dict[str, float] = {}
    for name, node in diagram.nodes.items():
        for key, declared in node.block.parameters.items():
            full, shape = f"{name}.{key}", node.values[key].shape
            if declared.tolerance is None or key in node.references:
                continue
            held = [k for k in range(int(np.prod(shape))) if (full, k) not in free]
            whole = len(held) == np.prod(shape)
            entries = (",".join(str(i + 1) for i in np.unravel_index(k, shape)) for k in held)
            found |= dict.fromkeys([full] if whole else [f"{full}[{one}]" for one in entries], declared.tolerance)
    return found


def uncertain_parameters(diagram: Diagram) -> tuple[Free, ...]:
    """Return what is `uncertain` as free parameters, whose priors are the tolerances."""
    given = {name: {"prior": {"std": tolerance}} for name, tolerance in uncertain(diagram).items()}
    units = diagram.parameter_units
    found, _ = free_parameters(Source(given), given, diagram.parameters, units, diagram.nodes)
    return found
