"""Recordings in the charts of the page, and co-simulation: what is told is what the library says."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rotorsim import load, load_recording
from rotorsim.cli.app import rotorsim
from rotorsim.serve.beside import in_axes
from rotorsim.serve.session import Session
from rotorsim.serve.store import DiagramFile
from rotorsim.simulation.run import simulate
from tests.serve.serving import TOKEN, Served, opened, served, talk


@pytest.fixture
def at(mine: Path) -> Iterator[Served]:
    made = 'record mine.json --speeds "1200 rpm, 1500 rpm" --settle --noise "0.5 %" --out bench'
    with chdir(mine.parent):
        made_it = CliRunner().invoke(rotorsim, shlex.split(made))
        assert made_it.exit_code == 0, made_it.output
    with served(Session(mine.parent, DiagramFile(mine))) as found:
        yield found


@pytest.mark.slow
def test_what_was_measured_stands_beside_the_diagram_driven_as_it_was(at: Served, mine: Path) -> None:
    recording = load_recording(mine.parent / "bench")

    async def talking() -> None:
        page = await opened(at)
        measured = await page.ask(kind="measured", recording="bench", run="run02")
        assert (measured["kind"], measured["title"]) == ("result", "measured, run02 of mine")
        assert measured["measured"] is True
        assert [one["name"] for one in measured["signals"]] == ["rotor.displacement", "controller.current"]
        assert measured["signals"][0]["unit"] == "um"
        assert measured["values"][0] == pytest.approx(1e6 * recording.runs[1].values["x"], rel=1e-5)
        assert measured["speed_rpm"] == pytest.approx(1500.0, rel=1e-3)
        driven = await page.ask(kind="run", recording="bench", run="run02")
        assert driven["title"] == "mine driven as run02 of mine"
        assert [one["name"] for one in driven["signals"]][:2] == ["rotor.displacement", "controller.current"]
        shares = [float(one) for one in re.findall(r"([\d.]+) % of", driven["note"])]
        assert len(shares) == 4
        assert max(shares) < 2.0  # the noise, of 0.5 % of the peak
        off = driven["values"][0] - measured["values"][0]
        assert np.sqrt(np.mean(off**2)) < 0.02 * np.abs(measured["values"][0]).max()
        softer = await page.ask(kind="run", recording="bench", run="run02", set={"crack_stiffness": "1e5 N/m"})
        assert max(float(one) for one in re.findall(r"([\d.]+) % of", softer["note"])) > 20.0
        for found, kind in ((measured, "spectrum"), (driven, "spectrum"), (driven, "overview"), (measured, "overview")):
            answer, body = at.ask(f"/api/figure/{found['run']}/{kind}", X_Rotorsim_Token=TOKEN)
            assert answer.status == 200, (kind, body)
        for asked, what in (
            ({"run": "run07"}, "no run 'run07'"),
            ({"recording": "bank"}, "no recording 'bank' below the folder of the diagram"),
            ({"recording": "../bench"}, "no recording '../bench' below the folder of the diagram"),
        ):
            refused = await page.ask(**{"kind": "run", "recording": "bench", **asked})
            assert refused["problems"][0]["what"] == what

    talk(talking)


@pytest.mark.slow
def test_harmonics_that_were_measured_stand_beside_the_settled_motion(at: Served) -> None:
    async def talking() -> None:
        page = await opened(at)
        found = await page.ask(kind="analyse", what="periodic", recording="bench")
        assert found["columns"][2] == "measured [um, 0-peak]"
        rows = {row[0]: row for row in found["rows"] if row[2]}
        assert list(rows) == ["1200", "1500"]
        for row in rows.values():
            assert float(row[2]) == pytest.approx(float(row[1]), rel=1e-3)
        answer, body = at.ask(f"/api/figure/{found['run']}/periodic", X_Rotorsim_Token=TOKEN)
        assert answer.status == 200
        assert b"measured" in body or b"<svg" in body

    talk(talking)


@pytest.mark.slow
def test_a_co_simulation_is_told_with_what_the_coupling_does(at: Served, mine: Path) -> None:
    mine.write_text(mine.read_text().replace('"stop": "5 s"', '"stop": "0.2 s"'))

    async def talking() -> None:
        page = await opened(at)
        parts = [["controller"]]
        found = await page.ask(kind="cosim", step="20 us", master="iterative", parts=parts, set={"speed": "1800 rpm"})
        assert (found["kind"], found["status"]) == ("result", "finished")
        assert found["title"] == "mine, 1800 rpm, iterative, step 20 us"
        assert re.match(r"damping kept by the coupling: \d+\.\d%", found["note"])
        whole = simulate(load(mine), parameters={"speed": "1800 rpm"})["rotor.displacement"]
        names = [one["name"] for one in found["signals"]]
        assert names[0] == "rotor.displacement"
        assert found["values"][0][-1] == pytest.approx(1e6 * whole[-1, 0], abs=0.01 * 1e6 * np.abs(whole).max())
        for asked, what in (
            ({}, "must be a number, not null"),
            ({"step": "-1 ms"}, "must be positive"),
            ({"step": "1 furlong"}, "unknown unit 'furlong'"),
            ({"step": "1 ms", "parts": "controller"}, "parts are lists of blocks"),
            ({"step": "1 ms", "parts": [["controler"]]}, "no such block"),
        ):
            refused = await page.ask(kind="cosim", **asked)
            assert refused["problems"][0]["what"] == what, asked

    talk(talking)


@pytest.mark.slow
def test_what_was_measured_and_is_not_drawn_is_said(at: Served, mine: Path) -> None:
    """FAULT: a force in metres stood beside one in newtons; signals that the diagram lacks were left out in silence."""
    description = mine.parent / "bench" / "recording.json"
    text = description.read_text()
    document = json.loads(mine.read_text())
    document["record"].append("amb.force")
    mine.write_text(json.dumps(document))

    async def talking() -> None:
        page = await opened(at)
        description.write_text(text.replace("controller.current", "controler.current"))
        found = await page.ask(kind="analyse", what="periodic", recording="bench")
        assert "not drawn: controler.current (no such signal)" in found["title"]
        description.write_text(text.replace("rotor.displacement", "amb.force"))
        found = await page.ask(kind="analyse", what="periodic", recording="bench")
        assert "not drawn: amb.force (m, not N)" in found["title"]
        assert "1X of controller.current" in found["columns"][1]

    talk(talking)


@pytest.mark.slow
def test_runs_of_another_machine_are_not_drawn_beside_this_one(at: Served, mine: Path) -> None:
    """FAULT: runs with other gains, and those that turn the other way, stood beside the diagram as if they were its."""
    with chdir(mine.parent):
        for name, more in (("other", '--set "controller.KP=14000 A/m"'), ("back", '--set "speed=-1500 rpm"')):
            speeds = '"-1500 rpm"' if name == "back" else '"1300 rpm" --settle'
            command = f"record mine.json {more} --speeds {speeds} --out {name}"
            made = CliRunner().invoke(rotorsim, shlex.split(command))
            assert made.exit_code == 0, made.output
    bench = json.loads((mine.parent / "bench" / "recording.json").read_text())
    [foreign] = json.loads((mine.parent / "other" / "recording.json").read_text())["runs"]
    [backward] = json.loads((mine.parent / "back" / "recording.json").read_text())["runs"]
    bench["runs"] += [
        {**foreign, "id": "stiff", "file": "../other/" + foreign["file"], "set": {"controller.KP": "14000 A/m"}},
        {**backward, "id": "back", "file": "../back/" + backward["file"]},
    ]
    for one in bench["runs"][2:]:  # below the folder of the recording
        (mine.parent / "bench" / f"{one['id']}.npz").write_bytes((mine.parent / "bench" / one["file"]).read_bytes())
        one["file"] = f"{one['id']}.npz"
    (mine.parent / "bench" / "recording.json").write_text(json.dumps(bench))

    async def talking() -> None:
        page = await opened(at)
        found = await page.ask(kind="analyse", what="periodic", recording="bench")
        assert found["title"].endswith("; not drawn: stiff (other controller.KP), back (turning the other way)")
        assert [row[0] for row in found["rows"] if row[2]] == ["1200", "1500"]

    talk(talking)


def test_a_broken_description_takes_no_other_recording_away(at: Served, mine: Path) -> None:
    for name, text in (("deep", "[" * 200_000), ("odd", '{"runs": [{"id": "\\ud800"}, {"id": 7}, 5]}'), ("none", "{")):
        (mine.parent / name).mkdir()
        (mine.parent / name / "recording.json").write_text(text)
    (mine.parent / os.fsdecode(b"\xff")).mkdir()
    (mine.parent / os.fsdecode(b"\xff") / "recording.json").write_text("{}")
    answer, body = at.ask("/api/recordings", X_Rotorsim_Token=TOKEN)
    assert answer.status == 200
    found = {one["name"]: one["runs"] for one in json.loads(body)["recordings"]}
    assert found == {"bench": ["run01", "run02"], "deep": [], "none": [], "odd": ["7"]}


def test_entries_of_two_axes_are_one_signal() -> None:
    flat = {name: np.full(3, float(k)) for k, name in enumerate(["a.b[2,1]", "a.b[2,2]", "a.c[1]", "a.d", "a.e[2]"])}
    found = in_axes(flat)
    assert list(found) == ["a.b[2]", "a.c[1]", "a.d", "a.e[2]"]
    assert found["a.b[2]"].tolist() == [[0.0, 1.0]] * 3
