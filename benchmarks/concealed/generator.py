"""Draw a case: machine, parameters, runs, instruments, faults; simulate it; say the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.concealed import loop, mechanical, outside
from benchmarks.concealed.detect import detectability
from benchmarks.concealed.faults import ALIASES, OUTSIDE, ROWS, Draw, Entry, Fault
from benchmarks.concealed.measuring import Instruments, draw_instruments
from benchmarks.concealed.plant import MACHINES, NOMINAL
from benchmarks.concealed.simulate import Motion, Run, Simulation

_ = (loop, mechanical, outside)  # they enter their rows

RATE = 5000.0
KINDS = ("nothing", "one", "two", "alias", "outside")
MIX = (0.15, 0.50, 0.12, 0.08, 0.15)
LEAST = {"jeffcott": 10.0, "fe_rigid": 15.0}  # detectability below which a fault is drawn again, larger
LIMIT = 4e-4  # m: a machine that moves more is drawn again

A = (12200.0, 2000.0, 3.0)
SPEEDS = {  # Hz: with gains A, with gains B; held out with gains A, with gains C
    "jeffcott": ((2, 15, 20, 25, 30, 40, 55, 70), (25, 55), (35, 85, 100), (45, 80)),
    "fe_rigid": ((2, 15, 20, 25, 33, 46, 58), (25, 55), (38, 66, 120), (48, 70)),
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
        nodes = [fault.node for fault in self.faults if self.machine == "fe_rigid"]
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
            "nodes": {f.physics: f.node for f in self.faults} if self.machine == "fe_rigid" else {},
            "blocks": {fault.physics: list(fault.blocks) for fault in self.faults},
            "law": next((fault.law for fault in self.faults if fault.law), None),
            "detectability": round(self.visible, 1),
            "lifted_s": self.lifted if np.isfinite(self.lifted) else None,
            "noise": list(self.instruments.noise),
            "noise_floor": self._noise_floor(hold),
        }

    def _noise_floor(self, lanes: list[int]) -> float:
        """Return noise over motion: of all held-out runs together for probes and for current, rms of the two."""
        shares = []
        for kind in (0, 1):
            noise, moved = 0.0, 0.0
            for name, value in self.motion.signals.items():
                if kind == int(name == "current"):
                    for lane in lanes:
                        noise += self.instruments.noise[kind] ** 2
                        moved += float(np.mean(np.abs(value[lane] - value[lane].mean()) ** 2)) / 2
            shares.append(noise / moved)
        return float(np.sqrt(np.mean(shares)))


def draw_parameters(rng: np.random.Generator) -> dict[str, float]:
    """Draw the free parameters: +-30 % about the nominal, any phase."""
    found = {name: value * rng.uniform(0.7, 1.3) for name, value in NOMINAL.items()}
    found |= {"beta": rng.uniform(-np.pi, np.pi), "crack_phase": rng.uniform(-np.pi, np.pi)}
    return {name: float(value) for name, value in found.items()}


def draw_runs(rng: np.random.Generator, machine: str) -> list[Run]:
    """Draw about ten runs to identify, with two sets of gains, and five to hold out, at other speeds and gains."""
    gains = {
        "A": A,
        "B": (float(rng.integers(16, 21)) * 500, float(rng.integers(15, 31)) * 100, float(rng.integers(35, 56)) / 10),
        "C": (float(rng.integers(27, 33)) * 500, float(rng.integers(15, 31)) * 100, float(rng.integers(18, 27)) / 10),
    }
    samples = int(rng.integers(4500, 5501))
    runs = []
    for label, speeds, use in zip("ABAC", SPEEDS[machine], ("identify",) * 2 + ("hold_out",) * 2, strict=True):
        for speed in speeds:
            hertz = speed * (1 + np.clip(0.02 * rng.standard_normal(), -0.04, 0.04))
            runs.append(Run(2 * np.pi * hertz, float(rng.uniform(0, 2 * np.pi)), gains[label], label, samples, use))
    return runs


def peaks(motion: Motion, runs: list[Run]) -> dict[str, float]:
    """Return the largest displacements, and the largest currents of an axis: to identify, and of all runs."""
    fit = [run.use == "identify" for run in runs]
    found: dict[str, float] = {}
    for name, value in motion.signals.items():
        if name == "current":
            largest, short = np.maximum(np.abs(value.real), np.abs(value.imag)).max(axis=1), "i"
        else:
            largest, short = np.abs(value).max(axis=1), f"z{name[1:]}"
        found |= {short: float(largest[fit].max()), f"all {short}": float(largest.max())}
    return found


def known_rows(kind: str) -> set[str]:
    """Return the names that cases of a kind may be narrowed to."""
    tables = {"one": (ROWS,), "alias": (ALIASES,), "outside": (OUTSIDE,)}
    return {name for table in tables.get(kind, ()) for name in table}


def _choose(seed: tuple[int, ...], kind: str, machine: str, number: int, only: tuple[str, ...]) -> list[Entry]:
    """Return the rows of a case: all in turn, in an order that the first number of the seed fixes."""
    table = {"one": ROWS, "two": ROWS, "alias": ALIASES, "outside": OUTSIDE}.get(kind, {})
    able = {n: e for n, e in table.items() if machine in e.nodes and (not only or n in only or kind == "two")}
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
    name: str, kind: str, machine: str, seed: tuple[int, ...], number: int, only: tuple[str, ...] = ()
) -> Case:
    """Return case `number` of its kind; the same for the same seed.

    Raises:
        RuntimeError: no stable, visible machine was found in twenty attempts
        ValueError: none of the rows asked for can be on this machine
    """
    rng = np.random.default_rng(seed)
    least = 0.0
    for attempt in range(1, 21):
        parameters, runs = draw_parameters(rng), draw_runs(rng, machine)
        lifted = float(np.exp(rng.uniform(np.log(3.0), np.log(40.0)))) if rng.random() < 0.5 else np.inf
        try:
            healthy = Simulation(machine, parameters, runs, RATE, lifted=lifted).run()
            sizes = peaks(healthy, runs)
            faults = []
            for entry in _choose(seed, kind, machine, number, only):
                plant = MACHINES[machine](parameters, A)
                low = max(least, 0.5 if kind == "two" else 0.0)
                draw = Draw(
                    rng,
                    machine,
                    int(rng.choice(entry.nodes[machine])),
                    parameters,
                    sizes,
                    float(rng.uniform(low, 1.0)),
                    len(runs),
                    plant.amb,
                    {node: 1 / plant.flexibility(node) for node in plant.displacement},
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
        found = peaks(motion, runs)
        instruments = draw_instruments(rng, (largest, found["all i"]))
        case = Case(name, kind, machine, faults, parameters, runs, lifted, instruments, motion, 0.0, attempt)
        if faults:
            case.visible = detectability(machine, parameters, runs, lifted, healthy, motion, instruments, case.coarse)
        if kind not in ("one", "two", "outside") or case.visible >= LEAST[machine]:
            return case
        least = min(0.9, least + 0.15)
    raise RuntimeError(f"{name}: no stable machine with a visible fault in twenty attempts")
