"""The live connection: states, edits of two pages, hand edits, runs, questions while typing."""

from __future__ import annotations

import json
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rotorsim import load, simulate
from rotorsim.cli.app import rotorsim
from rotorsim.serve.outcomes import Outcome
from rotorsim.serve.session import Session
from rotorsim.serve.store import DiagramFile
from tests.serve.serving import TOKEN, Served, opened, served, talk

MASS = {"op": "set", "name": "rotor.mass"}


@pytest.fixture
def at(mine: Path) -> Iterator[Served]:
    with served(Session(mine.parent, DiagramFile(mine))) as found:
        yield found


def test_the_state_has_all_that_is_drawn(at: Served) -> None:
    async def talking() -> None:
        state = (await opened(at)).state
        assert (state["file"], state["valid"], state["problems"], state["read_only"]) == ("mine.json", True, [], False)
        blocks = {block["name"]: block for block in state["view"]["blocks"]}
        assert list(blocks) == ["clock", "crack", "unbalance", "rotor", "controller", "amb", "reference", "bus"]
        ports = {port["name"]: port for port in blocks["rotor"]["inputs"]}
        assert (ports["force"]["unit"], ports["force"]["shape"], ports["force"]["wired"]) == ("N", "2", True)
        mass = next(one for one in blocks["rotor"]["parameters"] if one["name"] == "mass")
        assert (mass["written"], mass["value"], mass["unit"]) == ("2 kg", "2 kg", "kg")
        damping = next(one for one in blocks["rotor"]["parameters"] if one["name"] == "viscous_damping")
        assert damping["follows"] == "viscous_damping"
        assert len(state["view"]["wires"]) == 14
        for wire in state["view"]["wires"]:  # from the port of the one block to that of the other
            block, port = wire["source"].split(".")
            start = next(one for one in blocks[block]["outputs"] if one["name"] == port)
            assert wire["points"][0] == [start["x"], start["y"]]
        assert [column["value"] for column in state["view"]["columns"]] == [0, 1, 2, 3, 4]

    talk(talking)


def test_an_edit_that_is_asked_again_is_made_once(at: Served, mine: Path) -> None:
    async def talking() -> None:
        page = await opened(at)
        adding = {"op": "add", "type": "gain", "at": [1, 4]}
        base = page.state["sha"]
        first = await page.edit(adding, base=base, key="7f0c")
        again = await page.edit(adding, base=base, key="7f0c")
        assert again | {"id": 0} == first | {"id": 0}
        assert [name for name in json.loads(mine.read_text())["blocks"] if "gain" in name] == ["gain"]
        other = await page.edit(adding, base=base, key="7f0d")
        assert (other["kind"], "gain2" in json.loads(mine.read_text())["blocks"]) == ("done", True)

    talk(talking)


def test_two_pages_agree_and_hand_edits_appear(at: Served, mine: Path) -> None:
    async def talking() -> None:
        one, two = await opened(at), await opened(at)
        done = await one.edit({**MASS, "value": "3 kg"})
        assert done["kind"] == "done"
        told = await two.next()
        assert (told["kind"], told["sha"]) == ("state", done["sha"])
        conflict = await two.edit({**MASS, "value": "4 kg"})  # of the state before
        assert conflict["kind"] == "conflict"
        expected = [{"what": "blocks.rotor.parameters.mass", "mine": "4 kg", "theirs": "3 kg"}]
        assert conflict["conflicts"] == expected
        taken = await two.edit({**MASS, "value": "4 kg"}, base=conflict["sha"], mine=True)
        assert taken["kind"] == "done"
        mine.write_text(mine.read_text().replace('"4 kg"', '"5 kgg"'))
        while (told := await one.next())["valid"]:
            pass
        assert [problem["what"] for problem in told["problems"]] == ["unknown unit 'kgg'"]
        assert told["problems"][0]["block"] == "rotor"
        assert told["problems"][0]["place"].startswith("mine.json:")
        assert told["view"] is not None
        refused = await one.edit({**MASS, "value": "6 kg"}, base=told["sha"])
        assert refused["kind"] == "refused"
        assert refused["problems"][0]["what"] == "the file on disk has mistakes, and nothing is written over them"

    talk(talking)


def test_names_with_markup_are_text(at: Served, mine: Path) -> None:
    document = json.loads(mine.read_text()) | {"name": "<img src=x onerror=alert(1)>"}
    mine.write_text(json.dumps(document))

    async def talking() -> None:
        page = await opened(at)
        assert page.state["view"]["name"] == "<img src=x onerror=alert(1)>"  # told as data; the page writes text

    talk(talking)


