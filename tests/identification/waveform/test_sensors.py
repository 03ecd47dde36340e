"""Hum and drift beside a motion whose speed changes: found where they are, and nothing where nothing but motion is."""

from dataclasses import replace
from math import tau

import numpy as np
import pytest

from rotorsim.identification.identification import identify
from rotorsim.identification.waveform.noise import white_part
from rotorsim.identification.waveform.recorded.along_angle import along_angle
from rotorsim.identification.waveform.recorded.data import SampledRun, channels_of
from rotorsim.identification.waveform.recorded.reading import read_runs
from rotorsim.identification.waveform.sensors import with_drift
from rotorsim.model.load import load
from rotorsim.signals.pickup import mains_lines
from tests.identification.waveform.run_up import CHANNELS, NOISE, Machine, runs_of

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
    known, names = np.ones(y.shape, bool), [f"y{k}" for k in range(y.shape[1])]

    def beside(signal):
        return run.beside_nuisances(signal.copy(), known, names)

    np.testing.assert_allclose(beside(hummed), beside(y), atol=1e-10)
    known[100:900, 1] = False
    both = [beside(np.where(known, part, np.nan)) for part in (hummed, y)]
    np.testing.assert_allclose(both[0], both[1], atol=1e-10)
    assert run.part(slice(0, 1000)).nuisances is None  # 10 periods
    run = replace(run, drift_since=TIME[0], floating=frozenset(["y1", "y2", "y3"]))
    moved = hummed + 3 * TIME[:, None] + np.arange(y.shape[1])  # the means of y1 to y3
    np.testing.assert_allclose(beside(moved)[known], beside(y)[known], atol=1e-10)
    assert np.abs(beside(y + 1.0) - beside(y))[:, 0].max() > 0.1  # the mean of y0 counts


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


def test_a_drift_is_one_that_means_of_parts_do_not_scatter_by():
    """In 200 draws of white noise, with the motion of a resonance in half of them, one is expected."""
    run, names = SampledRun("up", {}, {}, TIME, {}), ["a", "b", "c", "d"]
    residuals = [white(seed) + (seed % 2) * chirp(1.0) for seed in range(200)]
    assert sum(with_drift(run, one, names).drift_since is not None for one in residuals) <= 3
    small = 0.15 * TIME[:, None] / TIME[-1] * [0, 0, 1, 0]  # a seventh of the noise: 15 standard deviations of its mean
    found = with_drift(run, white(1) + small, names)
    assert found.drift_since == 0
    assert str(found.notes[0]) == "warning: run up: a drift is fitted beside the motion: 0.16 in c (SI, over the run)"
    gappy = white(1) + small
    gappy[:1300] = np.nan
    assert with_drift(run, gappy, names).drift_since is None  # a part says nothing


def with_more(recording, more):
    """Return a recording with a signal more in each channel: more(name, run, n-th channel)."""
    runs = tuple(
        replace(run, values={name: y + more(name, run, k) for k, (name, y) in enumerate(run.values.items())})
        for run in recording.runs
    )
    return replace(recording, runs=runs)


@pytest.mark.slow
def test_a_run_up_with_drift_is_explained():
    """FAULT: 2.5 times the variance of the noise was left, and parameters were off by up to 7 standard deviations."""
    machine = Machine()
    made = with_more(runs_of(machine, 5, 1.5), lambda name, run, k: (2 + k) * NOISE[name] * run.time / run.time[-1])
    found = identify(load("jeffcott"), made)
    assert found.adequate
    assert [note.code for note in found.warnings].count("sensor_drift") == 3
    for name, truth in machine.parameters.items():
        one = found.parameters[name]
        assert abs(one.value - truth) < 4 * one.std, name
    clean = identify(load("jeffcott"), runs_of(machine, 5, 1.5))
    assert not [note.code for note in clean.warnings].count("sensor_drift")


@pytest.mark.slow
def test_the_mean_of_an_ac_coupled_channel_is_not_used():
    """FAULT: in time it was compared all the same, and parameters were off by up to 29 standard deviations."""
    machine = Machine()
    made = with_more(runs_of(machine, 5, 1.5), lambda name, run, k: 300 * NOISE[name] * (name in "xy"))
    floating = {name: replace(one, coupling="ac") if name in "xy" else one for name, one in CHANNELS.items()}
    found = identify(load("jeffcott"), replace(made, channels=floating))
    assert found.adequate
    for name, truth in machine.parameters.items():
        one = found.parameters[name]
        assert abs(one.value - truth) < 4 * one.std, name


def test_samples_that_a_recorder_dropped_are_not_compared():
    """FAULT: each was one of ten micrometres in a residual of 20 nm. Where a single channel repeats, it is none."""
    made = runs_of(Machine(), 3, 1.5)
    values = {name: column.copy() for name, column in made.runs[0].values.items()}
    for column in values.values():
        column[[1000, 1001, 4200]] = column[[999, 999, 4199]]
    values["x"][2000] = values["x"][1999]
    made = along_angle(load("jeffcott"), replace(made, runs=(replace(made.runs[0], values=values), made.runs[1])))
    channels = channels_of(load("jeffcott"), made)
    one, other = read_runs(load("jeffcott"), made.runs, channels)
    for name in channels.outputs:
        lost = one.time[~np.isfinite(one.values[name])]
        np.testing.assert_allclose(lost, np.array([1000, 1001, 4200]) / RATE)
        assert np.isfinite(other.values[name]).all()
    [note] = [note for note in one.notes if "repeat" in note.what]
    what = "3 of 7500 samples repeat the one before in all channels, and are not compared"
    assert str(note) == f"warning: run {one.id}: {what}\n\nhint: the recorder dropped them"
    assert not any("repeat" in note.what for note in other.notes)
