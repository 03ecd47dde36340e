"""Lay out equal axes side by side: states whose equations have one form become neighbours.

A C compiler joins neighbouring operations of one form into one vector instruction. A rotor block with
states of shape (2,) has its axes side by side anyway; a diagram from scalar blocks gets the same here.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program

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
    form_of: dict[int, int] = {}
    numbers: dict[object, int] = {}
    for number in program.needed(rates):
        op, a, b = program.nodes[number]
        form: object
        if program.levels[number] < ir.LEVEL_STATE:
            form = program.levels[number]
        elif op == ir.INPUT:
            form = ("x", colours[b]) if a == "x" else (str(a),)
        else:
            parts = [form_of[k] for k in program.operands(number)]
            which = a.name if isinstance(a, ir.Call) else b if op == ir.RESULT else None
            form = (op, which, *(sorted(parts) if op in (ir.ADD, ir.MUL) else parts))
        form_of[number] = numbers.setdefault(form, len(numbers))
    return form_of


def paired_constants(
    program: Program, rates: Sequence[int], groups: Sequence[Sequence[int]], constants: Sequence[int]
) -> list[int]:
    """Return the constants reordered: those that play one part for the states of a group are neighbours."""
    wanted = set(constants)

    def used(state: int) -> list[int]:
        reached = program.reached([rates[state]], lambda k: program.levels[k] <= ir.LEVEL_PARAMETER)
        return [k for k in reached if k in wanted]

    rows = (row for group in groups for row in zip_longest(*map(used, group)))
    return list(dict.fromkeys([*(k for row in rows for k in row if k is not None), *constants]))
