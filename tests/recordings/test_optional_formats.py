"""Formats by optional packages."""

import gc
import sys

import numpy as np
import pytest

from rotorsim.recordings.readers.columns import DAMAGED, read_columns
from tests.recordings.tables import TABLE, WRITERS, formats, refused, write_mf4, write_tdms, write_uff

CUT = "\n\nhint: copy it again, or save what is left by the program that recorded it"


@formats(["a.tdms", "a.uff", "a.mf4"])
def test_the_clock_of_a_file_is_that_of_what_is_wanted_and_no_channel_of_its_name(tmp_path, name):
    WRITERS[name](tmp_path / name, {"other": np.zeros(3), "x": TABLE["x"]})
    np.testing.assert_allclose(read_columns(tmp_path / name, ["x"], "time")["time"], TABLE["t"], rtol=1e-6)
    path = tmp_path / f"with {name}"
    WRITERS[name](path, {"time": 7 + TABLE["t"], "x": TABLE["x"]})
    np.testing.assert_array_equal(read_columns(path, ["x"], "time")["time"], 7 + TABLE["t"])


@formats(["a.mf4"])
def test_columns_that_were_sampled_at_different_times_have_no_common_clock(tmp_path, name):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        for column, late in {"x": 0.0, "y": 0.03}.items():
            file.append([Signal(TABLE[column], TABLE["t"] + late, name=column)])
        file.save(tmp_path / name)
    write_mf4(tmp_path / "empty.mf4", {"x": np.empty(0), "y": np.empty(0)})
    assert read_columns(tmp_path / "empty.mf4", ["x", "y"], "time")["time"].shape == (0,)
    assert refused(tmp_path / name, ["x", "y"], "time") == [
        "data: error: column 'time' cannot be read: columns 'x' and 'y' were sampled at different times"
    ]


@formats(["a.tdms"])
def test_tdms(tmp_path, name):
    write_tdms(tmp_path / "a.tdms", {column: TABLE[column] for column in "xy"})
    found = read_columns(tmp_path / "a.tdms", ["x", "rig/y"], "time")
    np.testing.assert_array_equal(found["x"], TABLE["x"])
    np.testing.assert_array_equal(found["rig/y"], TABLE["y"])
    np.testing.assert_allclose(found["time"], TABLE["t"], rtol=1e-15)
    assert refused(tmp_path / "a.tdms", ["X"]) == [
        "data: error: no column 'X'\n\nhint: did you mean 'x'? the file has rig/x, x, rig/y, y"
    ]


@formats(["a.tdms"])
def test_a_tdms_that_was_cut_off_is_refused(tmp_path, name, capfd):
    """In data, metadata or lead-in of its last segment: npTDMS reads all three as a shorter file."""
    path = tmp_path / name
    write_tdms(path, {"x": np.arange(90.0), "y": np.arange(90.0)}, segments=3)
    content = path.read_bytes()
    last = content.rindex(b"TDSm")
    for cut in (len(content) - 240, last + 40, last + 20, last + 2):
        path.write_bytes(content[:cut])
        assert refused(path, ["x", "y"]) == [
            f"data: error: the file was cut off: its segment 3 ends beyond byte {cut}{CUT}"
        ]
    path.write_bytes(content[: last + 12] + b"\xff" * 8 + content[last + 20 :])
    assert refused(path, ["x"]) == [f"data: error: the file was cut off: its segment 3 was never closed{CUT}"]
    path.write_bytes(content + bytes(100))
    assert refused(path, ["x"]) == [
        f"data: error: not a .tdms file: no segment at byte {len(content) + 1}\n\nhint: {DAMAGED}"
    ]
    assert capfd.readouterr().err == ""


@formats(["a.uff", "a.unv"])
def test_universal_files(tmp_path, name):
    path = tmp_path / name
    write_uff(path, {"x": TABLE["x"], "NONE": TABLE["y"]})
    found = read_columns(path, ["x", "2/3"], "time")
    np.testing.assert_array_equal(found["x"], TABLE["x"])
    np.testing.assert_array_equal(found["2/3"], TABLE["y"])
    np.testing.assert_allclose(found["time"], TABLE["t"], rtol=1e-6)


@formats(["a.uff"])
def test_a_universal_file_that_was_cut_off_is_refused(tmp_path, name):
    path = tmp_path / name
    write_uff(path, {"x": np.arange(50.0), "y": np.arange(50.0)})
    content = path.read_bytes()
    for cut, number in ((len(content) - 2, 2), (len(content) - 300, 2), (400, 1), (6, 1)):
        path.write_bytes(content[:cut])
        assert refused(path, ["x", "y"]) == [
            f"data: error: the file was cut off: its data set {number} has no end{CUT}"
        ]
    last = content.rindex(b"    -1")
    path.write_bytes(content[: last - 80] + content[last:])
    assert refused(path, ["x", "y"]) == ["data: error: column 'y' cannot be read: it has 40 samples, but says 50"]


@formats(["a.mf4"])
def test_mf4(tmp_path, name):
    write_mf4(tmp_path / "a.mf4", TABLE)
    found = read_columns(tmp_path / "a.mf4", ["x", "y"], "time")
    np.testing.assert_array_equal(found["x"], TABLE["x"])
    np.testing.assert_array_equal(found["y"], TABLE["y"])
    np.testing.assert_array_equal(found["time"], TABLE["t"])


@pytest.mark.slow
@formats(["a.mf4"])
def test_a_damaged_mf4_leaves_no_traceback(tmp_path, name, monkeypatch):
    unheard: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", unheard.append)
    write_mf4(tmp_path / name, TABLE)
    content = (tmp_path / name).read_bytes()
    for cut in (100, len(content) // 2, len(content) - 4):
        (tmp_path / name).write_bytes(content[:cut])
        (text,) = refused(tmp_path / name, ["x"])
        assert text.startswith("data: error: not a .mf4 file that can be read: ")
        assert text.endswith(f"\n\nhint: {DAMAGED}")
    gc.collect()
    assert unheard == []
