"""Sub-diagrams: inlined under their name, parameters passed on, files only from the diagram's folder."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.diagram.diagram import Endpoint
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from tests.diagram.helpers import block, diagram, mistakes, written

OUTSIDE = "name a file below that folder, such as 'parts/sub.json'"


def sub(file: str, **parameters: Any) -> dict[str, Any]:
    return {"type": "diagram", "file": file, "parameters": parameters}


@pytest.fixture
def parts(empty_folder: Path) -> Path:
    amplifier = diagram(
        {"g": block("gain", gain="$k"), "h": block("gain", gain="$more")},
        ("g.output", "h.input"),
        parameters={"k": 2.0, "more": 10.0},
        ports={"inputs": {"u": "g.input"}, "outputs": {"y": "h.output", "first": "h.output[1]"}},
    )
    pair = diagram(
        {"one": sub("amplifier.json", k="$gain"), "two": sub("amplifier.json", k=5.0)},
        ("one.y", "two.u"),
        parameters={"gain": 3.0},
        ports={"inputs": {"u": ["one.u"]}, "outputs": {"y": "two.y"}},
    )
    folder = empty_folder / "parts"
    folder.mkdir()
    (folder / "amplifier.json").write_text(written(amplifier))
    (folder / "pair.json").write_text(written(pair))
    return folder


def test_blocks_of_sub_diagrams_get_the_name_of_their_path(parts: Path) -> None:
    document = diagram(
        {"c": "constant", "p": sub("parts/pair.json", gain="$outer"), "g": "gain"},
        ("c.output", "p.u"),
        ("p.y", "g.input"),
        parameters={"outer": 7.0},
        record=["p.y", "p/one/g.output"],
    )
    loaded = load(document, folder=parts.parent)
    assert list(loaded.nodes) == ["c", "p/one/g", "p/one/h", "p/two/g", "p/two/h", "g"]
    assert sorted(f"{w.source} -> {w.target}" for w in loaded.wires) == [
        "c.output -> p/one/g.input",
        "p/one/g.output -> p/one/h.input",
        "p/one/h.output -> p/two/g.input",
        "p/two/g.output -> p/two/h.input",
        "p/two/h.output -> g.input",
    ]
    assert loaded.record == (Endpoint("p/two/h", "output"), Endpoint("p/one/g", "output"))
    assert loaded.nodes["p/one/g"].references == {"gain": "outer"}
    assert {name: float(value) for name, value in loaded.parameters.items()} == {
        "outer": 7.0,
        "p/one/more": 10.0,
        "p/two/k": 5.0,
        "p/two/more": 10.0,
    }


def test_a_value_from_outside_beats_the_default_of_the_sub_diagram(parts: Path) -> None:
    document = diagram({"c": "constant", "a": sub("parts/amplifier.json", k=4.0)}, ("c.output", "a.u"))
    loaded = load(document, folder=parts.parent, set={"a.more": "20", "a/g.gain": 6})
    assert loaded.nodes["a/g"].values["gain"] == 6.0
    assert loaded.nodes["a/h"].values["gain"] == 20.0
    assert load(document, folder=parts.parent).nodes["a/g"].values["gain"] == 4.0


def test_an_index_on_a_port_counts_inside_what_it_stands_for(parts: Path) -> None:
    document = diagram(
        {"v": block("constant", value=[1, 2]), "a": sub("parts/amplifier.json"), "g": "gain", "h": "gain"},
        ("v.output", "a.u"),
        ("a.y[2]", "g.input"),
        ("a.first", "h.input"),
    )
    loaded = load(document, folder=parts.parent)
    assert {str(w.source) for w in loaded.wires} >= {"a/h.output[2]", "a/h.output[1]"}
    assert loaded.nodes["g"].inputs["input"].shape == ()


def test_a_sub_diagram_is_taken_out_as_a_whole(parts: Path) -> None:
    document = diagram(
        {"c": "constant", "a": sub("parts/amplifier.json"), "g": "gain"}, ("c.output", "a.u"), ("a.y", "g.input")
    )
    loaded = load(document, folder=parts.parent, without=["a"])
    assert list(loaded.nodes) == ["c", "g"]
    assert loaded.cut == {("g", "input")}


def test_mistakes_inside_and_at_the_edge_of_sub_diagrams(parts: Path) -> None:
    Path("bad.json").write_text('{"blocks": {"a": {"type": "gain"}},}')
    Path("block.json").write_text('{"blocks":\n {"a": {"type": "gian"}}}')
    document = diagram(
        {
            "c": "constant",
            "s": sub("parts/amplifier.json", kk=3.0),
            "t": sub("bad.json"),
            "w": sub("block.json"),
            "v": sub("nothing.json"),
            "n": {"type": "diagram"},
        },
        ("c.output", "s.uu"),
        ("s.u", "s.u"),
        ("c.output", "s.y"),
        ("c.output", "s/g.input"),
        ("c.output", "t.u"),
    )
    text = written(document).replace('}, "', '},\n "').replace("], [", "],\n [")
    assert mistakes(text) == [
        "bad.json:1:35: : not valid JSON: comma before '}' | remove the comma",
        "block.json:2:17: w/a: unknown block type 'gian' | did you mean 'gain'?",
        "2:74: s.kk: sub-diagram has no parameter 'kk' | did you mean 'k'?",
        "5:35: v: nothing.json: file does not exist | the path is relative to the folder of the diagram that names it",
        '6:7: n: key \'file\' is missing | a sub-diagram is {"type": "diagram", "file": "sub.json"}',
        "7:24: s.uu: sub-diagram has no input 'uu' | did you mean 'u'?",
        "8:3: s.u: sub-diagram has no output 'u' | it is an input; wires run from an output to an input",
        "9:15: s.y: sub-diagram has no input 'y' | it is an output; wires run from an output to an input",
        "10:15: wires[4]: 's/g.input' is not a port | inside a sub-diagram only its ports can be wired",
        'parts/amplifier.json:1:13: s/g.input: input is not wired | add the wire ["block.output", "s/g.input"]',
    ]


def test_a_parameter_that_the_outer_diagram_does_not_have(parts: Path) -> None:
    document = diagram({"c": "constant", "a": sub("parts/amplifier.json", k="$gian")}, ("c.output", "a.u"))
    assert mistakes(document, folder=parts.parent) == [
        ": a/k: '$gian' is no diagram parameter | a value for a sub-diagram may name a parameter of the outer diagram"
    ]


@pytest.mark.parametrize(
    "file", ["../x.json", "a/../../x.json", "/etc/passwd", "..\\x.json", "C:x.json", "C:\\x.json", "a\0b", "//server/x"]
)
def test_paths_that_lead_out_are_refused(file: str) -> None:
    document = diagram({"s": sub(file)})
    what = f": s: file '{file}' is not inside the folder of the diagram"
    assert mistakes(document) == [f"{what} | {OUTSIDE}"]


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="needs symbolic links")
def test_links_that_lead_out_are_refused(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "secret.json").write_text('{"blocks": {"c": {"type": "constant"}}}')
    os.symlink(tmp_path, inner / "up")
    os.symlink(tmp_path / "secret.json", inner / "link.json")
    os.symlink(inner / "own.json", inner / "fine.json")
    os.symlink(inner / "round.json", inner / "round.json")
    (inner / "own.json").write_text('{"blocks": {"c": {"type": "constant"}}}')
    for file in ("up/secret.json", "link.json"):
        found = mistakes(diagram({"s": sub(file)}), folder=inner)
        assert found == [f": s: file '{file}' is not inside the folder of the diagram | {OUTSIDE}"]
    assert mistakes(diagram({"s": sub("fine.json")}), folder=inner) == []
    assert len(mistakes(diagram({"s": sub("round.json")}), folder=inner)) == 1


def test_a_document_in_memory_without_a_folder_reads_nothing() -> None:
    assert mistakes(diagram({"s": sub("x.json")}), folder=None) == [
        ": s: a document in memory has no folder to read from | pass folder="
    ]


def test_diagrams_that_contain_themselves_are_refused() -> None:
    Path("a.json").write_text(written(diagram({"b": sub("b.json")})))
    Path("b.json").write_text(written(diagram({"a": sub("a.json")})))
    remove = "remove one of these sub-diagrams"
    assert mistakes(written(diagram({"a": sub("a.json"), "me": sub("d.json")}))) == [
        "b.json:1:46: a/b/a: sub-diagram contains itself: a.json -> b.json -> a.json | " + remove,
        "1:109: me: sub-diagram contains itself: d.json -> d.json | " + remove,
    ]


@pytest.mark.slow
def test_nesting_and_multiplying_are_limited() -> None:
    for k in range(12):
        Path(f"n{k}.json").write_text(written(diagram({"n": sub(f"n{k + 1}.json")})))
    assert "sub-diagrams are nested deeper than 8" in mistakes(diagram({"n": sub("n0.json")}))[0]
    Path("m7.json").write_text(written(diagram({f"c{k}": "constant" for k in range(30)})))
    for k in range(7):
        Path(f"m{k}.json").write_text(written(diagram({f"m{i}": sub(f"m{k + 1}.json") for i in range(30)})))
    with pytest.raises(RotorsimError, match="more than 200000 blocks"):
        load(diagram({"m": sub("m0.json")}), folder=Path())


def test_one_file_may_be_used_many_times_with_shapes_of_its_own(parts: Path) -> None:
    document = diagram(
        {
            "v": block("constant", value=[1, 2]),
            "c": block("constant", value=1),
            "a": sub("parts/amplifier.json"),
            "b": sub("parts/amplifier.json", k=[[1]]),
        },
        ("v.output", "a.u"),
        ("c.output", "b.u"),
    )
    assert [m.split(" | ")[0] for m in mistakes(document, folder=parts.parent)] == [
        ": b/g.gain: shape is (1, 1), expected scalar"
    ]
    document["blocks"]["b"]["parameters"] = {}
    loaded = load(document, folder=parts.parent)
    assert loaded.nodes["a/h"].outputs["output"].shape == (2,)
    assert loaded.nodes["b/h"].outputs["output"].shape == ()
    np.testing.assert_array_equal(loaded.nodes["a/g"].values["gain"], 2.0)


@pytest.mark.parametrize(
    ("given", "outer", "one", "gain"),
    [
        ({}, [1.0, 2.0], [1.0, 2.0], [1.0, 2.0]),
        ({"outer[2]": 9.0}, [1.0, 9.0], [1.0, 9.0], [1.0, 9.0]),
        ({"pair.v[2]": 9.0}, [1.0, 2.0], [1.0, 9.0], [1.0, 9.0]),
        ({"pair/one.value[2]": 9.0}, [1.0, 2.0], [1.0, 9.0], [1.0, 2.0]),
        ({"pair/v[2]": 9.0}, [1.0, 2.0], [1.0, 9.0], [1.0, 9.0]),
        ({"pair/two.v[2]": 9.0}, [1.0, 2.0], [1.0, 2.0], [1.0, 9.0]),
        ({"pair/two/v[2]": 9.0}, [1.0, 2.0], [1.0, 2.0], [1.0, 9.0]),
        # what is followed first, in whatever order they are given
        ({"pair/two.v[2]": 9.0, "pair.v[1]": 8.0, "outer[2]": 7.0}, [1.0, 7.0], [8.0, 7.0], [8.0, 9.0]),
    ],
)
def test_an_entry_of_what_follows_a_parameter_outside_is_its_own(
    given: dict[str, Any], outer: list[float], one: list[float], gain: list[float], empty_folder: Path
) -> None:
    """As a block's: a parameter that is set inside follows no longer, and what it followed stays as it is."""
    inner = diagram({"c": block("constant", value="$v")}, parameters={"v": [0.0, 0.0]})
    pair = diagram({"one": block("constant", value="$v"), "two": sub("in.json", v="$v")}, parameters={"v": [0.0, 0.0]})
    (empty_folder / "in.json").write_text(written(inner))
    (empty_folder / "pair.json").write_text(written(pair))
    document = diagram({"pair": sub("pair.json", v="$outer")}, parameters={"outer": [1.0, 2.0]})
    loaded = load(document, folder=empty_folder, set=given)
    assert loaded.parameters["outer"].tolist() == outer
    assert loaded.nodes["pair/one"].values["value"].tolist() == one
    assert loaded.nodes["pair/two/c"].values["value"].tolist() == gain


def test_entries_at_several_depths_are_refused_all_at_once(empty_folder: Path) -> None:
    (empty_folder / "in.json").write_text(
        written(diagram({"c": block("constant", value="$v")}, parameters={"v": [0.0, 0.0]}))
    )
    document = diagram({"part": sub("in.json", v="$outer")}, parameters={"outer": [1.0, 2.0]})
    with pytest.raises(RotorsimError) as caught:
        load(document, folder=empty_folder, set={"part/c.value[4]": 1.0, "part.v[3]": 1.0, "outer[0]": 1.0})
    what = "no such entry; the parameter is 2, counted from 1"
    assert [(one.what, one.subject, one.hint) for one in caught.value.problems] == [
        (what, "outer[0]", "outer[1] is the first"),
        (what, "part.v[3]", "part.v[1] is the first"),
        (what, "part/c.value[4]", "part/c.value[1] is the first"),
    ]
