"""recording.json to checked entries, with every mistake at its file:line:column."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagram.parse.document import endpoint
from rotorsim.diagram.parse.source import JsonPath, Source, read_document
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.recordings.recording import ANGLE, AXES, TACHO, USES, Channel
from rotorsim.units import UnitError, compatible, parse_unit, split_quantity

__all__ = ["FILE", "KEYS", "Document", "RunEntry", "parse_recording", "read_recording_document", "recording_schema"]

FILE = "recording.json"
KEYS: dict[str, Mapping[str, type]] = {
    "recording": {
        "$schema": str,
        "name": str,
        "source": str,
        "description": str,
        "channels": dict,
        "time": str,
        "runs": list,
    },
    "channel": {"signal": str, "axis": str, "node": int, "position": object, "unit": str, "coupling": str},
    "run": {
        "id": str,
        "file": str,
        "sample_rate": object,
        "time": str,
        "speed": object,
        "tacho": list,
        "tacho_resolution": object,
        "set": dict,
        "use": str,
        "description": str,
    },
}
_REQUIRED = {"recording": ("name", "source", "channels", "runs"), "channel": ("signal", "unit"), "run": ("id", "file")}
_EXAMPLES = {
    "name": '"name": "test rig"',
    "source": '"source": "measured 2024-05-01 on ..."',
    "channels": '"channels": {"x": {"signal": "rotor.displacement", "axis": "x", "unit": "um"}}',
    "runs": '"runs": [{"id": "run1", "file": "run1.csv", "sample_rate": "5000 Hz"}]',
    "signal": '"signal": "rotor.displacement"',
    "unit": '"unit": "um"',
    "id": '"id": "run1"',
    "file": '"file": "run1.csv"',
}
_WORDS = {str: "a text", int: "a whole number", dict: "an object {...}", list: "a list [...]"}
_ID = re.compile(r"[^\x00-\x1f/\\]{1,200}")
_SETTING = re.compile(r"[A-Za-z_]\w*((/[A-Za-z_]\w*)*\.[A-Za-z_]\w*)?", re.ASCII)
_RATES = (1e-6, 1e12)  # Hz


@dataclass(frozen=True)
class RunEntry:
    """A run as recording.json says it; path: its data file. speed [rad/s], sample_rate [Hz], tacho (k,) [s].

    tacho_resolution [s]: as stated, of the times of the pulses.
    """

    id: str
    file: str
    path: Path
    sample_rate: float | None
    time: str | None
    speed: float | None
    tacho: np.ndarray | None
    settings: Mapping[str, Any]
    use: str
    place: Place
    tacho_resolution: float | None = None


@dataclass(frozen=True)
class Document:
    """A recording.json without mistakes."""

    name: str
    source: str
    folder: Path
    channels: Mapping[str, Channel]
    runs: tuple[RunEntry, ...] = field(default=())


def recording_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of recording.json."""
    schema: dict[str, Any] = json.loads(Path(__file__).with_name("recording.schema.json").read_text(encoding="utf-8"))
    return schema


def read_recording_document(path: str | Path) -> Document:
    """Read and check a recording.json, or the one in a folder. Raises RotorsimError with every mistake."""
    path = Path(path)
    try:
        if path.is_dir():
            path = path / FILE
            if not path.exists():
                hint = f"a recording is a folder with {FILE} and data files; see docs/recordings.md"
                raise RotorsimError(Problem("file does not exist", place=Place(str(path)), hint=hint))
    except (OSError, ValueError) as error:
        raise RotorsimError(Problem(f"file cannot be read: {error}", place=Place(str(path)))) from None
    return parse_recording(read_document(path), path.parent)


def parse_recording(source: Source, folder: Path, *, files: bool = True) -> Document:
    """Check a document; ``files``: also that the data files exist. Raises RotorsimError with every mistake."""
    reader = _Reader(source, folder, files)
    document = reader.document()
    if document is None or reader.problems:
        raise RotorsimError(*sorted(reader.problems, key=lambda problem: problem.place))
    return document


