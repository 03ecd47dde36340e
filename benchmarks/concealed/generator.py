"""Draw a case: machine, parameters, runs, instruments, faults; simulate it; say the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.concealed.detect import detectability
from benchmarks.concealed.machines import DRAWN, GAINS, MACHINES, PLAIN
from benchmarks.concealed.measuring import Instruments, draw_instruments
from benchmarks.concealed.plant import Gains
from benchmarks.concealed.rows import loop, mechanical, outside, sensors
from benchmarks.concealed.rows.faults import ALIASES, OUTSIDE, ROWS, Draw, Entry, Fault
from benchmarks.concealed.simulate import Motion, Run, Simulation

_ = (loop, mechanical, outside, sensors)  # they enter their rows

RATE = 5000.0
KINDS = ("nothing", "one", "two", "alias", "outside")
MIX = (0.15, 0.50, 0.12, 0.08, 0.15)
LEAST, LEAST_BEAM = 10.0, 15.0  # detectability below which a fault is drawn again, larger
LIMIT = 4e-4  # m: a machine that moves more is drawn again
STEP = 4 / RATE  # s, of the simulation: speeds have their corners between two
RAMP_STEPS, RAMP_LOW, RAMP_HIGH = (8000, 9501), (6.0, 12.0), (70.0, 95.0)  # steps of a run; Hz

STEADY = ("internal_damping", "hysteretic_damping", "speed_fluctuation", "torsion_coupling")  # at constant speed only

SPEEDS = {  # Hz: with gains A, with gains B; held out with gains A, with gains C
    "jeffcott": ((2, 15, 20, 25, 30, 40, 55, 70), (25, 55), (35, 85, 100), (45, 80)),
    "fe_rigid": ((2, 15, 20, 25, 33, 46, 58), (25, 55), (38, 66, 120), (48, 70)),
    "fe_flexible": ((2, 15, 20, 25, 33, 46, 58), (25, 55), (38, 66, 120), (48, 70)),
    "two_amb_rotor": ((2, 12, 18, 25, 34, 44, 62), (25, 58), (30, 75, 110), (40, 68)),
}


@dataclass
class Case:
    """A finished case, before it is measured."""

    name: str
    kind: str
    machine: str
    faults: list[Fault]
    parameters: dict[str, float]
    runs: list[Run]
    lifted: float
    instruments: Instruments
    motion: Motion
    visible: float
    attempts: int

    @property
    def coarse(self) -> float:
        """Step of a converter that is coarser than stated, or 0."""
        return max((fault.lsb for fault in self.faults), default=0.0)

    def truth(self) -> dict[str, Any]:
        """Return the truth as the shared sets write it, and what else helps to score."""
        missing = [fault.physics for fault in self.faults]
        nodes = [fault.node for fault in self.faults if self.machine != "jeffcott"]
        effect: dict[str, float] = {}
        for fault in self.faults:
            head = "" if len(self.faults) == 1 else f"{fault.physics}."
            effect |= {f"{head}{name}": value for name, value in fault.effect.items()}
        classes = {fault.physics: [fault.physics, *sorted({*fault.alias} - {fault.physics})] for fault in self.faults}
        hold = [k for k, run in enumerate(self.runs) if run.use == "hold_out"]
        return {
            "case": self.name,
            "kind": self.kind,
            "machine": self.machine,
            "missing": missing,
            "node": nodes[0] if len(nodes) == 1 else None,
            "effect": effect,
            "parameters": self.parameters,
            "class": classes,
            "nodes": {f.physics: f.node for f in self.faults} if self.machine != "jeffcott" else {},
            "blocks": {fault.physics: list(fault.blocks) for fault in self.faults},
            "law": next((fault.law for fault in self.faults if fault.law), None),
            "detectability": round(self.visible, 1),
            "lifted_s": self.lifted if np.isfinite(self.lifted) else None,
            "noise": list(self.instruments.noise),
            "noise_floor": self._noise_floor(hold),
        }

    def _noise_floor(self, lanes: list[int]) -> float:
        """Return noise over motion: of all held-out runs together for probes and for each current, rms of these."""
        currents = [name for name in self.motion.signals if name.startswith("current")]
        shares = []
        for kind, names in enumerate([[n for n in self.motion.signals if n not in currents], *([n] for n in currents)]):
            noise, moved = 0.0, 0.0
            for value in (self.motion.signals[name] for name in names):
                for lane in lanes:
                    noise += self.instruments.noise[min(kind, 1)] ** 2
                    moved += float(np.mean(np.abs(value[lane] - value[lane].mean()) ** 2)) / 2
            shares.append(noise / moved)
        return float(np.sqrt(np.mean(shares)))


def draw_parameters(rng: np.random.Generator, machine: str) -> dict[str, float]:
    """Draw the free parameters: +-30 % about the nominal, any phase."""
    return {
        name: float(rng.uniform(-np.pi, np.pi) if value is None else value * rng.uniform(0.7, 1.3))
        for name, value in DRAWN[machine].items()
    }


def draw_gains(rng: np.random.Generator, machine: str) -> dict[str, tuple[Gains, ...]]:
    """Draw three sets of gains of each bearing: A of the diagram, B softer and more damped, C stiffer and less."""

    def about(own: Gains, KP: tuple[int, int], KD: tuple[int, int]) -> Gains:
        drawn = (float(rng.integers(*KP)) * 500, float(rng.integers(15, 31)) * 100, float(rng.integers(*KD)) / 10)
        scale = [mine / plain for mine, plain in zip(own, PLAIN, strict=True)]
        return drawn[0] * scale[0], drawn[1] * scale[1], drawn[2] * scale[2]

    own = GAINS[machine]
    B = tuple(about(one, (16, 21), (35, 56)) for one in own)
    return {"A": own, "B": B, "C": tuple(about(one, (27, 33), (18, 27)) for one in own)}


def draw_runs(rng: np.random.Generator, machine: str) -> list[Run]:
    """Draw about ten runs to identify, with two sets of gains, and five to hold out, at other speeds and gains."""
    gains = draw_gains(rng, machine)
    samples = int(rng.integers(4500, 5501))
    runs = []
    for label, speeds, use in zip("ABAC", SPEEDS[machine], ("identify",) * 2 + ("hold_out",) * 2, strict=True):
        for speed in speeds:
            hertz = speed * (1 + np.clip(0.02 * rng.standard_normal(), -0.04, 0.04))
            runs.append(Run(2 * np.pi * hertz, float(rng.uniform(0, 2 * np.pi)), gains[label], label, samples, use))
    return runs


def draw_run_ups(rng: np.random.Generator, machine: str) -> list[Run]:
    """Draw a run-up, a coast-down and a run-up with other gains; to hold out, a run-up with a third set and one down.

    One of the first three holds its last speed for a while; which one, and how long, at random.
    """
    gains = draw_gains(rng, machine)
    samples, held = 4 * int(rng.integers(*RAMP_STEPS)), int(rng.integers(3))
    runs = []
    for number, (label, up) in enumerate((("A", True), ("A", False), ("B", True), ("C", True), ("A", False))):
        low, high = rng.uniform(*RAMP_LOW), rng.uniform(*RAMP_HIGH)
        ramp = STEP * int(samples / 4 * rng.uniform(0.6, 0.9)) if number == held else samples / RATE
        first, last = (low, high) if up else (high, low)
        acceleration, start = 2 * np.pi * (last - first) / ramp, float(rng.uniform(0, 2 * np.pi))
        use = "identify" if number < 3 else "hold_out"
        ends = float(ramp) if number == held else np.inf
        runs.append(Run(2 * np.pi * first, start, gains[label], label, samples, use, acceleration, ends))
    return runs


def peaks(motion: Motion, runs: list[Run]) -> dict[str, float]:
    """Return the largest displacements, and the largest currents of an axis: to identify, and of all runs."""
    fit = [run.use == "identify" for run in runs]
    found: dict[str, float] = {}
    for name, value in motion.signals.items():
        if name.startswith("current"):
            largest = np.maximum(np.abs(value.real), np.abs(value.imag)).max(axis=1)
            short = f"i{name.removeprefix('current')}"
        else:
            largest, short = np.abs(value).max(axis=1), f"z{name[1:]}"
        found |= {short: float(largest[fit].max()), f"all {short}": float(largest.max())}
    return found


def known_rows(kind: str) -> set[str]:
    """Return the names that cases of a kind may be narrowed to."""
    tables = {"one": (ROWS,), "alias": (ALIASES,), "outside": (OUTSIDE,)}
    return {name for table in tables.get(kind, ()) for name in table}


def _choose(
    seed: tuple[int, ...], kind: str, machine: str, number: int, only: tuple[str, ...], ramps: bool = False
) -> list[Entry]:
    """Return the rows of a case: all in turn, in an order that the first number of the seed fixes."""
    table = {"one": ROWS, "two": ROWS, "alias": ALIASES, "outside": OUTSIDE}.get(kind, {})
    able = {n: e for n, e in table.items() if e.nodes(machine) and (not only or n in only or kind == "two")}
    if ramps:
        able = {name: entry for name, entry in able.items() if name not in STEADY}
    if not able and kind != "nothing":
        raise ValueError(f"no row of kind {kind} that is asked for can be on {machine}")
    if not able:
        return []
    pool = sorted(name for name in able if kind != "two" or not able[name].alone)
    order = [str(name) for name in np.random.default_rng(seed[0]).permutation(pool)]
    first = order[number % len(order)]
    if kind != "two":
        return [able[first]]
    rough = ("rub", "clearance", "coulomb_friction", "current_clipping")
    fits = [
        n
        for n in pool
        if able[n].group != able[first].group
        and not (n in rough and first in rough)
        and {able[n].group, able[first].group} not in ({"sensor", "amb"}, {"controller", "amb"})
    ]
    second = str(np.random.default_rng([*seed, 7]).choice(fits))
    return [able[first], able[second]]


def make_case(
    name: str,
    kind: str,
    machine: str,
    seed: tuple[int, ...],
    number: int,
    only: tuple[str, ...] = (),
    ramps: bool = False,
) -> Case:
    """Return case `number` of its kind; the same for the same seed. ramps: run-ups and coast-downs.

    Raises:
        RuntimeError: no stable, visible machine was found in twenty attempts
        ValueError: none of the rows asked for can be on this machine
    """
    rng = np.random.default_rng(seed)
    least = 0.0
    for attempt in range(1, 21):
        parameters, runs = draw_parameters(rng, machine), (draw_run_ups if ramps else draw_runs)(rng, machine)
        lifted = float(np.exp(rng.uniform(np.log(3.0), np.log(40.0)))) if rng.random() < 0.5 else np.inf
        try:
            healthy = Simulation(machine, parameters, runs, RATE, lifted=lifted).run()
            sizes = peaks(healthy, runs)
            faults = []
            for entry in _choose(seed, kind, machine, number, only, ramps):
                plant = MACHINES[machine](parameters, GAINS[machine])
                low = max(least, 0.5 if kind == "two" else 0.0)
                draw = Draw(
                    rng,
                    machine,
                    int(rng.choice(entry.nodes(machine))),
                    parameters,
                    sizes,
                    float(rng.uniform(low, 1.0)),
                    len(runs),
                    plant,
                )
                faults.append(entry.make(draw))
            motion = healthy
            if faults:
                motion = Simulation(machine, parameters, runs, RATE, tuple(faults), lifted).run()
        except ArithmeticError:
            continue
        largest = max(value for key, value in peaks(motion, runs).items() if key.startswith("all z"))
        if largest > LIMIT:
            continue
        current = max(value for key, value in peaks(motion, runs).items() if key.startswith("all i"))
        instruments = draw_instruments(rng, (largest, current))
        case = Case(name, kind, machine, faults, parameters, runs, lifted, instruments, motion, 0.0, attempt)
        if faults:
            case.visible = detectability(machine, parameters, runs, lifted, healthy, motion, instruments, case.coarse)
        if kind not in ("one", "two", "outside") or case.visible >= (LEAST if machine == "jeffcott" else LEAST_BEAM):
            return case
        least = min(0.9, least + 0.15)
    raise RuntimeError(f"{name}: no stable machine with a visible fault in twenty attempts")
