"""What the verbs share: options, opening a diagram, printing, progress."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from rotorsim.errors import Problem, RotorsimError, near_miss, visible

if TYPE_CHECKING:
    import numpy as np

    from rotorsim.diagram.diagram import Diagram

__all__ = [
    "Group",
    "check_folder",
    "check_target",
    "diagram_options",
    "display_unit",
    "document_of",
    "echo_json",
    "json_option",
    "note",
    "open_diagram",
    "parse_settings",
    "plain",
    "progress_bar",
    "progress_option",
    "quantity",
    "speeds_of",
    "table",
]

FIGURES = (".png", ".svg", ".pdf")
NOISE_KINDS = ("white", "thesis", "uniform")  # `measuring.KINDS`, which takes SciPy to import

F = TypeVar("F", bound=Callable[..., Any])

json_option = click.option("--json", "as_json", is_flag=True, help="Print machine-readable JSON.")
progress_option = click.option(
    "--progress/--no-progress", default=None, help="Show progress on stderr (default: only on a terminal)."
)
diagram_argument = click.argument("diagram", metavar="DIAGRAM")
set_option = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="Give a parameter another value: speed='3000 rpm' or controller.KP=14000; repeatable.",
)
without_option = click.option(
    "--without", multiple=True, metavar="BLOCK", help="Cut the wires of this block (no crack, no AMB, ...); repeatable."
)
trust_option = click.option(
    "--trust-blocks",
    is_flag=True,
    help="Run what the diagram brings along, block files in its folders and (cosim) FMUs: they are code.",
)


def diagram_options(function: F) -> F:
    """Add DIAGRAM, --set, --without and --trust-blocks to a verb."""
    for decorate in (trust_option, without_option, set_option, diagram_argument):
        function = decorate(function)
    return function


class Group(click.Group):
    """Verb with verbs of its own, which knows near misses of them."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        verbs = self.list_commands(ctx)
        if args and not args[0].startswith("-") and args[0] not in verbs:
            hint = near_miss(args[0], verbs)
            raise RotorsimError(Problem(what=f"unknown verb '{self.name} {args[0]}'", hint=hint))
        return super().resolve_command(ctx, args)


def parse_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Return ``NAME=VALUE`` texts as a mapping; a value is JSON (number, list, true) or text with a unit."""
    values: dict[str, Any] = {}
    problems = []
    for text in settings:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name or not value:
            problems.append(Problem(what=f"--set {text}: not NAME=VALUE", hint="for example --set controller.KP=14000"))
            continue
        try:
            values[name] = json.loads(value, parse_constant=lambda constant: constant)
        except (ValueError, RecursionError):
            values[name] = value
    if problems:
        raise RotorsimError(*problems)
    return values


def echo_json(data: Any) -> None:
    """Print data as JSON on stdout; numbers that JSON cannot hold become null."""
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
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def note(text: str) -> None:
    """Say something about the work, on stderr."""
    click.echo(visible(text), err=True)


def table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return columns aligned: the first to the left, the others to the right."""
    rows = [list(header), *[list(line) for line in lines]]
    widths = [max(len(row[k]) for row in rows) for k in range(len(header))]
    text = []
    for row in rows:
        cells = [row[0].ljust(widths[0]), *[cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]]
        text.append("  ".join(cells).rstrip())
    return "\n".join(text)


@contextmanager
def progress_bar(label: str, wanted: bool | None) -> Iterator[Callable[[float], None] | None]:
    """Give a function that takes the fraction done (0..1), or None where no bar is wanted."""
    if not (sys.stderr.isatty() if wanted is None else wanted):
        yield None
        return
    from tqdm import tqdm

    form = "{l_bar}{bar}| {elapsed} < {remaining}"
    with tqdm(total=1.0, desc=label, bar_format=form, file=sys.stderr, leave=False, delay=0.0) as bar:

        def show(fraction: float) -> None:
            bar.update(max(0.0, min(1.0, fraction) - bar.n))

        yield show


def open_diagram(diagram: str, settings: Sequence[str], without: Sequence[str], trust_blocks: bool) -> Diagram:
    """Load a diagram with its settings; show its warnings on stderr."""
    from rotorsim.cli.app import show_problems
    from rotorsim.model.load import load

    loaded = load(diagram, set=parse_settings(settings), without=without, trust_blocks=trust_blocks)
    show_problems(loaded.warnings)
    return loaded


def document_of(diagram: str) -> tuple[Path, dict[str, Any]]:
    """Return the file and the JSON of a diagram (a file, or the name of a shipped one), not validated."""
    from rotorsim.cli.app import show_problems
    from rotorsim.diagram.parse.source import read_document
    from rotorsim.diagram.resolve.resolution import find_diagram

    path, said = find_diagram(diagram)
    show_problems(said)
    source = read_document(path)
    if not isinstance(source.data, dict):
        raise RotorsimError(Problem("a diagram is a JSON object {...}", place=source.locate()))
    return path, source.data


