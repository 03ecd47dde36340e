"""An actuator that takes whole steps only, which NumPy simulates: named and measured, though nobody records it."""

from __future__ import annotations

import math

import jsonschema
import pytest

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.files import diagnosis_data, diagnosis_schema
from rotorsim.model.load import load
from tests.diagnosis.evidence.waveform.level_control import CONTROL, controlled, made

STEP = 0.5  # of what the actuator takes, whose gain is 2


def rounded(value: float) -> float:
    return STEP * math.floor(value / STEP + 0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("at", "steps"),
    [
        ("taken", {"control.output": STEP, "actuator.output": 2 * STEP}),  # which no data tell apart
        ("read", {"the reading of level.output": STEP}),
    ],
)
def test_steps_are_named_where_they_are(at, steps):
    found = diagnose(load(CONTROL), made([controlled(seed, **{at: rounded}) for seed in (1, 2, 3)], 50), workers=1)
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.physics == "quantisation"
    assert {spot.words for spot in effect.spots} == steps.keys()
    there = effect.spot_of("quantisation").words
    interval = found.after.values["quantisation.interval"]
    assert interval == pytest.approx(steps[there], rel=1 / 200)  # the width of an edge
    assert found.score_after.total < 0.4 * found.score_before.total
    assert [item.what for item in found.warnings] == [effect.candidate.insertion.fault.convention]
    jsonschema.Draft202012Validator(diagnosis_schema()).validate(diagnosis_data(found))


@pytest.mark.slow
def test_steps_in_readings_that_pass_for_noise_are_seen():
    """FAULT: 30 levels, seen by none of the first starts: consistent, with a noise of step / sqrt(12)."""
    step = 0.15
    runs = [controlled(seed, read=lambda value: step * math.floor(value / step + 0.5)) for seed in (1, 2, 3)]
    found = diagnose(load(CONTROL), made(runs, 50), workers=1)
    [effect] = found.effects
    assert (found.verdict, effect.physics, effect.spot_of("quantisation").words) == (
        "missing_physics",
        "quantisation",
        "the reading of level.output",
    )
    assert found.after.values["quantisation.interval"] == pytest.approx(step, rel=1 / 200)
    assert found.score_after.total < 0.25 * found.score_before.total


@pytest.mark.slow
def test_without_steps_there_are_none():
    found = diagnose(load(CONTROL), made([controlled(seed) for seed in (1, 2, 3)], 50), workers=1)
    assert found.verdict == "consistent"
