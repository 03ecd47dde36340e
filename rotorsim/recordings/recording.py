"""What was measured: channels, runs and the recording they make; nothing in them can be changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from rotorsim.errors import Place, Problem, RotorsimError, near_miss

ANGLE = "clock.theta"  # signal of a channel that measures the shaft angle
TACHO = "tacho"  # signal of a channel with the raw voltage of a once-per-turn pulse
AXES = ("x", "y")
USES = ("identify", "hold_out")


@dataclass(frozen=True)
class Channel:
    """One column of the data files and the signal of the diagram that it measures.

    column: name in the data file. signal: "rotor.displacement", "controller.current", "clock.theta" (shaft angle)
    or "tacho" (raw pulse voltage). axis: "x" or "y". node: counted from 1. position: along the shaft [m].
    unit: as stated; values are SI all the same. coupling: "ac" when the mean means nothing. place: where
    recording.json names it. direction: of a probe [rad], from x towards y; None once two of them are turned to x and y.
    """

    column: str
    signal: str
    axis: str | None
    node: int | None
    position: float | None
    unit: str
    coupling: str = "dc"
    place: Place = field(default_factory=Place, compare=False, repr=False)
    direction: float | None = None

    @property
    def name(self) -> str:
        """The diagram's entry: rotor.displacement[3,1], controller.current[2], drive.output.

        A place along the shaft stands where the node would until the diagram says which it is:
        rotor.acceleration[0.05 m,1].
        """
        place = self.node if self.node is not None else f"{self.position:g} m" if self.position is not None else None
        axis: object = AXES.index(self.axis) + 1 if self.axis is not None else None
        if self.direction is not None:
            axis = f"{np.degrees(self.direction):g} deg"
        inside = ",".join(str(part) for part in (place, axis) if part is not None)
        return f"{self.signal}[{inside}]" if inside else self.signal

    @property
    def label(self) -> str:
        """What is measured, in words: two channels of a recording differ in it."""
        return self.name


@dataclass(frozen=True, eq=False)
class Run:
    """One run: its samples, and what was set and said about it.

    file: as shown to the user. time: (n,) [s], from 0 with a sample rate, else as in the time column.
    values: column -> (n,), SI. speed: nominal [rad/s]. tacho: (k,) [s], times of a once-per-turn pulse on the
    clock of ``time``. settings: block.parameter or diagram parameter -> value as in the JSON. use: "identify"
    or "hold_out". place: where recording.json says so. sample_rate: as stated there [Hz]. weights: column -> (n,),
    1 / SI^2: the information of each sample, of columns where samples differ in that. tacho_resolution: of the pulse
    times [s], as stated; None: to be seen from them.
    """

    id: str
    file: str
    time: np.ndarray
    values: Mapping[str, np.ndarray]
    speed: float | None
    tacho: np.ndarray | None
    settings: Mapping[str, Any]
    use: str
    place: Place
    sample_rate: float | None = None
    weights: Mapping[str, np.ndarray] = field(default_factory=dict)
    tacho_resolution: float | None = None

    def __post_init__(self) -> None:
        set_once = partial(object.__setattr__, self)
        set_once("time", _read_only(self.time))
        set_once("values", MappingProxyType({column: _read_only(array) for column, array in self.values.items()}))
        set_once("weights", MappingProxyType({column: _read_only(array) for column, array in self.weights.items()}))
        set_once("settings", MappingProxyType(dict(self.settings)))
        set_once("tacho", None if self.tacho is None else _read_only(self.tacho))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as plain dictionaries: runs travel between processes."""
        return Run, _plain(self)

    def __repr__(self) -> str:
        span = f"{self.time[0]:g}..{self.time[-1]:g} s" if len(self.time) else "no samples"
        return f"Run({self.id}: {len(self.time)} samples, {span}, {', '.join(self.values)})"


@dataclass(frozen=True, eq=False)
class Recording:
    """A folder of runs with the same channels.

    channels: column -> `Channel`. folder: where recording.json is. warnings: found while reading.
    """

    name: str
    source: str
    folder: Path
    channels: Mapping[str, Channel]
    runs: tuple[Run, ...]
    warnings: tuple[Problem, ...] = field(default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        object.__setattr__(self, "runs", tuple(self.runs))
        object.__setattr__(self, "warnings", tuple(self.warnings))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as plain dictionaries: recordings travel between processes."""
        return Recording, _plain(self)

    def column(self, name: str) -> str | None:
        """Return the column of an entry such as ``rotor.displacement[3,1]``, or None where it is not measured."""
        return next((column for column, channel in self.channels.items() if channel.name == name), None)

    def signal(self, run: Run, name: str) -> np.ndarray:
        """Return the samples (n,), SI, of an entry such as ``rotor.displacement[3,1]`` in a run.

        Raises RotorsimError with a near miss when it is not measured.
        """
        column = self.column(name)
        if column is None or column not in run.values:
            known = [channel.name for channel in self.channels.values() if channel.column in run.values]
            raise RotorsimError(Problem("this signal was not measured", name, run.place, near_miss(name, known)))
        return run.values[column]

    def run(self, name: str | None = None) -> Run:
        """Return a run by its id, the first without one. Raises RotorsimError with a near miss where there is none."""
        known = {run.id: run for run in self.runs}
        if name is not None and name not in known:
            raise RotorsimError(Problem(f"no run '{name}'", self.name, hint=near_miss(name, known)))
        return self.runs[0] if name is None else known[name]

    def select(self, use: str) -> tuple[Run, ...]:
        """Return the runs of a use: "identify" or "hold_out". Raises RotorsimError for another word."""
        if use not in USES:
            raise RotorsimError(Problem(f"'{use}' is no use of a run", hint=near_miss(use, USES)))
        return tuple(run for run in self.runs if run.use == use)

    def __repr__(self) -> str:
        return f"Recording({self.name}: {len(self.runs)} runs, {', '.join(self.channels)})"


def signal_and_place(name: str) -> tuple[str, tuple[int, ...]]:
    """Return the signal of an entry and the place in it, from 0: ("rotor.displacement", (2, 0)).

    A place along the shaft stays in the name: ("rotor.displacement[0.05 m]", (0,)).
    """
    base, _, inside = name.removesuffix("]").partition("[")
    parts = inside.split(",") if inside else []
    kept = [part for part in parts if not part.strip().isdecimal()]
    index = tuple(int(part) - 1 for part in parts if part.strip().isdecimal())
    return (f"{base}[{','.join(kept)}]" if kept else base), index


def _read_only(values: Any) -> np.ndarray:
    """Return a view that cannot be written; the caller's own array stays as it is."""
    array = np.asarray(values, dtype=float).view()
    array.flags.writeable = False
    return array


def _plain(item: Run | Recording) -> tuple[Any, ...]:
    return tuple(dict(value) if isinstance(value, MappingProxyType) else value for value in vars(item).values())
