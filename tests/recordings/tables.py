"""Data files for the tests of readers: a writer for every format, which declares nothing but the bytes."""

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
