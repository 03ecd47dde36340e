"""Mains hum beside a motion whose speed changes: found where it is, and nothing where nothing but motion is."""

from dataclasses import replace
from math import tau

import numpy as np
import pytest

from rotorsim.identification.identification import identify
from rotorsim.identification.waveform.noise import white_part
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.model.load import load
from rotorsim.signals.pickup import mains_lines
from tests.identification.waveform.run_up import NOISE, Machine, runs_of

RATE, SIZE = 5000.0, 20000
TIME = np.arange(SIZE) / RATE


def white(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(SIZE, 4))


def chirp(amplitude: float) -> np.ndarray:
    """A motion of once and twice a turn, 10 to 90 turns a second, largest at 50."""
    angle = tau * (10 * TIME + 10 * TIME**2)
    speed = 10 + 20 * TIME
    size = amplitude / np.hypot(1 - (speed / 50) ** 2, 0.1 * speed / 50)
    return np.stack([size * np.cos(k * angle + own) for k, own in ((1, 0.0), (1, 1.6), (2, 0.5), (2, 2.1))], axis=1)


def test_noise_and_motion_have_no_hum():
    for seed in range(20):
        assert [*mains_lines(white(seed), 1 / RATE)] == []
    for amplitude in (1.0, 30.0):
        assert [*mains_lines(white(50) + chirp(amplitude), 1 / RATE)] == []


@pytest.mark.parametrize("frequency", [49.93, 60.04, 100.04])
def test_hum_is_found_in_noise_and_beside_motion(frequency):
    """To a twentieth of the resolution of 0.25 Hz: fitted so, (pi / 20)^2 / 3 = 1 % of its power is left."""
    line = np.sin(tau * frequency * TIME + 0.3)[:, None]
    for level, motion in ((0.3, 0.0), (3.0, 1.0)):
        [found] = mains_lines(white(7) + chirp(motion) + level * line, 1 / RATE)
        assert found == pytest.approx(frequency, abs=0.25 / 20)


def test_signals_are_told_beside_their_lines_as_by_least_squares():
    run = SampledRun("up", {}, {}, TIME, {}, lines=(50.02,))
    angle = tau * 50.02 * TIME
    y = white(3)
    hummed = y + 5 * np.cos(angle)[:, None] - 2 * np.sin(angle)[:, None]
    known = np.ones(y.shape, bool)
    np.testing.assert_allclose(run.beside_lines(hummed.copy(), known), run.beside_lines(y.copy(), known), atol=1e-10)
    known[100:900, 1] = False
    both = [run.beside_lines(np.where(known, part, np.nan), known) for part in (hummed, y)]
    np.testing.assert_allclose(both[0], both[1], atol=1e-10)
    assert run.part(slice(0, 1000)).line_basis is None  # 10 periods


def test_the_white_part_is_told_from_motion_that_is_much_slower():
    """White noise of unit variance under a motion of 200 times its power, 50 samples a period."""
    y = white(11) + 20 * np.sin(tau * 100 * TIME)[:, None]
    assert white_part([y], 6) == pytest.approx(1.0, rel=0.03)
    assert white_part([y], 1).min() > 2.5
    assert white_part([white(12)], 6) == pytest.approx(1.0, rel=0.03)


@pytest.mark.slow
def test_a_run_up_with_hum_of_three_standard_deviations_is_explained():
    machine = Machine()
    made = runs_of(machine, 5, 1.5)
    runs = tuple(
        replace(
            run,
            values={
                name: run.values[name] + 3 * np.sqrt(2) * NOISE[name] * np.cos(tau * 50.03 * run.time + k)
                for k, name in enumerate(run.values)
            },
        )
        for run in made.runs
    )
    found = identify(load("jeffcott"), replace(made, runs=runs))
    assert found.adequate
    assert [note.code for note in found.warnings].count("mains_hum") == 3
    for name, truth in machine.parameters.items():
        one = found.parameters[name]
        assert abs(one.value - truth) < 4 * one.std, name