class _Reader:
    def __init__(self, source: Source, folder: Path, files: bool) -> None:
        self.source, self.folder, self.files = source, folder, files
        self.problems: list[Problem] = []

    def error(self, what: str, path: JsonPath, subject: str = "", hint: str = "", *, key: bool = False) -> None:
        self.problems.append(Problem(what, subject, self.source.locate(path, key=key), hint))

    def form(self, kind: str, data: Mapping[str, Any], path: JsonPath, subject: str = "") -> dict[str, Any]:
        """Return the keys that are known and of the right kind."""
        good: dict[str, Any] = {}
        for key, value in data.items():
            expected = KEYS[kind].get(key)
            if expected is None:
                self.error(f"unknown key '{key}'", (*path, key), subject, near_miss(str(key), KEYS[kind]), key=True)
            elif not isinstance(value, expected) or (isinstance(value, bool) and expected is not object):
                self.error(f"'{key}' must be {_WORDS[expected]}", (*path, key), subject)
            else:
                good[key] = value
        for key in _REQUIRED[kind]:
            if key not in data:
                self.error(f"key '{key}' is missing", path, subject, _EXAMPLES[key])
        return good

    def number(self, value: Any, unit: str, path: JsonPath, subject: str) -> float | None:
        """Return one number in ``unit``, or None after noting what is wrong."""
        try:
            array = numeric(value, unit)
            if array.ndim:
                raise ValueProblem("must be one number, not a list")
            return float(array)
        except ValueProblem as problem:
            self.error(f"{path[-1]}: {problem.what}", path, subject, problem.hint)
            return None

    def document(self) -> Document | None:
        data = self.source.data
        if not isinstance(data, dict):
            self.error("a recording is a JSON object {...}", ())
            return None
        form = self.form("recording", data, ())
        channels = self.channels(form.get("channels"))
        runs = self.runs(form.get("runs"), form.get("time"))
        for column in channels:
            clash = column == form.get("time") or any(run.time == column for run in runs)
            if clash:
                hint = f'the time column is named by "time": "{column}" alone'
                self.error("the time column is no channel", ("channels", column), f"channel {column}", hint, key=True)
        return Document(form.get("name", ""), form.get("source", ""), self.folder, channels, tuple(runs))

    # --- channels -----------------------------------------------------------------------------------

    def channels(self, data: dict[str, Any] | None) -> dict[str, Channel]:
        if data is None:
            return {}
        if not data:
            self.error("names no channel", ("channels",), "channels", _EXAMPLES["channels"])
        found: dict[str, Channel] = {}
        names: dict[str, str] = {}
        for column, entry in data.items():
            channel = self.channel(column, entry)
            if channel is None:
                continue
            found[column] = channel
            if channel.name in names:
                what = f"measures {channel.name}, and so does '{names[channel.name]}'"
                hint = "tell them apart by axis, node or position, or leave one out"
                self.error(what, ("channels", column), f"channel {column}", hint, key=True)
            names.setdefault(channel.name, column)
        return found

    def channel(self, column: str, entry: Any) -> Channel | None:
        path: JsonPath = ("channels", column)
        subject, before = f"channel {column}", len(self.problems)
        if not isinstance(entry, dict):
            self.error("must be an object {...}", path, subject, _EXAMPLES["channels"])
            return None
        form = self.form("channel", entry, path, subject)
        signal, axis, node, unit = form.get("signal", ""), form.get("axis"), form.get("node"), form.get("unit", "1")
        if not column.strip():
            self.error("the name of a column is empty", path, subject, key=True)
        if "signal" in form:
            end = endpoint(signal)
            if signal != TACHO and end is None:
                hint = "write block.port, as in 'rotor.displacement'"
                if signal in ("theta", "angle"):
                    hint = f"the shaft angle is '{ANGLE}'"
                self.error(f"'{signal}' is not a signal", (*path, "signal"), subject, hint)
            elif end is not None and end.index and (axis is not None or node is not None or "position" in form):
                what = f"'{signal}' names an entry already"
                self.error(what, (*path, "signal"), subject, "leave out axis, node and position, or the index")
        for key, known in (("axis", AXES), ("coupling", ("dc", "ac"))):
            if key in form and form[key] not in known:
                hint = near_miss(form[key], known)
                self.error(f"{key} '{form[key]}' is not known", (*path, key), subject, hint)
        if node is not None and not 1 <= node <= 1_000_000:
            self.error(f"node {node}: nodes are counted from 1", (*path, "node"), subject)
        position = self.number(form["position"], "m", (*path, "position"), subject) if "position" in form else None
        if "unit" in form:
            self.unit(unit, signal, (*path, "unit"), subject)
        if len(self.problems) > before:
            return None
        return Channel(column, signal, axis, node, position, unit, form.get("coupling", "dc"))

    def unit(self, unit: str, signal: str, path: JsonPath, subject: str) -> None:
        try:
            parse_unit(unit)
        except UnitError as error:
            self.error(error.what, path, subject, error.hint)
        else:
            if signal == ANGLE and compatible(unit, "rad") not in ("same", "scaled"):
                self.error(f"unit '{unit}' is not one of an angle", path, subject, "give rad, deg or rev")

    # --- runs ---------------------------------------------------------------------------------------

    def runs(self, data: list[Any] | None, time: str | None) -> list[RunEntry]:
        if data is None:
            return []
        if not data:
            self.error("names no run", ("runs",), "runs", _EXAMPLES["runs"])
        found: list[RunEntry] = []
        seen: dict[str, int] = {}
        for k, entry in enumerate(data):
            path: JsonPath = ("runs", k)
            if not isinstance(entry, dict):
                self.error("must be an object {...}", path, f"run {k + 1}", _EXAMPLES["runs"])
                continue
            run = self.run(entry, path, f"run {k + 1}", time)
            name = entry.get("id")
            if isinstance(name, str) and name in seen:
                what = f"run {seen[name] + 1} has the same id"
                self.error(what, (*path, "id"), name, "every run needs an id of its own")
            elif isinstance(name, str):
                seen[name] = k
            if run is not None:
                found.append(run)
        return found

    def run(self, entry: dict[str, Any], path: JsonPath, subject: str, time: str | None) -> RunEntry | None:
        before = len(self.problems)
        name = entry.get("id")
        if isinstance(name, str) and _ID.fullmatch(name) and name.strip():
            subject = name
        elif isinstance(name, str):
            self.error("the id is empty, too long or has one of / \\ or a control character", (*path, "id"), subject)
        form = self.form("run", entry, path, subject)
        file = self.file(form["file"], (*path, "file"), subject) if "file" in form else None
        rate = self.rate(form["sample_rate"], (*path, "sample_rate"), subject) if "sample_rate" in form else None
        time = form.get("time", time)
        if "sample_rate" not in entry and "time" not in entry and time is None:
            hint = 'give "sample_rate": "5000 Hz", or "time": the name of the time column'
            self.error("neither sample_rate nor time", path, subject, hint)
        speed = self.number(form["speed"], "rad/s", (*path, "speed"), subject) if "speed" in form else None
        tacho = self.tacho(form["tacho"], (*path, "tacho"), subject) if "tacho" in form else None
        resolution = None
        if "tacho_resolution" in form:
            at = (*path, "tacho_resolution")
            resolution = self.number(form["tacho_resolution"], "s", at, subject)
            if resolution is not None and not resolution >= 0:
                hint = "0 where the edges of pulses were timed, else the step between possible times: '0.2 ms'"
                self.error(f"tacho_resolution: {resolution:g} s is below zero", at, subject, hint)
            elif tacho is None and "tacho" not in entry:
                self.error("tacho_resolution is that of 'tacho', which is missing", at, subject, key=True)
        settings = self.settings(form.get("set", {}), (*path, "set"), subject)
        use = form.get("use", "identify")
        if use not in USES:
            hint = near_miss(use, USES)
            self.error(f"use '{use}' is not known", (*path, "use"), subject, hint)
        if len(self.problems) > before or file is None:
            return None
        place = self.source.place(path)
        shown = str(self.folder / form["file"])
        return RunEntry(form["id"], shown, file, rate, time, speed, tacho, settings, use, place, resolution)

    def file(self, file: str, path: JsonPath, subject: str) -> Path | None:
        """Return the path of a data file inside the folder of the recording."""
        parts = re.split(r"[/\\]", file)
        target = None
        if ".." in parts or "" in parts or any(mark in file for mark in "\\:\0"):
            inside = False
        else:
            try:
                target = (self.folder / file).resolve()
                inside = target.is_relative_to(self.folder.resolve())  # a symbolic link may lead out
            except (OSError, RuntimeError, ValueError) as error:
                self.error(f"file '{_short(file)}' cannot be found: {error}", path, subject)
                return None
        if not inside or target is None:
            hint = "name a file below that folder, such as 'data/run1.csv'"
            self.error(f"file '{_short(file)}' is not inside the folder of {FILE}", path, subject, hint)
            return None
        if self.files and not self.is_file(target):
            why = "is a folder" if target.is_dir() else "does not exist or cannot be read"
            try:
                hint = near_miss(parts[-1], [entry.name for entry in target.parent.iterdir()], list_all=False)
            except OSError:
                hint = ""
            self.error(f"file '{_short(file)}' {why}", path, subject, hint)
            return None
        return target

    @staticmethod
    def is_file(path: Path) -> bool:
        try:
            return path.is_file()
        except (OSError, ValueError):
            return False

    def rate(self, value: Any, path: JsonPath, subject: str) -> float | None:
        hint = "write it in Hz, as in '5000 Hz'"
        try:
            if isinstance(value, str) and not split_quantity(value)[1].endswith("Hz"):
                self.error(f"sample_rate: '{_short(value)}' is not in Hz", path, subject, hint)
                return None
        except UnitError as error:
            self.error(f"sample_rate: {error.what}", path, subject, hint)
            return None
        rate = self.number(value, "Hz", path, subject)
        if rate is not None and not _RATES[0] <= rate <= _RATES[1]:
            self.error(
                f"sample_rate: {rate:g} Hz is not between {_RATES[0]:g} and {_RATES[1]:g} Hz", path, subject, hint
            )
            return None
        return float(f"{rate:.12g}") if isinstance(value, str) and rate is not None else rate  # "5 kHz" is 5000

    def tacho(self, value: list[Any], path: JsonPath, subject: str) -> np.ndarray | None:
        if not value:
            return np.empty(0)
        try:
            array = numeric(value, "s")
            if array.ndim != 1:
                raise ValueProblem("must be a list of numbers", "write [0.01, 0.05, ...]")
            return array
        except ValueProblem as problem:
            self.error(f"tacho: {problem.what}", (*path, *problem.path), subject, problem.hint)
            return None

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
