"""What the verbs read from their options: diagrams, settings, quantities, speeds, lists, files to be written."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorsim.cli.shared.output import show_problems
from rotorsim.cli.shared.refusals import refuse_all, refuse_if
from rotorsim.errors import Problem, RotorsimError, near_miss

if TYPE_CHECKING:
    import numpy as np

    from rotorsim.diagram.diagram import Diagram


HERTZ = {"": 1.0, "Hz": 1.0, "kHz": 1e3, "MHz": 1e6}
MAX_SPEEDS = 100_000
RECORDING = "recording.json"
NEXT = re.compile(r",(?=\s*[A-Za-z_][\w/.]*\s*=)")  # a comma before NAME=, not one inside a list
SPAN = re.compile(r"\s*(\d+\.?\d*)\s*([A-Za-z/]*)\s*(?:-|\.\.|to)\s*(\d+\.?\d*)\s*([A-Za-z/]*)\s*")


@dataclass(frozen=True)
class Chosen:
    """A diagram with --set, --without and --trust-blocks, as they stand on the command line."""

    name: str
    settings: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    trust_blocks: bool = False

    def open(self) -> Diagram:
        """Load the diagram with its settings; show its warnings on stderr."""
        from rotorsim.model.load import load

        values = parse_settings(self.settings)
        loaded = load(self.name, set=values, without=self.without, trust_blocks=self.trust_blocks)
        show_problems(loaded.warnings)
        return loaded

    def refuse_changes(self, what: str) -> None:
        """Raise RotorsimError where --set or --without are given of what is no diagram."""
        refuse_if(self.settings or self.without, f"--set and --without need a diagram, not {what}", self.name)


def document_of(diagram: str) -> tuple[Path, dict[str, Any]]:
    """Return the file and the JSON of a diagram (a file, or the name of a shipped one), not validated."""
    from rotorsim.diagram.resolve.resolution import find_diagram

    path, said = find_diagram(diagram)
    show_problems(said)
    return path, object_of(path)


def object_of(file: str | Path) -> dict[str, Any]:
    """Return the JSON of a file of a diagram, not validated."""
    from rotorsim.diagram.parse.source import read_document

    source = read_document(file)
    refuse_if(not isinstance(source.data, dict), "a diagram is a JSON object {...}", place=source.locate())
    data: dict[str, Any] = source.data
    return data


def is_recording(source: str, results: Sequence[str] = ()) -> bool:
    """Return whether a name on the command line is a recording: its folder, its recording.json, or a data file.

    A folder without recording.json does not stand before a shipped diagram of its name. A data file is refused as
    a recording, with what is missing; suffixes in ``results`` are those of files that are no recording.
    """
    path = Path(source)
    try:
        if path.suffix and path.suffix != ".json" and path.suffix.lower() not in results and path.is_file():
            from rotorsim.recordings.readers.columns import READERS

            return path.suffix.lower() in READERS
        if path.name == RECORDING or (path / RECORDING).exists():
            return True
        if path.is_dir():
            from rotorsim.diagram.resolve.resolution import shipped_diagrams

            return source not in shipped_diagrams()
        data = json.loads(path.read_bytes()) if path.suffix == ".json" and path.is_file() else None
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(data, dict) and "runs" in data and "channels" in data and "blocks" not in data


def clock_of(diagram: Diagram) -> str | None:
    """Return the block that gives the shaft angle: the only clock, or the one named so."""
    clocks = [name for name, node in diagram.nodes.items() if node.block.type_name == "clock"]
    return "clock" if "clock" in clocks else clocks[0] if len(clocks) == 1 else None


# -- files to be written -----------------------------------------------------------------------------------------------


def check_target(option: str, file: str | None, suffixes: Sequence[str]) -> None:
    """Refuse a file that cannot be written, before the work is done."""
    if file is None:
        return
    path, what, hint = Path(file), "", ""
    if path.suffix.lower() not in suffixes:
        what = f"unknown format '{path.suffix}'" if path.suffix else "the name has no suffix that says the format"
        hint = f"one of {', '.join(suffixes)}"
    elif path.is_dir():
        what, hint = "is a folder", "give the name of a file"
    elif not path.parent.is_dir():
        what, hint = f"folder {path.parent} does not exist", "create it first"
    refuse_if(what, f"{option} {file}: {what}", hint=hint)


def check_folder(option: str, folder: str | None) -> None:
    """Refuse a folder that cannot be made, before the work is done."""
    if folder is None:
        return
    path = Path(folder)
    parent = next((p for p in path.absolute().parents if p.exists()), None)
    hint = "give the name of a folder"
    refuse_if(path.exists() and not path.is_dir(), f"{option} {folder}: is a file", hint=hint)
    refuse_if(parent is None or not parent.is_dir(), f"{option} {folder}: cannot be made", hint=hint)


def keep_diagram(out: str | None, diagram: str) -> None:
    """Refuse a folder in which the new diagram.json would overwrite the given one."""
    refuse_if(
        out and Path(diagram).exists() and (Path(out) / "diagram.json").resolve() == Path(diagram).resolve(),
        f"--out {out}: would overwrite {diagram}",
        hint="give another folder",
    )


# -- settings and lists ------------------------------------------------------------------------------------------------


def named_values(
    texts: Iterable[str], refuse: Callable[[str], Problem], twice: Callable[[str], Problem] | None = None
) -> dict[str, str]:
    """Return ``NAME=VALUE`` texts as a mapping. Raises RotorsimError with what is said of all wrong ones.

    twice: what is said of a name that is there twice; without it the last value counts.
    """
    pairs = [(text.strip(), *(part.strip() for part in text.partition("="))) for text in texts]
    names = [name for _, name, *_ in pairs]
    problems = [refuse(text) for text, name, equals, value in pairs if not (name and equals and value)]
    problems += [twice(name) for name in dict.fromkeys(names) if twice and names.count(name) > 1]
    refuse_all(problems)
    return {name: value for _, name, _, value in pairs}


def _json_or_text(value: str) -> Any:
    """Return a value that is JSON (number, list, true), else the text (with a unit) as it is."""
    try:
        return json.loads(value, parse_constant=lambda constant: constant)
    except (ValueError, RecursionError):
        return value


def parse_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Return the ``NAME=VALUE`` texts of --set as a mapping."""
    hint = "for example --set controller.KP=14000"
    values = named_values(settings, lambda text: Problem(f"--set {text}: not NAME=VALUE", hint=hint))
    return {name: _json_or_text(value) for name, value in values.items()}


