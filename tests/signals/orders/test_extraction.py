"""Orders of chirps whose envelopes are written down."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import Place, RotorsimError
from rotorsim.recordings.recording import ANGLE, Channel, Recording, Run
from rotorsim.signals.orders.extraction import tracked_recording
from rotorsim.signals.orders.slow_roll import without_slow_roll

RATE = 5000.0


def _envelope(order, theta):
    """Return an envelope that changes by a few per cent a turn, as at a resonance."""
    return (1e-5 / order) / (1 - (theta / 700) ** 2 + 0.1j) * np.exp(1j * order)


def _recording(change=lambda t, y: y, acceleration=40.0, pulses=None, rate=RATE):
    """Return a run-up whose angle was recorded, or pulses, that many seconds late; the first sample is at a mark."""
    t = np.arange(int(6.0 * rate)) / rate
    theta = 70.0 * t + acceleration * t**2 / 2
    y = sum((_envelope(k, theta) * np.exp(1j * k * theta)).real for k in (1, 2, 3, 5)) + 2e-6 + 1e-6 * t
    channels = {"x": Channel("x", "rotor.displacement", "x", None, None, "m")}
    values = {"x": change(t, y)}
    tacho = None
    if pulses is not None:
        whole = 2 * np.pi * np.arange(1, int(theta[-1] / (2 * np.pi)))
        tacho = (np.sqrt(70.0**2 + 2 * acceleration * whole) - 70.0) / acceleration + pulses
    else:
        channels["angle"] = Channel("angle", ANGLE, None, None, None, "rad")
        values["angle"] = theta
    run = Run("up", "up", t, values, None, tacho, {}, "identify", Place("up"))
    return Recording("chirp", "written down", Path(), channels, (run,)), theta


@pytest.mark.parametrize("pulses", [None, -1e-11, 0.0, 1e-11])  # s: rounding does not decide on the first row
@pytest.mark.parametrize(("turns", "error"), [(1, 3e-4), (3, 5e-3)])  # three turns are 0.3 of the half-power width
def test_orders_are_the_means_of_their_envelopes_and_do_not_leak(turns, error, pulses):
    recording, _ = _recording(pulses=pulses)
    tracked, [positions] = tracked_recording(recording, [1, 2, 3], turns)
    run = tracked.runs[0]
    fine = np.linspace(0, 2 * np.pi * turns, 2001)
    starts = 2 * np.pi * turns * np.arange(len(run.speed))
    inner = slice(3, -3)
    for order in (1, 2, 3):
        truth = _envelope(order, starts[:, None] + fine).mean(axis=1)
        off = np.abs(run.vectors[f"x {order}X"] - truth)[inner]
        assert off.max() < error * np.abs(truth).max()
    assert positions.mean["x"][inner] == pytest.approx((2e-6 + 1e-6 * run.time)[inner], abs=5e-8)


def test_a_shaft_that_turns_the_other_way_has_the_same_vectors_against_its_own_angle():
    recording, _ = _recording()
    run = recording.runs[0]
    back = replace(recording, runs=(replace(run, values={**run.values, "angle": -run.values["angle"]}),))
    tracked, forward = (tracked_recording(one, [1])[0].runs[0] for one in (back, recording))
    assert tracked.vectors["x 1X"] == pytest.approx(forward.vectors["x 1X"], abs=1e-12)
    assert (tracked.sense, forward.sense) == (-1, 1)


def test_rows_that_lack_a_sample_are_missing_and_leave_their_neighbours_alone():
    def with_gap(t, y):
        return np.where((t > 2.0) & (t < 2.05), np.nan, y)

    whole = tracked_recording(_recording()[0], [1])[0].runs[0].vectors["x 1X"]
    some = tracked_recording(_recording(with_gap)[0], [1])[0].runs[0].vectors["x 1X"]
    lost = np.isnan(some)
    assert 1 <= lost.sum() <= 3
    assert some[~lost] == pytest.approx(whole[~lost], abs=3e-8)


def test_slow_roll_is_the_mean_vector_at_low_speed():
    tracked, _ = tracked_recording(_recording()[0], [1])
    run = tracked.runs[0]
    low = run.speed < 80.0
    less = without_slow_roll(tracked, 0.0, 80.0)
    assert less.runs[0].vectors["x 1X"] == pytest.approx(run.vectors["x 1X"] - run.vectors["x 1X"][low].mean())
    assert not less.slow_roll
    with pytest.raises(RotorsimError, match="chirp: slow roll was subtracted already"):
        without_slow_roll(less, 0.0, 80.0)
    with pytest.raises(RotorsimError, match=r"no row between 0 and 95\.49 rpm: slow roll is not known"):
        without_slow_roll(tracked, 0.0, 10.0)


def _refused(recording, *given):
    with pytest.raises(RotorsimError) as caught:
        tracked_recording(recording, *given)
    return str(caught.value)


def test_what_cannot_be_tracked_is_refused():
    steady, _ = _recording(acceleration=0.0)
    assert "chirp: no run changes its speed" in _refused(steady, [1])
    assert "run up: its speed does not change" in _refused(steady, [1], 1, steady.runs)
    assert "rows of 20 turns: 20 are needed" in _refused(_recording()[0], [1], 20)
    slow, _ = _recording(rate=400.0)
    assert "8 samples a row at 2735 rpm are too few for 4X" in _refused(slow, [4])
