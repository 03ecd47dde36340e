"""Memory in oscillators and servos that NumPy simulates: named, located, sized; and nothing where nothing is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from tests.diagnosis.evidence.waveform.level_control import CONTROL, controlled, made

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


def oscillating(**missing: float) -> Recording:
    return made([simulated(seed, **missing) for seed in (1, 2, 3)], RATE)


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.4, math.inf])
def test_an_integral_that_overflows_is_found_and_no_other(limit):
    runs = [controlled(seed, overflow=limit) for seed in (1, 2, 3)]
    found = diagnose(load(CONTROL), made(runs, 50), workers=1)
    if math.isinf(limit):
        assert found.verdict == "consistent"
        assert not found.effects
        return
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.physics == "integrator_limit"
    assert {str(spot) for spot in found.spots} == {"integral.output"}
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
    assert {str(spot) for spot in found.spots} <= {"position.output", "spring.output"}
    values = sizes(found)
    gain = {"position.output": 1.0, "spring.output": values["spring.gain"]}[str(found.spots[0])]
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
