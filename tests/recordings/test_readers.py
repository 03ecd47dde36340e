"""Data files: every format gives the same numbers, and what is wrong is said with its place."""

import importlib.util
import math
import pickle
import time
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.readers import reader
from rotorsim.recordings.readers.columns import READERS, read_columns
from tests.recordings.made import CHANNELS, document, run, samples, write

TABLE = {"t": np.arange(5) * 0.1, "x": np.array([1.0, -2.5, 1e-300, 0.1 + 0.2, 7e20]), "y": np.arange(5.0) / 3}


def write_csv(path: Path, table: dict[str, np.ndarray], delimiter: str = ",") -> None:
    rows = zip(*(array.tolist() for array in table.values()), strict=True)
    lines = [delimiter.join(table), *(delimiter.join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_h5(path: Path, table: dict[str, np.ndarray]) -> None:
    with h5py.File(path, "w") as file:
        for name, array in table.items():
            file[name] = array


def write_mat73(path: Path, table: dict[str, np.ndarray]) -> None:
    """Write what MATLAB writes with -v7.3: HDF5 behind a header of 512 bytes, columns as rows."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in table.items():
            file[name] = np.atleast_2d(array)
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    with path.open("r+b") as stream:
        stream.write(header)


WRITERS = {
    "a.csv": write_csv,
    "a.CSV": lambda path, table: write_csv(path, table, ";"),
    "b.csv": lambda path, table: write_csv(path, table, "\t"),
    "a.npz": lambda path, table: np.savez(path, **table),
    "b.npz": lambda path, table: np.savez_compressed(path, **table),
    "a.mat": lambda path, table: scipy.io.savemat(path, table),
    "b.mat": lambda path, table: scipy.io.savemat(path, table, do_compression=True, oned_as="column"),
    "73.mat": write_mat73,
    "a.h5": write_h5,
    "a.hdf5": write_h5,
}


def refused(path: Path, columns: list[str], time: str | None = None) -> list[str]:
    with pytest.raises(RotorsimError) as error:
        read_columns(path, columns, time, shown="data")
    return [str(problem) for problem in error.value.problems]


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
    assert text == "data: error: no column 'run/y'\n\nhint: did you mean 'run/x'?"
    (text,) = refused(tmp_path / "a.h5", ["deep/" + "a/" * 3000 + "x"])
    assert "no column 'deep/a/a/" in text


def npy_header(shape: tuple[int, ...]) -> bytes:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


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


# --- CSV ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "x,y\n1,2\n3,4\n",
        "x,y\n1,2\n3,4",
        "x,y\r\n1,2\r\n3,4\r\n",
        "\ufeffx,y\n1,2\n3,4\n",
        " x , y \n 1 , 2\n 3, 4\n",
        '"x","y"\n1,2\n3,4\n',
        'x,"y"\n"1","2"\n3,4\n',
        "# made by an instrument\n\n# 2 channels\nx,y\n# data\n1,2\n\n3,4 # last\n\n",
        "# x, y\n1,2\n3,4\n",
        "# made by np.savetxt\n# x,y\n1,2\n3,4\n",
        "x;y\n1;2\n3;4\n",
        "x;y\n1,0;2,0\n3,0;4e0\n",
        "x\ty\n1\t2\n3\t4\n",
        "x,note,y\n1,good,2\n3,,4\n",
        'x,note,y\n1,"a, b",2\n3,"",4\n',
        "x;note;y\n1,0;a;2\n3;b,c;4\n",
        "x,y,\n1,2,\n3,4,\n",
        "x,y\n1,2,\n3,4,\n",
        "y,z,z,x\n2,0,0,1\n4,0,0,3\n",
        "x,y\n+1.0e0,2.\n.3e1,4\n",
    ],
)
def test_csv_as_instruments_write_it(tmp_path, text):
    path = tmp_path / "a.csv"
    for encoding in ("utf-8", "utf-16"):
        path.write_bytes(text.encode(encoding) if encoding == "utf-8" else text.lstrip("\ufeff").encode(encoding))
        found = read_columns(path, ["x", "y"])
        assert {name: values.tolist() for name, values in found.items()} == {"x": [1, 3], "y": [2, 4]}


def test_csv_of_one_column_and_of_no_rows(tmp_path):
    (tmp_path / "a.csv").write_text("x\n1\n2\n")
    assert read_columns(tmp_path / "a.csv", ["x"])["x"].tolist() == [1, 2]
    (tmp_path / "a.csv").write_text("x,y\n")
    found = read_columns(tmp_path / "a.csv", ["x", "y"])
    assert {name: values.shape for name, values in found.items()} == {"x": (0,), "y": (0,)}


def test_names_with_commas_and_letters_of_all_languages(tmp_path):
    (tmp_path / "a.csv").write_text('"rotor.displacement[3,2]","größe [µm]"\n1,2\n', encoding="utf-8")
    found = read_columns(tmp_path / "a.csv", ["rotor.displacement[3,2]", "größe [µm]"])
    assert [values.tolist() for values in found.values()] == [[1], [2]]
    (tmp_path / "a.csv").write_bytes("größe,x\n1,2\n".encode("latin-1"))
    assert read_columns(tmp_path / "a.csv", ["x"])["x"].tolist() == [2]


HEADER = "hint: the first line names the columns, as in 't,x,y'"
UNITS = "hint: units go into recording.json, remarks behind '#'"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1,2\n3,4\n", [f"data:1:1: error: no line with the names of the columns\n\n{HEADER}"]),
        ("\n\n", [f"data:2:1: error: no line with the names of the columns\n\n{HEADER}"]),
        ("# only remarks\n", [f"data:1:1: error: no line with the names of the columns\n\n{HEADER}"]),
        (
            "x,y\nm,m\n1,2\n",
            [
                f"data:2:1: error: column x: 'm' is not a number\n\n{UNITS}",
                f"data:2:3: error: column y: 'm' is not a number\n\n{UNITS}",
            ],
        ),
        ("# r\nx,y\n1,2\n\n3,four\n", [f"data:5:3: error: column y: 'four' is not a number\n\n{UNITS}"]),
        (
            "x,y\n1,2\n3,\n",
            ["data:3:3: error: column y: the cell is empty\n\nhint: write nan for a sample that is missing"],
        ),
        (
            "x,y\n1,2\n3\n1,2,3\n",
            ["data:3:1: error: 1 cells, but the header names 2", "data:4:1: error: 3 cells, but the header names 2"],
        ),
        ("x;y\n1.000,5;2\n", [f"data:2:1: error: column x: '1.000,5' is not a number\n\n{UNITS}"]),
        ("x,y,x\n1,2,3\n", ["data:1:1: error: column 'x' is there 2 times\n\nhint: rename one of them"]),
        ("x,y\n1_0,2\n", [f"data:2:1: error: column x: '1_0' is not a number\n\n{UNITS}"]),
    ],
)
def test_mistakes_in_csv_have_line_and_column(tmp_path, text, expected):
    (tmp_path / "a.csv").write_text(text)
    assert refused(tmp_path / "a.csv", ["x", "y"]) == expected


def test_many_mistakes_are_counted(tmp_path):
    (tmp_path / "a.csv").write_text("x\n" + "a\n" * 100)
    found = refused(tmp_path / "a.csv", ["x"])
    assert len(found) == 21
    assert found[-1] == "data: error: 80 more cells are wrong"


def test_a_line_without_end_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("x" * 2_000_000)
    assert refused(tmp_path / "a.csv", ["x"]) == ["data:1:1: error: a line is longer than 1000000 characters"]


def test_samples_that_are_not_finite_are_warned_of_with_their_place(tmp_path):
    (tmp_path / "a.csv").write_text("# r\nx,y\n1,2\n\nnan,3\n4,inf\n5,-inf\n")
    warnings: list[Problem] = []
    found = read_columns(tmp_path / "a.csv", ["x", "y"], shown="data", warnings=warnings)
    assert math.isnan(found["x"][1])
    assert [str(warning) for warning in warnings] == [
        "data:5:1: warning: column x: 1 of 4 values are not finite, the first is sample 2",
        "data:6:3: warning: column y: 2 of 4 values are not finite, the first is sample 3",
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


@settings(deadline=None)
@given(arrays(float, st.tuples(st.integers(1, 20), st.just(len(CHANNELS)))), st.sampled_from(",;\t"))
def test_csv_keeps_every_number(tmp_path_factory, values, delimiter):
    path = tmp_path_factory.getbasetemp() / "numbers.csv"
    write_csv(path, dict(zip(CHANNELS, values.T, strict=True)), delimiter)
    found = read_columns(path, list(CHANNELS))
    np.testing.assert_array_equal(np.column_stack(list(found.values())), values)


@settings(deadline=None)
@given(st.text(alphabet="xy,;\t\"'#\n\r 1.5eE+-nainf\x00é\u2028", max_size=60))
def test_csv_of_any_text_ends_with_numbers_or_a_message(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(text.encode())
    mistakes: tuple[Problem, ...] = ()
    found = {}
    try:
        found = read_columns(path, ["x", "y"])
    except RotorsimError as error:
        mistakes = error.problems
    assert mistakes or {values.ndim for values in found.values()} == {1}


# --- npz, mat and h5 --------------------------------------------------------------------------------------------------


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
        assert refused(tmp_path / "a.h5", [column]) == [f"data: error: no column '{column}'\n\nhint: known: y"]


# --- optional packages ------------------------------------------------------------------------------------------------


def needs(package: str):
    return pytest.mark.skipif(importlib.util.find_spec(package) is None, reason=f"{package} is not installed")


FOREIGN = pytest.mark.filterwarnings("ignore")  # of foreign packages, which leave files open


@FOREIGN
@needs("nptdms")
def test_tdms(tmp_path):
    from nptdms import ChannelObject, TdmsWriter

    properties = {"wf_increment": 0.1, "wf_start_offset": 0.0}
    with TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        writer.write_segment([ChannelObject("rig", name, TABLE[name], properties) for name in "xy"])
    found = read_columns(tmp_path / "a.tdms", ["x", "rig/y"], "time")
    np.testing.assert_array_equal(found["x"], TABLE["x"])
    np.testing.assert_array_equal(found["rig/y"], TABLE["y"])
    np.testing.assert_allclose(found["time"], TABLE["t"], rtol=1e-15)
    assert refused(tmp_path / "a.tdms", ["X"]) == ["data: error: no column 'X'\n\nhint: did you mean 'x'?"]


@FOREIGN
@needs("pyuff")
@pytest.mark.parametrize("suffix", [".uff", ".unv"])
def test_universal_files(tmp_path, suffix):
    import pyuff

    path = tmp_path / f"a{suffix}"
    for node, name in enumerate("xy", start=1):
        pyuff.UFF(str(path)).write_sets(
            pyuff.prepare_58(
                binary=1,
                func_type=1,
                rsp_node=node,
                rsp_dir=3,
                ref_dir=1,
                ref_node=1,
                data=TABLE[name],
                x=TABLE["t"],
                id1=name if node == 1 else "NONE",
                rsp_ent_name="NONE",
                ref_ent_name="NONE",
                abscissa_spacing=1,
                abscissa_spec_data_type=17,
                ordinate_spec_data_type=8,
                orddenom_spec_data_type=0,
            ),
            mode="add",
        )
    found = read_columns(path, ["x", "2/3"], "time")
    np.testing.assert_array_equal(found["x"], TABLE["x"])
    np.testing.assert_array_equal(found["2/3"], TABLE["y"])
    np.testing.assert_allclose(found["time"], TABLE["t"], rtol=1e-6)


@FOREIGN
@needs("asammdf")
def test_mf4(tmp_path):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(TABLE[name], TABLE["t"], name=name) for name in "xy"])
        file.save(tmp_path / "a.mf4")
    found = read_columns(tmp_path / "a.mf4", ["x", "y"], "time")
    np.testing.assert_array_equal(found["x"], TABLE["x"])
    np.testing.assert_array_equal(found["y"], TABLE["y"])
    np.testing.assert_array_equal(found["time"], TABLE["t"])
