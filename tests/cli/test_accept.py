"""The verb ``accept``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Run

GIVEN = ["--operating", "2000 rpm:3000 rpm", "--clearance", "0.2 mm"]
INJECT = ["record", "jeffcott", "--inject", "controller.displacement", "--amplitude", "1 um", "--out", "swept"]
SHORT = ["--set", "solver.stop=6 s", "--rate", "4500 Hz", "--sweep", "20 Hz:2000 Hz", "--noise", "1 %"]
RUN_UP = [
    "record",
    "jeffcott_runup",
    "--set",
    "acceleration=300 rad/s^2",
    "--set",
    "solver.stop=3.4 s",
    "--out",
    "runup",
]
STEPS = ["--set", "solver.step=0.05 ms", "--window", "0.2 s:3.4 s", "--rate", "5000 Hz", "--noise", "0.5 %"]


def test_what_is_printed_of_a_diagram(run: Run) -> None:
    found = run("accept", "jeffcott", *GIVEN)
    assert found.exit_code == 1
    assert found.stderr == "trip speed: 3150 rpm, 1.05 times the largest operating speed\n"
    lines = found.stdout.splitlines()
    assert lines[0] == (
        "jeffcott: 2000 to 3000 rpm, trip at 3150 rpm; clearance 200 um at rotor.displacement; zone A or better"
    )
    assert lines[2:5] == [
        "Displacement against the clearance",
        "verdict  quantity       where                            value   limit                             clause",
        "met      D_max / C_min  rotor.displacement at 2375 rpm  0.0664  <= 0.3  zone A: 13.3 um of 200 um  "
        "ISO 14839-2:2004, table 1",
    ]
    assert lines[-1] == "verdict: not met (7 met, 2 not met)"


def test_a_machine_that_is_accepted(run: Run) -> None:
    found = run("accept", "jeffcott", *GIVEN, "--zone", "B", "--json")
    data = json.loads(found.stdout)
    assert (found.exit_code, data["verdict"]) == (0, "met")
    assert [part["title"] for part in data["parts"]] == [
        "Displacement against the clearance",
        "Stability margins of the bearing loops",
        "Response to unbalance",
        "Damping of the modes",
        "Undamped critical speeds over the support stiffness",
        "Mode shapes, probes and magnets",
    ]
    peak = data["parts"][1]["criteria"][0]
    assert (peak["clause"], peak["limit"], peak["limit_is"]) == ("ISO 14839-3:2006, table 1", 4.0, "at most")
    assert peak["value"] == pytest.approx(3.434, rel=1e-3)
    assert data["conditions"]["operating"] == pytest.approx([209.4395, 314.1593], rel=1e-6)


@pytest.mark.slow
def test_recordings_beside_the_diagram_and_the_report(run: Run) -> None:
    assert run(*INJECT, *SHORT).exit_code == run(*RUN_UP, *STEPS).exit_code == 0
    assert (
        run("record", "jeffcott", "--speeds", "1500 rpm,3000 rpm", "--noise", "1 %", "--out", "steady").exit_code == 0
    )
    found = run("accept", "jeffcott", "swept", "runup", "steady", *GIVEN, "--out", "acceptance")
    assert found.stderr.splitlines()[-1] == "wrote acceptance/report.html and 10 files beside it"
    measured = [line.split("  ")[0] for line in found.stdout.splitlines() if ", measured" in line]
    assert measured == ["not met", "not met", "met", "met", "met", "met"]  # 2 peaks, N_c, 1X, D_max, vibration
    assert "note: run01: 1500 rpm, outside of the operating speeds; not counted" in found.stdout
    page = Path("acceptance/report.html").read_text()
    assert page.count("<figure>") == 9
    assert "<h2>7 Stability margins, jeffcott</h2>" in page
    assert page.count("sha256 of the samples") == 3
    assert json.loads(Path("acceptance/acceptance.json").read_text())["recordings"] == [
        "jeffcott",
        "jeffcott_runup",
        "jeffcott",
    ]
    alone = run("accept", "runup", "--operating", "9000 rpm:9500 rpm")
    lines = alone.stdout.splitlines()
    assert (alone.exit_code, lines[-1]) == (1, "verdict: not met (1 met, 1 not met, 1 not judged)")
    assert any(line.startswith("met") and "N_c 7331 rpm" in line for line in lines)
    assert any(line.startswith("not met") and "1X of the vibration" in line for line in lines)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["jeffcott", "--operating", "3000 rpm:2000 rpm", "--trip", "5 m", "--clearance", "x=", "--mass", "3 s"],
            "error: --operating 3000 rpm:2000 rpm: not LOW:HIGH\n\n"
            "hint: for example --operating '3000 rpm:3600 rpm'\n\n"
            "error: --trip 5 m: unit 'm' does not fit 'rad/s'\n\n"
            "hint: give an angular speed in rad/s, rpm or Hz (revolutions per second)\n\n"
            "error: --clearance x=: not [SIGNAL=]LENGTH\n\n"
            "hint: for example --clearance 'rotor.displacement[4]=0.2 mm' or --clearance '0.2 mm'\n\n"
            "error: --mass 3 s: unit 's' does not fit 'kg'\n\nhint: give it in kg\n",
        ),
        (
            ["jeffcott", "--cross-coupling", "1e5", "--clearance", "1 mm", "--clearance", "2 mm"],
            "error: --clearance 2 mm: all places twice\n\nhint: give each place once\n\n"
            "error: --cross-coupling 1e5: not PLANE=STIFFNESS\n\n"
            "hint: for example --cross-coupling 'rotor.force[4]=1e6 N/m'\n",
        ),
        (
            ["jeffcott", "jeffcott"],
            "error: jeffcott: not a recording\n\nhint: DIAGRAM is given once, before the recordings; "
            "`rotorsim check` says what is wrong with a recording\n",
        ),
        (
            ["jeffcott", "--unbalance", "rotor.moment"],
            "error: rotor.moment: no such input port\n\nhint: known: force\n",
        ),
    ],
)
def test_what_is_refused(run: Run, arguments: list[str], said: str) -> None:
    found = run("accept", *arguments)
    assert found.exit_code == 2
    assert found.stderr == said


def test_a_recording_alone_has_no_planes(run: Run) -> None:
    run("record", "jeffcott", "--speeds", "3000 rpm", "--out", "steady")
    found = run("accept", "steady", "--unbalance", "rotor.force")
    assert (found.exit_code, found.stderr) == (
        2,
        "error: steady: --unbalance, --mass and --cross-coupling need a diagram\n",
    )
