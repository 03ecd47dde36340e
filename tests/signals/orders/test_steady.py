"""Runs at constant speeds as one table: closed forms of their vectors, and of the critical speed that they show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotorsim import RotorsimError, critical_speeds
from rotorsim.recordings.recording import Recording
from rotorsim.signals.orders.resonance import peak_of
from rotorsim.signals.orders.steady import steady_recording
from tests.signals.orders.machine import RATE, _recorded

W, Z, E, NOISE = 300.0, 0.03, 2e-5, 2e-7
SLOW_ROLL = 1e-6 * np.exp(0.7j)


def settled(speeds: np.ndarray, sense: int = 1, wander: float = 1e-4) -> Recording:
    """Return runs of unbalance past a mode in x, a circle forward, with slow roll and a 2X, whose speeds waver."""
    runs = []
    for k, speed in enumerate(speeds):
        time = np.arange(int(1.5 * RATE)) / RATE
        theta = sense * (speed * time + 0.3 + wander * np.sin(2 * np.pi * time))
        X = E * speed**2 / (W**2 - speed**2 + 2j * Z * W * speed)
        turn = np.exp(1j * np.abs(theta))
        second = 3e-6 * np.exp(2j * np.abs(theta))
        x, y = ((X + SLOW_ROLL) * turn + second).real, (-1j * X * turn).real
        made = _recorded(time, theta, x, sense * y, NOISE, k)
        runs.append(replace(made.runs[0], id=f"run{k}", file=f"run{k}"))
    return replace(made, runs=tuple(runs[::-1]))  # in any order


@pytest.mark.slow
def test_vectors_and_their_noise_are_those_of_each_run() -> None:
    speeds = np.linspace(100.0, 500.0, 12)
    for sense in (1, -1):
        found, positions = steady_recording(settled(speeds, sense), [1, 2])
        (run,) = found.runs
        assert (run.id, run.sense) == ("steady", sense)
        np.testing.assert_allclose(run.speed, speeds, rtol=1e-3)
        X = E * speeds**2 / (W**2 - speeds**2 + 2j * Z * W * speeds)
        std = NOISE * np.sqrt(2 / (1.5 * RATE))
        assert np.sqrt(run.noise["x 1X"]) == pytest.approx(std, rel=0.15)
        for column, truth in (("x 1X", X + SLOW_ROLL), ("y 1X", -1j * sense * X), ("x 2X", np.full(12, 3e-6 + 0j))):
            assert np.abs(run.vectors[column] - truth).max() < 5 * std + 1e-3 * np.abs(truth).max() * 1e-2
        assert np.abs(positions[0].mean["x"]).max() < 5 * std


@pytest.mark.slow
def test_the_critical_speed_is_that_of_the_settled_response_within_its_interval() -> None:
    truth, inside = peak_of(W, Z, 1, 0.0), 0
    found, _ = steady_recording(settled(np.linspace(200.0, 420.0, 23)), [1])
    result = critical_speeds(found.runs[0], found.channels, 1)
    (one,) = result.found
    assert one.peak.speed == pytest.approx(truth.speed, rel=1e-4)
    assert one.peak.amplification == pytest.approx(truth.amplification, rel=5e-3)
    assert one.whirl == pytest.approx(1.0, abs=1e-3)
    low, high = one.interval90("speed")
    inside += low - 3e-4 * W <= truth.speed <= high + 3e-4 * W
    assert inside == 1


@pytest.mark.slow
def test_too_few_speeds_and_unknown_angles_are_refused() -> None:
    few = settled(np.linspace(100.0, 500.0, 7))
    with pytest.raises(RotorsimError, match="8 speeds of one setting are needed"):
        steady_recording(few, [1])
    two = settled(np.linspace(100.0, 500.0, 10))
    runs = tuple(replace(run, settings={"controller.KP": k % 2}) for k, run in enumerate(two.runs))
    with pytest.raises(RotorsimError, match="5 runs at constant speeds"):
        steady_recording(replace(two, runs=runs, folder=Path()), [1])
