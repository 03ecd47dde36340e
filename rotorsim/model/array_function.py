"""A CasADi function evaluated at many points at once: one operation of NumPy for each of its instructions.

At a hundred points and more that takes a sixth of the time of CasADi's virtual machine, which goes point by point, and
nothing is compiled. What is the same at all points is one number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np

MOST_INSTRUCTIONS = 20_000  # beyond, the virtual machine goes on

_BY_NUMPY: Mapping[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: np.positive,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_LT: lambda a, b: (a < b) * 1.0,
    ca.OP_LE: lambda a, b: (a <= b) * 1.0,
    ca.OP_EQ: lambda a, b: (a == b) * 1.0,
    ca.OP_NE: lambda a, b: (a != b) * 1.0,
    ca.OP_AND: lambda a, b: ((a != 0.0) & (b != 0.0)) * 1.0,
    ca.OP_OR: lambda a, b: ((a != 0.0) | (b != 0.0)) * 1.0,
    ca.OP_NOT: lambda a: (a == 0.0) * 1.0,
    ca.OP_SIGN: lambda a: (a > 0.0) * 1.0 - (a < 0.0) * 1.0,
    ca.OP_IF_ELSE_ZERO: lambda a, b: np.where(a != 0.0, b, 0.0),
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_FMOD: np.fmod,
    ca.OP_FABS: np.fabs,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_ASINH: np.arcsinh,
    ca.OP_ACOSH: np.arccosh,
    ca.OP_ATANH: np.arctanh,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_LOG1P: np.log1p,
    ca.OP_EXPM1: np.expm1,
    ca.OP_HYPOT: np.hypot,
}
_NONE = -1
Step = tuple[Callable[..., Any] | None, int, int, int]  # operation, where its result is, its operands


class ArrayFunction:
    """What evaluates the column that a CasADi function gives, by NumPy."""

    def __init__(self, function: ca.Function) -> None:
        """Raises KeyError where an operation is not one of NumPy's."""
        place = list(range(function.sz_w()))  # of what each register holds: of its own, of an argument, of a constant
        self._size, self._steps = len(place), list[Step]()
        self._constants: list[tuple[int, Any]] = []
        self._given: dict[tuple[int, int], int] = {}
        for k in range(function.n_instructions()):
            op, to, given = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
            if op == ca.OP_INPUT:
                place[to[0]] = self._given.setdefault((given[0], given[1]), self._size)
                self._size += place[to[0]] == self._size
            elif op == ca.OP_CONST:
                self._constants.append((self._size, np.float64(function.instruction_constant(k))))
                place[to[0]] = self._size
                self._size += 1
            elif op == ca.OP_OUTPUT:
                self._steps.append((None, to[1], place[given[0]], _NONE))
            else:
                second = place[given[1]] if len(given) > 1 else _NONE
                self._steps.append((_BY_NUMPY[op], to[0], place[given[0]], second))
                place[to[0]] = to[0]

    def __call__(self, *arguments: np.ndarray, out: np.ndarray) -> None:
        """Put the rows (rows, n) into out, of arguments (size, n) or (size,)."""
        held: list[Any] = [None] * self._size
        for place, value in self._constants:
            held[place] = value
        for (argument, row), place in self._given.items():
            held[place] = arguments[argument][row]
        for operation, to, a, b in self._steps:
            if operation is None:
                out[to] = held[a]
            elif b == _NONE:
                held[to] = operation(held[a])
            else:
                held[to] = operation(held[a], held[b])


def array_function(function: ca.Function) -> ArrayFunction | None:
    """Return what evaluates the column that a CasADi function gives, None where it is too long or not NumPy's."""
    try:
        return ArrayFunction(function) if function.n_instructions() <= MOST_INSTRUCTIONS else None
    except KeyError:
        return None
