"""rotorsim diagnose: what it prints and writes, its exit codes, and what it refuses."""

import json
from pathlib import Path

import pytest

from rotorsim.diagram.load import shipped_diagrams
from tests.cli.conftest import Run
from tests.diagnose.test_diagnosis import HELD, NOISE, SPEEDS, bent
from tests.identify import OTHER_GAINS, TRUTH, made
from tests.reference.recordings import THESIS_GAINS, write_recording

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
    result = run(
        "diagnose", "jeffcott", bowed, "--hold-out", held, "--physics", ROWS, "--workers", "1", "--out", "found"
    )
    assert result.exit_code == 1
    text = result.stdout.splitlines()
    assert text[0] == "verdict: missing_physics"
    assert text[2].split() == ["missing", "probability", "at"]
    assert text[3].split() == ["residual_bow", "1", "rotor.force"]
    assert "Missing is residual_bow at rotor.force (amplitude 1." in result.stdout
    assert "On held-out runs the error falls from" in result.stdout
    data = json.loads(Path("found/diagnosis.json").read_text())
    assert data["verdict"] == "missing_physics"
    assert run("check", "found/diagram.json").exit_code == 0
    assert run("diff", "jeffcott", "found/diagram.json").exit_code == 1


def test_nothing_is_missing(run: Run, healthy: str):
    result = run("diagnose", "jeffcott", healthy, "--physics", ROWS, "--workers", "1", "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert (data["verdict"], data["missing"], data["where"]) == ("consistent", [], [])
    assert data["detectable"]["residual_bow"]["unit"] == "m"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing", "here"], "nothing: error: no such file and no diagram of this name"),
        (["jeffcott", "here"], "here: "),
        (
            ["jeffcott", "BOWED", "--physics", "runnout"],
            "error: --physics runnout: no block declares it\n\nhint: did you mean 'runout'?",
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


def test_the_diagram_itself_is_not_overwritten(run: Run, bowed: str):
    Path("diagram.json").write_text(shipped_diagrams()["jeffcott"].read_text())
    result = run("diagnose", "diagram.json", bowed, "--out", ".")
    assert result.exit_code == 2
    assert "error: --out .: would overwrite diagram.json" in result.stderr


def test_a_diagram_that_does_not_have_the_signals(run: Run, bowed: str):
    result = run("diagnose", "fe_rigid", bowed)
    assert result.exit_code == 2
    assert "is not one entry of 'rotor.displacement', which is 6 x 2" in result.stderr
