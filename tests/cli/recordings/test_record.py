"""``rotorsim record``: simulated measurements that the other commands read."""

from __future__ import annotations

import json
import math
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from rotorsim.cli.shared.inputs import gains_of
from rotorsim.cli.shared.options import NOISE_KINDS
from rotorsim.measure import record as measuring
from rotorsim.measure.checks import check_signals
from rotorsim.recordings.loading import load_recording


def test_a_run_per_speed_and_set_of_gains(run) -> None:
    arguments = ["--speeds", "1200 rpm, 1500 rpm", "--hold-out", "1500 rpm, 1380 rpm", "--window", "0.1 s:0.2 s"]
    gains = ["--gains", "controller.KP=12200", "--gains", "controller.KP=9 A/mm, controller.KD=4.5"]
    result = run("record", "jeffcott", "--out", "measured", *arguments, *gains)
    assert result.exit_code == 0
    assert result.stderr == "written: measured/recording.json and 6 data files\n"
    found = load_recording("measured")
    assert [round(item.speed * 30 / math.pi) for item in found.runs] == [1200, 1500, 1380] * 2
    assert [item.use for item in found.runs] == ["identify", "hold_out", "hold_out"] * 2
    first, other = {"controller.KP": 12200}, {"controller.KP": "9 A/mm", "controller.KD": 4.5}
    assert [dict(item.settings) for item in found.runs] == [first] * 3 + [other] * 3
    assert list(found.channels) == ["x", "y", "ix", "iy"]
    assert found.name == "jeffcott"
    assert found.source.startswith("simulated by rotorsim ")
    assert [problem for problem in check_signals(found) if problem.severity == "error"] == []
    lines = result.stdout.splitlines()
    assert lines[0].split() == ["run", "speed", "[rpm]", "samples", "use", "set"]
    assert " ".join(lines[6].split()) == "run06 1380 1001 hold_out controller.KP = 9 A/mm, controller.KD = 4.5"


def test_gains_are_in_force_in_their_runs(run) -> None:
    """i = KP u + KI int(u) + KD u', the integral being small in the first milliseconds."""
    run(
        "record",
        "jeffcott",
        "--out",
        "m",
        "--window",
        "0:0.02",
        "--gains",
        "controller.KP=9000, controller.KD=0",
        "--gains",
        "controller.KP=7000, controller.KD=0",
    )
    for item, gain in zip(load_recording("m").runs, (9000.0, 7000.0), strict=True):
        x = item.values["x"]
        integral = 2000 * 0.02 * np.abs(x).max()  # KI times the largest integral there can be
        np.testing.assert_allclose(item.values["ix"], gain * x, rtol=0, atol=integral)


def test_what_set_changes_is_not_written_as_known(run) -> None:
    run("record", "jeffcott", "--out", "m", "--window", "0:0.1", "--set", "crack_stiffness=1e5 N/m", "--without", "amb")
    found = load_recording("m")
    assert dict(found.runs[0].settings) == {}
    assert "set crack_stiffness=1e5 N/m; without amb" in found.source


def test_the_default_is_the_last_fifth_at_the_speed_of_the_diagram(run) -> None:
    run("record", "jeffcott", "--out", "m")
    run("run", "jeffcott", "--out", "r.npz")
    from rotorsim.simulation.files import load_result

    whole = load_result("r.npz")
    [item] = load_recording("m").runs
    assert item.speed == pytest.approx(50 * np.pi)
    np.testing.assert_array_equal(item.values["iy"], whole.column("controller.current[2]")[40000:])
    np.testing.assert_allclose(item.tacho, np.arange(26) * 0.04, atol=1e-9)  # 4 s are a hundred turns


def test_a_run_up_is_kept_whole(run) -> None:
    run("record", "jeffcott_runup", "--out", "m", "--set", "solver.stop=2", "--rate", "2 kHz")
    [item] = load_recording("m").runs
    assert len(item.time) == 4001
    assert item.time[-1] == pytest.approx(2.0)


def test_nodes_that_cannot_move_are_not_measured(run) -> None:
    run("record", "fe_rigid", "--out", "m", "--window", "0:0.02")
    assert [name for name in load_recording("m").channels if name[0] in "xy"] == [
        f"{axis}{node}" for node in (2, 3, 4, 5) for axis in "xy"
    ]


