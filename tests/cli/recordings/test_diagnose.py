"""rotorsim diagnose: what it prints and writes, its exit codes, and what it refuses."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.diagram.resolve.resolution import shipped_diagrams
from tests.cli.conftest import Run
from tests.diagnosis.test_diagnosis import HELD, NOISE, SPEEDS, bent
from tests.identification import OTHER_GAINS, TRUTH, made
from tests.reference.recordings import THESIS_GAINS, write_recording
from tests.report import undrawn

ROWS = "residual_bow,runout,sensor_offset"


def folder(tmp_path_factory: pytest.TempPathFactory, name: str, bow: bool, speeds, gains) -> str:
    runs = [
        run
        for each in gains
        for k, speed in enumerate(speeds)
        for run in made(
            "jeffcott", [speed], bent(speed) if bow else TRUTH, gains=each, level=NOISE, seed=k, duration=0.5
        )
    ]
    path = tmp_path_factory.mktemp(name)
    write_recording(path, runs, name)
    return str(path)


@pytest.fixture(scope="module")
def bowed(tmp_path_factory) -> str:
    return folder(tmp_path_factory, "bowed", True, SPEEDS, (THESIS_GAINS, OTHER_GAINS))


@pytest.fixture(scope="module")
def held(tmp_path_factory) -> str:
    return folder(tmp_path_factory, "held", True, HELD, (OTHER_GAINS,))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory) -> str:
    return folder(tmp_path_factory, "healthy", False, SPEEDS, (THESIS_GAINS, OTHER_GAINS))


def test_what_is_missing_and_the_repaired_diagram(run: Run, bowed: str, held: str):
    with undrawn():  # figures: tests/report
        result = run(
            "diagnose",
            "jeffcott",
            bowed,
            "--hold-out",
            held,
            "--physics",
            "residual_bow",
            "--workers",
            "1",
            "--out",
            "found",
        )
    assert result.exit_code == 1
    text = result.stdout.splitlines()
    assert text[0] == "verdict: missing_physics"
    assert text[2].split() == ["missing", "probability", "at"]
    assert text[3].split() == ["residual_bow", "1", "rotor.force"]
    assert "Missing physics: residual_bow at rotor.force (amplitude 1." in result.stdout
    assert "On hold-out runs the error falls from" in result.stdout
    data = json.loads(Path("found/diagnosis.json").read_text())
    assert data["verdict"] == "missing_physics"
    assert "The diagram lacks residual bow at rotor.force" in Path("found/report.html").read_text()
    assert "written: found/report.html" in result.stderr
    assert run("check", "found/diagram.json").exit_code == 0
    assert run("diff", "jeffcott", "found/diagram.json").exit_code == 1


@pytest.mark.slow
def test_nothing_is_missing(run: Run, healthy: str):
    result = run("diagnose", "jeffcott", healthy, "--physics", "residual_bow", "--workers", "1", "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert (data["verdict"], data["missing"], data["where"]) == ("consistent", [], [])
    assert data["detectable"]["residual_bow"]["unit"] == "m"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing", "here"], "nothing: error: no such file and no diagram of this name"),
        (
            ["jeffcott", "here"],
            "error: RECORDING here: does not exist\n\n"
            "hint: a recording is a folder with recording.json and data files; see docs/recordings.md\n",
        ),
        (
            ["jeffcott", "BOWED", "--hold-out", "there"],
            "error: --hold-out there: does not exist\n\n"
            "hint: a recording is a folder with recording.json and data files; see docs/recordings.md\n",
        ),
        (
            ["jeffcott", "BOWED", "--physics", "runnout"],
            "error: --physics runnout: no block declares it\n\nhint: did you mean 'runout'?",
        ),
        (
            ["jeffcott", "BOWED", "--physics", " ,"],
            "error: --physics: names nothing\n\nhint: known: amb_cross_coupling, ",
        ),
        (["jeffcott", "BOWED", "--workers", "0"], "--workers"),
        (["jeffcott", "BOWED", "--scheduler", "home"], "error: scheduler: 'home' is not the address of a scheduler"),
        (["offset_disc", "BOWED", "--set", "nonsense=1"], "error: nonsense: no diagram parameter 'nonsense'"),
    ],
)
def test_what_is_refused(run: Run, bowed: str, arguments: list[str], said: str):
    result = run("diagnose", *[bowed if word == "BOWED" else word for word in arguments])
    assert result.exit_code == 2
    assert said in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""


def copied(source: str, name: str, change: Callable[[dict[str, Any]], object]) -> str:
    """Copy a recording with its recording.json changed."""
    shutil.copytree(source, name)
    file = Path(name) / "recording.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content, indent=1))
    return name


def lines_of(text: str) -> list[str]:
    return [line for line in text.splitlines() if line]


@pytest.mark.slow
def test_a_recording_that_does_not_go_with_the_diagram(run: Run, healthy: str):
    """FAULT: these had neither a place nor a hint."""

    def other(content: dict[str, Any]) -> None:
        for column in "xy":
            content["channels"][column]["signal"] = "rotr.displacement"

    result = run("diagnose", "jeffcott", copied(healthy, "other", other))
    assert result.exit_code == 2
    assert result.stderr == "\n".join(
        f"other/recording.json:{line}:3: error: channel {column}: the diagram has no signal 'rotr.displacement'\n\n"
        "hint: did you mean 'rotor.displacement'?\n"
        for column, line in {"x": 5, "y": 10}.items()
    )


@pytest.mark.slow
def test_without_a_tacho(run: Run, healthy: str):
    name = copied(healthy, "still", lambda content: [entry.pop("tacho") for entry in content["runs"]])
    result = run("diagnose", "jeffcott", name)
    assert result.exit_code == 2
    said = lines_of(result.stderr)
    assert len(said) == 12  # an error and a hint for each run
    assert re.fullmatch(
        r"still/recording.json:\d+:3: error: run run00: no phase reference: nothing says where shaft angle zero is",
        said[0],
    )
    assert said[1] == (
        'hint: add "tacho": [times of a once-per-turn pulse] or a channel "clock.theta"; or leave the run out'
    )


def test_all_runs_held_out(run: Run, healthy: str):
    name = copied(healthy, "all", lambda content: [entry.update(use="hold_out") for entry in content["runs"]])
    result = run("diagnose", "jeffcott", name)
    assert result.exit_code == 2
    assert result.stderr == (
        "error: RECORDING all: all its runs are held out\n\n"
        'hint: give runs to be scored only with --hold-out, or mark some of these "use": "identify"\n'
    )


def test_values_that_are_not_finite(run: Run, healthy: str):
    name = copied(healthy, "broken", lambda content: content["runs"].__delitem__(slice(1, None)))
    file = Path(name) / "run00.npz"
    data = dict(np.load(file))
    data["x"][100:120] = np.nan
    np.savez(file, **data)
    result = run("diagnose", "jeffcott", name)
    assert result.exit_code == 1
    assert result.stderr == (
        "broken/run00.npz: warning: column x: 20 of 1000 values are not finite, the first is sample 101\n"
        "broken/run00.npz: error: run00: column x: not finite: 20 of 1000 samples, first at 0.05 s\n\n"
        "hint: cut the run before it, or leave it out\n"
    )


def test_less_than_a_turn(run: Run, tmp_path_factory):
    short = tmp_path_factory.mktemp("short")
    write_recording(short, made("jeffcott", [SPEEDS[0]], level=NOISE, duration=0.03), "short")
    result = run("diagnose", "jeffcott", str(short))
    assert result.exit_code == 2
    assert result.stderr == (
        "error: run run00: only 0.442 turns of the shaft were recorded\n\nhint: harmonics need at least one turn\n"
    )


@pytest.mark.slow
def test_one_speed_is_not_called_enough(run: Run, bowed: str):
    """At one speed a bow is an unbalance: nothing is found missing then, which proves nothing."""
    name = copied(bowed, "one", lambda content: content["runs"].__delitem__(slice(1, None)))
    result = run("diagnose", "jeffcott", name, "--physics", ROWS, "--workers", "1", "--json")
    data = json.loads(result.stdout)
    assert result.exit_code == 1
    assert (data["verdict"], data["missing"]) == ("not_identifiable", [])
    assert "All its runs are alike, though: at one speed unbalance imitates bow and runout" in data["statement"]
    assert data["next_experiment"].startswith("runs at several speeds, from slow roll to above the first critical")


def test_a_diagram_in_which_nothing_is_free(run: Run, healthy: str):
    document = json.loads(shipped_diagrams()["jeffcott"].read_text())
    del document["identify"], document["$schema"]
    Path("stated.json").write_text(json.dumps(document))
    result = run("diagnose", "stated.json", healthy)
    assert result.exit_code == 2
    assert result.stderr == (
        "error: stated.json: no free parameters: identify is empty\n\n"
        'hint: name what is not known exactly, such as "identify": {"viscous_damping": {}}\n'
    )


def test_a_folder_that_cannot_be_made(run: Run, healthy: str):
    """Said before the work, not after it."""
    Path("file").write_text("")
    for out, said in (
        ("file", "error: --out file: is a file\n\nhint: give the name of a folder\n"),
        ("file/in", "error: --out file/in: cannot be made\n\nhint: give the name of a folder\n"),
    ):
        result = run("diagnose", "jeffcott", healthy, "--out", out)
        assert (result.exit_code, result.stdout, result.stderr) == (2, "", said)


def test_the_diagram_itself_is_not_overwritten(run: Run, bowed: str):
    Path("diagram.json").write_text(shipped_diagrams()["jeffcott"].read_text())
    result = run("diagnose", "diagram.json", bowed, "--out", ".")
    assert result.exit_code == 2
    assert "error: --out .: would overwrite diagram.json" in result.stderr


@pytest.mark.slow
def test_a_diagram_that_does_not_have_the_signals(run: Run, bowed: str):
    result = run("diagnose", "fe_rigid", bowed)
    assert result.exit_code == 2
    place = f"{bowed}/recording.json:5:3"
    assert lines_of(result.stderr)[:2] == [
        f"{place}: error: channel x: 'rotor.displacement[1]' is not one entry of 'rotor.displacement', which is 6 x 2",
        "hint: say node and axis",
    ]
