"""Recordings made for the tests: a rotor with a magnetic bearing, as an instrument would write it."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.recording import Recording

SHARED = Path(__file__).resolve().parents[3] / "shared" / "recordings"
CHANNELS = {
    "x": {"signal": "rotor.displacement", "axis": "x", "unit": "m"},
    "y": {"signal": "rotor.displacement", "axis": "y", "unit": "m"},
    "ix": {"signal": "controller.current", "axis": "x", "unit": "A"},
    "iy": {"signal": "controller.current", "axis": "y", "unit": "A"},
}
RATE = 5000.0
SPEED = 2 * np.pi * 25.3


def samples(speed: float = SPEED, seed: int = 0, n: int = 5000) -> dict[str, np.ndarray]:
    """Return good data: an elliptic orbit with a second harmonic and noise, and the current of a PD controller."""
    noise = np.random.default_rng(seed)
    time = np.arange(n) / RATE
    angle = speed * time + 0.3
    x = 2e-5 * np.cos(angle) + 4e-6 * np.cos(2 * angle) + noise.normal(0, 3e-8, n)
    y = 1.4e-5 * np.sin(angle) - 3e-6 * np.sin(2 * angle) + noise.normal(0, 3e-8, n) - 1e-5
    vx = -2e-5 * speed * np.sin(angle)
    vy = 1.4e-5 * speed * np.cos(angle)
    ix = 12200 * x + 3 * vx + noise.normal(0, 2e-4, n)
    iy = 12200 * y + 3 * vy + noise.normal(0, 2e-4, n)
    return {"x": x, "y": y, "ix": ix, "iy": iy}


def pulses(speed: float = SPEED, n: int = 5000) -> list[float]:
    turns = np.arange(1, int((speed * (n - 1) / RATE + 0.3) / (2 * np.pi)) + 1)
    return ((2 * np.pi * turns - 0.3) / speed).tolist()


def run(**changes: Any) -> dict[str, Any]:
    """Return the entry of a run; None removes a key."""
    entry = {
        "id": "run1",
        "file": "run1.npz",
        "sample_rate": "5000 Hz",
        "speed": SPEED,
        "tacho": pulses(),
        "set": {"controller.KP": 12200.0},
    }
    return {key: value for key, value in (entry | changes).items() if value is not None}


def document(*runs: dict[str, Any], **changes: Any) -> dict[str, Any]:
    data = {"name": "made", "source": "made for a test", "channels": CHANNELS, "runs": list(runs) or [run()]}
    return {key: value for key, value in (data | changes).items() if value is not None}


def write(folder: Path, data: Any, tables: dict[str, dict[str, np.ndarray]] | None = None) -> Path:
    """Write recording.json, and tables as .npz (default: good data for every run)."""
    folder.mkdir(exist_ok=True)
    (folder / "recording.json").write_text(data if isinstance(data, str) else json.dumps(data, indent=1))
    if tables is None:
        tables = {entry["file"]: samples(entry.get("speed", 0.0), k) for k, entry in enumerate(data["runs"])}
    for file, table in tables.items():
        np.savez(folder / file, **table)
    return folder


def load(folder: Path, data: Any, tables: dict[str, dict[str, np.ndarray]] | None = None) -> Recording:
    return load_recording(write(folder, data, tables))
