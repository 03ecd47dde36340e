"""Order vectors of a run-up as a monitoring system would export them: two modes by SciPy, nothing of the product."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

RPM = np.pi / 30
TRUTH = {  # a disc of 1 kg: e [m], phase [rad], stiffness [N/m] and damping [N s/m] along x and y
    "unbalance.eccentricity": 2e-6,
    "unbalance.phase": 0.6,
    "rotor.stiffness": 28e3,
    "rotor.viscous_damping": 8.0,
}
SLOW_ROLL = 1.5e-6 * np.exp(-2.0j)
ROTOR: dict[str, Any] = {
    "schema_version": 1,
    "name": "disc",
    "parameters": {"speed": "1600 rpm"},
    "blocks": {
        "clock": {"type": "clock", "parameters": {"speed": "$speed"}},
        "unbalance": {"type": "unbalance", "parameters": {"mass": 1.0, "eccentricity": 2.6e-6, "phase": 0.3}},
        "rotor": {"type": "rotor_2dof", "parameters": {"mass": 1.0, "stiffness": 27e3, "viscous_damping": 11.0}},
    },
    "wires": [
        ["clock.theta", "unbalance.theta"],
        ["clock.speed", "unbalance.speed"],
        ["clock.acceleration", "unbalance.acceleration"],
        ["unbalance.force", "rotor.force"],
    ],
    "identify": {name: {} for name in TRUTH},
    "solver": {"method": "rk4", "step": "0.1 ms", "stop": "1 s"},
}
CHANNEL = {"signal": "rotor.displacement", "axis": "x", "unit": "um", "amplitude": "amp", "phase": "ph"}


def passage(
    start: float, rate: float, turns: int, *, rows: int = 90, skip: int = 0, truth: dict[str, float] = TRUTH
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return speed [rpm], time [s] of the middle and 1X [m] of rows of ``turns`` turns, every 1 + skip-th one.

    The speed [rpm] is start + rate t [rpm/s] and the shaft turned on before for 2.5 s; truth: of a disc of 1 kg.
    """
    W0, a, m = start * RPM, rate * RPM, 1.0
    e, phase, k, c = truth.values()

    def angle(t: Any) -> Any:
        return W0 * t + a * t**2 / 2

    def rhs(t: float, x: np.ndarray) -> list[float]:
        W, b = W0 + a * t, angle(t) + phase
        return [x[1], e * (W**2 * np.cos(b) + a * np.sin(b)) - c / m * x[1] - k / m * x[0]]

    count = turns * rows * (1 + skip)
    ends = (np.sqrt(W0**2 + 2 * a * 2 * np.pi * turns * np.arange(count // turns + 1)) - W0) / a
    found = solve_ivp(rhs, (-2.5, ends[-1]), [0.0, 0.0], "DOP853", dense_output=True, rtol=1e-8, atol=1e-13)
    begin = 2 * np.pi * turns * np.arange(0, count // turns, 1 + skip)
    theta = begin[:, None] + 2 * np.pi * np.arange(400 * turns) / 400 + np.pi / 400  # midpoint rule
    time = (np.sqrt(W0**2 + 2 * a * theta) - W0) / a
    x = found.sol(time.ravel())[0].reshape(time.shape)
    vectors = 2 * (x * np.exp(-1j * theta)).mean(axis=1)
    from_, to = ends[: count // turns : 1 + skip], ends[1 :: 1 + skip]
    return 2 * np.pi * turns / (to - from_) / RPM, (from_ + to) / 2, vectors


def noisy(vectors: np.ndarray, sigma: float, seed: int = 1) -> np.ndarray:
    """Return vectors with slow roll and white noise, sigma [m] in real and imaginary part."""
    random = np.random.default_rng(seed)
    return vectors + SLOW_ROLL + sigma * (random.normal(size=len(vectors)) + 1j * random.normal(size=len(vectors)))


def write(folder: Path, speed: np.ndarray, vectors: np.ndarray, *, time: np.ndarray | None = None, **keys: Any) -> Path:
    """Write a recording of one run; keys: of recording.json, "turns" of the run, "words" (amplitude, phase)."""
    amplitude, phase = keys.pop("words", ("0-peak", "lead"))
    size = np.abs(vectors) * 1e6 * {"0-peak": 1, "peak-peak": 2, "rms": 1 / np.sqrt(2)}[amplitude]
    angle = np.degrees(np.angle(vectors)) * {"lead": 1, "lag": -1}[phase]
    columns = {"rpm": speed, "amp": size, "ph": angle, **({} if time is None else {"t": time})}
    folder.mkdir(exist_ok=True)
    rows = [",".join(columns), *(",".join(f"{x:.9g}" for x in row) for row in zip(*columns.values(), strict=True))]
    (folder / "up.csv").write_text("\n".join(rows) + "\n")
    run = {"id": "up", "file": "up.csv", "speed": "rpm", "turns": keys.pop("turns", 1)}
    run |= {} if time is None else {"time": "t"}
    document = {"kind": "orders", "name": "disc", "source": "made by SciPy", "amplitude": amplitude, "phase": phase}
    document |= {"channels": {"x 1X": CHANNEL}, "runs": [run], **keys}
    (folder / "recording.json").write_text(json.dumps(document, indent=1))
    return folder
