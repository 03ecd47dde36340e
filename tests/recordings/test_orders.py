"""recording.json of kind "orders": what is read, and every mistake at its place."""

import json

import jsonschema
import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.recordings import orders
from rotorsim.recordings.document import recording_kind
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.orders import load_any, load_orders
from tests.identification.waveform.orders import CHANNEL, write

SPEED = 1000.0 + 10 * np.arange(25)
VECTORS = np.linspace(1, 3, 25) * 1e-6 * np.exp(1j * np.linspace(0.5, -2.5, 25))


@pytest.mark.parametrize("amplitude", ["0-peak", "peak-peak", "rms"])
@pytest.mark.parametrize("phase", ["lead", "lag"])
def test_vectors_are_0_peak_and_lead_whatever_the_table_says(tmp_path, amplitude, phase):
    recording = load_orders(write(tmp_path / "r", SPEED, VECTORS, words=(amplitude, phase)))
    [run] = recording.runs
    np.testing.assert_allclose(run.vectors["x 1X"], VECTORS, rtol=1e-7)
    np.testing.assert_allclose(run.speed, SPEED * np.pi / 30, rtol=1e-9)
    assert (run.time, run.turns, recording.slow_roll) == (None, 1, True)
    assert recording.channels["x 1X"].label == "1X of rotor.displacement[1]"


def test_a_time_column_and_missing_rows(tmp_path):
    folder = write(tmp_path / "r", SPEED, VECTORS, time=0.3 * np.arange(25), turns=4, slow_roll="subtracted")
    lines = (folder / "up.csv").read_text().splitlines()
    lines[3] = lines[3].rsplit(",", 3)[0] + ",nan,nan," + lines[3].rsplit(",", 1)[1]
    (folder / "up.csv").write_text("\n".join(lines) + "\n")
    recording = load_orders(folder)
    [run] = recording.runs
    assert np.isnan(run.vectors["x 1X"][2])
    assert np.isfinite(run.vectors["x 1X"]).sum() == 24
    assert (run.time[-1], run.turns, recording.slow_roll) == (pytest.approx(7.2), 4, False)
    assert [problem.what for problem in recording.warnings] == ["1 of 25 rows are missing, and are not compared"]


def problems(folder):
    with pytest.raises(RotorsimError) as error:
        load_orders(folder)
    found = error.value.problems
    return [(p.place.line, p.place.column, f"{p.subject}: {p.what}" if p.subject else p.what, p.hint) for p in found]


def test_what_amplitude_and_phase_mean_must_be_said(tmp_path):
    folder = write(tmp_path / "r", SPEED, VECTORS)
    document = json.loads((folder / "recording.json").read_text())
    del document["phase"]
    document["amplitude"] = "pk-pk"
    (folder / "recording.json").write_text(json.dumps(document, indent=1))
    assert problems(folder) == [
        (1, 1, "key 'phase' is missing", '"phase": "lag", or "lead": what the numbers are'),
        (5, 15, "recording: amplitude 'pk-pk' is not known", "did you mean 'peak-peak'?"),
    ]


def test_all_mistakes_of_a_document_are_told_at_once(tmp_path):
    channels = {
        "a": {**CHANNEL, "order": 0},
        "b": {"signal": "rotor.displacement", "axis": "y", "unit": "um", "amplitude": "amp"},
        "c": {**CHANNEL, "order": 2, "signal": "clock.theta", "unit": "rad"},
    }
    folder = write(tmp_path / "r", SPEED, VECTORS, channels=channels, turns=0, slow_roll="yes")
    said = [what for _, _, what, _ in problems(folder)]
    assert said == [
        "channel a: order 0 is not between 1 and 100",
        "channel b: key 'phase' is missing",
        "channel c: 'clock.theta' has no order",
        "up: turns: 0 is not between 1 and 10000",
        "recording: slow_roll 'yes' is not known",
    ]


def test_the_same_order_of_a_signal_twice_is_a_mistake_and_another_order_is_not(tmp_path):
    two = {**CHANNEL, "order": 2}
    assert len(load_orders(write(tmp_path / "r", SPEED, VECTORS, channels={"a": CHANNEL, "b": two})).channels) == 2
    [(_, _, what, _)] = problems(write(tmp_path / "s", SPEED, VECTORS, channels={"a": two, "b": two}))
    assert what == "channel b: measures 2X of rotor.displacement[1], and so does 'a'"


@pytest.mark.parametrize(
    ("row", "text", "said"),
    [
        (6, "-5,1,0", (7, 1, "row 6: not a speed above zero")),
        (6, "2000,1,0", (7, 1, "row 6: the speed changes by more than 20 % a turn: these are no successive turns")),
        (6, "1050,-1,0", (7, 6, "row 6: an amplitude below zero")),
        (6, "1050,1,nan", (7, 8, "row 6: amplitude without phase")),
        (6, "1050,nan,1", (7, 6, "row 6: phase without amplitude")),
    ],
)
def test_a_wrong_row_is_told_with_line_and_column(tmp_path, row, text, said):
    folder = write(tmp_path / "r", SPEED, VECTORS)
    lines = (folder / "up.csv").read_text().splitlines()
    lines[row] = text
    (folder / "up.csv").write_text("\n".join(lines) + "\n")
    line, column, what, _ = problems(folder)[0]
    assert (line, column, what.partition(": ")[2]) == said


def test_time_that_falls_and_too_few_rows_are_refused(tmp_path):
    falls = 0.1 * np.arange(25)
    falls[4] = 0.0
    [(line, _, what, _)] = problems(write(tmp_path / "r", SPEED, VECTORS, time=falls))
    assert (line, what) == (6, "run up, column t: row 5: time does not rise")
    [(_, _, what, _)] = problems(write(tmp_path / "s", SPEED[:19], VECTORS[:19]))
    assert what == "run up: 19 rows are too few: 20 are needed to tell motion from noise"


def test_orders_are_not_read_as_samples(tmp_path):
    folder = write(tmp_path / "r", SPEED, VECTORS)
    assert recording_kind(folder) == "orders"
    assert load_any(folder).runs[0].id == "up"
    with pytest.raises(RotorsimError) as error:
        load_recording(folder)
    [problem] = error.value.problems
    assert problem.what == "these are orders over the speed, not samples in time"
    hint = "'identify', 'diagnose', 'run --input' and 'check' take them"
    assert (problem.place.line, problem.hint) == (2, hint)


def test_the_schema_names_the_keys_that_are_read(tmp_path):
    folder = write(tmp_path / "r", SPEED, VECTORS)
    from importlib import resources

    schema = json.loads((resources.files("rotorsim.recordings") / "orders.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert set(schema["properties"]) == set(orders.ORDER_KEYS["recording"])
    assert set(schema["$defs"]["channel"]["properties"]) == set(orders.ORDER_KEYS["channel"])
    assert set(schema["$defs"]["run"]["properties"]) == set(orders.ORDER_KEYS["run"])
    jsonschema.Draft202012Validator(schema).validate(json.loads((folder / "recording.json").read_text()))
