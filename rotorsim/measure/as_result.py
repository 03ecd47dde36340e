"""A run of a recording as the result of a simulation, so that the same analyses work on both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.recordings.recording import ANGLE, TACHO, Channel, Recording, Run, signal_and_place
from rotorsim.signals.shaft_angle import ShaftAngle, shaft_angle
from rotorsim.simulation.result import Result
from rotorsim.units import conversion, parse_unit

MOST_BYTES = 4e9  # bytes of a stacked signal
_TIME_ROUNDING = 1e-2  # of a step: rounding of a time column
_SI = ("m", "m/s", "m/s^2", "A", "V", "N", "rad", "rad/s", "1")


def has_angle(recording: Recording, run: Run) -> bool:
    """Return whether something says how the shaft turned: an angle, pulses, or a speed other than zero."""
    columns = {channel.signal: column for column, channel in recording.channels.items()}
    if any(columns.get(signal) in run.values for signal in (ANGLE, TACHO)):
        return True
    return (run.tacho is not None and len(run.tacho) > 1) or bool(run.speed)


def as_result(recording: Recording, run: Run, angle: ShaftAngle | None = None) -> Result:
    """Return a run as a `Result`: measured signals in SI, and ``clock.theta`` where an angle is known.

    Channels of one signal are stacked as a simulation records them: ``rotor.displacement`` (n, 2), or
    (n, nodes, 2) up to the last node measured; entries that were not measured are NaN. A channel at a place along
    the shaft keeps it in its name: ``rotor.displacement[0.05 m]`` (n, 2). angle: default `shaft_angle`.
    Time that a column states in few digits is made even.
    Raises RotorsimError for a run without samples, or with an angle that makes no sense.
    """
    if len(run.time) < 2:
        raise RotorsimError(Problem(f"{len(run.time)} samples", run.id, Place(run.file)), exit_code=1)
    if angle is None and has_angle(recording, run):
        angle = shaft_angle(recording, run)
    entries: dict[str, dict[tuple[int, ...], Channel]] = {}
    for channel in recording.channels.values():
        if channel.signal not in (ANGLE, TACHO) and channel.column in run.values:
            base, index = signal_and_place(channel.name)
            entries.setdefault(base, {})[index] = channel
    signals = {base: _stacked(base, parts, run) for base, parts in entries.items()}
    units = {base: _si(next(iter(parts.values())).unit) for base, parts in entries.items()}
    if angle is not None:
        signals[ANGLE], units[ANGLE] = angle.theta, "rad"
    provenance = {"diagram": f"{recording.name} {run.id}", "recording": recording.name, "run": run.id, "file": run.file}
    return Result(_even(run.time), signals, units, provenance=provenance)


def _stacked(base: str, parts: Mapping[tuple[int, ...], Channel], run: Run) -> np.ndarray:
    """Return the entries of one signal as an array (n, *shape), NaN where nothing was measured."""
    depths = {len(index) for index in parts}
    if len(depths) > 1:
        columns = ", ".join(channel.column for channel in parts.values())
        what = f"columns {columns} cannot be parts of one signal: some say node or axis, others do not"
        raise RotorsimError(Problem(what, base, run.place, "give all of them axis, and node where there are several"))
    if depths == {0}:
        return run.values[parts[()].column]
    shape = [max(index[k] for index in parts) + 1 for k in range(depths.pop())]
    if any(channel.axis is not None for channel in parts.values()):
        shape[-1] = max(shape[-1], 2)
    size = 8.0 * len(run.time) * float(np.prod([float(n) for n in shape]))
    if size > MOST_BYTES:
        what = f"{' x '.join(map(str, shape))} entries of {len(run.time)} samples would take {size / 1e9:.0f} GB"
        raise RotorsimError(Problem(what, base, run.place, "number the nodes from 1 without large gaps"))
    stacked = np.full((len(run.time), *shape), np.nan)
    for index, channel in parts.items():
        place: Any = (slice(None), *index)
        stacked[place] = run.values[channel.column]
    return stacked


def _si(unit: str) -> str:
    """Return the name of the SI unit in which values stated in ``unit`` are kept."""
    if conversion(unit, None) == 1.0:
        return unit
    dimension = parse_unit(unit).dimension
    return next((name for name in _SI if parse_unit(name).dimension == dimension), parse_unit(unit).si)


def _even(time: np.ndarray) -> np.ndarray:
    """Return evenly spaced time where a column differs from that by rounding only."""
    n = len(time)
    step = float(time[-1] - time[0]) / (n - 1)
    even = time[0] + step * np.arange(n)
    return even if step > 0 and float(np.abs(time - even).max()) < _TIME_ROUNDING * step else time
