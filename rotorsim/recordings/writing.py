"""Simulated results as a recording: what a measurement of the diagram would look like."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagram.parse.source import Source
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.files import atomic_target, write_atomically
from rotorsim.recordings.document import FILE, parse_recording
from rotorsim.recordings.injection import InjectionParser
from rotorsim.recordings.recording import ANGLE, AXES, USES, Channel, Recording, Run, signal_and_place
from rotorsim.simulation.result import Result, flat_name
from rotorsim.units import UnitError, conversion

_SHORT = {"rotor.displacement": "", "controller.current": "i"}  # x, y and ix, iy; others by their full names
_EVEN = 1e-6  # of a step: how even time must be to be said by a sample rate
_ROWS = 4096  # of a CSV, written at a time


@dataclass(frozen=True)
class NewRun:
    """A run to be written.

    speed: nominal [rad/s]; None: the mean speed of clock.theta, where that was recorded. settings: values in force
    in this run. use: "identify" or "hold_out". window: (t0, t1) [s], the part of the result that is kept.
    """

    id: str
    result: Result
    speed: float | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    use: str = "identify"
    window: tuple[float, float] | None = None


def save_recording(
    folder: str | Path,
    runs: Iterable[NewRun | Mapping[str, Any]],
    *,
    name: str,
    source: str,
    signals: Sequence[str] | None = None,
    angle: bool = False,
    suffix: str = ".npz",
    overwrite: bool = False,
    injected: Mapping[str, tuple[str, str, str]] | None = None,
) -> Path:
    """Write simulated runs as a folder that `load_recording` reads back to the same numbers; return recording.json.

    The clock of a run starts at 0 with a sample rate when the result is evenly sampled, else its time is a column.
    Pulses of the tacho are where clock.theta passes multiples of 2 pi (linear between samples).
    signals: what to write (None: all that every run has, but the clock's). angle: also write clock.theta.
    suffix: ".npz" or ".csv" of the data files. overwrite: replace files that are there. injected: of signals in a loop,
    the port at which a test signal was injected, "test", "before" or "after", and the unit; the recording is of that
    kind then.
    Raises RotorsimError; recording.json is written last, and every file as a whole or not at all.
    """
    folder = Path(folder)
    new = [_new_run(run, k) for k, run in enumerate(runs)]
    if suffix not in (".npz", ".csv"):
        raise RotorsimError(Problem(f"'{suffix}' cannot be written", hint="suffix='.npz' or '.csv'"))
    channels = _channels(new[0].result, _signals(new, signals, angle)) if new else {}
    parts = [_part(run) for run in new]
    document: dict[str, Any] = {
        **({"kind": "injection"} if injected else {}),
        "name": name,
        "source": source,
        "channels": {
            column: {"signal": c.signal}
            | ({} if c.axis is None else {"axis": c.axis})
            | ({} if c.node is None else {"node": c.node})
            | {"unit": c.unit}
            | _meaning(c.signal, injected or {})
            for column, c in channels.items()
        },
        "runs": [_run_entry(run, part, suffix) for run, part in zip(new, parts, strict=True)],
    }
    for entry in document["runs"] if injected else ():
        del entry["use"]
    _check(document, folder)
    make_folder(folder, [FILE, *(run.id + suffix for run in new)], overwrite)
    for run, part in zip(new, parts, strict=True):
        table = {"t": run.result.time[part]} if _rate(run.result.time[part]) is None else {}
        for column, channel in channels.items():
            table[column] = run.result.column(channel.name)[part]
        write_table(folder / (run.id + suffix), table)
    path = folder / FILE
    write_atomically(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return path


def as_recording(result: Result, name: str) -> Recording:
    """Return a result in memory as a recording of one run, "run", with its two-axis signals and the shaft angle.

    Raises RotorsimError where the shaft angle or any signal [x, y] was not recorded.
    """
    hint = f"record {ANGLE} and a signal [x, y], such as rotor.displacement"
    signals = [key for key in result.signals if result[key].shape[-1:] == (2,) and result[key].ndim in (2, 3)]
    if ANGLE not in result or not signals:
        raise RotorsimError(Problem("neither shaft angle nor motion was recorded", name, hint=hint))
    channels = _channels(result, [*signals, ANGLE])
    values = {column: result.column(channel.name) for column, channel in channels.items()}
    run = Run("run", name, result.time, values, None, None, {}, USES[0], Place(name))
    return Recording(name, "simulation", Path(), channels, (run,))


def _new_run(run: NewRun | Mapping[str, Any], k: int) -> NewRun:
    if isinstance(run, NewRun):
        return run
    known = [part.name for part in fields(NewRun)]
    unknown = [key for key in run if key not in known]
    problems = [Problem(f"unknown key '{key}'", f"run {k + 1}", hint=near_miss(str(key), known)) for key in unknown]
    problems += [Problem(f"key '{key}' is missing", f"run {k + 1}") for key in ("id", "result") if key not in run]
    if problems:
        raise RotorsimError(*problems)
    return NewRun(**run)


def _signals(runs: Sequence[NewRun], signals: Sequence[str] | None, angle: bool) -> list[str]:
    """Return the signals to write, all recorded in every run with the same shape."""
    if signals is None:
        common = [name for name in (runs[0].result.signals if runs else ()) if not name.startswith("clock.")]
        signals = [name for name in common if all(name in run.result for run in runs)]
    chosen = [*dict.fromkeys(signals), *([ANGLE] if angle and ANGLE not in signals else [])]
    problems: list[Problem] = []
    for name in chosen:
        shapes = {}
        for run in runs:
            try:
                shapes[run.id] = run.result[name].shape[1:]
            except RotorsimError as error:
                problems += [Problem(p.what, f"{run.id}: {name}", hint=p.hint) for p in error.problems]
        if len(set(shapes.values())) > 1:
            text = ", ".join(f"{run} {shape}" for run, shape in shapes.items())
            problems.append(Problem(f"the runs differ in shape: {text}", name))
    if problems:
        raise RotorsimError(*problems)
    return chosen


def _channels(result: Result, signals: Sequence[str]) -> dict[str, Channel]:
    """Return column -> channel for every entry of the signals."""
    channels: dict[str, Channel] = {}
    for signal in signals:
        shape, unit = result[signal].shape[1:], result.unit(signal) or ("rad" if signal == ANGLE else "1")
        for entry in product(*(range(n) for n in shape)):
            name = flat_name(signal, entry)
            base, index = signal_and_place(name)
            channel = Channel(name, name, None, None, None, _unit(unit, name))
            if shape and shape[-1] == 2 and len(index) <= 2:
                node = index[0] + 1 if len(index) == 2 else None
                channel = replace(channel, signal=base, axis=AXES[index[-1]], node=node)
                if base in _SHORT:
                    channel = replace(channel, column=f"{_SHORT[base]}{channel.axis}{node or ''}")
            channels[channel.column] = channel
    return channels


def _meaning(signal: str, injected: Mapping[str, tuple[str, str, str]]) -> dict[str, str]:
    """Return what a channel says of its part in an injection at a port, if it has one."""
    base, bracket, index = signal.partition("[")
    if base not in injected:
        return {}
    port, role, unit = injected[base]
    return {"signal": port + bracket + index, "unit": unit, "injection": role}


def _unit(unit: str, name: str) -> str:
    """Return the unit of a signal, which must be SI since its numbers are."""
    try:
        if conversion(unit, None) == 1.0:
            return unit
    except UnitError as error:
        raise RotorsimError(Problem(error.what, name, hint=error.hint)) from None
    raise RotorsimError(Problem(f"unit '{unit}' is not SI", name, hint="results are in SI"))


def _part(run: NewRun) -> slice:
    """Return the samples inside the window."""
    time = run.result.time
    first, last = run.window if run.window is not None else (-math.inf, math.inf)
    part = slice(int(np.searchsorted(time, first)), int(np.searchsorted(time, last, side="right")))
    if part.stop - part.start < 2:
        span = f"the result lasts from {time[0]:g} to {time[-1]:g} s" if len(time) else "the result is empty"
        raise RotorsimError(Problem(f"window {first:g}..{last:g} s holds fewer than 2 samples", run.id, hint=span))
    return part


def _rate(time: np.ndarray) -> float | None:
    """Return the sample rate [Hz] of evenly spaced time, None where it is not."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    if step <= 0 or float(np.abs(time - time[0] - step * np.arange(len(time))).max()) > _EVEN * step:
        return None
    rounded = float(f"{1.0 / step:.9g}")
    return rounded if abs(rounded * step - 1.0) < 1e-11 else 1.0 / step


def _run_entry(run: NewRun, part: slice, suffix: str) -> dict[str, Any]:
    time = run.result.time[part]
    rate = _rate(time)
    entry: dict[str, Any] = {"id": run.id, "file": run.id + suffix}
    entry |= {"time": "t"} if rate is None else {"sample_rate": rate}
    speed = run.speed
    if ANGLE in run.result:
        theta = run.result[ANGLE][part]
        if speed is None:
            speed = float(theta[-1] - theta[0]) / float(time[-1] - time[0])
        entry["tacho"] = _pulses(time if rate is None else time - time[0], theta)
        if entry["tacho"]:
            entry["tacho_resolution"] = 0  # interpolated, not sampled: even where all happen to be at a sample
    if speed is not None:
        entry["speed"] = float(speed)
    if run.settings:
        plain = {name: v.tolist() for name, v in run.settings.items() if isinstance(v, np.ndarray | np.generic)}
        entry["set"] = {**run.settings, **plain}
    return entry | {"use": run.use}


def _pulses(time: np.ndarray, theta: np.ndarray) -> list[float]:
    """Return the times [s] at which a steadily growing (or falling) angle passes multiples of 2 pi."""
    turns = theta / (2.0 * math.pi)
    if turns[-1] < turns[0]:
        turns = -turns
    if np.any(np.diff(turns) <= 0):
        return []  # a rotor that stands or turns back
    whole = np.arange(math.ceil(turns[0]), math.floor(turns[-1]) + 1)
    return [float(at) for at in np.interp(whole, turns, time)]


def _check(document: dict[str, Any], folder: Path) -> None:
    """Check the document as the reader will, and that it says the same after a trip through JSON."""
    try:
        data = json.loads(json.dumps(document, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise RotorsimError(Problem(f"cannot be written as JSON: {error}", place=Place(str(folder / FILE)))) from None
    parser = InjectionParser if data.get("kind") == InjectionParser.kind else None
    parse_recording(Source(data, file=str(folder / FILE)), folder, files=False, parser_class=parser)


def make_folder(folder: Path, files: Sequence[str], overwrite: bool) -> None:
    """Make a folder. Raises RotorsimError where that cannot be, and for files in it that would be replaced."""
    there = [name for name in files if (folder / name).exists()]
    if there and not overwrite:
        what = f"{len(there)} file{'s' if len(there) > 1 else ''} would be replaced: {', '.join(there[:3])}"
        raise RotorsimError(Problem(what, place=Place(str(folder)), hint="choose another folder, or overwrite=True"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RotorsimError(Problem(f"folder cannot be made: {error.strerror}", place=Place(str(folder)))) from None


def write_table(path: Path, table: Mapping[str, np.ndarray]) -> None:
    """Write columns (n,) as a .npz or .csv file, as a whole or not at all."""
    size = sum(array.nbytes for array in table.values()) * (1 if path.suffix == ".npz" else 20 // 8)
    with atomic_target(path, size=size) as temporary:
        if path.suffix == ".npz":
            with temporary.open("wb") as stream:
                arrays: dict[str, Any] = dict(table)
                np.savez(stream, **arrays)
            return
        with temporary.open("w", encoding="utf-8", newline="\n") as text:
            text.write(",".join(f'"{column}"' if "," in column else column for column in table) + "\n")
            rows = np.column_stack(list(table.values()))
            for start in range(0, len(rows), _ROWS):
                text.write("".join(",".join(map(repr, row)) + "\n" for row in rows[start : start + _ROWS].tolist()))
