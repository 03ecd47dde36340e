"""Data files for the tests of readers: a writer for every format."""

import importlib.util
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from rotorsim.errors import RotorsimError
from rotorsim.recordings.readers.columns import read_columns

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


def write_tdms(path: Path, table: dict[str, np.ndarray], segments: int = 1) -> None:
    from nptdms import ChannelObject, TdmsWriter

    clock = {"wf_increment": 0.1, "wf_start_offset": 0.0}
    with TdmsWriter(str(path)) as writer:
        for part in zip(*(np.array_split(array, segments) for array in table.values()), strict=True):
            writer.write_segment([ChannelObject("rig", *item, clock) for item in zip(table, part, strict=True)])


def write_uff(path: Path, table: dict[str, np.ndarray]) -> None:
    """Write functions at nodes 1, 2, ... in direction 3."""
    import pyuff

    for node, (name, array) in enumerate(table.items(), start=1):
        data = pyuff.prepare_58(
            binary=1,
            func_type=1,
            rsp_node=node,
            rsp_dir=3,
            ref_dir=1,
            ref_node=1,
            data=array,
            x=0.1 * np.arange(len(array)),
            id1=name,
            rsp_ent_name="NONE",
            ref_ent_name="NONE",
            abscissa_spacing=1,
            abscissa_spec_data_type=17,
            ordinate_spec_data_type=8,
            orddenom_spec_data_type=0,
        )
        pyuff.UFF(str(path)).write_sets(data, mode="add")


def write_mf4(path: Path, table: dict[str, np.ndarray]) -> None:
    """Write every column with a clock of its own."""
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        for name, array in table.items():
            file.append([Signal(array, 0.1 * np.arange(len(array)), name=name)])
        file.save(path)


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
    "a.tdms": write_tdms,
    "b.tdms": lambda path, table: write_tdms(path, table, segments=3),
    "a.uff": write_uff,
    "a.unv": write_uff,
    "a.mf4": write_mf4,
}
PACKAGES = {".tdms": "nptdms", ".uff": "pyuff", ".unv": "pyuff", ".mf4": "asammdf"}  # optional ones


def suffix(name: str) -> str:
    return Path(name).suffix.lower()


def formats(names: Iterable[str] = WRITERS) -> pytest.MarkDecorator:
    """Run a test with files of these names, of every format by default; without the package of one it is skipped."""

    def marks(package: str | None) -> list[pytest.MarkDecorator]:
        if package is None:
            return []
        missing = importlib.util.find_spec(package) is None
        quiet = pytest.mark.filterwarnings("ignore")  # packages of others leave files open
        return [pytest.mark.skipif(missing, reason=f"{package} is not installed"), quiet]

    return pytest.mark.parametrize("name", [pytest.param(n, marks=marks(PACKAGES.get(suffix(n)))) for n in names])


def refused(path: Path, columns: list[str], time: str | None = None) -> list[str]:
    with pytest.raises(RotorsimError) as error:
        read_columns(path, columns, time, shown="data")
    return [str(problem) for problem in error.value.problems]
