"""recording.json to a recording without samples, with every mistake at its file:line:column."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from rotorsim.diagram.parse.document import endpoint
from rotorsim.diagram.parse.source import Expected, JsonPath, Source, read_document
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.recordings.recording import ANGLE, AXES, TACHO, USES, Channel, Recording, Run
from rotorsim.units import UnitError, compatible, parse_unit, split_quantity

FILE = "recording.json"
RECORDING_FORM = Expected(
    'a recording is a JSON object: {"name": ..., "source": ..., "channels": {...}, "runs": [...]}',
    "a recording needs no more than four",
    "samples belong into data files",
)
RECORDING_KEYS: dict[str, Mapping[str, type]] = {
    "recording": {
        "$schema": str,
        "kind": str,
        "name": str,
        "source": str,
        "description": str,
        "channels": dict,
        "time": str,
        "runs": list,
    },
    "channel": {
        "signal": str,
        "axis": str,
        "direction": object,
        "node": int,
        "position": object,
        "unit": str,
        "coupling": str,
    },
    "run": {
        "id": str,
        "file": str,
        "sample_rate": object,
        "time": str,
        "speed": object,
        "tacho": list,
        "tacho_resolution": object,
        "set": dict,
        "not_measured": list,
        "use": str,
        "description": str,
    },
}
REQUIRED = {"recording": ("name", "source", "channels", "runs"), "channel": ("signal", "unit"), "run": ("id", "file")}
EXAMPLES = {
    "name": '"name": "test rig"',
    "source": '"source": "measured 2024-05-01 on ..."',
    "channels": '"channels": {"x": {"signal": "rotor.displacement", "axis": "x", "unit": "um"}}',
    "runs": '"runs": [{"id": "run1", "file": "run1.csv", "sample_rate": "5000 Hz"}]',
    "signal": '"signal": "rotor.displacement"',
    "unit": '"unit": "um"',
    "id": '"id": "run1"',
    "file": '"file": "run1.csv"',
}
OTHER_KINDS = {  # of a recording: what it is instead of samples of a diagram's signals, and what takes it
    "orders": (
        "these are orders over the speed, not samples in time",
        "'identify', 'diagnose', 'run --input' and 'check' take them",
    ),
    "samples": (
        "nothing says where a test signal was injected",
        'a recording of "kind": "injection" does; see docs/margins.md',
    ),
    "injection": ("a test signal was injected into this machine", "'margins' and 'check' take such a recording"),
}
_WORDS = {str: "a text", int: "a whole number", dict: "an object {...}", list: "a list [...]"}
_ID = re.compile(r"[^\x00-\x1f/\\]{1,200}")
_SETTING = re.compile(r"[A-Za-z_]\w*((/[A-Za-z_]\w*)*\.[A-Za-z_]\w*)?", re.ASCII)
_RATES = (1e-6, 1e12)  # Hz


@dataclass(frozen=True)
class DataFile:
    """Where the samples of a run are: the path of the file, its time column if there is one, channels not in it."""

    path: Path
    time: str | None
    without: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Document:
    """A recording.json without mistakes: the recording without samples, and the data file of each run."""

    recording: Recording
    files: tuple[DataFile, ...]


def read_recording_document(path: str | Path) -> Document:
    """Read and check a recording.json, or the one in a folder. Raises RotorsimError with every mistake."""
    source, folder = read_source(path)
    return parse_recording(source, folder)


def read_source(path: str | Path) -> tuple[Source, Path]:
    """Return the text of a recording.json, or of the one in a folder, and the folder. Raises RotorsimError."""
    path = Path(path)
    what = hint = ""
    try:
        if path.is_dir():
            path /= FILE
            if not path.exists():
                what = "file does not exist"
                hint = f"a recording is a folder with {FILE} and data files; see docs/recordings.md"
        elif path.suffix.lower() != ".json" and path.is_file():
            what, there = f"a recording is a folder with {FILE}, or that file; this is neither", path.parent / FILE
            hint = f"say what the columns of a data file mean in {there}; see docs/recordings.md"
            hint = f"give the folder: {path.parent}" if there.exists() else hint
    except (OSError, ValueError) as error:
        what = f"file cannot be read: {error}"
    if what:
        raise RotorsimError(Problem(what, place=Place(str(path)), hint=hint))
    return read_document(path, RECORDING_FORM), path.parent


def recording_kind(path: str | Path) -> str:
    """Return the kind of a recording.json, or of the one in a folder: "samples", "orders". Raises RotorsimError."""
    source, _ = read_source(path)
    return str(source.data.get("kind", "samples")) if isinstance(source.data, dict) else "samples"


def parse_recording(
    source: Source, folder: Path, *, files: bool = True, parser_class: type[DocumentParser] | None = None
) -> Document:
    """Check a document; ``files``: also that the data files exist. Raises RotorsimError with every mistake."""
    parser = (parser_class or DocumentParser)(source, folder, files)
    kind = source.data.get("kind") if isinstance(source.data, dict) else None
    if kind is None and parser.kind == "injection":
        kind = DocumentParser.kind
    if isinstance(kind, str) and kind != parser.kind and kind in OTHER_KINDS:
        what, hint = OTHER_KINDS[kind]
        raise RotorsimError(Problem(what, place=source.locate(("kind",)), hint=hint))
    document = parser.document()
    if document is None or parser.problems:
        raise RotorsimError(*sorted(parser.problems, key=lambda problem: problem.place))
    return document


@dataclass
class DocumentParser:
    source: Source
    folder: Path
    files: bool
    problems: list[Problem] = field(default_factory=list)

    kind: ClassVar[str] = "samples"
    keys: ClassVar[Mapping[str, Mapping[str, type]]] = RECORDING_KEYS
    required: ClassVar[Mapping[str, tuple[str, ...]]] = REQUIRED
    examples: ClassVar[Mapping[str, str]] = EXAMPLES

    def error(self, what: str, path: JsonPath, subject: str = "", hint: str = "", *, key: bool = False) -> None:
        self.problems.append(Problem(what, subject, self.source.locate(path, key=key), hint))

    def form(self, kind: str, data: Any, path: JsonPath, subject: str = "") -> dict[str, Any] | None:
        """Return the keys that are known and of the right kind; None where it is no object."""
        if not isinstance(data, dict):
            what = "must be an object {...}" if path else "a recording is a JSON object {...}"
            self.error(what, path, subject, EXAMPLES.get(str(path[0]), "") if path else "")
            return None
        good: dict[str, Any] = {}
        for key, value in data.items():
            expected = self.keys[kind].get(key)
            if expected is None:
                other = key == "injection" and self.kind == "samples"
                hint = 'that is of recordings of "kind": "injection"' if other else near_miss(str(key), self.keys[kind])
                self.error(f"unknown key '{key}'", (*path, key), subject, hint, key=True)
            elif not isinstance(value, expected) or (isinstance(value, bool) and expected is not object):
                self.error(f"'{key}' must be {_WORDS[expected]}", (*path, key), subject)
            else:
                good[key] = value
        for key in self.required[kind]:
            if key not in data:
                example = self.examples.get(f"{kind}.{key}", self.examples.get(key, ""))
                self.error(f"key '{key}' is missing", path, subject, example)
        return good

    def choice(self, form: Mapping[str, Any], key: str, known: tuple[str, ...], path: JsonPath, subject: str) -> Any:
        """Return one of the words that are known (default: None), after noting what is wrong."""
        if key in form and form[key] not in known:
            self.error(f"{key} '{form[key]}' is not known", (*path, key), subject, near_miss(form[key], known))
        return form.get(key)

    def quantity(
        self, form: Mapping[str, Any], key: str, unit: str, path: JsonPath, subject: str, ndim: int = 0
    ) -> np.ndarray | None:
        """Return a number, or a list of them, in ``unit``; None where it is missing or after noting what is wrong."""
        if key not in form:
            return None
        try:
            array = numeric(form[key], unit)
            if array.ndim == ndim:
                return array
            hint = "write [0.01, 0.05, ...]" if ndim else ""
            raise ValueProblem("must be a list of numbers" if ndim else "must be one number, not a list", hint)
        except ValueProblem as problem:
            self.error(f"{key}: {problem.what}", (*path, key, *(problem.path if ndim else ())), subject, problem.hint)
            return None

    def number(self, form: Mapping[str, Any], key: str, unit: str, path: JsonPath, subject: str) -> float | None:
        value = self.quantity(form, key, unit, path, subject)
        return None if value is None else float(value)

    def document(self) -> Document | None:
        form = self.form("recording", self.source.data, ())
        if form is None:
            return None
        self.choice(
            form, "kind", tuple(OTHER_KINDS) if form.get("kind") != self.kind else (self.kind,), (), "recording"
        )
        self.not_empty(form)
        channels = self.channels(form.get("channels", {}))
        runs = self.runs(form.get("runs", []), form.get("time"), list(form.get("channels", {})))
        for column in channels:
            if column == form.get("time") or any(file.time == column for _, file in runs):
                hint = f'the time column is named by "time": "{column}" alone'
                self.error("the time column is no channel", ("channels", column), f"channel {column}", hint, key=True)
        named = (form.get("name", ""), form.get("source", ""))
        recording = Recording(*named, self.folder, channels, tuple(run for run, _ in runs))
        return Document(recording, tuple(file for _, file in runs))

    def not_empty(self, form: Mapping[str, Any]) -> None:
        """Note a recording without channels or runs."""
        for key in ("channels", "runs"):
            if key in form and not form[key]:
                self.error(f"names no {key[:-1]}", (key,), key, EXAMPLES[key])

    # --- channels -----------------------------------------------------------------------------------

    def channels(self, data: dict[str, Any]) -> dict[str, Channel]:
        channels: dict[str, Channel] = {}
        names: dict[str, str] = {}
        for column, entry in data.items():
            channel = self.channel(column, entry)
            if channel is None:
                continue
            channels[column] = channel
            if channel.label in names:
                what = f"measures {channel.label}, and so does '{names[channel.label]}'"
                hint = "separate them by axis, node or position, or leave one out"
                self.error(what, ("channels", column), f"channel {column}", hint, key=True)
            names.setdefault(channel.label, column)
        return channels

    def channel(self, column: str, entry: Any) -> Channel | None:
        path: JsonPath = ("channels", column)
        subject, before = f"channel {column}", len(self.problems)
        form = self.form("channel", entry, path, subject)
        if form is None:
            return None
        if not column.strip():
            self.error("the name of a column is empty", path, subject, key=True)
        if "signal" in form:
            self.signal(form, (*path, "signal"), subject)
        axis = self.choice(form, "axis", AXES, path, subject)
        direction = self.number(form, "direction", "rad", path, subject)
        if axis is not None and direction is not None:
            self.error("both axis and direction", (*path, "direction"), subject, "a direction is the angle from x")
        coupling = self.choice(form, "coupling", ("dc", "ac"), path, subject)
        node = form.get("node")
        if node is not None and not 1 <= node <= 1_000_000:
            self.error(f"node {node}: nodes are counted from 1", (*path, "node"), subject)
        position = self.number(form, "position", "m", path, subject)
        if "unit" in form:
            self.unit(form, (*path, "unit"), subject)
        if len(self.problems) > before:
            return None
        place = self.source.place(path, key=True)
        unit, coupling = form["unit"], coupling or "dc"
        return Channel(column, form["signal"], axis, node, position, unit, coupling, place, direction)

    def signal(self, form: Mapping[str, Any], path: JsonPath, subject: str) -> None:
        signal = form["signal"]
        end = endpoint(signal)
        if signal != TACHO and end is None:
            hint = "write block.port, as in 'rotor.displacement'"
            hint = f"the shaft angle is '{ANGLE}'" if signal in ("theta", "angle") else hint
            self.error(f"'{signal}' is not a signal", path, subject, hint)
        elif end is not None and end.index and form.keys() & {"axis", "direction", "node", "position"}:
            hint = "leave out axis, node and position, or the index"
            self.error(f"'{signal}' names an entry already", path, subject, hint)

    def unit(self, form: Mapping[str, Any], path: JsonPath, subject: str) -> None:
        unit = form["unit"]
        try:
            parse_unit(unit)
            if form.get("signal") == ANGLE and compatible(unit, "rad") not in ("same", "scaled"):
                raise UnitError(f"unit '{unit}' is not one of an angle", "give rad, deg or rev")
        except UnitError as error:
            self.error(error.what, path, subject, error.hint)

    # --- runs ---------------------------------------------------------------------------------------

    def runs(self, data: list[Any], time: str | None, columns: list[str]) -> list[tuple[Run, DataFile]]:
        runs = []
        seen: dict[str, int] = {}
        for k, entry in enumerate(data):
            run = self.run(entry, ("runs", k), f"run {k + 1}", time, columns)
            runs += [] if run is None else [run]
            name = entry.get("id") if isinstance(entry, dict) else None
            if isinstance(name, str) and seen.setdefault(name, k) < k:
                what = f"run {seen[name] + 1} has the same id"
                self.error(what, ("runs", k, "id"), name, "every run needs an id of its own")
        return runs

    def run(
        self, entry: Any, path: JsonPath, subject: str, time: str | None, columns: list[str]
    ) -> tuple[Run, DataFile] | None:
        before = len(self.problems)
        name = entry.get("id") if isinstance(entry, dict) else None
        if isinstance(name, str) and _ID.fullmatch(name) and name.strip():
            subject = name
        elif isinstance(name, str):
            self.error("the id is empty, too long or has one of / \\ or a control character", (*path, "id"), subject)
        form = self.form("run", entry, path, subject)
        if form is None:
            return None
        file = self.file(form["file"], (*path, "file"), subject) if "file" in form else None
        rate = self.rate(form, path, subject)
        time = form.get("time", time)
        if "sample_rate" not in entry and "time" not in entry and time is None:
            hint = 'give "sample_rate": "5000 Hz", or "time": the name of the time column'
            self.error("neither sample_rate nor time", path, subject, hint)
        speed = self.number(form, "speed", "rad/s", path, subject)
        tacho = np.empty(0) if form.get("tacho") == [] else self.quantity(form, "tacho", "s", path, subject, 1)
        resolution = self.number(form, "tacho_resolution", "s", path, subject)
        at = (*path, "tacho_resolution")
        if resolution is not None and not resolution >= 0:
            hint = "0 where the edges of pulses were timed, else the step between possible times: '0.2 ms'"
            self.error(f"tacho_resolution: {resolution:g} s is below zero", at, subject, hint)
        elif "tacho_resolution" in form and "tacho" not in entry:
            self.error("tacho_resolution is that of 'tacho', which is missing", at, subject, key=True)
        settings = self.settings(form.get("set", {}), (*path, "set"), subject)
        without = self.not_measured(form, (*path, "not_measured"), subject, columns)
        use = self.choice(form, "use", USES, path, subject) or USES[0]
        if len(self.problems) > before or file is None:
            return None
        shown, place, none = str(self.folder / form["file"]), self.source.place(path), np.empty(0)
        run = Run(form["id"], shown, none, {}, speed, tacho, settings, use, place, rate, tacho_resolution=resolution)
        return run, DataFile(file, time, without)

    def not_measured(self, form: Mapping[str, Any], path: JsonPath, subject: str, columns: list[str]) -> frozenset[str]:
        """Return the channels that a run lacks, after noting what is wrong."""
        named = form.get("not_measured", [])
        for k, column in enumerate(named):
            if column not in columns:
                what = f"not_measured: {json.dumps(column)[:80]} is no channel"
                self.error(what, (*path, k), subject, near_miss(str(column), columns))
        if columns and set(columns) <= {str(column) for column in named}:
            self.error("not_measured: nothing is left of this run", path, subject, "leave the run out")
        return frozenset(str(column) for column in named)

    def file(self, file: str, path: JsonPath, subject: str) -> Path | None:
        """Return the path of a data file inside the folder of the recording."""
        parts = re.split(r"[/\\]", file)
        inside = ".." not in parts and "" not in parts and not any(mark in file for mark in "\\:\0")
        try:
            target = (self.folder / file if inside else self.folder).resolve()
            inside = inside and target.is_relative_to(self.folder.resolve())  # a symbolic link may lead out
        except (OSError, RuntimeError, ValueError) as error:
            self.error(f"file '{_short(file)}' cannot be found: {error}", path, subject)
            return None
        if not inside:
            hint = "name a file below that folder, such as 'data/run1.csv'"
            self.error(f"file '{_short(file)}' is not inside the folder of {FILE}", path, subject, hint)
            return None
        try:
            if not self.files or target.is_file():
                return target
            folder = target if target.is_dir() else target.parent
            there = sorted(entry.name for entry in folder.iterdir() if entry.is_file())
            if target.is_dir():
                why, hint = "is a folder", f"name a file in it, such as '{file}/{[*there, 'run1.csv'][0]}'"
            else:
                why, hint = "does not exist or cannot be read", near_miss(parts[-1], there, list_all=False)
        except (OSError, ValueError):
            why, hint = "does not exist or cannot be read", ""
        self.error(f"file '{_short(file)}' {why}", path, subject, hint)
        return None

    def rate(self, form: Mapping[str, Any], path: JsonPath, subject: str) -> float | None:
        """Return the sample rate [Hz], to twelve digits where it is a text: "5 kHz" is 5000."""
        value, hint = form.get("sample_rate"), "write it in Hz, as in '5000 Hz'"
        try:
            if isinstance(value, str) and not split_quantity(value)[1].endswith("Hz"):
                raise UnitError(f"'{_short(value)}' is not in Hz")
        except UnitError as error:
            self.error(f"sample_rate: {error.what}", (*path, "sample_rate"), subject, hint)
            return None
        rate = self.number(form, "sample_rate", "Hz", path, subject)
        if rate is not None and not _RATES[0] <= rate <= _RATES[1]:
            what = f"sample_rate: {rate:g} Hz is not between {_RATES[0]:g} and {_RATES[1]:g} Hz"
            self.error(what, (*path, "sample_rate"), subject, hint)
        return float(f"{rate:.12g}") if isinstance(value, str) and rate is not None else rate

    def settings(self, data: dict[str, Any], path: JsonPath, subject: str) -> dict[str, Any]:
        for name, value in data.items():
            if not _SETTING.fullmatch(name):
                hint = "write block.parameter or the name of a diagram parameter"
                self.error(f"set: '{_short(name)}' is not a parameter", (*path, name), subject, hint, key=True)
            elif not _is_setting(value):
                what = f"set: {name} must be a number, a text such as '12 N/A', true or false, or a list of those"
                self.error(what, (*path, name), subject)
        return data


def _is_setting(value: Any) -> bool:
    if isinstance(value, list):
        return bool(value) and all(_is_setting(item) for item in value)
    if isinstance(value, int | float):
        return abs(value) <= 1e300 and math.isfinite(value)
    return isinstance(value, str)


def _short(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "..."
