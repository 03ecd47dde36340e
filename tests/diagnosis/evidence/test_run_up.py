"""Run-ups as evidence: what is missing is named, and nothing where nothing is, on rotors by matrix exponentials."""

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.model.load import load
from tests.identification.run_up import RATE, Machine, runs_of

PHYSICS = ("residual_bow", "anisotropic_support", "seal_cross_coupling")

pytestmark = pytest.mark.slow


def test_nothing_is_found_where_nothing_is_hidden():
    found = diagnose(load("jeffcott"), runs_of(Machine(), 5, 1.5), physics=PHYSICS, workers=1)
    assert found.verdict == "consistent"
    assert found.effects == ()


def test_pulses_on_samples_are_no_missing_physics():
    """FAULT: what all of them were late by was named a runout."""
    fine = runs_of(Machine(), 5, 1.5)
    runs = tuple(replace(run, tacho=np.ceil(run.tacho * RATE) / RATE) for run in fine.runs)
    found = diagnose(load("jeffcott"), replace(fine, runs=runs), physics=("runout", "residual_bow"), workers=1)
    assert found.verdict == "consistent"


def test_a_bow_is_found_with_its_size_and_angle():
    found = diagnose(load("jeffcott"), runs_of(Machine(bow=1.6e-6), 6, 1.5), physics=PHYSICS, workers=1)
    assert found.verdict == "missing_physics"
    assert [effect.candidate.insertion.physics for effect in found.effects] == ["residual_bow"]
    assert found.after.values["residual_bow.amplitude"] == pytest.approx(1.6e-6, rel=0.02)
    assert found.after.values["residual_bow.phase"] % (2 * np.pi) == pytest.approx(1.2, abs=0.02)
