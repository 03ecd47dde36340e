"""Mains hum in what is recorded: said, and fitted beside the harmonics; orders on which it falls count less."""

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.identification.identification import identify
from rotorsim.signals.pickup import check_harmonics
from tests.identification import TRUTH, recorded, shipped
from tests.identification.test_likelihood import two_gains, with_noise

TURN = 2 * np.pi
SPEEDS = TURN * np.array([10.0, 16.7, 23.1])  # order 5 of the first is 50 Hz, order 3 of the second 50.1


@pytest.fixture(scope="module")
def clean():
    return two_gains("jeffcott", SPEEDS)


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.0, 5e-8])
def test_mains_hum_is_no_missing_physics(clean, level):
    """50 nm, some six times what the noise is at an order."""
    recording = recorded([with_noise(run, 0.01, (11, k), "white") for k, run in enumerate(clean)])
    column = next(c for c, item in recording.channels.items() if item.name == "rotor.displacement[1]")
    runs = tuple(
        replace(run, values={**run.values, column: run.values[column] + level * np.cos(TURN * 50 * run.time + k)})
        for k, run in enumerate(recording.runs)
    )
    recording = replace(recording, runs=runs)
    checked = [problem.what for problem in check_harmonics(recording)]
    found = identify(shipped("jeffcott"), recording, profile=False)
    assert found.adequate
    assert all(abs(item.value - TRUTH[name]) < 4 * item.std for name, item in found.parameters.items())
    said = [problem.what for problem in found.warnings]
    if not level:
        assert said == checked == []
    else:
        assert said[0] == (
            "a line of 50.00 Hz is asynchronous: 5e-08 m in rotor.displacement[1]: it is fitted beside the harmonics"
        )
        near = "50.00 Hz is not told from order {} here: that order counts less"
        assert checked[0] == (
            "a line of 50.00 Hz is asynchronous: 5e-08 m in rotor.displacement[1]: picked up from the mains, or a force"
        )
        assert said[1:] == checked[1:] == [near.format(order) for order in (5, 3, 5, 3)]


@pytest.mark.slow
def test_pulses_of_another_clock_are_said(clean):
    """A clock of the pulses that is 0.5 % slow: a turn of the harmonics is not one of the pulses."""
    recording = recorded([with_noise(run, 0.01, (12, k), "white") for k, run in enumerate(clean)])
    runs = tuple(replace(run, tacho=run.tacho * 1.005) for run in recording.runs)
    recording = replace(recording, runs=runs)
    what = "its harmonics turn otherwise than its pulses say, by more than these leave open"
    found = identify(shipped("jeffcott"), recording, profile=False)
    assert [problem.what for problem in found.warnings].count(what) == len(runs)
    assert [problem.what for problem in check_harmonics(recording)] == [what] * len(runs)
