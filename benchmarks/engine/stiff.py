"""From how many parts of a step on radau takes less CPU time than RK4: python -m benchmarks.engine.stiff.

Of beams with finer meshes, whose fastest modes ask for shorter steps of RK4. Source of
`rotorsim.simulation.stable_step.MOST_PARTS`.
"""

from __future__ import annotations

import copy
from typing import Any

from threadpoolctl import threadpool_limits

from benchmarks.harness import medians
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from rotorsim.simulation.stable_step import MOST_PARTS

MACHINES = ("fe_rigid", "fe_flexible")
SUBDIVISIONS = (2, 4)
STEPS = 400_000  # of RK4, whose cost per step does not depend on its length
STOP = 0.3  # s, of radau
SHORT = 1e-8  # s: stable with all of these


def solved(name: str, subdivisions: int, **solver: Any) -> Any:
    """Return what simulates a machine on a finer mesh."""
    document: Any = copy.deepcopy(load(name).document)
    document["blocks"]["rotor"]["parameters"]["subdivisions"] = subdivisions
    document["solver"] |= solver
    diagram = load(document)
    return lambda: simulate(diagram, stop=solver["stop"])


def main() -> int:
    """Print of how many parts of the diagram's own step RK4 takes as long as radau."""
    actions: dict[str, Any] = {}
    for name in MACHINES:
        for parts in SUBDIVISIONS:
            short = {"step": SHORT, "stop": STEPS * SHORT, "record_every": STEPS // 4}
            actions[f"{name} {parts} rk4"] = solved(name, parts, **short)
            actions[f"{name} {parts} radau"] = solved(name, parts, method="radau", stop=STOP)
    with threadpool_limits(1, "blas"):
        found = medians(actions)
    for name in MACHINES:
        step = load(name).solver.step
        for parts in SUBDIVISIONS:
            rk4, radau = found[f"{name} {parts} rk4"] / STEPS / step, found[f"{name} {parts} radau"] / STOP
            print(
                f"{name}, {parts} beams an element: radau takes as long as RK4 at {radau / rk4:.0f} parts of its step"
            )
    print(f"MOST_PARTS: {MOST_PARTS}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
