"""Jitter of pulses is one of the instrument: angle zero is as uncertain as it scatters, with few pulses too."""

from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import Place
from rotorsim.recordings.harmonics import with_one_jitter
from rotorsim.recordings.recording import Recording, Run
from rotorsim.recordings.shaft_angle import ShaftAngle, shaft_angle

TURN, RATE = 2 * np.pi, 2000.0
TIME = np.arange(2000) / RATE
EMPTY = Recording("", "", Path(), {}, ())
HERTZ = (2, 15, 20, 30, 55, 70)


def measured(seed: int, hertz: float, jitter: float, swing: float = 0.0) -> tuple[ShaftAngle, float]:
    """Return the angle from pulses with jitter [s], and what it is off from the true one over the run [rad]."""
    random = np.random.default_rng((int(hertz), seed))
    pulses = (np.arange(hertz) + random.uniform(0.1, 0.9)) / hertz
    noisy = pulses + jitter * random.standard_normal(len(pulses)) + swing * np.sin(TURN * 3 * pulses)
    run = Run("r", "", TIME, {}, None, np.sort(noisy), {}, "identify", Place("", 1, 1), RATE)
    angle = shaft_angle(EMPTY, run)
    return angle, float(np.mean(angle.theta - TURN * hertz * (TIME - pulses[0])))


def test_angle_zero_is_as_uncertain_as_said():
    """60 sets of six runs with 5 us: the mean square of errors over said deviations is one, to 4 sqrt(2 / 360)."""
    squares, alone = [], []
    for seed in range(60):
        angles, off = zip(*(measured(seed, hertz, 5e-6) for hertz in HERTZ), strict=True)
        squares += [(e / angle.std) ** 2 for e, angle in zip(off, with_one_jitter(angles), strict=True)]
        alone.append(angles[0].std)
    assert max(alone) < 1e-12  # two pulses are met by a line: they say nothing of their jitter
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)


def test_a_run_whose_speed_wanders_keeps_its_own():
    angles = [measured(0, hertz, 5e-6)[0] for hertz in HERTZ[1:]] + [measured(0, 40, 5e-6, swing=2e-3)[0]]
    found = with_one_jitter(angles)
    assert found[-1] is angles[-1]
    times = [angle.jitter / angle.speed for angle in found[:-1]]
    assert times == pytest.approx([times[0]] * 5)
    assert times[0] == pytest.approx(5e-6, rel=0.2)


def test_without_pulses_nothing_changes():
    angle = ShaftAngle(TIME, 1.0, 0.0, 0.0, "channel", True)
    assert with_one_jitter([angle, angle]) == [angle, angle]
    assert with_one_jitter([]) == []