def gains_of(text: str) -> dict[str, Any]:
    """Return ``"controller.KP=9000, controller.KD=4.5"`` of --gains as a mapping."""
    hint = "for example --gains 'controller.KP=9000, controller.KD=4.5'"
    values = named_values(
        NEXT.split(text),
        lambda part: Problem(f"--gains {text}: '{part}' is not NAME=VALUE", hint=hint),
        lambda name: Problem(f"--gains {text}: {name} is there twice", hint="a --gains for each value"),
    )
    return {name: _json_or_text(value) for name, value in values.items()}


def listed(text: str) -> tuple[str, ...]:
    """Return the names of a list; commas within brackets belong to a name."""
    return tuple(part.strip() for part in re.split(r",(?![^\[]*\])", text) if part.strip())


def known_names(
    names: Iterable[str], known: Iterable[str], refused: Callable[[str], str], subject: str = ""
) -> list[str]:
    """Return names, each once. Raises RotorsimError with what is said of all unknown ones, and their near misses."""
    names, known = list(dict.fromkeys(names)), list(known)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise RotorsimError(*(Problem(refused(n), subject, hint=near_miss(n, known)) for n in unknown))
    return names


def whole_numbers(option: str, text: str, hint: str) -> tuple[int, ...]:
    """Return the whole numbers, all different, of ``"1,2"``."""
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    refuse_if(
        not numbers or len(set(numbers)) < len(numbers),
        f"{option} {text}: not a list of different whole numbers",
        hint=hint,
    )
    return numbers


def share_of(option: str, text: str, hint: str) -> float:
    """Return a share, of one, of ``"5 %"`` or ``"0.05"``."""
    try:
        value = float(text.rstrip("% ")) / (100 if "%" in text else 1)
    except ValueError:
        value = -1.0
    refuse_if(not 0 < value <= 1, f"{option} {text}: not a share", hint=hint)
    return value


# -- quantities --------------------------------------------------------------------------------------------------------


