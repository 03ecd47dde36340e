"""The result of a simulation: signals with units, status, work counters, provenance."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.compile import Model

__all__ = ["Result", "flat_name", "make_result"]


def flat_name(name: str, index: tuple[int, ...]) -> str:
    """Return the FMI structured name of one entry: ``rotor.displacement[3,2]``, counted from 1."""
    base, _, inside = name.rstrip("]").partition("[")
    parts = [*([inside] if inside else []), *(str(i + 1) for i in index)]
    return f"{base}[{','.join(parts)}]" if parts else base


def _entry(array: np.ndarray, index: tuple[int, ...]) -> np.ndarray:
    """Return one entry (or row) of a signal at every instant."""
    place: Any = (slice(None), *index)
    return np.asarray(array[place])


@dataclass(frozen=True)
class Result:
    """Recorded signals of one run.

    time: (n,) [s]. signals: name -> (n, *shape), SI. units: name -> unit. status: "finished",
    "diverged" (a state stopped being finite) or "stopped" (interrupted); message: advice.
    counters: steps, evaluations, CPU seconds. provenance: what was run, with what.
    """

    time: np.ndarray
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    status: str = "finished"
    message: str = ""
    counters: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for array in (self.time, *self.signals.values()):
            array.flags.writeable = False

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a signal (n, *shape) or the part that a name such as ``rotor.displacement[3,1]`` selects."""
        if name == "time":
            return self.time
        if name in self.signals:
            return self.signals[name]
        base, bracket, inside = name.rstrip("]").partition("[")
        parts = inside.split(",") if bracket else []
        for kept in range(len(parts)):  # a part of a recorded part: displacement[4,1] of displacement[4]
            recorded = f"{base}[{','.join(parts[:kept])}]" if kept else base
            if recorded in self.signals:
                return self._part(name, recorded, parts[kept:])
        near = difflib.get_close_matches(name, list(self.signals), 1)
        hint = f"did you mean '{near[0]}'?" if near else f"recorded: {', '.join(self.signals)}"
        raise RotorsimError(Problem(what="this signal was not recorded", subject=name, hint=hint))

    def _part(self, name: str, recorded: str, parts: list[str]) -> np.ndarray:
        array = self.signals[recorded]
        try:
            index = tuple(int(part) - 1 for part in parts)
            if min(index) < 0:
                raise IndexError
            return _entry(array, index)
        except (ValueError, IndexError):
            shape = " x ".join(map(str, array.shape[1:])) or "scalar"
            what = f"no such entry; '{recorded}' has shape {shape}, counted from 1"
            raise RotorsimError(Problem(what=what, subject=name)) from None

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
            for index in product(*(range(n) for n in array.shape[1:])):
                yield flat_name(name, index), _entry(array, index)

    def flat_names(self) -> list[str]:
        """Return the flat names of `columns`."""
        return [name for name, _ in self.columns()]

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset with the coordinate time [s]; needs the optional package xarray."""
        try:
            import xarray
        except ImportError:
            hint = "pip install 'rotorsim[xarray]'"
            raise RotorsimError(Problem(what="xarray is not installed", subject="to_xarray", hint=hint)) from None
        variables = {}
        for name, array in self.signals.items():
            dims = ["time", *self._dimensions(name, array)]
            variables[name] = (dims, array, {"units": self.units.get(name, "1")})
        coordinates: dict[str, Any] = {"time": ("time", self.time, {"units": "s"})}
        if any(a.ndim > 1 and a.shape[-1] == 2 for a in self.signals.values()):
            coordinates["axis"] = ["x", "y"]
        attributes = {"status": self.status, "message": self.message, **{k: str(v) for k, v in self.provenance.items()}}
        return xarray.Dataset(variables, coordinates, attributes)

    @staticmethod
    def _dimensions(name: str, array: np.ndarray) -> list[str]:
        shape = array.shape[1:]
        names = [f"{name} {k + 1}" for k in range(len(shape))]
        if shape and shape[-1] == 2:
            names[-1] = "axis"
        return names

    def __repr__(self) -> str:
        span = f"{self.time[0]:g}..{self.time[-1]:g} s" if len(self.time) else "empty"
        return f"Result({self.provenance.get('diagram', '')}: {self.status}, {span}, {', '.join(self.signals)})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{escape(str(a.shape[1:]))}</td><td>{escape(self.units.get(name, ''))}</td>"
            f"<td>{float(np.abs(a).max()) if a.size else 0.0:.4g}</td></tr>"
            for name, a in self.signals.items()
        )
        head = "<tr><th>signal</th><th>shape</th><th>unit</th><th>peak</th></tr>"
        return f"<p>{escape(repr(self))}</p><table>{head}{rows}</table><p>{escape(self.message)}</p>"


def make_result(
    model: Model,
    names: Sequence[str],
    time: np.ndarray,
    rows: np.ndarray,
    status: str,
    message: str,
    counters: Mapping[str, Any],
    *,
    method: str,
    step: float,
    path: str,
    p: np.ndarray,
) -> Result:
    """Cut the recorded rows (n, n_y) into signals and note what was run."""
    signals: dict[str, np.ndarray] = {}
    at = 0
    for name in names:
        shape = model.shape_of(name)
        size = int(np.prod(shape, dtype=int))
        signals[name] = rows[:, at : at + size].reshape(len(rows), *shape)
        at += size
    residual = float(np.abs(rows[:, at:]).max()) if rows.shape[1] > at and len(rows) else 0.0
    counters = dict(counters)
    if rows.shape[1] > at:
        counters["loop_residual"] = residual
        if residual > 1e-9 and status == "finished":
            message = f"an algebraic loop did not converge: largest residual {residual:.2g}"
            status = "diverged"
    diagram = model.diagram
    changed = {}
    if not np.array_equal(p, model.p0):
        changed = {
            name: p[part].tolist() if part.stop - part.start > 1 else float(p[part.start])
            for name, part in model.parameters.items()
            if not np.array_equal(p[part], model.p0[part])
        }
    from rotorsim import __version__

    provenance = {
        "rotorsim": __version__,
        "diagram": diagram.name,
        "file": diagram.file,
        "document_sha256": diagram.sha256,
        "parameters_changed": changed,
        "method": method,
        "step": step,
        "path": path,
    }
    units = {name: model.select(name)[0].unit or "" for name in names}
    return Result(time, signals, units, status, message, counters, provenance)
