"""National Instruments files: .tdms, by the package npTDMS."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.readers.reader import (
    DAMAGED,
    Array,
    Columns,
    by_unique_name,
    columns_of,
    cut_off,
    optional_package,
)

LEAD_IN = 28  # bytes at the start of a segment; at 12 is the length of what follows them
BIG_ENDIAN = 64  # flag in the fifth of them
NOT_CLOSED = 2**64 - 1  # length of a segment whose program ended before it


class TdmsReader:
    """Reads .tdms: channels are ``channel`` or ``group/channel``."""

    suffixes = (".tdms",)
    counted = True

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        package = optional_package("nptdms", "npTDMS")
        _check_segments(path)
        with path.open("rb") as stream, package.TdmsFile.open(stream) as tree:
            channels = [(group.name, channel) for group in tree.groups() for channel in group.channels()]
            arrays = by_unique_name((item.name, f"{group}/{item.name}", _array(item)) for group, item in channels)
            return columns_of(dict(arrays), wanted)


def _array(channel: Any) -> Array:
    """Return the samples of a channel, and their times where it is a waveform."""
    start, step = (channel.properties.get(f"wf_{key}") for key in ("start_offset", "increment"))
    clock = None if step is None else lambda: (start or 0.0) + step * np.arange(len(channel))
    return Array(lambda: channel[:], len(channel) * 8, clock)


def _check_segments(path: Path) -> None:
    """Refuse a file that ends within a segment: npTDMS reads what there is as a shorter one."""
    size, start, number = path.stat().st_size, 0, 0
    with path.open("rb") as stream:
        while start < size:
            number += 1
            stream.seek(start)
            head = stream.read(LEAD_IN)
            length = int.from_bytes(head[12:20], "big" if head[4:5] and head[4] & BIG_ENDIAN else "little")
            if len(head) == LEAD_IN and length == NOT_CLOSED:
                raise cut_off(f"its segment {number} was never closed")
            if head[:4] != b"TDSm"[: len(head)]:
                raise RotorsimError(Problem(f"not a .tdms file: no segment at byte {start + 1}", hint=DAMAGED))
            start += LEAD_IN + length
            if len(head) < LEAD_IN or start > size:
                raise cut_off(f"its segment {number} ends beyond byte {size}")
