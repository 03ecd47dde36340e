"""A recording from its folder: recording.json and the data files that it names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.document import Document, RunEntry, read_recording_document
from rotorsim.recordings.readers.columns import read_columns
from rotorsim.recordings.recording import Recording, Run
from rotorsim.units import conversion

__all__ = ["load_recording"]


def load_recording(path: str | Path, *, read: bool = True) -> Recording:
    """Read a recording: ``path`` is its folder or its recording.json.

    read: False leaves the samples unread: time has shape (0,) and values are empty.
    Raises RotorsimError with every mistake of recording.json, or else of all data files.
    """
    document = read_recording_document(path)
    runs: list[Run] = []
    errors: list[Problem] = []
    warnings: list[Problem] = []
    for entry in document.runs:
        try:
            runs.append(_run(entry, document, read, warnings))
        except RotorsimError as error:
            errors += error.problems
    if errors:
        raise RotorsimError(*errors)
    return Recording(document.name, document.source, document.folder, document.channels, tuple(runs), tuple(warnings))


def _run(entry: RunEntry, document: Document, read: bool, warnings: list[Problem]) -> Run:
    time, values = np.empty(0), {}
    if read:
        data = read_columns(entry.path, list(document.channels), entry.time, shown=entry.file, warnings=warnings)
        for column, channel in document.channels.items():
            factor = conversion(channel.unit, None)
            values[column] = data[column] if factor == 1.0 else _scaled(data[column], factor)
        if entry.time is not None:
            time = data[entry.time]
        elif entry.sample_rate is not None:
            time = np.arange(len(next(iter(values.values())))) / entry.sample_rate
    rest = (entry.speed, entry.tacho, entry.settings, entry.use, entry.place, entry.sample_rate)
    return Run(entry.id, entry.file, time, values, *rest, tacho_resolution=entry.tacho_resolution)


def _scaled(values: np.ndarray, factor: float) -> np.ndarray:
    inverse = round(1.0 / factor) if 1e-15 < factor < 0.5 else 0
    exact = inverse and abs(inverse * factor - 1.0) < 1e-15
    return values / inverse if exact else values * factor  # as rotorsim.units does: 24 / 1e6 is 24e-6 to the last bit
