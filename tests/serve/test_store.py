"""The file as the only store: operations, undo, edits on both sides, mistakes made by hand."""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rotorsim import RotorsimError
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.resolve.resolution import resolve
from rotorsim.serve.changes import ConflictError, differences, with_changes
from rotorsim.serve.operations import KEYS_NEEDED, OPERATIONS, Document, Editing, Operation, applied
from rotorsim.serve.store import DiagramFile


def document_of(path: Path) -> Document:
    found: Document = json.loads(path.read_text())
    return found


def one(name: str, value: Any) -> list[Operation]:
    return [{"op": "set", "name": name, "value": value}]


def test_an_edit_is_written_in_canonical_form_and_taken_back_to_the_letter(opened: DiagramFile) -> None:
    before = opened.path.read_bytes()
    steps: list[list[Operation]] = [
        [{"op": "remove", "block": "controller"}],
        [{"op": "add", "type": "pd", "at": [3, 1.5], "parameters": {"KP": "12000 A/m"}}],
        [{"op": "wire", "source": "rotor.displacement", "target": "pd.displacement"}],
        [{"op": "rename", "block": "rotor", "to": "shaft"}],
        [{"op": "move", "block": "shaft", "to": [2, 7]}, {"op": "set", "name": "speed", "value": "1800 rpm"}],
        [{"op": "record", "signal": "amb.force", "on": True}],
        [{"op": "cut", "source": "shaft.displacement", "target": "pd.displacement"}],
        [{"op": "set", "name": "crack.sag", "value": None}],
    ]
    undos, redos, texts = [], [], []
    for operations in steps:
        done = opened.edit(opened.state.sha, operations)
        undos.append(done.undo)
        redos.append(done.redo)
        texts.append(opened.path.read_text())
        assert texts[-1] == format_document(document_of(opened.path))
    for operations in undos[::-1]:
        opened.edit(opened.state.sha, operations)
    assert opened.path.read_bytes() == before
    for operations, text in zip(redos, texts, strict=True):
        opened.edit(opened.state.sha, operations)
        assert opened.path.read_text() == text


def test_a_group_is_written_to_a_new_file_and_dissolved_again(opened: DiagramFile) -> None:
    before = document_of(opened.path)
    other = opened.path.with_name("bearing.json")
    other.write_text("somebody else's")
    done = opened.edit(opened.state.sha, [{"op": "group", "blocks": ["amb", "controller"], "name": "bearing"}])
    made = opened.path.with_name("bearing2.json")
    assert document_of(opened.path)["blocks"]["bearing"]["file"] == "bearing2.json"
    assert made.read_text() == format_document(document_of(made))
    assert list(document_of(made)["blocks"]) == ["controller", "amb"]
    assert opened.state.valid
    assert not opened.state.problems
    assert other.read_text() == "somebody else's"
    opened.edit(opened.state.sha, [{"op": "dissolve", "block": "bearing"}])
    after = document_of(opened.path)
    assert after["blocks"] == before["blocks"]
    assert sorted(after["wires"]) == sorted(before["wires"])
    opened.edit(opened.state.sha, [{"op": "group", "blocks": ["rotor"], "name": "bearing"}])
    assert document_of(opened.path)["blocks"]["bearing"]["file"] == "bearing3.json"
    assert done.undo[0]["op"] == "patch"