def test_signals_rate_and_format(run) -> None:
    arguments = ["--signal", "rotor.displacement[3]", "--signal", "controller.current[1]", "--rate", "2500 Hz"]
    result = run("record", "fe_rigid", "--out", "a/b", "--window", "0.1:0.2", *arguments, "--format", "csv", "--json")
    data = json.loads(result.stdout)
    assert data == {
        "folder": "a/b",
        "signals": ["rotor.displacement[3]", "controller.current[1]"],
        "runs": [{"id": "run01", "speed": pytest.approx(54 * np.pi), "samples": 251, "use": "identify", "set": {}}],
    }
    found = load_recording("a/b")
    assert [channel.name for channel in found.channels.values()] == [
        "rotor.displacement[3,1]",
        "rotor.displacement[3,2]",
        "controller.current[1]",
    ]
    assert found.runs[0].sample_rate == pytest.approx(2500.0)
    assert Path("a/b/run01.csv").exists()


@pytest.mark.parametrize("name", ["jeffcott", "sampled.json"])
def test_a_settled_recording_repeats_every_turn(run, name: str) -> None:
    run("swap", "jeffcott", "controller", "discrete_pid", "--out", "sampled.json")
    run("record", name, "--out", "m", "--settle", "--window", "0:0.12")
    x = load_recording("m").runs[0].values["x"]
    np.testing.assert_allclose(x[400:800], x[:400], atol=1e-6 * np.abs(x).max())  # 400 samples a turn; error of RK4


def test_noise_by_kind_and_seed(run) -> None:
    found = {}
    for name, options in {
        "clean": [],
        "one": ["--noise", "5 %"],
        "same": ["--noise", "0.05", "--seed", "1"],
        "other": ["--noise", "5 %", "--seed", "2"],
        "thesis": ["--noise", "5 %", "--noise-kind", "thesis"],
        "uniform": ["--noise", "5 %", "--noise-kind", "uniform"],
    }.items():
        assert run("record", "jeffcott", "--out", name, *options).exit_code == 0
        found[name] = load_recording(name).runs[0]
    for column, clean in found["clean"].values.items():
        added = {name: item.values[column] - clean for name, item in found.items()}
        assert added["one"].std() == pytest.approx(0.05 * clean.std(), rel=0.03)  # 10001 samples: 0.7 % is one std
        np.testing.assert_array_equal(added["one"], added["same"])
        assert abs(np.corrcoef(added["one"], added["other"])[0, 1]) < 0.05
        ratio = (added["thesis"] / clean)[clean != 0]
        assert ratio.mean() == pytest.approx(-0.025, abs=0.002)
        assert ratio.std() == pytest.approx(0.05, rel=0.03)
        ratio = (added["uniform"] / clean)[clean != 0]
        assert ratio.mean() == pytest.approx(0, abs=0.0006)  # four times 0.05 / sqrt(12 n)
        assert ratio.std() == pytest.approx(0.05 / 12**0.5, rel=0.03)
    np.testing.assert_array_equal(found["one"].tacho, found["clean"].tacho)
    assert "; white noise of 5 %, seed 1" in load_recording("one").source


def test_the_options_offer_all_kinds_of_noise() -> None:
    assert NOISE_KINDS == measuring.NOISE_KINDS


@pytest.mark.slow
def test_identify_finds_what_record_hid(run) -> None:
    """The circle closed: a diagram measured with another crack and unbalance; true values within the intervals."""
    arguments = ["--set", "crack_stiffness=2.2e5 N/m", "--set", "eccentricity=31 um", "--noise", "1 %", "--settle"]
    gains = ["--gains", "controller.KP=12200", "--gains", "controller.KP=9000, controller.KD=4.5"]
    run("record", "jeffcott", "--out", "m", "--speeds", "1200 rpm:150 rpm:1500 rpm", *arguments, *gains)
    data = json.loads(run("identify", "jeffcott", "m", "--json").stdout)
    for name, truth in {"crack_stiffness": 2.2e5, "eccentricity": 31e-6}.items():
        found = data["parameters"][name]
        assert abs(found["value"] - truth) < 4 * found["std"]
        assert found["std"] < 0.01 * truth