def check_target(option: str, file: str | None, suffixes: Sequence[str]) -> None:
    """Refuse a file that cannot be written, before the work is done."""
    if file is None:
        return
    path = Path(file)
    if path.suffix.lower() not in suffixes:
        what = f"unknown format '{path.suffix}'" if path.suffix else "the name has no suffix that says the format"
        hint = f"one of {', '.join(suffixes)}"
        raise RotorsimError(Problem(what=f"{option} {file}: {what}", hint=hint))
    if path.is_dir():
        raise RotorsimError(Problem(what=f"{option} {file}: is a folder", hint="give the name of a file"))
    if not path.parent.is_dir():
        raise RotorsimError(
            Problem(what=f"{option} {file}: folder {path.parent} does not exist", hint="create it first")
        )


def check_folder(option: str, folder: str | None) -> None:
    """Refuse a folder that cannot be made, before the work is done."""
    if folder is None:
        return
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise RotorsimError(Problem(what=f"{option} {folder}: is a file", hint="give the name of a folder"))
    parent = next((p for p in path.absolute().parents if p.exists()), None)
    if parent is None or not parent.is_dir():
        raise RotorsimError(Problem(what=f"{option} {folder}: cannot be made", hint="give the name of a folder"))


def quantity(text: str, unit: str, option: str) -> float:
    """Return the SI value of an option such as ``--stop "5 s"``; a bare number is in SI."""
    from rotorsim.units import UnitError, parse_quantity

    try:
        return parse_quantity(text, unit, bare=True)
    except UnitError as error:
        raise RotorsimError(Problem(what=f"{option} {text}: {error.what}", hint=error.hint)) from None


def display_unit(unit: str) -> tuple[str, float]:
    """Return the unit to show and the factor from SI: micrometres for metres, else as it is."""
    return ("um", 1e6) if unit == "m" else (unit or "1", 1.0)


def rpm(speed: float) -> float:
    """Return a speed [rad/s] in rpm."""
    return speed * 30 / math.pi


def degrees(value: complex) -> float:
    """Return the phase of a complex amplitude in degrees."""
    return math.degrees(math.atan2(value.imag, value.real))


def clock_of(diagram: Diagram) -> str | None:
    """Return the block that gives the shaft angle: the only clock, or the one named so."""
    found = [name for name, node in diagram.nodes.items() if node.block.type_name == "clock"]
    return "clock" if "clock" in found else found[0] if len(found) == 1 else None


MAX_SPEEDS = 100_000


_SPAN = re.compile(r"\s*(\d+\.?\d*)\s*([A-Za-z/]*)\s*(?:-|\.\.|to)\s*(\d+\.?\d*)\s*([A-Za-z/]*)\s*")


def speeds_of(text: str, option: str = "--speeds") -> np.ndarray:
    """Return the speeds [rad/s] of ``"900 rpm:100 rpm:6000 rpm"`` (start:step:stop), a list ``a,b,c``, or one.

    The stop is included where whole steps reach it.
    """
    import numpy as np

    hint = "write start:step:stop, as in '900 rpm:100 rpm:6000 rpm', or a list as in '900 rpm, 1200 rpm'"
    if ":" not in text:
        try:
            return np.array([quantity(part.strip(), "rad/s", option) for part in text.split(",")])
        except RotorsimError:
            if span := _SPAN.fullmatch(text):
                low, high, unit = float(span[1]), float(span[3]), span[4] or span[2]
                ends = f"{low:g} {unit}".strip(), f"{(high - low) / 10:.3g} {unit}".strip(), f"{high:g} {unit}".strip()
                hint = f"a range is start:step:stop, as in '{':'.join(ends)}'"
                raise RotorsimError(Problem(what=f"{option} {text}: a range without a step", hint=hint)) from None
            raise
    parts = [quantity(part.strip(), "rad/s", option) for part in text.split(":")]
    if len(parts) != 3:
        raise RotorsimError(Problem(what=f"{option} {text}: {len(parts)} parts, 3 expected", hint=hint))
    start, step, stop = parts
    if step == 0 or (stop - start) / step < -1e-9:
        raise RotorsimError(Problem(what=f"{option} {text}: these steps never reach the stop", hint=hint))
    count = math.floor((stop - start) / step * (1 + 1e-12) + 1e-9) + 1
    if count > MAX_SPEEDS:
        raise RotorsimError(
            Problem(what=f"{option} {text}: {count} speeds, at most {MAX_SPEEDS}", hint="use a larger step")
        )
    return start + step * np.arange(count)
