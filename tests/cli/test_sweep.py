"""The verb ``sweep``."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from rotorsim.cli.shared.variations import variations
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from tests.cli.conftest import Run
from tests.systems.shipped import DIAGRAMS

SHORT = ("--stop", "0.2 s")


def test_a_table_of_runs(run: Run) -> None:
    found = run("sweep", "jeffcott", "--vary", "speed=1200 rpm:300 rpm:1800 rpm", *SHORT, "--out", "a.csv")
    assert found.exit_code == 0
    assert found.stdout.splitlines()[0].split() == ["peak", "least", "median", "largest", "unit", "largest", "at"]
    assert found.stdout.splitlines()[1].startswith("rotor.displacement[1] ")
    assert found.stdout.splitlines()[1].endswith("um  speed = 1800 rpm")
    assert "clock.theta" not in found.stdout
    assert found.stderr.startswith("written: a.csv\njeffcott: 3 runs (speed 1200 to 1800 rpm), ")
    assert found.stderr.endswith("reduced over 0.1 to 0.2 s\n")
    rows = list(csv.DictReader(Path("a.csv").read_text().splitlines()))
    assert [float(row["speed [rad/s]"]) for row in rows] == pytest.approx(np.array([1200, 1500, 1800]) * np.pi / 30)


def test_one_run_is_that_of_run(run: Run) -> None:
    """The same diagram, values and options: the same peak, to the last digit."""
    swept = json.loads(
        run("sweep", "jeffcott", "--vary", "speed=1800 rpm", "--window", "0:0.2", *SHORT, "--json").stdout
    )
    alone = json.loads(run("run", "jeffcott", "--set", "speed=1800 rpm", *SHORT, "--json").stdout)
    assert [swept["runs"][0][f"peak rotor.displacement[{k}]"] for k in (1, 2)] == alone["signals"][
        "rotor.displacement"
    ]["peak"]


def test_an_entry_of_a_parameter_varies_and_the_others_stay(run: Run) -> None:
    window = ("--window", "0:0.2", "--json")
    swept = run("sweep", "jeffcott", "--vary", "rotor.initial_displacement[2]=0, 10 um", *SHORT, *window)
    for row, start in zip(json.loads(swept.stdout)["runs"], ("[0, 0]", "[0, 1e-5]"), strict=True):
        alone = json.loads(
            run("run", "jeffcott", "--set", f"rotor.initial_displacement={start}", *SHORT, "--json").stdout
        )
        own = [row[f"peak rotor.displacement[{k}]"] for k in (1, 2)]
        assert own == alone["signals"]["rotor.displacement"]["peak"]
    assert "(rotor.initial_displacement[2] 0 to 10 um)" in swept.stderr


@pytest.mark.parametrize("verb", ["sweep", "modes"])
@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("support.stiffness[3]", "no such entry; the parameter is 2, counted from 1"),
        ("support.stiffness[1,1]", "no such entry; the parameter is 2, counted from 1"),
        ("speed[1]", "no such entry; the parameter is a single number, counted from 1"),
        ("support.stifness[1]", "no such parameter\n\nhint: did you mean 'support.stiffness'?"),
    ],
)
def test_an_entry_that_is_not_there_is_refused(run: Run, verb: str, name: str, what: str) -> None:
    found = run(verb, "rk4_first_mode", "--vary", f"{name}=1, 2")
    assert (found.exit_code, found.stderr) == (2, f"error: {name}: {what}\n")


def test_runs_that_do_not_finish(run: Run) -> None:
    found = run("sweep", "jeffcott", "--vary", "controller.KP=12200, -20000", *SHORT)
    assert found.exit_code == 1
    assert (
        "error: jeffcott: 1 of 2 runs unstable; the first, controller.KP = -20000 A/m: the machine is unstable: "
        in found.stderr
    )
    assert found.stderr.endswith("hint: the table says which: --out FILE.csv\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "title"),
    [
        (("--vary", "speed=1200 rpm:150 rpm:1800 rpm"), "curve"),
        (("--vary", "speed=1200 rpm:150 rpm:1800 rpm", "--vary", "controller.KP=1e4, 1.2e4"), "map"),
        (
            ("--vary", "speed=1200 rpm:300 rpm:1800 rpm", "--vary", "rotor.mass=normal(2 kg, 3 %)", "--draws", "9"),
            "band",
        ),
        (("--vary", "rotor.mass=uniform(1.9, 2.1)", "--draws", "20"), "band"),
        (("--vary", "speed=1200 rpm:150 rpm:1800 rpm", "--figure", "bifurcation"), "bifurcation"),
        (("--vary", "speed=1200 rpm:150 rpm:1800 rpm", "--figure", "cascade"), "cascade"),
    ],
)
def test_figures(run: Run, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], title: str) -> None:
    drawn: list[str] = []
    import rotorsim.report.figures.ensemble as figures

    for name, draw in dict(figures.DRAWING).items():
        monkeypatch.setitem(
            figures.DRAWING,
            name,
            lambda *a, draw=draw, name=name: (drawn.append(name), draw(*a))[1],  # type: ignore
        )
    found = run("sweep", "jeffcott", *arguments, *SHORT, "--plot", "a.png")
    assert found.exit_code == 0, found.stderr
    assert drawn == [title]
    assert Path("a.png").stat().st_size > 10_000


def test_turns_and_window_in_turns(run: Run) -> None:
    found = run(
        "sweep", "jeffcott", "--vary", "speed=1200 rpm, 1800 rpm", "--turns", "6", "--window", "2 turns:6 turns",
        "--reduce", "poincare,last", "--step", "1 ms", "--out", "a.npz",
    )  # fmt: skip
    assert found.exit_code == 0
    assert "poincare: in a file (--out FILE.h5) or a figure (--plot)" in found.stdout
    assert found.stderr.endswith("reduced over the last 67% of every run\n")
    with np.load("a.npz") as kept:
        assert kept["stop"] == pytest.approx(6 * np.array([0.05, 1 / 30]))
        assert np.isfinite(kept["values/poincare/rotor.displacement"][..., 0]).sum(axis=1).tolist() in ([4, 4], [5, 5])


REFUSED = {
    (): 'error: nothing varies\n\nhint: for example --vary "speed=600 rpm:10 rpm:6000 rpm"\n',
    ("--vary", "speed"): "error: --vary speed: not NAME=VALUES\n\nhint: --vary 'speed=600 rpm:10 rpm:6000 rpm' ",
    ("--vary", "speed=1:2"): "error: --vary speed=1:2: 2 parts, 3 expected\n",
    ("--vary", "speed=1:-1:3"): "error: --vary speed=1:-1:3: no step leads there\n",
    ("--vary", "speed=1:0:3"): "error: --vary speed=1:0:3: no step leads there\n",
    ("--vary", "speed=1 kg"): "error: --vary speed=1 kg: unit 'kg' does not fit 'rad/s'\n",
    ("--vary", "speed=a"): "error: --vary speed=a: ",
    ("--vary", "sped=1"): "error: sped: no such parameter\n\nhint: did you mean 'speed'?\n",
    ("--vary", "speed=normal(1)"): "error: --vary speed=normal(1): normal takes two numbers, 1 given\n",
    ("--vary", "speed=normal(1, 0)"): "error: --vary speed=normal(1, 0): the standard deviation must be positive\n",
    (
        "--vary",
        "speed=uniform(2, 1)",
    ): "error: --vary speed=uniform(2, 1): the second number must be larger than the first\n",
    ("--vary", "speed=1, 2", "--draws", "3"): "error: --draws needs a distribution\n",
    ("--vary", "speed=1, 2", "--vary", "speed=3"): "error: --vary speed=3: 'speed' is varied twice\n",
    ("--vary", "speed=0:1e-6:1000"): "error: --vary speed=0:1e-6:1000: more than 1000000 values\n",
    ("--vary", "speed=0:0.01:1000", "--vary", "rotor.mass=1:0.01:3"): "error: 20100201 runs; at most 1000000\n",
    ("--vary", "speed=1, 2", "--stop", "1", "--turns", "3"): "error: --stop and --turns exclude each other\n",
    ("--vary", "speed=1, 2", "--figure", "map"): "error: --figure needs --plot FILE\n",
    ("--vary", "speed=1, 2", "--window", "3:1"): "error: --window 3:1: not START:STOP\n",
    ("--vary", "speed=90, 99", "--turns", "9", "--window", "3"): "error: --window 3: not START:STOP\n",
    (
        "--vary",
        "speed=90, 99",
        "--reduce",
        "poincare",
        "--out",
        "a.csv",
    ): "a.csv: error: poincare: many numbers for each entry",
    ("--vary", "clock.profile=ramp"): "error: clock.profile: is an option: another value makes other equations",
    (
        "--vary",
        "speed=90, 99",
        "--reduce",
        "peek",
    ): "error: reduce: no reduction 'peek'\n\nhint: did you mean 'peak'?\n",
}


@pytest.mark.parametrize("arguments", REFUSED, ids=" ".join)
def test_what_is_wrong_is_refused(run: Run, arguments: tuple[str, ...]) -> None:
    found = run("sweep", "jeffcott", *arguments)
    assert found.exit_code == 2
    assert found.stderr.startswith(REFUSED[arguments])
    assert found.stdout == ""


def test_all_mistakes_of_variations_at_once(run: Run) -> None:
    found = run("sweep", "jeffcott", "--vary", "speed=a", "--vary", "rotor.mass=1:2", "--vary", "x")
    assert found.stderr.count("error: --vary") == 3


def test_every_combination_with_the_same_draws() -> None:
    texts = ["speed=100, 200", "controller.KP=1e4:1e3:1.2e4", "rotor.mass=normal(2, 0.1)"]
    found = variations(texts, load("jeffcott"), 4, 7)
    assert (found.grid, found.drawn) == (("speed", "controller.KP"), ("rotor.mass",))
    assert found.runs["speed"].tolist() == [100.0] * 12 + [200.0] * 12
    assert (
        found.runs["controller.KP"].tolist()
        == [1e4] * 4 + [1.1e4] * 4 + [1.2e4] * 4 + [1e4] * 4 + [1.1e4] * 4 + [1.2e4] * 4
    )
    assert np.array_equal(found.runs["rotor.mass"].reshape(6, 4), np.tile(found.runs["rotor.mass"][:4], (6, 1)))
    again = variations(texts, load("jeffcott"), 4, 7).runs["rotor.mass"]
    assert np.array_equal(again, found.runs["rotor.mass"])


def test_draws_have_the_law_that_was_asked_for() -> None:
    texts = ["rotor.mass=normal(2 kg, 5 %)", "controller.KP=uniform(1e4, 2e4)"]
    runs = variations(texts, load("jeffcott"), 20_000, 1).runs
    assert runs["rotor.mass"].mean() == pytest.approx(2.0, abs=4 * 0.1 / np.sqrt(20_000))
    assert runs["rotor.mass"].std() == pytest.approx(0.1, abs=4 * 0.1 / np.sqrt(40_000))
    assert runs["controller.KP"].mean() == pytest.approx(1.5e4, abs=4 * 1e4 / np.sqrt(12 * 20_000))
    assert 1e4 <= runs["controller.KP"].min() < runs["controller.KP"].max() <= 2e4


def test_a_range_includes_its_stop_where_whole_steps_reach_it() -> None:
    runs = variations(["speed=600 rpm:10 rpm:6000 rpm"], load("jeffcott"), None, 1).runs
    assert runs["speed"] == pytest.approx(np.arange(600, 6001, 10) * np.pi / 30)
    with pytest.raises(RotorsimError):
        variations(["speed=2:1:1"], load("jeffcott"), None, 1)


@pytest.mark.parametrize("entry", ["[0]", "[9]", "[x]", "[]", "[1,1]", "[1"])
def test_an_entry_that_is_none_is_said_after_the_table(run: Run, entry: str) -> None:
    found = run(
        "sweep", "jeffcott", "--vary", "speed=90, 99", *SHORT, "--plot", "a.png", "--show", f"rotor.displacement{entry}"
    )
    assert found.exit_code == 2
    assert (
        f"error: rotor.displacement{entry}: no such entry; 'rotor.displacement' has shape 2, counted from 1"
        in found.stderr
    )
    assert found.stdout.startswith("peak")
    assert not Path("a.png").exists()


def test_a_band_of_runs_none_of_which_finished(run: Run) -> None:
    found = run(
        "sweep", "jeffcott", "--vary", "controller.KP=normal(-1e9, 1 %)", "--draws", "5", *SHORT, "--plot", "a.png"
    )
    assert found.exit_code == 2
    assert "5 of 5 runs diverged" in found.stderr
    assert found.stderr.endswith("error: band: no run finished\n")


def test_a_warning_of_runs_that_finished(run: Run) -> None:
    found = run("sweep", "jeffcott", "--vary", "speed=100, 3000", "--stop", "0.2", "--step", "2 ms")
    assert found.exit_code == 0
    assert (
        "warning: jeffcott: 2 of 2 runs finished with a warning; the first, speed = 954.93 rpm: the step 0.002 s is "
        in found.stderr
    )


def test_files_of_blocks_are_not_written_and_that_is_said(run: Run) -> None:
    content = json.loads((DIAGRAMS / "jeffcott.json").read_text())
    content["blocks"]["kept"] = {"type": "to_file", "parameters": {"names": ["displacement"], "file": "kept.csv"}}
    content["wires"].append(["rotor.displacement", "kept.displacement"])
    Path("mine.json").write_text(json.dumps(content))
    found = run("sweep", "mine.json", "--vary", "speed=90, 99", *SHORT)
    assert found.exit_code == 0, found.stderr
    assert "warning: kept: its file is not written: it would be that of one run alone" in found.stderr
    assert not Path("kept.csv").exists()
