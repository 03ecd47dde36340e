"""Entries of parameters that are set by themselves: ``controller.KD[2]``; the others stay as the diagram has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import groupby
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Place, Problem, RotorsimError, near_miss


def entries_set(settings: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return those settings that are of entries."""
    if not isinstance(settings, Mapping):
        return {}
    return {str(name): value for name, value in settings.items() if "[" in str(name)}


def with_entries(
    diagram_with: Callable[[dict[str, Any]], Diagram], settings: Mapping[str, Any], entries: Mapping[str, Any]
) -> dict[str, Any]:
    """Return settings with parameters of which entries are set as nested lists: SI numbers, what is given as it is.

    Entries count from 1: ``controller.KD[2]``, ``rotor.matrix[1,2]``. What follows another parameter has its value,
    with the entries of that set, and follows it no longer. Raises RotorsimError with all that are not there.
    """
    made = dict(settings)
    problems: list[Problem] = []
    for _, group in groupby(sorted(entries, key=_depth), _depth):  # what is followed before what follows it
        whole, mistakes = _whole(diagram_with(made), {name: entries[name] for name in group})
        made |= whole
        problems += mistakes
    if problems:
        raise RotorsimError(*problems)
    return made


def _depth(name: str) -> tuple[bool, int]:
    """Return parameters of the diagram as the lowest, then those of blocks and sub-diagrams, then what is in these."""
    base = name.partition("[")[0]
    block, sign, _ = base.rpartition("." if "." in base else "/")
    return bool(sign), block.count("/")


def _whole(diagram: Diagram, entries: Mapping[str, Any]) -> tuple[dict[str, Any], list[Problem]]:
    """Return parameters with their entries set, base name -> nested list, and what is wrong."""
    whole: dict[str, Any] = {}
    problems: list[Problem] = []
    for name, value in entries.items():
        base, _, inside = name.partition("[")
        found = whole[base] if base in whole else _value(diagram, base)
        if found is None:
            known = [*diagram.parameters, *(f"{b}.{key}" for b, node in diagram.nodes.items() for key in node.values)]
            near = near_miss(base, known, list_all=False) or "`rotorsim blocks TYPE` lists parameters"
            problems.append(Problem("no such parameter", name, Place("--set"), near))
            continue
        array = np.array(found, object)
        numbers = inside.removesuffix("]").split(",") if inside.endswith("]") else []
        index = tuple(int(part) - 1 for part in numbers if part.strip().isdigit())
        fits = len(index) == len(numbers) == array.ndim > 0
        if not fits or not all(0 <= i < n for i, n in zip(index, array.shape, strict=True)):
            size = " x ".join(map(str, array.shape)) or "a single number"
            hint = f"{base}[{','.join('1' * array.ndim)}] is the first" if array.ndim else f"set it whole: {base}=..."
            problems.append(
                Problem(f"no such entry; the parameter is {size}, counted from 1", name, Place("--set"), hint)
            )
        elif isinstance(value, list | dict):
            hint = f"the whole parameter: {base}=[...]"
            problems.append(Problem("an entry is one value, not a list", name, Place("--set"), hint))
        else:
            array[index] = value
        whole[base] = array.tolist()
    return whole, problems


def _value(diagram: Diagram, base: str) -> Any:
    """Return the value of a parameter, an option or a diagram parameter, SI; None for one that is not there."""
    if base in diagram.parameters:
        given = diagram.parameters[base]
        following = (
            node.values[key]
            for node in diagram.nodes.values()
            for key, reference in node.references.items()
            if reference == base
        )
        return np.broadcast_to(given, next(following, given).shape) if given.ndim == 0 else given
    block, _, parameter = base.rpartition("." if "." in base else "/")
    if block in diagram.sub_ports:
        outer = diagram.sub_ports[block].follows.get(parameter)
        return _value(diagram, outer) if outer else diagram.parameters.get(f"{block}/{parameter}")
    node = diagram.nodes.get(block)
    if node is None:
        return None
    return node.values[parameter] if parameter in node.values else getattr(node.block.option, parameter, None)