def test_a_group_that_is_refused_leaves_no_file(opened: DiagramFile, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise RotorsimError("cannot be drawn")

    names = sorted(one.name for one in opened.path.parent.iterdir())
    monkeypatch.setattr(opened, "_check", refuse)
    with pytest.raises(RotorsimError, match="cannot be drawn"):
        opened.edit(opened.state.sha, [{"op": "group", "blocks": ["rotor"], "name": "part"}])
    assert sorted(one.name for one in opened.path.parent.iterdir()) == names


def test_copies_keep_all_that_is_written_of_a_block_and_the_wires_among_them(opened: DiagramFile) -> None:
    entry = {**document_of(opened.path)["blocks"]["controller"], "description": "of the left bearing"}
    amb = document_of(opened.path)["blocks"]["amb"]
    operation = {
        "op": "insert",
        "blocks": {"controller": entry, "amb": amb},
        "wires": [["controller.current", "amb.current"]],
        "at": {"controller": [2, 5], "amb": [3, 5]},
    }
    opened.edit(opened.state.sha, [operation])
    now = document_of(opened.path)
    assert (now["blocks"]["controller2"], now["blocks"]["amb2"]) == (entry, amb)
    assert now["wires"][-1] == ["controller2.current", "amb2.current"]
    assert (now["layout"]["controller2"], now["layout"]["amb2"]) == ([2, 5], [3, 5])
    for wrong in ([["rotor.displacement", "amb.displacement"]], ["amb"], [["amb", "controller"]]):
        with pytest.raises(RotorsimError, match="this is no wire among these blocks"):
            opened.edit(opened.state.sha, [{**operation, "wires": wrong}])


def test_ports_lead_out_of_the_diagram_and_follow_their_block(opened: DiagramFile) -> None:
    edits: list[Operation] = [
        {"op": "port", "side": "outputs", "end": "rotor.displacement", "on": True},
        {"op": "port", "side": "inputs", "end": "rotor.force", "on": True},
        {"op": "rename", "block": "rotor", "to": "shaft"},
    ]
    opened.edit(opened.state.sha, edits)
    ports = {"outputs": {"displacement": "shaft.displacement"}, "inputs": {"force": "shaft.force"}}
    assert document_of(opened.path)["ports"] == ports
    opened.edit(opened.state.sha, [{"op": "port", "side": "outputs", "end": "shaft.displacement", "on": False}])
    assert document_of(opened.path)["ports"] == {"inputs": {"force": "shaft.force"}}
    opened.edit(opened.state.sha, [{"op": "remove", "block": "shaft"}])
    assert "ports" not in document_of(opened.path)


def test_blocks_are_wired_named_and_removed_with_all_that_is_theirs(opened: DiagramFile) -> None:
    opened.edit(opened.state.sha, [{"op": "rename", "block": "rotor", "to": "shaft"}])
    text = opened.path.read_text()
    assert '"shaft.displacement"' in text
    assert "rotor." not in text
    opened.edit(opened.state.sha, [{"op": "remove", "block": "amb"}])
    document = document_of(opened.path)
    assert not [wire for wire in document["wires"] if "amb." in "".join(wire)]
    assert "amb" not in document["layout"]
    assert document["identify"].keys() == document_of(opened.path)["identify"].keys()


def test_unfinished_diagrams_are_written_and_said_to_be_so(opened: DiagramFile) -> None:
    opened.edit(opened.state.sha, [{"op": "cut", "source": "clock.theta", "target": "crack.theta"}])
    assert opened.state.valid
    [problem] = opened.state.problems
    assert (problem.subject, problem.what, problem.place.file) == ("crack.theta", "input is not wired", "mine.json")
    assert opened.state.diagram is not None


@pytest.mark.parametrize(
    ("operations", "said"),
    [
        (one("rotor.mass", "2 kgg"), "unknown unit 'kgg'"),
        (one("rotor.mas", "2 kg"), "unknown parameter 'mas'"),
        (one("rotr.mass", "2 kg"), "no block 'rotr'"),
        (one("sped", "2 rpm"), "no diagram parameter 'sped'"),
        (one("speed", None), "a parameter of the diagram has no default"),
        ([{"op": "wire", "source": "rotor.displacement", "target": "amb.current"}], "input is wired twice"),
        (
            [{"op": "wire", "source": "rotor.displacement", "target": "rotor.force"}],
            "units differ: rotor.displacement [m], but rotor.force [N]",
        ),
        ([{"op": "wire", "source": "rotor", "target": "amb.current"}], "is no end of a wire"),
        ([{"op": "cut", "source": "rotor.displacement", "target": "amb.current"}], "there is no such wire"),
        ([{"op": "swap", "block": "controller", "type": "pdi"}], "unknown block type 'pdi'"),
        ([{"op": "swap", "block": "controller", "type": "gain"}], "type 'gain' has no input 'displacement'"),
        ([{"op": "add", "type": "gian", "at": [0, 0]}], "unknown block type 'gian'"),
        ([{"op": "add", "type": "gain", "at": [0, 0], "name": "amb"}], "there is a block of this name"),
        ([{"op": "rename", "block": "amb", "to": "2nd"}], "'2nd' is not a name"),
        ([{"op": "rename", "block": "amb", "to": "rotor"}], "there is a block of this name"),
        ([{"op": "move", "block": "amb", "to": [1, "x"]}], "a block moves to two numbers"),
        ([{"op": "paint", "block": "amb"}], "unknown operation 'paint'"),
        ([{"op": "move", "block": "amb"}], "operation 'move' needs 'to'"),
        ([{"op": "patch", "changes": [{"path": []}]}], "is no change of a document"),
        (["move"], "unknown operation 'move'"),
    ],
)
def test_what_cannot_be_done_is_refused_and_nothing_is_written(
    opened: DiagramFile, operations: list[Operation], said: str
) -> None:
    before = opened.path.read_bytes()
    with pytest.raises(RotorsimError) as caught:
        opened.edit(opened.state.sha, operations)
    assert said in str(caught.value)
    assert opened.path.read_bytes() == before
    assert [file.name for file in opened.path.parent.iterdir()] == ["mine.json"]  # no backup either


def test_edits_of_different_entries_are_put_together(opened: DiagramFile) -> None:
    base = opened.state.sha
    opened.edit(base, one("rotor.mass", "3 kg"))
    opened.edit(base, [{"op": "add", "type": "gain", "at": [5, 0]}])
    opened.edit(base, [{"op": "cut", "source": "reference.signal", "target": "bus.reference"}])
    document = document_of(opened.path)
    assert document["blocks"]["rotor"]["parameters"]["mass"] == "3 kg"
    assert "gain" in document["blocks"]
    assert ["reference.signal", "bus.reference"] not in document["wires"]


def test_a_block_that_is_renamed_brings_along_what_was_changed_in_it(opened: DiagramFile) -> None:
    base = opened.state.sha
    opened.edit(base, one("rotor.mass", "3 kg"))
    opened.edit(base, [{"op": "rename", "block": "rotor", "to": "shaft"}])
    assert document_of(opened.path)["blocks"]["shaft"]["parameters"]["mass"] == "3 kg"


def test_the_same_entry_changed_on_both_sides_waits_for_a_choice(opened: DiagramFile) -> None:
    base = opened.state.sha
    opened.edit(base, one("rotor.mass", "3 kg"))
    before = opened.path.read_bytes()
    with pytest.raises(ConflictError) as caught:
        opened.edit(base, one("rotor.mass", "4 kg"))
    [conflict] = caught.value.conflicts
    assert (conflict.name, conflict.mine, conflict.theirs) == ("blocks.rotor.parameters.mass", "4 kg", "3 kg")
    assert opened.path.read_bytes() == before
    seen = opened.state.sha
    opened.path.write_text(opened.path.read_text().replace('"3 kg"', '"7 kg"'))
    with pytest.raises(ConflictError) as caught:  # a third value, which nobody has seen
        opened.edit(seen, one("rotor.mass", "4 kg"), mine=True)
    assert [one.theirs for one in caught.value.conflicts] == ["7 kg"]
    opened.edit(opened.state.sha, one("rotor.mass", "4 kg"), mine=True)
    assert document_of(opened.path)["blocks"]["rotor"]["parameters"]["mass"] == "4 kg"


def test_an_undo_waits_for_a_choice_where_others_have_changed_the_same(opened: DiagramFile) -> None:
    done = opened.edit(opened.state.sha, one("rotor.mass", "3 kg"))
    opened.edit(opened.state.sha, one("rotor.mass", "5 kg"))
    with pytest.raises(ConflictError):
        opened.edit(opened.state.sha, done.undo)
    opened.edit(opened.state.sha, done.undo, mine=True)
    assert document_of(opened.path)["blocks"]["rotor"]["parameters"]["mass"] == "2 kg"


def test_a_hand_edit_with_mistakes_stays_as_it_is(opened: DiagramFile) -> None:
    base, good = opened.state.sha, opened.path.read_text()
    for bad, said in (
        (good.replace('"rotor_2dof"', '"rotor_2dofs"'), "unknown block type 'rotor_2dofs'"),
        (good[:-40], "mine.json:"),
        ("", "mine.json"),
    ):
        opened.path.write_text(bad)
        with pytest.raises(RotorsimError) as caught:
            opened.edit(base, one("rotor.mass", "4 kg"))
        assert "the file on disk has mistakes, and nothing is written over them" in str(caught.value)
        assert said in str(caught.value)
        assert opened.path.read_text() == bad
        assert not opened.state.valid
        assert opened.state.diagram is not None  # the last good picture
    opened.path.write_text(good)
    opened.edit(base, one("rotor.mass", "4 kg"))
    assert opened.state.valid


def test_a_file_that_an_editor_empties_before_it_writes_is_read_when_it_is_written(opened: DiagramFile) -> None:
    """FAULT: what was read in between was shown as "file is empty"."""
    text = opened.path.read_text().replace('"speed"', '"rate"')
    opened.path.write_text("")
    later = threading.Timer(0.03, opened.path.write_text, (text,))
    later.start()
    assert opened.refresh()
    later.join()
    assert "file is empty" not in [problem.what for problem in opened.state.problems]
    assert opened.state.sha == hashlib.sha256(text.encode()).hexdigest()
    opened.path.write_text("")  # it stays so
    assert opened.refresh()
    assert [problem.what for problem in opened.state.problems] == ["file is empty"]
    assert not opened.refresh()


def test_a_file_that_is_deleted_is_not_made_anew(opened: DiagramFile) -> None:
    opened.path.unlink()
    with pytest.raises(RotorsimError) as caught:
        opened.edit(opened.state.sha, one("rotor.mass", "4 kg"))
    assert "file does not exist" in str(caught.value)
    assert not opened.path.exists()


def test_one_backup_is_kept_of_what_was_there(opened: DiagramFile) -> None:
    before = opened.path.read_bytes()
    for mass in ("3 kg", "4 kg"):
        opened.edit(opened.state.sha, one("rotor.mass", mass))
    [backup] = opened.path.parent.glob("mine.json.*.backup")
    assert backup.read_bytes() == before


def test_read_only_writes_nothing(mine: Path) -> None:
    file = DiagramFile(mine, read_only=True)
    with pytest.raises(RotorsimError, match="nothing is written: --read-only"):
        file.edit(file.state.sha, one("rotor.mass", "4 kg"))


def test_moving_a_block_of_a_diagram_without_layout_keeps_the_others_where_they_are(mine: Path) -> None:
    document = document_of(mine)
    del document["layout"]
    mine.write_text(json.dumps(document))
    file = DiagramFile(mine)
    file.edit(file.state.sha, [{"op": "move", "block": "amb", "to": [9, 9]}])
    layout = document_of(mine)["layout"]
    assert layout.keys() == document["blocks"].keys()
    assert layout["amb"] == [9, 9]
    assert layout["clock"] == [0, 0]


# --- anything at all --------------------------------------------------------------------------------------------------


def some_operation(draw: random.Random, document: Document) -> list[Operation]:
    """Return an operation that may be possible in a document."""
    blocks, wires = list(document["blocks"]), document.get("wires", [])
    block, wire = draw.choice(blocks), draw.choice(wires or [["clock.theta", "crack.theta"]])
    numbers = [f"{draw.randint(1, 9)} kg", draw.randint(1, 99), None, "1 furlong", f"{draw.randint(1, 9)} um"]
    names = ["rotor.mass", "crack.sag", "speed", "eccentricity", f"{block}.KP", "solver.step"]
    return draw.choice(
        [
            [{"op": "move", "block": block, "to": [draw.randint(0, 5), draw.randint(0, 9) / 2]}],
            [{"op": "set", "name": draw.choice(names), "value": draw.choice(numbers)}],
            [{"op": "add", "type": draw.choice(["gain", "pd", "constant", "lag", "sum"]), "at": [1, 4]}],
            [{"op": "remove", "block": block}],
            [{"op": "rename", "block": block, "to": draw.choice(["shaft", "bearing", "b7"])}],
            [{"op": "swap", "block": block, "type": draw.choice(["pd", "crack", "gain", "discrete_pid"])}],
            [{"op": "cut", "source": wire[0], "target": wire[1]}],
            [{"op": "wire", "source": wire[0], "target": draw.choice(wires or [wire])[1]}],
            [{"op": "record", "signal": wire[0], "on": draw.random() < 0.5}],
            [{"op": "cut", "source": wire[0], "target": wire[1]}, {"op": "remove", "block": block}],
            [{"op": "insert", "blocks": {block: document["blocks"][block]}, "wires": [], "at": {block: [1, 5]}}],
            [{"op": "group", "blocks": draw.sample(list(blocks), min(2, len(blocks))), "name": "part"}],
            [{"op": "dissolve", "block": block}],
            [{"op": "port", "side": "outputs", "end": wire[0], "on": draw.random() < 0.5}],
        ]
    )


def by_hand(draw: random.Random, file: DiagramFile) -> None:
    """Change the file as somebody with an editor does, now and then so that it is no diagram any more."""
    text = file.path.read_text()
    kind = draw.random()
    if kind < 0.15:
        file.path.write_text(draw.choice([text[: len(text) // 2], "{}", text.replace("clock", "cloc", 1), ""]))
        return
    try:
        document = json.loads(text)
        new = applied(document, some_operation(draw, document), Editing(file.registry, {}, file.path.parent))
        resolve(new, folder=file.path.parent, unfinished=[])
    except (RotorsimError, ValueError, KeyError):
        return
    file.path.write_text(json.dumps(new, indent=draw.choice([None, 3])))


def check_step(draw: random.Random, file: DiagramFile, page: dict[str, Any]) -> None:
    """Make one edit of a page, perhaps of an old version, and see what has become of everybody's entries."""
    before = file.path.read_bytes()
    undo = page["undo"].pop() if page["undo"] and draw.random() < 0.3 else None
    operations = undo or some_operation(draw, page["document"])
    editing = Editing(file.registry, {}, file.path.parent)
    try:
        done = file.edit(page["sha"], operations)
    except RotorsimError:
        assert file.path.read_bytes() == before
        return
    now, text = document_of(file.path), file.path.read_text()
    assert text == format_document(now)
    resolve(now, folder=file.path.parent, unfinished=[])
    if undo is None:
        page["undo"].append(done.undo)
    old = json.loads(before)
    kinds = {operation["op"] for operation in operations}
    changed = {change.path for change in differences(old, now)}
    if kinds & {"add", "insert"}:  # finds a name that is free now
        assert [path[0] for path in changed if path[0] != "layout"] == ["blocks"]
    elif not kinds & {"rename", "patch", "group", "dissolve"}:
        wanted = differences(page["document"], applied(page["document"], operations, editing))
        own = {change.path for change in wanted if change.path[0] != "layout"}  # all blocks get a place with the first
        assert {path for path in changed if path[0] != "layout"} <= own  # nobody else's entries
        assert with_changes(now, [change for change in wanted if change.path[0] != "layout"]) == now  # all of mine
    assert in_order(with_changes(old, differences(old, now))) == in_order(now)
    assert in_order(with_changes(now, differences(now, old))) == in_order(old)
    page |= {"sha": done.sha, "document": now}


def in_order(document: Document) -> str:
    """Return a document as text, its wires sorted: a group that takes a block's name may give one another place."""
    return format_document({**document, "wires": sorted(document.get("wires", []))})


def everything(path: Path, seed: int, steps: int) -> None:
    """Edit a file from two pages and by hand, each with what it knew last."""
    draw = random.Random(seed)
    file = DiagramFile(path)
    pages = [{"sha": file.state.sha, "document": document_of(path), "undo": []} for _ in range(2)]
    last_good = path.read_text()
    for _ in range(steps):
        kind = draw.random()
        if kind < 0.25:
            by_hand(draw, file)
        elif kind < 0.4 and file.refresh() is not None and file.state.valid:
            assert file.state.document is not None
            draw.choice(pages).update(sha=file.state.sha, document=file.state.document)
        else:
            check_step(draw, file, draw.choice(pages))
        file.refresh()
        if file.state.valid:
            last_good = path.read_text()
        elif draw.random() < 0.5:
            path.write_text(last_good)  # whoever has made the mistake takes it back


@pytest.mark.slow
@given(seed=st.integers(0, 2**32))
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_no_edit_is_lost_and_the_file_is_canonical_or_as_it_was_left(mine: Path, seed: int) -> None:
    start = mine.read_text()
    try:
        everything(mine, seed, 12)
    finally:
        mine.write_text(start)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32))
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_no_edit_is_lost_in_long_sessions(mine: Path, seed: int) -> None:
    start = mine.read_text()
    try:
        everything(mine, seed, 40)
    finally:
        mine.write_text(start)


def test_two_pages_that_add_a_block_of_one_type_get_two(opened: DiagramFile) -> None:
    base, add = opened.state.sha, [{"op": "add", "type": "gain", "at": [0, 9]}]
    opened.edit(base, add)
    assert opened.edit(base, add).undo[0]["changes"]
    assert {"gain", "gain2"} <= document_of(opened.path)["blocks"].keys()


def test_what_is_recorded_without_being_named_stays_so(mine: Path) -> None:
    """Without the key everything is recorded; with an empty list nothing."""
    document = document_of(mine)
    del document["record"]
    mine.write_text(format_document(document))
    file, before = DiagramFile(mine), mine.read_bytes()
    done = file.edit(file.state.sha, [{"op": "record", "signal": "amb.force", "on": False}])
    record = document_of(mine)["record"]
    assert "rotor.displacement" in record
    assert "amb.force" not in record
    file.edit(file.state.sha, done.undo)
    assert mine.read_bytes() == before


def test_lists_with_an_entry_twice_are_undone_too(mine: Path) -> None:
    document = document_of(mine)
    document["wires"].append(["crack.force", "rotor.force"])  # twice as much of it
    mine.write_text(format_document(document))
    file, before = DiagramFile(mine), mine.read_bytes()
    done = file.edit(file.state.sha, [{"op": "cut", "source": "amb.force", "target": "rotor.force"}])
    file.edit(file.state.sha, done.undo)
    assert mine.read_bytes() == before


def test_a_name_that_is_too_long_is_a_problem_and_no_traceback(mine: Path) -> None:
    document = document_of(mine) | {"block_folders": ["a" * 300]}
    mine.write_text(format_document(document))
    assert not DiagramFile(mine, trusted=True).state.valid


def test_code_outside_of_the_folder_never_runs(mine: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("outside")
    (outside / "evil.py").write_text(f"open({str(outside / 'ran')!r}, 'w')")
    folder = mine.parent / ".." / outside.name
    document = document_of(mine) | {"block_folders": [f"../{outside.name}", str(outside), str(folder)]}
    mine.write_text(format_document(document))
    DiagramFile(mine, trusted=True).registry.all_types()
    assert not (outside / "ran").exists()


@pytest.mark.skipif(os.name != "posix", reason="modes of POSIX")
def test_the_backup_is_what_was_there_at_the_start_and_as_private(mine: Path) -> None:
    start = mine.read_bytes()
    mine.chmod(0o600)
    file = DiagramFile(mine)
    mine.write_text(mine.read_text().replace('"2 kg"', '"2.5 kg"'))
    file.refresh()
    file.edit(file.state.sha, one("crack.sag", "20 um"))
    [backup] = mine.parent.glob("*.backup")
    assert backup.read_bytes() == start
    assert backup.stat().st_mode & 0o777 == 0o600


def test_the_page_of_the_documents_names_every_operation_and_what_it_needs() -> None:
    text = (Path(__file__).parents[2] / "docs" / "serve.md").read_text(encoding="utf-8")
    table = text.partition("| operation `op` | with |")[2].partition("\n\n")[0]
    stated = dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", table, re.MULTILINE))
    assert stated.keys() == OPERATIONS.keys() == KEYS_NEEDED.keys()
    for operation, needed in KEYS_NEEDED.items():
        assert all(f"`{key}`" in stated[operation] for key in needed), operation
