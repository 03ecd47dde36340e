"""Grouping of blocks into a sub-diagram, and the way back: the same wires, records, values and motion."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim import RotorsimError
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.grouping import dissolve, group
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.resolution import resolve, shipped_diagrams
from rotorsim.identification.files import with_values
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate

SHIPPED = shipped_diagrams()


def wires(diagram: Diagram, name: str = "") -> list[tuple[str, str]]:
    ends = [(str(wire.source), str(wire.target)) for wire in diagram.wires]
    return sorted((source.removeprefix(name), target.removeprefix(name)) for source, target in ends)


def without(document: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in document.items() if key not in keys}


@pytest.mark.parametrize("name", [one for one in SHIPPED if "elementary" not in one or one == "jeffcott_elementary"])
def test_a_group_has_the_same_wires_and_dissolves_to_the_same_document(name: str, tmp_path: Path) -> None:
    data = read_document(SHIPPED[name]).data
    flat = resolve(data, folder=SHIPPED[name].parent)
    draw = random.Random(20261128)
    for _ in range(3):
        chosen = draw.sample(list(data["blocks"]), draw.randint(1, len(data["blocks"])))
        outer, inner = group(data, chosen, "grouped", "grouped.json")
        assert list(inner["blocks"]) == [one for one in data["blocks"] if one in chosen]
        (tmp_path / "grouped.json").write_text(format_document(inner))
        (tmp_path / "outer.json").write_text(format_document(outer))
        found = resolve(tmp_path / "outer.json")
        assert wires(found, "grouped/") == wires(flat)
        assert [str(one).removeprefix("grouped/") for one in found.record] == [str(one) for one in flat.record]
        for block, node in flat.nodes.items():
            same = found.nodes.get(block) or found.nodes[f"grouped/{block}"]
            assert repr(same.values) == repr(node.values)
        back, _ = dissolve(outer, "grouped", inner)
        assert back["blocks"] == data["blocks"]
        assert sorted(map(tuple, back["wires"])) == sorted(map(tuple, data["wires"]))
        assert without(back, "blocks", "wires", "layout") == without(data, "blocks", "wires", "layout")


def test_a_grouped_rotor_moves_as_before(tmp_path: Path) -> None:
    data = read_document(SHIPPED["jeffcott"]).data
    outer, inner = group(data, ["controller", "amb", "rotor"], "machine", "machine.json")
    assert inner["ports"] == {
        "inputs": {"force": "rotor.force", "rotor_force": "rotor.force"},
        "outputs": {"displacement": "rotor.displacement", "current": "controller.current"},
    }
    (tmp_path / "machine.json").write_text(format_document(inner))
    plain = simulate(load(data), stop=0.1)
    grouped = simulate(load(outer, folder=tmp_path), stop=0.1)
    assert np.array_equal(plain["rotor.displacement"], grouped["machine/rotor.displacement"])
    assert np.array_equal(plain["controller.current"], grouped["machine/controller.current"])


def test_ports_are_named_by_what_they_lead_to_and_values_follow_those_outside() -> None:
    data = {
        "parameters": {"k": "3 N/m", "other": 1},
        "blocks": {
            "one": {"type": "constant"},
            "two": {"type": "gain", "parameters": {"gain": "$k"}},
            "three": {"type": "gain", "parameters": {"gain": "$k"}},
            "sum": {"type": "sum"},
        },
        "wires": [
            ["one.output", "two.input"],
            ["one.output", "three.input"],
            ["two.output", "sum.input1"],
            ["three.output", "sum.input2"],
        ],
        "record": ["two.output"],
        "identify": {"three.gain": {}},
        "ports": {"outputs": {"y": "three.output"}},
        "layout": {"one": [0, 0], "two": [1, 0], "three": [1, 2], "sum": [2, 0]},
    }
    outer, inner = group(data, ["two", "three"], "gains", "gains.json")
    assert inner["parameters"] == {"k": "3 N/m"}
    assert inner["ports"] == {
        "inputs": {"two": ["two.input", "three.input"]},
        "outputs": {"two_output": "two.output", "three": "three.output"},
    }
    assert outer["blocks"]["gains"] == {"type": "diagram", "file": "gains.json", "parameters": {"k": "$k"}}
    assert list(outer["blocks"]) == ["one", "gains", "sum"]
    assert ["one.output", "gains.two"] in outer["wires"]
    assert len(outer["wires"]) == 3
    assert outer["record"] == ["gains/two.output"]
    assert outer["identify"] == {"gains/three.gain": {}}
    assert outer["ports"] == {"outputs": {"y": "gains.three"}}
    assert outer["layout"] == {"one": [0, 0], "sum": [2, 0], "gains": [1.0, 1.0]}
    back, names = dissolve({**outer, "blocks": {**outer["blocks"], "two": {"type": "constant"}}}, "gains", inner)
    assert names == {"two": "gains_two", "three": "three"}
    assert list(back["blocks"]) == ["one", "gains_two", "three", "sum", "two"]  # 'two' is taken meanwhile
    assert back["ports"] == {"outputs": {"y": "three.output"}}
    assert back["layout"] == {"one": [0, 0], "sum": [2, 0], "gains_two": [1.0, 0.0], "three": [1.0, 2.0]}


def test_what_is_recorded_and_free_in_a_group_follows_it_into_another() -> None:
    data = {
        "blocks": {
            "gains": {"type": "diagram", "file": "gains.json", "parameters": {"k": 2.0}},
            "one": {"type": "constant"},
        },
        "record": ["gains/first.output"],
        "identify": {"gains/first.gain": {}, "gains/k": {"low": 1.0}},
    }
    outer, inner = group(data, ["gains"], "more", "more.json")
    assert outer["record"] == ["more/gains/first.output"]
    assert outer["identify"] == {"more/gains/first.gain": {}, "more/gains/k": {"low": 1.0}}
    back, _ = dissolve(outer, "more", inner)
    assert (back["record"], back["identify"]) == (data["record"], data["identify"])
    gains = {"blocks": {"first": {"type": "gain", "parameters": {"gain": "$k"}}}, "parameters": {"k": 3.0}}
    flat, _ = dissolve(data, "gains", gains)
    assert flat["blocks"]["first"]["parameters"] == {"gain": 2.0}
    assert flat["identify"] == {"first.gain": {"low": 1.0}}


def test_free_parameters_inside_of_a_group_are_written_where_they_are(tmp_path: Path) -> None:
    """FAULT: identify ended with a KeyError after the whole computation."""
    data = read_document(SHIPPED["jeffcott"]).data
    data["identify"] = {"rotor.mass": {}, "controller.KP": {}, "crack_stiffness": {}}
    data["parameters"].pop("force_current_factor")
    data["blocks"]["amb"]["parameters"]["force_current_factor"] = "42.1 N/A"
    once, inner = group(data, ["rotor", "amb"], "machine", "machine.json")
    (tmp_path / "machine.json").write_text(format_document(inner))
    twice, outer = group(once, ["machine"], "deep", "deep.json")
    (tmp_path / "deep.json").write_text(format_document(outer))
    twice["blocks"]["deep"]["parameters"]["force_displacement_factor"] = "1e5 N/m"
    twice["identify"]["deep/force_displacement_factor"] = {}
    del twice["parameters"]["force_displacement_factor"]
    (tmp_path / "whole.json").write_text(format_document(twice))
    diagram = load(tmp_path / "whole.json")
    assert [item.base for item in diagram.free] == [
        "deep/machine/rotor.mass",
        "controller.KP",
        "crack_stiffness",
        "deep/force_displacement_factor",
    ]
    written = with_values(diagram, list(zip(diagram.free, (2.5, 12000.0, 2e5, 9e4), strict=True))).document
    assert written["blocks"]["rotor"]["parameters"]["mass"] == "2.5 kg"
    assert written["blocks"]["controller"]["parameters"]["KP"] == "12000.0 A/m"
    assert written["parameters"]["crack_stiffness"] == "200000.0 N/m"
    assert written["parameters"]["force_displacement_factor"] == "90000.0 N/m"
    assert wires(load(written)) == wires(load(data))
    in_memory = load(twice, folder=tmp_path)
    with pytest.raises(RotorsimError, match="is inside of a sub-diagram, whose file is not known"):
        with_values(replace(in_memory, folder=None), [(in_memory.free[0], 2.5)])


def test_a_group_that_takes_the_name_of_one_of_its_blocks_stands_there() -> None:
    blocks = {one: {"type": "constant"} for one in ("a", "b", "c", "d")}
    outer, inner = group({"blocks": blocks}, ["a", "c"], "c", "c2.json")
    assert list(outer["blocks"]) == ["b", "c", "d"]
    assert list(inner["blocks"]) == ["a", "c"]
    assert list(dissolve(outer, "c", inner)[0]["blocks"]) == ["b", "a", "c", "d"]


@pytest.mark.parametrize(
    ("chosen", "name", "what"),
    [
        ([], "part", "group: no block is chosen"),
        (["roter"], "part", "roter: no block 'roter'"),
        (["rotor"], "crack", "crack: there is a block of this name"),
        (["rotor"], "1st", "group: '1st' is not a name"),
    ],
)
def test_what_cannot_be_grouped_is_said(chosen: list[str], name: str, what: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        group(read_document(SHIPPED["jeffcott"]).data, chosen, name, "part.json")
    assert [f"{one.subject}: {one.what}" for one in caught.value.problems] == [what]


def test_a_plain_block_does_not_dissolve() -> None:
    with pytest.raises(RotorsimError, match="rotor: is no sub-diagram"):
        dissolve(read_document(SHIPPED["jeffcott"]).data, "rotor", {})
