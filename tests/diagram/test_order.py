"""Order of evaluation and algebraic loops, port by port."""

from typing import Any

import networkx as nx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rotorsim.model.load import load
from rotorsim.model.trace.order import block_traces, evaluation_order, feedthrough_graph
from tests.diagram.helpers import block, diagram, mistakes, written

CURE = 'put a state into it (integrator, derivative filter, delay), or write "algebraic_loops": "solve"'


def test_a_loop_is_printed_hop_by_hop() -> None:
    text = written(
        diagram(
            {"c": "constant", "s": block("sum", signs="+-"), "g": "gain", "after": "gain"},
            ("c.output", "s.input1"),
            ("s.output", "g.input"),
            ("g.output", "s.input2"),
            ("g.output", "after.input"),
        )
    )
    assert mistakes(text) == [f"1:40: s: algebraic loop: s.output -> g.input, g.output -> s.input2 | {CURE}"]


def test_two_loops_are_both_reported_and_a_block_may_feed_itself() -> None:
    document = diagram(
        {"s": "sum", "t": "sum", "i": "integrator", "a": "constant"},
        ("s.output", "s.input1"),
        ("i.output", "s.input2"),
        ("t.output", "t.input1"),
        ("a.output", "t.input2"),
        ("s.output", "i.input"),
    )
    assert mistakes(document) == [
        f": s: algebraic loop: s.output -> s.input1 | {CURE}",
        f": t: algebraic loop: t.output -> t.input1 | {CURE}",
    ]


def test_a_loop_may_be_solved_and_is_then_one_group() -> None:
    document = diagram(
        {"c": "constant", "s": "sum", "g": "gain", "after": "gain"},
        ("c.output", "s.input1"),
        ("s.output", "g.input"),
        ("g.output", "s.input2"),
        ("g.output", "after.input"),
        algebraic_loops="solve",
    )
    groups = evaluation_order(load(document))
    assert [set(group) for group in groups] == [
        {("c", "output")},
        {("s", "output"), ("g", "output")},
        {("after", "output")},
    ]


def test_a_state_in_the_loop_is_a_cure() -> None:
    document = diagram({"i": "integrator", "g": "gain"}, ("i.output", "g.input"), ("g.output", "i.input"))
    assert evaluation_order(load(document)) == ((("i", "output"),), (("g", "output"),))


def test_feedthrough_is_per_port_not_per_block() -> None:
    # the rotor's displacement does not depend on the force at the same instant, so amb and rotor form no loop
    loaded = load("jeffcott")
    order = [group[0] for group in evaluation_order(loaded)]
    assert order.index(("rotor", "displacement")) < order.index(("controller", "current"))
    assert order.index(("controller", "current")) < order.index(("amb", "force"))
    graph = feedthrough_graph(loaded, {name: trace.feedthrough for name, trace in block_traces(loaded).items()})
    assert not list(graph.predecessors(("rotor", "displacement")))
    assert graph.edges[("clock", "speed"), ("unbalance", "force")]["via"] == "speed"


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_the_order_is_topological_and_the_groups_are_the_strong_components(data: st.DataObject) -> None:
    n = data.draw(st.integers(2, 8))
    kinds = data.draw(st.lists(st.sampled_from(["gain", "sum", "integrator", "unit_delay"]), min_size=n, max_size=n))
    blocks: dict[str, Any] = {f"b{k}": kind for k, kind in enumerate(kinds)}
    wires = []
    for k, kind in enumerate(kinds):
        for port in ("input1", "input2") if kind == "sum" else ("input",):
            wires.append((f"b{data.draw(st.integers(0, n - 1))}.output", f"b{k}.{port}"))
    loaded = load(diagram(blocks, *wires, algebraic_loops="solve"))
    groups = evaluation_order(loaded)
    assert sorted(key for group in groups for key in group) == sorted((f"b{k}", "output") for k in range(n))

    graph = nx.DiGraph()  # computed here from what each kind is known to do
    graph.add_nodes_from((f"b{k}", "output") for k in range(n))
    for source, target in wires:
        to = target.split(".")[0]
        if blocks[to] in ("gain", "sum"):
            graph.add_edge((source.split(".")[0], "output"), (to, "output"))
    position = {key: k for k, group in enumerate(groups) for key in group}
    assert {frozenset(group) for group in groups} == {frozenset(c) for c in nx.strongly_connected_components(graph)}
    assert all(position[a] <= position[b] for a, b in graph.edges)


@pytest.mark.parametrize("name", ["jeffcott", "fe_flexible", "jeffcott_elementary"])
def test_shipped_diagrams_have_no_loops(name: str) -> None:
    loaded = load(name)
    assert all(len(group) == 1 for group in evaluation_order(loaded))
    assert sum(len(node.outputs) for node in loaded.nodes.values()) == len(evaluation_order(loaded))
