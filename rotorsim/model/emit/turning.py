"""Angles that turn evenly: which sines and cosines of the forcing a run gets by rotating a vector, and their angles.

Between two instants an angle of constant speed grows by the same step, and that of a ramp by a step that itself grows
evenly: a vector (cos, sin) is rotated instead of asking the library (turning.c). The angle is set anew in every block
of steps, in numbers of twice the length (106 bits), so that it stays exact modulo one turn however long the run is.
Source: Dekker (1971), Numerische Mathematik 18, 224-242 (arithmetic of double length).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program

MOST_ANGLES = 8
_BINARY = {ir.ADD: "add", ir.SUB: "sub", ir.MUL: "mul", ir.DIV: "div", ca.OP_FMIN: "min", ca.OP_FMAX: "max"}
_COMPARED = {ca.OP_LT: "less", ca.OP_LE: "less_equal"}
_UNARY = {
    ir.NEG: "rs_sub(rs_zero, {0})",
    ir.SQ: "rs_mul({0}, {0})",
    ir.TWICE: "rs_add({0}, {0})",
    ir.INV: "rs_div(rs_one, {0})",
    ca.OP_NOT: "{0}.hi == 0.0 ? rs_one : rs_zero",
}


@dataclass(frozen=True)
class Angle:
    """An angle whose cosine and sine the forcing has: nodes, -1 where there is none."""

    argument: int
    cosine: int
    sine: int


def turning_angles(program: Program, forcing: Sequence[int]) -> tuple[Angle, ...]:
    """Return the angles of sines and cosines in the forcing that are sums, products and cases of time and parameters.

    They need not turn evenly: that is found out in the run.
    """
    pairs: dict[int, dict[int, int]] = {}
    for number in program.needed(forcing):
        op = program.nodes[number][0]
        if op in (ir.SIN, ir.COS) and program.levels[number] == ir.LEVEL_TIME:
            [argument] = program.operands(number)
            pairs.setdefault(argument, {})[op] = number
    found = [Angle(a, own.get(ir.COS, -1), own.get(ir.SIN, -1)) for a, own in pairs.items() if _is_plain(program, a)]
    return tuple(found) if len(found) <= MOST_ANGLES else ()


def _is_plain(program: Program, argument: int) -> bool:
    known = {ir.INPUT, ir.CONSTANT, ca.OP_IF_ELSE_ZERO, *_BINARY, *_COMPARED, *_UNARY}
    return all(program.nodes[number][0] in known for number in program.needed([argument]))


def emit_angles(program: Program, angles: Sequence[Angle]) -> str:
    """Return the C text of ``rs_angles``, which gives the angles at a time in numbers of twice the length."""
    lines = ["static void rs_angles(rs_dd t, const double *p, rs_dd *angle) {"]
    text: dict[int, str] = {}
    for number in program.needed([one.argument for one in angles]):
        op, a, b = program.nodes[number]
        operands = [text[k] for k in program.operands(number)]
        if op == ir.INPUT:
            text[number] = "t" if a == "t" else f"rs_long({a}[{b}])"
            continue
        if op == ir.CONSTANT:
            text[number] = f"rs_long({program.value(number)!r})"
            continue
        if op == ca.OP_IF_ELSE_ZERO:
            value = f"{operands[0]}.hi != 0.0 ? {operands[1]} : rs_zero"
        else:
            name = _BINARY.get(op) or _COMPARED.get(op)
            value = f"rs_{name}({', '.join(operands)})" if name else _UNARY[op].format(*operands)
        lines.append(f"  const rs_dd v{number} = {value};")
        text[number] = f"v{number}"
    lines += [f"  angle[{k}] = {text[one.argument]};" for k, one in enumerate(angles)]
    return "\n".join([*lines, "  (void)t, (void)p;", "}", ""])
