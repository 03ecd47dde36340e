"""Angles that turn evenly: which sines and cosines of the forcing a run gets by rotating a vector, and their angles.

Between two instants an angle of constant speed grows by the same step, and that of a ramp by a step that itself grows
evenly: a vector (cos, sin) is rotated instead of asking the library (turning.c). The angle is set anew in every block
of steps, in numbers of twice the length (106 bits), so that it stays exact modulo one turn however long the run is.

Taken are angles that are polynomials of t of degree 2 at most, case by case, where what decides between cases is linear
in t: a case that holds at both ends of a block holds all through it, and there the angle is one parabola.
Source: Dekker (1971), Numerische Mathematik 18, 224-242 (arithmetic of double length).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.numbers import literal
from rotorsim.model.emit.program import Program

MOST_ANGLES = 8
ANGLE_NUMBERS = 8  # that turning.c keeps of each
_SUMS = {ir.ADD: "add", ir.SUB: "sub"}
_CASES = {ca.OP_FMIN: "min", ca.OP_FMAX: "max", ca.OP_LT: "less", ca.OP_LE: "less_equal"}
_SAME = {ir.NEG: "rs_sub(rs_zero, {0})", ir.TWICE: "rs_add({0}, {0})"}


@dataclass(frozen=True)
class Angle:
    """An angle whose cosine and sine the forcing has: nodes, -1 where there is none."""

    argument: int
    cosine: int
    sine: int


def turning_angles(program: Program, forcing: Sequence[int]) -> tuple[Angle, ...]:
    """Return the angles of sines and cosines in the forcing that are parabolas of time, case by case."""
    pairs: dict[int, dict[int, int]] = {}
    for number in program.needed(forcing):
        op = program.nodes[number][0]
        if op in (ir.SIN, ir.COS) and program.levels[number] == ir.LEVEL_TIME:
            [argument] = program.operands(number)
            pairs.setdefault(argument, {})[op] = number
    found = [Angle(a, own.get(ir.COS, -1), own.get(ir.SIN, -1)) for a, own in pairs.items() if _degree(program, a) <= 2]
    return tuple(found) if len(found) <= MOST_ANGLES else ()


def _degree(program: Program, argument: int) -> float:
    """Return the degree in t of a piecewise polynomial whose cases follow from what is linear in t; else infinity."""
    degrees: dict[int, float] = {}
    for number in program.needed([argument]):
        op, a, _ = program.nodes[number]
        of = [degrees[k] for k in program.operands(number)]
        if op in (ir.INPUT, ir.CONSTANT):
            degrees[number] = 1.0 if a == "t" else 0.0
        elif op in _SUMS or op in _SAME:
            degrees[number] = max(of)
        elif op in (ir.MUL, ir.SQ):
            degrees[number] = sum(of) * (2 if op == ir.SQ else 1)
        elif op in (ir.DIV, ir.INV) and of[-1] == 0:
            degrees[number] = of[0] if op == ir.DIV else 0.0
        elif op in _CASES and max(of) <= 1:
            degrees[number] = 0.0 if op in (ca.OP_LT, ca.OP_LE) else max(of)
        elif op in (ca.OP_IF_ELSE_ZERO, ca.OP_NOT) and of[0] == 0:
            degrees[number] = of[-1]
        else:
            return math.inf
    return degrees[argument]


def emit_angles(program: Program, angles: Sequence[Angle]) -> tuple[str, str]:
    """Return the C text of ``rs_angles``: the angles at a time, of twice the length, and which cases hold there.

    First what turning.c needs to know of it before.
    """
    lines, cases = [], 0
    text: dict[int, str] = {}
    for number in program.needed([one.argument for one in angles]):
        op, a, b = program.nodes[number]
        operands = [text[k] for k in program.operands(number)]
        if op == ir.INPUT:
            text[number] = "t" if a == "t" else f"rs_long({a}[{b}])"
            continue
        if op == ir.CONSTANT:
            text[number] = f"rs_long({literal(program.value(number))})"
            continue
        if op in _CASES:
            value = f"rs_{_CASES[op]}({', '.join(operands)}, held + {cases})"
            cases += 1
        elif op == ca.OP_IF_ELSE_ZERO:
            value = f"{operands[0]}.hi != 0.0 ? {operands[1]} : rs_zero"
        elif op == ca.OP_NOT:
            value = f"{operands[0]}.hi == 0.0 ? rs_one : rs_zero"
        elif op in _SUMS:
            value = f"rs_{_SUMS[op]}({', '.join(operands)})"
        elif op in (ir.MUL, ir.SQ):
            value = f"rs_mul({operands[0]}, {operands[-1]})"
        elif op in (ir.DIV, ir.INV):
            value = f"rs_div({operands[0] if op == ir.DIV else 'rs_one'}, {operands[-1]})"
        else:
            value = _SAME[op].format(*operands)
        lines.append(f"  const rs_dd v{number} = {value};")
        text[number] = f"v{number}"
    lines += [f"  angle[{k}] = {text[one.argument]};" for k, one in enumerate(angles)]
    head = "static void rs_angles(rs_dd t, const double *p, rs_dd *angle, char *held) {"
    return f"#define RS_CASES {cases}", "\n".join([head, *lines, "  (void)t, (void)p, (void)held;", "}", ""])
