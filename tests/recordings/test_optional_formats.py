"""Formats by optional packages."""

import importlib.util

import numpy as np
import pytest

from rotorsim.recordings.readers.columns import read_columns
from tests.recordings.tables import TABLE, refused


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
