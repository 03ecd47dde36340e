"""Archives of arrays (.npz, .mat, .h5): paths, matrices, and what hostile ones hold."""

import pickle
import time
import zipfile

import h5py
import numpy as np
import pytest
import scipy.io

from rotorsim.recordings.readers import reader
from rotorsim.recordings.readers.columns import read_columns
from tests.recordings.tables import TABLE, refused, write_h5, write_mat73


def test_a_column_of_a_matrix_and_a_path_in_the_file(tmp_path):
    matrix = np.arange(12.0).reshape(4, 3)
    np.savez(tmp_path / "a.npz", data=matrix)
    scipy.io.savemat(tmp_path / "a.mat", {"data": matrix, "rig": {"probe": {"x": np.arange(4.0)}}})
    write_mat73(tmp_path / "73.mat", {"data": matrix.T, "rig/probe/x": np.arange(4.0)})
    write_h5(tmp_path / "a.h5", {"data": matrix, "rig/probe/x": np.arange(4.0)})
    for name in ("a.npz", "a.mat", "73.mat", "a.h5"):
        assert read_columns(tmp_path / name, ["data[2]"])["data[2]"].tolist() == [1, 4, 7, 10]
        assert refused(tmp_path / name, ["data[4]", "data"]) == [
            "data: error: column 'data[4]' cannot be read: its array has shape (4, 3): no column 4",
            "data: error: column 'data' cannot be read: its array has shape (4, 3); name one column, as in 'data[1]'",
        ]
    for name in ("a.mat", "73.mat", "a.h5"):
        found = read_columns(tmp_path / name, ["rig.probe.x", "rig/probe/x"])
        assert [values.tolist() for values in found.values()] == [[0, 1, 2, 3]] * 2


def test_integers_and_single_precision_become_numbers(tmp_path):
    table = {"a": np.array([1, -2], np.int16), "b": np.array([1.5, 2.5], np.float32), "c": np.array([True, False])}
    np.savez(tmp_path / "a.npz", **table)
    found = read_columns(tmp_path / "a.npz", ["a", "b", "c"])
    assert {name: values.tolist() for name, values in found.items()} == {"a": [1, -2], "b": [1.5, 2.5], "c": [1, 0]}
    assert {values.dtype for values in found.values()} == {np.dtype(float)}


class Bomb:
    def __reduce__(self):
        return exec, ("raise SystemExit('a pickle was loaded')",)


@pytest.mark.slow
def test_pickles_are_never_loaded(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.array([Bomb()], dtype=object), y=np.zeros(1))
    assert refused(tmp_path / "a.npz", ["x", "y"]) == [
        "data: error: column 'x' cannot be read: it holds Python objects\n\n"
        "hint: save plain numbers: pickled objects are never read"
    ]
    (tmp_path / "b.npz").write_bytes(pickle.dumps(Bomb()))
    assert len(refused(tmp_path / "b.npz", ["x"])) == 1
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("x", pickle.dumps(Bomb()))
    assert len(refused(tmp_path / "c.npz", ["x"])) == 1


def test_what_is_no_real_number_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", text=np.array(["a"]), c=np.array([1j]), t=np.array(["2020-01-01"], "datetime64[s]"))
    assert refused(tmp_path / "a.npz", ["text", "c", "t"]) == [
        "data: error: column 'text' cannot be read: it holds <U1, not real numbers",
        "data: error: column 'c' cannot be read: it holds complex128, not real numbers",
        "data: error: column 't' cannot be read: it holds datetime64[s], not real numbers",
    ]


def test_links_out_of_an_h5_file_are_not_followed(tmp_path):
    write_h5(tmp_path / "out.h5", {"secret": np.arange(3.0)})
    np.arange(3.0).tofile(tmp_path / "raw.bin")
    layout = h5py.VirtualLayout(shape=(3,), dtype=float)
    layout[:] = h5py.VirtualSource(str(tmp_path / "out.h5"), "secret", shape=(3,))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = h5py.ExternalLink(str(tmp_path / "out.h5"), "secret")
        file["y"] = np.arange(3.0)
        file.create_virtual_dataset("v", layout)
        file.create_dataset("e", (3,), float, external=[(str(tmp_path / "raw.bin"), 0, 24)])
    assert read_columns(tmp_path / "a.h5", ["y"])["y"].tolist() == [0, 1, 2]
    for column in ("x", "v", "e"):
        assert refused(tmp_path / "a.h5", [column]) == [f"data: error: no column '{column}'\n\nhint: the file has y"]


def test_arrays_that_unpack_to_too_much_are_not_read(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", shape=(10**12,), dtype=float, chunks=(1000,))  # nothing is stored
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.npy", npy_header((10**12,)) + bytes(1000))
    assert refused(tmp_path / "a.h5", ["x"]) == ["data: error: column 'x' is larger than 2 GB"]
    assert len(refused(tmp_path / "a.npz", ["x"])) == 1


def test_columns_that_unpack_to_too_much_together_are_not_read(tmp_path, monkeypatch):
    """Four of 0.6 GB, of bytes or of doubles; a nested one of a .mat that says nothing of its size."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in "abcd":
            archive.writestr(f"{name}.npy", npy_header((75_000_000,)).replace(b"'<f8'", b"'|i1'") + bytes(1000))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in "abcd":
            file.create_dataset(name, shape=(75_000_000,), dtype="i1", chunks=(1000,))
    for name in ("a.npz", "a.h5"):
        assert refused(tmp_path / name, list("abcd")) == [
            "data: error: 4 columns take 2.4 GB, more than 2 GB\n\nhint: split it into several runs"
        ]
    scipy.io.savemat(tmp_path / "a.mat", {"run": {"inner": {"a": np.zeros(100_000)}}}, do_compression=True)
    assert len(read_columns(tmp_path / "a.mat", ["run/inner/a"])["run/inner/a"]) == 100_000
    monkeypatch.setattr(reader, "MAX_RECORDING_BYTES", 700_000)
    assert refused(tmp_path / "a.mat", ["run/inner/a"])[0].startswith("data: error: it unpacks to more than")


def test_groups_within_groups_take_no_time(tmp_path):
    """3000 of them: what is wanted is looked up, what is listed for near misses ends 20 deep and after 1000 names."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/x"] = TABLE["x"]
        inner = file.create_group("deep")
        for _ in range(3000):
            inner = inner.create_group("a")
        inner["x"] = TABLE["x"]
        file["loop"] = file["run"]
        file["run/again"] = file["run"]
    np.testing.assert_array_equal(read_columns(tmp_path / "a.h5", ["run.x"])["run.x"], TABLE["x"])
    before = time.process_time()
    (text,) = refused(tmp_path / "a.h5", ["run/y"])
    assert time.process_time() - before < 0.5
    assert text.startswith("data: error: no column 'run/y'\n\nhint: did you mean 'run/x'? the file has loop/x, run/x, ")
    assert text.endswith(", ...")
    assert text.count(", ") == 20
    (text,) = refused(tmp_path / "a.h5", ["deep/" + "a/" * 3000 + "x"])
    assert "no column 'deep/a/a/" in text


def npy_header(shape: tuple[int, ...]) -> bytes:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()
