"""What is no recording, or does not fit its diagram: every verb says the same, with its place."""

from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.recordings import made
from tests.recordings.tables import write_csv

VERBS = [["identify", "jeffcott"], ["diagnose", "jeffcott"], ["locate", "jeffcott"], ["check"], ["check", "jeffcott"]]
NEITHER = "error: a recording is a folder with recording.json, or that file; this is neither\n\nhint: "


@pytest.fixture
def good(run: Run) -> Path:
    """Return a recording of one run, whose samples are in .csv."""
    folder = made.write(Path("good"), made.document(made.run(file="run1.csv")), {})
    write_csv(folder / "run1.csv", made.samples(n=500))
    return folder


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_a_data_file_is_no_recording(run: Run, good: Path, verb: list[str]) -> None:
    result = run(*verb, "good/run1.csv")
    assert result.exit_code == 2
    assert result.stderr.startswith(f"good/run1.csv: {NEITHER}give the folder: good\n")
    write_csv(Path("alone.csv"), made.samples(n=5))
    hint = "say what the columns of a data file mean in recording.json; see docs/recordings.md\n"
    assert run(*verb, "alone.csv").stderr.startswith(f"alone.csv: {NEITHER}{hint}")


def test_the_spectrum_of_a_data_file_is_one_of_its_recording(run: Run, good: Path) -> None:
    """A file of a format of results may be one."""
    no_result = "error: not a result of rotorsim: ValueError: the first column is 'x', not 'time'\n\nhint: "
    hint = "it is in a recording: give the folder good, and the run by --run\n"
    assert run("spectrum", "good/run1.csv").stderr == f"good/run1.csv: {no_result}{hint}"
    write_csv(Path("alone.csv"), made.samples(n=5))
    assert run("spectrum", "alone.csv").stderr == f"alone.csv: {no_result}`rotorsim run ... --out FILE` writes one\n"
    Path("good/a.tdms").touch()
    assert run("spectrum", "good/a.tdms").stderr == f"good/a.tdms: {NEITHER}give the folder: good\n"


@pytest.mark.parametrize("verb", [*VERBS[:2], VERBS[-1]], ids=" ".join)
def test_a_channel_that_does_not_fit_has_its_place(run: Run, verb: list[str]) -> None:
    channels = {**made.CHANNELS, "x": {**made.CHANNELS["x"], "unit": "A"}}
    made.write(Path("b"), made.document(channels=channels))
    text = "channel x: unit 'A' does not fit 'rotor.displacement', which is in m"
    result = run(*verb, "b")
    assert result.exit_code == 2
    assert f"b/recording.json:5:3: error: {text}\n\nhint: correct the unit, or the signal, in recording.json\n" in (
        result.stderr
    )
