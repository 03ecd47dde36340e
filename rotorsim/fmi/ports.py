"""Ports, parameters and options of a block of type ``fmu``: the variables of an FMU, grouped.

Variables are grouped by their structured names: ``rotor.force[1]``, ``rotor.force[2]`` are a port of shape 2. A first
part that all inputs and outputs share ("rotor.") is left out; other dots become underscores. The option ``ports``
groups and names them otherwise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.block import Option, Shape, matrix_shape, zeros
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.fmi.description.model import FLOATS, NUMERIC, Entry, FmuVariable, ModelDescription

_INDEX = re.compile(r"(.*?)\[(\d+(?:,\d+)*)\]")
TAKEN = ("file", "interface", "in_process", "linear", "ports", "timeout")  # options: a value of the FMU gets "_"
Named = tuple[tuple[str, tuple[str, ...] | str], ...]  # names of ports, variables of each: `named_ports`
_WORDS: dict[str, type] = {"Boolean": bool, "String": str}  # types whose values are given as such


@dataclass(frozen=True)
class FmuPort:
    """A port or parameter of an ``fmu`` block: the FMU's own names of its entries, row-major.

    Ports are in SI units, whatever the FMU has: scales (n, 2) are factor and offset of the entries, SI value = factor *
    value of the FMU + offset. start: SI.
    """

    name: str
    shape: Shape
    unit: str | None
    entries: tuple[str, ...]
    start: np.ndarray | None
    description: str
    scales: np.ndarray
    discrete: bool = False

    def to_si(self, values: Any) -> np.ndarray:
        """Return values (n,) of the FMU in SI units."""
        return np.asarray(self.scales[:, 0] * np.ravel(values) + self.scales[:, 1])

    def of_fmu(self, values: Any) -> np.ndarray:
        """Return SI values (n,) in the units of the FMU."""
        return np.asarray((np.ravel(values) - self.scales[:, 1]) / self.scales[:, 0])


@dataclass(frozen=True)
class FmuOption:
    """A value of a variable that is no number: true or false, a text, the name of an item, or the size of arrays."""

    name: str
    variable: FmuVariable
    default: Any
    items: Mapping[str, int]

    def of_fmu(self, value: Any) -> Any:
        """Return a value as the FMU has it."""
        if self.variable.negated and isinstance(value, bool):
            return not value
        return self.items.get(value, value) if isinstance(value, str) else value


def named_ports(given: Any) -> Named:
    """Return the option ``ports``, {name of a port: variable, or list of variables}. Raises RotorsimError."""
    form = '{"displacement": ["x", "y"], "force": ["F_x", "F_y"]}: variables of the FMU, by the names of ports'
    if not isinstance(given, Mapping):
        raise RotorsimError(Problem("must be an object", "ports", hint=form))
    named: list[tuple[str, tuple[str, ...] | str]] = []
    problems = []
    for name, members in given.items():
        texts = members if isinstance(members, list | tuple) else [members]
        if not isinstance(name, str):
            problems.append(Problem(f"{name} is no text", "ports", hint=form))
        elif not texts or not all(isinstance(text, str) for text in texts):
            problems.append(Problem(f"'{name}' is no variable or list of variables", "ports", hint=form))
        elif not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
            hint = "letters, digits and _, not a digit first"
            problems.append(Problem(f"'{name}' cannot be the name of a port", "ports", hint=hint))
        else:
            named.append((name, members if isinstance(members, str) else tuple(members)))
    every = [text for _, members in named for text in ((members,) if isinstance(members, str) else members)]
    twice = [text for text in dict.fromkeys(every) if every.count(text) > 1]
    problems += [Problem(f"the variable '{text}' is named twice", "ports", hint="each once") for text in twice]
    if problems:
        raise RotorsimError(*problems)
    return tuple(named)


def check_named(description: ModelDescription, named: Named) -> None:
    """Raise RotorsimError where the option ``ports`` names what are no inputs or outputs, or both in one port."""
    sides = {side: [v.name for v in description.by_causality(side)] for side in ("input", "output")}
    side_of = {name: side for side, names in sides.items() for name in names}
    side_of |= {entry.name: side for side, names in sides.items() for n in names for entry in description.entries(n)}
    arrays: dict[str, str] = {}  # base -> the first entry
    for name in side_of:
        if match := _INDEX.fullmatch(name):
            arrays.setdefault(match[1], name)
    side_of |= {base: side_of[name] for base, name in arrays.items()}
    every = {text for _, members in named for text in ((members,) if isinstance(members, str) else members)}
    problems = [
        Problem(f"'{text}' is an array, and one of its entries is named, too", "ports", hint="the array or its entries")
        for text in arrays.keys() & every
        if any(other != text and other.startswith(f"{text}[") for other in every)
    ]
    for name, members in named:
        if not isinstance(members, str):
            problems += [
                Problem(
                    f"'{text}' is an array", "ports", hint=f'"{name}": "{text}", or its entries, {arrays[text]}, ...'
                )
                for text in members
                if text in arrays
            ]
        texts = (members,) if isinstance(members, str) else members
        for text in (text for text in texts if text not in side_of):
            what = f"the FMU has no input or output '{text}'"
            problems.append(Problem(what, "ports", hint=near_miss(text, [*side_of])))
        if len({side_of[text] for text in texts if text in side_of}) > 1:
            what = f"'{name}' has inputs and outputs"
            problems.append(Problem(what, "ports", hint="a port is one or the other"))
    if problems:
        raise RotorsimError(*problems)


def ports_of(
    description: ModelDescription,
    causalities: Sequence[str],
    prefix: str,
    types: Sequence[str] = NUMERIC,
    named: Named = (),
) -> dict[str, FmuPort]:
    """Return the variables of some causalities grouped to ports: numbers; flags as 0 and 1."""
    lists = {text: (name, (k,)) for name, own in named if not isinstance(own, str) for k, text in enumerate(own, 1)}
    renamed = {text: name for name, text in named if isinstance(text, str)}
    groups: dict[tuple[str, str, int], list[tuple[tuple[int, ...], Entry]]] = {}
    usable = [v for v in description.by_causality(*causalities) if v.type in types and not v.clocked]
    for entry in (entry for variable in usable for entry in description.entries(variable.name)):
        match = _INDEX.fullmatch(entry.name)
        base, index = (match[1], tuple(map(int, match[2].split(",")))) if match else (entry.name, ())
        if entry.name in lists:
            name, index = lists[entry.name]
        elif entry.name in renamed:
            name, index = renamed[entry.name], ()
        else:
            name = renamed.get(base, "")
        key = (name, "", len(index)) if name else (port_name(base, prefix), base, len(index))
        groups.setdefault(key, []).append((index, entry))
    found: dict[str, FmuPort] = {}
    for (name, _, _), members in groups.items():
        port = _port(description, name, sorted(members, key=lambda member: member[0]))
        if port.name in found and "local" not in causalities:  # those inside need no name
            what = f"two variables would be called '{port.name}'"
            raise RotorsimError(Problem(what, description.name, description.place))
        found.setdefault(port.name, port)
    return found


def _port(description: ModelDescription, name: str, members: Sequence[tuple[tuple[int, ...], Entry]]) -> FmuPort:
    """Return the port of entries, which are given in the order of their indices."""
    indices, entries = np.array([index for index, _ in members]), [entry for _, entry in members]
    shape: Shape = tuple(int(n) for n in indices.max(axis=0)) if indices.size else ()
    if indices.size and (prod(shape) != len(members) or indices.min() != 1):
        shape = (len(members),)
    variable = entries[0].variable
    units = [description.unit_of(entry.variable) for entry in entries]
    scales = np.array([(unit.factor, unit.offset) if unit else (1.0, 0.0) for unit in units])
    given = [_as_given(entry.variable, *scale) for entry, scale in zip(entries, scales.tolist(), strict=True)]
    shown = {unit.si if unit else None for unit in units}
    port = FmuPort(
        name,
        shape,
        shown.pop() if len(shown) == 1 else None,
        tuple(entry.name for entry in entries),
        None,
        variable.description,
        np.array(given),
        variable.variability in ("discrete", "constant", "fixed"),
    )
    starts = [entry.start for entry in entries]
    if not all(isinstance(start, int | float) and math.isfinite(start) for start in starts):
        return port  # what is not finite cannot be given here: the FMU keeps it
    return replace(port, start=(scales[:, 0] * np.array(starts, float) + scales[:, 1]).reshape(shape))


def _as_given(variable: FmuVariable, factor: float, offset: float) -> tuple[float, float]:
    """Return factor and offset to SI of what the functions of the FMU have: of a negated alias -v, or not v."""
    return (-factor, offset + (variable.type == "Boolean")) if variable.negated else (factor, offset)


def port_name(base: str, prefix: str) -> str:
    """Return the name of a port for the base of variables' names."""
    text = base[len(prefix) :] if prefix and base.startswith(prefix) else base
    text = re.sub(r"\W", "_", text)
    return f"_{text}" if text[:1].isdigit() else text


