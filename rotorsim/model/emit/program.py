"""Scalar programs: the traced expressions as a list of operations that can be rewritten and emitted.

A `Program` is a directed acyclic graph in evaluation order. Equal operations are one node (hash
consing), constants are folded, and every node has a level that says what it depends on, so that what
does not change in the time loop is computed outside it. A `Pass` rewrites a program into an equal one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, Protocol

import casadi as ca

from rotorsim.model.called import called_with

INPUT, CONSTANT, CALL = ca.OP_INPUT, ca.OP_CONST, ca.OP_CALL
RESULT = -1  # no operation of CasADi: one number of what a call gives
LEVEL_CONSTANT, LEVEL_PARAMETER, LEVEL_TIME, LEVEL_STATE = 0, 1, 2, 3
_LEVEL_OF_VECTOR = {"p": LEVEL_PARAMETER, "t": LEVEL_TIME}

ADD, SUB, MUL, DIV, NEG = ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG
SQ, TWICE, INV, SIN, COS = ca.OP_SQ, ca.OP_TWICE, ca.OP_INV, ca.OP_SIN, ca.OP_COS
_COMMUTATIVE = frozenset({ADD, MUL, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_FMIN, ca.OP_FMAX, ca.OP_HYPOT})
_UNARY = frozenset(
    {
        NEG,
        ca.OP_EXP,
        ca.OP_LOG,
        ca.OP_SQRT,
        SQ,
        TWICE,
        SIN,
        COS,
        ca.OP_TAN,
        ca.OP_ASIN,
        ca.OP_ACOS,
        ca.OP_ATAN,
        ca.OP_NOT,
        ca.OP_FLOOR,
        ca.OP_CEIL,
        ca.OP_FABS,
        ca.OP_SIGN,
        ca.OP_ERF,
        INV,
        ca.OP_SINH,
        ca.OP_COSH,
        ca.OP_TANH,
        ca.OP_ASINH,
        ca.OP_ACOSH,
        ca.OP_ATANH,
        ca.OP_LOG1P,
        ca.OP_EXPM1,
        ca.OP_ASSIGN,
    }
)
_FOLD: dict[int, Callable[[float, float], float]] = {
    ADD: lambda a, b: a + b,
    SUB: lambda a, b: a - b,
    MUL: lambda a, b: a * b,
    DIV: lambda a, b: a / b,
    NEG: lambda a, _: -a,
    SQ: lambda a, _: a * a,
    TWICE: lambda a, _: 2 * a,
    INV: lambda a, _: 1 / a,
    SIN: lambda a, _: math.sin(a),
    COS: lambda a, _: math.cos(a),
    ca.OP_SQRT: lambda a, _: math.sqrt(a),
    ca.OP_EXP: lambda a, _: math.exp(a),
}


@dataclass(frozen=True)
class Call:
    """A call of a function that has no expression (a part of a diagram that is opaque), told by its name.

    operands: nodes of the nonzeros of all arguments; it gives the nonzeros of all results.
    """

    name: str
    operands: tuple[int, ...]
    function: Any = field(compare=False)


Node = tuple[int, int | str | float | Call, int]


class Program:
    """Operations in evaluation order.

    nodes[k] = (op, a, b): for INPUT a is the vector's name and b the position; for CONSTANT a is the
    value; for CALL a is a `Call`, whose results follow as (RESULT, node of the call, position); else a, b
    are node numbers (b = -1 for one operand). levels[k]: what it depends on.
    ``reassociate`` allows sums and products to be regrouped so that what changes less often is joined first.
    ``inputs``: levels of vectors that are inputs, by name; of all others it is that of the states.
    """

    def __init__(self, reassociate: bool = True, inputs: Mapping[str, int] = _LEVEL_OF_VECTOR) -> None:
        self.nodes: list[Node] = []
        self.levels: list[int] = []
        self.reassociate, self.inputs = reassociate, inputs
        self._known: dict[Node, int] = {}

    def _add(self, node: Node, level: int) -> int:
        number = self._known.get(node)
        if number is None:
            number = self._known[node] = len(self.nodes)
            self.nodes.append(node)
            self.levels.append(level)
        return number

    def constant(self, value: float) -> int:
        """Return the node of a constant."""
        return self._add((CONSTANT, float(value) + 0.0, -1), LEVEL_CONSTANT)

    def input(self, vector: str, position: int) -> int:
        """Return the node of an input; its level follows from the vector's name."""
        return self._add((INPUT, vector, position), self.inputs.get(vector, LEVEL_STATE))

    def copied(self, node: Node, operands: Mapping[int, int]) -> int:
        """Return the node that a node of another program becomes here; operands: what those of the other became."""
        op, a, b = node
        if op == INPUT:
            return self.input(str(a), b)
        if op == CONSTANT:
            return self.constant(_number(a))
        if isinstance(a, Call):
            return self.call(a.function, [operands[k] for k in a.operands])
        if op == RESULT:
            return self.result(operands[_node(a)], b)
        return self.apply(op, operands[_node(a)], operands[b] if b >= 0 else -1)

    def call(self, function: Any, operands: Sequence[int]) -> int:
        """Return the node of a call of a CasADi function that cannot be written out; its results are behind it."""
        call = Call(function.name(), tuple(operands), function)
        known = self._known.get((CALL, call, -1))
        if known is None:
            level = max((self.levels[k] for k in operands), default=LEVEL_CONSTANT)
            known = self._add((CALL, call, -1), level)
            for position in range(function.nnz_out()):
                self._add((RESULT, known, position), level)
        return known

    def result(self, call: int, position: int) -> int:
        """Return the node of a number that a call gives."""
        return self._known[RESULT, call, position]

    def operands(self, number: int) -> tuple[int, ...]:
        """Return the nodes that an operation is applied to; none of an input or a constant."""
        op, a, b = self.nodes[number]
        if op in (INPUT, CONSTANT):
            return ()
        if isinstance(a, Call):
            return a.operands
        return (_node(a), b) if b >= 0 and op != RESULT else (_node(a),)

    def is_constant(self, number: int, value: float | None = None) -> bool:
        """Return whether a node is a constant (of this value)."""
        op, a, _ = self.nodes[number]
        return op == CONSTANT and (value is None or a == value)

    def value(self, number: int) -> float:
        """Return the value of a constant node."""
        return _number(self.nodes[number][1])

    def apply(self, op: int, a: int, b: int = -1) -> int:
        """Return the node of an operation, simplified."""
        if op in _UNARY:
            b = -1
        fold = _FOLD.get(op)
        if fold is not None and self.is_constant(a) and (b < 0 or self.is_constant(b)):
            try:
                folded = fold(self.value(a), self.value(b) if b >= 0 else 0.0)
            except (ArithmeticError, ValueError):
                folded = math.nan
            if math.isfinite(folded):
                return self.constant(folded)
        simple = self._simplified(op, a, b)
        if simple is not None:
            return simple
        if op in _COMMUTATIVE and b < a:
            a, b = b, a
        level = max(self.levels[a], self.levels[b] if b >= 0 else 0)
        return self._add((op, a, b), level)

    def _simplified(self, op: int, a: int, b: int) -> int | None:
        zero = self.is_constant
        if op == ca.OP_ASSIGN:
            return a
        if op == NEG:
            return self._operand(a, NEG)
        if op == ADD:
            if zero(a, 0.0) or zero(b, 0.0):
                return b if zero(a, 0.0) else a
            for one, other in ((a, b), (b, a)):
                inner = self._operand(other, NEG)
                if inner is not None:
                    return self.apply(SUB, one, inner)
        elif op == SUB:
            if zero(b, 0.0):
                return a
            if zero(a, 0.0):
                return self.apply(NEG, b)
            inner = self._operand(b, NEG)
            if inner is not None:
                return self.apply(ADD, a, inner)
        elif op == MUL:
            for one, other in ((a, b), (b, a)):
                if zero(one, 0.0):
                    return one
                if zero(one, 1.0):
                    return other
                if zero(one, -1.0):
                    return self.apply(NEG, other)
        elif op == DIV:
            if zero(b, 1.0) or zero(a, 0.0):
                return a
            if self.levels[b] <= LEVEL_PARAMETER < self.levels[a]:  # one reciprocal outside the time loop
                return self.apply(MUL, a, self.apply(INV, b))
        if self.reassociate and op in (ADD, SUB, MUL):
            return self._regrouped(op, a, b)
        return None

    def _operand(self, number: int, op: int) -> int | None:
        node = self.nodes[number]
        return _node(node[1]) if node[0] == op else None

    def _regrouped(self, op: int, a: int, b: int) -> int | None:
        """Join operands that change less often: (s + q) + r = s + (q + r) when q and r are below s."""
        for high, low, swapped in ((a, b, False), (b, a, True)):
            inner_op, c, d = self.nodes[high]
            level = self.levels[high]
            if inner_op in (INPUT, CONSTANT) or not isinstance(c, int) or self.levels[low] >= level or d < 0:
                continue
            if self.is_constant(low) and op != MUL:
                continue
            if op == MUL and inner_op == MUL:
                for s, q in ((c, d), (d, c)):
                    if self.levels[q] < level:
                        return self.apply(MUL, s, self.apply(MUL, q, low))
            elif op in (ADD, SUB) and inner_op in (ADD, SUB):
                joined = self._regrouped_sum(op, inner_op, c, d, low, level, swapped)
                if joined is not None:
                    return joined
        return None

    def _regrouped_sum(self, op: int, inner: int, c: int, d: int, r: int, level: int, swapped: bool) -> int | None:
        sign, sign_r = (-1 if op == SUB and swapped else 1), (-1 if op == SUB and not swapped else 1)
        sign_c, sign_d = sign, (sign if inner == ADD else -sign)
        for s, sign_s, q, sign_q in ((c, sign_c, d, sign_d), (d, sign_d, c, sign_c)):
            if self.levels[q] < level:
                return self._signed_sum(s, sign_s, self._signed_sum(q, sign_q, r, sign_r), 1)
        return None

    def _signed_sum(self, a: int, sign_a: int, b: int, sign_b: int) -> int:
        if sign_a > 0:
            return self.apply(ADD if sign_b > 0 else SUB, a, b)
        if sign_b > 0:
            return self.apply(SUB, b, a)
        return self.apply(NEG, self.apply(ADD, a, b))

    def load(self, function: ca.Function, names: Sequence[str]) -> list[list[int]]:
        """Add the operations of a CasADi SX function; return the nodes of its outputs. names: of its arguments."""
        return self._loaded(function, lambda argument, place: self.input(names[argument], place))

    def _loaded(self, function: ca.Function, leaf: Callable[[int, int], int]) -> list[list[int]]:
        """Return the nodes of the outputs of a function, whose arguments are nodes; leaf: argument, nonzero -> node."""
        work: list[int] = [0] * function.sz_w()
        outputs = [[self.constant(0.0)] * function.numel_out(k) for k in range(function.n_out())]
        rows = [_dense_positions(function.sparsity_out(k)) for k in range(function.n_out())]
        called: Any = function.instructions_sx() if function.get_function() else ()
        for k in range(function.n_instructions()):
            op = function.instruction_id(k)
            into, out = function.instruction_input(k), function.instruction_output(k)
            if op == INPUT:
                work[out[0]] = leaf(into[0], into[1])
            elif op == CONSTANT:
                work[out[0]] = self.constant(function.instruction_constant(k))
            elif op == ca.OP_OUTPUT:
                outputs[out[0]][rows[out[0]][out[1]]] = work[into[0]]
            elif op == CALL:
                results = self._called(called[k].which_function(), [work[place] for place in into])
                for position, place in enumerate(out):
                    if place >= 0:  # else nobody wants it
                        work[place] = results(position)
            else:
                work[out[0]] = self.apply(op, work[into[0]], work[into[1]] if len(into) > 1 else -1)
        return outputs

    def _called(self, function: ca.Function, operands: list[int]) -> Callable[[int], int]:
        """Return the results of a call by position: of an expression that calls others, which is inlined, or of a node.

        Of what is inlined only the calls remain whose results somebody wants.
        """
        if not function.is_a("SXFunction"):
            call = self.call(function, operands)
            return lambda position: self.result(call, position)
        first = [0, *accumulate(function.nnz_in(k) for k in range(function.n_in()))]
        dense = self._loaded(function, lambda argument, place: operands[first[argument] + place])
        sparse = [_dense_positions(function.sparsity_out(k)) for k in range(function.n_out())]
        results = [one[place] for one, places in zip(dense, sparse, strict=True) for place in places]
        return results.__getitem__

    def to_casadi(self, outputs: Iterable[int], symbols: Mapping[str, Any], given: Mapping[int, ca.SX]) -> ca.SX:
        """Return nodes as one CasADi column; symbols: vector name -> column, given: nodes that are known already."""
        wanted = list(outputs)
        value: dict[int, Any] = dict(given)
        for number in self.needed(wanted, given):
            if number in value:
                continue
            op, a, b = self.nodes[number]
            if op == INPUT:
                value[number] = symbols[str(a)][b]
            elif op == CONSTANT:
                value[number] = ca.SX(_number(a))
            elif isinstance(a, Call):
                value[number] = called_with(a.function, [value[k] for k in a.operands])
            elif op == RESULT:
                value[number] = value[_node(a)][b]
            elif b >= 0:
                value[number] = ca.SX.binary(op, value[_node(a)], value[b])
            else:
                value[number] = ca.SX.unary(op, value[_node(a)])
        return ca.densify(ca.vertcat(*[value[k] for k in wanted])) if wanted else ca.SX(0, 1)

    def reached(self, outputs: Iterable[int], is_end: Callable[[int], bool]) -> list[int]:
        """Return the nodes that outputs depend on, depth first, first operands first, not looking behind ends."""
        seen: dict[int, None] = {}
        stack = list(outputs)
        while stack:
            number = stack.pop()
            if number not in seen:
                seen[number] = None
                if not is_end(number):
                    stack += reversed(self.operands(number))
        return list(seen)

    def needed(self, outputs: Iterable[int], given: Mapping[int, object] | None = None) -> list[int]:
        """Return the nodes that outputs depend on, in evaluation order, not looking behind given nodes."""
        return sorted(self.reached(outputs, (given or {}).__contains__))

    def boundary(self, outputs: Iterable[int], level: int) -> list[int]:
        """Return the nodes of at most this level that outputs need directly (hoisting points).

        Constants are left out, and inputs of a lower level.
        """

        def is_end(number: int) -> bool:
            return self.levels[number] <= level

        def is_computed(number: int) -> bool:
            op = self.nodes[number][0]
            return op != CONSTANT and (op != INPUT or self.levels[number] == level)

        return sorted(k for k in self.reached(outputs, is_end) if is_end(k) and is_computed(k))


class Pass(Protocol):
    """A rewriting of a program: returns an equal program, and its nodes for the outputs given."""

    def __call__(self, program: Program, outputs: Sequence[int], /) -> tuple[Program, list[int]]: ...


def _node(operand: int | str | float | Call) -> int:
    """Return an operand that is a node."""
    assert isinstance(operand, int)
    return operand


def _number(operand: int | str | float | Call) -> float:
    """Return an operand that is a value."""
    assert isinstance(operand, int | float)
    return float(operand)


def _dense_positions(sparsity: ca.Sparsity) -> list[int]:
    """Return the row-major dense position of every nonzero (outputs here are columns)."""
    width = sparsity.size2()
    return [r * width + c for r, c in zip(*sparsity.get_triplet(), strict=True)]
