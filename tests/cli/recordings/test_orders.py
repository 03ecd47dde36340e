"""The verb ``orders``."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rotorsim import accept, load_orders
from rotorsim.cli.recordings.orders import PHASE_WORDS
from rotorsim.recordings.order_writing import save_orders
from rotorsim.recordings.orders import PHASES, OrderRecording
from rotorsim.signals.orders.extraction import tracked_recording
from rotorsim.signals.orders.resonance import peak_of
from tests.cli.conftest import Run
from tests.signals.orders.machine import Mode, run_up

QUICK = [
    "--set=acceleration=300 rad/s^2",
    "--set=solver.stop=4 s",
    "--set=solver.step=0.05 ms",
    "--set=solver.record_every=4",
]


@cache
def tracked() -> OrderRecording:
    return tracked_recording(run_up([Mode(300.0, 0.03, 2e-5, -2e-5j)], 60.0, 500.0, 4.0, noise=2e-8), [1, 2])[0]


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Return the folder of a table of 1X and 2X past one mode at 300 rad/s."""
    save_orders(tmp_path / "table", tracked())
    return tmp_path / "table"


@pytest.mark.slow
def test_the_run_up_of_a_diagram_has_the_critical_speed_of_its_poles(run: Run) -> None:
    """m s^3 + (c + k_i K_D) s^2 + (k - k_s + k_i K_P) s + k_i K_I = 0, and the peak of that pair of poles."""
    found = run("orders", "jeffcott_runup", *QUICK, "--order", "1", "--json")
    assert found.exit_code == 0, found.output
    [critical] = json.loads(found.stdout)["critical_speeds"]
    [one] = critical["found"]
    k, ks, ki, KP, KI, KD = 7.6e5, 105210.0, 42.1, 12200.0, 2000.0, 3.0
    s = max(np.roots([2.0, 76.0 + ki * KD, k - ks + ki * KP, ki * KI]), key=lambda root: root.imag)
    truth = peak_of(abs(s), -s.real / abs(s))
    assert one["speed"] == pytest.approx(truth.speed, rel=1e-4)
    assert one["amplification"] == pytest.approx(truth.amplification, rel=1e-3)
    assert one["whirl"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_what_is_printed(run: Run, table: Path) -> None:
    found = run("orders", str(table), "--operating", "3600 rpm:4200 rpm", "--signal", "rotor.displacement[1]")
    assert found.exit_code == 0
    lines = found.stdout.splitlines()
    assert lines[0] == "up: run-up, 623.5 to 4764.7 rpm, 178 rows of 1 turn"
    assert lines[2].split() == ["as", "recorded", "largest,", "0-peak", "at", "[rpm]", "N1", "N2", "AF"]
    assert lines[3].startswith("1X of rotor.displacement[1] ")
    assert lines[6].split()[:4] == ["1X:", "N_c", "[rpm],", "90"]
    assert lines[6].split()[-2:] == ["SM", "required"]
    assert lines[7].split()[-5:] == ["20.4", "%", "15.9", "%", "met"]
    assert lines[-1] == "2X: no critical speed between 623.5 and 4764.7 rpm"


@pytest.mark.slow
def test_a_margin_that_the_intervals_leave_open_is_unsure(run: Run, table: Path) -> None:
    """AF is 16.7 at a damping ratio of 0.03, which asks for 17 (1 - 1 / 15.2) = 15.9 %."""
    found = json.loads(run("orders", str(table), "--order", "1", "--json").stdout)
    [one] = found["critical_speeds"][0]["found"]
    needed = 17 * (1 - 1 / (one["amplification"] - 1.5))
    for share, verdict in ((needed - 0.2, "not met"), (needed, "unsure"), (needed + 0.2, "met")):
        lowest = one["speed"] / (1 - share / 100)
        again = run("orders", str(table), "--order", "1", "--json", "--operating", f"{lowest!r}:{2 * lowest!r}")
        margin = json.loads(again.stdout)["critical_speeds"][0]["found"][0]["separation_margin"]
        assert margin["verdict"] == verdict
        assert margin["actual"] == pytest.approx(share)
        assert margin["required"] == pytest.approx(15.9, abs=0.1)


def test_a_probe_that_shows_nothing_in_a_table_is_left_out(run: Run, table: Path, tmp_path: Path) -> None:
    """FAULT: of samples a dead probe was told of, of a table it was one more channel of the machine."""
    folder = tmp_path / "dead"
    shutil.copytree(table, folder)
    document = json.loads((folder / "recording.json").read_text())
    first = next(iter(document["channels"]))
    file = folder / document["runs"][0]["file"]
    head, *rows = file.read_text().splitlines()
    names = head.split(",")
    for name in (document["channels"][first]["amplitude"], document["channels"][first]["phase"]):
        rows = [",".join("0" if names[k] == name else one for k, one in enumerate(row.split(","))) for row in rows]
    file.write_text("\n".join([head, *rows]) + "\n")
    found = run("orders", str(folder), "--order", "1")
    assert f"up: column {first}: constant signal: all 178 vectors are the same\n" in found.stderr
    assert "1X of rotor.displacement[1]" not in found.stdout
    assert "constant signal: all 178 vectors are the same" in run("check", str(folder)).output
    [part] = accept(None, load_orders(folder), operating=(377.0, 440.0)).parts
    [passed] = part.results
    assert first not in passed.channels
    assert np.isnan(passed.found.found[0].whirl)


@pytest.mark.slow
@pytest.mark.parametrize("figure", ["bode", "polar", "cascade", "centreline"])
def test_figures_are_drawn(run: Run, figure: str) -> None:
    found = run("orders", "jeffcott_runup", *QUICK, "--order", "1", "--figure", figure, "--plot", "a.png")
    assert found.exit_code == 0, found.output
    assert Path("a.png").stat().st_size > 10_000


def test_words_of_the_command_are_those_of_the_tables() -> None:
    assert tuple(PHASES) == PHASE_WORDS


@pytest.mark.slow
def test_a_figure_has_one_unit_and_says_what_it_leaves_out(run: Run) -> None:
    mixed = ("--signal", "rotor.displacement", "--signal", "controller.current")
    found = run("orders", "jeffcott_runup", *QUICK, "--order", "1", *mixed, "--plot", "a.png")
    assert found.exit_code == 2
    assert "error: jeffcott_runup, run: --figure bode has one scale, not A and m\n" in found.stderr


@pytest.mark.slow
def test_what_is_coupled_for_ac_has_no_centreline(run: Run, tmp_path: Path) -> None:
    record = ("record", "jeffcott_runup", *QUICK, "--window", "0.2 s:3.4 s", "--rate", "5000 Hz", "--out", "up")
    assert run(*record).exit_code == 0
    file = tmp_path / "up" / "recording.json"
    document = json.loads(file.read_text())
    document["channels"]["x"]["coupling"] = "ac"
    file.write_text(json.dumps(document))
    found = run("orders", "up", "--order", "1", "--figure", "centreline", "--plot", "a.png")
    assert found.exit_code == 2
    assert 'needs means, and x have none: "coupling": "ac"' in found.stderr


@pytest.mark.slow
def test_a_diagram_stands_beside_a_table(run: Run, table: Path) -> None:
    found = run("orders", str(table), "--order", "1", "--beside", "jeffcott", "--plot", "a.png")
    assert found.exit_code == 0, found.output
    assert Path("a.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_table_is_written_and_read_back(run: Run, table: Path) -> None:
    found = run("orders", str(table), "--slow-roll", "600 rpm:800 rpm", "--out", "b", "--amplitude", "peak-peak")
    assert found.exit_code == 0
    assert found.stderr == f"written: {Path('b', 'recording.json')}\n"
    document = json.loads(Path("b/recording.json").read_text())
    assert (document["amplitude"], document["slow_roll"]) == ("peak-peak", "subtracted")
    again = run("orders", "b", "--slow-roll", "600 rpm:800 rpm")
    assert again.exit_code == 2
    assert "slow roll was subtracted already" in again.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--order", "7"), 2, "error: machine: no channel of order 7\n\nhint: there: 1X, 2X\n"),
        (("--run", "dwon"), 2, "error: --run dwon: no such run in machine\n"),
        (("--signal", "rotor.x"), 2, "error: --signal rotor.x: not measured in machine\n"),
        (("--turns", "4"), 2, "error: machine: turns: the rows of this table are as they were exported\n"),
        (("--operating", "5 m"), 2, "error: --operating 5 m: unit 'm' does not fit 'rad/s'\n"),
        (
            ("--operating", "9 rpm:5 rpm"),
            2,
            "error: --operating 9 rpm:5 rpm: not LOW:HIGH\n\nhint: for example --operating '3000 rpm:3600 rpm'\n",
        ),
        (
            ("--operating", "0 rpm"),
            2,
            "error: --operating 0 rpm: a shaft that does not turn\n\n"
            "hint: for example --operating '3000 rpm:3600 rpm'\n",
        ),
        (("--set", "a=1"), 2, "--set and --without need a diagram, not a recording"),
        (
            ("--figure", "cascade", "--plot", "a.png"),
            2,
            "error: machine, up: --figure cascade needs samples: these are order vectors\n\n"
            "hint: bode and polar are drawn of tables\n",
        ),
        (("--slow-roll", "1 rpm:5 rpm"), 1, "error: run up: no row between 1 and 5 rpm: slow roll is not known\n"),
    ],
)
def test_what_is_refused(run: Run, table: Path, arguments: tuple[str, ...], code: int, said: str) -> None:
    found = run("orders", str(table), *arguments)
    assert found.exit_code == code
    assert said in found.stderr


