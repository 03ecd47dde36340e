"""Lay out equal axes side by side: states whose equations have one form become neighbours.

A C compiler joins neighbouring operations of one form into one vector instruction. A rotor block with
states of shape (2,) has its axes side by side anyway; a diagram from scalar blocks gets the same here.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program

__all__ = ["paired_constants", "paired_states"]

ROUNDS = 8  # of colour refinement; forms that differ only farther away are neighbours all the same


def paired_states(program: Program, rates: Sequence[int]) -> list[list[int]]:
    """Return the states in groups of one form: colour refinement of the graph of their equations."""
    colours = [0] * len(rates)
    for _ in range(ROUNDS):
        form_of = _forms(program, rates, colours)
        forms = [form_of[rate] for rate in rates]
        names = {form: k for k, form in enumerate(dict.fromkeys(zip(colours, forms, strict=True)))}
        new = [names[pair] for pair in zip(colours, forms, strict=True)]
        if new == colours:
            break
        colours = new
    groups: dict[int, list[int]] = {}
    for state, colour in enumerate(colours):
        groups.setdefault(colour, []).append(state)
    return list(groups.values())


def _forms(program: Program, rates: Sequence[int], colours: Sequence[int]) -> dict[int, int]:
    """Return a number for the form of every node: operations alike, states by colour, parameters all alike."""
    found: dict[int, int] = {}
    numbers: dict[object, int] = {}
    for number in program.needed(rates):
        op, a, b = program.nodes[number]
        if program.levels[number] < ir.LEVEL_STATE:
            form: object = program.levels[number]
        elif op == ir.INPUT:
            form = ("x", colours[b]) if a == "x" else (str(a),)
        else:
            parts = [found[int(a)]] + ([found[b]] if b >= 0 else [])
            form = (op, *(sorted(parts) if op in (ir.ADD, ir.MUL) else parts))
        found[number] = numbers.setdefault(form, len(numbers))
    return found


def paired_constants(
    program: Program, rates: Sequence[int], groups: Sequence[Sequence[int]], constants: Sequence[int]
) -> list[int]:
    """Return the constants reordered: those that play one part for the states of a group are neighbours."""
    wanted = set(constants)
    order: list[int] = []
    for group in groups:
        used = [[k for k in _depth_first(program, rates[state]) if k in wanted] for state in group]
        order += [k for row in zip_longest(*used) for k in row if k is not None]
    return list(dict.fromkeys([*order, *constants]))


def _depth_first(program: Program, root: int) -> list[int]:
    """Return the nodes below a node, operands in order; what depends on parameters only is not looked into."""
    found: dict[int, None] = {}
    stack = [root]
    while stack:
        number = stack.pop()
        if number in found:
            continue
        found[number] = None
        op, a, b = program.nodes[number]
        if op in (ir.INPUT, ir.CONSTANT) or program.levels[number] <= ir.LEVEL_PARAMETER:
            continue
        stack += [b, int(a)] if b >= 0 else [int(a)]
    return list(found)
