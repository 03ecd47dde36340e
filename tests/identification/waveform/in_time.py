"""An oscillator drawn from elementary blocks, and what it would record, by matrix exponentials."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from rotorsim.errors import Place
from rotorsim.recordings.recording import Channel, Recording, Run

TRUTH = {"inverse_mass.gain": 1.0, "damper.gain": 2.0, "spring.gain": 400.0}
RATE = 200.0
OSCILLATOR: dict[str, Any] = {
    "schema_version": 1,
    "name": "oscillator",
    "blocks": {
        "drive": {"type": "recorded", "parameters": {"interpolation": "linear"}},
        "force": {"type": "sum", "parameters": {"signs": "+--"}},
        "inverse_mass": {"type": "gain", "parameters": {"gain": 0.9}},
        "velocity": {"type": "integrator"},
        "position": {"type": "integrator"},
        "damper": {"type": "gain", "parameters": {"gain": 2.5}},
        "spring": {"type": "gain", "parameters": {"gain": 380.0}},
    },
    "wires": [
        ["drive.output", "force.input1"],
        ["damper.output", "force.input2"],
        ["spring.output", "force.input3"],
        ["force.output", "inverse_mass.input"],
        ["inverse_mass.output", "velocity.input"],
        ["velocity.output", "position.input"],
        ["velocity.output", "damper.input"],
        ["position.output", "spring.input"],
    ],
    "record": ["position.output"],
    "identify": {name: {"low": 0.0} for name in TRUTH},
}
CHANNELS = {
    "u": Channel("u", "drive.output", None, None, None, "N"),
    "q": Channel("q", "position.output", None, None, None, "m"),
    "v": Channel("v", "velocity.output", None, None, None, "m/s"),
}


def motion(time: np.ndarray, u: np.ndarray, start: Sequence[float]) -> np.ndarray:
    """Return position and velocity (n, 2) of the true oscillator; u goes along straight lines between instants."""
    m, c, k = TRUTH.values()
    A = np.zeros((4, 4))  # position, velocity, u, slope of u
    A[0, 1], A[1], A[2, 3] = 1.0, [-k * m, -c * m, m, 0.0], 1.0
    x, out, steps = np.array([*start, 0.0, 0.0]), [], {}
    for i, at in enumerate(time):
        out.append(x[:2].copy())
        if i + 1 < len(time):
            h = round(time[i + 1] - at, 14)
            x[2:] = u[i], (u[i + 1] - u[i]) / h
            if h not in steps:
                steps[h] = expm(A * h)
            x = steps[h] @ x
    return np.array(out)


def pushes(time: np.ndarray, seed: int) -> np.ndarray:
    """Return a smooth force: twelve lines below 8 Hz."""
    rng = np.random.default_rng(seed)
    f = rng.uniform(0.3, 8.0, 12)
    return 20 * np.sin(2 * np.pi * np.outer(time, f) + rng.uniform(0, 7, 12)).sum(axis=1)


def coloured(n: int, rng: np.random.Generator, dt: float = 1 / RATE) -> np.ndarray:
    """Return noise of unit variance: white, first order below 2 Hz, and 50 Hz pick-up."""
    a = np.exp(-dt * 2 * np.pi * 2)
    slow = lfilter([np.sqrt(1 - a * a)], [1, -a], rng.normal(size=n + 500))[500:]
    hum = np.sqrt(2) * np.sin(2 * np.pi * 50.3 * np.arange(n) * dt + rng.uniform(0, 7))
    return (0.8 * rng.normal(size=n) + 0.5 * slow + 0.33 * hum) / np.sqrt(0.64 + 0.25 + 0.11)


def run_of(
    name: str, time: np.ndarray, values: Mapping[str, np.ndarray], use: str = "identify", **settings: Any
) -> Run:
    return Run(name, f"{name}.csv", time, dict(values), None, None, settings, use, Place("recording.json", 9, 5))


def measured(name: str, seed: int, time: np.ndarray, noise: float = 0.0, use: str = "identify") -> Run:
    """Return a run of force and position; noise: of the position's standard deviation."""
    rng = np.random.default_rng(seed + 1000)
    u = pushes(time, seed)
    x = motion(time, u, rng.normal(size=2) * [0.05, 1.0])
    q = x[:, 0] + noise * x[:, 0].std() * coloured(len(time), rng)
    return run_of(name, time, {"u": u, "q": q}, use)


def recording(*runs: Run, columns: Sequence[str] = ("u", "q")) -> Recording:
    return Recording("bench", "made for a test", Path("bench"), {c: CHANNELS[c] for c in columns}, runs)


def even(n: int) -> np.ndarray:
    return np.arange(n) / RATE
