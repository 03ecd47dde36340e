"""Tables of order vectors over the speed, as monitoring systems export them: run-ups and coast-downs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from rotorsim.diagram.parse.source import JsonPath
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.recordings.directions import along_axes
from rotorsim.recordings.document import EXAMPLES, RECORDING_KEYS, REQUIRED, DocumentParser, read_source, recording_kind
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.readers.columns import read_table
from rotorsim.recordings.recording import ANGLE, TACHO, USES, Channel, Recording
from rotorsim.units import AMPLITUDE_KINDS, conversion

PHASES = {"lead": 1.0, "lag": -1.0}  # word -> sign of a lead
SLOW_ROLLS = ("included", "subtracted")
LARGEST_CHANGE = 0.2  # of the speed in a turn: rows further apart are no successive turns
LEAST_ORDER_ROWS = 20  # of a run
OVERLAP = 0.9  # of the turns of a row: rows that are nearer share samples
_RPM = math.pi / 30.0

_RUN_KEYS = {key: RECORDING_KEYS["run"][key] for key in ("id", "file", "time", "set", "use", "description")}
ORDER_KEYS: dict[str, Mapping[str, type]] = {
    "recording": {
        **{key: value for key, value in RECORDING_KEYS["recording"].items() if key != "time"},
        "amplitude": str,
        "phase": str,
        "slow_roll": str,
    },
    "channel": {
        **{key: value for key, value in RECORDING_KEYS["channel"].items() if key != "coupling"},
        "order": int,
        "amplitude": str,
        "phase": str,
    },
    "run": {**_RUN_KEYS, "speed": str, "turns": int},
}
_REQUIRED = {
    "recording": (*REQUIRED["recording"], "amplitude", "phase"),
    "channel": (*REQUIRED["channel"], "amplitude", "phase"),
    "run": (*REQUIRED["run"], "speed", "turns"),
}
_EXAMPLES = {
    **EXAMPLES,
    "runs": '"runs": [{"id": "up", "file": "up.csv", "speed": "rpm", "turns": 1}]',
    "recording.amplitude": '"amplitude": "0-peak", or "peak-peak", or "rms": what the numbers are',
    "recording.phase": '"phase": "lag", or "lead": what the numbers are',
    "channel.amplitude": '"amplitude": "amp_1x": the name of a column',
    "channel.phase": '"phase": "phase_1x": the name of a column, in deg',
    "run.speed": '"speed": "rpm": the name of a column, in rpm',
    "run.turns": '"turns": 1: revolutions that each row is the mean of',
}


@dataclass(frozen=True)
class OrderChannel(Channel):
    """Two columns of the data files, and the order of a signal of the diagram that they measure.

    order: of the running speed, from 1. amplitude, phase: names of the columns.
    """

    order: int = 1
    amplitude: str = ""
    phase: str = ""

    @property
    def label(self) -> str:
        """What is measured, in words."""
        return f"{self.order}X of {self.name}"


@dataclass(frozen=True, eq=False)
class OrderRun:
    """One run-up or coast-down: order vectors over the speed.

    speed (n,): mean over the turns of each row [rad/s]. vectors: channel -> (n,) complex, SI, 0-peak,
    2 mean(x exp(-i order theta)) over the turns of the row; NaN where nothing was measured. time (n,) [s]: of the
    middle of each row; None: the rows are successive turns. turns: of each row. settings, use, place: as of `Run`.
    sense: 1 where the shaft turns from x to y, -1 the other way round; its angle is counted as it turns.
    noise: of rows that are runs at constant speeds, settled: channel -> variance of the real parts. None: of a run-up.
    """

    id: str
    file: str
    speed: np.ndarray
    vectors: Mapping[str, np.ndarray]
    time: np.ndarray | None
    turns: int
    settings: Mapping[str, Any]
    use: str
    place: Place
    sense: int = 1
    noise: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class OrderRecording:
    """A folder of runs with the same channels; slow_roll: the constant vectors of run-out are in the data."""

    name: str
    source: str
    folder: Path
    channels: Mapping[str, OrderChannel]
    runs: tuple[OrderRun, ...]
    slow_roll: bool = True
    warnings: tuple[Problem, ...] = field(default=())

    def select(self, use: str) -> tuple[OrderRun, ...]:
        """Return the runs of a use: "identify" or "hold_out". Raises RotorsimError for another word."""
        if use not in USES:
            raise RotorsimError(Problem(f"'{use}' is no use of a run", hint=near_miss(use, USES)))
        return tuple(run for run in self.runs if run.use == use)

    def __repr__(self) -> str:
        return f"OrderRecording({self.name}: {len(self.runs)} runs, {', '.join(self.channels)})"


def load_orders(path: str | Path) -> OrderRecording:
    """Read order vectors: ``path`` is a folder with a recording.json of kind "orders", or that file.

    Raises RotorsimError with every mistake of recording.json, or else of all data files.
    """
    source, folder = read_source(path)
    parser = _OrderParser(source, folder, True)
    read = parser.order_document()
    if read is None or parser.problems:
        raise RotorsimError(*sorted(parser.problems, key=lambda problem: problem.place))
    recording, tables = read
    runs: list[OrderRun] = []
    errors: list[Problem] = []
    warnings: list[Problem] = []
    for run, table in zip(recording.runs, tables, strict=True):
        try:
            runs.append(_with_rows(run, table, recording.channels, warnings))
        except RotorsimError as error:
            errors += error.problems
    if errors:
        raise RotorsimError(*errors)
    channels, vectors = along_axes(recording.channels, [run.vectors for run in runs], [run.id for run in runs])
    turned = tuple(replace(run, vectors=own) for run, own in zip(runs, vectors, strict=True))
    return replace(recording, channels=channels, runs=turned, warnings=tuple(warnings))


Recorded = TypeVar("Recorded", bound=Recording | OrderRecording)


def load_any(path: str | Path) -> Recording | OrderRecording:
    """Read a recording of samples or of orders. Raises RotorsimError with every mistake."""
    return load_orders(path) if recording_kind(path) == "orders" else load_recording(path)


def renamed(recording: Recorded, named: Callable[[str], str]) -> Recorded:
    """Return a recording with other names for the signals that it measures and the parameters that it sets."""
    changed: dict[str, Any] = {
        "channels": {column: replace(one, signal=named(one.signal)) for column, one in recording.channels.items()},
        "runs": tuple(
            replace(run, settings={named(name): value for name, value in run.settings.items()})
            for run in recording.runs
        ),
    }
    return replace(recording, **changed)


@dataclass(frozen=True)
class _Table:
    """A data file: its columns of speed and time, and what its numbers mean: factor to 0-peak, sign of a lead."""

    path: Path
    speed: str
    time: str | None
    amplitude: float
    lead: float


def _with_rows(run: OrderRun, table: _Table, channels: Mapping[str, OrderChannel], warnings: list[Problem]) -> OrderRun:
    """Return a run with the rows of its file. Raises RotorsimError for tables that cannot be."""
    wanted = [table.speed, *(name for one in channels.values() for name in (one.amplitude, one.phase))]
    read = read_table(table.path, wanted if table.time is None else [*wanted, table.time], shown=run.file)
    data = read.values
    speed, time = data[table.speed] * _RPM, None if table.time is None else data[table.time]
    subject, problems = f"run {run.id}", []

    def refuse(column: str, what: str, at: np.ndarray, hint: str = "") -> None:
        if at.any():
            row = int(np.flatnonzero(at)[0])
            place = replace(read.place(row, column), file=run.file)
            problems.append(Problem(f"row {row + 1}: {what}", f"{subject}, column {column}", place, hint))

    if len(speed) < LEAST_ORDER_ROWS:
        what = f"{len(speed)} rows are too few: {LEAST_ORDER_ROWS} are needed to tell motion from noise"
        raise RotorsimError(Problem(what, subject, Place(run.file)), exit_code=1)
    refuse(table.speed, "not a speed above zero", ~(np.isfinite(speed) & (speed > 0)), "rpm, without a sign")
    if time is not None:
        refuse(str(table.time), "time does not rise", ~np.append(np.isfinite(time[0]), np.diff(time) > 0))
    elif not problems:
        jump = np.append(False, np.abs(np.diff(np.log(speed))) > LARGEST_CHANGE * run.turns)
        what = f"the speed changes by more than {100 * LARGEST_CHANGE:.0f} % a turn: these are no successive turns"
        refuse(table.speed, what, jump, 'name the column of their time: "time": "t"')
    vectors = {}
    for name, channel in channels.items():
        size, angle = data[channel.amplitude], data[channel.phase]
        refuse(channel.amplitude, "an amplitude below zero", size < 0, "the sign of a vector is in its phase")
        refuse(channel.phase, "amplitude without phase", np.isfinite(size) & ~np.isfinite(angle))
        refuse(channel.amplitude, "phase without amplitude", ~np.isfinite(size) & np.isfinite(angle))
        factor = table.amplitude * conversion(channel.unit, None)
        vectors[name] = factor * size * np.exp(1j * table.lead * np.radians(angle))
        missing = int((~np.isfinite(vectors[name])).sum())
        if missing:
            what = f"{missing} of {len(speed)} rows are missing, and are not compared"
            warnings.append(Problem(what, f"{subject}, {name}", Place(run.file), severity="warning"))
    if problems:
        raise RotorsimError(*problems, exit_code=1)
    apart = np.inf if time is None else float(np.median(np.diff(time) * speed[1:])) / (2 * math.pi)
    if apart < OVERLAP * run.turns:
        what = f"rows overlap: each is the mean of {run.turns} turns, and they are {apart:.3g} turns apart"
        hint = "are turns, time and speed right?"
        warnings.append(Problem(what, subject, Place(run.file), hint, severity="warning"))
    warnings += [replace(one, place=replace(one.place, file=run.file)) for one in read.warnings]
    return replace(run, speed=speed, vectors=vectors, time=time)


class _OrderParser(DocumentParser):
    kind: ClassVar[str] = "orders"
    keys: ClassVar[Mapping[str, Mapping[str, type]]] = ORDER_KEYS
    required: ClassVar[Mapping[str, tuple[str, ...]]] = _REQUIRED
    examples: ClassVar[Mapping[str, str]] = _EXAMPLES

    def order_document(self) -> tuple[OrderRecording, list[_Table]] | None:
        form = self.form("recording", self.source.data, ())
        if form is None:
            return None
        self.choice(form, "kind", (self.kind,), (), "recording")
        amplitude = self.choice(form, "amplitude", tuple(AMPLITUDE_KINDS), (), "recording")
        phase = self.choice(form, "phase", tuple(PHASES), (), "recording")
        slow_roll = self.choice(form, "slow_roll", SLOW_ROLLS, (), "recording") or SLOW_ROLLS[0]
        self.not_empty(form)
        channels = self.channels(form.get("channels", {}))
        runs: list[tuple[OrderRun, _Table]] = []
        words = 1.0 / AMPLITUDE_KINDS.get(amplitude, 1.0), PHASES.get(phase, 1.0)
        ids: dict[str, int] = {}
        for k, entry in enumerate(form.get("runs", [])):
            run = self.order_run(entry, ("runs", k), f"run {k + 1}", words)
            runs += [] if run is None else [run]
            name = entry.get("id") if isinstance(entry, dict) else None
            if isinstance(name, str) and ids.setdefault(name, k) < k:
                what = f"run {ids[name] + 1} has the same id"
                self.error(what, ("runs", k, "id"), name, "every run needs an id of its own")
        if self.problems:
            return None
        kept = {name: one for name, one in channels.items() if isinstance(one, OrderChannel)}
        recording = OrderRecording(
            form["name"], form["source"], self.folder, kept, tuple(run for run, _ in runs), slow_roll == SLOW_ROLLS[0]
        )
        return recording, [table for _, table in runs]

    def channel(self, column: str, entry: Any) -> OrderChannel | None:
        base = super().channel(column, entry)
        path, subject = ("channels", column), f"channel {column}"
        if base is None:
            return None
        order = entry.get("order", 1)
        if not 1 <= order <= 100:
            self.error(f"order {order} is not between 1 and 100", (*path, "order"), subject)
        if base.signal in (ANGLE, TACHO):
            self.error(f"'{base.signal}' has no order", (*path, "signal"), subject)
        if not (isinstance(entry.get("amplitude"), str) and isinstance(entry.get("phase"), str)):
            return None  # said by the form
        return OrderChannel(**vars(base), order=order, amplitude=entry["amplitude"], phase=entry["phase"])

    def order_run(
        self, entry: Any, path: JsonPath, subject: str, words: tuple[float, float]
    ) -> tuple[OrderRun, _Table] | None:
        before = len(self.problems)
        form = self.form("run", entry, path, subject)
        if form is None:
            return None
        subject = form.get("id", subject)
        file = self.file(form["file"], (*path, "file"), subject) if "file" in form else None
        turns = form.get("turns", 1)
        if not 1 <= turns <= 10_000:
            self.error(f"turns: {turns} is not between 1 and 10000", (*path, "turns"), subject)
        settings = self.settings(form.get("set", {}), (*path, "set"), subject)
        use = self.choice(form, "use", USES, path, subject) or USES[0]
        if len(self.problems) > before or file is None:
            return None
        shown, place, none = str(self.folder / form["file"]), self.source.place(path), np.empty(0)
        run = OrderRun(form["id"], shown, none, {}, None, turns, settings, use, place)
        return run, _Table(file, form["speed"], form.get("time"), *words)
