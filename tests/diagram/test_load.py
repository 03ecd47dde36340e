"""Good diagrams: values in SI, references, settings, what is recorded, what is cut, shapes that are found."""

import json
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.errors import RotorsimError
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.load import load
from rotorsim.model.trace.order import block_traces
from tests.diagram.helpers import block, diagram, mistakes, written


@pytest.mark.parametrize("name", sorted(shipped_diagrams()))
def test_a_shipped_diagram_has_no_mistakes_and_no_warnings(name: str) -> None:
    loaded = load(name)
    assert loaded.warnings == ()
    assert loaded.name == name
    assert set(block_traces(loaded)) == set(loaded.nodes)


def test_values_are_si_arrays_of_the_resolved_shape() -> None:
    loaded = load("jeffcott")
    rotor, clock = loaded.nodes["rotor"], loaded.nodes["clock"]
    assert clock.values["speed"] == pytest.approx(50 * math.pi, rel=1e-15)
    assert rotor.values["stiffness"].shape == ()
    assert loaded.nodes["unbalance"].values["eccentricity"] == 24e-6
    assert clock.references == {"speed": "speed"}
    assert loaded.parameter_units["speed"] == "rad/s"
    assert loaded.parameters["speed"] == clock.values["speed"]
    assert rotor.outputs["displacement"].shape == (2,)
    assert str(rotor.outputs["displacement"]) == "rotor.displacement"
    assert (loaded.solver.method, loaded.solver.step, loaded.solver.stop) == ("rk4", 1e-4, 5.0)
    assert [str(end) for end in loaded.record][:2] == ["rotor.displacement", "controller.current"]


def test_a_file_and_its_document_give_the_same_diagram() -> None:
    file = shipped_diagrams()["jeffcott"]
    one, two = load(file), load(json.loads(file.read_text()))
    assert one.record == two.record
    assert [(w.source, w.target) for w in one.wires] == [(w.source, w.target) for w in two.wires]
    assert one.sha256 == two.sha256
    assert str(one.wires[0].place).startswith(f"{file}:")
    assert one.file == str(file)


def test_settings_take_the_place_of_values_and_are_kept_in_the_document() -> None:
    loaded = load(
        "jeffcott", set={"speed": "25 Hz", "controller.KP": 9, "crack.stiffness": "1", "solver.step": "50 us"}
    )
    assert loaded.nodes["clock"].values["speed"] == pytest.approx(50 * math.pi, rel=1e-15)
    assert loaded.nodes["controller"].values["KP"] == 9.0
    assert loaded.nodes["crack"].values["stiffness"] == 1.0
    assert "stiffness" not in loaded.nodes["crack"].references
    assert loaded.solver.step == 5e-5
    assert loaded.warnings == ()  # crack_stiffness is put aside, not forgotten
    assert loaded.document["parameters"]["speed"] == "25 Hz"
    assert loaded.document["blocks"]["controller"]["parameters"]["KP"] == 9
    assert loaded.document["solver"]["step"] == "50 us"
    assert loaded.sha256 != load("jeffcott").sha256
    assert json.loads(shipped_diagrams()["jeffcott"].read_text())["parameters"]["speed"] == "1500 rpm"


@pytest.mark.slow
def test_an_entry_that_is_set_leaves_the_others_as_the_diagram_has_them() -> None:
    given = {"support_left.stiffness[2]": "7 N/um"}
    loaded, before = load("fe_flexible", set=given), load("fe_flexible")
    stiffness = before.nodes["support_left"].values["stiffness"]
    assert loaded.nodes["support_left"].values["stiffness"].tolist() == [stiffness[0], 7e6]
    drawn = load("drawn_rotor", set={"rotor.section_lengths[2]": "150 mm"})
    lengths = load("drawn_rotor").nodes["rotor"].block.option.section_lengths
    assert list(drawn.nodes["rotor"].block.option.section_lengths) == [lengths[0], 0.15, *lengths[2:]]
    again = load(loaded.document, folder=loaded.folder)
    assert again.nodes["support_left"].values["stiffness"].tolist() == [stiffness[0], 7e6]
    one = modes(load("fe_flexible", set={"support_left.stiffness[2]": 7e6})).modes
    other = modes(before, parameters={"support_left.stiffness[2]": 7e6}).modes
    assert [mode.eigenvalue for mode in one] == pytest.approx([mode.eigenvalue for mode in other], rel=1e-12)


