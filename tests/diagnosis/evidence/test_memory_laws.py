"""Memory in oscillators and servos that NumPy simulates: named, located, sized; and nothing where nothing is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from tests.diagnosis.evidence.machines import recording

RATE, SAMPLES, FINE = 200, 1500, 20
NOISE = {"speed": 4e-3, "position": 1e-3}
OSCILLATOR = {  # x'' = u - 12 x' - 90 (what acts on the spring)
    "schema_version": 1,
    "name": "oscillator",
    "blocks": {
        "drive": {"type": "recorded", "parameters": {"interpolation": "hold"}},
        "force": {"type": "sum", "parameters": {"signs": "+--"}},
        "damper": {"type": "gain", "parameters": {"gain": 9.0}},
        "spring": {"type": "gain", "parameters": {"gain": 70.0}},
        "speed": {"type": "integrator"},
        "position": {"type": "integrator"},
    },
    "wires": [
        ["drive.output", "force.input1"],
        ["damper.output", "force.input2"],
        ["spring.output", "force.input3"],
        ["force.output", "speed.input"],
        ["speed.output", "damper.input"],
        ["speed.output", "position.input"],
        ["position.output", "spring.input"],
    ],
    "solver": {"method": "rk4", "step": "1 ms", "stop": "1 s"},
    "record": ["speed.output", "position.output"],
    "identify": {"damper.gain": {"low": 0.0}, "spring.gain": {"low": 0.0}},
}


def simulated(seed: int, *, gap: float = 0.0, slider: float = 0.0) -> dict[str, np.ndarray]:
    """Return a run by midpoint steps a twentieth of a sample long.

    gap: full width of the play between mass and spring. slider: force at which a second spring of 60 begins to slide.
    """
    random = np.random.default_rng(seed)
    drive = np.repeat(random.uniform(-1, 1, SAMPLES // 20) * 80, 20)
    v = x = 0.0
    behind, slid = 0.0, 0.0  # the spring's end behind the play; force of the slider
    out, h = np.empty((SAMPLES, 2)), 1 / RATE / FINE

    def rate(u: float, v: float, x: float) -> float:
        held = min(max(behind, x - gap / 2), x + gap / 2)
        return u - 12.0 * v - 90.0 * held - min(max(slid + 60.0 * (x - before), -slider), slider)

    for k, u in enumerate(drive.tolist()):
        out[k] = v, x
        for _ in range(FINE):
            before = x
            middle = v + h / 2 * rate(u, v, x)
            x, v = x + h * middle, v + h * rate(u, middle, x + h / 2 * v)
            behind = min(max(behind, x - gap / 2), x + gap / 2)
            slid = min(max(slid + 60.0 * (x - before), -slider), slider)
    noisy = {
        name: column + random.normal(size=SAMPLES) * NOISE[name] for name, column in zip(NOISE, out.T, strict=True)
    }
    return {"drive": drive, **noisy}


def made(runs: list[dict[str, np.ndarray]], rate: float) -> Recording:
    """Return runs as a recording, the last one held out."""
    uses = ["identify"] * (len(runs) - 1) + ["hold_out"]
    return recording(list(zip(runs, uses, strict=True)), {name: (f"{name}.output", "1") for name in runs[0]}, rate)


def oscillating(**missing: float) -> Recording:
    return made([simulated(seed, **missing) for seed in (1, 2, 3)], RATE)


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


def controlled(seed: int, limit: float) -> dict[str, np.ndarray]:
    """Return a run of 800 samples of the control by midpoint steps; its integral stays within the limits."""
    random = np.random.default_rng(seed)
    reference = np.repeat(random.uniform(-1, 1, 8) * 4, 100)
    y = z = 0.0
    out, h = np.empty((800, 2)), 1 / 50 / FINE

    def rate(r: float, y: float, z: float) -> float:
        return 2.0 * (1.5 * (r - y) + 4.0 * z) - y

    for k, r in enumerate(reference.tolist()):
        out[k] = 1.5 * (r - y) + 4.0 * z, y
        for _ in range(FINE):
            middle = y + h / 2 * rate(r, y, z)
            z_middle = min(max(z + h / 2 * (r - y), -limit), limit)
            y, z = y + h * rate(r, middle, z_middle), min(max(z + h * (r - middle), -limit), limit)
    noisy = out + random.normal(size=out.shape) * (5e-3, 2e-3)
    return {"reference": reference, "control": noisy[:, 0], "level": noisy[:, 1]}


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.4, math.inf])
def test_an_integral_that_overflows_is_found_and_no_other(limit):
    runs = [controlled(seed, limit) for seed in (1, 2, 3)]
    found = diagnose(load(CONTROL), made(runs, 50), workers=1)
    if math.isinf(limit):
        assert found.verdict == "consistent"
        assert not found.effects
        return
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.physics == "integrator_limit"
    assert {str(spot) for spot, _ in found.places} == {"integral.output"}
    values = found.after.values
    assert math.isclose(values["integral.upper"], 0.4, rel_tol=0.02)
    assert math.isclose(values["integral.lower"], -0.4, rel_tol=0.02)
    assert math.isclose(values["actuator.gain"], 2.0, rel_tol=0.02)


def sizes(found: Diagnosis) -> dict[str, float]:
    """Return the parameters of the effect and of the diagram, by their last names."""
    return {
        name.removeprefix(f"{found.effects[0].candidate.insertion.name}."): v for name, v in found.after.values.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("physics", "missing", "near"), [("play", {"gap": 0.4}, 0.03), ("hysteresis", {"slider": 12.0}, 0.05)]
)
def test_memory_at_the_spring_is_named_and_measured(physics, missing, near):
    """Play between mass and spring; or dry friction of 12 behind a spring of 60, 24 / 60 wide, beside the spring."""
    found = diagnose(load(OSCILLATOR), oscillating(**missing), workers=1)
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.physics == physics
    assert {str(spot) for spot, _ in found.places} <= {"position.output", "spring.output"}
    values = sizes(found)
    gain = {"position.output": 1.0, "spring.output": values["spring.gain"]}[str(found.places[0][0])]
    assert math.isclose(values["width"] / gain, 0.4, rel_tol=near)
    assert math.isclose(values["spring.gain"], 90.0, rel_tol=0.4 * near)
    if physics == "hysteresis":
        assert math.isclose(-values["share"] * values["spring.gain"], 60.0, rel_tol=0.05)
    assert found.score_after.total < 0.2 * found.score_before.total


@pytest.mark.slow
def test_no_memory_is_found_where_there_is_none():
    found = diagnose(load(OSCILLATOR), oscillating(), workers=1)
    assert found.verdict == "consistent"
    assert not found.effects
