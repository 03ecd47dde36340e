"""recording.json: what is read, and every mistake at its place."""

import json
import os
import pickle
from importlib import resources
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.diagram.parse.source import Source, parse_document
from rotorsim.errors import Problem, RotorsimError
from rotorsim.measure.checks import check_signals
from rotorsim.recordings.document import RECORDING_KEYS, parse_recording
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.recording import Recording
from tests.recordings.made import CHANNELS, SHARED, SPEED, document, load, run, samples, write

SCHEMA = json.loads((resources.files("rotorsim.recordings") / "recording.schema.json").read_text(encoding="utf-8"))


def problems(folder: Path, data) -> list[str]:
    """Return what is wrong with a document, as line:column: subject: what | hint."""
    with pytest.raises(RotorsimError) as error:
        load(folder, data, {"run1.npz": samples()})
    found = []
    for problem in error.value.problems:
        assert problem.place.file.startswith(str(folder))
        assert problem.severity == "error"
        subject = f"{problem.subject}: " if problem.subject else ""
        found.append(f"{subject}{problem.what} | {problem.hint}")
    return found


def test_a_recording_says_what_was_measured(tmp_path):
    channels = {
        "s1": {"signal": "rotor.displacement", "axis": "y", "node": 3, "unit": "um"},
        "s2": {"signal": "rotor.acceleration", "axis": "x", "position": "50 mm", "unit": "m/s^2", "coupling": "ac"},
        "angle": {"signal": "clock.theta", "unit": "rev"},
        "pulse": {"signal": "tacho", "unit": "mV"},
        "u": {"signal": "drive.output", "unit": "V"},
        "q": {"signal": "plant.state[4]", "unit": "1"},
        "z": {"signal": "sub/rotor.displacement", "axis": "x", "unit": "mil"},
    }
    table = {column: np.arange(4.0) for column in channels}
    found = load(
        tmp_path,
        document(
            run(
                sample_rate="5 kHz",
                speed="1500 rpm",
                tacho=["2 ms", 0.004],
                use="hold_out",
                set={"controller.KP": "12 kA/m", "speed": 3, "rotor.gains": [[1, 2]], "crack.opening": "switching"},
            ),
            channels=channels,
        ),
        {"run1.npz": table},
    )
    assert [channel.name for channel in found.channels.values()] == [
        "rotor.displacement[3,2]",
        "rotor.acceleration[0.05 m,1]",
        "clock.theta",
        "tacho",
        "drive.output",
        "plant.state[4]",
        "sub/rotor.displacement[1]",
    ]
    assert found.channels["s2"].position == 0.05
    assert [found.channels[c].coupling for c in ("s1", "s2")] == ["dc", "ac"]
    one = found.runs[0]
    np.testing.assert_allclose(one.time, [0, 0.2e-3, 0.4e-3, 0.6e-3], rtol=1e-14)
    np.testing.assert_array_equal(one.values["s1"], [0, 1e-6, 2e-6, 3e-6])
    np.testing.assert_allclose(one.values["angle"], 2 * np.pi * np.arange(4), rtol=1e-15)
    np.testing.assert_allclose(one.values["z"], 25.4e-6 * np.arange(4), rtol=1e-15)
    assert one.speed == pytest.approx(50 * np.pi, rel=1e-15)
    assert one.tacho.tolist() == [0.002, 0.004]
    assert one.settings == {
        "controller.KP": "12 kA/m",
        "speed": 3,
        "rotor.gains": [[1, 2]],
        "crack.opening": "switching",
    }
    assert (one.id, one.use, one.sample_rate, one.file) == ("run1", "hold_out", 5000.0, str(tmp_path / "run1.npz"))
    lines = (tmp_path / "recording.json").read_text().splitlines()
    assert (one.place.line, one.place.column) == (lines.index("  {") + 1, 3)
    assert found.column("rotor.displacement[3,2]") == "s1"
    assert found.column("rotor.displacement[3,1]") is None
    assert found.signal(one, "drive.output") is one.values["u"]
    assert found.select("hold_out") == (one,)
    assert found.select("identify") == ()


def test_a_channel_that_a_run_lacks_is_named(tmp_path):
    short = {column: values for column, values in samples().items() if column != "iy"}
    folder = write(
        tmp_path,
        document(run(), run(id="b", file="b.npz", not_measured=["iy"])),
        {"run1.npz": samples(), "b.npz": short},
    )
    found = load_recording(folder)
    assert [sorted(one.values) for one in found.runs] == [["ix", "iy", "x", "y"], ["ix", "x", "y"]]


