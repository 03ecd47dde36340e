"""An actuator that takes whole steps only, which NumPy simulates: named and measured, though nobody records it."""

from __future__ import annotations

import jsonschema
import numpy as np
import pytest

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.files import diagnosis_data, diagnosis_schema
from rotorsim.model.load import load
from tests.diagnosis.evidence.test_memory_laws import CONTROL, FINE, made

STEP = 0.5  # of what the actuator takes, whose gain is 2


def controlled(seed: int, at: str) -> dict[str, np.ndarray]:
    """Return a run of 800 samples of the control by midpoint steps; at: "actuator", or only the "reading" has steps."""
    random = np.random.default_rng(seed)
    reference = np.repeat(random.uniform(-1, 1, 8) * 4, 100)
    y = z = 0.0
    out, h = np.empty((800, 2)), 1 / 50 / FINE

    def rate(r: float, y: float, z: float) -> float:
        u = 1.5 * (r - y) + 4.0 * z
        return 2.0 * (STEP * np.floor(u / STEP + 0.5) if at == "actuator" else u) - y

    for k, r in enumerate(reference.tolist()):
        out[k] = 1.5 * (r - y) + 4.0 * z, STEP * np.floor(y / STEP + 0.5) if at == "reading" else y
        for _ in range(FINE):
            middle, z_middle = y + h / 2 * rate(r, y, z), z + h / 2 * (r - y)
            y, z = y + h * rate(r, middle, z_middle), z + h * (r - middle)
    noisy = out + random.normal(size=out.shape) * (5e-3, 2e-3)
    return {"reference": reference, "control": noisy[:, 0], "level": noisy[:, 1]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("at", "steps"),
    [
        ("actuator", {"control.output": STEP, "actuator.output": 2 * STEP}),  # which no data tell apart
        ("reading", {"the reading of level.output": STEP}),
    ],
)
def test_steps_are_named_where_they_are(at, steps):
    found = diagnose(load(CONTROL), made([controlled(seed, at) for seed in (1, 2, 3)], 50), workers=1)
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.physics == "quantisation"
    assert {spot.words for spot, _ in effect.places} == steps.keys()
    there = effect.spot_of("quantisation").words
    assert found.after.values["quantisation.interval"] == pytest.approx(steps[there], rel=5e-3)
    assert found.score_after.total < 0.4 * found.score_before.total
    jsonschema.Draft202012Validator(diagnosis_schema()).validate(diagnosis_data(found))
