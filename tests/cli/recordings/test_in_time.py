"""rotorsim identify and run --input on samples in time: what they print, their exit codes, and what they refuse."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Run
from tests.identification.waveform.in_time import OSCILLATOR, TRUTH, even, measured
from tests.report import undrawn


@pytest.fixture
def bench(tmp_path: Path) -> str:
    """Return a folder with two runs of an oscillator, and put its diagram beside it."""
    folder = tmp_path / "bench"
    folder.mkdir()
    runs = []
    for k, use in enumerate(("identify", "hold_out")):
        run = measured(f"run{k}", k, even(600), 0.02)
        np.savez(folder / f"run{k}.npz", **run.values)
        runs.append({"id": f"run{k}", "file": f"run{k}.npz", "sample_rate": "200 Hz", "use": use})
    channels = {"u": {"signal": "drive.output", "unit": "N"}, "q": {"signal": "position.output", "unit": "mm"}}
    with np.load(folder / "run0.npz") as first, np.load(folder / "run1.npz") as second:
        for name, values in (("run0", first), ("run1", second)):
            np.savez(folder / f"{name}.npz", u=values["u"], q=1e3 * values["q"])
    document = {"name": "bench", "source": "made for a test", "channels": channels, "runs": runs}
    (folder / "recording.json").write_text(json.dumps(document))
    (tmp_path / "oscillator.json").write_text(json.dumps(OSCILLATOR))
    return "bench"


def test_identify_prints_parameters_scores_and_a_statement(run: Run, bench: str):
    result = run("identify", "oscillator.json", bench)
    assert result.exit_code == 0, result.output
    lines = [line.split() for line in result.stdout.splitlines() if line]
    assert [line[0] for line in lines[1:4]] == list(TRUTH)
    assert all(line[-1] == "yes" for line in lines[1:4])
    assert lines[4] == ["NRMSE", "of", "signal", "identified", "from", "held", "out", "noise", "floor"]
    assert lines[5][0] == "position.output"
    assert result.stdout.rstrip().endswith(
        "3 of 3 parameters are identified: inverse_mass.gain, damper.gain, spring.gain."
    )


@pytest.mark.slow
def test_identify_writes_a_folder(run: Run, bench: str):
    with undrawn():
        result = run("identify", "oscillator.json", bench, "--out", "found", "--json")
    data = json.loads(result.stdout)
    assert data == json.loads(Path("found/identification.json").read_text())
    assert data["runs"] == ["run0"]
    assert "goodness" not in data
    assert set(data["fit"]) == {"identify", "hold_out"}
    again = run("run", "found/diagram.json", "--input", bench, "--json")
    assert json.loads(again.stdout)["errors"]["position.output"]["nrmse"] == pytest.approx(0.02, rel=0.1)


def test_identify_refuses_what_belongs_to_a_shaft(run: Run, bench: str):
    result = run("identify", "oscillator.json", bench, "--method", "regression")
    assert result.exit_code == 2
    assert result.stderr == (
        "error: oscillator: method 'regression' is of harmonics at steady speeds, and nothing turns so here\n\n"
        "hint: --method likelihood: in time it is output error\n"
    )


def test_run_prints_errors_in_recorded_units_and_writes_the_signals(run: Run, bench: str):
    right = [part for name, value in TRUTH.items() for part in ("--set", f"{name}={value}")]
    result = run("run", "oscillator.json", *right, "--input", bench, "--run", "run1", "--out", "beside.csv")
    assert result.exit_code == 0, result.output
    header, line = (text.split() for text in result.stdout.splitlines())
    assert header == ["signal", "NRMSE", "rms", "error", "unit"]
    assert (line[0], line[2], line[4]) == ("position.output", "%", "mm")
    assert float(line[1]) == pytest.approx(2.0, rel=0.1)
    assert result.stderr == ("oscillator: driven as run run1, 600 samples, starts estimated\nwritten: beside.csv\n")
    head = Path("beside.csv").read_text().splitlines()[0]
    assert head == '"time","position.output","drive.output","measured.position.output"'
    first = run("run", "oscillator.json", "--input", bench).stderr
    assert first == ("oscillator: driven as run run0 of 2 (--run chooses another), 600 samples, starts estimated\n")


def test_options_that_do_not_go_together_are_refused_all_at_once(run: Run, bench: str):
    result = run("run", "oscillator.json", "--input", bench, "--step", "1 ms", "--solver", "dop853")
    assert result.exit_code == 2
    assert result.stderr == (
        "error: --solver does not go with --input\n\n"
        "hint: the recorded instants say where it goes, in steps that are short enough\n\n"
        "error: --step does not go with --input\n\n"
        "hint: the recorded instants say where it goes, in steps that are short enough\n"
    )
    result = run("run", "oscillator.json", "--run", "run1", "--start", "diagram")
    assert result.exit_code == 2
    assert result.stderr == "error: --run needs --input RECORDING\nerror: --start needs --input RECORDING\n"