def test_a_diagram_at_one_speed_is_refused(run: Run) -> None:
    found = run("orders", "jeffcott", "--set", "solver.stop=0.1 s")
    assert found.exit_code == 1
    assert found.stderr == (
        "error: jeffcott: no run changes its speed\n\nhint: rotorsim spectrum shows harmonics of runs at one speed\n"
    )


def test_a_table_at_one_speed_is_refused(run: Run, table: Path) -> None:
    """FAULT: it ended with a division by zero."""
    _changed(table, lambda columns: columns.update(rpm=0 * columns["rpm"] + 3000))
    found = run("orders", str(table), "--order", "1")
    assert found.exit_code == 1
    assert "error: run up: its speed does not change\n" in found.stderr


@pytest.mark.slow
def test_what_a_run_has_not_passed_is_not_judged(run: Run, table: Path) -> None:
    """FAULT: a run that ended before the operating speeds said "no critical speed"."""
    found = run("orders", str(table), "--order", "1", "--operating", "5000 rpm:5500 rpm", "--json")
    [critical] = json.loads(found.stdout)["critical_speeds"]
    [(first, last)] = critical["not_passed"]
    assert first == pytest.approx(500.0, rel=0.01)
    assert last == pytest.approx(1.26 * 5500 * np.pi / 30)
    said = run("orders", str(table), "--order", "1", "--operating", "5000 rpm:5500 rpm").stdout.splitlines()[-1]
    assert said.startswith("not judged: 47")
    assert said.endswith(" to 6930 rpm, where a critical speed might be too near: the run does not pass there")


