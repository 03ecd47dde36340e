"""What is missing in a wire of a servo that NumPy simulates: named, located, sized; and nothing where nothing is."""

from __future__ import annotations

import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from rotorsim import load_recording
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.files import diagnosis_data, diagnosis_schema
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from rotorsim.report.diagnosis.report import save_report

RATE, SAMPLES, FINE = 200, 2000, 20
NOISE = {"speed": 4e-3, "angle": 2e-3}
SERVO = {  # J w' = k sat(u) - b w,  u = K (r - a),  a' = w
    "schema_version": 1,
    "name": "servo",
    "blocks": {
        "reference": {"type": "recorded", "parameters": {"interpolation": "hold"}},
        "error": {"type": "sum", "parameters": {"signs": "+-"}},
        "controller": {"type": "gain", "parameters": {"gain": 12.0}},
        "torque": {"type": "sum", "parameters": {"signs": "+-"}},
        "friction": {"type": "gain", "parameters": {"gain": 5.0}},
        "speed": {"type": "integrator"},
        "angle": {"type": "integrator"},
    },
    "wires": [
        ["reference.output", "error.input1"],
        ["angle.output", "error.input2"],
        ["error.output", "controller.input"],
        ["controller.output", "torque.input1"],
        ["friction.output", "torque.input2"],
        ["torque.output", "speed.input"],
        ["speed.output", "friction.input"],
        ["speed.output", "angle.input"],
    ],
    "solver": {"method": "rk4", "step": "1 ms", "stop": "1 s"},
    "record": ["speed.output", "angle.output"],
    "identify": {"friction.gain": {"low": 0.0}},
}


def simulated(
    seed: int, size: int = SAMPLES, *, limit: float = math.inf, dry: float = 0.0, still: bool = False
) -> dict[str, np.ndarray]:
    """Return a run by midpoint steps a twentieth of a sample long: their error is far below the noise."""
    random = np.random.default_rng(seed)
    reference = np.repeat(random.uniform(-1, 1, -(-size // 100)), 100)[:size] * (not still)
    w = a = 0.0
    out = np.empty((size, 2))
    h = 1 / RATE / FINE

    def rate(r: float, w: float, a: float) -> float:
        return max(min(12.0 * (r - a), limit), -limit) - 4.4 * w - dry * math.tanh(w / 0.01)

    for k, r in enumerate(reference.tolist()):
        out[k] = w, a
        for _ in range(FINE):
            middle = w + h / 2 * rate(r, w, a)
            a, w = a + h * middle, w + h * rate(r, middle, a + h / 2 * w)
    noisy = {name: column + random.normal(size=size) * NOISE[name] for name, column in zip(NOISE, out.T, strict=True)}
    return {"reference": reference, **noisy}


def recording(folder: Path, *sizes: int, **missing: float) -> Recording:
    channels = {name: {"signal": f"{name}.output", "unit": "1"} for name in ("reference", "speed", "angle")}
    runs = []
    for seed, size in enumerate(sizes or (SAMPLES, SAMPLES), 1):
        np.savez(folder / f"run{seed}.npz", **simulated(seed, size, **missing))
        runs.append({"id": f"run{seed}", "file": f"run{seed}.npz", "sample_rate": f"{RATE} Hz", "use": "identify"})
    (folder / "recording.json").write_text(
        json.dumps({"name": "servo", "source": "NumPy", "channels": channels, "runs": runs})
    )
    return load_recording(folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("missing", "physics", "places", "values"),
    [
        ({"limit": 4.0}, "saturation", {"controller.output": 1.0, "error.output": 12.0}, {"upper": 4.0, "lower": -4.0}),
        ({"dry": 0.4}, "dry_friction", {"friction.output": 1.0}, {"level": 0.4}),
    ],
)
def test_what_a_wire_hides_is_named_located_and_sized(tmp_path, missing, physics, places, values):
    found = diagnose(load(SERVO), recording(tmp_path, **missing), workers=1)
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.physics == physics
    size = places[str(found.spots[0])]  # a gain that is known lies between places that no data separate
    fit = found.after
    names = [item.name for item in fit.free]
    for key, value in values.items():
        j = names.index(f"{effect.candidate.insertion.name}.{key}")
        assert abs(size * fit.theta[j] - value) < max(4 * size * fit.std(j), 0.01 * abs(value))
    j = names.index("friction.gain")
    assert abs(fit.theta[j] - 4.4) < max(4 * fit.std(j), 0.01 * 4.4)
    [signal] = found.signals
    assert (signal.physics, signal.place) == (physics, found.spots[0])
    data = json.loads(json.dumps(diagnosis_data(found), allow_nan=False))
    jsonschema.Draft202012Validator(diagnosis_schema()).validate(data)
    [written] = data["signals"]
    assert {len(written[name]) for name in ("time", "signal", "std", "over_values", "law")} == {200}
    names = {file.name for file in save_report(found, tmp_path)}
    assert {"traces.png", "residuals.png", "missing_signal.png"} <= names


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_hidden(tmp_path):
    found = diagnose(load(SERVO), recording(tmp_path), workers=1)
    assert found.verdict == "consistent"
    assert not found.effects
    assert found.signals == ()
    names = {file.name for file in save_report(found, tmp_path)}
    assert "residuals.png" in names
    assert "missing_signal.png" not in names


def test_a_place_says_which_side_of_a_signal_is_meant():
    assert Spot("sensor", "output").words == "sensor.output"
    assert Spot("sensor", "output", side="reading").words == "the reading of sensor.output"
    assert Spot("sensor", "output", side="both").words == "sensor.output, its reading too"
