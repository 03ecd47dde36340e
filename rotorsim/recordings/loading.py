"""A recording from its folder: recording.json and the data files that it names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.directions import along_axes
from rotorsim.recordings.document import DataFile, Document, read_recording_document
from rotorsim.recordings.readers.columns import read_columns
from rotorsim.recordings.recording import Recording, Run
from rotorsim.units import conversion


def load_recording(path: str | Path, *, read: bool = True) -> Recording:
    """Read a recording: ``path`` is its folder or its recording.json.

    read: False leaves the samples unread: time has shape (0,) and values are empty.
    Raises RotorsimError with every mistake of recording.json, or else of all data files.
    """
    document = read_recording_document(path)
    if not read:
        recording = document.recording
        return replace(recording, channels=along_axes(recording.channels, (), ())[0])
    return read_samples(document)


def read_samples(document: Document) -> Recording:
    """Return the recording of a document with its samples. Raises RotorsimError with every mistake of data files."""
    recording = document.recording
    runs: list[Run] = []
    errors: list[Problem] = []
    warnings: list[Problem] = []
    for run, file in zip(recording.runs, document.files, strict=True):
        try:
            runs.append(_with_samples(run, file, recording, warnings))
        except RotorsimError as error:
            errors += error.problems
    if errors:
        raise RotorsimError(*errors)
    channels, values = along_axes(recording.channels, [run.values for run in runs], [run.id for run in runs])
    turned = tuple(replace(run, values=own) for run, own in zip(runs, values, strict=True))
    return replace(recording, channels=channels, runs=turned, warnings=tuple(warnings))


def _with_samples(run: Run, file: DataFile, recording: Recording, warnings: list[Problem]) -> Run:
    channels = {column: channel for column, channel in recording.channels.items() if column not in file.without}
    data = read_columns(file.path, list(channels), file.time, shown=run.file, warnings=warnings)
    values = {c: _scaled(data[c], conversion(channel.unit, None)) for c, channel in channels.items()}
    count, rate = len(next(iter(values.values()))), run.sample_rate
    time = data[file.time] if file.time is not None else np.arange(count) / (rate or np.nan)
    return replace(run, time=time, values=values)


def _scaled(values: np.ndarray, factor: float) -> np.ndarray:
    inverse = round(1.0 / factor) if 1e-15 < factor < 0.5 else 0
    exact = inverse and abs(inverse * factor - 1.0) < 1e-15
    return values / inverse if exact else values * factor  # as rotorsim.units does: 24 / 1e6 is 24e-6 to the last bit
