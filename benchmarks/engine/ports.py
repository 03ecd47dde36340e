"""What a beam's settled motion costs by way of its ports: python -m benchmarks.engine.ports.

The same response and derivatives of ten runs, by all states and by the ports of what no parameter moves; growth with
the number of elements.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.harness import medians
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from rotorsim.settled.equations import Equations
from rotorsim.settled.motion import LinearMotion, Response

ORDERS = 12
SPEEDS = 2 * np.pi * np.linspace(5.0, 60.0, 10)
SUBDIVISIONS = (1, 2, 4)
OUTPUTS = [f"rotor.displacement[{node},{axis}]" for node in (2, 3, 4, 5) for axis in (1, 2)]


def motion_of(subdivisions: int) -> LinearMotion:
    """Return the motion of ten runs."""
    document: Any = copy.deepcopy(load("fe_rigid").document)
    document["blocks"]["rotor"]["parameters"]["subdivisions"] = subdivisions
    diagram = load(document)
    model = compile_diagram(diagram)
    p = np.array([model.parameter_vector({"speed": speed}) for speed in SPEEDS])
    equations = Equations(model, [*OUTPUTS, "controller.current[1]", "controller.current[2]"], diagram.free, p)
    count = len(SPEEDS)
    return LinearMotion(equations, p, SPEEDS, ORDERS, np.ones(count), np.zeros(count))


def evaluate(response: Response) -> np.ndarray:
    """Return the derivatives of all outputs, as every step of a fit needs them."""
    return response.sensitivity(response.states())


def main() -> int:
    """Print seconds of CPU for one evaluation, and ratios of the same run."""
    actions: dict[str, Any] = {}
    states = {}
    for subdivisions in SUBDIVISIONS:
        motion = motion_of(subdivisions)
        theta = motion.equations.theta0
        states[subdivisions] = motion.equations.n
        motion.condensed(theta)  # the ports are opened once
        for name, response in (("whole", motion.response), ("ports", motion.condensed)):
            actions[f"{name}{subdivisions}"] = lambda response=response, theta=theta: evaluate(response(theta))
    with threadpool_limits(1, "blas"):
        found = medians(actions)
    print(f"fe_rigid, {len(SPEEDS)} runs, {ORDERS} orders, response and derivatives by all free parameters")
    for subdivisions in SUBDIVISIONS:
        whole, ports = found[f"whole{subdivisions}"], found[f"ports{subdivisions}"]
        grown = ports / found[f"ports{SUBDIVISIONS[0]}"]
        print(
            f"{states[subdivisions]:4} states: by ports 1/{whole / ports:.0f} of the CPU time by all states; "
            f"{grown:.2f} times that of {states[SUBDIVISIONS[0]]} states by ports"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
