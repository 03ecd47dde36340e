"""Algebraic loops solved by Newton's method, traced like everything else: one step where the loop is linear."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import casadi as ca
import networkx as nx
import numpy as np

from rotorsim.model.trace.order import Key

LOOP_NEWTON_STEPS = 12  # of a nonlinear loop


def solve_loop(
    group: Collection[Key],
    feeding: Callable[[Key], Iterable[Key]],
    output: Callable[[Key, Mapping[Key, Any]], Any],
    signals: Mapping[Key, Any],
    sizes: Mapping[Key, int],
) -> tuple[dict[Key, Any], Any]:
    """Solve r(v) = F(v) - v = 0 for the torn signals v of one loop; return all its signals and what is left of r.

    Every signal of the group is torn that no later one can be computed without; the rest follow. feeding: the outputs
    that one needs at once; output: one as an expression of those known; sizes: entries of each. r is None for a
    linear loop, which one step solves.
    """
    torn, order = _tear(group, feeding, sizes)

    def followed(values: Mapping[Key, Any]) -> dict[Key, Any]:
        known = {**signals, **values}
        for key in order:
            known[key] = output(key, known)
        return known

    guess = {key: ca.SX.sym("loop", sizes[key]) for key in torn}
    unknown = ca.vertcat(*guess.values())
    known = followed(guess)
    residual = ca.vertcat(*[output(key, known) for key in torn]) - unknown
    jacobian = ca.jacobian(residual, unknown)
    symbols = ca.symvar(ca.vertcat(residual, ca.vec(jacobian)))
    others = [symbol for symbol in symbols if not ca.depends_on(unknown, symbol)]
    newton = ca.Function("newton", [unknown, *others], [unknown - ca.solve(jacobian, residual), residual])
    linear = not ca.depends_on(jacobian, unknown)
    value = ca.SX.zeros(unknown.shape[0])
    for _ in range(1 if linear else LOOP_NEWTON_STEPS):
        value = newton.call([value, *others])[0]
    left = None if linear else newton.call([value, *others])[1] / (1 + ca.fabs(value))
    ends = np.cumsum([0, *(sizes[key] for key in torn)]).tolist()
    known = followed(dict(zip(torn, ca.vertsplit(value, ends), strict=True)))
    return {key: known[key] for key in group}, left


def _tear(
    group: Collection[Key], feeding: Callable[[Key], Iterable[Key]], sizes: Mapping[Key, int]
) -> tuple[list[Key], list[Key]]:
    """Return the signals to tear, few and small ones, and the others in the order in which they follow."""
    graph = nx.DiGraph()
    graph.add_nodes_from(group)
    graph.add_edges_from((source, key) for key in group for source in feeding(key) if source in group)
    torn: list[Key] = []
    while True:
        cycle = next((c for c in nx.strongly_connected_components(graph) if len(c) > 1), ())
        loops = list(nx.nodes_with_selfloops(graph))
        if not cycle and not loops:
            return torn, list(nx.topological_sort(graph))
        best = loops[0] if loops else min(cycle, key=lambda k: (sizes[k], -graph.degree(k), k))
        torn.append(best)
        graph.remove_node(best)
