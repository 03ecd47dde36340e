"""Collapse what is linear in the states: many gains and sums become one coefficient each.

A controller, a bearing and a rotor in series are, for the time loop, sums of coefficients times states.
The coefficients depend on parameters only and are computed once per run; what depends on time only joins
the forcing. The collapsed program is taken only where it needs fewer operations: a finite element rotor,
whose banded solution is cheaper than its dense inverse, stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program

__all__ = ["collapse_linear", "state_operations"]

LARGEST = 400  # operations of the right-hand side above which collapsing is not tried
Form = tuple[dict[int, int], int]  # atom -> coefficient node, and the node of the rest; all of the new program


def state_operations(program: Program, outputs: Sequence[int]) -> int:
    """Return the number of operations that must be carried out for every state."""
    return sum(program.levels[k] == ir.LEVEL_STATE and program.nodes[k][0] != ir.INPUT for k in program.needed(outputs))


def collapse_linear(old: Program, rates: Sequence[int], others: Sequence[int]) -> tuple[Program, list[int]]:
    """Return an equal program and its outputs [*rates, *others], or the old one where that is no gain.

    rates: the right-hand side, evaluated four times a step. others: evaluated once a step.
    """
    wanted = [*rates, *others]
    before = 4 * state_operations(old, rates) + state_operations(old, others)
    if state_operations(old, rates) > LARGEST:
        return old, wanted
    new = Program(old.reassociate)
    forms: dict[int, Form] = {}
    for number in old.needed(wanted):
        forms[number] = _form(old, new, number, forms)
    outputs = [_node(new, forms[number]) for number in wanted]
    n = len(rates)
    after = 4 * state_operations(new, outputs[:n]) + state_operations(new, outputs[n:])
    return (new, outputs) if after < before else (old, wanted)


def _form(old: Program, new: Program, number: int, forms: dict[int, Form]) -> Form:
    op, a, b = old.nodes[number]
    zero = new.constant(0.0)
    if op == ir.INPUT:
        leaf = new.input(str(a), b)
        return ({leaf: new.constant(1.0)}, zero) if old.levels[number] == ir.LEVEL_STATE else ({}, leaf)
    if op == ir.CONSTANT:
        return {}, new.constant(float(a))
    left = forms[int(a)]
    right = forms[b] if b >= 0 else ({}, zero)
    if old.levels[number] < ir.LEVEL_STATE:
        return {}, new.apply(op, left[1], right[1] if b >= 0 else -1)
    if op == ir.ADD:
        return _combined(new, left, right, ir.ADD)
    if op == ir.SUB:
        return _combined(new, left, right, ir.SUB)
    if op == ir.NEG:
        return _scaled(new, left, new.constant(-1.0))
    if op == ir.TWICE:
        return _scaled(new, left, new.constant(2.0))
    if op == ir.MUL:
        for form, factor in ((left, right), (right, left)):
            if not factor[0] and new.levels[factor[1]] <= ir.LEVEL_PARAMETER:
                return _scaled(new, form, factor[1])
    atom = new.apply(op, _node(new, left), _node(new, right) if b >= 0 else -1)
    return {atom: new.constant(1.0)}, zero


def _combined(new: Program, left: Form, right: Form, op: int) -> Form:
    coefficients = dict(left[0])
    for atom, coefficient in right[0].items():
        if atom in coefficients:
            coefficients[atom] = new.apply(op, coefficients[atom], coefficient)
        else:
            coefficients[atom] = coefficient if op == ir.ADD else new.apply(ir.NEG, coefficient)
    return coefficients, new.apply(op, left[1], right[1])


def _scaled(new: Program, form: Form, factor: int) -> Form:
    return {atom: new.apply(ir.MUL, c, factor) for atom, c in form[0].items()}, new.apply(ir.MUL, form[1], factor)


def _node(new: Program, form: Form) -> int:
    """Return the node of a form: the largest part first, in the order in which the states are laid out."""
    total = form[1]
    for atom in sorted(form[0], key=lambda k: (new.nodes[k][0] != ir.INPUT, new.nodes[k][2], k)):
        coefficient = form[0][atom]
        if new.is_constant(coefficient, -1.0):
            total = new.apply(ir.SUB, total, atom)
        else:
            total = new.apply(ir.ADD, total, new.apply(ir.MUL, coefficient, atom))
    return total
