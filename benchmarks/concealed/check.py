"""How exact the generator is: against finer steps, closed forms, and limits that follow from the method."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.concealed import generator
from benchmarks.concealed.detect import detectability
from benchmarks.concealed.machine_fe import bare_frequencies
from benchmarks.concealed.machines import GAINS, MACHINES
from benchmarks.concealed.measuring import Instruments
from benchmarks.concealed.rows.faults import ALIASES, OUTSIDE, ROWS, Draw, Fault
from benchmarks.concealed.rows.loop import late
from benchmarks.concealed.simulate import Accuracy, Motion, Simulation

FINE = Accuracy(16, 2)
FINER_CORNERS = Accuracy(9, 1, 1e-3)
INTEGRATION = 1e-9
SEED = 20


def difference(one: Motion, other: Motion) -> float:
    """Return the largest difference of a signal over the largest value of it in the same run."""
    worst = 0.0
    for name, value in one.signals.items():
        gap = np.abs(value - other.signals[name]).max(axis=1)
        worst = max(worst, float((gap / np.abs(value).max(axis=1)).max()))
    return worst


def scene(machine: str, seed: int = SEED) -> tuple[dict[str, float], list[Any], Motion, dict[str, float]]:
    """Return parameters, runs, healthy motion and its peaks."""
    rng = np.random.default_rng(seed)
    parameters, runs = generator.draw_parameters(rng, machine), generator.draw_runs(rng, machine)
    healthy = Simulation(machine, parameters, runs, generator.RATE).run()
    return parameters, runs, healthy, generator.peaks(healthy, runs)


def drawn(
    name: str,
    machine: str,
    strength: float,
    parameters: dict[str, float],
    peaks: dict[str, float],
    lanes: int,
    node: int | None = None,
) -> Fault:
    """Return a row or a law of given strength, at a node or, without it, at the crack's if it can be there."""
    entry = (ROWS | OUTSIDE)[name]
    nodes = entry.nodes(machine)
    plant = MACHINES[machine](parameters, GAINS[machine])
    node = node or (plant.crack.node if plant.crack.node in nodes else nodes[0])
    rng = np.random.default_rng(SEED)
    return entry.make(Draw(rng, machine, node, parameters, peaks, strength, lanes, plant))


def everything(quick: bool) -> list[dict[str, Any]]:
    """Return what was checked, the error found, and the limit."""
    found: list[dict[str, Any]] = []

    def enter(what: str, error: float, limit: float) -> None:
        found.append({"what": what, "error": error, "limit": limit})

    for machine in MACHINES:
        parameters, runs, healthy, peaks = scene(machine)
        fine = Simulation(machine, parameters, runs, generator.RATE, accuracy=FINE).run()
        enter(f"{machine}: healthy, against half the step and more points", difference(fine, healthy), INTEGRATION)
        for name, entry in (ROWS | OUTSIDE).items():
            if not entry.nodes(machine):
                continue
            fault = drawn(name, machine, 0.9, parameters, peaks, len(runs))
            if fault.feedback is None or (quick and fault.corner):
                continue
            one = Simulation(machine, parameters, runs, generator.RATE, (fault,))
            w, _ = one.settle()
            other = Simulation(
                machine, parameters, runs, generator.RATE, (fault,), accuracy=FINER_CORNERS if fault.corner else FINE
            )
            how = "corners a thousand times finer" if fault.corner else "half the step and more points"
            enter(f"{machine}: {name}, against {how}", difference(other.follow(w), one.follow(w)), INTEGRATION)
    for mode in range(3):
        errors = []
        for elements in (10, 20):
            exact = ((mode + 1) * np.pi / 0.5) ** 2 * np.sqrt(2.1e11 * 0.016**2 / 16 / 7850.0)
            errors.append(bare_frequencies(elements, 0.5, 0.016, 2.1e11, 7850.0)[mode] / exact - 1)
        enter(
            f"beam: order of convergence of frequency {mode + 1}, away from 4",
            abs(np.log2(errors[0] / errors[1]) - 4),
            0.1,
        )
    path, s, delay = late(3e-4), 2j * np.pi * np.linspace(0, 1500, 301), 3e-4
    H = path.direct + sum(r / (s - pole) for r, pole in zip(path.residues, path.poles, strict=True))
    enter(
        "control delay of 0.3 ms up to 1500 Hz, against e^{-s tau}",
        float(np.abs(H - np.exp(-s * delay)).max()),
        INTEGRATION,
    )
    for machine in MACHINES:
        if machine != "jeffcott":
            what = "the diagram's elements instead of three for each: detectability, noise of 25 nm"
            enter(f"{machine}: {what}", _mesh(machine), float("inf"))
    enter("exact aliases: detectability, noise of 1 nm", _aliases(), 4.0)
    return found


def _mesh(machine: str) -> float:
    """Return how visible the diagram's mesh is."""
    parameters, runs, healthy, _ = scene(machine)
    own = MACHINES[machine]
    try:
        MACHINES[machine] = partial(own, parts=1)
        coarse = Simulation(machine, parameters, runs, generator.RATE).run()
    finally:
        MACHINES[machine] = own
    instruments = Instruments((2.5e-8, 4e-4), (1e-4, 1.0), 16, 1e-6)
    return detectability(machine, parameters, runs, np.inf, healthy, coarse, instruments, 0.0)


def _aliases() -> float:
    worst = 0.0
    instruments = Instruments((1e-9, 1e-5), (1e-4, 1.0), 18, 1e-6)
    for machine in MACHINES:
        parameters, runs, healthy, peaks = scene(machine)
        for entry in ALIASES.values():
            if entry.nodes(machine):
                plant, rng = MACHINES[machine](parameters, GAINS[machine]), np.random.default_rng(SEED)
                draw = Draw(rng, machine, entry.nodes(machine)[0], parameters, peaks, 0.5, len(runs), plant)
                motion = Simulation(machine, parameters, runs, generator.RATE, (entry.make(draw),)).run()
                D = detectability(machine, parameters, runs, np.inf, healthy, motion, instruments, 0.0)
                worst = max(worst, D)
    return worst


def text(found: list[dict[str, Any]]) -> str:
    """Return the table of checks."""
    lines = []
    for item in found:
        good = "ok  " if item["error"] <= item["limit"] else "FAIL"
        lines.append(f"{good} {item['error']:9.1e} (limit {item['limit']:.0e})  {item['what']}")
    return "\n".join(lines)
