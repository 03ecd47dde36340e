"""Laws that go on beyond where they are defined, so that a search gets past what no run may do.

A trial may empty a tank, from which Torricelli's law takes the root of its level: no number from there on, whatever the
next step would bring. Below zero a root, a logarithm or a broken power is held at its value at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from rotorsim.model.called import called_with

AT_ZERO = 1e-30  # the least argument: its root is far below any signal, and its slope, which is zero below, is finite
_LIMITED = (ca.OP_SQRT, ca.OP_LOG)
_POWERS = (ca.OP_POW, ca.OP_CONSTPOW)


def continued(arguments: Sequence[Any], expressions: Sequence[Any], least: Any) -> list[Any] | None:
    """Return expressions whose laws see no argument below ``least`` where they are not defined for it; None if all are.

    arguments: the symbols of the expressions. least: a symbol; at minus infinity they are as given.
    """
    function = ca.Function("given", [*arguments], [*expressions])
    if not any(function.instruction_id(k) in (*_LIMITED, *_POWERS) for k in range(function.n_instructions())):
        return None
    known: dict[int, Any] = {}
    found = [ca.SX(one) for one in expressions]
    limited = False
    called: Any = function.instructions_sx() if function.get_function() else ()
    for k in range(function.n_instructions()):
        op, taken, given = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            found[given[0]].nz[given[1]] = known[taken[0]]
        elif op == ca.OP_CALL:
            results = called_with(called[k].which_function(), [known[j] for j in taken])
            known |= {place: one for place, one in zip(given, results, strict=True) if place >= 0}
        elif op == ca.OP_CONST:
            known[given[0]] = ca.SX(function.instruction_constant(k))
        elif op == ca.OP_INPUT:
            known[given[0]] = arguments[taken[0]].nz[taken[1]]
        else:
            values = [known[j] for j in taken]
            if op in _LIMITED or (op in _POWERS and not _is_whole(values[1])):
                limited, values[0] = True, ca.fmax(values[0], least)
            known[given[0]] = ca.SX.unary(op, *values) if len(values) == 1 else ca.SX.binary(op, *values)
    return found if limited else None


def _is_whole(power: Any) -> bool:
    return bool(power.is_constant()) and float(power).is_integer()
