"""What outputs and state derivatives depend on, from the sparsity of the traced equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.model.linearity import is_affine
from rotorsim.model.part import Part

Rows = list[list[int]]
CONSTANT, FIXED, TUNABLE, DEPENDENT = "constant", "fixed", "tunable", "dependent"  # dependenciesKind (FMI 2.0, 3.0)


@dataclass(frozen=True)
class Dependencies:
    """Sparsity of rows [xdot; y; events] by columns [x; u; t] and by p, and of [xdot; y; x0] at the start.

    kinds: of the entries of by_column, whether a row is its column times a factor, and what the factor follows. At the
    start the columns are x exact; z exact; u; p; t (how many: 0 or 1). moving: positions of outputs that change between
    sample hits.
    """

    by_column: Rows
    kinds: list[dict[int, str]]
    by_parameter: Rows
    initial_x: Rows
    initial_z: Rows
    initial_u: Rows
    initial_p: Rows
    initial_t: Rows
    moving: frozenset[int]


def find_dependencies(
    part: Part, record: Sequence[str], x_constant: np.ndarray, z_constant: np.ndarray, fixed: bool
) -> Dependencies:
    """Return what depends on what: in motion, and at the start, when states follow from parameters.

    fixed: no parameter changes after the start.
    """
    trace = part.trace
    y = ca.vertcat(*[part.expression(name) for name in record]) if record else ca.SX(0, 1)
    u = inputs_of(part)
    moving_columns = ca.vertcat(trace.x, u, trace.t)
    rows = ca.vertcat(trace.xdot, y, trace.events)
    by_column, by_parameter = _rows(rows, moving_columns), _rows(rows, trace.p)
    kinds = _kinds(rows, ca.vertcat(trace.x, u), ca.vertcat(trace.x, trace.z, trace.t), trace.p, fixed)
    n_x = part.n_x
    moving = frozenset(k for k in range(y.numel()) if by_column[n_x + k])
    own, outputs = part.n_z - u.numel(), slice(n_x, n_x + y.numel())
    if trace.samplers and y.numel() and own:  # what passes through at a sample hit
        new = ca.substitute(trace.z_next, trace.hit, ca.SX.ones(*trace.hit.shape))[:own]
        at_hit = ca.substitute(y, trace.z[:own], new)
        passing = [[c + n_x for c in columns] for columns in _rows(at_hit, u)]
        by_column[outputs] = _joined(by_column[outputs], passing)
        kinds[outputs] = [{} for _ in passing]
        by_parameter[outputs] = _joined(by_parameter[outputs], _rows(at_hit, trace.p))
    first = ca.vertcat(trace.xdot, y, trace.x0)
    for symbols, begun, constant in ((trace.x, trace.x0, x_constant), (trace.z[:own], trace.z0, z_constant[:own])):
        if not constant.all():
            begun = ca.densify(begun)
            start = [symbols[k] if exact else begun[k] for k, exact in enumerate(constant)]
            first = ca.substitute(first, symbols, ca.vertcat(*start))
    initial_x, initial_z, initial_u, initial_p, initial_t = (
        _rows(first, symbols) for symbols in (trace.x, trace.z[:own], u, trace.p, trace.t)
    )
    following = [[c - n_x for c in columns if n_x <= c < n_x + u.numel()] for columns in by_column[outputs]]
    initial_u[outputs] = _joined(initial_u[outputs], following)
    return Dependencies(by_column, kinds, by_parameter, initial_x, initial_z, initial_u, initial_p, initial_t, moving)


def _joined(first: Rows, second: Rows) -> Rows:
    """Return the columns that are in either."""
    return [sorted({*a, *b}) for a, b in zip(first, second, strict=True)]


def _kinds(rows: Any, columns: Any, moving: Any, p: Any, fixed: bool) -> list[dict[int, str]]:
    """Return for each row the kind of what it depends on by column; what is not named is dependent."""
    found: list[dict[int, str]] = []
    for row in ca.vertsplit(ca.densify(rows)) if rows.numel() else []:
        found.append({})
        if not is_affine(row, columns):
            continue
        factors = ca.jacobian(row, columns)
        for k, column in enumerate(factors.sparsity().get_triplet()[1]):
            if not ca.depends_on(factor := factors.nz[k], moving):
                set_by = ca.depends_on(factor, p)
                found[-1][column] = CONSTANT if not set_by else FIXED if fixed else TUNABLE
    return found


def inputs_of(part: Part) -> Any:
    """Return the inputs of a part as symbols of its trace."""
    places = [k for signal in part.inputs.values() for k in range(signal.part.start, signal.part.stop)]
    return part.trace.z[places] if places else ca.SX(0, 1)


def _rows(expression: Any, symbols: Any) -> Rows:
    """Return the columns on which every row of an expression depends."""
    found: Rows = [[] for _ in range(expression.numel())]
    if not expression.numel() or not symbols.numel():
        return found
    sparsity = ca.jacobian_sparsity(ca.densify(expression), symbols)
    for row, column in zip(*sparsity.get_triplet(), strict=True):
        found[row].append(column)
    return [sorted(columns) for columns in found]
