"""CSV as instruments write it: comma, semicolon or tab, quoted names, comment lines, decimal commas."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.recordings.readers.reader import Columns
from rotorsim.recordings.readers.text import TextTable, cells_of, number_of, numbered_lines, open_text


class CsvReader:
    """Reads .csv."""

    suffixes = (".csv",)
    counted = False

    def read(self, path: Path, wanted: Sequence[str]) -> Columns:
        """Return the columns that are wanted. Raises RotorsimError with the place of every wrong cell."""
        with open_text(path) as stream:
            header, line = _header(stream)
        outside = re.sub(r'"[^"]*"', "", header)
        delimiter = next((mark for mark in ";\t" if mark in outside), ",")
        names = cells_of(header, delimiter)
        if not any(names) or all(number_of(name) is not None for name in names):
            hint = "the first line names the columns, as in 't,x,y'"
            raise RotorsimError(Problem("no line with the names of the columns", "", Place("", line, 1), hint))
        return TextTable(path, names, line, delimiter, "," if delimiter == ";" else ".").columns(wanted)


def _header(stream: TextIO) -> tuple[str, int]:
    """Return the first line that is no comment, and its number; of np.savetxt, whose header is a comment, that one."""
    comment, comment_line, number = "", 0, 0
    for number, line in numbered_lines(stream):
        text = line.strip()
        if text.startswith("#"):
            comment, comment_line = text.lstrip("# "), number
        elif text:
            cells = re.split(r"[,;\t]", text)
            numbers = None not in map(number_of, cells)
            if comment_line and numbers and len(re.split(r"[,;\t]", comment)) == len(cells):
                return comment, comment_line
            return text, number
    return "", number
