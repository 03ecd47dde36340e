"""Whether an expression is linear, as it is written: a derivative does not tell (a sign has none, but steps)."""

from __future__ import annotations

from typing import Any

import casadi as ca

_SUMS = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_TWICE, ca.OP_ASSIGN)


def is_affine(of: Any, by: Any) -> bool:
    """Return whether an expression is a + B by with a and B independent of the symbols ``by``."""
    others = [symbol for symbol in ca.symvar(ca.SX(of)) if not ca.depends_on(symbol, by)]
    function = ca.Function("f", [by, ca.vertcat(*others)], [of])
    moves = [False] * function.sz_w()
    for k in range(function.n_instructions()):
        op, given, to = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            continue
        if op in (ca.OP_INPUT, ca.OP_CONST):
            moves[to[0]] = op == ca.OP_INPUT and given[0] == 0
            continue
        held = [moves[place] for place in given]
        product = op == ca.OP_MUL and not all(held)
        factor = (op == ca.OP_DIV and not held[-1]) or (op == ca.OP_IF_ELSE_ZERO and not held[0])
        if any(held) and not (op in _SUMS or product or factor):
            return False
        moves[to[0]] = any(held)
    return True