@pytest.mark.slow
def test_a_run_is_that_of_the_library(at: Served, mine: Path) -> None:
    async def talking() -> None:
        page = await opened(at)
        found = await page.ask(kind="run", set={"speed": "1800 rpm"})
        assert (found["kind"], found["status"], found["title"]) == ("result", "finished", "mine, 1800 rpm")
        assert found["speed_rpm"] == pytest.approx(1800.0)
        expected = simulate(load(mine), parameters={"speed": "1800 rpm"})
        assert [one["name"] for one in found["signals"]] == ["rotor.displacement", "controller.current"]
        assert found["signals"][0] == {
            "name": "rotor.displacement",
            "unit": "um",
            "entries": ["x", "y"],
            "two_axis": True,
        }
        assert found["values"][0] == pytest.approx(1e6 * expected["rotor.displacement"][:, 0], rel=1e-6)
        assert found["values"][3] == pytest.approx(expected["controller.current"][:, 1], rel=1e-6)
        assert found["time"] == pytest.approx(expected.time, rel=1e-6)
        for kind in ("overview", "spectrum"):
            answer, body = at.ask(f"/api/figure/{found['run']}/{kind}", X_Rotorsim_Token=TOKEN)
            assert answer.status == 200
            assert answer.headers["Content-Type"] == "image/svg+xml"
            assert b"<svg" in body[:500]
        assert at.ask(f"/api/figure/{found['run']}/modes", X_Rotorsim_Token=TOKEN)[0].status == 404
        refused = await page.ask(kind="run", set={"speed": "1800 kg"})
        assert refused["kind"] == "refused"
        assert "speed" in refused["problems"][0]["subject"]

    talk(talking)


def test_an_analysis_tells_what_is_done_and_is_stopped(at: Served) -> None:
    async def talking() -> None:
        page = await opened(at)
        await page.connection.write_message(json.dumps({"id": 70, "kind": "analyse", "what": "campbell"}))
        shares = []
        while (told := await page.next())["kind"] == "progress":
            shares.append(told["share"])
        assert told["kind"] == "table"
        assert len(shares) > 10
        assert shares == sorted(shares)
        assert shares[-1] == pytest.approx(1.0, abs=0.03)
        await page.connection.write_message(json.dumps({"id": 71, "kind": "analyse", "what": "campbell"}))
        assert (await page.next())["kind"] == "progress"
        await page.connection.write_message(json.dumps({"id": 71, "kind": "cancel"}))
        while (told := await page.next())["kind"] == "progress":
            pass
        assert (told["kind"], told["id"], told["problems"][0]["what"]) == ("refused", 71, "stopped")

    talk(talking)


@pytest.mark.slow
def test_a_run_is_stopped(at: Served, mine: Path) -> None:
    mine.write_text(mine.read_text().replace('"stop": "5 s"', '"stop": "100000 s", "record_every": 100000'))

    async def talking() -> None:
        page = await opened(at)
        await page.connection.write_message(json.dumps({"id": 77, "kind": "run"}))
        while (await page.next())["kind"] != "progress":
            pass
        await page.connection.write_message(json.dumps({"id": 77, "kind": "cancel"}))
        while (told := await page.next())["kind"] in ("progress", "state"):
            pass
        assert (told["kind"], told["id"], told["problems"][0]["what"]) == ("refused", 77, "stopped")

    talk(talking)


@pytest.mark.slow
def test_analyses_have_a_table_and_a_figure(at: Served) -> None:
    async def talking() -> None:
        page = await opened(at)
        for what, first in (("modes", "mode"), ("campbell", "order"), ("periodic", "speed [rpm]")):
            moved = {"speed": "1545 rpm", "eccentricity": "30 um"}  # as sliders say it
            assert (await page.ask(kind="analyse", what=what, set=moved))["kind"] == "table"
            found = await page.ask(kind="analyse", what=what)
            assert found["kind"] == "table"
            assert found["columns"][0] == first
            assert at.ask(f"/api/figure/{found['run']}/{what}", X_Rotorsim_Token=TOKEN)[0].status == 200
            if what == "modes":
                assert [row[1] for row in found["rows"]] == ["121.38", "121.38"]

    talk(talking)