@pytest.mark.slow
def test_motion_is_no_slow_roll(run: Run, table: Path) -> None:
    """FAULT: the vector of a resonance was subtracted without a word; where little moves nothing is said."""
    found = run("orders", str(table), "--order", "1", "--slow-roll", "2500 rpm:3200 rpm")
    what = "x 1X changes by more than its mean between 2500 and 3200 rpm\n\nhint: the shaft moves there"
    assert what in found.stderr
    quiet = run("orders", str(table), "--order", "1", "--slow-roll", "600 rpm:700 rpm")
    assert "changes by more than its mean" not in quiet.stderr


@pytest.mark.slow
def test_the_coast_down_of_a_diagram_begins_settled(run: Run) -> None:
    """FAULT: it began from rest at full speed, rang, and had a damping ratio of 0.092."""
    falls = ["--set=acceleration=-300 rad/s^2", "--set=speed=9000 rpm", "--set=speed_limit=100 rpm"]
    found = run("orders", "jeffcott_runup", "--without", "crack", *QUICK[1:], *falls, "--order", "1", "--json")
    [critical] = json.loads(found.stdout)["critical_speeds"]
    [one] = critical["found"]
    assert one["damping_ratio"] == pytest.approx(0.0661, rel=0.01)
    assert one["speed"] * 30 / np.pi == pytest.approx(7330.9, rel=1e-3)


@pytest.mark.slow
def test_long_rows_invent_no_critical_speed(run: Run) -> None:
    """FAULT: of rows of three turns on a quick run-up four critical speeds were told, of a machine with one."""
    found = run("orders", "jeffcott_runup", "--without", "crack", *QUICK, "--order", "1", "--turns", "4", "--json")
    assert "critical speeds are told from rows of one turn" in found.stderr
    data = json.loads(found.stdout)
    assert [run["turns"] for run in data["runs"].values()] == [4]
    assert [one["speed"] for one in data["critical_speeds"][0]["found"]] == pytest.approx([767.7], rel=1e-3)


