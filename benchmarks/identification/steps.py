"""Exponential against Runge-Kutta steps of run-ups: python -m benchmarks.identification.steps.

CPU time of a run-up with its sensitivities in compiled C, over the same in exponential steps, with the largest error of
either (of the largest value of a signal, against exponential steps of an eighth). The same process, interleaved.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from rotorsim.identification.waveform.driven.equations import clock_ports, driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.recorded.along_angle import with_reaction
from rotorsim.identification.waveform.recorded.data import STABLE_STEP
from rotorsim.model.load import load

RATE, SECONDS = 5000.0, 1.0
OUTPUTS = {
    "jeffcott": [f"{port}[{axis}]" for port in ("rotor.displacement", "controller.current") for axis in (1, 2)],
    "fe_rigid": [
        *(f"rotor.displacement[{node},{axis}]" for node in (2, 3, 4, 5) for axis in (1, 2)),
        *(f"controller.current[{axis}]" for axis in (1, 2)),
    ],
}
SPEEDS = (50.0, 600.0)  # rad/s, at the ends
REPEATED = 3


def driven(ports: tuple[str, ...], sub: int) -> np.ndarray:
    """Return angle, speed and acceleration of a shaft at ends and middles of steps, (N, 2 sub + 1, n)."""
    t = (np.arange(int(RATE * SECONDS))[:, None] + np.arange(2 * sub + 1) / (2 * sub)) / RATE
    rise = (SPEEDS[1] - SPEEDS[0]) / SECONDS
    known = {"theta": SPEEDS[0] * t + rise * t**2 / 2, "speed": SPEEDS[0] + rise * t, "acceleration": 0 * t + rise}
    return np.stack([known[port.rpartition(".")[2]] for port in ports], axis=2)


def with_spring(name: str) -> Mapping[str, Any]:
    """Return a diagram with a spring at the disc that hardens, which is small."""
    document = dict(load(name).document)
    at = "[3]" if name == "fe_rigid" else ""
    document["blocks"] = {**document["blocks"], "spring": {"type": "cubic_stiffness"}}
    wires = [[f"rotor.displacement{at}", "spring.displacement"], ["spring.force", f"rotor.force{at}"]]
    return {**document, "wires": [*document["wires"], *wires]}


def compared(name: str, spring: bool) -> str:
    """Return a line: CPU time over that of exponential steps, and errors."""
    diagram = with_reaction(load(with_spring(name) if spring else name))
    ports = clock_ports(diagram)
    equations = driven_equations(diagram, OUTPUTS[name], ports, diagram.free, fastest=STABLE_STEP * RATE)
    simulation = Simulation(equations)
    p = equations.parameters(equations.model.p0, np.array([item.value for item in equations.free]))
    start = np.zeros(equations.n)
    title = f"{name}{' with a cubic spring' if spring else ''}"
    exact = simulation.in_exponential_steps(p, start, driven(ports, 8), 1 / RATE)
    if exact is None:
        return f"{title:30} no C compiler, or no exponential steps"
    spent: dict[str, list[float]] = {"exponential": [], "Runge-Kutta": []}
    error = {}
    for _ in range(REPEATED):
        for kind, method, sub in (
            ("exponential", simulation.in_exponential_steps, 1),
            ("Runge-Kutta", simulation.simulate, 2),
        ):
            begin = time.process_time()
            y, _ = method(p, start, driven(ports, sub), 1 / RATE) or exact
            spent[kind].append(time.process_time() - begin)
            error[kind] = np.abs(y - exact[0]).max(axis=0) / np.abs(exact[0]).max(axis=0)
    ratio = min(spent["Runge-Kutta"]) / min(spent["exponential"])
    errors = ", ".join(f"{kind} {own.max():.1e}" for kind, own in error.items())
    return f"{title:30}{equations.n:3} states: Runge-Kutta takes {ratio:5.1f} times the CPU time; error: {errors}"


def main() -> None:
    """Print a line per diagram."""
    for name, spring in product(OUTPUTS, (False, True)):
        print(compared(name, spring), flush=True)


if __name__ == "__main__":
    main()