def test_values_are_checked_while_they_are_typed(at: Served) -> None:
    async def talking() -> None:
        page = await opened(at)
        for name, value, problem in (
            ("rotor.mass", "2 kg", ""),
            ("rotor.mass", "2 lb", ""),
            ("rotor.mass", "2 kgg", "unknown unit 'kgg'"),
            ("rotor.mass", "2 N", "unit 'N' does not fit 'kg'"),
            ("rotor.mass", "$speed", ""),
            ("rotor.mass", "$sped", "no diagram parameter 'sped'"),
            ("speed", "1500 rpm", ""),
            ("crack.terms", 5, ""),
            ("crack.terms", "many", "must be a whole number"),
        ):
            found = await page.ask(kind="value", name=name, value=value)
            assert found["problem"].startswith(problem) if problem else found["problem"] == "", (name, value, found)

    talk(talking)


def test_only_ports_that_fit_are_offered(at: Served) -> None:
    async def talking() -> None:
        page = await opened(at)
        await page.edit({"op": "cut", "source": "rotor.displacement", "target": "amb.displacement"})
        found = await page.ask(kind="fits", port="rotor.displacement")
        fits = {one["port"] for one in found["ports"] if one["ok"]}
        assert "amb.displacement" in fits
        why = {one["port"]: one["why"] for one in found["ports"]}
        assert why["controller.displacement"] == "has a wire already"
        assert why["unbalance.theta"] == "has a wire already"
        assert why["rotor.force"] == "unit 'm' does not fit 'N'"
        found = await page.ask(kind="fits", port="amb.displacement")
        assert {one["port"] for one in found["ports"] if one["ok"]} == {"rotor.displacement", "bus.output"}

    talk(talking)


def test_wrong_messages_are_answered_in_words(at: Served) -> None:
    async def talking() -> None:
        page = await opened(at)
        for message, said in (
            ({"kind": "dance"}, "unknown message 'dance'"),
            ({"kind": "edit"}, "an edit has a base and operations"),
            ({"kind": "edit", "base": "no", "operations": [MASS]}, "the version that was edited is not known any more"),
            ({"kind": "fits", "port": "rotor.nothing"}, "no such port"),
            ({"kind": "types", "block": "rotr"}, "no block 'rotr' in this file"),
            ({"kind": "analyse", "what": "taste"}, "unknown analysis 'taste'"),
            ({"kind": "run", "set": [1]}, "'set' is an object of names and values"),
        ):
            found = await page.ask(**message)
            assert found["kind"] == "refused", message
            assert found["problems"][0]["what"] == said

    talk(talking)


def test_a_run_that_diverges_is_told_as_far_as_it_can_be_drawn(at: Served, mine: Path) -> None:
    """KP = 0 drops the rotor into its negative stiffness: what diverges is told up to where it did."""
    mine.write_text(mine.read_text().replace('"KP": "12200 A/m"', '"KP": "-1e9 A/m"'))

    async def talking() -> None:
        page = await opened(at)
        found = await page.ask(kind="run")
        assert found["kind"] == "result"
        assert found["status"] in ("unstable", "diverged")
        assert found["message"]
        assert not np.isinf(found["values"]).any()
        assert np.isfinite(found["values"][:, 0]).all()

    talk(talking)


def test_the_gallery_copies_a_diagram_to_the_folder(tmp_path: Path) -> None:
    with served(Session(tmp_path)) as at:
        answer, body = at.ask("/api/gallery", X_Rotorsim_Token=TOKEN)
        names = [one["name"] for one in json.loads(body)["diagrams"]]
        assert "jeffcott" in names
        assert "fe_flexible" in names
        for name, status in (("jeffcot", 400), ("../x", 400), ("jeffcott", 200)):
            answer, body = at.ask("/api/copy", "POST", json.dumps({"name": name}), X_Rotorsim_Token=TOKEN)
            assert answer.status == status, body
        assert json.loads(body) == {"file": "jeffcott.json"}
        assert [file.name for file in tmp_path.iterdir()] == ["jeffcott.json"]

        async def talking() -> None:
            assert (await opened(at)).state["file"] == "jeffcott.json"

        talk(talking)


def test_the_palette_has_every_type(at: Served) -> None:
    from rotorsim.diagram.resolve.registry import all_types

    _, body = at.ask("/api/palette", X_Rotorsim_Token=TOKEN)
    assert {one["type"] for one in json.loads(body)["types"]} == set(all_types())


