"""A scalar program evaluated at many points at once: one operation of NumPy for each of its nodes.

At a hundred points and more that takes a tenth of the time of CasADi's virtual machine, which goes point by point, and
nothing is compiled. What is the same at all points is one number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program

MOST_WRITTEN = 20_000  # operations of a program that is written as Python

_SIGNS = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_COMPARISONS = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_BY_NUMPY: Mapping[int, str] = {
    **{op: f"{{0}} {sign} {{1}}" for op, sign in _SIGNS.items()},
    **{op: f"({{0}} {sign} {{1}}) * 1.0" for op, sign in _COMPARISONS.items()},
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_AND: "(({0} != 0.0) & ({1} != 0.0)) * 1.0",
    ca.OP_OR: "(({0} != 0.0) | ({1} != 0.0)) * 1.0",
    ca.OP_NOT: "({0} == 0.0) * 1.0",
    ca.OP_SIGN: "({0} > 0.0) * 1.0 - ({0} < 0.0) * 1.0",
    ca.OP_IF_ELSE_ZERO: "np.where({0} != 0.0, {1}, 0.0)",
    ca.OP_EXP: "np.exp({0})",
    ca.OP_LOG: "np.log({0})",
    ca.OP_POW: "np.power({0}, {1})",
    ca.OP_CONSTPOW: "np.power({0}, {1})",
    ca.OP_SQRT: "np.sqrt({0})",
    ca.OP_SIN: "np.sin({0})",
    ca.OP_COS: "np.cos({0})",
    ca.OP_TAN: "np.tan({0})",
    ca.OP_ASIN: "np.arcsin({0})",
    ca.OP_ACOS: "np.arccos({0})",
    ca.OP_ATAN: "np.arctan({0})",
    ca.OP_FLOOR: "np.floor({0})",
    ca.OP_CEIL: "np.ceil({0})",
    ca.OP_FMOD: "np.fmod({0}, {1})",
    ca.OP_FABS: "np.fabs({0})",
    ca.OP_COPYSIGN: "np.copysign({0}, {1})",
    ca.OP_FMIN: "np.fmin({0}, {1})",
    ca.OP_FMAX: "np.fmax({0}, {1})",
    ca.OP_SINH: "np.sinh({0})",
    ca.OP_COSH: "np.cosh({0})",
    ca.OP_TANH: "np.tanh({0})",
    ca.OP_ASINH: "np.arcsinh({0})",
    ca.OP_ACOSH: "np.arccosh({0})",
    ca.OP_ATANH: "np.arctanh({0})",
    ca.OP_ATAN2: "np.arctan2({0}, {1})",
    ca.OP_LOG1P: "np.log1p({0})",
    ca.OP_EXPM1: "np.expm1({0})",
    ca.OP_HYPOT: "np.hypot({0}, {1})",
}


def array_function(function: ca.Function) -> Callable[..., np.ndarray] | None:
    """Return what evaluates the column that a CasADi function gives, None where an operation is not one of NumPy's.

    It takes the arguments (size, n) or (size,), and returns (rows, n).
    """
    names = [f"a{k}" for k in range(function.n_in())]
    program = Program(reassociate=False)
    nodes = program.load(function, names)[0]
    order = program.needed(nodes)
    known = {ir.INPUT, ir.CONSTANT, *_BY_NUMPY}
    if len(order) > MOST_WRITTEN or any(program.nodes[k][0] not in known for k in order):
        return None
    namespace: dict[str, Any] = {"np": np}
    exec(compile(_source(program, nodes, order, names), "<array function>", "exec"), namespace)
    written: Callable[..., np.ndarray] = namespace["evaluate"]
    return written


def _source(program: Program, nodes: Sequence[int], order: Sequence[int], names: Sequence[str]) -> str:
    """Return the text of ``evaluate``: a variable holds one value after another, so that few arrays are alive."""
    last = {k: place for place, number in enumerate(order) for k in program.operands(number)}
    last |= dict.fromkeys(nodes, len(order))
    text: dict[int, str] = {}
    free: list[str] = []
    lines, count = [], 0
    for place, number in enumerate(order):
        op, a, b = program.nodes[number]
        if op == ir.INPUT:
            text[number] = f"{a}[{b}]"
            continue
        if op == ir.CONSTANT:
            text[number] = f"np.float64({program.value(number)!r})".replace("inf", "np.inf").replace("nan", "np.nan")
            continue
        operands = program.operands(number)
        value = _BY_NUMPY[op].format(*(text[k] for k in operands))
        free += [text[k] for k in dict.fromkeys(operands) if last[k] == place and text[k].startswith("v")]
        if free:
            target = free.pop()
        else:
            target, count = f"v{count}", count + 1
        text[number] = target
        lines.append(f"    {target} = {value}")
    lines += [f"    out[{k}] = {text[number]}" for k, number in enumerate(nodes)]
    return "\n".join([f"def evaluate({', '.join(names)}, out):", *lines, "    return out", ""])
