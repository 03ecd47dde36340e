"""What the verbs print: data on standard output, problems, notes and progress on standard error."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

import click

from rotorsim.errors import Problem, visible
from rotorsim.files import json_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def show(as_json: bool, data: Callable[[], Any], text: Callable[[], str]) -> None:
    """Print a result on stdout: its data as JSON, or its text, if there is any."""
    if as_json:
        echo_json(data())
    elif said := text():
        click.echo(said)


def echo_json(data: Any) -> None:
    """Print data as JSON on stdout; numbers that it has not as `json_number` says."""
    click.echo(json.dumps(plain(data), indent=2, allow_nan=False))


def plain(value: Any) -> Any:
    """Return arrays, NumPy numbers and complex numbers as plain data ([re, im] for a complex number)."""
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    return json_number(value) if isinstance(value, float) else value


def note(text: str) -> None:
    """Say something about the work, on stderr."""
    click.echo(visible(text), err=True)


def note_mistakes(count: int) -> None:
    """Say how many mistakes there are, if any, on stderr."""
    if count:
        note(f"\n{count} mistake{'s' if count > 1 else ''}")


def save_plot(draw: Callable[[], Figure], file: str | None) -> None:
    """Draw a figure into a file, where one is wanted, and say so."""
    if file:
        from rotorsim.report.figures.run import save_figure

        save_figure(draw(), file)
        note(f"written: {file}")


def show_problems(problems: Sequence[Problem], file: TextIO | None = None) -> None:
    """Print problems on stderr, one after the other, with the severity coloured on a terminal."""
    stream = file or sys.stderr
    coloured = stream.isatty() and not os.environ.get("NO_COLOR")
    for index, problem in enumerate(problems):
        text = str(problem)
        if coloured:
            colour = "red" if problem.severity == "error" else "yellow"
            text = text.replace(f"{problem.severity}:", click.style(f"{problem.severity}:", fg=colour, bold=True), 1)
        separator = "" if index == len(problems) - 1 else "\n" if problem.hint else ""
        click.echo(text + separator, file=stream, color=coloured)


def warn(what: str, subject: str = "", hint: str = "") -> None:
    """Print a warning on stderr."""
    show_problems([Problem(what, subject, hint=hint, severity="warning")])


def problem_data(problem: Problem) -> dict[str, Any]:
    """Return a problem as plain data for ``--json``."""
    return {
        "file": problem.place.file,
        "line": problem.place.line,
        "column": problem.place.column,
        "severity": problem.severity,
        "subject": problem.subject,
        "what": problem.what,
        "hint": problem.hint,
    }


@contextmanager
def progress_bar(label: str, wanted: bool | None) -> Iterator[Callable[[float], None] | None]:
    """Give a function that takes the fraction done (0..1), or None where no bar is wanted."""
    if not (sys.stderr.isatty() if wanted is None else wanted):
        yield None
        return
    from tqdm import tqdm

    form = "{l_bar}{bar}| {elapsed} < {remaining}"
    with tqdm(total=1.0, desc=label, bar_format=form, file=sys.stderr, leave=False, delay=0.0) as bar:
        yield lambda fraction: bar.update(max(0.0, min(1.0, fraction) - bar.n))
