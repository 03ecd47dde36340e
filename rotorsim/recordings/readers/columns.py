"""Columns of measurement files of every format: .csv, .npz, .mat, .h5, and by optional packages .tdms, .uff, .mf4."""

from __future__ import annotations

import gc
import logging
import sys
import warnings as python_warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.readers.csv import CsvReader
from rotorsim.recordings.readers.hdf5 import Hdf5Reader
from rotorsim.recordings.readers.mat import MatReader
from rotorsim.recordings.readers.mf4 import Mf4Reader
from rotorsim.recordings.readers.npz import NpzReader
from rotorsim.recordings.readers.reader import DAMAGED, Columns, Reader, refuse_large
from rotorsim.recordings.readers.tdms import TdmsReader
from rotorsim.recordings.readers.uff import UffReader

_FORMATS: tuple[Reader, ...] = (
    CsvReader(),
    NpzReader(),
    MatReader(),
    Hdf5Reader(),
    TdmsReader(),
    UffReader(),
    Mf4Reader(),
)
READERS: dict[str, Reader] = {suffix: reader for reader in _FORMATS for suffix in reader.suffixes}


def read_columns(
    path: Path,
    columns: Sequence[str],
    time_column: str | None = None,
    *,
    shown: str = "",
    warnings: list[Problem] | None = None,
) -> dict[str, np.ndarray]:
    """Return columns of a data file: name -> (n,), as the numbers stand in the file.

    A name may be a path in the file (``group/x``), and ``name[2]`` is the second column of a two-dimensional array.
    shown: the file's name in messages. warnings: takes those of the reader, and one for values that are not finite.
    Raises RotorsimError with every mistake: missing columns, text in cells, lengths that differ.
    """
    found = read_table(path, [*columns, *([] if time_column is None else [time_column])], shown=shown)
    if warnings is not None:
        warnings += [_in_file(problem, shown or str(path)) for problem in (*found.warnings, *_not_finite(found))]
    return found.values


def read_table(path: Path, columns: Sequence[str], *, shown: str = "") -> Columns:
    """Return columns of a data file with the places of their numbers; raises as `read_columns` does."""
    wanted, file = list(dict.fromkeys(columns)), shown or str(path)
    try:
        reader = _reader_of(path)
        found = _read(reader, path, wanted)
        lengths = {name: len(array) for name, array in found.values.items()}
        if len(set(lengths.values())) > 1:
            text = ", ".join(f"{name} {length}" for name, length in lengths.items())
            hint = "columns of one run must be sampled together; put others into a run of their own"
            raise RotorsimError(Problem(f"columns differ in length: {text}", hint=hint))
    except RotorsimError as error:
        raise RotorsimError(*(_in_file(problem, file) for problem in error.problems)) from None
    return found


def _read(reader: Reader, path: Path, wanted: Sequence[str]) -> Columns:
    """Return what a reader reads, in silence: packages warn and log, and objects that they leave half made fail."""
    said = ""
    disabled, hook = logging.root.manager.disable, sys.unraisablehook
    logging.disable()
    sys.unraisablehook = lambda failure: None
    try:
        with python_warnings.catch_warnings():
            python_warnings.simplefilter("ignore")
            return reader.read(path, wanted)
    except RotorsimError:
        raise
    except Exception as error:  # foreign readers raise anything on a damaged file
        said = f"{type(error).__name__}: {(str(error).splitlines() or [''])[0][:120]}"
    finally:
        if said:
            gc.collect()  # half of an MDF4: else its traceback is seen whenever it goes
        sys.unraisablehook = hook
        logging.disable(disabled)
    raise RotorsimError(Problem(f"not a {path.suffix.lower()} file that can be read: {said}", hint=DAMAGED))


def _in_file(problem: Problem, file: str) -> Problem:
    return replace(problem, place=replace(problem.place, file=file))


def _reader_of(path: Path) -> Reader:
    """Return the reader of a file that has a known format, something in it, and not too much."""
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        what = f"unknown format '{path.suffix}'" if path.suffix else "the name has no suffix that says the format"
        raise RotorsimError(Problem(what, hint=f"one of {', '.join(READERS)}"))
    try:
        size = path.stat().st_size
    except OSError as error:
        raise RotorsimError(Problem(f"file cannot be read: {error.strerror}")) from None
    if size == 0:
        raise RotorsimError(
            Problem("file is empty", hint="it should hold the samples of a run: record or copy it again")
        )
    refuse_large(size, "file is larger than")
    return reader


def _not_finite(columns: Columns) -> list[Problem]:
    """Return warnings of columns that hold values that are not finite."""
    problems = []
    for name, array in columns.values.items():
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad):
            what = f"{len(bad)} of {len(array)} values are not finite, the first is sample {bad[0] + 1}"
            problems.append(Problem(what, f"column {name}", columns.place(int(bad[0]), name), severity="warning"))
    return problems
