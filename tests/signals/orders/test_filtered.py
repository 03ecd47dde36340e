"""Order vectors by the Vold-Kalman filter: against those turn by turn, and a run-up that crosses the mains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rotorsim import RotorsimError
from rotorsim.signals.orders.extraction import tracked_recording
from rotorsim.signals.orders.filtered import Passband, filtered_recording
from tests.signals.orders.machine import Mode, run_up

MACHINE = [Mode(300.0, 0.08, 2e-5, -2e-5j)]
SLOW = {"first": 100.0, "last": 500.0, "duration": 8.0}


@pytest.mark.slow
def test_a_wide_filter_has_the_vectors_of_each_turn() -> None:
    recording = run_up(MACHINE, **SLOW, slow_roll=2e-6)
    turns = tracked_recording(recording, [1, 2])[0].runs[0]
    filtered, positions = filtered_recording(recording, [1, 2], Passband(share=0.4))
    own = filtered.runs[0]
    np.testing.assert_allclose(own.speed, turns.speed, rtol=1e-6)
    size = np.abs(turns.vectors["x 1X"]).max()
    for column in ("x 1X", "y 1X", "x 2X"):
        assert np.abs(own.vectors[column] - turns.vectors[column])[5:-5].max() < 2e-3 * size
    assert np.abs(positions[0].mean["x"]).max() < 0.1 * size


@pytest.mark.slow
@pytest.mark.parametrize("passband", [Passband(share=0.1), Passband(hertz=3.0)])
def test_the_mains_that_the_shaft_overtakes_are_told_apart(passband: Passband) -> None:
    quiet, humming = (run_up(MACHINE, **SLOW, hum=hum) for hum in (0.0, 3e-5))
    truth = filtered_recording(quiet, [1], passband)[0].runs[0]
    alone = filtered_recording(humming, [1], passband)[0].runs[0]
    apart = filtered_recording(humming, [1], passband, [50.0])[0].runs[0]
    there = np.abs(truth.speed - 2 * np.pi * 50.0) < 40.0
    taken, left = (np.abs(one.vectors["x 1X"] - truth.vectors["x 1X"])[there].max() for one in (alone, apart))
    assert taken > 1.5e-5
    assert left < 0.25 * taken  # it passes at 8 Hz/s, hardly faster than B^2: within 1 / B the two are nearly alike


@pytest.mark.slow
def test_the_other_way_round_is_the_mirror_image() -> None:
    recording = run_up(MACHINE, **SLOW)
    values = {**recording.runs[0].values, "angle": -recording.runs[0].values["angle"]}
    turned = replace(recording, runs=(replace(recording.runs[0], values=values),))
    one, other = (filtered_recording(it, [1], Passband(share=0.2))[0].runs[0] for it in (recording, turned))
    assert (one.sense, other.sense) == (1, -1)
    np.testing.assert_allclose(other.vectors["x 1X"], one.vectors["x 1X"], rtol=1e-3, atol=1e-9)


@pytest.mark.slow
def test_what_cannot_be_filtered_is_refused() -> None:
    recording = run_up(MACHINE, 100.0, 200.0, 1.0)
    with pytest.raises(RotorsimError, match="do not show"):
        filtered_recording(recording, [100], Passband(share=0.1))
    run = recording.runs[0]
    uneven = replace(run, time=run.time + 5e-5 * np.sin(np.arange(len(run.time))))
    with pytest.raises(RotorsimError, match="not equally spaced"):
        filtered_recording(replace(recording, runs=(uneven,)), [1], Passband(share=0.1))
    steady = run_up(MACHINE, 200.0, 200.0001, 1.0)
    with pytest.raises(RotorsimError, match="no run changes its speed"):
        filtered_recording(steady, [1], Passband(share=0.1))
