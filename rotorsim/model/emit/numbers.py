"""What generated C computes with: doubles, or vectors of them, one lane for each run of an ensemble."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

_INFIX = {
    ca.OP_ADD: "+",
    ca.OP_SUB: "-",
    ca.OP_MUL: "*",
    ca.OP_DIV: "/",
    ca.OP_LT: "<",
    ca.OP_LE: "<=",
    ca.OP_EQ: "==",
    ca.OP_NE: "!=",
    ca.OP_AND: "&&",
    ca.OP_OR: "||",
}
_CALL = {
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_SQRT: "sqrt",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_FMOD: "fmod",
    ca.OP_FABS: "fabs",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_ERF: "erf",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_ATAN2: "atan2",
    ca.OP_LOG1P: "log1p",
    ca.OP_EXPM1: "expm1",
    ca.OP_HYPOT: "hypot",
    ca.OP_REMAINDER: "remainder",
}
_FORMAT: dict[int, Callable[[str, str], str]] = {
    ca.OP_NEG: lambda a, _: f"-{a}",
    ca.OP_SQ: lambda a, _: f"{a} * {a}",
    ca.OP_TWICE: lambda a, _: f"{a} + {a}",
    ca.OP_INV: lambda a, _: f"1.0 / {a}",
    ca.OP_NOT: lambda a, _: f"!{a}",
    ca.OP_SIGN: lambda a, _: f"({a} > 0) - ({a} < 0)",
    ca.OP_IF_ELSE_ZERO: lambda a, b: f"{a} != 0 ? {b} : 0.0",
}
_COMPARED = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE)
_IN_LANES: dict[int, Callable[[str, str], str]] = {
    ca.OP_AND: lambda a, b: f"rs_true((rs_zeros != {a}) & (rs_zeros != {b}))",
    ca.OP_OR: lambda a, b: f"rs_true((rs_zeros != {a}) | (rs_zeros != {b}))",
    ca.OP_NOT: lambda a, _: f"rs_true(rs_zeros == {a})",
    ca.OP_SIGN: lambda a, _: f"rs_true({a} > rs_zeros) - rs_true({a} < rs_zeros)",
    ca.OP_IF_ELSE_ZERO: lambda a, b: f"rs_where(rs_zeros != {a}, {b})",
}


@dataclass(frozen=True)
class Numbers:
    """Doubles. type: their C type."""

    type: str = "double"

    def constant(self, value: float) -> str:
        """Return the C text of a constant."""
        return literal(value)

    def expression(self, op: int, left: str, right: str = "") -> str:
        """Return the C text of an operation of CasADi."""
        if op in _INFIX:
            return f"{left} {_INFIX[op]} {right}"
        if op in _CALL:
            return f"{_CALL[op]}({left}, {right})" if right else f"{_CALL[op]}({left})"
        return _FORMAT[op](left, right)


class Lanes(Numbers):
    """Vectors of the compiler (lanes.h), lane by lane the same operations as `Numbers`, to the last bit."""

    def __init__(self) -> None:
        super().__init__("rs_lanes")

    def constant(self, value: float) -> str:
        """Return the C text of a constant, in all lanes."""
        return f"rs_all({literal(value)})"

    def expression(self, op: int, left: str, right: str = "") -> str:
        """Return the C text of an operation of CasADi."""
        if op in _COMPARED:
            return f"rs_true({left} {_INFIX[op]} {right})"
        if op in _IN_LANES:
            return _IN_LANES[op](left, right)
        text = super().expression(op, left, right)
        return f"rs_{text}" if op in _CALL else text


DOUBLES, LANES = Numbers(), Lanes()


def literal(value: float) -> str:
    """Return the C text of a number."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = repr(value)
    return f"({text})" if value < 0 or text.startswith("-") else text
