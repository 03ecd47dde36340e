"""What was measured, in the diagram's own terms: which entries of which ports, at which parameters, in each run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.identification.harmonic.whitening import harmonics_of_time
from rotorsim.linear import linearisation as linear
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.recordings.recording import ANGLE, TACHO, Channel, Recording, Run
from rotorsim.settled.equations import Equations, is_linear, slots_of
from rotorsim.settled.motion import LinearMotion, SettledMotion
from rotorsim.settled.nonlinear import NonlinearMotion
from rotorsim.settled.torus import Torus
from rotorsim.signals.converters import before_converters
from rotorsim.signals.harmonic_fit import HarmonicFit
from rotorsim.signals.harmonics import RunHarmonics, harmonics_of
from rotorsim.units import compatible

SPEED_MISMATCH = 0.02  # stated against measured
FORCING_INSTANTS = (0.137, 1.137, 0.618, 1.618)  # instants, in turns, at which forcing is compared one turn apart


@dataclass(frozen=True, eq=False)
class Experiment:
    """Measured harmonics of R runs beside the model that is to explain them.

    free: the m free parameters that the measured signals can depend on. predicted: flat names of measured outputs
    of the model; given: flat names of measured signals that the model takes as inputs (the loop is opened there).
    order_of: columns of each fit in the order [predicted, given]. p (R, n_p); motion: the settled motion of
    the runs. use_mean (c + V,): False where the mean of a channel means nothing.
    """

    diagram: Diagram
    recording: Recording
    model: Model
    free: tuple[Free, ...]
    predicted: tuple[str, ...]
    given: tuple[str, ...]
    runs: tuple[RunHarmonics, ...]
    columns: np.ndarray
    p: np.ndarray
    motion: SettledMotion
    use_mean: np.ndarray

    @property
    def beside_orders(self) -> np.ndarray:
        """Orders (L,) of the lines beside the harmonics that all runs were fitted with; empty where there are none."""
        first = self.runs[0].fit.beside
        return np.zeros(0, int) if first is None else first.orders

    @property
    def fits(self) -> list[HarmonicFit]:
        """The harmonics of each run."""
        return [item.fit for item in self.runs]

    @property
    def linear(self) -> LinearMotion:
        """The motion, for what only a linear diagram allows. Raises RotorsimError for others."""
        linear = self.motion.linear()
        if linear is not None:
            return linear
        hint = "--method likelihood takes nonlinear diagrams"
        raise RotorsimError(Problem("the diagram is not linear in its states", self.diagram.name, hint=hint))

    @property
    def theta0(self) -> np.ndarray:
        """The free parameters as the diagram has them, (m,)."""
        return np.array([item.value for item in self.free])

    def measured(self, K: int) -> np.ndarray:
        """Return the measured harmonics of time 0..K of [predicted, given], (R, K+1, c + V)."""
        return measured_harmonics(self.runs, self.columns, K)

    def again(self, runs: Sequence[RunHarmonics] | None = None, p: np.ndarray | None = None) -> Experiment:
        """Return the experiment with other harmonics of the same runs, or other known parameters p (R, n_p)."""
        p = self.p if p is None else p
        old = self.motion
        motion = old if p is self.p else old.at(p)
        return replace(self, runs=self.runs if runs is None else tuple(runs), p=p, motion=motion)


def measured_harmonics(runs: Sequence[RunHarmonics], columns: np.ndarray, K: int) -> np.ndarray:
    """Return the measured harmonics of time 0..K in some columns (R, c) of the fits, (R, K+1, c)."""
    pairs = zip(runs, columns, strict=True)
    return np.array([harmonics_of_time(run.fit.values[: K + 1, own], run.fit.speed) for run, own in pairs])


def open_experiment(
    diagram: Diagram,
    recording: Recording,
    *,
    runs: Sequence[Run] | None = None,
    given: Sequence[str] = (),
    inject: Sequence[str] = (),
    free: Sequence[Free] | None = None,
    harmonics: Sequence[RunHarmonics] | None = None,
    drop: Sequence[str] = (),
) -> Experiment:
    """Return the measured harmonics of runs (default: those to identify from) beside the model of the diagram.

    given: output ports ("controller.current") that are taken as they were measured, with their noise: what makes
    them is cut off and need not be right. inject: additive inputs that take an external force. free: default what
    the diagram's ``identify`` says. drop: flat names of measured entries that are left out.
    Raises RotorsimError with all that does not fit: channels that the diagram does not have, settings, speeds.
    """
    chosen = tuple(recording.select("identify") if runs is None else runs)
    problems: list[Problem] = []
    if not chosen:
        hint = '"use": "identify" marks the runs that parameters are taken from'
        raise RotorsimError(Problem("no run to identify from", recording.name, hint=hint))
    wanted = diagram.free if free is None else tuple(free)
    if not wanted:
        hint = 'add "identify": {"viscous_damping": {}, ...} to the diagram'
        raise RotorsimError(Problem("no free parameters", diagram.name, Place(diagram.file), hint))
    if "speed" not in diagram.parameters:
        hint = 'add "parameters": {"speed": "1500 rpm"} and let the clock follow it: {"speed": "$speed"}'
        raise RotorsimError(Problem("no diagram parameter 'speed'", diagram.name, Place(diagram.file), hint))
    model = compile_diagram(diagram, inject=inject, replace=given)
    names = _names(model, recording, problems)
    taken = [name for name in names if name.partition("[")[0] in given]
    for port in given:
        missing = [name for name in linear.flat_names(model, port) if name not in taken]
        if missing:
            problems.append(Problem(f"not all of it was measured: {', '.join(missing)} is missing", port))
    still = _still(model, names, recording, chosen)
    predicted = [name for name in names if name not in taken and name not in drop and name not in still]
    if problems:
        raise RotorsimError(*problems)
    if not predicted:
        raise RotorsimError(Problem("nothing was measured that the diagram could be compared with", recording.name))
    found = tuple(harmonics_of(recording, chosen) if harmonics is None else harmonics)
    _refuse_missing(found, [*predicted, *taken])
    _refuse_unknown_phase(found)
    kept = _free(model, diagram, wanted)
    p = _parameters(model, diagram, found, kept)
    linear_model = bool(taken) or is_linear(model, predicted)  # `LinearMotion` says what is wrong with the others
    K = min(int(item.fit.orders[-1]) for item in found)
    windows = np.array([float(item.run.time[-1] - item.run.time[0]) for item in found])
    speeds = np.array([item.fit.speed for item in found])
    phase = _clock_phase(model, p)
    forced = _is_aperiodic(model, p, speeds)
    besides = [item.fit.beside for item in found]
    if forced is not None and not (linear_model and all(beside is not None for beside in besides)):
        what = "the forcing is not the same one turn later: it does not follow the shaft"
        raise RotorsimError(Problem(what, forced, hint="what is compared are harmonics of the shaft angle"))
    torus = None
    if linear_model and besides[0] is not None:
        second = np.array([beside.second for beside in besides if beside is not None])
        torus = Torus(speeds, K, second, besides[0].orders, forced is not None)
    channels = {channel.name: channel for channel in recording.channels.values()}
    order = [*predicted, *taken]
    columns = np.array([[item.fit.names.index(name) for name in order] for item in found])
    use_mean = np.array([channels[name].coupling == "dc" for name in order])
    equations = Equations(model, predicted, kept, p, linear=linear_model and not taken)
    motion: SettledMotion
    if linear_model:
        motion = LinearMotion(equations, p, speeds, K, windows, phase, torus)
    else:
        measured = measured_harmonics(found, columns[:, : len(predicted)], K)
        motion = NonlinearMotion(equations, p, speeds, K, windows, phase, torus, measured=measured)
    return Experiment(
        diagram, recording, model, kept, tuple(predicted), tuple(taken), found, columns, p, motion, use_mean
    )


def _names(model: Model, recording: Recording, problems: list[Problem]) -> list[str]:
    """Return the flat names of the channels that the model has; add what it does not have to the problems."""
    found: list[str] = []
    for column, channel in recording.channels.items():
        if channel.signal in (ANGLE, TACHO):
            continue
        subject, place = f"channel {column}", channel.place
        if channel.signal not in model.signals:
            hint = near_miss(channel.signal, model.signals)
            problems.append(Problem(f"the diagram has no signal '{channel.signal}'", subject, place, hint))
            continue
        name = channel.name
        unit = model.signals[channel.signal].unit
        if unit is not None and compatible(channel.unit, unit) not in ("same", "scaled"):
            what = f"unit '{channel.unit}' does not fit '{channel.signal}', which is in {unit}"
            problems.append(Problem(what, subject, place, "correct the unit, or the signal, in recording.json"))
            continue
        shape = model.signals[channel.signal].shape
        if shape and not _is_entry(channel, shape):
            size = " x ".join(map(str, shape))
            hint = "say node and axis" if len(shape) == 2 else "say axis"
            what = f"'{name}' is not one entry of '{channel.signal}', which is {size}"
            problems.append(Problem(what, subject, place, hint))
        elif name in found:
            problems.append(Problem(f"'{name}' is measured by two channels", subject, place, "leave one of them out"))
        else:
            found.append(name)
    return found


def _still(model: Model, names: Sequence[str], recording: Recording, runs: Sequence[Run]) -> list[str]:
    """Return the entries that cannot move (a pinned node) and were measured as zero: they say nothing."""
    columns = {channel.name: column for column, channel in recording.channels.items()}
    fixed = [name for name in names if not linear.can_move(model, model.diagram.as_measured(name))]
    zero = np.zeros(1)
    return [name for name in fixed if not any(run.values.get(columns[name], zero).any() for run in runs)]


RATE_PORTS = (".velocity", ".acceleration")  # recorded signals that are rates of a block's displacement


def check_against(diagram: Diagram, recording: Recording) -> list[Problem]:
    """Return what a recording says that the diagram does not have: signals, units, entries, parameters that are set.

    Velocities and accelerations are taken where the diagram has the displacement, as `diagnose` does.
    """
    problems: list[Problem] = []
    model = compile_diagram(before_converters(diagram))
    compared = {
        column: channel
        for column, channel in recording.channels.items()
        if not (
            channel.signal.endswith(RATE_PORTS) and channel.signal.rpartition(".")[0] + ".displacement" in model.signals
        )
    }
    _names(model, replace(recording, channels=compared), problems)
    for run in recording.runs:
        for name, value in run.settings.items():
            subject = f"run {run.id}: set {name}"
            try:
                model.parameter_vector({name: numeric(value, diagram.unit_of_parameter(name))})
            except ValueProblem as problem:
                problems.append(Problem(problem.what, subject, run.place, problem.hint))
            except RotorsimError as error:
                problems += [Problem(p.what, subject, run.place, p.hint) for p in error.problems]
    return problems


def _is_entry(channel: Channel, shape: tuple[int, ...]) -> bool:
    if channel.position is not None and channel.node is None:
        return False
    index = [channel.node] if channel.node is not None else []
    index += [1 if channel.axis == "x" else 2] if channel.axis is not None else []
    return len(index) == len(shape) and all(1 <= k <= n for k, n in zip(index, shape, strict=True))


def _refuse_missing(runs: Sequence[RunHarmonics], names: Sequence[str]) -> None:
    """Refuse runs in which a channel was not measured."""
    missing = [(item.run, name) for item in runs for name in names if name not in item.fit.names]
    hint = "compared at harmonics of the shaft, runs have the same channels: leave the channel out, or the run"
    if missing:
        what = "was not measured in this run"
        raise RotorsimError(*(Problem(f"'{name}' {what}", f"run {run.id}", run.place, hint) for run, name in missing))


def _refuse_unknown_phase(runs: Sequence[RunHarmonics]) -> None:
    problems = [
        Problem(
            "no phase reference: nothing says where shaft angle zero is",
            f"run {item.run.id}",
            item.run.place,
            'add "tacho": [times of a once-per-turn pulse] or a channel "clock.theta"; or leave the run out',
        )
        for item in runs
        if not item.angle.phase_known
    ]
    if problems:
        raise RotorsimError(*problems)


def _free(model: Model, diagram: Diagram, wanted: Sequence[Free]) -> tuple[Free, ...]:
    """Return the free parameters that a block follows."""
    entries = linear.speed_entries(model)
    speed = set() if entries is None else set(np.flatnonzero(entries).tolist())
    problems = [
        Problem("is measured, so that it cannot be free", f"identify.{item.name}", Place(diagram.file))
        for item in wanted
        if item.name == "speed" or speed & set(slots_of(model, item))
    ]
    kept = tuple(item for item in wanted if slots_of(model, item))
    if not kept:
        names = ", ".join(item.name for item in wanted)
        problems.append(Problem(f"no block follows what is free: {names}", "identify", Place(diagram.file)))
    if problems:
        raise RotorsimError(*problems)
    return kept


def _parameters(model: Model, diagram: Diagram, runs: Sequence[RunHarmonics], free: Sequence[Free]) -> np.ndarray:
    """Return p of every run, (R, n_p): its settings and its measured speed."""
    problems: list[Problem] = []
    rows = []
    bases = {item.base for item in free}
    for item in runs:
        overrides: dict[str, Any] = {}
        for name, value in item.run.settings.items():
            if name in bases:
                hint = "a parameter is either set or free: remove it from one of them"
                what = f"set {name}: it is to be identified"
                problems.append(Problem(what, f"run {item.run.id}", item.run.place, hint))
                continue
            try:
                overrides[name] = numeric(value, diagram.unit_of_parameter(name))
            except ValueProblem as problem:
                problems.append(Problem(problem.what, f"run {item.run.id}: set {name}", item.run.place, problem.hint))
        stated = overrides.pop("speed", None)
        if stated is not None and abs(float(stated) / item.fit.speed - 1) > SPEED_MISMATCH:
            said, seen = (f"{abs(speed) * 30 / np.pi:.6g} rpm" for speed in (float(stated), item.fit.speed))
            what = f"set speed: {said}, but the shaft angle says {seen}"
            problems.append(Problem(what, f"run {item.run.id}", item.run.place))
        overrides["speed"] = item.fit.speed
        try:
            rows.append(model.parameter_vector(overrides))
        except RotorsimError as error:
            problems += [
                Problem(p.what, f"run {item.run.id}: set {p.subject}", item.run.place, p.hint) for p in error.problems
            ]
    if problems:
        raise RotorsimError(*problems)
    return np.array(rows)


def _is_aperiodic(model: Model, p: np.ndarray, speeds: np.ndarray) -> str | None:
    """Return a block whose forcing is not the same one turn later, None where all of it follows the shaft."""
    period = 2 * np.pi / np.abs(speeds[0])
    x, z = np.zeros(model.n_x), model.z0(p[0])
    rates = [np.array(model.rhs(at * period, x, z, p[0])).ravel() for at in FORCING_INSTANTS]
    for first, second in (rates[:2], rates[2:]):
        size = np.maximum(np.abs(first), np.abs(second))
        changed = np.flatnonzero(np.abs(second - first) > 1e-6 * np.maximum(size, 1e-9 * size.max(initial=0.0)))
        if len(changed):
            return model.block_of_state(int(changed[0]))
    return None


def _clock_phase(model: Model, p: np.ndarray) -> np.ndarray:
    """Return the shaft angle at t = 0 in every run, (R,) [rad]. Raises RotorsimError for a speed that changes."""
    angles = [name for name in model.signals if name.endswith(".theta")]
    if not angles:
        return np.zeros(len(p))
    name = "clock.theta" if "clock.theta" in angles else angles[0]
    x, z = model.x0(model.p0), model.z0(model.p0)
    output = model.output((name,))
    at = [np.array([float(np.array(output(t, x, z, row))[0, 0]) for row in p]) for t in (0.0, 0.5, 1.0)]
    if not np.allclose(at[2] - at[1], at[1] - at[0], rtol=1e-9, atol=1e-9):
        hint = "identification needs a constant speed in each run: profile 'constant', acceleration 0"
        raise RotorsimError(Problem("the shaft speed changes", name.rpartition(".")[0], hint=hint))
    return at[0]
