"""Results: access by name, files read back equal, FMPy's own reader as judge."""

import os
from pathlib import Path

import numpy as np
import pytest
from fmpy.util import read_csv
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.diagram.files import atomic_target
from rotorsim.errors import RotorsimError
from rotorsim.simulate.files import load_result, save
from rotorsim.simulate.result import Result


def made(n: int = 7, seed: int = 0) -> Result:
    rng = np.random.default_rng(seed)
    signals = {"rotor.displacement": rng.normal(size=(n, 2)) * 1e-6, "clock.theta": rng.normal(size=n)}
    units = {"rotor.displacement": "m", "clock.theta": "rad"}
    return Result(np.arange(n) * 1e-4, signals, units, "finished", "", {"steps": n}, {"diagram": "test"})


def nodes() -> Result:
    values = np.arange(24.0).reshape(4, 3, 2)
    return Result(np.arange(4.0), {"rotor.displacement": values}, {"rotor.displacement": "m"})


def same(a: Result, b: Result) -> bool:
    return (
        np.array_equal(a.time, b.time)
        and list(a.signals) == list(b.signals)
        and all(np.array_equal(a[name], b[name]) for name in a.signals)
        and dict(a.units) == dict(b.units)
        and (a.status, a.message, dict(a.counters), dict(a.provenance))
        == (b.status, b.message, dict(b.counters), dict(b.provenance))
    )


@pytest.mark.parametrize("suffix", [".csv", ".h5", ".npz"])
@pytest.mark.parametrize("result", [made(), nodes()])
def test_files_are_read_back_equal_to_the_last_bit(tmp_path, suffix, result):
    path = tmp_path / f"run{suffix}"
    save(result, path)
    assert same(load_result(path), result)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=20))
def test_csv_keeps_every_number(values):
    import tempfile

    result = Result(np.arange(float(len(values))), {"a.b": np.array(values)}, {"a.b": "N"})
    with tempfile.TemporaryDirectory() as folder:
        save(result, Path(folder) / "x.csv")
        assert same(load_result(Path(folder) / "x.csv"), result)


def test_fmpy_reads_our_csv(tmp_path):
    result = made()
    save(result, tmp_path / "run.csv")
    table = read_csv(tmp_path / "run.csv")
    assert table.dtype.names == ("time", "rotor.displacement[1]", "rotor.displacement[2]", "clock.theta")
    assert np.array_equal(table["rotor.displacement[2]"], result["rotor.displacement[2]"])


def test_flat_names_count_from_one_row_by_row():
    assert nodes().flat_names() == [f"rotor.displacement[{i},{j}]" for i in (1, 2, 3) for j in (1, 2)]
    assert np.array_equal(nodes()["rotor.displacement[3,1]"], nodes().signals["rotor.displacement"][:, 2, 0])
    assert nodes().complex("rotor.displacement[2]")[0] == 2 + 3j


def test_a_part_of_a_recorded_part_is_found():
    result = Result(np.arange(2.0), {"rotor.displacement[4]": np.array([[1.0, 2.0], [3.0, 4.0]])}, {})
    assert result["rotor.displacement[4,2]"].tolist() == [2.0, 4.0]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "rotor.displacemnt",
            "error: rotor.displacemnt: this signal was not recorded\n\nhint: did you mean 'rotor.displacement'?",
        ),
        (
            "rotor.displacement[3]",
            "error: rotor.displacement[3]: no such entry; 'rotor.displacement' has shape 2, counted from 1",
        ),
        (
            "rotor.displacement[0]",
            "error: rotor.displacement[0]: no such entry; 'rotor.displacement' has shape 2, counted from 1",
        ),
    ],
)
def test_wrong_names_are_explained(name, text):
    with pytest.raises(RotorsimError) as caught:
        made()[name]
    assert str(caught.value.problems[0]) == text


def test_results_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        made()["clock.theta"][0] = 1.0


def test_xarray_has_units_and_axes():
    data = made().to_xarray()
    assert data["rotor.displacement"].dims == ("time", "axis")
    assert data["rotor.displacement"].attrs["units"] == "m"
    assert data["rotor.displacement"].sel(axis="y").values.tolist() == made()["rotor.displacement[2]"].tolist()


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


def test_file_errors_say_what_is_expected(tmp_path):
    for path, text in (
        (tmp_path / "run.xls", f"{tmp_path}/run.xls: error: unknown format '.xls'\n\nhint: one of .csv, .h5, .npz"),
        (tmp_path / "no" / "run.csv", f"{tmp_path}/no: error: folder does not exist\n\nhint: create it first"),
    ):
        with pytest.raises(RotorsimError) as caught:
            save(made(), path)
        assert str(caught.value.problems[0]) == text
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"not a zip")
    with pytest.raises(RotorsimError) as caught:
        load_result(broken)
    assert str(caught.value.problems[0]).startswith(f"{broken}: error: not a result of rotorsim: ")