@pytest.mark.slow
def test_recordings_below_the_folder_are_found_and_looked_into(at: Served, mine: Path, tmp_path_factory) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "recording.json").write_text("{}")
    (mine.parent / "away").symlink_to(elsewhere)
    made = (
        'record mine.json --set "controller.KD=3.3 A s/m" --speeds "900 rpm, 1500 rpm, 2100 rpm" --settle '
        '--noise "0.5 %" --out runs/bench'
    )
    with chdir(mine.parent):
        assert CliRunner().invoke(rotorsim, shlex.split(made)).exit_code == 0
    _, body = at.ask("/api/recordings", X_Rotorsim_Token=TOKEN)
    of_bench = {"name": "runs/bench", "kind": "time", "runs": ["run01", "run02", "run03"]}
    assert json.loads(body) == {"recordings": [of_bench]}

    async def talking() -> None:
        page = await opened(at)
        for recording in ("away", "../x", str(elsewhere)):
            refused = await page.ask(kind="find", verb="identify", recording=recording)
            what = f"no recording '{recording}' below the folder of the diagram"
            assert (refused["kind"], refused["problems"][0]["what"]) == ("refused", what)
        refused = await page.ask(kind="find", verb="cosim", recording="runs/bench")
        assert refused["problems"][0]["what"] == "unknown verb 'cosim'"
        found = await page.ask(kind="find", verb="identify", recording="runs/bench")
        assert found["kind"] == "found"
        assert "force_current_factor" in found["text"]
        assert "parameters.png" in found["figures"]
        assert any("force_current_factor" in one for one in found["words"])
        path = f"/api/outcome/{found['outcome']}/parameters.png"
        assert at.ask(path)[0].status == 403
        answer, body = at.ask(path, X_Rotorsim_Token=TOKEN)
        assert (answer.status, body[:4]) == (200, b"\x89PNG")
        for name in ("diagram.json", "..%2fmine.json", "report.html"):
            assert at.ask(f"/api/outcome/{found['outcome']}/{name}", X_Rotorsim_Token=TOKEN)[0].status == 404
        done = await page.edit({"op": "patch", "changes": found["changes"]}, base=found["sha"])
        assert done["kind"] == "done"
        assert load(mine).parameters["force_current_factor"] != 42.1

    talk(talking)


@pytest.mark.slow
def test_files_of_the_folder_are_no_modules(at: Served, mine: Path) -> None:
    """FAULT: a click.py beside the diagram was run by the verbs, without --trust-blocks."""
    (mine.parent / "click.py").write_text("open('ran', 'w')")
    (mine.parent / "bench").mkdir()
    (mine.parent / "bench" / "recording.json").write_text("{}")

    async def talking() -> None:
        page = await opened(at)
        refused = await page.ask(kind="find", verb="beside", recording="bench")
        assert refused["kind"] == "refused"

    talk(talking)
    assert sorted(file.name for file in mine.parent.iterdir()) == ["bench", "click.py", "mine.json"]


@pytest.mark.slow
def test_what_is_looked_for_is_stopped_with_its_processes(at: Served, mine: Path) -> None:
    made = 'record mine.json --speeds "900 rpm:60 rpm:3000 rpm" --settle --noise "0.5 %" --out bench'
    with chdir(mine.parent):
        assert CliRunner().invoke(rotorsim, shlex.split(made)).exit_code == 0

    async def talking() -> None:
        page = await opened(at)
        await page.connection.write_message(
            json.dumps({"id": 5, "kind": "find", "verb": "diagnose", "recording": "bench"})
        )
        while (await page.next())["kind"] != "progress":
            pass
        await page.connection.write_message(json.dumps({"id": 5, "kind": "cancel"}))
        while (told := await page.next())["kind"] in ("progress", "state"):
            pass
        assert (told["kind"], told["problems"][0]["what"]) == ("refused", "stopped")

    talk(talking)
    ps = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True)
    assert str(mine) not in ps.stdout


def test_a_report_opens_with_its_own_key_only_and_runs_nothing(at: Served, tmp_path: Path) -> None:
    folder = tmp_path / "found"
    folder.mkdir()
    (folder / "report.html").write_text("<script>alert(1)</script><p>report</p>")
    outcome = Outcome(folder)
    at.session.outcomes.kept[1] = outcome
    for key in ("", outcome.key[:-1], TOKEN):
        assert at.ask(f"/report/1/{key}", X_Rotorsim_Token=TOKEN)[0].status in (403, 404)
    assert at.ask(f"/report/1/{outcome.key}", Sec_Fetch_Site="cross-site")[0].status == 403
    answer, body = at.ask(f"/report/1/{outcome.key}")
    assert (answer.status, b"report" in body) == (200, True)
    assert answer.headers["Content-Security-Policy"].startswith("sandbox; default-src 'none'; ")
    assert answer.headers["X-Frame-Options"] == "SAMEORIGIN"


