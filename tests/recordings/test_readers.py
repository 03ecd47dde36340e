"""Data files: every format gives the same numbers, and what is wrong is said with its place."""

from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.readers import reader
from rotorsim.recordings.readers.columns import READERS, read_columns
from tests.recordings.made import document, run, samples, write
from tests.recordings.tables import TABLE, WRITERS, refused


@pytest.mark.parametrize("name", list(WRITERS))
def test_all_formats_give_the_same_numbers(tmp_path, name):
    WRITERS[name](tmp_path / name, TABLE)
    found = read_columns(tmp_path / name, ["y", "x"], "t")
    assert list(found) == ["y", "x", "t"]
    for column, values in found.items():
        assert values.dtype == float
        np.testing.assert_array_equal(values, TABLE[column])


@pytest.mark.parametrize("name", list(WRITERS))
def test_a_column_that_is_missing_has_a_near_miss(tmp_path, name):
    WRITERS[name](tmp_path / name, {"disp_x": TABLE["x"], "t": TABLE["t"]})
    assert refused(tmp_path / name, ["disp_y", "Disp_X"], "t") == [
        "data: error: no column 'disp_y'\n\nhint: did you mean 'disp_x'?",
        "data: error: no column 'Disp_X'\n\nhint: did you mean 'disp_x'?",
    ]


@pytest.mark.parametrize("name", [name for name in WRITERS if not name.lower().endswith("csv")])
def test_columns_that_differ_in_length(tmp_path, name):
    WRITERS[name](tmp_path / name, {"x": np.zeros(3), "y": np.zeros(4)})
    hint = "columns of one run must be sampled together; put others into a run of their own"
    assert refused(tmp_path / name, ["x", "y"]) == [f"data: error: columns differ in length: x 3, y 4\n\nhint: {hint}"]


@pytest.mark.parametrize("suffix", READERS)
def test_empty_and_damaged_files_end_with_a_message(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"")
    assert refused(path, ["x"]) == ["data: error: file is empty"]
    for content in (b"\x00\xff\xfe\x80" * 300, b"PK\x03\x04" + bytes(500), b"\x89HDF\r\n\x1a\n" + bytes(900)):
        path.write_bytes(content)
        assert len(refused(path, ["x"])) == 1


@pytest.mark.parametrize("name", ["a.npz", "b.npz", "a.mat", "73.mat", "a.h5"])
def test_a_file_cut_off_ends_with_a_message(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path, TABLE)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    assert len(refused(path, ["x", "y"])) >= 1


def test_other_formats_are_named(tmp_path):
    (tmp_path / "a.wav").write_bytes(b"x")
    (tmp_path / "a").write_bytes(b"x")
    known = ".csv, .npz, .mat, .h5, .hdf5, .tdms, .uff, .unv, .mf4"
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
    ("suffix", "package"), [(".tdms", "npTDMS"), (".uff", "pyuff"), (".unv", "pyuff"), (".mf4", "asammdf")]
)
def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch, suffix, package):
    def missing(module):
        raise ImportError(module)

    monkeypatch.setattr(reader, "import_module", missing)
    (tmp_path / f"a{suffix}").write_bytes(b"x")
    assert refused(tmp_path / f"a{suffix}", ["x"]) == [
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
        ("run1.npz", "no column 'x'", "did you mean 'ix'?"),
        ("run2.npz", "no column 'iy'", "did you mean 'y'?"),
    ]