def test_progress_goes_over_all_runs(run, monkeypatch) -> None:
    shown: list[float] = []
    monkeypatch.setattr("rotorsim.cli.recordings.record.progress_bar", lambda label, wanted: nullcontext(shown.append))
    run("record", "jeffcott", "--out", "m", "--speeds", "1200 rpm, 1500 rpm", "--progress")
    assert shown == sorted(shown)
    assert {0.5, 1.0} <= set(shown)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.b=1", {"a.b": 1}),
        (" a.b = 1 , c.d = 2 N/A ", {"a.b": 1, "c.d": "2 N/A"}),
        ("a/b.c=[1, 2], d=true", {"a/b.c": [1, 2], "d": True}),
        ('a.b=["1 N/m", "2 N/m"],c.d=-3e-4', {"a.b": ["1 N/m", "2 N/m"], "c.d": -3e-4}),
    ],
)
def test_gains_as_text(text: str, expected) -> None:
    assert gains_of(text) == expected


NOT_GAINS = "hint: for example --gains 'controller.KP=9000, controller.KD=4.5'"
PROBLEMS = {
    "no folder": ((), "missing option '--out'", "hint: 'rotorsim record --help' shows how it is used"),
    "same speed": (
        ("--speeds", "1200 rpm, 1200 rpm"),
        "--speeds 1200 rpm, 1200 rpm: the same speed twice",
        "hint: runs at one speed need different --gains",
    ),
    "window": (("--window", "5 s"), "--window 5 s: not START:STOP", "hint: for example --window '4 s:5 s'"),
    "early window": (("--window=-1:5",), "--window -1:5: begins before the run", "hint: runs begin at t = 0"),
    "short window": (
        ("--window", "0:1e-5"),
        "jeffcott: window 0..1e-05 s holds 1 sample of 0.0001 s",
        "hint: a longer window, or a higher rate",
    ),
    "gains": (("--gains", "controller.KP"), "--gains controller.KP: 'controller.KP' is not NAME=VALUE", NOT_GAINS),
    "gains twice": (
        ("--gains", "a.b=1, a.b=2"),
        "--gains a.b=1, a.b=2: a.b is there twice",
        "hint: a --gains for each value",
    ),
    "gains and set": (
        ("--gains", "controller.KP=3", "--set", "controller.KP=4"),
        "--gains controller.KP: is given by --set as well",
        "hint: give it once",
    ),
    "speed as gain": (("--gains", "speed=3"), "--gains speed: the speeds are given by --speeds", ""),
    "unknown gain": (
        ("--gains", "controller.KQ=3"),
        "--gains controller.KQ: no such parameter in jeffcott",
        "hint: did you mean 'controller.KP' or 'controller.KI' or 'controller.KD'?",
    ),
    "noise": (("--noise", "-5 %"), "--noise -5 %: not a share of the rms", "hint: for example --noise '5 %'"),
    "unit of noise": (("--noise", "5 m"), "--noise 5 m: unit 'm' does not fit '1'", "hint: give a pure number"),
    "rate": (("--rate", "5000 rpm"), "--rate 5000 rpm: not a sample rate", "hint: for example --rate '5000 Hz'"),
    "no rate": (("--rate", "often"), "--rate often: not a sample rate", "hint: for example --rate '5000 Hz'"),
    "zero rate": (("--rate", "0 Hz"), "--rate 0 Hz: not a sample rate", "hint: for example --rate '5000 Hz'"),
    "lone hold-out": (
        ("--hold-out", "1200 rpm"),
        "--hold-out needs --speeds",
        "hint: for example --speeds '1200 rpm, 1320 rpm' --hold-out '1260 rpm'",
    ),
    "all held out": (
        ("--speeds", "1200 rpm", "--hold-out", "1200 rpm"),
        "--hold-out leaves no run to identify from",
        "hint: more --speeds",
    ),
    "signal": (
        ("--signal", "rotor.displacment"),
        "rotor.displacment: no such signal",
        "hint: did you mean 'rotor.displacement'?",
    ),
    "settled at rest": (
        ("--speeds", "0 rpm", "--settle"),
        "jeffcott at 0 rpm: a settled start needs a speed above zero",
        "",
    ),
    "too many runs": (("--speeds", "1 rpm:0.1 rpm:2000 rpm"), "19991 runs, at most 10000", "hint: fewer speeds"),
}


@pytest.mark.parametrize("case", PROBLEMS)
def test_mistakes(run, case: str) -> None:
    arguments, what, hint = PROBLEMS[case]
    folder = () if case == "no folder" else ("--out", "new")
    result = run("record", "jeffcott", *folder, *arguments)
    assert result.stderr == f"error: {what}\n" + (f"\n{hint}\n" if hint else "")
    assert (result.exit_code, result.stdout) == (2, "")
    assert not Path("new").exists()


