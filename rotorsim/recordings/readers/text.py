"""What formats of text share: opening, cells, numbers, and a table of lines whose mistakes have their place."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.recordings.readers.reader import Columns, check_names, refuse_large

MAX_LINE = 1_000_000  # characters
ROWS = 100_000  # read at a time: only what is wanted of them is kept
MAX_CELL_PROBLEMS = 20


def open_text(path: Path) -> TextIO:
    """Open a file of UTF-8 or UTF-16; what is neither becomes a character that is no digit."""
    with path.open("rb") as stream:
        wide = stream.read(2) in (b"\xff\xfe", b"\xfe\xff")
    return path.open(encoding="utf-16" if wide else "utf-8-sig", errors="replace")


def numbered_lines(stream: TextIO) -> Iterator[tuple[int, str]]:
    """Yield lines with their numbers, from 1. Raises RotorsimError for one that has no end."""
    for number, line in enumerate(iter(lambda: stream.readline(MAX_LINE), ""), start=1):
        if len(line) >= MAX_LINE:
            raise RotorsimError(Problem(f"a line is longer than {MAX_LINE} characters", place=Place("", number, 1)))
        yield number, line


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line, without quotes."""
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        cells = line.split(delimiter)
    return [cell.strip() for cell in cells]


def number_of(cell: str) -> float | None:
    """Return the number of a cell, None where it is none."""
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


@dataclass(frozen=True)
class TextTable:
    """A table of text: columns ``names``, whose samples are the lines after the line ``header``; '#' is a comment."""

    path: Path
    names: list[str]
    header: int
    delimiter: str
    decimal: str = "."

    def columns(self, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted. Raises RotorsimError with the place of every mistake."""
        check_names(wanted, self.names)
        for name in wanted:
            if self.names.count(name) > 1:
                what = f"column '{name}' is there {self.names.count(name)} times"
                raise RotorsimError(Problem(what, place=Place("", self.header, 1), hint="rename one of them"))
        try:
            rows = self._numbers([self.names.index(name) for name in wanted])
        except ValueError:  # text in a cell, perhaps of a column that nobody wants
            return Columns(self._cells(wanted), self._place_of)
        return Columns(dict(zip(wanted, np.ascontiguousarray(rows.T), strict=True)), self._place_of)

    def _numbers(self, at: list[int]) -> np.ndarray:
        """Return some columns (n, m) of a table without text. Raises ValueError for any."""
        parts, rows = [np.empty((0, len(at)))], 0
        with open_text(self.path) as stream, warnings.catch_warnings():
            warnings.filterwarnings("ignore", "loadtxt: input contained no data")
            for _ in range(self.header):
                stream.readline()
            lines = stream if self.decimal == "." else (line.replace(self.decimal, ".") for line in stream)
            while more := list(islice(lines, ROWS)):
                table = np.loadtxt(more, delimiter=self.delimiter, comments="#", quotechar='"', ndmin=2)
                if table.size and table.shape[1] != len(self.names):
                    raise ValueError("cells")
                parts += [table[:, at]] if table.size else []
                rows += len(parts[-1])
                refuse_large(rows * len(at) * 8, f"{len(at)} columns take more than")
        return np.concatenate(parts)

    def _cells(self, wanted: Sequence[str]) -> dict[str, np.ndarray]:
        """Read cell by cell: columns of text that nobody wants are passed over, and mistakes are placed."""
        columns: dict[str, list[float]] = {name: [] for name in wanted}
        problems: list[Problem] = []
        mistakes = 0
        for line, row, text in self._rows():
            if len(row) not in (len(self.names), len(self.names) + (row[-1] == "")):
                wrong = [Problem(f"{len(row)} cells, but the header names {len(self.names)}", place=self._place(line))]
            else:
                wrong = []
                for name, values in columns.items():
                    k = self.names.index(name)
                    value = number_of(row[k].replace(self.decimal, "."))
                    if value is None:
                        wrong.append(_no_number(row[k], name, self._place(line, k, text)))
                    else:
                        values.append(value)
            mistakes += len(wrong)
            problems += wrong[: MAX_CELL_PROBLEMS - len(problems)]
        if mistakes > MAX_CELL_PROBLEMS:
            problems.append(Problem(f"{mistakes - MAX_CELL_PROBLEMS} more cells are wrong"))
        if problems:
            raise RotorsimError(*problems)
        return {name: np.array(values) for name, values in columns.items()}

    def _rows(self) -> Iterator[tuple[int, list[str], str]]:
        """Yield line number, cells and text of every line of samples."""
        with open_text(self.path) as stream:
            for number, line in enumerate(stream, start=1):
                text = line.partition("#")[0].rstrip("\r\n")
                if number > self.header and text.strip():
                    yield number, cells_of(text, self.delimiter), text

    def _place_of(self, sample: int, column: str) -> Place:
        """Return the line and column of a sample, counted from 0."""
        line, _, text = next(islice(self._rows(), sample, None))
        return self._place(line, self.names.index(column), text)

    def _place(self, line: int, k: int = 0, text: str = "") -> Place:
        column = 1 + sum(len(part) + 1 for part in text.split(self.delimiter)[:k])
        return Place("", line, column if '"' not in text else 1)


def _no_number(cell: str, name: str, place: Place) -> Problem:
    short = cell if len(cell) <= 40 else cell[:37] + "..."
    hint = "units go into recording.json, remarks behind '#'" if cell else "write nan for a sample that is missing"
    return Problem(f"'{short}' is not a number" if cell else "the cell is empty", f"column {name}", place, hint)
