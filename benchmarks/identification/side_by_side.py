"""What runs side by side in lanes save, where many runs are needed: python -m benchmarks.identification.side_by_side

A study of sensitivity makes its undisturbed runs in lanes; a fit in time does not: its Levenberg-Marquardt steps follow
each other, their sensitivities fill the lanes already, and every law is another code. Printed are the CPU time of the
runs of a study, in lanes over one by one, and which share of a fit of run-ups is simulations that could go side by side
(starts at other angles: the same code, and no sensitivities).
"""

from __future__ import annotations

import sys
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.harness import Line, at_most, cpu_seconds, medians
from rotorsim import simulate, simulate_many
from rotorsim.identification.identification import identify
from rotorsim.identification.waveform import noise_model as fits
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from tests.identification.waveform.run_up import drawn, runs_of

SPEEDS = np.linspace(100.0, 200.0, 9)  # rad/s
RUN: dict[str, Any] = {"stop": 5.0, "step": 1e-5, "record_every": 10}  # of a study on fe_rigid
SEED = 3


def study_runs() -> Line:
    """Return the CPU time of nine runs of a beam in lanes over that of nine runs one by one; no compiler's time."""
    model = compile_diagram(load("fe_rigid"))
    together = {"reduce": ["history"], "window": (4.0, 5.0), "scheduler": "synchronous"}

    def in_lanes() -> None:
        simulate_many(model, {"speed": SPEEDS}, **RUN, **together)

    def one_by_one() -> None:
        for speed in SPEEDS:
            simulate(model, parameters={"speed": speed}, **RUN)

    times = medians({"lanes": in_lanes, "one": one_by_one}, repeats=3)
    return at_most("undisturbed runs of a study on fe_rigid, in lanes / one by one", times["lanes"] / times["one"], 1.0)


def share_of_starts() -> Line:
    """Return the share of a fit of three run-ups that is spent in trying angles, which lanes could make less."""
    spent: list[float] = []
    inner = fits.angle_starts

    def counted(*given: Any) -> list[np.ndarray]:
        found: list[list[np.ndarray]] = []
        spent.append(cpu_seconds(lambda: found.append(inner(*given))))
        return found[0]

    recording, diagram = runs_of(drawn(SEED), SEED), load("jeffcott")
    with patch.object(fits, "angle_starts", counted):
        whole = cpu_seconds(lambda: identify(diagram, recording))
    return Line("starts at other angles, of the CPU time of a fit of run-ups", f"{100 * sum(spent) / whole:.0f} %")


def main() -> int:
    """Print both; exit 1 where lanes cost more than they save."""
    lines = [study_runs(), share_of_starts()]
    print(*lines, sep="\n")
    return int(any(line.ok is False for line in lines))


if __name__ == "__main__":
    sys.exit(main())
