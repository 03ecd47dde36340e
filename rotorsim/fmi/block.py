"""The block ``fmu``: its ports and parameters are those that the model description of an FMU states.

Variables are grouped by their structured names: ``rotor.force[1]``, ``rotor.force[2]`` are a port of shape 2. A first
part that all inputs and outputs share ("rotor.") is left out; other dots become underscores.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.block import (
    Block,
    Equations,
    In,
    Option,
    Out,
    Param,
    Shape,
    State,
    concatenate,
    matrix_shape,
    unflatten,
    zeros,
)
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.model import FLOATS, INTEGERS, NUMERIC, Entry, FmuVariable, ModelDescription
from rotorsim.fmi.functions import functions_of, held_inputs, moving_inputs
from rotorsim.fmi.mode import FmuMode
from rotorsim.fmi.runtime.slave import describe_fmu

_INDEX = re.compile(r"(.*?)\[(\d+(?:,\d+)*)\]")
_TAKEN = ("file", "interface", "in_process")  # options of the block itself; a value of the FMU of this name gets a "_"
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


def ports_of(
    description: ModelDescription, causalities: Sequence[str], prefix: str, types: Sequence[str] = NUMERIC
) -> dict[str, FmuPort]:
    """Return the variables of some causalities grouped to ports: numbers; flags as 0 and 1."""
    groups: dict[tuple[str, int], list[tuple[tuple[int, ...], Entry]]] = {}
    usable = [v for v in description.by_causality(*causalities) if v.type in types and not v.clocked]
    for entry in (entry for variable in usable for entry in description.entries(variable.name)):
        match = _INDEX.fullmatch(entry.name)
        index = tuple(map(int, match[2].split(","))) if match else ()
        groups.setdefault((match[1] if match else entry.name, len(index)), []).append((index, entry))
    found: dict[str, FmuPort] = {}
    for (base, _), members in groups.items():
        port = _port(description, port_name(base, prefix), sorted(members, key=lambda member: member[0]))
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


def _silent(description: ModelDescription, outputs: Mapping[str, FmuPort], prefix: str) -> list[Problem]:
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
        name, start = _value_name(port_name(variable.name, prefix)), variable.start
        if items and not variable.dimensions:
            start = next((item for item, value in items.items() if value == start), start)
        if not variable.dimensions or variable.type in _WORDS:
            found[name] = FmuOption(name, variable, list(start) if isinstance(start, tuple) else start, items)
    return found


def _value_name(name: str) -> str:
    return f"{name}_" if name in _TAKEN else name


def _option(option: FmuOption) -> Any:
    """Return the declaration of an option."""
    kind: Any = _WORDS.get(option.variable.type, int)
    more: dict[str, Any] = {"low": 0} if option.variable.causality == "structuralParameter" else {}
    if option.items:
        kind, more = (str, int), {"choices": (*option.items, *option.items.values())}
    return Option(option.default, name=option.name, kind=kind, doc=option.variable.description, **more)


@lru_cache(maxsize=64)
def _made(
    path: Path, _stamp: tuple[int, int], sizes: tuple[tuple[str, int], ...] = (), signals: frozenset[str] = frozenset()
) -> type[Block]:
    if sizes:  # given by the names of the block
        prefix = prefix_of(_made(path, _stamp).fmu_description)  # type: ignore[attr-defined]
        known = {port_name(v.name, prefix): v.name for v in describe_fmu(path).by_causality("structuralParameter")}
        description = describe_fmu(path, sizes={known[name]: size for name, size in sizes if name in known})
    else:
        description = describe_fmu(path)
    prefix = prefix_of(description)
    inputs = ports_of(description, ("input",), prefix)
    outputs = ports_of(description, ("output",), prefix)
    if not signals <= outputs.keys():
        inside = ports_of(description, ("local", "calculatedParameter", "parameter", "independent"), prefix)
        outputs |= {name: port for name, port in inside.items() if name in signals - outputs.keys()}
    options = options_of(description, prefix)
    resized = set(description.sizes)
    parameters = {
        _value_name(name): port
        for name, port in ports_of(description, ("parameter",), prefix, (*FLOATS, *INTEGERS)).items()
        if name not in options and (port.start is not None or resized)
    }
    body: dict[str, Any] = {
        "__doc__": f"{description.description or description.name} (FMU).\n\nIts equations are inside the FMU.",
        "type_name": "fmu",
        "category": "fmu",
        "opaque": True,
        "source": description.name,
        "fmu_block": "",
        "fmu_path": path,
        "fmu_description": description,
        "fmu_options": options,
        "fmu_warnings": [*description.warnings, *unit_warnings(description), *_silent(description, outputs, prefix)],
        "fmu_inputs": inputs,
        "fmu_outputs": outputs,
        "fmu_parameters": parameters,
        "no_signals": {
            port_name(v.name, prefix): "a text, no signal: cosim tells its last value"
            for v in description.by_causality("output")
            if v.type == "String" and not v.clocked
        },
        "file": Option(str(path), kind=str, doc="file of the FMU"),
        "interface": Option(
            "any",
            choices=("any", "cs", "me"),
            kind=str,
            doc="cs, me, or any: me where equations are asked for, cs to cosim",
        ),
        "in_process": Option(False, kind=bool, doc="load its code into this process: faster, but a crash is ours"),
    }
    for port in inputs.values():
        body[f"_i_{port.name}"] = In(
            name=port.name, shape=port.shape, unit=port.unit, doc=port.description, additive=True
        )
    for port in outputs.values():
        body[f"_o_{port.name}"] = Out(name=port.name, shape=port.shape, unit=port.unit, doc=port.description)
    starts = {
        name: port
        for name, port in inputs.items()
        if port.start is not None and name not in parameters and name not in options and name not in _TAKEN
    }
    body |= {f"_s_{name}": _option(option) for name, option in options.items()}
    for name, port in {**parameters, **starts}.items():
        body[f"_p_{name}"] = Param(
            port.start.tolist() if port.start is not None and port.shape else port.start,
            name=name,
            shape=port.shape,
            unit=port.unit,
            doc=port.description,
        )
    n_x = len(description.states)
    if n_x:
        body["_x"] = State(
            name="states",
            shape=(n_x,),
            unit=None,
            when=lambda option: _has_states(option, description),
            doc="those of the FMU, in its units",
        )
    body |= {"equations": _equations, "starts": _starts, "untraced": _not_traced, "mode": _mode}
    return type("Fmu", (Block,), body)


def _not_traced(block: Any) -> tuple[str, str]:
    """Return why an FMU has no equations that a trace can call, with a hint; nothing where it has."""
    description, interface = block.fmu_description, block.option.interface
    cosim = "`rotorsim run` co-simulates it"
    if interface == "cs" or "me" not in description.kinds:
        hidden = "for Co-Simulation, which hides its states and equations"
        if interface == "cs" and "me" in description.kinds:
            return f"is an FMU {hidden}", f'it offers Model Exchange, too: "interface": "me"; {cosim} as it is'
        return f"is an FMU {hidden}", f"{cosim}; export it for Model Exchange, too"
    if not description.states and (description.n_events or _is_sampled(description)):
        return "is an FMU with events and without states, which only a co-simulation carries out", cosim
    stepped = [name for name in held_inputs(block) if name in block.wired]
    if stepped:
        return f"is an FMU that takes its input {stepped[0]} at events only", cosim
    return "", ""


def _is_sampled(description: ModelDescription) -> bool:
    """Return whether all outputs change at events only."""
    outputs = description.by_causality("output")
    return bool(outputs) and all(v.variability == "discrete" for v in outputs)


def _equations(self: Block, p: Any, u: Any, x: Any, t: Any) -> Equations:
    """Return calls of an FMU for Model Exchange; zeros where only a co-simulation can run it."""
    block: Any = self
    description, ports = block.fmu_description, block.fmu_outputs
    n_x = len(description.states) if _has_states(block.option, description) else 0
    state = x.states if n_x else ca.SX(0, 1)
    if block.untraced()[0]:
        rates = {"states": zeros(n_x)} if n_x else {}
        return Equations({name: zeros(*_two(port.shape)) for name, port in ports.items()}, rates)
    functions = functions_of(block)
    moving, held = moving_inputs(block), held_inputs(block)
    fed = {name: concatenate([getattr(u, name) + _unfed(block, p, name, port)]) for name, port in moving.items()}
    values = _values(block, p, held)
    given = [t, state, concatenate([ca.SX(0, 1), *fed.values()]), values]
    together: dict[frozenset[str], dict[str, range]] = {}  # outputs that follow the same inputs at once
    at = n_x
    for name, port in ports.items():
        rows, at = range(at, at + len(port.entries)), at + len(port.entries)
        follows = frozenset(
            other
            for other, its in moving.items()
            if any(description.follows(y, one) for y in port.entries for one in its.entries)
        )
        together.setdefault(follows, {})[name] = rows
    outputs: dict[str, Any] = {}
    for follows, members in together.items():
        seen = [value if name in follows else concatenate([_begun(moving[name])]) for name, value in fed.items()]
        rows_of_all = [k for rows in members.values() for k in rows]
        groups = (True, bool(n_x), bool(follows), True)
        column = functions.call("y", rows_of_all, groups, [t, state, concatenate([ca.SX(0, 1), *seen]), values])
        for name, part in zip(members, _split(column, [len(rows) for rows in members.values()]), strict=True):
            outputs[name] = unflatten(part, _two(ports[name].shape))
    return Equations(outputs, {"states": functions.call("f", range(n_x), (True,) * 4, given)} if n_x else {})


def _starts(self: Block, p: Any) -> dict[str, Any]:
    """Return where the states begin, as the FMU says."""
    block: Any = self
    if block.untraced()[0] or not block.fmu_description.states:
        return {}
    moving = moving_inputs(block).items()
    fed = concatenate([ca.SX(0, 1), *(_unfed(block, p, name, port, start=True) for name, port in moving)])
    given = [ca.SX(0, 1), ca.SX(0, 1), fed, _values(block, p, held_inputs(block))]
    return {"states": functions_of(block).call("x0", None, (False, False, True, True), given)}


def _mode(self: Block, p: Any) -> FmuMode | None:
    """Return the mode of an FMU that may have events, or wants to be told of completed steps."""
    block: Any = self
    description = block.fmu_description
    if block.untraced()[0] or not _has_states(block.option, description):
        return None
    values = np.array(ca.DM(ca.evalf(_values(block, p, held_inputs(block))))).ravel()
    return FmuMode(functions_of(block).equations, values)


def _values(block: Any, p: Any, held: Mapping[str, FmuPort]) -> Any:
    """Return the values of parameters, then of inputs that are set once."""
    own = [getattr(p, name) for name in block.fmu_parameters]
    return concatenate([ca.SX(0, 1), *own, *(_unfed(block, p, name, port) for name, port in held.items())])


def _unfed(block: Any, p: Any, name: str, port: FmuPort, start: bool = False) -> Any:
    """Return what is added to an input: its value where nothing feeds it; start: that with which it begins."""
    alone = name not in block.wired
    if alone and name in block.parameters and name not in block.fmu_parameters:
        return getattr(p, name)
    return _begun(port) if alone or start else zeros(*_two(port.shape))


def _begun(port: FmuPort) -> Any:
    """Return the value with which the FMU begins an input."""
    return ca.SX(np.zeros(_two(port.shape)) if port.start is None else np.reshape(port.start, _two(port.shape)))


def _two(shape: Shape) -> tuple[int, int]:
    """Return rows and columns of the symbol of a port, whose last index runs fastest."""
    return matrix_shape(shape) if len(shape) < 3 else (prod(shape), 1)


def _split(column: Any, sizes: Sequence[int]) -> list[Any]:
    return list(ca.vertsplit(column, np.cumsum([0, *sizes]).tolist()))


def _has_states(option: Any, description: ModelDescription) -> bool:
    """Return whether the states of an FMU are states of the diagram."""
    return bool(option.interface != "cs" and "me" in description.kinds and description.states)


@lru_cache(maxsize=256)
def _of_block(made: type[Block], name: str) -> type[Block]:
    """Return the class for one block of a diagram: each has a mode of its own, and so functions of its own."""
    own = {"__doc__": made.__doc__, "type_name": "fmu", "category": "fmu", "fmu_block": name}
    return type("Fmu", (made,), own)


def block_class(
    path: str | Path, values: Mapping[str, Any] | None = None, signals: frozenset[str] = frozenset(), name: str = ""
) -> type[Block]:
    """Return the block class of an FMU file. Raises RotorsimError for what cannot be read.

    values: those given to the block, of which sizes of arrays give its ports their shapes. signals: names of ports that
    somebody wants: variables inside the FMU among them become outputs. name: of the block, where it is one of a
    diagram.
    """
    path = Path(path).resolve()
    try:
        found = path.stat()
    except OSError as error:
        raise RotorsimError(Problem(f"cannot read {path.name}: {(error.strerror or str(error)).lower()}")) from None
    stamp = (found.st_mtime_ns, found.st_size)
    made = _made(path, stamp)
    options: Mapping[str, FmuOption] = made.fmu_options  # type: ignore[attr-defined]
    sizes = tuple(
        (name, int(value))
        for name, value in (values or {}).items()
        if name in options
        and options[name].variable.causality == "structuralParameter"
        and type(value) is int
        and value >= 0
        and value != options[name].default
    )
    own: Mapping[str, FmuPort] = made.fmu_outputs  # type: ignore[attr-defined]
    made = _made(path, stamp, sizes, signals) if sizes or not signals <= own.keys() else made
    return _of_block(made, name) if name else made  # type: ignore[arg-type]
