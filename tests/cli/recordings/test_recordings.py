"""Recordings on the command line: ``rotorsim spectrum`` and ``rotorsim check``; harmonics by name."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from rotorsim.diagram.parse.source import Source
from rotorsim.recordings.document import parse_recording
from tests.recordings import made
from tests.reference.published import TABLE_2_2

ROOT = Path(__file__).parents[3]
ERROR = re.compile(r"reconstruction error: x (\S+) %, y (\S+) % of the rms")


@pytest.fixture
def measured(run) -> str:
    """Return the folder of two runs of good data at 25.3 Hz; forward and backward amplitudes are known."""
    two = [made.run(id=name, file=f"{name}.npz") for name in ("one", "two")]
    made.write(Path("measured"), made.document(*two))
    return "measured"


def amplitude(unit: float, *pairs: tuple[int, float]) -> dict[int, float]:
    return {order: size * unit for order, size in pairs}


# x + i y of tests/recordings/made.py: (a + b) / 2 and (a - b) / 2 of cosine a in x and sine b in y
DISPLACEMENT = amplitude(1e-6, (1, 17.0), (-1, 3.0), (2, 0.5), (-2, 3.5), (0, 10.0))

# --- spectrum ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [None, "least-squares", "regression", "fft"])
def test_harmonics_of_a_recording(run, measured: str, method: str | None) -> None:
    option = ["--harmonics", method] if method else []
    data = json.loads(run("spectrum", measured, "--json", *option).stdout)
    assert (data["recording"], list(data["runs"])) == ("made", ["one", "two"])
    for entry in data["runs"].values():
        assert entry["speed"] == pytest.approx(made.SPEED, rel=1e-6)
        assert (entry["angle"], entry["phase_known"], entry["samples"]) == ("tacho", True, 5000)
        found = entry["signals"]["rotor.displacement"]["harmonics"]
        assert found["method"] == (method or "least-squares")
        sizes = {k: math.hypot(a, b) for k, a, b in zip(found["orders"], found["real"], found["imag"], strict=True)}
        # fft: what the window lacks of whole turns; regression: order -2 leaks, being none of the nine
        leak = 3e-3 if method in ("fft", "regression") else 3e-4  # else noise: 3e-8 / 17e-6 / 70
        for order, size in DISPLACEMENT.items():
            if order in sizes:
                assert sizes[order] == pytest.approx(size, abs=leak * 17e-6)
        assert (found["amplitude_90"] is None) == (method in ("regression", "fft"))
        assert found["lines"] == []
    forward = data["runs"]["one"]["signals"]["rotor.displacement"]
    at = int(np.argmax(np.hypot(forward["real"], forward["imag"])))
    assert forward["frequency_hz"][at] == pytest.approx(25.3, abs=1.01)


def test_the_interval_of_a_harmonic(run, measured: str) -> None:
    """White noise of std s in n samples of each axis: R_k has std s sqrt(2/n) as a complex number, s/sqrt(n) a part."""
    data = json.loads(run("spectrum", measured, "--run", "one", "--json").stdout)
    found = data["runs"]["one"]["signals"]["rotor.displacement"]["harmonics"]
    at = found["orders"].index(1)
    expected = 1.645 * 3e-8 / math.sqrt(5000)
    assert found["amplitude_90"][at] == pytest.approx(expected, rel=0.03)
    assert found["phase_90"][at] == pytest.approx(expected / 17e-6, rel=0.03)


def test_the_text(run, measured: str) -> None:
    result = run("spectrum", measured, "--run", "two", "--signal", "rotor.displacement")
    lines = result.stdout.splitlines()
    assert lines[0] == "two: 0..0.9998 s, 1518 rpm by the tacho"
    assert lines[2] == "rotor.displacement, least squares over 25.3 turns, 0..0.9999 s"
    assert " ".join(lines[3].split()) == "order amplitude [um, 0-peak] +- 90 % phase [deg] +- 90 %"
    rows = [line.split() for line in lines[4:-1]]
    assert [row[0] for row in rows] == ["-2", "-1", "0", "1", "2"]
    for order, size, doubt, *_ in rows:
        assert float(size) == pytest.approx(DISPLACEMENT[int(order)] * 1e6, abs=0.003)
        assert float(doubt) == pytest.approx(0.0007, abs=1e-4)
    assert ERROR.fullmatch(lines[-1])


@pytest.mark.slow
def test_tables_2_2_and_2_3_by_one_command(run) -> None:
    for method in ("regression", "fft"):
        arguments = ["--window", "4 s:5 s", "--harmonics", method]
        text = run("spectrum", "jeffcott", *arguments).stdout
        assert text.splitlines()[0] == (
            f"rotor.displacement, {'FFT' if method == 'fft' else method} over 25 turns, 4..5 s"
        )
        data = json.loads(run("spectrum", "jeffcott", *arguments, "--json").stdout)
        for signal, column in (("rotor.displacement", 0), ("controller.current", 2)):
            found = data["signals"][signal]["harmonics"]
            assert sorted(found["orders"]) == sorted(TABLE_2_2)
            for order, real, imag in zip(found["orders"], found["real"], found["imag"], strict=True):
                size, phase = TABLE_2_2[order][column : column + 2]
                assert math.hypot(real, imag) == pytest.approx(size, rel=1e-3)
                assert math.degrees(math.atan2(imag, real)) == pytest.approx(phase, abs=0.02)


def test_lines_that_do_not_follow_the_shaft_are_named(run) -> None:
    table = made.samples()
    time = np.arange(5000) / made.RATE
    table["x"] += 1e-6 * np.cos(2 * np.pi * 61.7 * time)
    table["y"] += 1e-6 * np.sin(2 * np.pi * 61.7 * time)
    made.write(Path("m"), made.document(), {"run1.npz": table})
    [line] = [line for line in run("spectrum", "m").stdout.splitlines() if line.startswith("asynchronous line")]
    number = r"([\d.e+-]+)"
    found = re.fullmatch(
        rf"asynchronous line: {number} Hz, order {number}, forward {number} um, backward {number} um", line
    )
    assert found
    frequency, order, forward, backward = map(float, found.groups())
    assert frequency == pytest.approx(61.7, abs=0.01)
    assert order == pytest.approx(61.7 / 25.3, abs=1e-3)
    assert forward == pytest.approx(1.0, rel=0.01)
    assert backward < 0.01


def test_channels_that_are_coupled_by_a_capacitor_have_no_mean(run) -> None:
    channels = {name: {**entry, "coupling": "ac"} for name, entry in made.CHANNELS.items() if name in "xy"}
    made.write(Path("m"), made.document(channels=channels))
    data = json.loads(run("spectrum", "m", "--json").stdout)
    found = data["runs"]["run1"]["signals"]["rotor.displacement"]
    assert 0 not in found["harmonics"]["orders"]
    assert max(found["harmonics"]["reconstruction_error"]) < 0.01


def test_a_run_at_rest_has_a_spectrum_but_no_harmonics(run) -> None:
    made.write(Path("m"), made.document(made.run(tacho=[], speed=0.0)), {"run1.npz": made.samples()})
    text = run("spectrum", "m", "--threshold", "0.2").stdout
    assert text.splitlines()[0] == "run1: 0..0.9998 s, no shaft angle"
    assert text.splitlines()[4].split()[1] == "-"
    for arguments in (["--harmonics", "fft"], ["--plot", "s.png"]):
        result = run("spectrum", "m", *arguments)
        assert result.stderr.startswith(f"error: run1: {arguments[0]} needs the shaft angle\n\nhint: ")
        assert result.exit_code == 2


def test_a_speed_alone_gives_no_phase(run) -> None:
    made.write(Path("m"), made.document(made.run(tacho=None)), {"run1.npz": made.samples()})
    text = run("spectrum", "m").stdout
    assert text.startswith("run1: 0..0.9998 s, 1518 rpm by the stated speed; phases count from the start of the run\n")


def test_uneven_samples_have_harmonics_but_no_full_spectrum(run) -> None:
    time = np.arange(5000) / made.RATE + np.random.default_rng(0).uniform(0, 1e-4, 5000)
    angle = made.SPEED * time + 0.3
    table = {"x": 2e-5 * np.cos(angle), "y": 1.4e-5 * np.sin(angle), "t": time}
    channels = {name: made.CHANNELS[name] for name in "xy"}
    document = made.document(made.run(sample_rate=None, time="t"), channels=channels)
    made.write(Path("m"), document, {"run1.npz": table})
    result = run("spectrum", "m", "--json")
    assert result.stderr == "run1: the samples are not equally spaced: harmonics, but no full spectrum\n"
    signal = json.loads(result.stdout)["runs"]["run1"]["signals"]["rotor.displacement"]
    found = signal["harmonics"]
    assert "frequency_hz" not in signal
    for order, size in ((1, 17e-6), (-1, 3e-6)):
        at = found["orders"].index(order)
        assert math.hypot(found["real"][at], found["imag"][at]) == pytest.approx(size, rel=1e-6)


@pytest.mark.slow
def test_nodes_that_were_measured_are_shown(run) -> None:
    run("record", "fe_rigid", "--out", "m", "--signal", "rotor.displacement[3]", "--window", "0:0.1", "--settle")
    data = json.loads(run("spectrum", "m", "--json").stdout)
    assert list(data["runs"]["run01"]["signals"]) == ["rotor.displacement[3]"]
    assert run("spectrum", "m", "--plot", "s.svg").exit_code == 0
    assert Path("s.svg").read_text().startswith("<?xml")


def test_a_window_of_a_recording(run, measured: str) -> None:
    result = run("spectrum", measured, "--run", "one", "--window", "0.2 s:0.7 s", "--signal", "controller.current")
    lines = result.stdout.splitlines()
    assert lines[0] == "one: 0.2..0.7 s, 1518 rpm by the tacho"
    assert lines[2] == "controller.current, least squares over 12.65 turns, 0.2..0.6999 s"


def complaint(text: str, hint: str = "") -> str:
    return f"error: {text}\n" + (f"\nhint: {hint}\n" if hint else "")


WRONG = {
    "run": (["measured", "--run", "on"], "--run on: no such run in made", "did you mean 'one'?"),
    "plot": (["measured", "--plot", "s.png"], "--plot draws one run, measured has 2", "--run one, for example"),
    "signal": (
        ["measured", "--run", "one", "--signal", "rotor.displacment"],
        "one: rotor.displacment: not a two-axis signal that was measured",
        "did you mean 'rotor.displacement'?",
    ),
    "set": (["measured", "--set", "speed=3"], "measured: --set and --without need a diagram, not a recording", ""),
    "window": (
        ["measured", "--run", "one", "--window", "5:6"],
        "one: window 5..6 s holds 0 samples",
        "the run covers 0..0.9998 s",
    ),
    "short": (
        ["measured", "--run", "one", "--window", "0:0.01"],
        "one: only 0.253 turns of the shaft in 0..0.0098 s",
        "harmonics need at least one turn",
    ),
    "method": (
        ["measured", "--harmonics", "dft"],
        "invalid value for '--harmonics': 'dft' is not one of 'least-squares', 'fft', 'regression'",
        "'rotorsim spectrum --help' shows how it is used",
    ),
    "not a recording": (["jeffcott", "--run", "one"], "jeffcott: --run needs a recording", ""),
    "at rest": (
        ["jeffcott", "--set", "speed=0", "--harmonics", "fft"],
        "only 0 turns of the shaft in 0..4.9999 s",
        "harmonics need at least one turn",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes_of_spectrum(run, measured: str, case: str) -> None:
    arguments, what, hint = WRONG[case]
    result = run("spectrum", *arguments)
    assert (result.stderr, result.exit_code, result.stdout) == (complaint(what, hint), 2, "")


def test_all_runs_are_tried_and_all_mistakes_said(run) -> None:
    tables = {name: made.samples() for name in ("a.npz", "b.npz", "c.npz")}
    tables["a.npz"]["x"][700] = np.nan
    tables["b.npz"] = {name: values[:150] for name, values in tables["b.npz"].items()}
    runs = [made.run(id=name, file=f"{name}.npz") for name in "abc"]
    made.write(Path("m"), made.document(*runs), tables)
    result = run("spectrum", "m")
    assert result.exit_code in (1, 2)
    assert result.stdout.startswith("c: ")
    for text in (
        "a: rotor.displacement: x: 1 sample is not finite, first at sample 701",
        "b: only 0.759 turns of the shaft",
    ):
        assert f"error: {text}" in result.stderr
    assert json.loads(run("spectrum", "m", "--json").stdout)["problems"][0]["subject"] == "a: rotor.displacement: x"


def test_recordings_without_two_axes(run) -> None:
    made.write(Path("m"), made.document(channels={"x": made.CHANNELS["x"]}))
    text = complaint(
        "run1: no two-axis signal was measured", "spectra of both whirls need channels of axis x and of axis y"
    )
    result = run("spectrum", "m")
    assert (result.stderr, result.exit_code) == (text, 2)


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".h5"])
def test_a_saved_run_that_diverged_has_no_spectrum(run, suffix: str) -> None:
    said = run("run", "jeffcott", "--set", "controller.KP=-30000", "--out", f"d{suffix}").stderr
    [message] = re.findall(r"error: jeffcott: (diverged at .*)", said)
    result = run("spectrum", f"d{suffix}")
    hint = "what was computed until then has no spectrum; 'rotorsim modes' shows which modes grow"
    assert result.stderr == f"d{suffix}: error: {message}\n\nhint: {hint}\n"
    assert (result.exit_code, result.stdout) == (1, "")
    if suffix == ".csv":
        Path("d.csv.meta.json").unlink()
        result = run("spectrum", "d.csv")
        text = "this run diverged: its values are beyond 1e100"
        assert (result.stderr, result.exit_code) == (f"d.csv: error: {text}\n\nhint: {hint}\n", 1)


# --- check ---------------------------------------------------------------------------------------------------------


def test_check_sums_up_a_recording(run) -> None:
    gains = [{"controller.KP": 12200.0}, {"controller.KP": 9000.0, "controller.KD": 4.5}]
    runs = [
        made.run(
            id=f"r{k}{g}",
            file=f"r{k}{g}.npz",
            speed=speed,
            tacho=made.pulses(speed),
            set=gains[g],
            use="hold_out" if k else None,
        )
        for k, speed in enumerate((2 * np.pi * 19, 2 * np.pi * 27))
        for g in (0, 1)
    ]
    made.write(Path("m"), made.document(*runs))
    result = run("check", "m", "jeffcott")
    assert result.stdout == (
        "m: 4 channels, 4 runs (2 held out), 1140 to 1620 rpm, 2 sets of controller.KP and controller.KD, no mistakes\n"
        "jeffcott: 8 blocks, 14 wires, no mistakes\n"
    )
    assert (result.stderr, result.exit_code) == ("", 0)
    data = json.loads(run("check", "m", "jeffcott", "--json").stdout)
    assert [entry["diagram"] for entry in data["diagrams"]] == ["jeffcott"]
    assert data["recordings"] == [
        {
            "recording": "m",
            "valid": True,
            "channels": 4,
            "runs": 4,
            "hold_out": 2,
            "speed_low": pytest.approx(2 * np.pi * 19),
            "speed_high": pytest.approx(2 * np.pi * 27),
            "settings": 2,
            "set": ["controller.KP", "controller.KD"],
            "problems": [],
        }
    ]


def test_check_of_one_run(run) -> None:
    made.write(Path("m"), made.document(made.run(set=None)))
    assert run("check", "m").stdout == "m: 4 channels, 1 run, 1518 rpm, no mistakes\n"
    assert run("check", "m/recording.json").stdout == "m/recording.json: 4 channels, 1 run, 1518 rpm, no mistakes\n"
    Path("m/recording.json").rename("m/rig.json")
    assert run("check", "m/rig.json").stdout == "m/rig.json: 4 channels, 1 run, 1518 rpm, no mistakes\n"


def test_check_prints_warnings_and_passes(run) -> None:
    table = made.samples()
    table["ix"][:] = 0.0
    made.write(Path("m"), made.document(), {"run1.npz": table})
    result = run("check", "m")
    assert result.stderr == "m/run1.npz: warning: run1: column ix: constant signal: all samples are 0 A\n"
    assert result.exit_code == 0


def test_check_finds_errors_in_the_data(run) -> None:
    made.write(Path("m"), made.document(made.run(speed=made.SPEED * 2)), {"run1.npz": made.samples()})
    result = run("check", "m")
    assert result.stderr.endswith("run1: tacho: the tacho says 1518 rpm, the stated speed is 3036 rpm\n\n1 mistake\n")
    assert (result.exit_code, result.stdout) == (1, "")
    data = json.loads(run("check", "m", "--json").stdout)
    assert (data["recordings"][0]["valid"], data["recordings"][0]["runs"]) == (False, 1)


def test_check_compares_a_recording_with_a_diagram(run) -> None:
    channels = {**made.CHANNELS, "x": {**made.CHANNELS["x"], "signal": "rotor.displ"}}
    channels["iy"] = {**made.CHANNELS["iy"], "unit": "V"}
    wrong = made.document(made.run(set={"controler.KP": 12200.0, "controller.KD": "3 kg"}), channels=channels)
    made.write(Path("m"), wrong)
    result = run("check", "jeffcott", "m")
    for text in (
        "m/recording.json:5:3: error: channel x: the diagram has no signal 'rotor.displ'\n\n"
        "hint: did you mean 'rotor.displacement'?\n",
        "error: channel iy: unit 'V' does not fit 'controller.current', which is in A\n",
        "error: run run1: set controler.KP: no such parameter\n\nhint: did you mean 'controller.KP'?\n",
        "error: run run1: set controller.KD: ",
    ):
        assert text in result.stderr
    assert result.stderr.endswith("\n4 mistakes\n")
    assert (result.exit_code, result.stdout) == (2, "jeffcott: 8 blocks, 14 wires, no mistakes\n")
    made.write(Path("good"), made.document())
    assert run("check", "jeffcott", "good").exit_code == 0


def test_a_run_up_has_no_spectrum_of_orders(run) -> None:
    result = run("spectrum", "jeffcott_runup", "--set", "solver.stop=2")
    assert "its orders are not those of one speed" in result.stderr
    assert (result.exit_code, result.stdout) == (2, "")


def test_check_finds_mistakes_of_the_document(run) -> None:
    made.write(Path("bad"), made.document(made.run(usage="identify")))
    made.write(Path("data"), made.document(made.run(speed=made.SPEED * 2)), {"run1.npz": made.samples()})
    result = run("check", "data", "bad", "jeffcott")
    assert "bad/recording.json:" in result.stderr
    assert "unknown key 'usage'\n\nhint: did you mean 'use'?" in result.stderr
    assert result.stderr.endswith("\n2 mistakes\n")
    assert result.stdout == "jeffcott: 8 blocks, 14 wires, no mistakes\n"
    assert result.exit_code == 2


def test_check_of_a_folder_without_recording(run) -> None:
    Path("empty").mkdir()
    result = run("check", "empty")
    hint = "a recording is a folder with recording.json and data files; see docs/recordings.md"
    assert result.stderr == f"empty/recording.json: error: file does not exist\n\nhint: {hint}\n\n1 mistake\n"
    assert result.exit_code == 2
    result = run("check", "empty", "--set", "speed=3")
    assert result.stderr == "error: empty: --set and --without need a diagram, not a recording\n"


# --- the page about it ---------------------------------------------------------------------------------------------


def test_the_example_of_the_page_is_a_recording() -> None:
    page = (ROOT / "docs/recordings.md").read_text(encoding="utf-8")
    [text, _] = re.findall(r"^```json\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert len(text.splitlines()) <= 16
    found = parse_recording(Source(json.loads(text)), Path(), files=False).recording
    assert [entry.id for entry in found.runs] == ["slow", "soft", "fast"]
    assert list(found.channels) == ["x", "y", "ix", "iy", "key"]
