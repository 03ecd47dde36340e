"""A diagram of very many elementary blocks: a ring of first-order cells x_i' = sin(x_{i-1}) - a_i x_i.

Five blocks a cell: integrator, gain, trigonometric, sum, gain; one sine drives the ring.
"""

from __future__ import annotations

from typing import Any

PER_CELL = 5


def ring(blocks: int) -> dict[str, Any]:
    """Return a diagram of ``blocks`` elementary blocks (a multiple of five) as JSON."""
    cells = blocks // PER_CELL
    found: dict[str, Any] = {}
    wires = []
    for i in range(cells):
        before = (i - 1) % cells
        decay = f"decay{i}"
        found[f"state{i}"] = {"type": "integrator", "parameters": {"initial": 1.0 if i % 7 == 0 else 0.0}}
        found[decay] = {"type": "gain", "parameters": {"gain": 1.0 + 0.001 * i}}
        found[f"wave{i}"] = {"type": "trigonometric", "parameters": {"function": "sin"}}
        found[f"coupling{i}"] = {"type": "gain", "parameters": {"gain": 0.5}}
        found[f"rate{i}"] = {"type": "sum", "parameters": {"signs": "+-"}}
        wires += [
            [f"state{before}.output", f"wave{i}.input"],
            [f"wave{i}.output", f"coupling{i}.input"],
            [f"coupling{i}.output", f"rate{i}.input1"],
            [f"state{i}.output", f"{decay}.input"],
            [f"{decay}.output", f"rate{i}.input2"],
            [f"rate{i}.output", f"state{i}.input"],
        ]
    return {
        "schema_version": 1,
        "name": f"ring_{blocks}",
        "blocks": found,
        "wires": wires,
        "solver": {"method": "rk4", "step": "1 ms", "stop": "1 s"},
        "record": ["state0.output", f"state{cells - 1}.output"],
    }