def test_an_entry_of_a_diagram_parameter_has_the_shape_of_what_follows_it() -> None:
    rotor = block("rotor_2dof", mass=1.0, stiffness=1.0)
    document = diagram(
        {"support": block("support", stiffness="$k", damping=[1.0, 1.0]), "rotor": rotor},
        ("rotor.displacement", "support.displacement"),
        ("rotor.velocity", "support.velocity"),
        ("support.force", "rotor.force"),
        parameters={"k": ["3 kN/m", "4 kN/m"]},
    )
    loaded = load(document, set={"k[1]": "5 kN/m"})
    assert loaded.parameters["k"].tolist() == loaded.nodes["support"].values["stiffness"].tolist() == [5000.0, 4000.0]


def test_entries_that_are_not_there_are_refused_all_at_once() -> None:
    given = {
        "support_left.stiffness[3]": 1.0,
        "support_left.stiffness[x]": 1.0,
        "controller.KP[1]": 1.0,
        "controller.KX[1]": 1.0,
        "support_left.damping[1]": [1.0, 2.0],
    }
    with pytest.raises(RotorsimError) as caught:
        load("fe_flexible", set=given)
    assert [(one.what, one.subject, one.hint) for one in caught.value.problems] == [
        ("no such entry; the parameter is 2, counted from 1", "support_left.stiffness[3]", FIRST),
        ("no such entry; the parameter is 2, counted from 1", "support_left.stiffness[x]", FIRST),
        (
            "no such entry; the parameter is a single number, counted from 1",
            "controller.KP[1]",
            "set it whole: controller.KP=...",
        ),
        (
            "no such parameter",
            "controller.KX[1]",
            "did you mean 'controller.KP' or 'controller.KI' or 'controller.KD'?",
        ),
        (
            "an entry is one value, not a list",
            "support_left.damping[1]",
            "the whole parameter: support_left.damping=[...]",
        ),
    ]


FIRST = "support_left.stiffness[1] is the first"


def test_one_parameter_may_be_followed_by_blocks_of_no_unit_and_of_a_unit() -> None:
    document = diagram(
        {"c": block("constant", value="$k"), "crack": block("crack", stiffness="$k")},
        ("c.output", "crack.theta"),
        parameters={"k": "3 kN/m"},
    )
    loaded = load(document)
    assert loaded.nodes["c"].values["value"] == 3000.0
    assert loaded.parameter_units == {"k": "N/m"}


def test_an_option_may_follow_a_diagram_parameter() -> None:
    document = diagram(
        {"c": "clock", "k": block("crack", opening="$law", terms="$terms")},
        ("c.theta", "k.theta"),
        parameters={"law": "harmonics", "terms": 7},
    )
    loaded = load(document)
    assert loaded.warnings == ()
    assert loaded.nodes["k"].block.option.opening == "harmonics"
    assert loaded.nodes["k"].block.option.terms == 7
    assert "law" not in loaded.parameters


def test_without_cuts_wires_and_what_needs_them_reads_zero() -> None:
    loaded = load("jeffcott", without=["clock", "amb"])
    assert "amb" not in loaded.nodes
    assert not any("amb" in (w.source.block, w.target.block) for w in loaded.wires)
    assert {("crack", "theta"), ("unbalance", "theta"), ("unbalance", "speed")} <= loaded.cut
    assert not any(port == ("rotor", "force") for port in loaded.cut)  # a sum without this term
    assert [str(end) for end in loaded.record][:2] == ["rotor.displacement", "controller.current"]
    assert load("jeffcott", without=["clock"]).record == tuple(e for e in load("jeffcott").record if e.block != "clock")


