"""Order vectors as a folder that monitoring systems' exports look like, and `load_orders` reads back."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.files import write_atomically
from rotorsim.recordings.document import FILE
from rotorsim.recordings.orders import PHASES, OrderRecording, OrderRun
from rotorsim.recordings.writing import make_folder, write_table
from rotorsim.units import AMPLITUDE_KINDS, conversion


def save_orders(
    folder: str | Path,
    recording: OrderRecording,
    *,
    amplitude: str = "0-peak",
    phase: str = "lead",
    overwrite: bool = False,
) -> Path:
    """Write order vectors as recording.json and a CSV for each run; return the former.

    Each row has time [s], speed [rpm], and of every channel amplitude, in its own unit, and phase [deg]. amplitude:
    "0-peak", "peak-peak" or "rms"; phase: "lead" or "lag". Runs without times stay so: their rows are successive turns.
    Raises RotorsimError for other words, and files that are there already unless ``overwrite``.
    """
    for word, known in ((amplitude, AMPLITUDE_KINDS), (phase, PHASES)):
        if word not in known:
            raise RotorsimError(Problem(f"'{word}' says not what numbers are", hint=near_miss(word, known)))
    backward = [run for run in recording.runs if run.sense < 0]
    if backward:
        hint = "exchange the axes of the recording, so that the shaft turns from x to y"
        what = "a table does not say that the shaft turns from y to x"
        raise RotorsimError(*(Problem(what, f"run {run.id}", run.place, hint) for run in backward))
    folder = Path(folder)
    names = {run.id: f"{_plain(run.id, k)}.csv" for k, run in enumerate(recording.runs)}
    columns = {name: _plain(name, k) for k, name in enumerate(recording.channels)}
    document: dict[str, Any] = {
        "kind": "orders",
        "name": recording.name,
        "source": recording.source,
        "amplitude": amplitude,
        "phase": phase,
        "slow_roll": "included" if recording.slow_roll else "subtracted",
        "channels": {
            name: {"signal": one.signal}
            | ({} if one.axis is None else {"axis": one.axis})
            | ({} if one.node is None else {"node": one.node})
            | ({} if one.position is None else {"position": f"{one.position!r} m"})
            | {
                "unit": one.unit,
                "order": one.order,
                "amplitude": f"{columns[name]} amplitude",
                "phase": f"{columns[name]} phase",
            }
            for name, one in recording.channels.items()
        },
        "runs": [
            {"id": run.id, "file": names[run.id], "speed": "rpm", "turns": run.turns}
            | ({} if run.time is None else {"time": "t"})
            | ({"set": dict(run.settings)} if run.settings else {})
            | {"use": run.use}
            for run in recording.runs
        ],
    }
    make_folder(folder, [FILE, *names.values()], overwrite)
    for run in recording.runs:
        write_table(folder / names[run.id], _table(recording, run, columns, amplitude, phase))
    path = folder / FILE
    write_atomically(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return path


def _plain(name: str, number: int) -> str:
    """Return a name as it is where any reader of CSV files takes it, else without what is special there, numbered."""
    plain = re.sub(r"[^A-Za-z0-9 _.\[\]-]", "_", name)
    return name if plain == name else f"{plain} {number + 1}"


def _table(
    recording: OrderRecording, run: OrderRun, columns: Mapping[str, str], amplitude: str, phase: str
) -> dict[str, np.ndarray]:
    """Return the columns of a run."""
    table = {} if run.time is None else {"t": run.time}
    table["rpm"] = run.speed * 30 / math.pi
    for name, channel in recording.channels.items():
        values = run.vectors.get(name, np.full(len(run.speed), np.nan, complex))
        table[f"{columns[name]} amplitude"] = (
            np.abs(values) * AMPLITUDE_KINDS[amplitude] / conversion(channel.unit, None)
        )
        table[f"{columns[name]} phase"] = PHASES[phase] * np.degrees(np.angle(values))
    return table
