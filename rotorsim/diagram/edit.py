"""Edit diagram documents: put another block in the place of one, keeping its wires; add a signal to a port."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any

from rotorsim.block import Block
from rotorsim.diagram.parse.document import endpoint
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.errors import Problem, Problems, RotorsimError, near_miss


def swap(
    data: Mapping[str, Any],
    block: str,
    new_type: str,
    parameters: Mapping[str, Any] | None = None,
    registry: Registry | None = None,
) -> dict[str, Any]:
    """Return the document with ``block`` replaced by one of ``new_type``; its wires stay.

    Parameters that both types have keep their values; ``parameters`` are set on top.
    Raises RotorsimError when the ports that are wired do not exist in the new type, or when the new type
    needs inputs that are not wired, with the types that would fit.
    """
    registry = registry or Registry()
    blocks = data.get("blocks", {})
    if block not in blocks:
        raise RotorsimError(Problem(f"no block '{block}'", block, hint=near_miss(block, blocks)))
    kind = registry.find(new_type)
    if kind is None:
        raise RotorsimError(Problem(f"unknown block type '{new_type}'", block, hint=registry.hint(new_type)))
    before = blocks[block]
    known = {**kind.parameters, **kind.options}
    kept = {name: value for name, value in before.get("parameters", {}).items() if name in known}
    for name in parameters or {}:
        if name not in known:
            what = f"type '{new_type}' has no parameter '{name}'"
            raise RotorsimError(Problem(what, f"{block}.{name}", hint=near_miss(name, known)))
    values = {**kept, **(parameters or {})}
    problems = _misfits(data, block, kind, values)
    if problems:
        fits = [name for name in fitting_types(data, block, registry) if name != before.get("type")]
        hint = f"types that fit: {', '.join(fits)}" if fits else "no other type has these ports"
        raise RotorsimError(*[Problem(p.what, p.subject, p.place, hint) for p in problems])
    result = copy.deepcopy(dict(data))
    result["blocks"][block] = {"type": new_type, **({"parameters": values} if values else {})}
    return result


def fitting_types(data: Mapping[str, Any], block: str, registry: Registry | None = None) -> list[str]:
    """Return the types that have every port of ``block`` that is wired, and need no other input."""
    registry = registry or Registry()
    return [name for name, kind in registry.all_types().items() if not _misfits(data, block, kind, {})]


def add_signal(data: Mapping[str, Any], port: str, source: str, name: str, *, is_output: bool) -> dict[str, Any]:
    """Return the document with an output ``source`` added to what arrives at an input port, or leaves an output port.

    Two sums are put into its wires: ``name_before``, the signal as it was, and ``name_after``, what goes on.
    """
    result = copy.deepcopy(dict(data))
    before, after = f"{name}_before", f"{name}_after"
    result["blocks"] |= {before: {"type": "sum", "parameters": {"signs": "+"}}, after: {"type": "sum"}}
    side, new = (0, f"{after}.output") if is_output else (1, f"{before}.input1")
    for wire in result["wires"]:
        plain, bracket, index = str(wire[side]).partition("[")
        if plain.strip() == port:
            wire[side] = new + bracket + index
    ends = [port, f"{before}.input1"] if is_output else [f"{after}.output", port]
    result["wires"] += [ends, [f"{before}.output", f"{after}.input1"], [source, f"{after}.input2"]]
    return result


def _misfits(data: Mapping[str, Any], block: str, kind: type[Block], values: Mapping[str, Any]) -> list[Problem]:
    try:
        made = kind({name: value for name, value in values.items() if name in kind.options})
        inputs = {n: d for d in kind.inputs.values() for n in made.port_names(d)}
        outputs = {n for d in kind.outputs.values() for n in made.port_names(d)}
    except Exception as error:  # options of the wrong kind: the loader says it better
        return [Problem(f"type '{kind.type_name}' cannot be made: {error}", block)]
    kind_name = f"type '{kind.type_name}'"
    problems = Problems()
    used: set[str] = set()
    wires = [wire for wire in data.get("wires", []) if isinstance(wire, list) and len(wire) == 2]
    for known, word, ends in ((outputs, "output", [w[0] for w in wires]), (inputs, "input", [w[1] for w in wires])):
        for port in _ports_of(block, ends):
            used.add(port)
            if port not in known:
                problems.error(f"{kind_name} has no {word} '{port}', which is wired", f"{block}.{port}")
    for port in _ports_of(block, data.get("record", [])):
        if port not in outputs and port not in used:
            problems.error(f"{kind_name} has no output '{port}', which is recorded", f"{block}.{port}")
    for port, declared in inputs.items():
        if not declared.optional and not declared.additive and port not in used:
            problems.error(f"{kind_name} needs input '{port}', which is not wired", f"{block}.{port}")
    return list(dict.fromkeys(problems))


def _ports_of(block: str, texts: Iterable[Any]) -> list[str]:
    """Return the ports of a block among wire ends or recorded signals."""
    return [end.port for end in map(endpoint, texts) if end is not None and end.block == block]