def test_a_wrong_unit_of_a_gain_says_so(run) -> None:
    result = run("record", "jeffcott", "--out", "new", "--gains", "controller.KP=3 m")
    assert result.stderr == "--gains: error: controller.KP: unit 'm' does not fit 'A/m'\n\nhint: give it in A/m\n"
    assert result.exit_code == 2


@pytest.mark.parametrize("option", ["--speeds", "--settle"])
def test_a_run_up_takes_no_speeds(run, option: str) -> None:
    value = ["1200 rpm"] if option == "--speeds" else []
    result = run("record", "jeffcott_runup", "--out", "new", option, *value)
    assert result.stderr == (
        f"error: jeffcott_runup: {option}: the speed of this diagram changes\n\n"
        f"hint: {option} needs a diagram with the clock profile 'constant'\n"
    )
    assert result.exit_code == 2


def test_a_diagram_without_signals_or_speed(run, oscillator) -> None:
    result = run("record", str(oscillator), "--out", "new")
    hint = "hint: --signal rotor.displacement, for example"
    assert result.stderr == f"error: decay: the diagram records no two-axis signal\n\n{hint}\n"
    result = run("record", str(oscillator), "--out", "new", "--signal", "state.output", "--speeds", "3 rpm")
    assert "varies the diagram parameter 'speed', but no block follows it" in result.stderr
    assert run("record", str(oscillator), "--out", "new", "--signal", "state.output").exit_code == 0
    [item] = load_recording("new").runs
    np.testing.assert_allclose(item.values["state.output"], np.exp(-0.8 - item.time), rtol=1e-9)
    assert (item.speed, item.tacho) == (None, None)


def test_a_run_that_diverges_leaves_nothing(run) -> None:
    result = run("record", "jeffcott", "--out", "new", "--gains", "controller.KP=-30000", "--speeds", "1500 rpm")
    assert result.stderr.startswith("error: jeffcott at 1500 rpm: diverged at t = ")
    assert "the system is unstable" in result.stderr
    assert result.exit_code == 1
    result = run("record", "jeffcott", "--out", "new", "--gains", "controller.KP=-30000", "--settle")
    text = "error: jeffcott at 1500 rpm: no settled start: unstable: this motion is never reached\n"
    assert (result.stderr, result.exit_code) == (text, 1)
    assert not Path("new").exists()


def test_a_recording_is_replaced_only_when_asked(run) -> None:
    arguments = ["record", "jeffcott", "--out", "m", "--window", "0:0.1"]
    assert run(*arguments).exit_code == 0
    before = Path("m/recording.json").read_bytes()
    result = run(*arguments, "--set", "speed=1200 rpm")
    hint = "hint: choose another folder, or --overwrite"
    assert (result.stderr, result.exit_code) == (f"m: error: there is a recording already\n\n{hint}\n", 2)
    assert Path("m/recording.json").read_bytes() == before
    assert run(*arguments, "--set", "speed=1200 rpm", "--overwrite").exit_code == 0
    assert load_recording("m").runs[0].speed == pytest.approx(40 * np.pi)
    Path("file").touch()
    result = run("record", "jeffcott", "--out", "file")
    assert result.stderr == "error: --out file: is a file\n\nhint: give the name of a folder\n"


def test_few_samples_are_warned_of(run) -> None:
    result = run("record", "jeffcott", "--out", "m", "--rate", "50 Hz")
    assert result.exit_code == 0
    assert result.stderr.startswith(
        "warning: run01: 2 samples a turn: harmonics are mistaken for each other\n\nhint: a higher --rate\n"
    )


def test_an_unstable_machine_is_not_recorded(run) -> None:
    result = run("record", "jeffcott", "--set", "controller.KD=-5", "--out", "wrong")
    assert result.exit_code == 1
    assert result.stderr.startswith(
        "error: jeffcott: the machine is unstable: a pole at 121.5 Hz, damping ratio -0.044"
    )
    assert not Path("wrong").exists()


def test_a_step_that_is_too_coarse_is_warned_of(run) -> None:
    result = run("record", "jeffcott", "--set", "solver.step=0.003", "--out", "coarse")
    assert result.exit_code == 0
    assert "warning: run01: the step 0.003 s is too large: 'rotor.displacement' is wrong by about " in result.stderr