def quantity(text: str, unit: str, option: str) -> float:
    """Return the SI value of an option such as ``--stop "5 s"``; a bare number is in SI."""
    from rotorsim.units import UnitError, parse_quantity

    try:
        return parse_quantity(text, unit, bare=True)
    except UnitError as error:
        raise RotorsimError(Problem(f"{option} {text}: {error.what}", hint=error.hint)) from None


def hertz(text: str, option: str, what: str = "frequency", example: str = "5 Hz:2000 Hz") -> float:
    """Return a frequency [Hz]: samples and swings are counted in a second, never in a turn."""
    from rotorsim.units import UnitError, split_quantity

    try:
        value, unit = split_quantity(text)
    except UnitError:
        value, unit = 0.0, ""
    refuse_if(
        not 1e-6 <= value * HERTZ.get(unit, 0.0) <= 1e12,
        f"{option} {text}: not a {what}",
        hint=f"for example {option} '{example}'",
    )
    return value * HERTZ[unit]


def band_of(text: str, option: str) -> tuple[float, float]:
    """Return the ends [Hz] of a text such as ``"5 Hz:2000 Hz"``."""
    ends = [hertz(part.strip(), option) for part in text.split(":")]
    hint = f"for example {option} '5 Hz:2000 Hz'"
    refuse_if(len(ends) != 2 or ends[-1] <= ends[0], f"{option} {text}: not LOW:HIGH", hint=hint)
    return ends[0], ends[1]


def window_of(window: str) -> tuple[float, float]:
    """Return the ends [s] of a text such as ``"4 s:5 s"``."""
    ends = [quantity(part.strip(), "s", "--window") for part in window.split(":")]
    refuse_if(
        len(ends) != 2 or ends[1] <= ends[0],
        f"--window {window}: not START:STOP",
        hint="for example --window '4 s:5 s'",
    )
    return ends[0], ends[1]


def span_of(text: str, option: str) -> tuple[float, float]:
    """Return the ends [rad/s] of a range of speeds such as ``"3000 rpm:3600 rpm"``, or of one speed."""
    ends = [quantity(part.strip(), "rad/s", option) for part in text.split(":")]
    hint = f"for example {option} '3000 rpm:3600 rpm'"
    refuse_if(len(ends) > 2 or min(ends) < 0 or ends[-1] < ends[0], f"{option} {text}: not LOW:HIGH", hint=hint)
    refuse_if(ends[-1] == 0, f"{option} {text}: a shaft that does not turn", hint=hint)
    return ends[0], ends[-1]


def speeds_of(text: str, option: str = "--speeds") -> np.ndarray:
    """Return the speeds [rad/s] of ``"900 rpm:100 rpm:6000 rpm"`` (start:step:stop), a list ``a,b,c``, or one.

    The stop is included where whole steps reach it.
    """
    import numpy as np

    parts = text.split(":" if ":" in text else ",")
    try:
        values = [quantity(part.strip(), "rad/s", option) for part in parts]
    except RotorsimError:
        if ":" not in text and (span := SPAN.fullmatch(text)):
            low, high, unit = float(span[1]), float(span[3]), span[4] or span[2]
            ends = f"{low:g} {unit}".strip(), f"{(high - low) / 10:.3g} {unit}".strip(), f"{high:g} {unit}".strip()
            hint = f"a range is start:step:stop, as in '{':'.join(ends)}'"
            raise RotorsimError(Problem(f"{option} {text}: a range without a step", hint=hint)) from None
        raise
    if ":" not in text:
        return np.array(values)
    hint = "write start:step:stop, as in '900 rpm:100 rpm:6000 rpm', or a list as in '900 rpm, 1200 rpm'"
    refuse_if(len(values) != 3, f"{option} {text}: {len(values)} parts, 3 expected", hint=hint)
    start, step, stop = values
    refuse_if(
        step == 0 or (stop - start) / step < -1e-9, f"{option} {text}: these steps never reach the stop", hint=hint
    )
    count = math.floor((stop - start) / step * (1 + 1e-12) + 1e-9) + 1
    refuse_if(count > MAX_SPEEDS, f"{option} {text}: {count} speeds, at most {MAX_SPEEDS}", hint="use a larger step")
    return start + step * np.arange(count)
