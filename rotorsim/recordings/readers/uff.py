"""Universal files: .uff and .unv (data sets 58), by the package pyuff."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from rotorsim.recordings.readers.reader import OWN_TIME, Array, Columns, by_unique_name, columns_of, optional_package


class UffReader:
    """Reads functions at nodal degrees of freedom: by title, or response node and direction, as in ``3/1``."""

    suffixes = (".uff", ".unv")
    counted = True

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        file = optional_package("pyuff", "pyuff").UFF(str(path))
        sets = [file.read_sets(k) for k, kind in enumerate(file.get_set_types()) if int(kind) == 58]
        named = []
        for data in sets:
            degree = f"{data.get('rsp_node', 0)}/{data.get('rsp_dir', 0)}"
            title = str(data.get("id1", "")).strip()
            short = title if title not in ("", "NONE") else degree
            named.append((short, degree, Array(partial(np.ravel, data["data"]))))
        own = {OWN_TIME: Array(partial(np.ravel, sets[0]["x"]))} if sets else {}
        return columns_of({**own, **dict(by_unique_name(named))}, wanted)