def test_channels_that_a_run_cannot_lack(tmp_path):
    data = document(run(not_measured=["iz", 3]), run(id="b", not_measured=["x", "y", "ix", "iy"]))
    assert problems(tmp_path, data) == [
        'run1: not_measured: "iz" is no channel | known: ix, iy, x, y',
        "run1: not_measured: 3 is no channel | known: ix, iy, x, y",
        "b: not_measured: nothing is left of this run | leave the run out",
    ]


def test_nothing_in_a_recording_can_be_changed(tmp_path):
    found = load(tmp_path, document())
    with pytest.raises(AttributeError):
        found.name = "other"
    with pytest.raises(TypeError):
        found.channels["x"] = None
    with pytest.raises(TypeError):
        found.runs[0].values["x"] = None
    with pytest.raises(TypeError):
        found.runs[0].settings["controller.KP"] = 1.0
    for array in (found.runs[0].time, found.runs[0].tacho, found.runs[0].values["x"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_a_recording_travels_between_processes(tmp_path):
    found = load(tmp_path, document())
    other: Recording = pickle.loads(pickle.dumps(found))
    assert other.channels == found.channels
    assert other.runs[0].settings == found.runs[0].settings
    assert other.runs[0].place == found.runs[0].place
    np.testing.assert_array_equal(other.runs[0].values["x"], found.runs[0].values["x"])
    with pytest.raises(ValueError, match="read-only"):
        other.runs[0].values["x"][0] = 1.0


def test_the_folder_or_its_file_may_be_named(tmp_path):
    write(tmp_path, document())
    for path in (tmp_path, str(tmp_path), tmp_path / "recording.json"):
        assert load_recording(path).runs[0].id == "run1"


def test_samples_may_be_left_unread(tmp_path):
    found = load_recording(write(tmp_path, document()), read=False)
    assert found.runs[0].time.shape == (0,)
    assert dict(found.runs[0].values) == {}
    assert found.runs[0].speed == SPEED


def test_a_time_column_of_all_runs_and_of_one(tmp_path):
    table = {column: np.arange(3.0) for column in CHANNELS}
    tables = {
        "run1.npz": {**table, "t": np.array([5.0, 5.1, 5.2])},
        "run2.npz": {**table, "s": np.array([1.0, 2.0, 4.0])},
    }
    both = document(run(sample_rate=None), run(id="run2", file="run2.npz", time="s", sample_rate=None), time="t")
    found = load(tmp_path, both, tables)
    assert found.runs[0].time.tolist() == [5.0, 5.1, 5.2]
    assert found.runs[1].time.tolist() == [1.0, 2.0, 4.0]


def test_all_mistakes_are_said_at_once(tmp_path):
    text = """{
 "name": "n",
 "sorce": "s",
 "channels": {
  "x": {"signal": "rotor", "axis": "z", "unit": "um/"},
  "y": {"signal": "rotor.displacement", "node": 0, "axis": "Y", "unit": "mete"},
  "theta": {"signal": "theta", "unit": "rad"},
  "angle": {"signal": "clock.theta", "unit": "m", "coupling": "AC"},
  "a": {"signal": "a.b[1]", "axis": "x", "unit": "m"},
  "c": {"signal": "c.d", "unit": "m", "position": "3 kg"},
  "d": {"signal": "c.d", "unit": 3},
  "e": 3
 },
 "runs": [
  {"id": "r", "file": "run1.npz", "speed": "15 Nm", "use": "identfy"},
  {"id": "r", "file": "run2.npz", "sample_rate": "5000 rpm", "tacho": [1, "x"]},
  {"id": "a/b", "file": "run1.npz", "sample_rate": -1, "sett": {}},
  {"file": 3, "sample_rate": 1e99, "set": {"a b": 3, "c": null, "d": []}, "time": null, "tacho": 3},
  []
 ]
}"""
    write(tmp_path, text, {"run1.npz": samples()})
    with pytest.raises(RotorsimError) as error:
        load_recording(tmp_path)
    found = [(p.place.line, p.place.column, p.subject, p.what, p.hint) for p in error.value.problems]
    near_setting = "write block.parameter or the name of a diagram parameter"
    assert found == [
        (1, 1, "", "key 'source' is missing", '"source": "measured 2024-05-01 on ..."'),
        (3, 2, "", "unknown key 'sorce'", "did you mean 'source'?"),
        (5, 19, "channel x", "'rotor' is not a signal", "write block.port, as in 'rotor.displacement'"),
        (5, 36, "channel x", "axis 'z' is not known", "known: x, y"),
        (5, 49, "channel x", "'um/' is not a unit: nothing follows '/'", ""),
        (6, 49, "channel y", "node 0: nodes are counted from 1", ""),
        (6, 60, "channel y", "axis 'Y' is not known", "did you mean 'y'?"),
        (6, 73, "channel y", "unknown unit 'mete'", KNOWN_UNITS),
        (7, 23, "channel theta", "'theta' is not a signal", "the shaft angle is 'clock.theta'"),
        (8, 46, "channel angle", "unit 'm' is not one of an angle", "give rad, deg or rev"),
        (8, 63, "channel angle", "coupling 'AC' is not known", "did you mean 'ac'?"),
        (9, 19, "channel a", "'a.b[1]' names an entry already", "leave out axis, node and position, or the index"),
        (10, 51, "channel c", "position: unit 'kg' does not fit 'm'", "give it in m"),
        (11, 34, "channel d", "'unit' must be a text", ""),
        (12, 8, "channel e", "must be an object {...}", EXAMPLE_CHANNELS),
        (15, 3, "r", "neither sample_rate nor time", NO_TIME),
        (15, 44, "r", "speed: unknown unit 'Nm'", "did you mean 'N m'? (a space multiplies)"),
        (15, 60, "r", "use 'identfy' is not known", "did you mean 'identify'?"),
        (16, 10, "r", "run 1 has the same id", "every run needs an id of its own"),
        (16, 23, "r", "file 'run2.npz' does not exist or cannot be read", "did you mean 'run1.npz'?"),
        (16, 50, "r", "sample_rate: '5000 rpm' is not in Hz", IN_HZ),
        (16, 75, "r", "tacho: 'x' is not a quantity", "write a number and a unit, such as '24 um' or '1500 rpm'"),
        (17, 10, "run 3", "the id is empty, too long or has one of / \\ or a control character", ""),
        (17, 52, "run 3", "sample_rate: -1 Hz is not between 1e-06 and 1e+12 Hz", IN_HZ),
        (17, 56, "run 3", "unknown key 'sett'", "did you mean 'set'?"),
        (18, 3, "run 4", "key 'id' is missing", '"id": "run1"'),
        (18, 12, "run 4", "'file' must be a text", ""),
        (18, 30, "run 4", "sample_rate: 1e+99 Hz is not between 1e-06 and 1e+12 Hz", IN_HZ),
        (18, 44, "run 4", "set: 'a b' is not a parameter", near_setting),
        (18, 59, "run 4", "set: c must be a number, a text such as '12 N/A', true or false, or a list of those", ""),
        (18, 70, "run 4", "set: d must be a number, a text such as '12 N/A', true or false, or a list of those", ""),
        (18, 83, "run 4", "'time' must be a text", ""),
        (18, 98, "run 4", "'tacho' must be a list [...]", ""),
        (19, 3, "run 5", "must be an object {...}", EXAMPLE_RUNS),
    ]


EXAMPLE_CHANNELS = '"channels": {"x": {"signal": "rotor.displacement", "axis": "x", "unit": "um"}}'
EXAMPLE_RUNS = '"runs": [{"id": "run1", "file": "run1.csv", "sample_rate": "5000 Hz"}]'
NO_TIME = 'give "sample_rate": "5000 Hz", or "time": the name of the time column'
KNOWN_UNITS = (
    "known: %, A, C, F, H, Hz, J, K, N, Ohm, Pa, T, V, W, Wb, bar, cd, deg, g, h, in, lb, lbf, m, "
    "mil, min, mol, rad, rev, rpm, s, with prefixes n u m k M G"
)
IN_HZ = "write it in Hz, as in '5000 Hz'"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"channels": {}}, f"channels: names no channel | {EXAMPLE_CHANNELS}"),
        ({"channels": []}, "'channels' must be an object {...} | "),
        ({"channels": None}, f"key 'channels' is missing | {EXAMPLE_CHANNELS}"),
        ({"runs": []}, f"runs: names no run | {EXAMPLE_RUNS}"),
        ({"runs": {"run1": {}}}, "'runs' must be a list [...] | "),
        ({"runs": [3]}, f"run 1: must be an object {{...}} | {EXAMPLE_RUNS}"),
        ({"name": 3}, "'name' must be a text | "),
        ({"name": None}, 'key \'name\' is missing | "name": "test rig"'),
        ({"time": "x"}, 'channel x: the time column is no channel | the time column is named by "time": "x" alone'),
        (
            {"channels": {**CHANNELS, "x2": CHANNELS["x"]}},
            "channel x2: measures rotor.displacement[1], and so does 'x' | "
            "separate them by axis, node or position, or leave one out",
        ),
    ],
)
def test_mistakes_of_the_document(tmp_path, changes, expected):
    data = document()
    for key, value in changes.items():
        if value is None:
            del data[key]
        else:
            data[key] = value
    assert problems(tmp_path, data) == [expected]


