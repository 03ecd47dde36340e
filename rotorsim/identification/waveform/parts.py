"""Parts of long runs at all speeds, for what need not be exact: each begins as the fitted diagram passes there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.evaluation import Label
from rotorsim.identification.waveform.noise_model import NoiseModel
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import subsystems_of

PART_SAMPLES = 16384  # of all parts together
PARTS_OF_RUN = 5  # of each run


def parts_of(
    diagram: Diagram, channels: Channels, runs: Sequence[SampledRun], noise: NoiseModel
) -> tuple[tuple[SampledRun, ...], dict[Label, float]]:
    """Return parts of runs that are evenly apart, and the states at their first samples; none of short runs."""
    total = sum(run.size for run in runs)
    if total <= PART_SAMPLES:
        return (), {}
    systems = subsystems_of(diagram, channels)
    search = OutputErrorSearch(systems, runs, dict.fromkeys(noise.variance, 1.0), noise.least)
    unknowns = search.first(noise.starts)
    unknowns[: search.m] = noise.theta
    states = replace(search, systems=tuple(_of_states(system) for system in systems))
    sub = search.substeps(unknowns)
    parts: list[SampledRun] = []
    starts: dict[Label, float] = {}
    for r, run in enumerate(runs):
        size = run.size * PART_SAMPLES // total // PARTS_OF_RUN
        x = [states.simulated(unknowns, k, r, sub, sensitivities=False)[0] for k in range(len(systems))]
        for first in np.linspace(0, run.size - size, PARTS_OF_RUN).astype(int).tolist():
            for system, own in zip(systems, x, strict=True):
                names = system.equations.state_names
                starts |= {(system.name, name, len(parts)): float(own[first, j]) for j, name in enumerate(names)}
            parts.append(replace(run.part(slice(first, first + size)), id=f"{run.id} from {run.time[first]:.6g} s"))
    return tuple(parts), starts


def _of_states(system: Simulation) -> Simulation:
    """Return a simulation whose outputs are its states."""
    equations = system.equations
    return replace(system, equations=equations.with_states(()), sensitive=False)
