"""The verb ``sensitivity``."""

import json

import pytest

from tests.cli.conftest import Run

FAST = ("--seeds", "2", "--scheduler", "synchronous")


def test_list(run: Run) -> None:
    found = run("sensitivity", "--list")
    assert found.exit_code == 0
    assert "2-6     noise     jeffcott  5520:60:6000 rpm" in found.stdout
    tables = json.loads(run("sensitivity", "--list", "--json").stdout)
    assert len(tables) == 11
    assert tables[0]["levels"] == [0.0, 0.01, 0.02, 0.05]


@pytest.mark.slow
def test_table_of_the_thesis(run: Run) -> None:
    found = run("sensitivity", "--table", "2-5", "--noise", "0,5", "--out", "a.csv", *FAST)
    assert found.exit_code == 0
    lines = found.stdout.splitlines()
    assert lines[0] == "Table 2-5 of the thesis: jeffcott, 9 speeds, 1140 to 1620 rpm; regression, exact reduction"
    assert lines[2].split() == ["parameter", "true", "case", "mean", "error", "rms", "error", "rms", "error", "thesis"]
    assert lines[3].startswith("viscous_damping")
    assert lines[3].endswith("-0.92 %")
    assert "Delta k_22 at 2 %: -0.8 % is printed" in found.stdout
    assert "written: a.csv" in found.stderr


@pytest.mark.slow
def test_free_study_as_json(run: Run) -> None:
    arguments = (
        "sensitivity",
        "jeffcott",
        "--speeds",
        "1140 rpm, 1620 rpm",
        "--noise",
        "2 %",
        "--method",
        "likelihood",
        "--free",
        "crack_stiffness,eccentricity",
        "--gains",
        "controller.KP=12200",
        "--gains",
        "controller.KP=14000 A/m,controller.KD=4",
        "--set",
        "crack_stiffness=2e5",
    )
    found = run(*arguments, *FAST, "--json", "--out", "a.json")
    assert found.exit_code == 0
    data = json.loads(found.stdout)
    assert [row["parameter"] for row in data["rows"]] == ["crack_stiffness", "eccentricity"]
    assert data["rows"][0]["true"] == 2e5
    assert data["rows"][0]["coverage90"] is not None
    assert data["study"]["gains"][1] == {"controller.KP": 14000.0, "controller.KD": 4.0}


def test_wrong_known_parameters(run: Run) -> None:
    found = run(
        "sensitivity",
        "jeffcott",
        "--speeds",
        "1140 rpm,1620 rpm",
        "--wrong",
        "rotor.mass,unbalance.mass",
        "--wrong",
        "crack.sag",
        "--bias",
        "5",
        "--json",
        *FAST,
    )
    assert found.exit_code == 0
    rows = {row["parameter"]: row for row in json.loads(found.stdout)["rows"]}
    assert rows["crack_stiffness"]["rms_error_percent"] > 0.1
    assert rows["crack_stiffness"]["bias"] == 0.05


@pytest.mark.slow
def test_smallest_crack(run: Run) -> None:
    found = run("sensitivity", "jeffcott", "--speeds", "1140 rpm,1620 rpm", "--noise", "5", "--smallest-crack", *FAST)
    assert found.exit_code == 0
    assert found.stdout.splitlines()[2].split() == ["noise", "expected", "confirmed", "in", "share", "of", "seeds"]
    assert "Taken as known, for it has no effect at size zero: crack_phase." in found.stdout


def test_mistakes(run: Run) -> None:
    for arguments, words in (
        ((), "neither a diagram nor --table"),
        (("jeffcott",), "--speeds is missing"),
        (("--table", "9-9"), "one of 2-5, 2-6"),
        (("jeffcott", "--speeds", "100", "--noise", "much"), "not a list of numbers"),
        (("jeffcott", "--speeds", "100", "--noise", "300"), "3 is no level of noise"),
        (("jeffcott", "--speeds", "100", "--window", "5 s"), "not START:STOP"),
        (("jeffcott", "--speeds", "100", "--gains", "controller.KQ=1"), "did you mean 'controller.K"),
        (("jeffcott", "--speeds", "100", "--free", "crack"), "did you mean 'crack_phase'"),
        (("jeffcott", "--speeds", "100", "--bias", "2"), "--wrong rotor.mass"),
        (("jeffcott", "--speeds", "100", "--wrong", "rotor.mas", "--bias", "2"), "did you mean 'rotor.mass'"),
        (("jeffcott", "--speeds", "100", "--controllers", "--smallest-crack"), "exclude each other"),
        (("jeffcott", "--speeds", "100", "--controllers", "--store", "x"), "--store keeps one study"),
        (("jeffcott", "--speeds", "100", "--out", "a.txt"), "unknown format"),
    ):
        found = run("sensitivity", *arguments)
        assert found.exit_code == 2, arguments
        assert words in found.stderr, (arguments, found.stderr)