@pytest.mark.parametrize("text", ["[]", "3", "null", '"x"'])
def test_a_recording_is_an_object(tmp_path, text):
    write(tmp_path, text, {})
    with pytest.raises(RotorsimError, match=r"recording.json:1:1: error: a recording is a JSON object"):
        load_recording(tmp_path)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('{"a": NaN}', "NaN"),
        ('{"a": 1e999}', "1e999"),
        ('{"a": 1, "a": 2}', "key 'a' is given twice"),
        ('{"a": ', ""),
        ("[" * 100 + "]" * 100, "nested deeper"),
        ('{"a": ' + "9" * 400 + "}", ""),
    ],
)
def test_json_that_is_refused(tmp_path, text, what):
    write(tmp_path, text, {})
    with pytest.raises(RotorsimError, match=r"recording\.json:1:") as error:
        load_recording(tmp_path)
    assert what in str(error.value)


def test_numbers_too_large_for_a_float_are_refused():
    data = document(run(set={"a.b": 10**400}, speed=10**400, tacho=[10**400], sample_rate=10**400))
    with pytest.raises(RotorsimError) as error:
        parse_recording(Source(data, file="made"), Path("."), files=False)
    assert [problem.what for problem in error.value.problems] == [
        "sample_rate: must be a finite number",
        "speed: must be a finite number",
        "tacho: must be a finite number",
        "set: a.b must be a number, a text such as '12 N/A', true or false, or a list of those",
    ]


