"""CSV as instruments write it: comma, semicolon or tab, quoted names, comment lines, decimal commas."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.recordings.readers.reader import Columns, check_names

MAX_LINE = 1_000_000
MAX_TABLE = 2_000_000_000  # bytes of the columns that are wanted
ROWS = 100_000  # read at a time: only what is wanted of them is kept
MAX_CELL_PROBLEMS = 20


class CsvReader:
    """Reads .csv."""

    suffixes = (".csv",)

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted. Raises RotorsimError with the place of every wrong cell."""
        with _text(path) as stream:
            header, line = _header(stream)
        outside = re.sub(r'"[^"]*"', "", header)
        delimiter = next((mark for mark in ";\t" if mark in outside), ",")
        names = _cells(header, delimiter)
        place = Place("", line, 1)
        if not any(names) or all(_number(name) is not None for name in names):
            hint = "the first line names the columns, as in 't,x,y'"
            raise RotorsimError(Problem("no line with the names of the columns", place=place, hint=hint))
        check_names(wanted, names)
        for name in wanted:
            if names.count(name) > 1:
                what = f"column '{name}' is there {names.count(name)} times"
                raise RotorsimError(Problem(what, place=place, hint="rename one of them"))
        table = _Table(path, names, line, delimiter)
        try:
            rows = table.numbers([names.index(name) for name in wanted])
        except ValueError:  # text in a cell, perhaps of a column that nobody wants
            return Columns(table.cells(wanted), table.place)
        return Columns(dict(zip(wanted, np.ascontiguousarray(rows.T), strict=True)), table.place)


@dataclass(frozen=True)
class _Table:
    """A CSV file; header: the line that names the columns."""

    path: Path
    names: list[str]
    header: int
    delimiter: str

    def place(self, sample: int, column: str) -> Place:
        """Return the line and column of a sample, counted from 0."""
        line, _, text = next(islice(self._rows(), sample, None))
        return self._place(line, self.names.index(column), text)

    def numbers(self, at: list[int]) -> np.ndarray:
        """Return some columns (n, m) of a table without text. Raises ValueError for any."""
        parts, rows = [np.empty((0, len(at)))], 0
        with _text(self.path) as stream, warnings.catch_warnings():
            warnings.filterwarnings("ignore", "loadtxt: input contained no data")
            for _ in range(self.header):
                stream.readline()
            lines = (line.replace(",", ".") for line in stream) if self.delimiter == ";" else stream
            while more := list(islice(lines, ROWS)):
                table = np.loadtxt(more, delimiter=self.delimiter, comments="#", quotechar='"', ndmin=2)
                if table.size and table.shape[1] != len(self.names):
                    raise ValueError("cells")
                parts += [table[:, at]] if table.size else []
                rows += len(parts[-1])
                if rows * len(at) * 8 > MAX_TABLE:
                    what = f"{len(at)} columns take more than {MAX_TABLE // 10**9} GB"
                    raise RotorsimError(Problem(what, hint="split it into several runs"))
        return np.concatenate(parts)

    def _rows(self) -> Iterator[tuple[int, list[str], str]]:
        """Yield line number, cells and text of every line of data."""
        with _text(self.path) as stream:
            for number, line in enumerate(stream, start=1):
                text = line.partition("#")[0].rstrip("\r\n")
                if number > self.header and text.strip():
                    yield number, _cells(text, self.delimiter), text

    def cells(self, wanted: Sequence[str]) -> dict[str, np.ndarray]:
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
                    value = _number(row[k].replace(",", ".") if self.delimiter == ";" else row[k])
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

    def _place(self, line: int, k: int = 0, text: str = "") -> Place:
        column = 1 + sum(len(part) + 1 for part in text.split(self.delimiter)[:k])
        return Place("", line, column if '"' not in text else 1)


def _text(path: Path) -> TextIO:
    with path.open("rb") as stream:
        wide = stream.read(2) in (b"\xff\xfe", b"\xfe\xff")
    return path.open(encoding="utf-16" if wide else "utf-8-sig", errors="replace")


def _header(stream: TextIO) -> tuple[str, int]:
    """Return the first line that is no comment, and its number; of np.savetxt, whose header is a comment, that one."""
    comment, comment_line, number = "", 0, 0
    for number, line in enumerate(iter(lambda: stream.readline(MAX_LINE), ""), start=1):
        if len(line) >= MAX_LINE:
            raise RotorsimError(Problem(f"a line is longer than {MAX_LINE} characters", place=Place("", number, 1)))
        text = line.strip()
        if text.startswith("#"):
            comment, comment_line = text.lstrip("# "), number
        elif text:
            cells = re.split(r"[,;\t]", text)
            numbers = None not in map(_number, cells)
            if comment_line and numbers and len(re.split(r"[,;\t]", comment)) == len(cells):
                return comment, comment_line
            return text, number
    return "", number


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        cells = line.split(delimiter)
    return [cell.strip() for cell in cells]


def _no_number(cell: str, name: str, place: Place) -> Problem:
    short = cell if len(cell) <= 40 else cell[:37] + "..."
    hint = "units go into recording.json, remarks behind '#'" if cell else "write nan for a sample that is missing"
    return Problem(f"'{short}' is not a number" if cell else "the cell is empty", f"column {name}", place, hint)


def _number(cell: str) -> float | None:
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None
