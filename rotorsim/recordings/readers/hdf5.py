"""HDF5 files: .h5."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from rotorsim.recordings.readers.reader import Array, Columns, columns_of, spellings

MAX_DEPTH, MAX_NAMES = 20, 1000  # of groups within groups, and of names that are listed for near misses


@dataclass(frozen=True)
class Hdf5Reader:
    """Reads .h5; transposed: MATLAB writes columns as rows."""

    suffixes: ClassVar[tuple[str, ...]] = (".h5", ".hdf5")
    counted: ClassVar[bool] = True
    transposed: bool = False

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        import h5py

        def array(item: Any) -> Array:
            return Array(lambda: np.transpose(item[()]) if self.transposed else item[()], int(item.size or 0) * 8)

        with h5py.File(path, "r") as tree:
            sets = {path: _inside(tree, path) for name in wanted for path, _ in spellings(name)}
            sets = {path: item for path, item in sets.items() if item is not None}
            if not all(any(path in sets for path, _ in spellings(name)) for name in wanted):
                sets |= _listed(tree)  # for near misses
            return columns_of({name: array(item) for name, item in sets.items()}, wanted)


def _inside(tree: Any, name: str) -> Any:
    """Return the data set of a path, or None; links out of the file are not followed."""
    import h5py

    steps = name.split("/")
    if len(steps) > MAX_DEPTH or "" in steps or "." in steps:
        return None
    item = tree
    for step in steps:
        if not isinstance(item, h5py.Group) or not isinstance(item.get(step, getlink=True), h5py.HardLink):
            return None
        item = item[step]
    return item if isinstance(item, h5py.Dataset) and not item.external and not item.is_virtual else None


def _listed(tree: Any) -> dict[str, Any]:
    """Return the first data sets of a file by path: some MAX_NAMES of them, in no more than MAX_DEPTH groups."""
    import h5py

    sets: dict[str, Any] = {}
    groups = [("", tree, 1)]
    seen = 0
    while groups and seen < MAX_NAMES:
        above, group, depth = groups.pop(0)
        for step in islice(group, MAX_NAMES - seen):
            seen += 1
            item = _inside(group, step) if "/" not in step else None
            if item is not None:
                sets[above + step] = item
            elif depth < MAX_DEPTH and isinstance(group.get(step, getlink=True), h5py.HardLink):
                inner = group[step]
                groups += [(f"{above}{step}/", inner, depth + 1)] if isinstance(inner, h5py.Group) else []
    return sets