def test_a_sub_diagram_that_changes_on_disk_is_what_runs(tmp_path: Path) -> None:
    inner = {
        "schema_version": 1,
        "blocks": {"gain": {"type": "gain", "parameters": {"gain": 2.0}}},
        "wires": [],
        "ports": {"inputs": {"u": "gain.input"}, "outputs": {"y": "gain.output"}},
    }
    outer = {
        "schema_version": 1,
        "name": "outer",
        "blocks": {
            "one": {"type": "constant", "parameters": {"value": 1.0}},
            "inner": {"type": "diagram", "file": "inner.json"},
        },
        "wires": [["one.output", "inner.u"]],
        "solver": {"step": 0.01, "stop": 0.1},
        "record": ["inner.y"],
    }
    (tmp_path / "inner.json").write_text(json.dumps(inner))
    (tmp_path / "outer.json").write_text(json.dumps(outer))
    with served(Session(tmp_path, DiagramFile(tmp_path / "outer.json"))) as at:

        async def talking() -> None:
            page = await opened(at)
            part = page.state["view"]["blocks"][1]
            assert (part["name"], part["kind"], part["closed"], part["editable"]) == (
                "inner",
                "diagram: inner.json",
                True,
                True,
            )
            assert [port["name"] for port in part["inputs"] + part["outputs"]] == ["u", "y"]
            ends = [(wire["source"], wire["target"]) for wire in page.state["view"]["wires"]]
            assert ends == [("one.output", "inner.u")]
            fits = await page.ask(kind="fits", port="inner.u")
            assert {one["port"]: one["ok"] for one in fits["ports"]} == {"one.output": False, "inner.y": False}
            assert (await page.edit({"op": "move", "block": "inner", "to": [3, 0]}))["kind"] == "done"
            assert (await page.ask(kind="part", block="inner", open=True))["kind"] == "part"
            assert (await page.ask(kind="part", block="outer", open=True))["problems"][0]["what"] == (
                "no sub-diagram 'outer'"
            )
            assert [one["name"] for one in page.state["view"]["blocks"]] == ["one", "inner/gain"]
            assert page.state["view"]["blocks"][1]["part"] == "inner"
            assert page.state["view"]["wires"][0]["target"] == "inner/gain.input"
            assert (await page.ask(kind="part", block="inner", open=False))["kind"] == "part"
            assert (await page.ask(kind="run"))["values"][0][-1] == 2.0
            inner["blocks"]["gain"]["parameters"]["gain"] = 33.0
            (tmp_path / "inner.json").write_text(json.dumps(inner))
            assert (await page.ask(kind="run"))["values"][0][-1] == 33.0
            refused = await page.edit({"op": "set", "name": "inner/gain.gain", "value": 4})
            assert refused["problems"][0]["what"] == "it is a part of the sub-diagram 'inner'"

        talk(talking)


def test_a_block_file_of_the_user_that_changes_is_what_runs(tmp_path: Path) -> None:
    block = '''from rotorsim.block import Block, Equations, In, Out

class Times(Block):
    """Multiply by a number."""

    input = In()
    output = Out()

    def equations(self, p, u, x, t):
        return Equations(outputs={"output": FACTOR * u.input})
'''
    (tmp_path / "own").mkdir()
    file = tmp_path / "own" / "times.py"
    file.write_text(block.replace("FACTOR", "2"))
    diagram = {
        "schema_version": 1,
        "name": "owner",
        "block_folders": ["own"],
        "blocks": {"one": {"type": "constant", "parameters": {"value": 1.0}}, "times": {"type": "times"}},
        "wires": [["one.output", "times.input"]],
        "solver": {"step": 0.01, "stop": 0.1},
        "record": ["times.output"],
    }
    (tmp_path / "owner.json").write_text(json.dumps(diagram))
    untrusted = DiagramFile(tmp_path / "owner.json")
    assert "block files are programs; they are not run unless you say so" in [p.what for p in untrusted.state.problems]
    with served(Session(tmp_path, DiagramFile(tmp_path / "owner.json", trusted=True), trusted=True)) as at:

        async def talking() -> None:
            page = await opened(at)
            assert page.state["problems"] == []
            assert (await page.ask(kind="run"))["values"][0][-1] == 2.0
            file.write_text(block.replace("FACTOR", "100"))
            assert (await page.ask(kind="run"))["values"][0][-1] == 100.0

        talk(talking)
