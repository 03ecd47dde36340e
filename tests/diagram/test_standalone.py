"""The document of a diagram that needs nothing beside it: what was removed, set or in a sub-diagram is in place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.grouping import group
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.diagram.standalone import standalone
from rotorsim.errors import RotorsimError
from rotorsim.identification.waveform.recorded.along_angle import with_reaction
from rotorsim.model.load import load, load_standalone
from rotorsim.simulation.run import simulate, without

SIGNALS = ("rotor.displacement", "controller.current")


def grouped(folder: Path, *more: str) -> Path:
    """Return the file of jeffcott with rotor and magnet in a sub-diagram of one that holds the controller, too.

    more: blocks that stand beside the rotor.
    """
    data = read_document(shipped_diagrams()["jeffcott"]).data
    once, inner = group(data, ["rotor", "amb", *more], "machine", "machine.json")
    (folder / "machine.json").write_text(format_document(inner))
    twice, outer = group(once, ["machine", "controller"], "loop", "loop.json")
    (folder / "loop.json").write_text(format_document(outer))
    (folder / "whole.json").write_text(format_document(twice))
    return folder / "whole.json"


def same(one: Diagram, other: Diagram, names: dict[str, str]) -> None:
    """Assert that two diagrams move alike."""
    first, second = simulate(one, stop=0.05), simulate(other, stop=0.05)
    for signal in SIGNALS:
        block, _, port = signal.partition(".")
        flat = next(name for name in one.nodes if name.split("/")[-1] == block)
        assert np.array_equal(first[f"{flat}.{port}"], second[f"{names[flat]}.{port}"])


def test_sub_diagrams_of_sub_diagrams_are_dissolved(tmp_path: Path) -> None:
    diagram = load(grouped(tmp_path))
    alone = standalone(diagram)
    assert alone.blocks["loop/machine/rotor"] == "rotor"
    assert not any(block["type"] == "diagram" for block in alone.document["blocks"].values())
    assert alone.named("loop/machine/rotor.displacement[2]") == "rotor.displacement[2]"
    assert alone.named("loop/controller.KP") == "controller.KP"
    assert alone.named("speed") == "speed"
    same(diagram, load(alone.document), alone.blocks)
    told = "its sub-diagrams are dissolved: loop/machine/rotor is rotor, loop/machine/amb is amb, "
    assert [problem.what for problem in alone.notes] == [told + "loop/controller is controller"]


def test_what_was_set_inside_is_in_it(tmp_path: Path) -> None:
    """FAULT: the document kept it under a key that no diagram has, and was refused when it was read again."""
    given = {"loop/machine/rotor.mass": 2.5, "loop/controller.KP": 11000.0, "speed": 150.0}
    diagram = load(grouped(tmp_path), set=given)
    alone = standalone(diagram)
    assert alone.document["blocks"]["rotor"]["parameters"]["mass"] == 2.5
    assert alone.document["blocks"]["controller"]["parameters"]["KP"] == 11000.0
    same(diagram, load(alone.document), alone.blocks)
    kept = standalone(diagram, [])
    assert "controller" in kept.document["blocks"]  # set inside: dissolved, whatever is asked for
    again = standalone(load(grouped(tmp_path), set={"speed": 150.0}), [])
    assert set(again.document["blocks"]) == set(json.loads((tmp_path / "whole.json").read_text())["blocks"])


def test_a_parameter_of_a_sub_diagram_that_blocks_follow_is_one_of_the_diagram(tmp_path: Path) -> None:
    inner = {
        "parameters": {"k": 3.0, "unused": 1.0},
        "blocks": {
            "first": {"type": "gain", "parameters": {"gain": "$k"}},
            "second": {"type": "gain", "parameters": {"gain": "$k"}},
        },
        "wires": [["first.output", "second.input"]],
        "ports": {"inputs": {"input": "first.input"}, "outputs": {"output": "second.output"}},
    }
    (tmp_path / "gains.json").write_text(json.dumps(inner))
    outer = {
        "parameters": {"k": 5.0},
        "blocks": {
            "source": {"type": "constant", "parameters": {"value": "$k"}},
            "gains": {"type": "diagram", "file": "gains.json", "parameters": {"k": 2.0}},
        },
        "wires": [["source.output", "gains.input"]],
        "identify": {"gains/k": {"low": 1.0}},
    }
    diagram = load(outer, folder=tmp_path)
    alone = standalone(diagram)
    assert alone.document["parameters"] == {"k": 5.0, "gains_k": 2.0, "unused": 1.0}
    assert alone.named("gains/k") == "gains_k"
    assert alone.document["identify"] == {"gains_k": {"low": 1.0}}
    loaded = load(alone.document)
    assert [item.name for item in loaded.free] == ["gains_k"]
    assert loaded.nodes["second"].references == {"gain": "gains_k"}
    for name in ("gains/k", "gains.k"):
        moved = load(outer, folder=tmp_path, set={name: 7.0})
        assert moved.nodes["gains/second"].values["gain"] == 7.0
        assert standalone(moved).document["parameters"]["gains_k"] == 7.0
    (tmp_path / "more.json").write_text(json.dumps(outer | {"identify": {}}))
    twice = {"blocks": {"more": {"type": "diagram", "file": "more.json"}}, "wires": []}
    for name in ("more/gains/k", "more/gains.k"):
        deep = load(twice, folder=tmp_path, set={name: 7.0})
        assert deep.nodes["more/gains/second"].values["gain"] == 7.0
        assert load(standalone(deep).document).nodes["second"].values["gain"] == 7.0


def test_blocks_that_were_removed_are_left_out_also_inside(tmp_path: Path) -> None:
    """FAULT: a document that is read again had them back, and a diagnosis did not miss what was left out."""
    for file, removed in ((shipped_diagrams()["jeffcott"], "crack"), (grouped(tmp_path), "crack")):
        diagram = load(file, without=[removed])
        alone = standalone(diagram)
        assert "crack" not in alone.document["blocks"]
        assert "crack_stiffness" in alone.document["parameters"]  # which a recording may set
        assert "crack_stiffness" not in alone.document["identify"]
        same(diagram, load(alone.document), alone.blocks)
    data = read_document(shipped_diagrams()["jeffcott"]).data
    outer, inner = group(data, ["rotor", "crack"], "part", "part.json")
    (tmp_path / "part.json").write_text(format_document(inner))
    diagram = load(outer, folder=tmp_path, without=["part/crack"])
    for found in (standalone(diagram), standalone(diagram, [])):
        assert "crack" not in found.document["blocks"]
        same(diagram, load(found.document), found.blocks)
    whole = standalone(load(outer, folder=tmp_path), [])
    assert whole.document["blocks"] == outer["blocks"]


def test_a_diagram_of_one_file_stays_as_it_is() -> None:
    diagram = load("jeffcott")
    same_one, alone = load_standalone(diagram)
    assert same_one is diagram
    assert alone.notes == []


def test_what_does_not_load_without_a_block_is_refused_with_the_input_it_leaves_open() -> None:
    with pytest.raises(RotorsimError, match=r"controller\.displacement: input is not wired"):
        load_standalone(load("jeffcott", without=["rotor"]))


def test_a_block_that_was_removed_from_an_inner_sub_diagram_stays_out(tmp_path: Path) -> None:
    diagram = load(grouped(tmp_path, "crack"), without=["loop/machine/crack"])
    for found in (standalone(diagram), standalone(diagram, [])):
        loaded = load(found.document, folder=tmp_path)
        assert not any(name.endswith("crack") for name in loaded.nodes)
        assert not any(item.name.startswith("crack") for item in loaded.free)
        same(diagram, loaded, found.blocks)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("loop/machine/crack_stiffness", 1e5),
        ("loop/machine.crack_stiffness", np.array(1e5)),
        ("loop/machine/crack.opening", "switching"),
        ("crack_stiffness", 1e5),
    ],
)
def test_a_setting_of_an_inner_parameter_that_follows_an_outer_one(tmp_path: Path, name: str, value: Any) -> None:
    diagram = load(grouped(tmp_path, "crack"), set={name: value})
    for found in (standalone(diagram), standalone(diagram, [])):
        loaded = load(found.document, folder=tmp_path)
        flat = next(one for one in loaded.nodes if one.endswith("crack"))
        for key, right in diagram.nodes["loop/machine/crack"].values.items():
            assert np.array_equal(loaded.nodes[flat].values[key], right), key


def test_settings_of_what_was_removed_are_dropped(tmp_path: Path) -> None:
    given = {"loop/machine/crack.stiffness": 1e5, "crack_stiffness": 2e5}
    diagram = load(grouped(tmp_path, "crack"), set=given, without=["loop/machine/crack"])
    same(diagram, load(standalone(diagram).document), standalone(diagram).blocks)


def test_what_a_document_says_of_removed_blocks_goes_with_them() -> None:
    document = {
        "parameters": {"extra": 2.0, "gone": 1.0},
        "blocks": {
            "source": {"type": "constant", "parameters": {"value": "$extra"}},
            "gain": {"type": "gain"},
            "extra": {"type": "gain", "parameters": {"gain": "$gone"}},
        },
        "wires": [["source.output", "gain.input"], ["gain.output", "extra.input"]],
        "measured": {"gain.output": "extra.output"},
        "record": ["gain.output", "extra.output"],
        "identify": {"extra": {}, "gone": {}},
        "ports": {"outputs": {"y": "extra.output", "z": "gain.output"}},
        "layout": {"source": [0, 0], "gain": [1, 0], "extra": [2, 0]},
    }
    diagram = load(document, without=["extra"])
    found = standalone(diagram).document
    assert found["measured"] == {}
    assert found["record"] == ["gain.output"]
    assert found["identify"] == {"extra": {}}
    assert found["ports"] == {"outputs": {"z": "gain.output"}}
    assert found["layout"] == {"source": [0, 0], "gain": [1, 0]}
    assert set(load(found).nodes) == {"source", "gain"}


def test_an_entry_of_an_idle_parameter_is_not_free() -> None:
    document = {
        "parameters": {"k": [1.0, 2.0]},
        "blocks": {
            "source": {"type": "constant", "parameters": {"value": [1.0, 2.0]}},
            "gain": {"type": "gain", "parameters": {"gain": "$k"}},
        },
        "wires": [["source.output", "gain.input"]],
        "identify": {"k[1]": {}},
    }
    assert standalone(load(document, without=["gain"])).document["identify"] == {}


def test_a_parameter_of_a_block_is_set_by_a_dot(tmp_path: Path) -> None:
    with pytest.raises(RotorsimError) as raised:
        load(grouped(tmp_path), set={"loop/machine/rotor/mass": 2.0})
    assert str(raised.value) == (
        "--set: error: loop/machine/rotor/mass: no diagram parameter 'loop/machine/rotor/mass'\n\n"
        "hint: did you mean 'loop/machine/rotor.mass' or 'loop/machine/rotor.stiffness' or "
        "'loop/machine/rotor.viscous_damping'?"
    )


def test_a_diagram_that_was_loaded_with_settings_loads_from_its_document(tmp_path: Path) -> None:
    """FAULT: unknown key 'set': ensembles in other processes and sensitivity load the document again."""
    diagram = load(grouped(tmp_path), set={"loop/machine/rotor.mass": 2.5, "speed": 150.0})
    again = load(diagram.document, folder=tmp_path, set={"loop/machine/rotor.stiffness": 7e5})
    assert again.nodes["loop/machine/rotor"].values["mass"] == 2.5
    assert again.nodes["loop/machine/rotor"].values["stiffness"] == 7e5
    same(diagram, load(diagram.document, folder=tmp_path), {name: name for name in diagram.nodes})


def test_settings_of_a_document_that_are_none_are_refused() -> None:
    document = {"blocks": {"one": {"type": "constant"}}, "set": 3}
    with pytest.raises(RotorsimError, match="unknown key 'set'"):
        load(document)


def test_wires_to_what_is_inside_are_those_of_the_blocks(tmp_path: Path) -> None:
    """A run-up wires unbalances inside of sub-diagrams to the acceleration of the clock."""
    data = read_document(shipped_diagrams()["jeffcott_runup"]).data
    data["wires"] = [wire for wire in data["wires"] if "unbalance.acceleration" not in wire]
    for chosen in (["unbalance"], ["clock"], ["clock", "unbalance"]):
        outer, inner = group(data, chosen, "part", "part.json")
        (tmp_path / "part.json").write_text(format_document(inner))
        diagram = with_reaction(load(outer, folder=tmp_path))
        for found in (standalone(diagram), standalone(diagram, [])):
            wires = [[str(w.source), str(w.target)] for w in load(found.document, folder=tmp_path).wires]
            assert ["clock.acceleration", "unbalance.acceleration"] in wires


def test_what_is_free_inside_of_a_removed_sub_diagram_goes_with_it(tmp_path: Path) -> None:
    outer, inner = group(read_document(shipped_diagrams()["jeffcott"]).data, ["crack"], "part", "part.json")
    outer["blocks"]["part"]["parameters"]["crack_phase"] = "3 deg"
    del outer["parameters"]["crack_phase"], outer["identify"]["crack_phase"]
    outer["identify"]["part/crack_phase"] = {}
    (tmp_path / "part.json").write_text(format_document(inner))
    diagram = load(outer, folder=tmp_path, without=["part"])
    for found in (standalone(diagram), standalone(diagram, [])):
        assert load(found.document).free == diagram.free


def test_without_names_blocks_inside_too(tmp_path: Path) -> None:
    """FAULT: ensembles in other processes had them back."""
    file = grouped(tmp_path, "crack")
    assert without(load(file, without=["loop/machine/crack", "bus"])) == ["bus", "loop/machine/crack"]
    assert without(load(file, without=["loop"])) == ["loop"]


def test_what_lacks_a_removed_block_says_so() -> None:
    with pytest.raises(RotorsimError) as raised:
        load_standalone(load("jeffcott", without=["controller"]))
    hint = "hint: left out was controller: put a constant in the place of what feeds it"
    assert str(raised.value).count(hint) == 2
