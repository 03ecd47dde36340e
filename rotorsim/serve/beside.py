"""Recordings in the charts of the page: what was measured, and the diagram driven as it was recorded."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.parse.document import endpoint
from rotorsim.diagram.resolve.values import numeric
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.measure.over_speed import HarmonicsOverSpeed, harmonics_over_speed
from rotorsim.model.compiled import Model
from rotorsim.recordings.recording import ANGLE, Recording, Run
from rotorsim.settled.result import Periodic
from rotorsim.simulation.result import Result, flat_name
from rotorsim.units import compatible

if TYPE_CHECKING:
    from rotorsim.identification.as_recorded import AsRecorded

RECORDING_FILE = "recording.json"
DEEPEST_RECORDING = 3  # folders below the diagram's in which recordings are looked for
MOST_LISTED = 200
PAST_RUNS = 1.02  # times the fastest run, to which the settled motion is drawn
MOST_DESCRIBED = 5_000_000  # bytes of a recording.json whose runs are listed
Data = dict[str, Any]


def recordings_below(folder: Path) -> list[Data]:
    """Return name, kind and runs of the recordings below a folder; names as they are called from there."""
    found = []
    pattern = ["/".join(["*"] * depth) for depth in range(1, DEEPEST_RECORDING + 1)]
    for one in pattern:
        for file in sorted(folder.glob(f"{one}/{RECORDING_FILE}")):
            if file.is_file() and file.resolve().is_relative_to(folder.resolve()):
                name = file.parent.relative_to(folder).as_posix()
                if name.isprintable():  # others cannot be written as JSON, or not be read
                    found.append({"name": name, **_described(file)})
    return found[:MOST_LISTED]


def _described(file: Path) -> Data:
    """Return what a description says of kind and runs, as far as it can be read: verbs say what is wrong with it."""
    try:
        data = json.loads(file.read_bytes()) if file.stat().st_size < MOST_DESCRIBED else {}
    except (OSError, ValueError, RecursionError):
        data = {}
    runs = data.get("runs") if isinstance(data, dict) else None
    ids = [str(run["id"]) for run in runs if isinstance(run, dict) and "id" in run] if isinstance(runs, list) else []
    ids = [one for one in ids if one.isprintable()]
    return {"kind": str(data.get("kind", "time")) if isinstance(data, dict) else "time", "runs": ids}


def read_recording(folder: Path, name: str) -> Recording:
    """Return a recording below a folder. Raises RotorsimError for what is none, and for orders."""
    from rotorsim.recordings.loading import load_recording

    known = {one["name"]: one["kind"] for one in recordings_below(folder)}
    if name not in known:
        what = f"no recording '{name}' below the folder of the diagram"
        raise RotorsimError(Problem(what, hint=near_miss(name, known)))
    if known[name] == "orders":
        hint = "Compare draws them in a figure of its own"
        raise RotorsimError(Problem("orders over the speed have no samples in time", name, hint=hint))
    return load_recording(folder / name)


@dataclass(frozen=True, eq=False)
class Beside:
    """A diagram driven as a run was recorded, and what was measured then: signals by their names in the diagram."""

    simulated: Result
    measured: Result
    errors: Mapping[str, float]  # NRMSE by signal
    found: AsRecorded

    def plot(self) -> Any:
        """Return the figure of simulated beside measured signals in time, the worst stretch of each beside it."""
        from rotorsim.report.figures.as_recorded import as_recorded_figure

        return as_recorded_figure(self.found)


def driven_as_recorded(diagram: Diagram, recording: Recording, run: str | None) -> Beside:
    """Return a diagram driven as a run was. Raises RotorsimError as `simulate_as_recorded`."""
    from rotorsim.identification.as_recorded import MEASURED_PREFIX, simulate_as_recorded

    found = simulate_as_recorded(diagram, recording, run)
    measured = measured_result(diagram, recording, recording.run(found.run))
    flat = {
        diagram.as_measured(name): (values, found.result.unit(name))
        for name, values in found.result.signals.items()
        if not name.startswith(MEASURED_PREFIX)
    }
    signals, units = in_axes({name: values for name, (values, _) in flat.items()}), {}
    for name in signals:
        units[name] = next(unit for one, (_, unit) in flat.items() if one == name or _pair(one)[0] == name)
    if ANGLE in measured and ANGLE not in signals and len(measured.time) == len(found.result.time):
        signals[ANGLE], units[ANGLE] = measured[ANGLE], "rad"
    simulated = Result(found.result.time, signals, units, provenance=found.result.provenance)
    errors = {diagram.as_measured(name): value for name, value in found.errors.nrmse.items()}
    return Beside(simulated, measured, errors, found)


def measured_result(diagram: Diagram, recording: Recording, run: Run) -> Result:
    """Return a run as a result, with the names that its signals have in the diagram."""
    from rotorsim.measure.as_result import as_result

    found = as_result(recording, run)
    names = {name: diagram.as_measured(name) for name in found.signals}
    signals = {names[name]: values for name, values in found.signals.items()}
    units = {names[name]: found.unit(name) for name in found.signals}
    return Result(found.time, signals, units, provenance=found.provenance)


@dataclass(frozen=True, eq=False)
class BesideSettled:
    """Settled motion over the speed, and the harmonics that were measured: signals by their names in the diagram."""

    settled: Periodic
    measured: Mapping[str, HarmonicsOverSpeed]
    left_out: tuple[str, ...] = ()  # measured signals and runs that are not those of the diagram, and why

    def plot(self) -> Any:
        """Return the figure of both."""
        from rotorsim.report.figures.linear import periodic_figure

        names = [name for name in self.settled.two_axis if name in self.measured]
        return periodic_figure(self.settled, names or None, measured=self.measured)


def beside_settled(
    model: Model, speeds: np.ndarray, parameters: Data, recording: Recording, progress: Callable[[float], None]
) -> BesideSettled:
    """Return the settled motion of a diagram beside what the runs of a recording have measured.

    speeds (n,) [rad/s]: reach further where the runs do, and hold their speeds too. Runs of other settings, and those
    that turn the other way, are another machine: they are left out, and said.
    Raises RotorsimError where nothing is left.
    """
    from rotorsim.settled.periodic import periodic

    measured = {}
    runs, left_out = _alike(model.diagram, parameters, recording, float(speeds[-1]))
    for name, one in harmonics_over_speed(recording, runs).items():
        meant = model.diagram.as_measured(name)
        why = _misfit(model.diagram, meant, one.harmonics[0].unit)
        if why:
            left_out.append(f"{name} ({why})")
        else:
            measured[meant] = one
    if not measured:
        raise RotorsimError(Problem(f"no measured signal is one of the diagram: {', '.join(left_out)}", recording.name))
    known = np.concatenate([one.speeds for one in measured.values()])
    top = max(float(speeds[-1]), *(PAST_RUNS * known), key=abs)
    all_speeds = np.unique(np.concatenate([np.linspace(speeds[0], top, len(speeds)), known]))
    settled = periodic(model, speeds=all_speeds, parameters=parameters, progress=progress)
    return BesideSettled(settled, measured, tuple(left_out))


def _alike(diagram: Diagram, parameters: Data, recording: Recording, speed: float) -> tuple[list[Run], list[str]]:
    """Return the runs of the machine that the diagram is, and why others are not; speed: of the diagram [rad/s]."""
    from rotorsim.identification.waveform.recorded.reading import settings_of
    from rotorsim.measure.as_result import has_angle
    from rotorsim.signals.shaft_angle import shaft_angle

    runs: list[Run] = []
    others: dict[str, list[str]] = {}
    for run in recording.runs:
        settings, problems = settings_of(diagram, run)
        if problems:
            raise RotorsimError(*problems)
        other = [
            name for name, value in settings.items() if name != "speed" and not _is(diagram, parameters, name, value)
        ]
        if other:
            others.setdefault(f"other {', '.join(other)}", []).append(run.id)
        elif has_angle(recording, run) and float(np.subtract(*shaft_angle(recording, run).theta[[-1, 0]])) * speed < 0:
            others.setdefault("turning the other way", []).append(run.id)
        else:
            runs.append(run)
    left_out = [f"{', '.join(ids)} ({why})" for why, ids in others.items()]
    if not runs:
        raise RotorsimError(Problem(f"no run is one of this machine: {'; '.join(left_out)}", recording.name))
    return runs, left_out


def _is(diagram: Diagram, parameters: Data, name: str, value: Any) -> bool:
    """Return whether a parameter of the diagram has a value (SI) that was set in a run."""
    block, _, key = name.partition("[")[0].rpartition(".")
    node = diagram.nodes.get(block)
    known = diagram.parameters.get(name) if node is None else node.values.get(key)
    followed = "" if node is None else node.references.get(key, "")
    given = parameters.get(followed or name)
    if given is not None:
        known = numeric(given, diagram.unit_of_parameter(followed or name))
    if known is None or np.shape(known) != np.shape(value):
        return False
    return bool(np.allclose(known, value, rtol=1e-9, atol=0.0))


def _misfit(diagram: Diagram, name: str, unit: str) -> str:
    """Return why a measured signal is none that the diagram records, "" where it is."""
    end = endpoint(name)
    node = None if end is None else diagram.nodes.get(end.block)
    if end is None or node is None or end.port not in node.outputs:
        return "no such signal"
    if not any(str(one).partition("[")[0] == name.partition("[")[0] for one in diagram.record):
        return "not recorded"
    known = node.outputs[end.port].unit
    return f"{unit}, not {known}" if compatible(unit, known) in ("different", "angle") else ""


def in_axes(flat: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return entries (n,) with those of an x and a y axis as one, (n, 2): ``a.b[3]`` of ``a.b[3,1]``, ``a.b[3,2]``."""
    held: dict[str, set[int]] = {}
    for name in flat:
        whole, axis = _pair(name)
        held.setdefault(whole, set()).add(axis)
    signals: dict[str, np.ndarray] = {}
    for name, values in flat.items():
        whole, axis = _pair(name)
        if held[whole] != {0, 1}:
            signals[name] = values
        elif axis == 0:
            other = next(one for one in flat if _pair(one) == (whole, 1))
            signals[whole] = np.column_stack([values, flat[other]])
    return signals


def _pair(name: str) -> tuple[str, int]:
    """Return the name of a signal without its last index, and that index; -1 where it has none."""
    end = endpoint(name)
    if end is None or not end.index:
        return name, -1
    return flat_name(f"{end.block}.{end.port}", end.index[:-1]), end.index[-1]
