"""Order vectors over the speed beside the order-tracked simulation of the run-up or coast-down.

The diagram is simulated along the angle that the speeds of a table give, and order k of a row is extracted as a
monitoring system does, 2 mean(x exp(-i k theta)) over the turns of the row. Nothing is taken to be settled: a rotor
that passes a critical speed rings on, and that beats with what follows the shaft. Before its first row a run turns on
backwards with the acceleration that it has there, until what was before is forgotten.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log, pi

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.identification.waveform.driven.equations import DrivenEquations, driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.evaluation import Evaluation, Label
from rotorsim.identification.waveform.recorded.data import RATE_PREFIX, STABLE_STEP, SampledRun, signal_name
from rotorsim.identification.waveform.recorded.reading import settings_of
from rotorsim.identification.waveform.search import SIMULATION_SUBSTEPS, OutputErrorSearch
from rotorsim.linear.linearisation import entry_names
from rotorsim.model.compiled import compile_diagram
from rotorsim.recordings.orders import OrderChannel, OrderRecording, OrderRun
from rotorsim.recordings.recording import ANGLE
from rotorsim.signals.orders.rows import DIFFERENCES, row_floor, row_noise, row_times

SAMPLES_OF_PERIOD = 32  # a period of the highest order: Simpson's rule and a Runge-Kutta step are good to 1e-5 there
FORGOTTEN = 1e-4  # of what was before the first row, when it begins
MOST_LEAD = 400.0  # turns before the first row
LEAD_SPEEDS = (0.5, 2.0)  # of the first row's, between which the speed stays before it
SLOPE_ROWS = 10  # from which the acceleration at the first row is taken
SPEED, ACCELERATION = RATE_PREFIX + ANGLE, RATE_PREFIX + RATE_PREFIX + ANGLE


@dataclass(frozen=True, eq=False)
class OrderTrack:
    """One run on samples that are even in angle: run has the angle, first (n,) is the first sample of each row.

    length: samples of a row less one. vectors: measured, (n, c) complex.
    """

    run: SampledRun
    source: OrderRun
    first: np.ndarray
    length: int
    vectors: np.ndarray

    def extracted(self, y: np.ndarray, columns: Sequence[int], orders: Sequence[int]) -> np.ndarray:
        """Return 2 mean(y_j exp(-i k theta)) over the turns of each row, by Simpson's rule; y (N, s, ...)."""
        rows = self.first[:, None] + np.arange(self.length + 1)
        weights = np.ones(self.length + 1)
        weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
        theta = self.run.values[ANGLE]
        found = []
        for j, order in zip(columns, orders, strict=True):
            factors = 2 * weights / weights.sum() * np.exp(-1j * order * theta[rows])
            found.append(np.einsum("nl,nl...->n...", factors, y[rows, j]))
        return np.stack(found, axis=1)


@dataclass(frozen=True, eq=False)
class TrackedOrders:
    """Order vectors of some runs beside a diagram: channels, equations with their outputs, and each channel's place."""

    channels: tuple[OrderChannel, ...]
    simulation: Simulation
    places: tuple[int, ...]
    tracks: tuple[OrderTrack, ...]
    slow_roll: bool

    @property
    def orders(self) -> tuple[int, ...]:
        """The order of each channel."""
        return tuple(channel.order for channel in self.channels)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """What each channel measures."""
        return tuple(channel.label for channel in self.channels)


