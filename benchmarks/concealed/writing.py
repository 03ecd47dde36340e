"""Write a case as the shared sets are written: CASE/, hold_out/CASE/, truth/CASE.json."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.generator import RATE, Case
from benchmarks.concealed.machines import nominal
from benchmarks.concealed.measuring import Nuisances, draw_nuisances, pulses, read_signals
from benchmarks.concealed.plant import Bearing, Gains

Array = NDArray[Any]
FORMATS = ("csv", "npz", "mat")


def write_case(case: Case, folder: Path, seed: tuple[int, ...], nuisances: tuple[str, ...] = ()) -> None:
    """Measure a case, with nuisances, and write it. Without them it is the same as before there were any."""
    rng = np.random.default_rng([*seed, 1])
    more = np.random.default_rng([*seed, 2]) if nuisances else None
    drawn = Nuisances() if more is None else draw_nuisances(more, nuisances, RATE)
    columns = read_signals(case.motion, case.instruments, rng, case.coarse, drawn, RATE, more)
    duration = case.runs[0].samples / RATE
    tacho = pulses(case.motion, duration, float(np.hypot(case.instruments.jitter, drawn.jitter)), rng, drawn.grid)
    bearings = nominal(case.machine).bearings
    suffix = FORMATS[int(rng.integers(len(FORMATS)))]
    for use, place in (("identify", folder / case.name), ("hold_out", folder / "hold_out" / case.name)):
        place.mkdir(parents=True, exist_ok=True)
        runs: list[dict[str, Any]] = []
        for lane in (k for k, run in enumerate(case.runs) if run.use == use):
            run = case.runs[lane]
            hertz = run.speed / (2 * np.pi)
            motion = "up" if run.acceleration > 0 else "down" if run.acceleration else f"{hertz:05.1f}Hz"
            name = f"run{len(runs):02d}_{motion}_{run.label}"
            _write_data(place / f"{name}.{suffix}", columns[lane])
            runs.append(
                {
                    "id": name,
                    "file": f"{name}.{suffix}",
                    "sample_rate": f"{RATE:.0f} Hz",
                    **({} if run.acceleration else {"speed": f"{60 * hertz:.0f} rpm"}),
                    "tacho": tacho[lane],
                    "use": use,
                    "set": _settings(run.gains, bearings),
                }
            )
        channels = _channels(columns[0], bearings)
        recording = {"name": case.name, "source": _source(case), "channels": channels, "runs": runs}
        (place / "recording.json").write_text(json.dumps(recording, indent=1) + "\n")
    truths = folder / "truth"
    truths.mkdir(exist_ok=True)
    (truths / f"{case.name}.json").write_text(
        json.dumps(case.truth() | ({"nuisances": asdict(drawn)} if nuisances else {}), indent=1) + "\n"
    )


def _source(case: Case) -> str:
    span, bits = case.instruments.span, case.instruments.bits
    text = "simulated by a program that shares nothing with rotorsim; the sensors' noise is in the data; "
    text += f"converters of {bits} bit over +-{span[0] * 1e6:g} um and +-{span[1]:g} A"
    if case.machine != "jeffcott":
        probes = tuple(nominal(case.machine).probes)
        count = {6: "six", 9: "nine"}[len(nominal(case.machine).tilt)]
        text += f"; probes at nodes {probes[0]} to {probes[-1]} of the {count} of diagram {case.machine}, another mesh"
    return text


def _settings(gains: tuple[Gains, ...], bearings: list[Bearing]) -> dict[str, float]:
    """Return the gains by the names that they have in the diagram."""
    return {
        f"{bearing.controller}.{name}": own[k]
        for own, bearing in zip(gains, bearings, strict=True)
        for k, name in ((0, "KP"), (2, "KD"), (1, "KI"))
    }


def _channels(columns: dict[str, Array], bearings: list[Bearing]) -> dict[str, dict[str, Any]]:
    controllers = {bearing.mark: bearing.controller for bearing in bearings}
    out: dict[str, dict[str, Any]] = {}
    for name in columns:
        if name[0] == "i":
            out[name] = {"signal": f"{controllers[name[2:]]}.current", "axis": name[1], "unit": "A"}
        else:
            node = {"node": int(name[1:])} if len(name) > 1 else {}
            out[name] = {"signal": "rotor.displacement", **node, "axis": name[0], "unit": "m"}
    return out


def _write_data(path: Path, columns: dict[str, Array]) -> None:
    t = np.arange(len(next(iter(columns.values())))) / RATE
    if path.suffix == ".csv":
        table = np.column_stack([t, *columns.values()])
        head = ",".join(["t", *columns])
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=head, comments="")
    elif path.suffix == ".npz":
        with open(path, "wb") as file:
            np.savez(file, **columns)  # type: ignore[arg-type]
    else:
        from scipy.io import savemat

        savemat(path, columns)
