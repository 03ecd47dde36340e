"""Runs as samples in time: what drives the diagram, what it is to predict, and values between samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from math import tau
from typing import Any

import numpy as np
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline
from scipy.signal import resample

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.identification.waveform.driven.equations import clock_ports, driven_parameters, measured_expression
from rotorsim.identification.waveform.recorded.gaps import EVEN_SAMPLES
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.pickup import LINE_PERIODS
from rotorsim.units import compatible

RATE_PREFIX = "rate of "
STABLE_STEP = 2.0  # largest |eigenvalue| times step: the limits of RK4 are 2.79 and 2.83 on the axes
PIECEWISE_LINEAR = ("hold", "linear")  # of inputs, between samples
SMOOTH_KIND = "smooth"  # kind of an input that goes between samples on a cubic spline
BLOCK_ROWS = 1024  # of large arrays, changed at a time
SENSOR_DISTANCE = 1e-3  # m, between a sensor and the node that stands for it


@dataclass(frozen=True)
class Channels:
    """Recorded signals by flat name: inputs drive the diagram, outputs are what it predicts.

    columns: name -> column of the data. kinds: of each input, how it goes on between samples. gappy: outputs of which
    samples are missing in some run. fastest: see `DrivenEquations`. floating: outputs whose mean means nothing.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    columns: Mapping[str, str]
    kinds: Mapping[str, str]
    gappy: frozenset[str] = frozenset()
    fastest: float | None = None
    floating: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class SampledRun:
    """Samples of one run: values {flat name: (N,)}, SI, at instants time (N,) [s]; NaN where an output is missing.

    notes: what of the recording is not used, or was filled in. Free in each output are lines, frequencies [Hz] of hum,
    and a drift that grows evenly from an instant drift_since [s] on; of floating outputs the mean is.
    """

    id: str
    values: Mapping[str, np.ndarray]
    kinds: Mapping[str, str]
    time: np.ndarray
    settings: Mapping[str, Any]
    notes: tuple[Problem, ...] = ()
    lines: tuple[float, ...] = ()
    drift_since: float | None = None
    floating: frozenset[str] = frozenset()
    _inputs: dict[tuple[tuple[str, ...], int], np.ndarray] = field(default_factory=dict, init=False, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without what can be computed again."""
        kept = (item.name for item in fields(self) if item.init)
        return SampledRun, tuple(getattr(self, name) for name in kept)

    def first(self, count: int) -> SampledRun:
        """Return the run up to a number of samples."""
        return self.part(slice(count))

    def part(self, part: slice) -> SampledRun:
        """Return a part of the run."""
        values = {name: array[part] for name, array in self.values.items()}
        return replace(self, values=values, time=self.time[part])

    @property
    def size(self) -> int:
        """The number of samples N."""
        return len(self.time)

    @property
    def start(self) -> float:
        """The time of the first sample [s]."""
        return float(self.time[0])

    @property
    def dt(self) -> float:
        """The sample period [s], the mean one where samples are not even."""
        return float(self.time[-1] - self.time[0]) / max(self.size - 1, 1)

    @cached_property
    def steps(self) -> np.ndarray | None:
        """The steps between samples (N - 1,) [s], None where they are even."""
        uneven = np.abs(self.time - self.start - self.dt * np.arange(self.size)).max()
        return np.diff(self.time) if uneven > EVEN_SAMPLES * self.dt else None

    @cached_property
    def counted(self) -> np.ndarray:
        """Whether any output was measured at a sample, (N,)."""
        outputs = [array for name, array in self.values.items() if name not in self.kinds]
        return np.asarray(np.isfinite(outputs).any(axis=0)) if outputs else np.zeros(self.size, bool)

    @cached_property
    def nuisances(self) -> np.ndarray | None:
        """Orthonormal signals that each output may have besides, (N, b); None without any that a run so short tells."""
        told = [line for line in self.lines if line * self.dt * self.size >= LINE_PERIODS]
        angle = tau * np.outer(self.time - self.start, told)
        drift = () if self.drift_since is None else (self.time[:, None] - self.drift_since,)
        basis = np.concatenate([*drift, np.cos(angle), np.sin(angle)], axis=1)
        return np.linalg.qr(basis)[0] if basis.shape[1] else None

    def beside_nuisances(self, y: np.ndarray, known: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Return signals (N, c, ...) of names less their nuisances, by least squares on known samples (N, c).

        Where all are, the signals themselves may be changed: they are large.
        """
        basis, floats = self.nuisances, np.array([name in self.floating for name in names])
        if basis is None and not floats.any():
            return y
        basis = np.zeros((self.size, 0)) if basis is None else basis
        flat = y.reshape(self.size, y.shape[1], -1)
        if known.all() and not floats.any():
            columns = flat.reshape(self.size, -1)
            parts = basis.T @ columns
            for a in range(0, self.size, BLOCK_ROWS):
                columns[a : a + BLOCK_ROWS] -= basis[a : a + BLOCK_ROWS] @ parts
            return columns.reshape(y.shape)
        out, with_mean = flat.copy(), np.column_stack([np.ones(self.size), basis])
        for c, there in enumerate(known.T):
            free = with_mean if floats[c] else basis
            out[:, c] -= free @ np.linalg.lstsq(free[there], flat[there, c], rcond=None)[0]
        return out.reshape(y.shape)

    def measured(self, names: Sequence[str]) -> np.ndarray:
        """Return samples of signals, (N, c)."""
        return np.stack([self.values[name] for name in names], axis=1)

    def is_piecewise_linear(self, names: Sequence[str]) -> bool:
        """Return whether signals are held or go straight between samples."""
        return all(self.kinds.get(name) in PIECEWISE_LINEAR for name in names)

    def inputs(self, names: tuple[str, ...], sub: int) -> np.ndarray:
        """Return signals at ends and middles of the ``sub`` steps after each sample, (N, 2 sub + 1, n_v).

        A name that begins with "rate of " stands for the time derivative of the rest; measured outputs and rates go
        between samples on a cubic spline, and so does what is band-limited where samples are not even.
        """
        if (names, sub) not in self._inputs:
            values = [self._input(name, 2 * sub) for name in names]
            self._inputs[names, sub] = np.array(values).reshape(-1, self.size, 2 * sub + 1).transpose(1, 2, 0).copy()
        return self._inputs[names, sub]

    def _input(self, name: str, parts: int) -> np.ndarray:
        kind = self.kinds.get(name, "")
        if kind in PIECEWISE_LINEAR or (kind not in ("", SMOOTH_KIND) and self.steps is None):
            return between_samples(self.values[name], kind, parts)
        spline = CubicSpline(self.time - self.start, self.values[name.removeprefix(RATE_PREFIX)])
        steps = np.append(np.diff(self.time), 0.0)
        at = (self.time - self.start)[:, None] + steps[:, None] * np.linspace(0.0, 1.0, parts + 1)
        return np.asarray(spline(at, int(name.startswith(RATE_PREFIX))))


def mean_of(y: np.ndarray) -> np.ndarray:
    """Return the means (c,) of outputs (N, c), zero of those that are missing."""
    there = np.isfinite(y)
    return np.asarray(np.nansum(y, axis=0) / np.maximum(there.sum(axis=0), 1))


def chosen_runs(recording: Recording) -> tuple[Run, ...]:
    """Return the runs to identify from. Raises RotorsimError where there are none."""
    chosen = recording.select("identify")
    if not chosen:
        hint = '"use": "identify" marks the runs that parameters are taken from'
        raise RotorsimError(Problem("no run to identify from", recording.name, hint=hint))
    return chosen


def between_samples(values: np.ndarray, kind: str, parts: int) -> np.ndarray:
    """Return a signal at ``parts`` equal parts after each sample and at the end, (N, parts + 1).

    kind: "hold", "linear" or "band_limited" (by Fourier transform of the signal followed by its mirror image).
    """
    n = len(values)
    if kind == "hold":
        return np.repeat(values[:, None], parts + 1, axis=1)
    if kind == "linear" or n < 4:
        later = np.append(values[1:], values[-1])
        return np.asarray(values[:, None] + (later - values)[:, None] * np.linspace(0.0, 1.0, parts + 1))
    size = 2 * next_fast_len(n - 1, real=True)
    fine = resample(np.concatenate([values, values[-2:0:-1], np.full(size - 2 * n + 2, values[0])]), parts * size)
    return np.lib.stride_tricks.sliding_window_view(fine[: parts * n + 1], parts + 1)[::parts].copy()


def channels_of(diagram: Diagram, recording: Recording) -> Channels:
    """Return what a recording gives to a diagram and what it measures of it. Raises RotorsimError with all mistakes."""
    model, driven, turning = compile_diagram(diagram), driven_parameters(diagram), clock_ports(diagram)
    problems: list[Problem] = []
    kinds: dict[str, str] = {}
    outputs: list[str] = []
    columns: dict[str, str] = {}
    for column, channel in recording.channels.items():
        try:
            name = signal_name(model, channel)
        except RotorsimError as error:
            problem = error.problems[0]
            hint = problem.hint or near_miss(channel.signal, model.signals)
            problems.append(Problem(problem.what, f"channel {column}", channel.place, hint))
            continue
        if name in columns:
            what, hint = f"'{name}' is measured by two channels", "leave one of them out"
            problems.append(Problem(what, f"channel {column}", channel.place, hint))
        elif channel.signal in turning:
            kinds[name] = SMOOTH_KIND
        elif channel.signal in driven:
            option = diagram.nodes[channel.signal.rpartition(".")[0]].block.option
            kinds[name] = str(getattr(option, "interpolation", "linear"))
        else:
            outputs.append(name)
        columns[name] = column
    if not outputs and not problems:
        what = "nothing was measured that the diagram could be compared with"
        hint = "a channel must name a signal that the diagram computes"
        problems.append(Problem(what, recording.name, hint=hint))
    if problems:
        raise RotorsimError(*problems)
    floating = frozenset(name for name in outputs if recording.channels[columns[name]].coupling == "ac")
    return Channels(tuple(kinds), tuple(outputs), columns, kinds, floating=floating)


def signal_name(model: Model, channel: Channel) -> str:
    """Return the flat name of a channel's signal. Raises RotorsimError where the diagram has no such number."""
    name = _node_name(model, channel)
    size = measured_expression(model, name).numel()
    if size != 1:
        raise RotorsimError(Problem(f"'{name}' is {size} numbers", hint="say node and axis"))
    unit = model.signals[channel.signal].unit if channel.signal in model.signals else None
    if unit is not None and compatible(channel.unit, unit) not in ("same", "scaled"):
        what = f"unit '{channel.unit}' does not fit '{channel.signal}', which is in {unit}"
        raise RotorsimError(Problem(what, hint="correct the unit, or the signal, in recording.json"))
    return name


def _node_name(model: Model, channel: Channel) -> str:
    """Return the flat name of a channel's signal, a place along the shaft replaced by the node there.

    Raises RotorsimError where the shaft has no node at this place.
    """
    if channel.position is None or channel.node is not None:
        return channel.name
    node = model.diagram.nodes.get(channel.signal.rpartition(".")[0])
    if node is None or "element_length" not in node.values:
        raise RotorsimError(Problem("a position along the shaft, but this block has no elements"))
    lengths = np.broadcast_to(np.ravel(node.values["element_length"]), int(node.block.option.elements))
    places = np.cumsum([0.0, *lengths])
    k = int(np.argmin(np.abs(places - channel.position)))
    if abs(places[k] - channel.position) > SENSOR_DISTANCE:
        nearest = f"the nearest is node {k + 1} at {places[k]:g} m"
        hint = f"{nearest}; divide the shaft so that a node is where it was measured"
        raise RotorsimError(Problem(f"no node at {channel.position:g} m", hint=hint))
    return channel.name.replace(f"{channel.position:g} m", str(k + 1))
