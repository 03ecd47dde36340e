"""The verb ``margins``, and ``record --inject``."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from rotorsim import load
from rotorsim.linear.control.margins import margins
from tests.cli.conftest import Run

RECORD = ["record", "jeffcott", "--inject", "controller.displacement", "--amplitude", "1 um", "--out", "swept"]
SHORT = ["--set", "solver.stop=6 s", "--rate", "4500 Hz", "--sweep", "20 Hz:2000 Hz"]


@pytest.mark.slow
def test_what_is_printed_of_a_diagram(run: Run) -> None:
    found = run("margins", "jeffcott", "--plot", "margins.png")
    assert (found.exit_code, found.stderr) == (0, "written: margins.png\n")
    lines = found.stdout.splitlines()
    assert lines[0].split("  ")[0] == "injected at"
    assert " ".join(lines[1].split()) == (
        "controller.displacement[1] 3.434 10.7 123.5 B no limit no limit 17.1 at 121.9 Hz 0.389 at 121.9 Hz"
    )
    assert lines[4] == (
        "peak sensitivity 3.43 (10.7 dB) at 123.5 Hz, controller.displacement[1]: zone B (ISO 14839-3:2006)"
    )
    assert lines[5] == "all axes together: largest singular value of S 3.43 at 123.5 Hz"
    assert Path("margins.png").stat().st_size > 10_000


def test_numbers_of_a_diagram(run: Run) -> None:
    found = run("margins", "jeffcott", "--set", "controller.KD=4", "--at", "controller.current", "--json")
    data = json.loads(found.stdout)
    truth = margins(load("jeffcott"), "controller.current", parameters={"controller.KD": 4.0})
    assert data["zone"] == truth.zone
    assert data["axes"][0]["peak"] == pytest.approx(truth.peak, rel=1e-12)
    assert data["axes"][0]["gain_up"] == "infinity"  # no limit, and known: JSON has no number for it
    assert data["axes"][0]["gain_up_frequency"] is None
    assert data["speed"] == pytest.approx(1500 * math.pi / 30)
    assert data["sensitivity"]["controller.current[1]"][3] == [
        truth.sensitivity[3, 0, 0].real,
        truth.sensitivity[3, 0, 0].imag,
    ]


def test_a_loop_that_is_not_stable(run: Run) -> None:
    found = run("margins", "jeffcott", "--set", "controller.KD=-10")
    assert found.exit_code == 0
    assert found.stdout.splitlines()[-1] == (
        "the closed loop is unstable: a sensitivity cannot be measured, zone D (ISO 14839-3:2006)"
    )


@pytest.mark.slow
def test_a_recorded_sweep_beside_its_diagram(run: Run) -> None:
    assert run(*RECORD, *SHORT, "--noise", "1 %").exit_code == 0
    assert run("check", "jeffcott", "swept").stdout.splitlines()[1] == (
        "swept: injection at 2 axes, 2 runs, no mistakes"
    )
    assert run("check", "jeffcott", "swept").stderr == ""
    found = run("margins", "swept", "--beside", "jeffcott", "--plot", "margins.png")
    assert found.exit_code == 0
    lines = found.stdout.splitlines()
    assert lines[0] == "run01, run02: 1500 rpm"
    assert lines[3].split()[:6] == ["jeffcott", "3.434", "10.7", "123.5", "B", "no"]
    assert lines[7].endswith("zone B (ISO 14839-3:2006)")
    data = json.loads(run("margins", "swept", "--run", "run01", "--beside", "jeffcott", "--json").stdout)
    [condition] = data["conditions"]
    [axis] = condition["axes"]
    assert (condition["runs"], axis["name"], axis["zones"]) == (["run01"], "controller.displacement[1]", ["B"])
    low, high = axis["interval90"]["peak"]
    truth = condition["modelled"]["axes"][0]["peak"]
    assert low - (high - low) < truth < high + (high - low)
    assert axis["phase"] == pytest.approx(condition["modelled"]["axes"][0]["phase"], rel=0.05)


@pytest.mark.slow
def test_a_sweep_at_the_output_of_a_controller(run: Run) -> None:
    arguments = ["record", "jeffcott", "--inject", "controller.current", "--amplitude", "20 mA", "--out", "swept"]
    assert run(*arguments, *SHORT).exit_code == 0
    data = json.loads(run("margins", "swept", "--run", "run02", "--json").stdout)
    [axis] = data["conditions"][0]["axes"]
    assert axis["name"] == "controller.current[2]"
    assert axis["peak"] == pytest.approx(margins(load("jeffcott"), "controller.current").peak, rel=0.01)


@pytest.mark.slow
def test_gains_and_speeds_are_conditions_of_their_own(run: Run) -> None:
    gains = ["--gains", "controller.KD=3", "--gains", "controller.KD=6", "--speeds", "1200 rpm"]
    assert run(*RECORD, *SHORT, *gains).exit_code == 0
    found = run("margins", "swept", "--beside", "jeffcott", "--json")
    conditions = json.loads(found.stdout)["conditions"]
    assert [one["set"] for one in conditions] == [{"controller.KD": 3}, {"controller.KD": 6}]
    for one in conditions:
        assert one["axes"][0]["peak"] == pytest.approx(one["modelled"]["axes"][0]["peak"], rel=0.02)
    refused = run("margins", "swept", "--plot", "margins.png")
    assert (refused.exit_code, refused.stderr.partition("error: ")[2]) == (
        2,
        "--plot draws one condition, swept has 2\n\nhint: --run run01, for example\n",
    )


def test_blocks_that_are_cut_are_cut_from_what_is_injected(run: Run) -> None:
    """FAULT of an earlier version: --without was taken with --inject, and did nothing."""
    for folder, cut in (("with", []), ("without", ["--without", "unbalance", "--without", "crack"])):
        assert run(*RECORD[:-1], folder, *SHORT, *cut).exit_code == 0
    moving, still = (np.load(f"{folder}/run01.npz")["injection_before.output[2]"] for folder in ("with", "without"))
    assert np.ptp(still) < 0.01 * np.ptp(moving)


@pytest.mark.slow
def test_an_entry_that_a_diagram_has_not(run: Run) -> None:
    assert run(*RECORD, *SHORT).exit_code == 0
    file = Path("swept/recording.json")
    document = json.loads(file.read_text())
    for channel in document["channels"].values():
        if channel.pop("axis") == "y":
            channel["signal"] += "[9]"
        else:
            channel["signal"] += "[1]"
    file.write_text(json.dumps(document))
    found = run("check", "jeffcott", "swept")
    assert found.exit_code == 2
    assert "controller.displacement[9]: error: no such entry" in found.stderr or (
        "error: controller.displacement[9]: no such entry" in found.stderr
    )
    found = run("margins", "swept", "--beside", "jeffcott")
    assert (found.exit_code, found.stderr.splitlines()[0]) == (
        2,
        "error: --beside jeffcott: jeffcott has no controller.displacement[9]",
    )


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["jeffcott", "--run", "run01"], "jeffcott: --run and --beside need a recording, not a diagram\n"),
        (
            ["rlc"],
            "rlc: no controller with a wired input 'displacement'\n\nhint: name the ports of its bearing loops: where "
            "a sensor's signal arrives, or the output of a controller\n",
        ),
        (["jeffcott", "--at", "controler.current"], "controler: no such block\n\nhint: did you mean 'controller'?\n"),
        (["no_such"], None),
    ],
)
def test_what_is_refused(run: Run, arguments: list[str], text: str | None) -> None:
    found = run("margins", *arguments)
    assert found.exit_code == 2
    if text is not None:
        assert found.stderr == f"error: {text}"
    assert "Traceback" not in found.output


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (["--settle"], "--inject records its loops alone: no --signal, --settle, --hold-out\n"),
        (["--sweep", "20 Hz"], "--sweep 20 Hz: not LOW:HIGH\n\nhint: for example --sweep '5 Hz:2000 Hz'\n"),
        (
            ["--rate", "2 kHz"],
            "--sweep 5 Hz:2000 Hz: samples of 2000 Hz do not show it\n\n"
            "hint: --sweep '5 Hz:900 Hz', or a higher --rate\n",
        ),
        (["--amplitude", "-1 um"], "--amplitude -1 um: not above zero\n"),
        (["--amplitude", "1 A"], None),
        (["--inject", "controller.nothing"], None),
    ],
)
def test_what_is_refused_of_a_sweep(run: Run, more: list[str], text: str | None) -> None:
    found = run(*RECORD, *more)
    assert found.exit_code == 2
    assert "Traceback" not in found.output
    if text is not None:
        assert found.stderr == f"error: {text}"
    assert not Path("swept").exists()