def test_an_optional_input_that_is_cut_is_as_if_never_wired() -> None:
    document = diagram(
        {"r": "rotor_2dof", "v": "rotor_2dof", "p": "pid"},
        ("r.displacement", "p.displacement"),
        ("v.velocity", "p.velocity"),
    )
    whole, cut = load(document), load(document, without=["v"])
    assert whole.nodes["p"].block.wired == {"velocity"}
    assert cut.nodes["p"].block.wired == frozenset()
    assert len(cut.nodes["p"].state_shapes) == len(whole.nodes["p"].state_shapes) + 1  # the derivative is filtered


def test_what_is_recorded_when_nothing_is_said() -> None:
    document = diagram({"c": "clock", "g": "gain", "k": "crack"}, ("c.theta", "g.input"), ("c.theta", "k.theta"))
    assert {end.block for end in load(document).record} == {"c", "k"}
    assert [str(end) for end in load(diagram({"a": "constant", "g": "gain"}, ("a.output", "g.input"))).record] == [
        "a.output",
        "g.output",
    ]


def test_an_input_of_a_diagram_of_its_own_reads_zero_and_says_so() -> None:
    document = diagram({"g": "gain"}, ports={"inputs": {"u": "g.input"}, "outputs": {"y": "g.output"}})
    assert load(document).cut == {("g", "input")}
    assert mistakes(document) == [
        ": warning: g.input: input reads zero unless this diagram is a part of another "
        "| a diagram that runs by itself wires all its inputs"
    ]
    wrong = diagram({"g": "gain"}, ports={"inputs": {"u": "q.input"}, "outputs": {"y": "g.outputt"}, "x": {}})
    assert mistakes(wrong)[:3] == [
        ": ports: unknown key 'x' | known: inputs, outputs",
        ": q.input: no block 'q' | known: g",
        ": g.outputt: block type 'gain' has no output 'outputt' | did you mean 'output'?",
    ]


def test_places_survive_pickling_and_do_not_keep_the_text() -> None:
    wire = load("jeffcott").wires[0]
    assert pickle.loads(pickle.dumps(wire)).place == wire.place


# --- shapes -----------------------------------------------------------------------------------------


def shape_of(loaded: Diagram, port: str) -> tuple[int, ...]:
    name, _, key = port.partition(".")
    node = loaded.nodes[name]
    return (node.outputs | node.inputs)[key].shape


def test_a_shape_runs_along_wires_in_both_directions() -> None:
    document = diagram(
        {"a": "gain", "s": "sum", "i": "integrator", "b": "gain", "v": block("constant", value=[1, 2, 3])},
        ("i.output", "a.input"),
        ("a.output", "s.input1"),
        ("b.output", "s.input2"),
        ("v.output", "b.input"),
        ("s.output", "i.input"),
    )
    loaded = load(document)
    for port in ("a.input", "a.output", "s.input1", "s.output", "i.input", "i.output", "b.output"):
        assert shape_of(loaded, port) == (3,)
    assert loaded.nodes["i"].state_shapes == {"value": (3,)}


def test_a_scalar_value_fills_the_shape_that_its_wires_ask_for() -> None:
    document = diagram({"c": block("constant", value="2 kN"), "r": "rotor_2dof"}, ("c.output", "r.force"))
    loaded = load(document)
    np.testing.assert_array_equal(loaded.nodes["c"].values["value"], [2000.0, 2000.0])


def test_what_nothing_determines_is_a_scalar() -> None:
    document = diagram({"i": "integrator", "g": "gain"}, ("i.output", "g.input"), ("g.output", "i.input"))
    assert shape_of(load(document), "i.output") == ()


def test_rows_and_entries_of_wider_signals() -> None:
    document = diagram(
        {"c": "clock", "fe": block("rotor_fe"), "p": "pid", "g": "gain", "a": block("constant", value=[1, 2])},
        ("c.speed", "fe.speed"),
        ("fe.displacement[3]", "p.displacement"),
        ("fe.displacement[3,2]", "g.input"),
        ("a.output", "fe.force[2]"),
        ("g.output", "fe.force[6,1]"),
    )
    loaded = load(document)
    assert shape_of(loaded, "g.input") == ()
    assert Endpoint("fe", "force", (5, 0)) in [wire.target for wire in loaded.wires]


