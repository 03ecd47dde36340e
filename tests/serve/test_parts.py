"""Sub-diagrams: entering their files, edits inside of them, and what that means outside."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rotorsim.diagram.parse.fmt import format_document
from rotorsim.serve.session import Session
from rotorsim.serve.store import DiagramFile
from tests.serve.serving import Page, Served, opened, served, talk

GAINS = {
    "schema_version": 1,
    "name": "gains",
    "parameters": {"k": 2.0},
    "blocks": {"first": {"type": "gain", "parameters": {"gain": "$k"}}, "second": {"type": "gain"}},
    "wires": [["first.output", "second.input"]],
    "ports": {"inputs": {"u": "first.input"}, "outputs": {"y": "second.output"}},
}
WHOLE = {
    "schema_version": 1,
    "name": "whole",
    "parameters": {"size": 1.0},
    "blocks": {
        "one": {"type": "constant", "parameters": {"value": "$size"}},
        "gains": {"type": "diagram", "file": "parts/gains.json", "parameters": {"k": 3.0}},
    },
    "wires": [["one.output", "gains.u"]],
    "solver": {"step": 0.01, "stop": 0.1},
    "record": ["gains.y"],
}


def written(folder: Path) -> Path:
    (folder / "parts").mkdir()
    (folder / "parts" / "gains.json").write_text(format_document(GAINS))
    path = folder / "whole.json"
    path.write_text(format_document(WHOLE))
    return path


async def inside(at: Served, part: str = "gains") -> Page:
    page = await opened(at)
    assert (await page.ask(kind="enter", part=part))["kind"] == "entered"
    return page


def test_the_file_of_a_sub_diagram_is_entered_edited_and_left(tmp_path: Path) -> None:
    path = written(tmp_path)
    part = tmp_path / "parts" / "gains.json"
    before = part.read_bytes()
    with served(Session(tmp_path, DiagramFile(path))) as at:

        async def talking() -> None:
            page, outside = await inside(at), await opened(at)
            state = page.state
            assert (state["file"], state["part"], state["top"]) == ("gains.json", "gains", "whole.json")
            assert state["valid"]
            assert state["problems"] == []  # that its input comes from outside is no mistake here
            assert [one["name"] for one in state["view"]["blocks"]] == ["first", "second"]
            assert state["view"]["blocks"][0]["inputs"][0]["exposed"] == [["u", "first.input"]]
            of_whole = [(one["name"], one["field"], one["written"]) for one in state["parameters"]]
            assert of_whole == [("size", "size", 1.0), ("gains/k", "gains.k", 3.0)]  # it is what runs
            result = await page.ask(kind="run", set={"size": 2.0})
            assert (result["signals"][0]["name"], result["values"][0][-1]) == ("gains/second.output", 6.0)
            done = await page.edit({"op": "set", "name": "second.gain", "value": 5})
            assert done["kind"] == "done"
            assert path.read_text() == format_document(WHOLE)
            assert part.read_text() == format_document(json.loads(part.read_text()))
            assert (await outside.ask(kind="run"))["values"][0][-1] == 15.0
            assert outside.state["part"] == ""
            assert (await page.edit(*done["undo"], base=done["sha"]))["kind"] == "done"
            assert part.read_bytes() == before
            assert (await page.ask(kind="enter", part=""))["kind"] == "entered"
            assert page.state["file"] == "whole.json"

        talk(talking)


def test_parameters_of_a_sub_diagram_are_shown_given_and_taken_back(tmp_path: Path) -> None:
    path = written(tmp_path)
    part = {**GAINS, "parameters": {"k": "2 m", "free": "3 m"}}
    (tmp_path / "parts" / "gains.json").write_text(format_document(part))
    path.write_text(path.read_text().replace('"k": 3.0', '"k": "$size"').replace('"size": 1.0', '"size": "1 m"'))
    with served(Session(tmp_path, DiagramFile(path))) as at:

        async def talking() -> None:
            page = await opened(at)
            [one] = [block for block in page.state["view"]["blocks"] if block["name"] == "gains"]
            said = [(each["name"], each["written"], each["follows"]) for each in one["parameters"]]
            assert said == [("k", "$size", "size"), ("free", None, "")]
            assert (await page.edit({"op": "set", "name": "gains.free", "value": 5.0}))["kind"] == "done"
            assert json.loads(path.read_text())["blocks"]["gains"]["parameters"]["free"] == 5.0
            assert (await page.edit({"op": "set", "name": "gains.free", "value": None}))["kind"] == "done"
            wrong = await page.ask(kind="value", name="gains.k", value="1 furlong")
            assert wrong["problem"] == "unknown unit 'furlong'"

        talk(talking)


def test_an_edit_that_does_not_fit_outside_is_refused_and_taken_back(tmp_path: Path) -> None:
    path = written(tmp_path)
    part = tmp_path / "parts" / "gains.json"
    before = part.read_bytes()
    with served(Session(tmp_path, DiagramFile(path))) as at:

        async def talking() -> None:
            page = await inside(at)
            refused = await page.edit({"op": "port", "side": "outputs", "end": "second.output", "on": False})
            said = [(one["subject"], one["what"], one["hint"]) for one in refused["problems"]]
            hint = "this sub-diagram would not fit there any more"
            assert said == [("gains.y", "sub-diagram has no output 'y'", hint)]
            assert part.read_bytes() == before
            assert at.session.file is not None
            assert at.session.file.state.valid
            assert (await page.edit({"op": "port", "side": "outputs", "end": "first.output", "on": True}))[
                "kind"
            ] == "done"

        talk(talking)


def test_what_is_no_sub_diagram_is_not_entered_and_a_page_that_comes_back_is_where_it_was(tmp_path: Path) -> None:
    with served(Session(tmp_path, DiagramFile(written(tmp_path)))) as at:

        async def talking() -> None:
            page = await inside(at)
            for name, wrong in (("one", "one"), ("gain", "gain"), ("gains/first", "first"), ("../whole", "..")):
                refused = await page.ask(kind="enter", part=name)
                assert refused["problems"][0]["what"] == f"no sub-diagram '{wrong}'"
                assert page.state["file"] == "whole.json"
            again = await opened(at, part="gains")
            assert again.state["file"] == "gains.json"
            gone = await opened(at, part="gone")
            assert gone.state["file"] == "whole.json"
            answer, _ = at.ask("/api/picture?part=gains", X_Rotorsim_Token="token-of-the-tests")
            assert answer.status == 200

        talk(talking)


def test_blocks_are_grouped_and_the_group_is_entered_at_once(mine: Path) -> None:
    with served(Session(mine.parent, DiagramFile(mine))) as at:

        async def talking() -> None:
            page = await opened(at)
            before: dict[str, Any] = await page.ask(kind="run")
            done = await page.edit({"op": "group", "blocks": ["controller", "amb"], "name": "bearing"})
            assert done["kind"] == "done"
            after = await page.ask(kind="run")
            assert (after["values"] == before["values"]).all()
            page = await inside(at, "bearing")
            assert [one["name"] for one in page.state["view"]["blocks"]] == ["controller", "amb"]
            assert page.state["problems"] == []

        talk(talking)


def test_a_file_outside_of_the_folder_is_not_entered(tmp_path: Path) -> None:
    """FAULT: the path came from the newest document, its check from the last good one."""
    folder = tmp_path / "mine"
    folder.mkdir()
    path = written(folder)
    outside = tmp_path / "outside.json"
    outside.write_text(format_document(GAINS))
    with served(Session(folder, DiagramFile(path))) as at:

        async def talking() -> None:
            page = await opened(at)
            for name in ("../outside.json", str(outside)):
                path.write_text(format_document(WHOLE).replace("parts/gains.json", name))
                while page.state["valid"]:
                    page.state = await page.next()
                refused = await page.ask(kind="enter", part="gains")
                what = "the file on disk has mistakes: its sub-diagrams are not entered"
                assert (refused["kind"], refused["problems"][0]["what"]) == ("refused", what)
                assert page.state["file"] == "whole.json"

        talk(talking)


def test_an_edit_is_made_in_the_file_that_it_was_made_on(tmp_path: Path) -> None:
    """FAULT: edits that waited while the page went elsewhere were made there."""
    path = written(tmp_path)
    with served(Session(tmp_path, DiagramFile(path))) as at:

        async def talking() -> None:
            page = await inside(at)
            adding = {"op": "add", "type": "gain", "at": [5, 5]}
            refused = await page.edit(adding, part="")
            what = "it was made in 'whole.json', which is not shown any more"
            assert (refused["kind"], refused["problems"][0]["what"]) == ("refused", what)
            assert (await page.edit(adding, part="gains"))["kind"] == "done"
            assert path.read_text() == format_document(WHOLE)

        talk(talking)


def test_what_is_refused_outside_leaves_the_file_as_it_was_written(tmp_path: Path) -> None:
    path = written(tmp_path)
    part = tmp_path / "parts" / "gains.json"
    part.write_text(json.dumps(GAINS))  # by hand, in another form
    names = sorted(one.name for one in part.parent.iterdir())
    with served(Session(tmp_path, DiagramFile(path))) as at:

        async def talking() -> None:
            page = await inside(at)
            cut = {"op": "port", "side": "outputs", "end": "second.output", "on": False}
            grouped = {"op": "group", "blocks": ["first"], "name": "deep"}
            assert (await page.edit(grouped, cut))["kind"] == "refused"
            assert part.read_text() == json.dumps(GAINS)
            assert [one.name for one in part.parent.iterdir() if one.suffix == ".json"] == names

        talk(talking)


def test_wires_at_a_group_are_those_that_are_written(mine: Path) -> None:
    """FAULT: of several ports that lead to one additive input, the first was shown for all."""
    file = DiagramFile(mine)
    file.edit(file.state.sha, [{"op": "group", "blocks": ["rotor"], "name": "part"}])
    with served(Session(mine.parent, file)) as at:

        async def talking() -> None:
            page = await opened(at)
            written_wires = json.loads(mine.read_text())["wires"]
            shown = [[wire["source"], wire["target"]] for wire in page.state["view"]["wires"]]
            assert sorted(shown) == sorted(written_wires)
            assert ["unbalance.force", "part.rotor_force"] in shown
            cut = {"op": "cut", "source": "unbalance.force", "target": "part.rotor_force"}
            assert (await page.edit(cut))["kind"] == "done"

        talk(talking)
