"""Universal files: .uff and .unv (data sets 58), by the package pyuff."""

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.recordings.readers.reader import Array, Columns, by_unique_name, columns_of, cut_off, optional_package

DELIMITER = re.compile(
    rb" {4}-1(?=[\r\n]|\Z| {74})"
)  # before and after every data set; binary data may stand before it

TIME = (0, 17)  # kinds of an abscissa: unknown, time


class UffReader:
    """Reads functions at nodal degrees of freedom: by title, or response node and direction, as in ``3/1``."""

    suffixes = (".uff", ".unv")
    counted = True

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        package = optional_package("pyuff", "pyuff")
        delimiters = sum(1 for _ in DELIMITER.finditer(path.read_bytes()))
        if delimiters % 2:
            raise cut_off(f"its data set {delimiters // 2 + 1} has no end")
        file = package.UFF(str(path))
        sets = [file.read_sets(k) for k, kind in enumerate(file.get_set_types()) if int(kind) == 58]
        named = []
        for data in sets:
            degree = f"{data.get('rsp_node', 0)}/{data.get('rsp_dir', 0)}"
            title = str(data.get("id1", "")).strip()
            short = title if title not in ("", "NONE") else degree
            clock = partial(np.ravel, data["x"]) if data.get("abscissa_spec_data_type", 0) in TIME else None
            named.append((short, degree, Array(partial(_samples, data), clock=clock)))
        return columns_of(dict(by_unique_name(named)), wanted)


def _samples(data: dict[str, Any]) -> np.ndarray:
    """Return the samples of a data set. Raises ValueError where they are not as many as it says."""
    samples = np.ravel(data["data"])
    if len(samples) != data.get("num_pts", len(samples)):
        raise ValueError(f"it has {len(samples)} samples, but says {data['num_pts']}")
    return samples
