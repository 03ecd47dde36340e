"""National Instruments files: .tdms, by the package npTDMS."""

from collections.abc import Sequence
from pathlib import Path

from rotorsim.recordings.readers.reader import OWN_TIME, Array, Columns, by_unique_name, columns_of, optional_package


class TdmsReader:
    """Reads .tdms: channels are ``channel`` or ``group/channel``."""

    suffixes = (".tdms",)

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted."""
        package = optional_package("nptdms", "npTDMS")
        with path.open("rb") as stream, package.TdmsFile.open(stream) as tree:
            channels = [(group.name, channel) for group in tree.groups() for channel in group.channels()]
            arrays = {OWN_TIME: Array(channels[0][1].time_track)} if channels else {}
            arrays |= by_unique_name(
                (channel.name, f"{group}/{channel.name}", Array(lambda channel=channel: channel[:], len(channel) * 8))  # type: ignore[misc]
                for group, channel in channels
            )
            return columns_of(arrays, wanted)
