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

Form = tuple[dict[int, int], int]  # atom -> coefficient node, and the node of the rest; all of the new program


def state_operations(program: Program, outputs: Sequence[int]) -> int:
    """Return the number of operations that must be carried out for every state."""
    return sum(program.levels[k] == ir.LEVEL_STATE and program.nodes[k][0] != ir.INPUT for k in program.needed(outputs))


def collapse_linear(old: Program, outputs: Sequence[int], *, n_rates: int, most: int) -> tuple[Program, list[int]]:
    """Return an equal program and its outputs, or the old one where that is no gain (a `Pass`, with the rest given).

    n_rates: how many outputs, the first, are rates, or states after a step: they alone decide, so that a motion does
    not depend on what is recorded, to the last bit. most: of their operations, above which it is not tried.
    """
    before = state_operations(old, outputs[:n_rates])
    if before > most:
        return old, list(outputs)
    new = Program(old.reassociate, old.inputs)
    forms: dict[int, Form] = {}
    for number in old.needed(outputs):
        forms[number] = _form(old, new, number, forms)
    collapsed = [_node(new, forms[number]) for number in outputs]
    return (new, collapsed) if state_operations(new, collapsed[:n_rates]) < before else (old, list(outputs))


def _form(old: Program, new: Program, number: int, forms: dict[int, Form]) -> Form:
    op, a, b = old.nodes[number]
    zero = new.constant(0.0)
    if old.levels[number] < ir.LEVEL_STATE:
        return {}, new.copied(old.nodes[number], {k: forms[k][1] for k in old.operands(number)})
    if op == ir.INPUT:
        return {new.input(str(a), b): new.constant(1.0)}, zero
    if op in (ir.CALL, ir.RESULT):
        atom = new.copied(old.nodes[number], {k: _node(new, forms[k]) for k in old.operands(number)})
        return {atom: new.constant(1.0)}, zero
    left, *others = (forms[k] for k in old.operands(number))
    right = others[0] if others else ({}, zero)
    if op in (ir.ADD, ir.SUB):
        return _combined(new, left, right, op)
    if op in (ir.NEG, ir.TWICE):
        return _scaled(new, left, new.constant(-1.0 if op == ir.NEG else 2.0))
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
    """Return the node of a form: what does not change first, then inputs in the order of their vectors."""

    def place(atom: int) -> tuple[bool, str, int, int]:
        op, vector, position = new.nodes[atom]
        return op != ir.INPUT, str(vector) if op == ir.INPUT else "", position, atom

    total = form[1]
    for atom in sorted(form[0], key=place):
        coefficient = form[0][atom]
        if new.is_constant(coefficient, -1.0):
            total = new.apply(ir.SUB, total, atom)
        else:
            total = new.apply(ir.ADD, total, new.apply(ir.MUL, coefficient, atom))
    return total