def test_a_folder_without_recording(tmp_path):
    with pytest.raises(RotorsimError, match=r"recording.json: error: file does not exist\n\nhint: a recording is"):
        load_recording(tmp_path)
    with pytest.raises(RotorsimError, match="nowhere: error: file does not exist"):
        load_recording(tmp_path / "nowhere")
    with pytest.raises(RotorsimError, match=r"file (cannot be read|does not exist)"):
        load_recording("a\0b")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "",
            "file is empty | a recording is a JSON object: "
            '{"name": ..., "source": ..., "channels": {...}, "runs": [...]}',
        ),
        ("[" * 70, "JSON is nested deeper than 64 levels | a recording needs no more than four"),
        (" " * 20_000_001, "file is larger than 20 MB | samples belong into data files"),
    ],
)
def test_hints_are_those_of_a_recording(tmp_path, text, expected):
    (tmp_path / "recording.json").write_text(text)
    with pytest.raises(RotorsimError) as error:
        load_recording(tmp_path)
    assert [f"{problem.what} | {problem.hint}" for problem in error.value.problems] == [expected]


OUTSIDE = "is not inside the folder of recording.json | name a file below that folder, such as 'data/run1.csv'"


@pytest.mark.parametrize(
    "file",
    [
        "../run1.npz",
        "a/../../run1.npz",
        "/etc/passwd",
        "C:\\run1.npz",
        "C:/run1.npz",
        "..\\run1.npz",
        "a//b.npz",
        "",
        "//server/run1.npz",
        "..",
        "sub/..",
    ],
)
def test_files_outside_the_folder_are_refused(tmp_path, file):
    folder = tmp_path / "recording"
    np.savez(tmp_path / "run1.npz", **samples())
    found = problems(folder, document(run(file=file)))
    assert found == [f"run1: file '{file}' {OUTSIDE}"]
    assert problems(folder, document(run(file="a\0.npz"))) == ["control character (\\u0000) | remove it"]


def test_links_out_of_the_folder_are_refused_and_links_inside_are_not(tmp_path):
    folder = write(tmp_path / "recording", document())
    np.savez(tmp_path / "out.npz", **samples())
    os.rename(folder / "run1.npz", folder / "real.npz")
    (folder / "run1.npz").symlink_to("real.npz")
    assert len(load_recording(folder).runs[0].time) == 5000
    (folder / "run1.npz").unlink()
    (folder / "run1.npz").symlink_to(tmp_path / "out.npz")
    with pytest.raises(RotorsimError, match=r"'run1\.npz' is not inside the folder"):
        load_recording(folder)
    (folder / "run1.npz").unlink()
    (folder / "run1.npz").symlink_to("run1.npz")
    with pytest.raises(RotorsimError, match=r"run1.npz' (cannot be found|does not exist)"):
        load_recording(folder)
    (folder / "run1.npz").unlink()
    (folder / "away").symlink_to(tmp_path)
    write(folder, document(run(file="away/out.npz")), {})
    with pytest.raises(RotorsimError, match=r"'away/out\.npz' is not inside the folder"):
        load_recording(folder)


