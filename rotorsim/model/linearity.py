"""Whether an expression is linear, as it is written: a derivative does not tell (a sign has none, but steps)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import casadi as ca

from rotorsim.model.called import called_with

_SUMS = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_TWICE, ca.OP_ASSIGN)
_PRODUCTS = (ca.OP_MUL, ca.OP_DIV, ca.OP_IF_ELSE_ZERO)


def is_affine(of: Any, by: Any, beside: Any = None) -> bool:
    """Return whether an expression is a + B by with a and B independent of the symbols ``by``, B also of ``beside``."""
    beside = ca.SX(0, 1) if beside is None else beside
    known = _hashes(ca.vertcat(by, beside))
    others = [symbol for symbol in ca.symvar(ca.SX(of)) if symbol.element_hash() not in known]
    function = ca.Function("f", [by, beside, ca.vertcat(*others)], [of])
    moves = [False] * function.sz_w()  # with ``by``
    varies = [False] * function.sz_w()  # with either
    for k in range(function.n_instructions()):
        op, given, to = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            continue
        if op in (ca.OP_INPUT, ca.OP_CONST):
            moves[to[0]] = op == ca.OP_INPUT and given[0] == 0
            varies[to[0]] = op == ca.OP_INPUT and given[0] <= 1
            continue
        moved = any(moves[place] for place in given)
        if moved and op not in _SUMS:
            second = op == ca.OP_IF_ELSE_ZERO or (op == ca.OP_MUL and moves[given[-1]])
            factors = given[:1] if second else given[1:]
            if op not in _PRODUCTS or any(varies[place] for place in factors):
                return False
        varied = any(varies[place] for place in given)
        for place in (place for place in to if place >= 0):
            moves[place], varies[place] = moved, varied
    return True


def jacobian(of: Any, by: Any) -> Any:
    """Return the sparse derivatives of an expression by symbols; what is called with others alone has none.

    CasADi by itself goes on to differentiate such calls, of zeros, and the factors of a linear part seem to move.
    """
    of = ca.SX(of)
    if not ca.Function("f", ca.symvar(of), [of]).get_function():
        return ca.jacobian(of, by)
    own = _hashes(by)
    others = [symbol for symbol in ca.symvar(of) if symbol.element_hash() not in own]
    rest, symbols, values = ca.extract_parametric(ca.cse(of), ca.vertcat(ca.SX(0, 1), *others))
    return ca.substitute([ca.jacobian(rest, by)], symbols, values)[0]


def pattern(of: Any, by: Any) -> ca.Sparsity:
    """Return where `jacobian` may have entries that are not zero."""
    of = ca.SX(of)
    if ca.Function("f", ca.symvar(of), [of]).get_function():
        return ca.Sparsity(jacobian(of, by).sparsity())
    found: ca.Sparsity = ca.jacobian_sparsity(of, by)
    return found


@dataclass(frozen=True, eq=False)
class SemiLinear:
    """of = a + B [by; w], w = phi(by, fast, slow): what is linear in ``by``, and the laws of the rest.

    of (k,), phi (r,): expressions, the former of by and of the symbols w (r,). B depends on neither by nor fast, a on
    none of the three.
    """

    of: Any
    w: Any
    phi: Any


class _Kind(IntEnum):
    """What a term is: steady, of what changes slowly alone, linear in ``by`` and in laws, or a law itself."""

    STEADY = 0
    SLOW = 1
    LINEAR = 2
    LAW = 3


@dataclass(frozen=True)
class _Term:
    kind: _Kind
    value: Any  # as given
    linear: Any  # with symbols for terms that are neither independent nor linear


def semi_linear(of: Any, by: Any, fast: Any, slow: Any) -> SemiLinear:
    """Return an expression with what is not linear in symbols ``by``, or changes with ``fast`` and ``slow``, apart."""
    known = _hashes(ca.vertcat(by, fast, slow))
    others = [one for one in ca.symvar(ca.SX(of)) if one.element_hash() not in known]
    given = [by, fast, slow, ca.vertcat(*others)]
    kinds = (_Kind.LINEAR, _Kind.LAW, _Kind.SLOW, _Kind.STEADY)
    function = ca.Function("f", given, [ca.cse(ca.densify(of))])
    work: dict[int, _Term] = {}
    symbols: list[Any] = []
    laws: list[Any] = []
    out = ca.SX.zeros(function.numel_out(0))

    def linear(place: int, entering: bool = True) -> Any:
        """Return a term that is linear, a symbol in the place of what is a law."""
        term = work[place]
        if term.kind == _Kind.LAW or (term.kind == _Kind.SLOW and entering):
            symbols.append(ca.SX.sym("w"))
            laws.append(term.value)
            work[place] = term = _Term(_Kind.LINEAR, term.value, symbols[-1])
        return term.linear

    called: Any = function.instructions_sx() if function.get_function() else ()
    for k in range(function.n_instructions()):
        op, places, to = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_CALL:  # of a part without an expression: a law of whatever moves
            terms = [work[place] for place in places]
            kind = max((term.kind for term in terms), default=_Kind.STEADY)
            kind = kind if kind <= _Kind.SLOW else _Kind.LAW
            results = called_with(called[k].which_function(), [term.value for term in terms])
            work |= {place: _Term(kind, one, one) for place, one in zip(to, results, strict=True) if place >= 0}
        elif op == ca.OP_OUTPUT:
            out[to[1]] = linear(places[0])
        elif op == ca.OP_INPUT:
            symbol = given[places[0]][places[1]]
            work[to[0]] = _Term(kinds[places[0]], symbol, symbol)
        elif op == ca.OP_CONST:
            constant = ca.SX(function.instruction_constant(k))
            work[to[0]] = _Term(_Kind.STEADY, constant, constant)
        else:
            kind = _kind_of(op, [work[place].kind for place in places])
            value = _applied(op, [work[place].value for place in places])
            parts = [linear(place, op in _SUMS) for place in places] if kind == _Kind.LINEAR else []
            work[to[0]] = _Term(kind, value, _applied(op, parts) if parts else value)
    entered = _hashes(out)
    used = [k for k, symbol in enumerate(symbols) if symbol.element_hash() in entered]
    w, phi = ca.vertcat(*[symbols[k] for k in used]), ca.vertcat(*[laws[k] for k in used])
    return SemiLinear(out, ca.SX(w), ca.SX(phi))


def _hashes(expression: Any) -> set[int]:
    """Return what tells the symbols in an expression."""
    return {symbol.element_hash() for symbol in ca.symvar(ca.SX(expression))}


def _kind_of(op: int, kinds: Sequence[_Kind]) -> _Kind:
    if max(kinds) <= _Kind.SLOW:
        return max(kinds)
    if op in _SUMS:
        return _Kind.LINEAR if _Kind.LINEAR in kinds else _Kind.LAW
    moves = [k for k, kind in enumerate(kinds) if kind > _Kind.SLOW]
    factor = op == ca.OP_MUL or (op, *moves) in ((ca.OP_DIV, 0), (ca.OP_IF_ELSE_ZERO, 1))
    forced = _Kind.LAW in kinds and _Kind.SLOW in kinds  # what drives is followed from instant to instant
    return _Kind.LINEAR if len(moves) == 1 and factor and not forced else _Kind.LAW


def _applied(op: int, values: Sequence[Any]) -> Any:
    return ca.SX.unary(op, values[0]) if len(values) == 1 else ca.SX.binary(op, *values)
