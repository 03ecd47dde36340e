"""The result of a simulation: signals with units, status, work counters, provenance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from rotorsim._shown import Shown, html_table, xarray_module
from rotorsim.errors import Problem, RotorsimError, escape, near_miss


def flat_name(name: str, index: tuple[int, ...]) -> str:
    """Return the FMI structured name of one entry: ``rotor.displacement[3,2]``, counted from 1."""
    base, _, inside = name.rstrip("]").partition("[")
    parts = [*([inside] if inside else []), *(str(i + 1) for i in index)]
    return f"{base}[{','.join(parts)}]" if parts else base


def _read_only(values: Any) -> np.ndarray:
    """Return a view that cannot be written; the caller's own array stays as it is."""
    array = np.asarray(values).view()
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Result(Shown):
    """Recorded signals of one run; nothing in it can be changed.

    time: (n,) [s]. signals: name -> (n, *shape), SI. units: name -> unit. status: "finished",
    "unstable" (the machine is, by its poles), "diverged" (a state stopped being finite, or the step is beyond the
    stability limit) or "stopped" (interrupted); message: the reason, or advice; cause: what it is about, where that
    decides the cure: "step" (too large), "coupling" (its step is), "sampled" (unstable, with sampled blocks), "loop",
    "part" (one has failed). counters: steps,
    evaluations, CPU seconds, step_error (of a fixed step, relative). provenance: what was run, with what.

    ``result["rotor.displacement"]`` is the whole signal, ``result["rotor.displacement[3,1]"]`` one entry of it.
    Raises RotorsimError for signals that are not as long as time.
    """

    time: np.ndarray
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    status: str = "finished"
    message: str = ""
    counters: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    cause: str = ""

    _figure = "rotorsim.report.figures.run:overview"

    def __post_init__(self) -> None:
        time = _read_only(self.time)
        signals = {name: _read_only(array) for name, array in self.signals.items()}
        problems = [
            Problem(what=f"{len(np.atleast_1d(array))} samples, but time has {time.size}", subject=name)
            for name, array in signals.items()
            if array.shape[:1] != time.shape
        ]
        if time.ndim != 1:
            problems = [Problem(what=f"must have shape (n,), got {time.shape}", subject="time")]
        if problems:
            raise RotorsimError(*problems)
        frozen = {"time": time, "signals": MappingProxyType(signals)}
        frozen |= {name: MappingProxyType(dict(getattr(self, name))) for name in ("units", "counters", "provenance")}
        for name, value in frozen.items():
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as plain dictionaries: results travel between processes."""
        maps = (dict(self.counters), dict(self.provenance))
        return Result, (self.time, dict(self.signals), dict(self.units), self.status, self.message, *maps, self.cause)

    def __eq__(self, other: object) -> bool:
        """Whether everything is equal, to the last bit (NaN equals NaN)."""
        if not isinstance(other, Result):
            return NotImplemented
        return (
            list(self.signals) == list(other.signals)
            and np.array_equal(self.time, other.time)
            and all(np.array_equal(self.signals[k], other.signals[k], equal_nan=True) for k in self.signals)
            and (self.units, self.status, self.message, self.cause)
            == (other.units, other.status, other.message, other.cause)
            and (self.counters, self.provenance) == (other.counters, other.provenance)
        )

    __hash__ = None  # type: ignore[assignment]

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a signal (n, *shape) or the part that a name such as ``rotor.displacement[3,1]`` selects."""
        if name == "time":
            return self.time
        recorded, index = self._find(name)
        place: Any = (slice(None), *index)
        return np.asarray(self.signals[recorded][place])

    def column(self, name: str) -> np.ndarray:
        """Return one entry of a signal by its flat name, shape (n,). Raises RotorsimError if there are several."""
        values = self[name]
        if values.ndim != 1:
            first = flat_name(name, (0,) * (values.ndim - 1))
            last = flat_name(name, tuple(n - 1 for n in values.shape[1:]))
            hint = f"name one of them: '{first}' .. '{last}'"
            what = f"has {np.prod(values.shape[1:])} entries"
            raise RotorsimError(Problem(what=what, subject=name, hint=hint))
        return values

    def unit(self, name: str) -> str:
        """Return the unit of a signal or of a part of one ("" where it is not known)."""
        return "s" if name == "time" else self.units.get(self._find(name)[0], "")

    def _find(self, name: str) -> tuple[str, tuple[int, ...]]:
        """Return the recorded signal and the place in it (from 0) that a name stands for."""
        if name in self.signals:
            return name, ()
        base, bracket, inside = name.partition("[")
        if bracket and inside.endswith("]"):
            parts = inside[:-1].split(",")
            for kept in range(len(parts)):  # a part of a recorded part: displacement[4,1] of displacement[4]
                recorded = f"{base}[{','.join(parts[:kept])}]" if kept else base
                if recorded in self.signals:
                    return recorded, self._place(name, recorded, parts[kept:])
        hint = near_miss(name, self.signals) or "nothing was recorded"
        raise RotorsimError(
            Problem(what="this signal was not recorded", subject=name, hint=hint.replace("known:", "recorded:"))
        )

    def _place(self, name: str, recorded: str, parts: list[str]) -> tuple[int, ...]:
        shape = self.signals[recorded].shape[1:]
        if len(parts) <= len(shape) and all(part.strip().isdecimal() for part in parts):
            index = tuple(int(part) - 1 for part in parts)
            if all(0 <= at < size for at, size in zip(index, shape, strict=False)):
                return index
        text = " x ".join(map(str, shape)) or "scalar"
        what = f"no such entry; '{recorded}' has shape {text}, counted from 1"
        if not shape:
            what = f"no such entry; '{recorded}' is a scalar"
        raise RotorsimError(Problem(what=what, subject=name))

    def __contains__(self, name: object) -> bool:
        return name in self.signals

    def complex(self, name: str) -> np.ndarray:
        """Return x + i y of a two-axis signal: (n, 2) -> (n,), (n, nodes, 2) -> (n, nodes).

        Raises RotorsimError when the last dimension is not [x, y].
        """
        array = self[name]
        if array.ndim < 2 or array.shape[-1] != 2:
            raise RotorsimError(
                Problem(what="not a two-axis signal", subject=name, hint="its last dimension must be [x, y]")
            )
        return np.asarray(array[..., 0] + 1j * array[..., 1])

    def columns(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield every entry of every signal by its flat name, row-major."""
        for name, array in self.signals.items():
            for index in np.ndindex(array.shape[1:]):
                yield flat_name(name, index), array[:, *index]

    def flat_names(self) -> list[str]:
        """Return the flat names of `columns`."""
        return [name for name, _ in self.columns()]

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset with the coordinate time [s]; needs the optional package xarray."""
        variables = {
            name: (["time", *_dimensions(name, array.shape[1:])], array, {"units": self.units.get(name, "1")})
            for name, array in self.signals.items()
        }
        coordinates: dict[str, Any] = {"time": ("time", self.time, {"units": "s"})}
        if any(a.ndim > 1 and a.shape[-1] == 2 for a in self.signals.values()):
            coordinates["axis"] = ["x", "y"]
        attributes = {"status": self.status, "message": self.message, **{k: str(v) for k, v in self.provenance.items()}}
        return xarray_module().Dataset(variables, coordinates, attributes)

    def __repr__(self) -> str:
        span = f"{self.time[0]:g}..{self.time[-1]:g} s" if len(self.time) else "empty"
        names = ", ".join(list(self.signals)[:4]) + (
            f", ... {len(self.signals)} signals" if len(self.signals) > 4 else ""
        )
        return f"Result({self.provenance.get('diagram', '')}: {self.status}, {span}, {names})"

    def _repr_html_(self) -> str:
        rows = [
            {
                "signal": name,
                "shape": a.shape[1:],
                "unit": self.units.get(name, ""),
                "peak": float(np.abs(a).max()) if a.size else 0.0,
            }
            for name, a in self.signals.items()
        ]
        return f"{super()._repr_html_()}{html_table(rows)}<p>{escape(self.message)}</p>"


def _dimensions(name: str, shape: tuple[int, ...]) -> list[str]:
    names = [f"{name} {k + 1}" for k in range(len(shape))]
    return [*names[:-1], "axis"] if shape and shape[-1] == 2 else names


def cut(rows: np.ndarray, shapes: Mapping[str, Sequence[int]]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return rows (n, n_y) as signals (n, *shape) by name, and the columns behind them."""
    ends = np.cumsum([int(np.prod(shape, dtype=int)) for shape in shapes.values()], dtype=int)
    *parts, rest = np.split(rows, ends, axis=1)
    signals = zip(shapes.items(), parts, strict=True)
    return {name: part.reshape(len(rows), *shape) for (name, shape), part in signals}, rest
