"""CSV as instruments write it: comma, semicolon or tab, quoted names, comment lines, decimal commas."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError

__all__ = ["CsvTable"]

MAX_LINE = 1_000_000
MAX_TABLE = 2_000_000_000  # bytes of the columns that are wanted
ROWS = 100_000  # read at a time: only what is wanted of them is kept
MAX_PROBLEMS = 20


class CsvTable:
    """A CSV file: its names are read at once, its numbers when they are asked for."""

    def __init__(self, path: Path, file: str) -> None:
        self.path, self.file = path, file
        self.header_line, self.delimiter = 0, ","
        with self._open() as stream:
            header = self._header(stream)
        outside = re.sub(r'"[^"]*"', "", header)
        self.delimiter = next((mark for mark in ";\t" if mark in outside), ",")
        self.names = self._cells(header)
        if not any(self.names) or all(_number(name) is not None for name in self.names):
            hint = "the first line names the columns, as in 't,x,y'"
            raise RotorsimError(Problem("no line with the names of the columns", place=self._place(), hint=hint))

    def read(self, wanted: Sequence[str]) -> dict[str, np.ndarray]:
        """Return columns: name -> (n,). Raises RotorsimError with the place of every wrong cell."""
        twice = [name for name in wanted if self.names.count(name) > 1]
        if twice:
            what = f"column '{twice[0]}' is there {self.names.count(twice[0])} times"
            raise RotorsimError(Problem(what, place=self._place(), hint="rename one of them"))
        try:
            with self._open() as stream, warnings.catch_warnings():
                warnings.filterwarnings("ignore", "loadtxt: input contained no data")
                for _ in range(self.header_line):
                    stream.readline()
                lines = (line.replace(",", ".") for line in stream) if self.delimiter == ";" else stream
                at = [self.names.index(name) for name in wanted]
                parts, rows = [np.empty((0, len(wanted)))], 0
                while more := list(islice(lines, ROWS)):
                    table = np.loadtxt(more, delimiter=self.delimiter, comments="#", quotechar='"', ndmin=2)
                    if table.size and table.shape[1] != len(self.names):
                        raise ValueError("cells")
                    parts.append(table[:, at] if table.size else parts[0])
                    rows += len(parts[-1])
                    if rows * len(wanted) * 8 > MAX_TABLE:
                        what = f"{len(wanted)} columns take more than {MAX_TABLE // 10**9} GB"
                        raise RotorsimError(Problem(what, place=Place(self.file), hint="split it into several runs"))
            return {name: np.concatenate([part[:, k] for part in parts]) for k, name in enumerate(wanted)}
        except ValueError:
            pass  # text in a cell, perhaps of a column that nobody wants
        return self._read_slowly(wanted)

    def place(self, sample: int, name: str) -> Place:
        """Return the line and column of a sample, counted from 0."""
        for k, (line, row, text) in enumerate(self._rows()):
            if k == sample:
                return self._place(line, row, self.names.index(name), text)
        return self._place()

    def _open(self) -> TextIO:
        with self.path.open("rb") as stream:
            wide = stream.read(2) in (b"\xff\xfe", b"\xfe\xff")
        return self.path.open(encoding="utf-16" if wide else "utf-8-sig", errors="replace")

    def _header(self, stream: TextIO) -> str:
        """Return the first line that is no comment; of np.savetxt, whose header is a comment, that one."""
        comment, comment_line = "", 0
        for line in iter(lambda: stream.readline(MAX_LINE), ""):
            self.header_line += 1
            if len(line) >= MAX_LINE:
                raise RotorsimError(Problem(f"a line is longer than {MAX_LINE} characters", place=self._place()))
            text = line.strip()
            if text.startswith("#"):
                comment, comment_line = text.lstrip("# "), self.header_line
            elif text:
                cells = re.split(r"[,;\t]", text)
                if comment_line and len(re.split(r"[,;\t]", comment)) == len(cells) and None not in map(_number, cells):
                    self.header_line = comment_line
                    return comment
                return text
        return ""

    def _cells(self, line: str) -> list[str]:
        try:
            return [
                cell.strip() for cell in next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), [])
            ]
        except csv.Error:
            return [cell.strip() for cell in line.split(self.delimiter)]

    def _rows(self) -> Iterator[tuple[int, list[str], str]]:
        """Yield line number, cells and text of every line of data."""
        with self._open() as stream:
            for number, line in enumerate(stream, start=1):
                text = line.partition("#")[0].rstrip("\r\n")
                if number > self.header_line and text.strip():
                    yield number, self._cells(text), text

    def _read_slowly(self, wanted: Sequence[str]) -> dict[str, np.ndarray]:
        """Read cell by cell: columns of text that nobody wants are passed over, and mistakes are placed."""
        at = {name: self.names.index(name) for name in wanted}
        columns: dict[str, list[float]] = {name: [] for name in wanted}
        problems: list[Problem] = []
        mistakes = 0
        for line, row, text in self._rows():
            if len(row) not in (len(self.names), len(self.names) + (row[-1] == "")):
                mistakes += 1
                if mistakes <= MAX_PROBLEMS:
                    what = f"{len(row)} cells, but the header names {len(self.names)}"
                    problems.append(Problem(what, place=self._place(line)))
                continue
            for name, k in at.items():
                value = _number(row[k].replace(",", ".") if self.delimiter == ";" else row[k])
                if value is None:
                    mistakes += 1
                    if mistakes <= MAX_PROBLEMS:
                        problems.append(self._wrong(row[k], name, self._place(line, row, k, text)))
                else:
                    columns[name].append(value)
        if problems:
            if mistakes > MAX_PROBLEMS:
                problems.append(Problem(f"{mistakes - MAX_PROBLEMS} more cells are wrong", place=Place(self.file)))
            raise RotorsimError(*problems)
        return {name: np.array(values) for name, values in columns.items()}

    def _wrong(self, cell: str, name: str, place: Place) -> Problem:
        short = cell if len(cell) <= 40 else cell[:37] + "..."
        what = f"'{short}' is not a number" if cell else "the cell is empty"
        hint = "units go into recording.json, remarks behind '#'" if cell else "write nan for a sample that is missing"
        return Problem(what, f"column {name}", place, hint)

    def _place(self, line: int = 0, row: Sequence[str] = (), k: int = 0, text: str = "") -> Place:
        column = 1 + sum(len(part) + 1 for part in text.split(self.delimiter)[:k])
        return Place(self.file, line or self.header_line, column if '"' not in text else 1)


def _number(cell: str) -> float | None:
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None