@dataclass(frozen=True, eq=False)
class OrderSearch(OutputErrorSearch):
    """A search on order vectors: residuals (n, 2 c), real and imaginary parts of each channel in turn.

    Unknowns: the m free parameters, then, where slow roll is included, two constants of each channel, the same in all
    runs. There are no unknown states: what was before a run is forgotten.
    """

    tracked: TrackedOrders | None = None

    @property
    def _tracked(self) -> TrackedOrders:
        assert self.tracked is not None
        return self.tracked

    @cached_property
    def measured(self) -> list[list[np.ndarray]]:
        """The measured vectors of each run, (n, 2 c) real."""
        return [[_parts(track.vectors) for track in self._tracked.tracks]]

    @property
    def constants(self) -> int:
        """The number of constants of slow roll."""
        return 2 * len(self._tracked.channels) if self._tracked.slow_roll else 0

    @cached_property
    def bounds(self) -> np.ndarray:
        """The lower and upper bounds of the unknowns, (2, q)."""
        bounds = np.repeat([[-np.inf], [np.inf]], self.m + self.constants, axis=1)
        bounds[:, : len(self.free)] = np.array([(item.low, item.high) for item in self.free]).reshape(-1, 2).T
        return bounds

    def columns(self, k: int, r: int) -> np.ndarray:
        """Return which unknowns a run depends on: all."""
        return np.arange(self.m + self.constants)

    def root(self, k: int, r: int) -> np.ndarray:
        """Return the square roots of the weights, (n, 2 c)."""
        weights = np.repeat([self.weights["", label] for label in self._tracked.labels], 2)
        return np.where(np.isfinite(self.measured[k][r]), np.sqrt(weights), 0.0)

    @cached_property
    def labels(self) -> list[Label]:
        """Return no states."""
        return []

    def first(self, known: object = None) -> np.ndarray:
        """Return the unknowns that the diagram states."""
        return np.array([*(item.value for item in self.free), *([0.0] * self.constants)])

    def substeps(self, unknowns: np.ndarray) -> int:
        """Return as many steps between samples as the fastest mode needs to be stable, SIMULATION_SUBSTEPS at most."""
        return min(self.needed(unknowns), SIMULATION_SUBSTEPS)

    def needed(self, unknowns: np.ndarray) -> int:
        """Return as many steps between samples as the fastest mode needs to be stable."""
        system, fastest = self.systems[0], 0.0
        for run, p in zip(self.runs, self.p, strict=True):
            A = _system_matrix(system.equations, run, system.equations.parameters(p, unknowns[: self.m]))
            if A.size and np.isfinite(A).all():
                fastest = max(fastest, float(np.abs(np.linalg.eigvals(A)).max()) * float(np.diff(run.time).max()))
        return max(self.least, int(np.ceil(fastest / STABLE_STEP)))

    def simulated(
        self, unknowns: np.ndarray, k: int, r: int, sub: int, sensitivities: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the order vectors of a run (n, 2 c), and their derivatives by the unknowns."""
        system, run, tracked = self.systems[k], self.runs[r], self._tracked
        eq, track = system.equations, tracked.tracks[r]
        p, v = eq.parameters(self.p[r], unknowns[: self.m]), run.inputs(eq.inputs, sub)
        x0 = eq.model.x0(self.p[r])[eq.kept]
        steps = np.diff(run.time)
        y, dy = system.simulate(p, x0, v, steps, t0=run.start, sensitivities=sensitivities)
        vectors = _parts(track.extracted(y, tracked.places, tracked.orders))
        size = self.m + self.constants if sensitivities else 0
        derivatives = np.zeros((*vectors.shape, size))
        if sensitivities:
            by_theta = track.extracted(dy, tracked.places, tracked.orders)
            for j in range(self.m):
                derivatives[:, :, j] = _parts(by_theta[:, :, j])
            derivatives[:, :, self.m :] = np.eye(vectors.shape[1], self.constants)
        return vectors + (unknowns[self.m :] if self.constants else 0.0), derivatives


def clock_of(diagram: Diagram) -> str:
    """Return the name of the only clock of a diagram. Raises RotorsimError where there is not one."""
    clocks = [name for name, node in diagram.nodes.items() if node.block.category == "clock"]
    if len(clocks) != 1:
        what = f"has {len(clocks) or 'no'} clock{'s' * (len(clocks) != 1)}: which one turns as recorded is not known"
        raise RotorsimError(Problem(what, diagram.name, hint="one block 'clock' gives the angle of the shaft"))
    return clocks[0]


def order_equations(diagram: Diagram, outputs: Sequence[str], free: Sequence[Free]) -> DrivenEquations:
    """Return the equations of a diagram whose clock gives what the angle of a run tells; outputs: flat names.

    Raises RotorsimError for a diagram without one clock, and as `driven_equations` does.
    """
    ports = {"theta": ANGLE, "speed": SPEED, "acceleration": ACCELERATION}
    cut = {f"{clock_of(diagram)}.{port}": [name] for port, name in ports.items()}
    return driven_equations(diagram, outputs, [*ports.values()], free, cut=cut)


def largest_of(tracked: TrackedOrders, diagram: Diagram) -> dict[str, float]:
    """Return the largest magnitude of every output of a diagram in the rows of its runs, as it is, by flat name."""
    model = tracked.simulation.equations.model
    ports = [f"{name}.{port}" for name, node in diagram.nodes.items() for port in node.outputs]
    names = [name for port in ports if port in model.signals for name in entry_names(port, model.signals[port].shape)]
    simulation = Simulation(order_equations(diagram, names, ()), by_start=False, sensitive=False)
    search, largest = order_search(tracked, {("", label): 1.0 for label in tracked.labels}), np.zeros(len(names))
    eq, sub = simulation.equations, search.substeps(search.first())
    for track, given in zip(tracked.tracks, search.p, strict=True):
        p, run = eq.parameters(given, np.zeros(0)), track.run
        v, x0 = run.inputs(eq.inputs, sub), eq.model.x0(given)[eq.kept]
        y, _ = simulation.simulate(p, x0, v, np.diff(run.time), t0=run.start, sensitivities=False)
        largest = np.maximum(largest, np.abs(y[track.first[0] :]).max(axis=0))
    return {name: float(size) for name, size in zip(names, largest, strict=True) if np.isfinite(size)}


def tracked_orders(
    diagram: Diagram, recording: OrderRecording, runs: Sequence[OrderRun], free: Sequence[Free]
) -> TrackedOrders:
    """Return order vectors of runs beside a diagram.

    Raises RotorsimError for channels that the diagram does not have, and a diagram without one clock.
    """
    model = compile_diagram(diagram)
    problems: list[Problem] = []
    try:
        clock_of(diagram)
    except RotorsimError as error:
        problems += error.problems
    names: list[str] = []
    for column, channel in recording.channels.items():
        try:
            names.append(signal_name(model, channel))
        except RotorsimError as error:
            problem = error.problems[0]
            hint = problem.hint or near_miss(channel.signal, model.signals)
            problems.append(Problem(problem.what, f"channel {column}", channel.place, hint))
    if problems:
        raise RotorsimError(*problems)
    outputs = tuple(dict.fromkeys(names))
    equations = order_equations(diagram, outputs, free)
    simulation = Simulation(equations, by_start=False)
    channels = tuple(recording.channels.values())
    samples = SAMPLES_OF_PERIOD * max(channel.order for channel in channels)
    keys, tracks = [*recording.channels], []
    for run in runs:
        settings, wrong = settings_of(diagram, run)
        problems += wrong
        if not wrong:
            tracks.append(_track(equations, replace(run, settings=settings), keys, samples))
    if problems:
        raise RotorsimError(*problems)
    return TrackedOrders(
        channels, simulation, tuple(outputs.index(n) for n in names), tuple(tracks), recording.slow_roll
    )


def order_search(
    tracked: TrackedOrders, variance: dict[tuple[str, str], float], tracks: Sequence[OrderTrack] | None = None
) -> OrderSearch:
    """Return the search on some tracks (default: all), weighed by the noise of each channel's real parts."""
    some = tracked if tracks is None else replace(tracked, tracks=tuple(tracks))
    weights = {signal: 1 / value for signal, value in variance.items()}
    return OrderSearch((some.simulation,), [track.run for track in some.tracks], weights, tracked=some)


def order_noise(
    tracked: TrackedOrders, least: float, simulated: Sequence[np.ndarray] | None = None
) -> dict[tuple[str, str], float]:
    """Return the variance of the real parts of each channel, as differences of the sixth order between rows show it.

    simulated: vectors of each run (n, c), taken away before: a resonance is sharp where rows are far apart. least: of
    the rms of what varies. Raises RotorsimError where no channel has as many rows without a gap.
    """
    variance: dict[tuple[str, str], float] = {}
    for c, label in enumerate(tracked.labels):
        known = [0.0 if simulated is None else simulated[r][:, c] for r in range(len(tracked.tracks))]
        left = [track.vectors[:, c] - own for track, own in zip(tracked.tracks, known, strict=True)]
        found = row_noise(left)
        if found is None:
            what = f"no {DIFFERENCES + 1} rows without a gap: its noise is not known"
            raise RotorsimError(Problem(what, label))
        whole = [track.vectors[:, c] for track in tracked.tracks]
        variance["", label] = max(found, row_floor(whole, least))
    return variance


def vectors_of(search: OrderSearch, evaluation: Evaluation) -> list[np.ndarray]:
    """Return the simulated order vectors of each run, (n, c) complex, slow roll included."""
    found = []
    for r in range(len(search.runs)):
        y, _ = search.simulated(evaluation.unknowns, 0, r, evaluation.sub, sensitivities=False)
        found.append(y[:, ::2] + 1j * y[:, 1::2])
    return found


def _parts(vectors: np.ndarray) -> np.ndarray:
    """Return real and imaginary parts (n, 2 c) of complex (n, c)."""
    return np.stack([vectors.real, vectors.imag], axis=2).reshape(len(vectors), -1)


def _system_matrix(eq: DrivenEquations, run: SampledRun, p: np.ndarray) -> np.ndarray:
    """Return df/dx at rest, at the highest speed of a run."""
    v = run.inputs(eq.inputs, 1)[int(np.argmin(np.diff(run.time))), 0]
    return np.asarray(eq.matrices[0](run.start, np.zeros(eq.n), v, p)[0])


def _track(eq: DrivenEquations, run: OrderRun, keys: Sequence[str], samples: int) -> OrderTrack:
    """Return a run on samples that are even in angle, as many a turn."""
    turn, rows = 2 * pi, row_times(run)
    speed, angle, begin, end, middles, starts = rows.speed, rows.angle, rows.begin, rows.end, rows.middles, rows.starts
    lead_time, lead_speed = _lead_in(eq, run, middles - begin)
    fine = np.linspace(begin, end, int((angle(end) - angle(begin)) / turn * samples) + 2)
    before = -float(cumulative_trapezoid(lead_speed, lead_time)[-1])
    lead_turns = int(-before / turn)
    lead_angle = cumulative_trapezoid(lead_speed, lead_time, initial=0.0) + before
    times = np.concatenate([begin + lead_time[:-1], fine])
    angles = np.concatenate([lead_angle[:-1], angle(fine) - angle(begin)])
    first = lead_turns * samples + np.rint(starts / turn * samples).astype(int)
    length = samples * run.turns
    grid = np.arange(first[-1] + length + 1) * turn / samples - lead_turns * turn
    time = CubicSpline(angles, times)(grid)
    rate = np.interp(time, [*(begin + lead_time[:-1]), *fine], [*lead_speed[:-1], *speed(fine)])
    sampled = SampledRun(run.id, {ANGLE: grid, SPEED: rate}, {}, time, run.settings)
    vectors = np.stack([run.vectors[key] for key in keys], axis=1)
    return OrderTrack(sampled, run, first, length, vectors)


def _lead_in(eq: DrivenEquations, run: OrderRun, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times (k,) up to zero, where the first row begins, and speeds: until what was before is forgotten.

    middles: of the rows, from there.
    """
    rows = slice(0, SLOPE_ROWS)
    slope, speed = (float(part) for part in np.polyfit(middles[rows], run.speed[rows], 1))
    theta = np.array([item.value for item in eq.free])
    p = eq.parameters(eq.model.parameter_vector(dict(run.settings)), theta)
    v = np.array([0.0, speed, 0.0])
    A = np.asarray(eq.matrices[0](0.0, np.zeros(eq.n), v, p)[0])
    decay = -float(np.linalg.eigvals(A).real.max()) if A.size and np.isfinite(A).all() else 0.0
    longest = MOST_LEAD * 2 * pi / speed
    lead = min(log(1 / FORGOTTEN) / decay, longest) if decay > 0 else longest
    time = np.linspace(-lead, 0.0, max(int(lead * speed / (2 * pi) * SAMPLES_OF_PERIOD), 2) + 1)
    return time, np.clip(speed + slope * time, LEAD_SPEEDS[0] * speed, LEAD_SPEEDS[1] * speed)
