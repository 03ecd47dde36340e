"""Data files: every format gives the same numbers, and what is wrong is said with its place."""

import json
from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.readers import reader
from rotorsim.recordings.readers.columns import READERS, read_columns
from tests.recordings.made import document, run, samples, write
from tests.recordings.tables import TABLE, WRITERS, formats, refused, suffix

ROOT = Path(__file__).parents[2]


@formats()
def test_all_formats_give_the_same_numbers(tmp_path, name):
    WRITERS[name](tmp_path / name, TABLE)
    found = read_columns(tmp_path / name, ["y", "x"], "t")
    assert list(found) == ["y", "x", "t"]
    for column, values in found.items():
        assert values.dtype == float
        np.testing.assert_array_equal(values, TABLE[column])


@formats()
def test_a_column_that_is_missing_has_a_near_miss(tmp_path, name):
    WRITERS[name](tmp_path / name, {"disp_x": TABLE["x"], "t": TABLE["t"]})
    texts = refused(tmp_path / name, ["disp_y", "Disp_X"], "t")
    place = "data:1:1" if suffix(name) == ".csv" else "data"
    for text, column in zip(texts, ("disp_y", "Disp_X"), strict=True):
        what, _, there = text.partition(" the file has ")
        assert what.split(" or ")[0].rstrip("?") == (
            f"{place}: error: no column '{column}'\n\nhint: did you mean 'disp_x'"
        )
        assert {"disp_x", "t"} <= set(there.split(", "))


@formats(name for name in WRITERS if READERS[suffix(name)].counted)
def test_columns_that_differ_in_length(tmp_path, name):
    WRITERS[name](tmp_path / name, {"x": np.zeros(3), "y": np.zeros(4)})
    hint = "columns of one run must be sampled together; put others into a run of their own"
    assert refused(tmp_path / name, ["x", "y"]) == [f"data: error: columns differ in length: x 3, y 4\n\nhint: {hint}"]


@pytest.mark.slow
@pytest.mark.parametrize("ending", READERS)
def test_empty_and_damaged_files_end_with_a_message(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    path.write_bytes(b"")
    assert refused(path, ["x"]) == [
        "data: error: file is empty\n\nhint: it should hold the samples of a run: record or copy it again"
    ]
    for content in (b"\x00\xff\xfe\x80" * 300, b"PK\x03\x04" + bytes(500), b"\x89HDF\r\n\x1a\n" + bytes(900)):
        path.write_bytes(content)
        assert len(refused(path, ["x"])) == 1


@pytest.mark.slow
@formats()
def test_a_file_that_was_cut_off_is_refused_or_has_the_first_samples(tmp_path, name, capfd):
    """Never others; without a sample count in the format the rest cannot be missed."""
    path = tmp_path / name
    table = {column: np.arange(40.0) / 7 + k for k, column in enumerate("txy")}
    WRITERS[name](path, table)
    content = path.read_bytes()
    for cut in [*(len(content) * k // 4 for k in range(1, 4)), len(content) - 4, len(content) - 1]:
        path.write_bytes(content[:cut])
        try:
            found = read_columns(path, list(table), shown="data")
        except RotorsimError:
            continue
        count = len(found["x"])
        assert count == 40 or not READERS[suffix(name)].counted, f"read as a shorter one: {cut} of {len(content)}"
        for column, values in found.items():
            np.testing.assert_array_equal(values, table[column][:count])
    assert capfd.readouterr().err == ""


def test_every_format_has_a_writer():
    assert {suffix(name) for name in WRITERS} == set(READERS)


def test_every_suffix_is_in_the_schema_and_in_the_page():
    schema = json.loads((ROOT / "rotorsim/recordings/recording.schema.json").read_text())
    assert schema["$defs"]["run"]["properties"]["file"]["description"].endswith(": " + " ".join(READERS))
    table = (ROOT / "docs/recordings.md").read_text().partition("| suffix |")[2].partition("\n\n")[0]
    assert [ending for ending in READERS if f"`{ending}`" not in table] == []


def test_other_formats_are_named(tmp_path):
    (tmp_path / "a.wav").write_bytes(b"x")
    (tmp_path / "a").write_bytes(b"x")
    known = ", ".join(READERS)
    assert refused(tmp_path / "a.wav", ["x"]) == [f"data: error: unknown format '.wav'\n\nhint: one of {known}"]
    assert refused(tmp_path / "a", ["x"]) == [
        f"data: error: the name has no suffix that says the format\n\nhint: one of {known}"
    ]


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    path = tmp_path / "a.csv"
    with path.open("wb") as stream:
        stream.truncate(reader.MAX_RECORDING_BYTES + 1)  # takes no room on the disk
    assert refused(path, ["x"]) == ["data: error: file is larger than 2 GB\n\nhint: split it into several runs"]


@pytest.mark.parametrize(
    ("ending", "package"), [(".tdms", "npTDMS"), (".uff", "pyuff"), (".unv", "pyuff"), (".mf4", "asammdf")]
)
def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch, ending, package):
    def missing(module):
        raise ImportError(module)

    monkeypatch.setattr(reader, "import_module", missing)
    (tmp_path / f"a{ending}").write_bytes(b"x")
    assert refused(tmp_path / f"a{ending}", ["x"]) == [
        f"data: error: reading this format needs the package {package}\n\nhint: pip install {package}"
    ]


def test_warnings_and_mistakes_of_all_runs_are_collected(tmp_path):
    two = document(run(), run(id="run2", file="run2.npz"))
    tables = {"run1.npz": samples(), "run2.npz": samples()}
    tables["run2.npz"]["x"][7] = np.nan
    found = load_recording(write(tmp_path, two, tables))
    assert [str(warning) for warning in found.warnings] == [
        f"{tmp_path / 'run2.npz'}: warning: column x: 1 of 5000 values are not finite, the first is sample 8"
    ]
    del tables["run1.npz"]["x"], tables["run2.npz"]["iy"]
    with pytest.raises(RotorsimError) as error:
        load_recording(write(tmp_path, two, tables))
    assert [(Path(p.place.file).name, p.what, p.hint) for p in error.value.problems] == [
        ("run1.npz", "no column 'x'", "did you mean 'ix'? the file has y, ix, iy"),
        ("run2.npz", "no column 'iy'", "did you mean 'y'? the file has x, y, ix"),
    ]
