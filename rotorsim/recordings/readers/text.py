"""What formats of text share: opening, cells, numbers, and a table of lines whose mistakes have their place."""

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
from rotorsim.recordings.readers.reader import Columns, check_names, refuse_large

MAX_LINE = 1_000_000  # characters
ROWS = 100_000  # read at a time: only what is wanted of them is kept
TAIL = 1 << 16  # bytes at the end of a file, with whose numbers the last one is compared
MAX_CELL_PROBLEMS = 20
CUT = "the file ends within this line: it was cut off; copy it again, or delete the line"


def open_text(path: Path) -> TextIO:
    """Open a file of UTF-8 or UTF-16; what is neither becomes a character that is no digit."""
    return path.open(encoding="utf-16" if _wide_mark(path) else "utf-8-sig", errors="replace")


def last_lines(path: Path) -> list[str]:
    """Return the last whole lines of a file, and what stands behind the last line feed."""
    mark = _wide_mark(path)
    with path.open("rb") as stream:
        start = max(path.stat().st_size // 2 * 2 - TAIL, len(mark))
        stream.seek(start)
        text = (mark + stream.read()).decode("utf-16" if mark else "utf-8-sig", errors="replace")
    lines = re.split(r"\r\n|\r|\n", text)
    return lines[start > len(mark) :]


def _wide_mark(path: Path) -> bytes:
    """Return the bytes at the start of a file that say UTF-16, else none."""
    with path.open("rb") as stream:
        mark = stream.read(2)
    return mark if mark in (b"\xff\xfe", b"\xfe\xff") else b""


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
        header = Place("", self.header, 1)
        check_names(wanted, self.names, header)
        for name in wanted:
            if self.names.count(name) > 1:
                what = f"column '{name}' is there {self.names.count(name)} times"
                raise RotorsimError(Problem(what, place=header, hint="rename one of them"))
        try:
            rows = self._numbers([self.names.index(name) for name in wanted])
        except ValueError:  # text in a cell, perhaps of a column that nobody wants
            values = self._cells(wanted)
        else:
            values = dict(zip(wanted, np.ascontiguousarray(rows.T), strict=True))
        name = self._cut_column()
        if name not in values:
            return Columns(values, self._place_of)
        last = len(values[name]) - 1
        what = "the last line has no line feed, and this number may lack digits: the line is left out"
        hint = "copy the file again; if this line is whole, end it with a line feed"
        warning = Problem(what, f"column {name}", self._place_of(last, name), hint, "warning")
        return Columns({name: array[:last] for name, array in values.items()}, self._place_of, (warning,))

    def _cut_column(self) -> str:
        """Return the column, if any, in whose last number the file ends without a line feed, and others are longer.

        As many digits behind the point as any other has, and as long an exponent, say that nothing is missing.
        """
        *others, last = last_lines(self.path)
        rows = [cells_of(line.partition("#")[0], self.delimiter) for line in (*others, last)]
        k = len(rows[-1]) - 1
        if (
            "#" in last
            or last.rstrip().endswith('"')
            or not 0 <= k < len(self.names)
            or not self._is_number(rows[-1][k])
        ):
            return ""
        column = [row[k] for row in rows if len(row) > k and self._is_number(row[k])]
        point = any(re.search("[.,]", cell) for cell in column[:-1])
        digits = [len("".join(re.split("[.,]", cell)[1:])) if point else len(cell.lstrip("+-")) for cell in column]
        exponents = [len(cell.lower().partition("e")[2]) for cell in column]
        first = exponents[-1] > 0 and not any(exponents[:-1])
        return self.names[k] if first or digits[-1] < max(digits) or 0 < exponents[-1] < max(exponents) else ""

    def _is_number(self, cell: str) -> bool:
        return number_of(cell.replace(self.decimal, ".")) is not None

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
        for line, row, text, ended in self._rows():
            cut = "" if ended else CUT
            if len(row) not in (len(self.names), len(self.names) + (row[-1] == "")):
                what = f"{len(row)} cells, but the header names {len(self.names)}"
                wrong = [Problem(what, "", self._place(line), cut)]
            else:
                wrong = []
                for name, values in columns.items():
                    k = self.names.index(name)
                    value = number_of(row[k].replace(self.decimal, "."))
                    if value is None:
                        hint = cut if k == len(row) - 1 else ""
                        wrong.append(_no_number(row[k], name, self._place(line, k, text), hint))
                    else:
                        values.append(value)
            mistakes += len(wrong)
            problems += wrong[: MAX_CELL_PROBLEMS - len(problems)]
        if mistakes > MAX_CELL_PROBLEMS:
            problems.append(Problem(f"{mistakes - MAX_CELL_PROBLEMS} more cells are wrong"))
        if problems:
            raise RotorsimError(*problems)
        return {name: np.array(values) for name, values in columns.items()}

    def _rows(self) -> Iterator[tuple[int, list[str], str, bool]]:
        """Yield line number, cells and text of every line of samples, and whether a line feed ends it."""
        with open_text(self.path) as stream:
            for number, line in enumerate(stream, start=1):
                text = line.partition("#")[0].rstrip("\r\n")
                if number > self.header and text.strip():
                    yield number, cells_of(text, self.delimiter), text, line[-1] in "\r\n"

    def _place_of(self, sample: int, column: str) -> Place:
        """Return the line and column of a sample, counted from 0."""
        line, _, text, _ = next(islice(self._rows(), sample, None))
        return self._place(line, self.names.index(column), text)

    def _place(self, line: int, k: int = 0, text: str = "") -> Place:
        column = 1 + sum(len(part) + 1 for part in text.split(self.delimiter)[:k])
        return Place("", line, column if '"' not in text else 1)


def _no_number(cell: str, name: str, place: Place, cut: str) -> Problem:
    short = cell if len(cell) <= 40 else cell[:37] + "..."
    hint = "units go into recording.json, remarks behind '#'" if cell else "write nan for a sample that is missing"
    return Problem(f"'{short}' is not a number" if cell else "the cell is empty", f"column {name}", place, cut or hint)
