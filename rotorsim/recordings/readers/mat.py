"""MATLAB files: .mat up to version 7, and 7.3, which is HDF5."""

import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rotorsim.recordings.readers.hdf5 import MAX_DEPTH, Hdf5Reader
from rotorsim.recordings.readers.reader import Array, Columns, columns_of, refuse_large

BLOCK = 1 << 20  # bytes, unpacked at a time where they are only counted
PACKED = 15  # type of an element that is compressed


class MatReader:
    """Reads .mat; fields of structs are paths."""

    suffixes = (".mat",)
    counted = True

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        from scipy.io import loadmat, whosmat

        try:
            sizes = {name: int(np.prod(shape, dtype=float)) * 8 for name, shape, _ in whosmat(str(path))}
        except NotImplementedError:  # version 7.3
            return Hdf5Reader(transposed=True).read(path, wanted)
        _check_unpacked(path)
        tops = {re.split(r"[./\[]", name)[0] for name in wanted}
        refuse_large(sum(size for name, size in sizes.items() if name in tops), "the columns take more than")
        tree = loadmat(str(path), variable_names=sorted(tops), simplify_cells=True)
        leaves = {name: Array(lambda value=value: value) for name, value in _leaves(tree) if name[:2] != "__"}  # type: ignore[misc]
        others = {name: Array(tuple) for name in sizes if name not in tops}  # not loaded: near misses
        return columns_of({**leaves, **others}, wanted)


def _check_unpacked(path: Path) -> None:
    """Refuse a .mat (version 5) whose packed elements are larger than what is read, however they are nested."""
    total = 0
    with path.open("rb") as stream:
        head = stream.read(128)
        order: Literal["little", "big"] = "big" if head[126:128] == b"MI" else "little"
        while len(tag := stream.read(8)) == 8 and head[126:128] in (b"MI", b"IM"):
            kind, left = (int.from_bytes(part, order) for part in (tag[:4], tag[4:]))
            if kind != PACKED:
                stream.seek(left, 1)
                continue
            unpack = zlib.decompressobj()
            while left > 0 and (data := stream.read(min(left, BLOCK))):
                left -= len(data)
                while data:
                    total += len(unpack.decompress(data, BLOCK))
                    data = unpack.unconsumed_tail
                    refuse_large(total, "it unpacks to more than")


def _leaves(tree: Mapping[str, Any], above: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict) and depth < MAX_DEPTH:
            yield from _leaves(value, f"{above}{name}/", depth + 1)
        else:
            yield above + name, value
