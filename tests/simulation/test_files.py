"""Files of results: read back equal to the last bit, FMPy's own writer and reader as judges."""

import csv
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from fmpy.util import read_csv, write_csv
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rotorsim.errors import RotorsimError
from rotorsim.files import atomic_target
from rotorsim.simulation.files import load_result, save
from rotorsim.simulation.result import Result
from tests.simulation.test_result import made, nodes, text_of

SUFFIXES = (".csv", ".h5", ".npz")


def diverged() -> Result:
    values = np.array([1.0, -1e300, np.inf, np.nan])
    return Result(np.arange(4.0), {"a.b": values}, {"a.b": "N"}, "diverged", "state 'q' grows", {"steps": 4}, {})


def sub() -> Result:
    return Result(np.arange(3.0), {"sub/gain.output": np.ones(3), "sub/gain.input": np.zeros((3, 1))}, {})


def empty() -> Result:
    return Result(np.empty(0), {"a.b": np.empty((0, 2))}, {"a.b": "m"}, "stopped")


def only_time() -> Result:
    return Result(np.arange(3.0), {}, {})


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".CSV"])
@pytest.mark.parametrize("make", [made, nodes, diverged, sub, empty, only_time])
def test_files_are_read_back_equal_to_the_last_bit(tmp_path, suffix, make):
    path = tmp_path / f"run{suffix}"
    result = replace(make(), units=dict.fromkeys(make().signals, "m"))
    save(result, path)
    assert load_result(path) == result


def test_numbers_of_numpy_in_counters_and_provenance_stay_numbers(tmp_path):
    counters = {"steps": np.int64(3), "seconds": np.float64(0.5)}
    for suffix in SUFFIXES:
        save(replace(made(), counters=counters, provenance={"set": np.arange(2.0)}), tmp_path / f"r{suffix}")
        found = load_result(tmp_path / f"r{suffix}")
        assert dict(found.counters) == {"steps": 3, "seconds": 0.5}
        assert dict(found.provenance) == {"set": [0.0, 1.0]}


def table_of(result: Result) -> np.ndarray:
    """Return a result as FMPy has it: a structured array."""
    table = np.zeros(len(result.time), [(name, float) for name in ("time", *result.flat_names())])
    for name in table.dtype.names:
        table[name] = result[name]
    return table


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(), min_size=2, max_size=20))
def test_csv_is_byte_for_byte_that_of_fmpy_and_keeps_every_number(values):
    result = Result(np.arange(float(len(values))), {"a.b": np.array(values)}, {"a.b": "N"})
    with tempfile.TemporaryDirectory() as folder:
        ours, fmpy = Path(folder) / "ours.csv", Path(folder) / "fmpy.csv"
        save(result, ours)
        write_csv(fmpy, table_of(result))
        assert ours.read_bytes() == fmpy.read_bytes()
        assert load_result(ours) == result


@pytest.mark.parametrize("make", [made, nodes])
def test_csv_of_arrays_is_byte_for_byte_that_of_fmpy(tmp_path, make):
    save(make(), tmp_path / "ours.csv")
    write_csv(tmp_path / "fmpy.csv", table_of(make()))
    assert (tmp_path / "ours.csv").read_bytes() == (tmp_path / "fmpy.csv").read_bytes()


def test_csv_is_whole_across_the_pieces_it_is_written_in(tmp_path):
    result = made(n=10_000)
    save(result, tmp_path / "run.csv")
    assert load_result(tmp_path / "run.csv") == result


def test_fmpy_reads_our_csv(tmp_path):
    result = made()
    save(result, tmp_path / "run.csv")
    table = read_csv(tmp_path / "run.csv")
    assert table.dtype.names == ("time", "rotor.displacement[1]", "rotor.displacement[2]", "clock.theta")
    assert np.array_equal(table["rotor.displacement[2]"], result["rotor.displacement[2]"])


def test_readers_that_know_quotes_read_matrix_entries(tmp_path):
    save(nodes(), tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["rotor.displacement[3,1]"]) for row in rows] == nodes()["rotor.displacement[3,1]"].tolist()


def test_the_side_file_has_units_and_provenance(tmp_path):
    save(made(), tmp_path / "run.csv")
    meta = json.loads((tmp_path / "run.csv.meta.json").read_text())
    assert meta["signals"]["rotor.displacement"] == {"unit": "m", "shape": [2]}
    assert meta["provenance"] == {"diagram": "test"}


