"""Motion of a machine with its faults, in all runs of a case at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.core import Core
from benchmarks.concealed.integrator import Forces, History, Nodes, Stepper
from benchmarks.concealed.machines import MACHINES
from benchmarks.concealed.plant import Gains, Plant

Array = NDArray[Any]

CHUNK = 1000
TURN = 128  # samples of one turn, for the harmonics of the forces
WINDOW, RIPPLE = 0.3, 15  # s at least, for the mean of slow modes; orders of their ripple
INSTANT = 1e-9  # s: rounding of times
SLOW = 2.0  # 1/s: what decays more slowly is not waited for
SIZES = {"z": 1.0, "p": 1.0, "v": 700.0, "w": 7e3, "i": 1.2e4, "c": 1.2e4, "a": 20.0}  # of outputs, against z
SETTLE = {
    "jeffcott": (0.60, 0.55, 0.35),
    "fe_rigid": (0.70, 0.60, 0.50),
    "fe_flexible": (1.00, 0.90, 0.80),  # a mode at 172 Hz decays with 7 / s
    "two_amb_rotor": (0.70, 0.60, 0.50),
}


@dataclass(frozen=True)
class Run:
    """One run: what is set, what is recorded."""

    speed: float  # rad/s, before the first sample
    start: float  # shaft angle at the first sample
    gains: tuple[Gains, ...]  # of each bearing
    label: str  # of the gains
    samples: int
    use: str
    acceleration: float = 0.0  # rad/s^2, from the first sample on
    ramp: float = np.inf  # s: how long; then the speed is held


@dataclass
class Clock:
    """Times [s] from the first sample, shaft angle, its rate and acceleration; arrays that broadcast to (L, ...)."""

    t: Array
    theta: Array
    rate: Array
    acceleration: Array
    speed: Array


@dataclass(frozen=True)
class Accuracy:
    """How finely motion is followed."""

    points: int  # nodes of a step
    samples: int  # of the record, in a step
    tolerance: float = 1.0  # share of the error that a force with corners may make


SMOOTH, ROUGH, SETTLING = Accuracy(12, 4), Accuracy(9, 1), 1e5


class Row(Protocol):
    """What a fault may do; see faults.py."""

    @property
    def physics(self) -> str: ...
    @property
    def alter(self) -> Callable[[Plant, float], None] | None: ...
    @property
    def force(self) -> Callable[[Clock, list[Plant]], dict[str, Array]] | None: ...
    @property
    def feedback(self) -> Callable[[Nodes, dict[str, Array]], dict[str, Array]] | None: ...
    @property
    def measure(self) -> Callable[[Clock, dict[str, Array]], None] | None: ...
    @property
    def wobble(self) -> Callable[[Array], tuple[Array, Array, Array]] | None: ...
    @property
    def twist(self) -> Callable[[Array], tuple[Array, Array, Array]] | None: ...
    @property
    def reads(self) -> tuple[str, ...]: ...
    @property
    def drives(self) -> tuple[str, ...]: ...
    @property
    def integrators(self) -> int: ...
    @property
    def synchronous(self) -> bool: ...
    @property
    def corner(self) -> float: ...
    @property
    def timed(self) -> bool: ...
    @property
    def late(self) -> float: ...


@dataclass
class Motion:
    """Signals at the samples, (L, N) complex: `p3` what the probe at node 3 shows, `current`, `current2`; the angle."""

    signals: dict[str, Array]
    clock: Clock
    angle: Callable[[Array], Array]  # t (L, 1, ...) -> shaft angle


def base_forces(plant: Plant, clock: Clock, twist: Any) -> dict[str, Array]:
    """Return the forces of crack and unbalances, thesis eq. (2.22) and (2.2).

    f_crack = 1/2 s(a) dk sag (1 + e^{2ia}),  a = theta + phase
    f_unbalance = m e (theta'^2 - i theta'') e^{i(theta + beta)}
    """
    theta, rate, acceleration = clock.theta, clock.rate, clock.acceleration
    if twist is not None:
        angle, its_rate, its_acceleration = twist(clock.t)
        theta, rate, acceleration = theta + angle, rate + its_rate, acceleration + its_acceleration
    crack, a = plant.crack, theta + plant.crack.phase
    forces = {f"f{crack.node}": 0.5 * crack.stiffness * crack.sag * crack.opening(a) * (1 + np.exp(2j * a))}
    for one in plant.unbalances:
        force = one.mass * one.eccentricity * (rate**2 - 1j * acceleration) * np.exp(1j * (theta + one.phase))
        place = f"f{one.node}"
        forces[place] = forces[place] + force if place in forces else force
    return forces


class Simulation:
    """A machine with parameters and faults, ready to run."""

    def __init__(
        self,
        machine: str,
        parameters: dict[str, float],
        runs: list[Run],
        rate: float,
        rows: Sequence[Row] = (),
        lifted: float = np.inf,
        accuracy: Accuracy | None = None,
    ) -> None:
        self.machine, self.runs, self.rows, self.lifted = machine, runs, rows, lifted
        rough = [row for row in rows if row.feedback]
        self.feedback = [row.feedback for row in rough if row.feedback]
        corner = min((row.corner for row in rough if row.corner), default=None)
        accuracy = accuracy or (ROUGH if corner else SMOOTH)
        self.sample, self.step, self.stride = 1.0 / rate, accuracy.samples / rate, accuracy.samples
        self.plants = [MACHINES[machine](parameters, run.gains) for run in runs]
        for plant, run in zip(self.plants, runs, strict=True):
            for row in rows:
                if row.alter:
                    row.alter(plant, run.speed)
        integrators = sum(row.integrators for row in rows)
        cores = [Core(plant, run.speed, integrators) for plant, run in zip(self.plants, runs, strict=True)]
        plant = self.plants[0]
        ramps = any(run.acceleration for run in runs)
        self.discs = [node for node, dof in plant.tilt.items() if ramps and plant.gyroscopic[dof, dof]]
        self.feedback += [self._gyroscopic] if self.discs else []
        marks = [bearing.mark for bearing in plant.bearings]
        unbalances = (f"f{unbalance.node}" for unbalance in plant.unbalances)
        moments, tilts = (tuple(f"{kind}{node}" for node in self.discs) for kind in "mw")
        driven = (f"f{plant.crack.node}", *unbalances, *(name for row in rows for name in row.drives), *moments)
        self.inputs = tuple(dict.fromkeys(driven))
        self.reads = tuple(dict.fromkeys((*(name for row in rough for name in row.reads), *tilts)))
        currents = (f"{name}{mark}" for mark in marks for name in ("i", "command"))
        self.recorded = tuple(dict.fromkeys([*(f"p{node}" for node in plant.probes), *currents, *self.reads]))
        self.speed = np.array([run.speed for run in runs])[:, None, None]
        self.start = np.array([run.start for run in runs])[:, None, None]
        self.twist = next((row.twist for row in rows if row.twist), None)
        vectors = [core.eigen() for core in cores]
        self.lam = np.array([lam for lam, _, _ in vectors])
        self.slow = (np.abs(self.lam) < SLOW) & (self.lam != 0)
        self.B = np.array([left @ core.inputs(self.inputs) for core, (_, _, left) in zip(cores, vectors, strict=True)])
        pairs = [(core, right) for core, (_, right, _) in zip(cores, vectors, strict=True)]
        self.C = _rows(pairs, self.recorded)
        seen = self.reads or ("i",)
        self.stepper = Stepper(
            self.lam,
            self.B,
            _rows(pairs, seen),
            self.step,
            self._forces() if self.feedback else None,
            np.array([SIZES[name[0]] for name in seen]),
            corner and corner * accuracy.tolerance,
            accuracy.points,
            accuracy.samples,
            any(row.timed for row in rough) or bool(self.discs),
            plant.anisotropic,
        )

    def _forces(self) -> Forces:
        """Return the sum of the feedbacks, as the stepper wants it."""
        where = {name: j for j, name in enumerate(self.inputs)}

        def forces(nodes: Nodes, y: Array) -> Array:
            motion = {name: y[:, j] for j, name in enumerate(self.reads)}
            if nodes.past is not None:
                motion |= {f"late {name}": nodes.past[:, j] for j, name in enumerate(self.reads)}
            out = np.zeros((len(y), len(where), y.shape[2]), complex)
            for law in self.feedback:
                for name, value in law(nodes, motion).items():
                    out[:, where[name]] += value
            return self._complete(out)

        return forces

    def _complete(self, inputs: Array) -> Array:
        """Return inputs (L, m, ...) and, of an anisotropic machine, behind them their conjugates."""
        return np.concatenate([inputs, inputs.conj()], axis=1) if self.plants[0].anisotropic else inputs

    def _gyroscopic(self, nodes: Nodes, motion: dict[str, Array]) -> dict[str, Array]:
        """Return the moments i (theta' - W) G tilt' of what a shaft turns faster than at W, for which the core is."""
        plant = self.plants[0]
        more = {node: plant.gyroscopic[plant.tilt[node], plant.tilt[node]] for node in self.discs}
        return {f"m{node}": 1j * (nodes.rate - nodes.speed) * G * motion[f"w{node}"] for node, G in more.items()}

    def clock(self, t: Array) -> Clock:
        """Return times t (1 or L, ...), at least three axes, with the shaft angle there.

        Ramps begin where the step does in which the first sample lies, so that no step has a corner.
        """
        a, ramp = (
            np.array([getattr(run, name) for run in self.runs])[:, None, None] for name in ("acceleration", "ramp")
        )
        since = np.maximum(t + self.sample, 0.0)
        on = np.minimum(since, ramp)
        theta = self.start + self.speed * t + a * on * (since - on / 2)
        rate = self.speed + a * on + np.zeros_like(theta)
        acceleration = a * ((since > INSTANT) & (since < ramp + INSTANT)) + np.zeros_like(theta)
        for row in self.rows:
            if row.wobble:
                more = row.wobble(t)
                theta, rate, acceleration = theta + more[0], rate + more[1], acceleration + more[2]
        return Clock(t, theta, rate, acceleration, self.speed)

    def known(self, clock: Clock, synchronous: bool = False) -> Array:
        """Return the inputs that do not depend on the motion, (L, m, ...), complete."""
        out = np.zeros((len(self.runs), len(self.inputs), *clock.theta.shape[1:]), complex)
        parts = [base_forces(self.plants[0], clock, None if synchronous else self.twist)]
        parts += [
            row.force(clock, self.plants) for row in self.rows if row.force and (row.synchronous or not synchronous)
        ]
        for part in parts:
            for name, value in part.items():
                out[:, self.inputs.index(name)] += value
        return self._complete(out)

    def harmonics(self) -> tuple[Array, Array]:
        """Return the orders (k) and what is recorded at them, (L, p, k), for a machine without feedback."""
        order, w = self._orders(0.0)
        return order, self.C @ w

    def beginning(self, time: float) -> Array:
        """Return the state (L, n) at a time, in eigenvectors: the motion that the synchronous forces keep up."""
        order, w = self._orders(time)
        speed, start = self.speed[:, 0], self.start[:, 0]
        return np.asarray((w * np.exp(1j * order * (start + speed * time))[:, None, :]).sum(axis=-1))

    def _orders(self, time: float) -> tuple[Array, Array]:
        """Return the orders k and the states (L, n, k) of e^{ik theta}."""
        turn = 2 * np.pi * np.arange(TURN) / TURN + np.zeros((len(self.runs), 1, TURN))
        clock = Clock(np.zeros_like(turn), turn, self.speed + 0 * turn, np.zeros_like(turn), self.speed)
        F = np.fft.fft(self.known(clock, synchronous=True)[:, :, 0], axis=-1) / TURN  # (L, m, k)
        order = np.fft.fftfreq(TURN, 1 / TURN)
        gap = (1j * order * self.speed[:, 0])[:, None, :] - self.lam[..., None]
        gap[np.abs(gap) < 1e-12] = np.inf
        w = self.B @ F / gap
        w[..., 0] *= self._risen(time)
        return order, w

    def _risen(self, time: float) -> Array:
        """Return the share of its rest value that each mode has reached since the rotor was lifted."""
        age = self.lifted + time
        if not np.isfinite(age):
            return np.ones_like(self.lam)
        return np.asarray(1.0 - np.where(self.slow, np.exp(np.where(self.slow, self.lam, 0) * age), 0))

    def run(self) -> Motion:
        """Settle, and return the signals at the samples."""
        return self.follow(*self.settle())

    def settle(self) -> tuple[Array, History]:
        """Return the state one step before the first sample's step ends, when everything fast has died out."""
        pauses: tuple[float, ...] = SETTLE[self.machine]
        if not self.feedback:
            exact = all(row.synchronous and row.wobble is None and row.twist is None for row in self.rows)
            pauses = () if exact else (sum(pauses),)
        steps = [round(pause / self.step) for pause in pauses]
        at = -sum(steps)
        w = self.beginning(at * self.step - self.sample)
        history = History(round(max((row.late for row in self.rows), default=0.0) / self.step))
        rough = self.stepper.rough
        self.stepper.rough = rough and rough * SETTLING
        for number, count in enumerate(steps):
            states = self._go(w, at, count, history)
            at += count
            w = states[-1].copy()
            if self.feedback and number < len(steps) - 1:
                w += self._rebalance(states, at * self.step)
        self.stepper.rough = rough
        return w, history

    def follow(self, w: Array, history: History | None = None) -> Motion:
        """Return the signals at the samples, from the state (L, n), in eigenvectors, one sample before the first."""
        samples = max(run.samples for run in self.runs)
        states = self._go(w, 0, -(-samples // self.stride), history or History())[:samples]
        if not np.isfinite(states).all():
            raise ArithmeticError("the motion grows without bound")
        return self._record(states)

    def _go(self, w: Array, first: int, count: int, history: History) -> Array:
        """Advance `count` steps from step `first`; return states (N S, L, n). Step 0 begins a sample before t = 0."""
        parts = []
        for begin in range(first, first + count, CHUNK // self.stride):
            number = np.arange(begin, min(begin + CHUNK // self.stride, first + count))
            clock = self.clock(((number[:, None] + self.stepper.c) * self.step - self.sample)[None])
            known = np.ascontiguousarray(np.moveaxis(self.known(clock), 1, 2))
            if self.feedback:
                nodes = [
                    Nodes(clock.t[0, k : k + 1], clock.theta[:, k], clock.rate[:, k], self.speed[:, 0])
                    for k in range(len(number))
                ]
                states = self.stepper.forced_run(w, known, nodes.__getitem__, history)
            else:
                states = self.stepper.free_run(w, known)
            parts.append(states)
            w = states[-1]
        return np.concatenate(parts)

    def _rebalance(self, states: Array, time: float) -> Array:
        """Return what moves the slow modes to where the mean force of the last turns holds them.

        w = rest + past e^{lambda t} + ripple
        """
        shift, risen = np.zeros_like(states[0]), self._risen(time)
        order = np.arange(-RIPPLE, RIPPLE + 1)
        for lane, speed in enumerate(self.speed[:, 0, 0]):
            turns = np.ceil(WINDOW * speed / (2 * np.pi))
            last = min(len(states), int(turns * 2 * np.pi / speed / self.sample))
            t = np.arange(1 - last, 1) * self.sample
            ripple = np.exp(1j * speed * t[:, None] * order)
            for mode in np.flatnonzero(self.slow[lane]):
                basis = np.column_stack([ripple, np.exp(self.lam[lane, mode] * t)])
                found = np.linalg.lstsq(basis, states[-last:, lane, mode], rcond=None)[0]
                rest, past = found[RIPPLE], found[-1]
                shift[lane, mode] = rest * risen[lane, mode] - (rest + past)
        return np.asarray(shift)

    def _record(self, states: Array) -> Motion:
        """Return what the probes and the current sensor show, without noise."""
        outputs = self.C @ np.moveaxis(states, 0, 2)  # (L, p, N)
        found = {name: outputs[:, j] for j, name in enumerate(self.recorded)}
        clock = self.clock((np.arange(outputs.shape[2]) * self.sample)[None, None])
        flat = Clock(clock.t[:, 0], clock.theta[:, 0], clock.rate[:, 0], clock.acceleration[:, 0], self.speed[:, 0])
        inputs = self.known(clock)[:, :, 0]
        if self.feedback:
            nodes = Nodes(flat.t, flat.theta, flat.rate, flat.speed)
            inputs = inputs + self._forces()(nodes, np.stack([found[name] for name in self.reads], axis=1))
        signals = {name: found[name] for name in found if name[0] == "p"}
        for k, bearing in enumerate(self.plants[0].bearings):
            mark, recorded, probe = bearing.mark, bearing.path.recorded, f"p{bearing.probe}"
            current = found[f"{'i' if recorded else 'command'}{mark}"]
            if f"e{mark}" in self.inputs:
                e, edot = (inputs[:, self.inputs.index(f"{name}{mark}")] for name in ("e", "edot"))
                signals[probe] = signals[probe] + e
                direct = bearing.path.direct if recorded else 1.0
                KP, KD = (np.array([plant.bearings[k].gains[j] for plant in self.plants])[:, None] for j in (0, 2))
                current = current + direct * (KP * e + KD * edot)
            signals[f"current{mark}"] = current
        for row in self.rows:
            if row.measure:
                row.measure(flat, signals)
        return Motion(signals, flat, lambda t: self.clock(t).theta)


def _rows(cores: list[tuple[Core, Array]], names: tuple[str, ...]) -> Array:
    """Return the rows of C (L, p, n) in eigenvectors."""
    return np.array([core.outputs(names) @ right for core, right in cores])
