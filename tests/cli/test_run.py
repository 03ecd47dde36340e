"""``rotorsim run`` and ``spectrum``: numbers, files, exit codes."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from rotorsim.cli.simulations import run as run_verb
from tests.reference.published import TABLE_2_2


def test_run_solves_the_decay(run, oscillator) -> None:
    result = run("run", str(oscillator), "--json")
    data = json.loads(result.stdout)
    assert result.exit_code == 0
    assert data["status"] == "finished"
    assert data["signals"]["state.output"]["final"] == pytest.approx(math.exp(-1.0), rel=1e-9)  # RK4: h^4/120 = 1e-10


def test_settings_and_solver(run, oscillator) -> None:
    arguments = ["run", str(oscillator), "--set", "rate.gain=-2", "--stop", "500 ms", "--solver", "dop853", "--json"]
    data = json.loads(run(*arguments).stdout)
    assert data["signals"]["state.output"]["final"] == pytest.approx(math.exp(-1.0), rel=1e-7)  # rtol of the solver
    assert data["provenance"]["method"] == "dop853"


def test_run_says_which_path_it_took(run, oscillator) -> None:
    assert "CasADi virtual machine" in run("run", str(oscillator), "--no-compiler").stderr
    assert run("run", str(oscillator)).stderr.startswith("decay: 100 rk4 steps to 1 s, ")


def test_table_2_2_by_one_command(run) -> None:
    data = json.loads(run("run", "jeffcott", "--json").stdout)
    for signal, column in (("rotor.displacement", 0), ("controller.current", 2)):
        found = data["harmonics"][signal]
        for order, real, imag in zip(found["orders"], found["real"], found["imag"], strict=True):
            amplitude, phase = TABLE_2_2[order][column : column + 2]
            assert math.hypot(real, imag) == pytest.approx(amplitude, rel=2e-3)
            assert math.degrees(math.atan2(imag, real)) == pytest.approx(phase, abs=0.1)


def test_text_of_a_run(run) -> None:
    lines = run("run", "jeffcott").stdout.splitlines()
    assert lines[0].split() == ["signal", "peak", "rms", "unit"]
    assert lines[1].split()[0] == "rotor.displacement[1]"
    assert "rotor.displacement" in lines
    first = lines.index("rotor.displacement") + 3
    assert lines[first].split() == ["1", "3.17825", "7.97"]


@pytest.mark.slow
def test_a_run_up_names_its_resonance(run) -> None:
    data = json.loads(run("run", "jeffcott_runup", "--json").stdout)
    found = {row["signal"]: row["resonance_rpm"] for row in data["run_up"]}
    assert found["rotor.displacement[1]"] == pytest.approx(7298, rel=0.01)
    assert data["harmonics"] == {}


@pytest.mark.parametrize("suffix", [".csv", ".h5", ".npz"])
def test_results_are_written_and_read_back(run, suffix: str) -> None:
    assert run("run", "jeffcott", "--stop", "0.2 s", "--out", f"r{suffix}").exit_code == 0
    one = run("spectrum", f"r{suffix}", "--json")
    other = run("spectrum", "jeffcott", "--set", "solver.stop=0.2", "--json")
    assert (one.exit_code, other.exit_code) == (0, 0)
    assert json.loads(one.stdout) == json.loads(other.stdout)


def test_csv_has_the_layout_of_fmpy(run) -> None:
    run("run", "jeffcott", "--stop", "1 ms", "--out", "r.csv", "--record", "amb.force")
    with Path("r.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows[0][:3] == ["time", "rotor.displacement[1]", "rotor.displacement[2]"]
    assert rows[0][-2:] == ["amb.force[1]", "amb.force[2]"]
    assert len(rows) == 12


def test_only_what_the_diagram_records_is_written(run) -> None:
    run("run", "jeffcott_runup", "--stop", "1 ms", "--set", "solver.record_every=1", "--out", "r.csv")
    header = Path("r.csv").read_text().splitlines()[0]
    assert "reference" not in header
    assert set(Path().iterdir()) == {Path("r.csv"), Path("r.csv.meta.json")}


@pytest.mark.slow
def test_plot(run) -> None:
    assert run("run", "jeffcott", "--stop", "0.2", "--plot", "a.png").exit_code == 0
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--plot", "x.gif"], "error: --plot x.gif: unknown format '.gif'\n\nhint: one of .png, .svg, .pdf\n"),
        (["--out", "no/x.csv"], "error: --out no/x.csv: folder no does not exist\n\nhint: create it first\n"),
        (["--set", "KP"], "error: --set KP: not NAME=VALUE\n\nhint: for example --set controller.KP=14000\n"),
        (["--stop", "5 m"], "error: --stop 5 m: unit 'm' does not fit 's'\n\nhint: give it in s\n"),
        (["--without", "crak"], "--without: error: crak: no block 'crak'\n\nhint: did you mean 'crack'?\n"),
        (
            ["--set", "controler.KP=1"],
            "--set: error: controler: no block 'controler'\n\nhint: did you mean 'controller'?\n",
        ),
        (
            ["--record", "rotor.displacment"],
            "error: rotor.displacment: no such signal\n\nhint: did you mean 'rotor.displacement'?\n",
        ),
        (
            ["--solver", "euler"],
            "error: invalid value for '--solver': 'euler' is not one of 'rk4', 'dop853', 'rk45', 'radau', 'bdf', "
            "'lsoda'\n\nhint: 'rotorsim run --help' shows how it is used\n",
        ),
    ],
)
def test_wrong_arguments(run, arguments, text) -> None:
    result = run("run", "jeffcott", *arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == text


def test_a_diverging_run_keeps_what_was_computed(run, oscillator) -> None:
    result = run("run", str(oscillator), "--set", "rate.gain=2000", "--out", "part.npz")
    assert result.exit_code == 1
    assert "error: decay: diverged at t = " in result.stderr
    assert "block 'state'" in result.stderr
    assert result.stderr.endswith(
        "hint: what was computed until then is in part.npz; 'rotorsim modes' shows which modes grow\n"
    )
    signal = np.load("part.npz")["signals/state.output"]
    assert len(signal) > 3
    assert np.isfinite(signal).all()


def test_an_unstable_machine_ends_with_exit_code_1_and_its_pole(run) -> None:
    result = run("run", "jeffcott", "--set", "controller.KD=-5", "--stop", "0.5 s", "--json", "--out", "x.npz")
    data = json.loads(result.stdout)
    assert (result.exit_code, data["status"], data["harmonics"]) == (1, "unstable", {})
    what = (
        "the machine is unstable: a pole at 121.5 Hz, damping ratio -0.044, grows at 33.66 1/s, most of it in the "
        "states of 'rotor'; 1 more grows"
    )
    assert data["message"] == what
    assert result.stderr.endswith(
        f"error: jeffcott: {what}\n\nhint: what was computed is in x.npz; 'rotorsim modes' shows which modes grow\n"
    )
    assert len(np.load("x.npz")["time"]) == 5001
    spectrum = run("spectrum", "x.npz")
    assert (spectrum.exit_code, spectrum.stdout) == (1, "")


def test_a_step_beyond_the_limit_ends_with_exit_code_1_and_the_limit(run) -> None:
    result = run("run", "jeffcott", "--step", "1 s")
    assert result.exit_code == 1
    assert result.stderr.endswith(
        "error: jeffcott: the step 1 s is too large: RK4 is stable here up to 0.00382 s\n\n"
        "hint: a smaller --step, or --solver dop853 or radau, which choose their own; --out FILE keeps what was "
        "computed until then\n"
    )


def test_a_coarse_step_is_warned_of(run) -> None:
    result = run("run", "jeffcott", "--step", "3 ms", "--json")
    data = json.loads(result.stdout)
    assert (result.exit_code, data["status"]) == (0, "finished")
    assert data["counters"]["step_error"] == pytest.approx(0.252, abs=0.01)
    assert (
        "warning: jeffcott: the step 0.003 s is too large: 'rotor.displacement' is wrong by about 25 % "
        in result.stderr
    )
    assert result.stderr.endswith("\n\nhint: a smaller --step, or --solver dop853 or radau, which choose their own\n")
    assert "warning" not in run("run", "jeffcott", "--step", "0.2 ms").stderr


@pytest.mark.slow
def test_run_says_speed_window_and_whether_the_motion_has_settled(run) -> None:
    # the pole of the integral action, -0.0721 1/s, has 70 % of its way still to go after 5 s
    data = json.loads(run("run", "jeffcott", "--json").stdout)["motion"]
    assert data["speed_rpm"] == pytest.approx(1500, rel=1e-9)
    assert data["window"] == pytest.approx([4.0, 5.0])
    assert (data["turns"], data["settled"]) == (25, False)
    change = data["still_changes"]
    assert (change["signal"], change["order"]) == ("controller.current", 0)
    settled = json.loads(run("periodic", "jeffcott", "--json").stdout)
    middle = settled["orders"].index(0)
    final = settled["harmonics"]["controller.current"]["real"][0][middle]
    now = json.loads(run("run", "jeffcott", "--json").stdout)["harmonics"]["controller.current"]["real"][0]
    assert change["left"] == pytest.approx(final - now, rel=0.05)
    # the integral action has hardly begun after 0.2 s: 26 mA are to come, as the pole says
    short = json.loads(run("run", "jeffcott", "--stop", "0.2 s", "--json").stdout)["motion"]
    assert short["still_changes"]["left"] == pytest.approx(change["left"] * np.exp(0.0721 * (4.5 - 0.18)), rel=0.02)
    slow = json.loads(run("run", "jeffcott", "--set", "controller.KI=20", "--json").stdout)["motion"]
    assert slow["settled"] is False  # the pole is at -0.00072 1/s: nothing moves, and nearly all is still to come
    backward = run("run", "jeffcott", "--set", "speed=-1500 rpm", "--stop", "0.1 s").stdout.splitlines()
    said = "-1500 rpm (-157.08 rad/s), from y to x: harmonics are told of shafts that turn from x to y"
    assert backward[4] == said
    lines = run("run", "jeffcott", "--set", "speed=1500", "--set", "controller.KI=0").stdout.splitlines()
    assert lines[4] == "14323.9 rpm (1500 rad/s); harmonics over 4.0031 .. 5 s, 238 turns; settled"


def test_orders_that_samples_cannot_tell_apart_are_not_shown_as_others(run) -> None:
    """The highest of nine orders is the seventh: 14 samples a turn tell it from the minus seventh."""
    few = run("run", "jeffcott", "--set", "solver.record_every=200")
    assert (few.exit_code, few.stdout.splitlines()[-1]) == (
        0,
        "1500 rpm (157.08 rad/s); 2 samples a turn: harmonics need 14, so a smaller step or record_every",
    )
    assert json.loads(run("run", "jeffcott", "--set", "solver.record_every=200", "--json").stdout)["harmonics"] == {}
    least = json.loads(run("run", "jeffcott", "--step", "2.857142857142857 ms", "--json").stdout)
    assert least["harmonics"]
    assert "samples a turn" not in run("spectrum", "jeffcott").stderr
    assert run("spectrum", "jeffcott", "--set", "solver.record_every=200").stderr == (
        "warning: jeffcott: 2 samples a turn: orders beyond 1 appear as lower ones\n\n"
        "hint: record more often: --set solver.record_every=..., or a smaller step\n"
    )
    # three steps a turn: the error of the step is said all the same
    coarse = run("run", "jeffcott", "--set", "speed=2e5 rpm", "--stop", "0.5 s")
    assert (coarse.exit_code, "the step 0.0001 s is too large" in coarse.stderr) == (0, True)


def test_an_interrupted_run_keeps_what_was_computed(run, oscillator, monkeypatch) -> None:
    def interrupt(fraction: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run_verb, "_silent", interrupt)
    result = run("run", str(oscillator), "--stop", "100 s", "--out", "part.csv", "--json")
    assert result.exit_code == 130
    data = json.loads(result.stdout)
    assert data["status"] == "stopped"
    assert 1 < data["time"]["samples"] < 10_000
    assert len(Path("part.csv").read_text().splitlines()) == data["time"]["samples"] + 1


def test_progress_goes_to_stderr_when_asked_for(run, oscillator) -> None:
    result = run("run", str(oscillator), "--progress", "--json")
    json.loads(result.stdout)
    assert "decay" in result.stderr


def test_spectrum_finds_the_harmonics(run) -> None:
    data = json.loads(run("spectrum", "jeffcott", "--window", "4 s:5 s", "--json").stdout)
    found = data["signals"]["rotor.displacement"]
    assert data["running_hz"] == pytest.approx(25.0, rel=1e-9)
    bins = [round(frequency) for frequency in found["frequency_hz"]]  # one second: 1 Hz apart
    value = dict(zip(bins, zip(found["real"], found["imag"], strict=True), strict=True))
    for order in (-5, 1, 3):
        assert math.hypot(*value[25 * order]) == pytest.approx(TABLE_2_2[order][0], rel=2e-3)


def test_spectrum_refuses_settings_of_a_saved_result(run) -> None:
    run("run", "jeffcott", "--stop", "0.1", "--out", "r.npz")
    result = run("spectrum", "r.npz", "--set", "speed=1")
    assert result.exit_code == 2
    assert result.stderr == "error: r.npz: --set and --without need a diagram, not a saved result\n"


def test_spectrum_window(run) -> None:
    result = run("spectrum", "jeffcott", "--window", "5 s")
    assert result.exit_code == 2
    assert result.stderr == "error: --window 5 s: not START:STOP\n\nhint: for example --window '4 s:5 s'\n"


@pytest.mark.parametrize("sampled", [False, True])
def test_a_run_that_begins_settled(run, sampled: bool) -> None:
    if sampled:
        run("swap", "jeffcott", "controller", "discrete_pid", "--out", "sampled.json")
    found = run("run", "sampled.json" if sampled else "jeffcott", "--settle", "--stop", "0.2 s", "--out", "settled.csv")
    assert found.exit_code == 0
    table = np.genfromtxt("settled.csv", delimiter=",", names=True)
    x = table[next(name for name in table.dtype.names if "displacement" in name)]
    turn = round(0.04 / (table["time"][1] - table["time"][0]))
    assert np.abs(x[turn:] - x[:-turn]).max() < 1e-5 * np.abs(x).max()


def test_settle_does_not_go_with_a_recording(run) -> None:
    run("record", "jeffcott", "--speeds", "1500 rpm", "--out", "measured")
    found = run("run", "jeffcott", "--input", "measured", "--settle")
    assert (found.exit_code, found.stderr.splitlines()[0]) == (2, "error: --settle does not go with --input")