def test_hdf5_datasets_have_units(tmp_path):
    save(made(), tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as file:
        assert file["time"].attrs["unit"] == "s"
        assert file["signals/rotor.displacement"].attrs["unit"] == "m"
        assert list(file["signals"]) == ["rotor.displacement", "clock.theta"]


@pytest.mark.parametrize("make", [made, nodes])
def test_a_csv_without_side_file_is_read_by_its_names(tmp_path, make):
    write_csv(tmp_path / "other.csv", table_of(make()))
    found = load_result(tmp_path / "other.csv")
    assert list(found.signals) == list(make().signals)
    assert all(np.array_equal(found[name], make()[name]) for name in found.signals)
    assert found.message == "read without other.csv.meta.json: units and what was run are not known"


def test_columns_that_are_no_whole_array_stay_apart(tmp_path):
    (tmp_path / "some.csv").write_text('"time","a[2]","b"\n0.0,1.0,2.0\n1.0,3.0,4.0\n')
    found = load_result(tmp_path / "some.csv")
    assert list(found.signals) == ["a[2]", "b"]
    assert found["a[2]"].tolist() == [1.0, 3.0]


KILLED = """
import os, sys
import numpy as np
import rotorsim.simulation.files as files
from rotorsim.simulation.result import Result
seen = 0
def last_row(values):
    global seen
    seen += 1
    if seen > 5000:
        os._exit(9)  # as a power cut: nothing is tidied up
    return "0.0"
files.repr = last_row
files.save(Result(np.arange(6000.0), {}, {}), sys.argv[1])
"""


def test_a_killed_writer_leaves_the_old_file_whole(tmp_path):
    save(made(), tmp_path / "run.csv")
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "run.csv")], check=False)
    assert done.returncode == 9
    assert load_result(tmp_path / "run.csv") == made()


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("old")

    def write_half() -> None:
        with atomic_target(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["run.csv"]


def test_a_side_file_that_cannot_be_written_leaves_no_other_beside_new_numbers(tmp_path, monkeypatch):
    save(made(), tmp_path / "run.csv")

    def interrupted(path: Path, text: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rotorsim.simulation.files.write_atomically", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save(made(seed=1), tmp_path / "run.csv")
    assert os.listdir(tmp_path) == ["run.csv"]


def test_file_errors_say_what_is_expected(tmp_path):
    hint = "hint: one of .csv, .h5, .npz"
    for name, text in (
        ("run.xls", f"/run.xls: error: unknown format '.xls'\n\n{hint}"),
        ("run", f"/run: error: the name has no suffix that says the format\n\n{hint}"),
        ("no/run.csv", "/no: error: folder does not exist\n\nhint: create it first"),
    ):
        assert text_of(lambda name=name: save(made(), tmp_path / name)) == f"{tmp_path}{text}"
    assert text_of(lambda: load_result(tmp_path / "run.csv")) == (
        f"{tmp_path}/run.csv: error: file does not exist\n\nhint: `rotorsim run ... --out FILE`"
    )


def test_files_of_others_are_refused_in_words(tmp_path):
    def saying(name: str) -> str:
        text = text_of(lambda: load_result(tmp_path / name))
        start = f"{tmp_path}/{name}: error: not a result of rotorsim: "
        assert text.startswith(start)
        return text.removeprefix(start).removesuffix("\n\nhint: `rotorsim run ... --out FILE` writes one")

    (tmp_path / "broken.npz").write_bytes(b"not a zip")
    (tmp_path / "broken.h5").write_bytes(b"not hdf5")
    (tmp_path / "broken.csv").write_text('"time","a"\n0.0,x\n')
    (tmp_path / "column.csv").write_text('"t","a"\n0.0,1.0\n')
    (tmp_path / "empty.csv").write_text("")
    for name in ("broken.npz", "broken.h5", "broken.csv", "empty.csv"):
        assert "\n" not in saying(name)
    assert saying("column.csv") == "ValueError: the first column is 't', not 'time'"
    save(made(), tmp_path / "run.csv")
    other = (tmp_path / "run.csv").read_text().replace("clock.theta", "clock.phi")
    (tmp_path / "run.csv").write_text(other)
    assert saying("run.csv") == "ValueError: its columns are not those that run.csv.meta.json names"


@given(st.sampled_from(SUFFIXES), st.binary(max_size=200))
@example(".npz", b"PK\x05\x06")  # np.load would leave it open
@settings(max_examples=40, deadline=None)
def test_any_bytes_are_refused_without_a_traceback(suffix, data):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"any{suffix}"
        path.write_bytes(data)
        with pytest.raises(RotorsimError):
            load_result(path)
