"""The block ``fmu``: its ports and parameters are those that the model description of an FMU states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, concatenate, unflatten, zeros
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.model import FLOATS, INTEGERS, ModelDescription
from rotorsim.fmi.functions import functions_of, held_inputs, moving_inputs
from rotorsim.fmi.mode import FmuMode
from rotorsim.fmi.ports import (
    TAKEN,
    FmuOption,
    FmuPort,
    Named,
    begun,
    check_named,
    declared_option,
    named_ports,
    options_of,
    port_name,
    ports_of,
    prefix_of,
    silent,
    symbol_shape,
    unfed,
    unit_warnings,
    value_name,
)
from rotorsim.fmi.runtime.slave import TIMEOUT, describe_fmu


@lru_cache(maxsize=64)
def _made(
    path: Path,
    _stamp: tuple[int, int],
    sizes: tuple[tuple[str, int], ...] = (),
    signals: frozenset[str] = frozenset(),
    named: Named = (),
) -> type[Block]:
    if sizes:  # given by the names of the block
        prefix = prefix_of(_made(path, _stamp).fmu_description)  # type: ignore[attr-defined]
        known = {port_name(v.name, prefix): v.name for v in describe_fmu(path).by_causality("structuralParameter")}
        description = describe_fmu(path, sizes={known[name]: size for name, size in sizes if name in known})
    else:
        description = describe_fmu(path)
    prefix = prefix_of(description)
    check_named(description, named)
    inputs = ports_of(description, ("input",), prefix, named=named)
    outputs = ports_of(description, ("output",), prefix, named=named)
    if both := [name for name in inputs if name in outputs]:
        raise RotorsimError(
            Problem(f"'{both[0]}' is an input and an output", "ports", hint="a name of its own for each")
        )
    if not signals <= outputs.keys():
        inside = ports_of(description, ("local", "calculatedParameter", "parameter", "independent"), prefix)
        outputs |= {name: port for name, port in inside.items() if name in signals - outputs.keys()}
    options = options_of(description, prefix)
    resized = set(description.sizes)
    parameters = {
        value_name(name): port
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
        "fmu_warnings": [*description.warnings, *unit_warnings(description), *silent(description, outputs, prefix)],
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
        "linear": Option(
            True, kind=bool, doc="take its description at its word where that says that its equations are linear"
        ),
        "in_process": Option(False, kind=bool, doc="load its code into this process: faster, but a crash is ours"),
        "ports": Option({}, kind=dict, doc="inputs and outputs by the names that their ports get, a list for a vector"),
        "timeout": Option(TIMEOUT, kind=(int, float), low=1, doc="for one answer of a process of its own [s]"),
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
        if port.start is not None and name not in parameters and name not in options and name not in TAKEN
    }
    body |= {f"_s_{name}": declared_option(option) for name, option in options.items()}
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
    body |= {"equations": _equations, "linear_equations": _linear_equations, "starts": _starts}
    body |= {"untraced": _not_traced, "mode": _mode}
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
        return Equations({name: zeros(*symbol_shape(port.shape)) for name, port in ports.items()}, rates)
    functions = functions_of(block)
    moving, held = moving_inputs(block), held_inputs(block)
    fed = {name: concatenate([getattr(u, name) + unfed(block, p, name, port)]) for name, port in moving.items()}
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
        seen = [value if name in follows else concatenate([begun(moving[name])]) for name, value in fed.items()]
        rows_of_all = [k for rows in members.values() for k in rows]
        groups = (True, bool(n_x), bool(follows), True)
        column = functions.call("y", rows_of_all, groups, [t, state, concatenate([ca.SX(0, 1), *seen]), values])
        for name, part in zip(members, _split(column, [len(rows) for rows in members.values()]), strict=True):
            outputs[name] = unflatten(part, symbol_shape(ports[name].shape))
    return Equations(outputs, {"states": functions.call("f", range(n_x), (True,) * 4, given)} if n_x else {})


def _linear_equations(self: Block, p: Any, u: Any, x: Any, t: Any) -> Equations | None:
    """Return x' = A(p) x + B(p) (u - u0) + f(t, p), u0 the inputs with which it begins, and outputs likewise.

    None where the model description does not say that it is so.
    """
    block: Any = self
    description, ports = block.fmu_description, block.fmu_outputs
    unknowns = [entry for port in ports.values() for entry in port.entries]
    if block.untraced()[0] or not (block.option.linear and description.states and description.is_affine(unknowns)):
        return None
    functions, moving, held = functions_of(block), moving_inputs(block), held_inputs(block)
    fed = [concatenate([getattr(u, name) + unfed(block, p, name, port)]) for name, port in moving.items()]
    values = _values(block, p, held)
    knowns = [*description.states, *(entry for port in moving.values() for entry in port.entries)]
    rows = [*description.derivatives, *unknowns]
    slopes = ca.reshape(functions.slopes(values), len(knowns), len(rows)).T
    listed = [[description.follows(unknown, known) for known in knowns] for unknown in rows]
    factors = slopes * ca.sparsify(ca.DM(listed))
    moved = ca.vertcat(x.states, ca.vertcat(ca.SX(0, 1), *fed) - ca.SX(functions.equations.idle))
    column = factors @ moved + functions.forcing(t, values)
    n_x = len(description.states)
    parts = _split(column[n_x:], [len(port.entries) for port in ports.values()])
    outputs = {name: unflatten(part, symbol_shape(ports[name].shape)) for name, part in zip(ports, parts, strict=True)}
    return Equations(outputs, {"states": column[:n_x]})


def _starts(self: Block, p: Any) -> dict[str, Any]:
    """Return where the states begin, as the FMU says."""
    block: Any = self
    if block.untraced()[0] or not block.fmu_description.states:
        return {}
    moving = moving_inputs(block).items()
    fed = concatenate([ca.SX(0, 1), *(unfed(block, p, name, port, start=True) for name, port in moving)])
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
    return concatenate([ca.SX(0, 1), *own, *(unfed(block, p, name, port) for name, port in held.items())])


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
    named = named_ports((values or {}).get("ports", {}))
    made = _made(path, stamp, sizes, signals, named) if sizes or named or not signals <= own.keys() else made
    return _of_block(made, name) if name else made  # type: ignore[arg-type]
