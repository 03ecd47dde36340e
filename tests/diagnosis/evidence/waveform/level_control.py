"""A level under PI control that NumPy simulates, with what may be wrong in one of its wires."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rotorsim.recordings.recording import Recording
from tests.diagnosis.evidence.waveform.machines import recording

FINE = 20  # midpoint steps in a sample
CONTROL = {  # y' = 2 u - y,  u = 1.5 e + 4 z,  z' = e = r - y, which overflows
    "schema_version": 1,
    "name": "control",
    "blocks": {
        "reference": {"type": "recorded", "parameters": {"interpolation": "hold"}},
        "error": {"type": "sum", "parameters": {"signs": "+-"}},
        "proportional": {"type": "gain", "parameters": {"gain": 1.5}},
        "integral": {"type": "integrator"},
        "share": {"type": "gain", "parameters": {"gain": 4.0}},
        "control": {"type": "sum", "parameters": {"signs": "++"}},
        "actuator": {"type": "gain", "parameters": {"gain": 1.5}},
        "loss": {"type": "gain", "parameters": {"gain": 1.5}},
        "rate": {"type": "sum", "parameters": {"signs": "+-"}},
        "level": {"type": "integrator"},
    },
    "wires": [
        ["reference.output", "error.input1"],
        ["level.output", "error.input2"],
        ["error.output", "proportional.input"],
        ["error.output", "integral.input"],
        ["integral.output", "share.input"],
        ["proportional.output", "control.input1"],
        ["share.output", "control.input2"],
        ["control.output", "actuator.input"],
        ["actuator.output", "rate.input1"],
        ["loss.output", "rate.input2"],
        ["rate.output", "level.input"],
        ["level.output", "loss.input"],
    ],
    "solver": {"method": "rk4", "step": "1 ms", "stop": "1 s"},
    "record": ["control.output", "level.output"],
    "identify": {"actuator.gain": {"low": 0.0}, "loss.gain": {"low": 0.0}},
}


def same(value: float) -> float:
    return value


def controlled(
    seed: int,
    *,
    overflow: float = math.inf,
    fed_back: Callable[[float], float] = same,
    taken: Callable[[float], float] = same,
    read: Callable[[float], float] = same,
) -> dict[str, np.ndarray]:
    """Return a run of 800 samples of the control.

    overflow: limit of its integral. fed_back: what its error takes of the level; taken: what the actuator takes of the
    control; read: what is recorded of the level.
    """
    random = np.random.default_rng(seed)
    reference = np.repeat(random.uniform(-1, 1, 8) * 4, 100)
    y = z = 0.0
    out, h = np.empty((800, 2)), 1 / 50 / FINE

    def error(r: float, y: float) -> float:
        return r - fed_back(y)

    def rate(r: float, y: float, z: float) -> float:
        return 2.0 * taken(1.5 * error(r, y) + 4.0 * z) - y

    def within(z: float) -> float:
        return min(max(z, -overflow), overflow)

    for k, r in enumerate(reference.tolist()):
        out[k] = 1.5 * error(r, y) + 4.0 * z, read(y)
        for _ in range(FINE):
            middle, z_middle = y + h / 2 * rate(r, y, z), within(z + h / 2 * error(r, y))
            y, z = y + h * rate(r, middle, z_middle), within(z + h * error(r, middle))
    noisy = out + random.normal(size=out.shape) * (5e-3, 2e-3)
    return {"reference": reference, "control": noisy[:, 0], "level": noisy[:, 1]}


def made(runs: list[dict[str, np.ndarray]], rate: float) -> Recording:
    """Return runs as a recording, the last one held out."""
    uses = ["identify"] * (len(runs) - 1) + ["hold_out"]
    return recording(list(zip(runs, uses, strict=True)), {name: (f"{name}.output", "1") for name in runs[0]}, rate)