def test_matrices_give_the_sizes_of_a_state_space_block() -> None:
    matrices = {"A": [[0, 1], [-1, 0]], "B": [[0], [1]], "C": [[1, 0], [0, 1], [1, 1]]}
    document = diagram(
        {"s": block("linear_system", **matrices), "g": "gain", "c": "constant"},
        ("c.output", "s.input"),
        ("s.output", "g.input"),
    )
    loaded = load(document)
    assert shape_of(loaded, "s.input") == (1,)  # one entry fits the scalar constant
    assert shape_of(loaded, "g.output") == (3,)
    assert loaded.nodes["s"].state_shapes == {"value": (2,)}
    assert loaded.nodes["s"].values["D"].shape == (3, 1)
    wrong = diagram({"c": "constant", "s": block("linear_system", **{**matrices, "B": [[0]]})}, ("c.output", "s.input"))
    said = ": s.B: shape is (1, 1), expected (2, ?) | write a list of rows [[...], ...]: [n, inputs]"
    assert mistakes(wrong) == [said]


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(1, 5), st.permutations(range(6)), st.integers(0, 5))
def test_the_order_of_wires_and_blocks_does_not_matter_for_shapes(size: int, order: list[int], where: int) -> None:
    names = [f"g{k}" for k in range(6)]
    blocks: dict[str, Any] = {names[k]: "gain" for k in order}
    blocks[names[where]] = "integrator"
    blocks["v"] = block("constant", value=[1.0] * size)
    blocks["s"] = "sum"
    wires = [(f"{names[k]}.output", f"{names[(k + 1) % 6]}.input") for k in range(6) if k != 5]
    wires += [("v.output", "s.input1"), ("g5.output", "s.input2"), ("s.output", "g0.input")]
    wires = [wires[k] for k in order] + wires[6:]
    loaded = load(diagram(blocks, *wires))
    assert {port.shape for node in loaded.nodes.values() for port in node.outputs.values()} == {(size,)}


# --- scale ------------------------------------------------------------------------------------------


def chain(n: int) -> dict[str, Any]:
    """Return a diagram of n blocks in a row whose shape is told only by its first block."""
    blocks: dict[str, Any] = {"b0": block("constant", value=[1.0, 2.0])}
    wires = []
    for k in range(1, n):
        blocks[f"b{k}"] = block("gain", gain="$k") if k % 2 else block("sum", signs="+-")
        wires.append((f"b{k - 1}.output", f"b{k}.input" if k % 2 else f"b{k}.input1"))
        if k % 2 == 0:
            wires.append(("b0.output", f"b{k}.input2"))
    return diagram(blocks, *wires[::-1], parameters={"k": 0.5})


@pytest.mark.slow
def test_ten_thousand_blocks() -> None:
    loaded = load(chain(10_000))
    assert len(loaded.nodes) == 10_000
    assert loaded.nodes["b9999"].outputs["output"].shape == (2,)
    assert len({id(trace) for trace in block_traces(loaded).values()}) == 3  # like blocks are traced once
    assert len(loaded.graph) == 10_000


@pytest.mark.slow
def test_mistakes_in_ten_thousand_blocks_are_placed() -> None:
    document = chain(10_000)
    document["blocks"]["b5001"]["parameters"] = {"gian": 1}
    document["wires"][7] = ["b1.output", "nowhere.input"]
    text = written(document).replace('"b5001"', '\n"b5001"')
    Path("big.json").write_text(text)
    with pytest.raises(RotorsimError) as error:
        load("big.json")
    assert [str(problem.place).count(":") for problem in error.value.problems] == [2] * len(error.value.problems)
    assert any("unknown parameter 'gian'" in problem.what for problem in error.value.problems)
    assert any("no block 'nowhere'" in problem.what for problem in error.value.problems)
