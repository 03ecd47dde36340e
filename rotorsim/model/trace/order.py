"""In which order the outputs of blocks can be computed, and where that is a circle (algebraic loops)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import networkx as nx
import numpy as np

from rotorsim.block import Block
from rotorsim.diagram.diagram import Diagram, Node
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.trace.block import BlockTrace, TraceError, trace_block

Key = tuple[str, str]  # (block, port)
Feedthrough = Mapping[str, Mapping[str, Iterable[str]]]
Shapes = tuple[tuple[str, Any], ...]
CACHED_TRACES = 256  # traces of blocks; a diagnosis loads hundreds of diagrams that differ in one block
SHOWN_HOPS = 20  # at the start and at the end of a loop
_TRACES: WeakKeyDictionary[Diagram, dict[bool, dict[str, BlockTrace]]] = WeakKeyDictionary()


def block_traces(diagram: Diagram, *, called: bool = False) -> Mapping[str, BlockTrace]:
    """Return the trace of every block (like blocks share one, of other diagrams too), kept as long as the diagram.

    called: opaque blocks as they are called, though they are said to be linear. Raises RotorsimError with all blocks
    whose equations fail.
    """
    kept = _TRACES.setdefault(diagram, {})
    if called in kept:
        return kept[called]
    wired = {(wire.target.block, wire.target.port) for wire in diagram.wires} | diagram.cut
    traces: dict[str, BlockTrace] = {}
    problems: list[Problem] = []
    for name, node in diagram.nodes.items():
        inputs = {
            port: declared.shape for port, declared in node.inputs.items() if (name, port) in wired or declared.additive
        }
        shapes = {key: np.shape(value) for key, value in node.values.items()}
        outputs = {port: declared.shape for port, declared in node.outputs.items()}
        each = [tuple(s.items()) for s in (inputs, outputs, shapes, node.state_shapes, node.random_shapes)]
        try:
            options = repr(sorted(vars(node.block.option).items()))
            traces[name] = _traced(_Like(node.block, type(node.block), options, node.block.wired, called), *each)
        except Exception as error:  # the equations are foreign code
            problems.append(_failed(node, error))
    if problems:
        raise RotorsimError(*problems)
    kept[called] = traces
    return traces


@dataclass(frozen=True)
class _Like:
    """A block that equals every other one with the same equations: of its class, with its options and wired inputs."""

    block: Block = field(compare=False)
    kind: type[Block]
    options: str
    wired: frozenset[str]
    called: bool


@lru_cache(maxsize=CACHED_TRACES)
def _traced(
    like: _Like, inputs: Shapes, outputs: Shapes, parameters: Shapes, states: Shapes, randoms: Shapes
) -> BlockTrace:
    shapes = (dict(one) for one in (inputs, outputs, parameters, states, randoms))
    return trace_block(like.block, *shapes, called=like.called)


def _failed(node: Node, error: Exception) -> Problem:
    kind = type(node.block)
    if isinstance(error, TraceError):
        return Problem(f"block type '{kind.type_name}': {error}", node.name, node.place, "correct the block file")
    text = str(error).strip().split("\n")[-1][:200]
    return Problem(
        f"equations of block type '{kind.type_name}' fail: {type(error).__name__}: {text}",
        node.name,
        node.place,
        "check options and shapes, or the block file",
    )


def feedthrough_graph(diagram: Diagram, feedthrough: Feedthrough) -> nx.DiGraph:
    """Return the graph of (block, output port): an edge where one is needed to compute the other at once.

    feedthrough: block -> output port -> the input ports that act on it. Every edge carries ``via``: the input port
    through which it acts.
    """
    into: dict[Key, list[Key]] = {}
    for wire in diagram.wires:
        into.setdefault((wire.target.block, wire.target.port), []).append((wire.source.block, wire.source.port))
    graph = nx.DiGraph()
    for name, ports in feedthrough.items():
        for port, feeding in ports.items():
            graph.add_node((name, port))
            for fed in feeding:
                graph.add_edges_from(((source, (name, port)) for source in into.get((name, fed), ())), via=fed)
    return graph


def evaluation_groups(graph: nx.DiGraph) -> tuple[tuple[Key, ...], ...]:
    """Return the nodes of a graph in evaluation order; those of one loop are one group."""
    try:
        return tuple((key,) for key in nx.topological_sort(graph))
    except nx.NetworkXUnfeasible:
        condensed = nx.condensation(graph)
    position = {key: k for k, key in enumerate(graph)}
    members = (condensed.nodes[k]["members"] for k in nx.topological_sort(condensed))
    return tuple(tuple(sorted(group, key=position.__getitem__)) for group in members)


def evaluation_order(diagram: Diagram, given: Iterable[Key] = ()) -> tuple[tuple[Key, ...], ...]:
    """Return groups of (block, output port) in evaluation order; a group of several, or of one that feeds
    itself, is an algebraic loop.

    given: outputs whose consumers see something else, so that no loop passes through them.
    Raises RotorsimError that prints every loop hop by hop unless the diagram solves its loops.
    """
    graph = feedthrough_graph(diagram, {name: trace.feedthrough for name, trace in block_traces(diagram).items()})
    graph.remove_edges_from([edge for key in given for edge in graph.out_edges(key)])
    groups = evaluation_groups(graph)
    loops = [group for group in groups if len(group) > 1 or graph.has_edge(group[0], group[0])]
    if loops and not diagram.solve_loops:
        raise RotorsimError(*[_loop_problem(diagram, graph, loop) for loop in loops])
    return groups


def _loop_problem(diagram: Diagram, graph: nx.DiGraph, loop: tuple[Key, ...]) -> Problem:
    cycle = nx.find_cycle(graph.subgraph(loop), loop[0])
    hops = [
        f"{block}.{port} -> {after}.{graph.edges[(block, port), (after, out)]['via']}"
        for (block, port), (after, out) in cycle
    ]
    if len(hops) > 2 * SHOWN_HOPS:
        hops[SHOWN_HOPS:-SHOWN_HOPS] = [f"... {len(hops) - 2 * SHOWN_HOPS} more hops ..."]
    more = f" (and {len(loop) - len(cycle)} more outputs in the same loop)" if len(loop) > len(cycle) else ""
    return Problem(
        "algebraic loop: " + ", ".join(hops) + more,
        cycle[0][0][0],
        diagram.nodes[cycle[0][0][0]].place,
        'put a state into it (integrator, derivative filter, delay), or write "algebraic_loops": "solve"',
    )
