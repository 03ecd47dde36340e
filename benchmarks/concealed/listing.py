"""List the rows and laws that can be drawn, with their range of sizes and how visible the ends are."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed import generator
from benchmarks.concealed.check import drawn, scene
from benchmarks.concealed.detect import detectability
from benchmarks.concealed.measuring import Instruments
from benchmarks.concealed.rows.faults import OUTSIDE, ROWS, Entry, Fault
from benchmarks.concealed.simulate import Motion, Run, Simulation
from benchmarks.concealed.sites import SITES, WORDS

TYPICAL = Instruments((2e-8, 3e-4), (1e-4, 1.0), 16, 1e-6)


def _law(entry: Entry) -> str:
    """Return the equation that a row states: the first paragraph of its docstring."""
    return " ".join((entry.make.__doc__ or "").split("\n\n")[0].split()).rstrip(".").replace("|", "\\|")


def _sizes(small: Fault, large: Fault) -> str:
    """Return the numbers that grow with strength."""
    parts = []
    for name, value in small.effect.items():
        other = large.effect.get(name, value)
        if abs(abs(other) - abs(value)) > 1e-9 * abs(value):
            parts.append(f"{name} {abs(value):.2g} to {abs(other):.2g}")
    return ", ".join(parts) or "-"


def _sites() -> list[str]:
    """Return a markdown table of the nodes that sites have on each beam."""
    beams = [machine for machine in SITES if machine != "jeffcott"]
    lines = [f"| on a beam | {' | '.join(f'`{machine}`' for machine in beams)} |", "|---" * (1 + len(beams)) + "|"]
    for site in (site for site in WORDS if site != "machine"):
        nodes = (", ".join(map(str, SITES[machine][site])) for machine in beams)
        lines.append(f"| {WORDS[site]} | {' | '.join(nodes)} |")
    return lines


def listing(visible: bool) -> str:
    """Return markdown tables of sites and of rows.

    D of both ends, if `visible`: on one machine, with noise of 20 nm and 0.3 mA.
    """
    scenes = {machine: scene(machine) for machine in ("jeffcott", "fe_rigid")}
    lines = [*_sites(), "", "| row or law | where | equation | sizes (SI) | D |", "|---|---|---|---|---|"]
    for name, entry in (ROWS | OUTSIDE).items():
        machine = "jeffcott" if entry.jeffcott else "fe_rigid"
        parameters, runs, healthy, peaks = scenes[machine]
        ends = [drawn(name, machine, strength, parameters, peaks, len(runs)) for strength in (0.0, 1.0)]
        found = [_visible(machine, fault, healthy, parameters, runs) for fault in ends] if visible else []
        places = ["Jeffcott"] * entry.jeffcott + [f"beam: {WORDS[site]}" for site in (entry.beam,) if site]
        D = " to ".join(found) or "-"
        lines.append(f"| `{name}` | {'; '.join(places)} | {_law(entry)} | {_sizes(*ends)} | {D} |")
    return "\n".join(lines)


def _visible(machine: str, fault: Fault, healthy: Motion, parameters: dict[str, float], runs: list[Run]) -> str:
    try:
        motion = Simulation(machine, parameters, runs, generator.RATE, (fault,)).run()
    except ArithmeticError:
        return "unstable"
    D = detectability(machine, parameters, runs, np.inf, healthy, motion, TYPICAL, fault.lsb)
    return f"{D:.2g}" if D < 100 else f"{D:.0f}"