def unit_warnings(description: ModelDescription) -> list[Problem]:
    """Return a warning for every unit of a variable at work that is neither defined nor known, and so fits anything."""
    names: dict[str, FmuVariable] = {}
    for v in description.by_causality("input", "output", "parameter"):
        if v.unit and v.type in FLOATS and description.unit_of(v) is None:
            names.setdefault(v.unit, v)
    return [
        Problem(
            f"the unit '{unit[:80]}' is neither defined in the FMU nor known: it is taken as it is and fits all",
            variable.name[:200],
            variable.place,
            severity="warning",
        )
        for unit, variable in names.items()
    ]


def silent(description: ModelDescription, outputs: Mapping[str, FmuPort], prefix: str) -> list[Problem]:
    """Return a warning where nothing of an FMU can be seen."""
    inside = [] if outputs else [*ports_of(description, ("local",), prefix)]
    shown = ", ".join(inside[:5]) + (", ..." if len(inside) > 5 else "")
    what = "it has no outputs, and none of the variables inside is recorded or wired"
    return [
        Problem(what, hint=f'"record": ["BLOCK.{first}"]; there are {shown}', severity="warning")
        for first in inside[:1]
    ]


def prefix_of(description: ModelDescription) -> str:
    """Return the first part "name." that all inputs and outputs share, or nothing."""
    names = [v.name for v in description.by_causality("input", "output")]
    first = {name.partition(".")[0] for name in names if "." in name.partition("[")[0]}
    return f"{first.pop()}." if len(first) == 1 and all("." in name.partition("[")[0] for name in names) else ""


