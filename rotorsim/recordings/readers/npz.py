"""NumPy archives: .npz."""

import math
import zipfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from rotorsim.recordings.readers.reader import Array, Columns, columns_of


class NpzReader:
    """Reads .npz by name; never pickled objects."""

    suffixes = (".npz",)
    counted = True

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        with zipfile.ZipFile(path) as archive:
            sizes = {info.filename.removesuffix(".npy"): _size(archive, info) for info in archive.infolist()}
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            reading = {name: Array(partial(arrays.__getitem__, name), sizes.get(name, 0)) for name in arrays.files}
            return columns_of(reading, wanted)


def _size(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> int:
    """Return the bytes that an array of an archive takes as double precision, by its header."""
    try:
        with archive.open(info) as stream:
            major, _ = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
            return max(math.prod(read(stream)[0]) * 8, info.file_size)
    except Exception:  # said when the array is read
        return info.file_size
