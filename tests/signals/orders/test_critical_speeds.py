"""Critical speeds of run-ups whose modes are known, integrated by another program."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.signals.orders.critical_speeds import critical_speeds
from rotorsim.signals.orders.extraction import tracked_recording
from rotorsim.signals.orders.resonance import peak_in, peak_of
from tests.signals.orders.machine import Mode, run_up

NOISE = 2e-8  # m
E = 2e-5  # m, eccentricity
FORWARD = Mode(300.0, 0.03, E, -1j * E)


@cache
def usual():
    """Return a run-up past one mode and its tracked orders, made once."""
    recording = run_up([FORWARD], 60.0, 500.0, 5.0, noise=NOISE)
    return recording, tracked_recording(recording, [1])[0]


def _found(recording, order=1, turns=1):
    orders, _ = tracked_recording(recording, [order], turns)
    return critical_speeds(orders.runs[0], orders.channels, order), orders


def test_a_fast_run_up_gives_the_settled_peak_that_it_never_shows():
    truth = peak_of(300.0, 0.03)
    orders = usual()[1]
    found = critical_speeds(orders.runs[0], orders.channels)
    [one] = found.found
    size = np.abs(orders.runs[0].vectors["x 1X"])
    read = peak_in(orders.runs[0].speed, size, int(size.argmax()))
    assert abs(read.speed / truth.speed - 1) > 0.02  # late by the sweep rate
    assert abs(read.amplification / truth.amplification - 1) > 0.05
    assert one.peak.speed == pytest.approx(truth.speed, rel=5e-4)
    assert one.peak.amplification == pytest.approx(truth.amplification, rel=5e-3)
    assert one.whirl == pytest.approx(1.0, abs=0.01)
    settled = E * truth.speed**2 / abs(300.0**2 - truth.speed**2 + 2j * 0.03 * 300.0 * truth.speed)
    assert abs(one.vectors["x 1X"]) == pytest.approx(settled, rel=2e-3)
    assert found.excess < 1.2


def test_a_coast_down_gives_the_same():
    truth = peak_of(300.0, 0.03)
    found, _ = _found(run_up([FORWARD], 500.0, 60.0, 5.0, noise=NOISE))
    [one] = found.found
    assert one.peak.speed == pytest.approx(truth.speed, rel=5e-4)
    assert one.peak.amplification == pytest.approx(truth.amplification, rel=5e-3)


def test_planes_of_different_stiffness_are_two_critical_speeds_and_whirl_is_planar():
    modes = [Mode(300.0, 0.04, x=E), Mode(310.0, 0.04, y=-1j * E)]
    found, _ = _found(run_up(modes, 60.0, 500.0, 8.0, noise=NOISE))
    assert [one.frequency for one in found.found] == pytest.approx([300.0, 310.0], rel=1e-3)
    assert [abs(one.whirl) < 0.05 for one in found.found] == [True, True]


def test_backward_whirl_is_said():
    found, _ = _found(run_up([Mode(300.0, 0.04, E, 1j * E)], 60.0, 500.0, 5.0, noise=NOISE))
    assert found.found[0].whirl == pytest.approx(-1.0, abs=0.01)


def test_a_second_order_meets_the_mode_at_half_the_speed():
    found, _ = _found(run_up([Mode(600.0, 0.03, 3.0, -3j, order=2)], 60.0, 500.0, 4.0, noise=NOISE), order=2)
    [one] = found.found
    assert one.peak.speed == pytest.approx(peak_of(600.0, 0.03, 2).speed, rel=5e-4)


def test_two_modes_far_apart_are_found_with_slow_roll_between():
    modes = [Mode(180.0, 0.03, E, -1j * E), Mode(420.0, 0.02, 0.5 * E, -0.5j * E)]
    found, _ = _found(run_up(modes, 50.0, 560.0, 8.0, noise=NOISE, slow_roll=3e-6 + 1e-6j))
    assert [one.frequency for one in found.found] == pytest.approx([180.0, 420.0], rel=1e-3)
    assert found.slow_roll["x 1X"] == pytest.approx(3e-6 + 1e-6j, abs=1e-7)


@pytest.mark.parametrize("hum", [0.0, 3e-7])
def test_nothing_is_found_where_no_critical_speed_was_passed(hum):
    found, _ = _found(run_up([Mode(900.0, 0.03, E, -1j * E)], 60.0, 500.0, 5.0, noise=NOISE, hum=hum))
    assert found.found == ()


def test_one_mode_that_splits_for_no_plane_stays_one():
    """A single probe cannot tell planes apart; a fit that is a little better with twins says so of nothing."""
    orders = usual()[1]
    alone = {"x 1X": orders.channels["x 1X"]}
    assert len(critical_speeds(orders.runs[0], alone).found) == 1


def test_rows_of_successive_turns_need_no_times():
    orders = usual()[1]
    found = critical_speeds(replace(orders.runs[0], time=None), orders.channels)
    assert found.found[0].peak.speed == pytest.approx(peak_of(300.0, 0.03).speed, rel=5e-4)


def test_rows_that_are_missing_are_left_out():
    orders = usual()[1]
    vectors = {name: values.copy() for name, values in orders.runs[0].vectors.items()}
    vectors["x 1X"][40:60] = np.nan
    found = critical_speeds(replace(orders.runs[0], vectors=vectors), orders.channels)
    assert found.found[0].peak.speed == pytest.approx(peak_of(300.0, 0.03).speed, rel=5e-4)


def test_what_was_not_measured_is_refused():
    orders = usual()[1]
    with pytest.raises(RotorsimError, match="run up: no channel of 3X was measured"):
        critical_speeds(orders.runs[0], orders.channels, 3)
    vectors = {name: np.where(np.arange(len(v)) % 5, v, np.nan) for name, v in orders.runs[0].vectors.items()}
    with pytest.raises(RotorsimError, match="too many rows are missing to tell noise from motion"):
        critical_speeds(replace(orders.runs[0], vectors=vectors), orders.channels)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    """Of 60 run-ups with two intervals each; 90 % of 120 are 108, and 99 are missed by chance once in a hundred."""
    rng = np.random.default_rng(7)
    held = []
    for seed in range(60):
        w, z, duration = rng.uniform(200, 350), rng.uniform(0.02, 0.08), rng.uniform(4.0, 8.0)
        mode = Mode(w, z, E * np.exp(1j * rng.uniform(0, 6)), E * np.exp(1j * rng.uniform(0, 6)))
        found, _ = _found(run_up([mode], 60.0, 500.0, duration, noise=rng.uniform(2e-7, 2e-6), seed=seed))
        [one] = found.found
        truth = peak_of(w, z)
        for name, value in (("speed", truth.speed), ("amplification", truth.amplification)):
            low, high = one.interval90(name)
            held.append(low <= value <= high)
    assert sum(held) >= 99