def options_of(description: ModelDescription, prefix: str) -> dict[str, FmuOption]:
    """Return what is given as text, true or false, or the name of an item, and the sizes of arrays (FMI 3.0)."""
    found = {}
    for variable in description.by_causality("parameter", "input", "structuralParameter"):
        items = description.items.get(variable.declared_type, {}) if variable.type == "Enumeration" else {}
        sized = variable.causality == "structuralParameter"
        if variable.start is None or variable.clocked or not (variable.type in _WORDS or items or sized):
            continue
        name, start = value_name(port_name(variable.name, prefix)), variable.start
        if items and not variable.dimensions:
            start = next((item for item, value in items.items() if value == start), start)
        if not variable.dimensions or variable.type in _WORDS:
            found[name] = FmuOption(name, variable, list(start) if isinstance(start, tuple) else start, items)
    return found


def value_name(name: str) -> str:
    return f"{name}_" if name in TAKEN else name


def declared_option(option: FmuOption) -> Any:
    """Return the declaration of an option."""
    kind: Any = _WORDS.get(option.variable.type, int)
    more: dict[str, Any] = {"low": 0} if option.variable.causality == "structuralParameter" else {}
    if option.items:
        kind, more = (str, int), {"choices": (*option.items, *option.items.values())}
    return Option(option.default, name=option.name, kind=kind, doc=option.variable.description, **more)


def symbol_shape(shape: Shape) -> tuple[int, int]:
    """Return rows and columns of the symbol of a port, whose last index runs fastest."""
    return matrix_shape(shape) if len(shape) < 3 else (prod(shape), 1)


def begun(port: FmuPort) -> Any:
    """Return the value with which the FMU begins an input."""
    shape = symbol_shape(port.shape)
    return ca.SX(np.zeros(shape) if port.start is None else np.reshape(port.start, shape))


def unfed(block: Any, p: Any, name: str, port: FmuPort, start: bool = False) -> Any:
    """Return what is added to an input: its value where nothing feeds it; start: that with which it begins."""
    alone = name not in block.wired
    if alone and name in block.parameters and name not in block.fmu_parameters:
        return getattr(p, name)
    return begun(port) if alone or start else zeros(*symbol_shape(port.shape))