def _changed(folder: Path, change: Callable[[dict[str, np.ndarray]], object]) -> None:
    """Change the columns of the table in a folder."""
    with (folder / "up.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    change(columns)
    np.savetxt(
        folder / "up.csv",
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(f'"{name}"' for name in columns),
        comments="",
    )


@pytest.mark.slow
def test_motion_that_is_none_of_linear_modes_is_said_and_exits_with_one(run: Run, table: Path) -> None:
    def wavy(columns: dict[str, np.ndarray]) -> None:
        for axis in "xy":
            columns[f"{axis} 1X phase"][:] = 40 * np.cos(columns["rpm"] / 80)
            columns[f"{axis} 1X amplitude"][:] = 1e-5 * (1 + 0.3 * np.sin(columns["rpm"] / 60))

    _changed(table, wavy)
    found = run("orders", str(table), "--order", "1")
    assert found.exit_code == 1
    assert "1X: no critical speed is told between 623.5 and 4764.7 rpm: linear modes leave " in found.stdout
    assert "error: up, 1X: the motion is not that of linear modes, and no critical speed is told" in found.stderr


@pytest.mark.slow
def test_a_speed_that_rises_and_falls_is_no_run_up(run: Run, table: Path) -> None:
    def mirrored(columns: dict[str, np.ndarray]) -> None:
        for name, values in [*columns.items()]:
            columns[name] = np.concatenate([values, 2 * values[-1] - values[::-1] if name == "t" else values[::-1]])
        columns["t"] = np.maximum.accumulate(columns["t"]) + 1e-6 * np.arange(len(columns["t"]))

    _changed(table, mirrored)
    found = run("orders", str(table), "--order", "1")
    assert found.stdout.startswith("up: speed rises and falls, 623.5 to 4764.7 rpm, 356 rows of 1 turn\n")
    assert found.stdout.splitlines()[3].split()[-3:] == ["-", "-", "-"]


@pytest.mark.slow
def test_rows_that_overlap_are_warned_of(run: Run, table: Path) -> None:
    document = json.loads((table / "recording.json").read_text())
    document["runs"][0]["turns"] = 4
    (table / "recording.json").write_text(json.dumps(document))
    found = run("orders", str(table), "--order", "1")
    assert "warning: run up: rows overlap: each is the mean of 4 turns, and they are 1 turns apart\n" in found.stderr


@pytest.mark.slow
def test_names_that_a_csv_cannot_hold_are_written_plainly_and_read_back(run: Run, tmp_path: Path) -> None:
    recording = run_up([Mode(300.0, 0.03, 2e-5, -2e-5j)], 60.0, 500.0, 4.0, noise=2e-8)
    orders, _ = tracked_recording(recording, [1])
    renamed = {'x, "1" %;=': orders.channels["x 1X"], "y 1X": orders.channels["y 1X"]}
    vectors = dict(zip(renamed, orders.runs[0].vectors.values(), strict=False))
    odd = replace(orders, channels=renamed, runs=(replace(orders.runs[0], vectors=vectors),))
    save_orders(tmp_path / "odd", odd)
    again = load_orders(tmp_path / "odd")
    for name, values in vectors.items():
        assert again.runs[0].vectors[name] == pytest.approx(values, abs=1e-15)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--filter", "60 %"), "--filter 60 %: orders are one apart\n\nhint: at most 50 %\n"),
        (("--filter", "x"), "--filter x: not a width\n\nhint: for example --filter '10 %' or '2 Hz'\n"),
        (("--line", "50 Hz"), "--line needs --filter\n\nhint: for example --filter '10 %'\n"),
        (("--filter", "10 %", "--turns", "2"), "--turns: the filter has its own width, and rows of one turn\n"),
        (("--filter", "10 %"), "machine: a filter needs samples: these are order vectors\n"),
    ],
)
def test_filters_that_are_refused(run: Run, table: Path, arguments: tuple[str, ...], said: str) -> None:
    found = run("orders", str(table), *arguments)
    assert (found.exit_code, found.stderr) == (2, f"error: {said}")


def test_a_filter_shows_vectors_and_tells_no_critical_speed(run: Run) -> None:
    found = run("orders", "jeffcott_runup", *QUICK, "--order", "1", "--filter", "30 %")
    assert found.exit_code == 0
    assert "critical speeds are told without --filter" in found.stderr
    assert "N_c" not in found.stdout
    data = json.loads(run("orders", "jeffcott_runup", *QUICK, "--order", "1", "--filter", "30 %", "--json").stdout)
    assert data["critical_speeds"] == []
