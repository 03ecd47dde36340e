"""ASAM measurement files: .mf4, by the package asammdf."""

from collections.abc import Sequence
from pathlib import Path

from rotorsim.recordings.readers.reader import OWN_TIME, Array, Columns, columns_of, optional_package


class Mf4Reader:
    """Reads channels whose name is that of one only; ``time`` is the clock of the first that is wanted."""

    suffixes = (".mf4",)
    counted = True

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        with optional_package("asammdf", "asammdf").MDF(str(path)) as tree:
            names = [name for name, places in tree.channels_db.items() if len(places) == 1]
            arrays = {name: Array(lambda name=name: tree.get(name).samples) for name in names}  # type: ignore[misc]
            signal = next((name for name in wanted if name in arrays and name != OWN_TIME), None)
            if signal is not None:
                arrays[OWN_TIME] = Array(lambda: tree.get(signal).timestamps)
            return columns_of(arrays, wanted)
