"""ASAM measurement files: .mf4, by the package asammdf."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rotorsim.recordings.readers.reader import OWN_TIME, Array, Columns, columns_of, optional_package


class Mf4Reader:
    """Reads channels whose name is that of one only."""

    suffixes = (".mf4",)
    counted = True

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        with optional_package("asammdf", "asammdf").MDF(str(path)) as tree:
            masters = set(tree.masters_db.items())
            arrays = {}
            for name, places in tree.channels_db.items():
                channels = [place for place in places if name != OWN_TIME or place not in masters]
                if len(channels) == 1:
                    [(group, index)] = channels
                    arrays[name] = Array(partial(_samples, tree, group, index), clock=partial(tree.get_master, group))
            return columns_of(arrays, wanted)


def _samples(tree: Any, group: int, index: int) -> Any:
    return tree.get(group=group, index=index).samples