def test_a_pipe_or_a_folder_is_no_data_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    (tmp_path / "sub.npz").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "b.csv").touch()
    (tmp_path / "full" / "a.csv").touch()
    both = document(run(file="pipe.npz"), run(id="2", file="sub.npz"), run(id="3", file="full"))
    assert problems(tmp_path, both) == [
        "run1: file 'pipe.npz' does not exist or cannot be read | ",
        "2: file 'sub.npz' is a folder | name a file in it, such as 'sub.npz/run1.csv'",
        "3: file 'full' is a folder | name a file in it, such as 'full/a.csv'",
    ]


# --- the schema ---------------------------------------------------------------------------------------------------


def test_the_schema_names_the_keys_that_are_read():
    schema = SCHEMA
    jsonschema.Draft202012Validator.check_schema(schema)
    assert set(schema["properties"]) == set(RECORDING_KEYS["recording"])
    assert set(schema["$defs"]["channel"]["properties"]) == set(RECORDING_KEYS["channel"])
    assert set(schema["$defs"]["run"]["properties"]) == set(RECORDING_KEYS["run"])


@pytest.mark.parametrize(
    "data",
    [
        document(run(unknown=3)),
        document(runs=[]),
        document(channels={}),
        document(channels={"x": {"signal": "x", "unit": "m"}}),
        document(channels={"x": {"signal": "a.x", "unit": "m", "axis": "z"}}),
        document(channels={"x": {"signal": "a.x", "unit": "m", "node": 0}}),
        document(run(use="both")),
        document(run(set={"a b": 3})),
        document(run(set={"a": []})),
        document(run(tacho=3)),
    ],
)
def test_schema_and_reader_refuse_the_same(tmp_path, data):
    assert not jsonschema.Draft202012Validator(SCHEMA).is_valid(data)
    assert problems(tmp_path, data)


def shared():
    return sorted(SHARED.rglob("recording.json"))


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
def test_the_shared_recordings_load_and_are_good():
    schema = jsonschema.Draft202012Validator(SCHEMA)
    for path in shared():
        schema.validate(json.loads(path.read_text()))
        found = load_recording(path.parent)
        assert found.warnings == ()
        for one in found.runs:
            assert one.time[0] == 0.0
            assert set(one.values) == set(found.channels)
            assert one.sample_rate * one.time[-1] == pytest.approx(len(one.time) - 1, rel=1e-12)
        codes = {problem.code for problem in check_signals(found)}
        if path.parent.name == "tum_amb_rotor":
            assert codes == {"missing_channel", "no_phase_reference"}  # one axis, at rest
        elif any(abs(values).max() > 1.0 for one in found.runs for c, values in one.values.items() if c in "xy"):
            assert codes <= {"wrong_unit"}  # a run that went unstable, or volts
        elif path.parent.parent.name.startswith("runup"):
            assert codes <= {"run_up"}
        else:
            assert codes == set()


WORDS = st.sampled_from(["x", "rotor.displacement", "um", "run1.npz", "identify", "1 Hz", "", "..", "é", "time", "\0"])
SCALARS = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False, allow_infinity=False), WORDS)
KEY = st.sampled_from([*RECORDING_KEYS["recording"], *RECORDING_KEYS["channel"], *RECORDING_KEYS["run"], "other", ""])
ANYTHING = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEY, inner, max_size=5))


@pytest.mark.slow
@settings(deadline=None)
@given(ANYTHING, st.sampled_from(["recording", "channel", "run"]), st.data())
def test_damaged_documents_end_with_a_message_and_never_with_a_traceback(value, part, choice):
    data = json.loads(json.dumps(document()))
    target = {"recording": data, "channel": data["channels"]["x"], "run": data["runs"][0]}[part]
    target[choice.draw(st.sampled_from([*RECORDING_KEYS[part], "other"]))] = value
    mistakes: tuple[Problem, ...] = ()
    try:
        source = parse_document(json.dumps(data), "recording.json")
        found = parse_recording(source, Path("nowhere"), files=False).recording
    except RotorsimError as error:
        mistakes = error.problems
    assert all(problem.what and problem.place.line for problem in mistakes)
    if not mistakes:
        assert found.runs
        assert all(channel.name for channel in found.channels.values())


def test_a_document_made_in_memory_has_mistakes_without_a_line():
    with pytest.raises(RotorsimError, match=r"^made: error: key 'runs' is missing"):
        parse_recording(Source({"name": "n", "source": "s", "channels": CHANNELS}, file="made"), Path("."))
