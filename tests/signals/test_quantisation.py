"""Steps of converters: found among readings, and taken out of harmonics."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from rotorsim.errors import Place
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.covariance import real_vector
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.quantisation import Step, find_steps, interval_slopes, step_of, without_steps

COUNT, RATE, SPEED = 4000, 5000.0, 2 * np.pi * 23.7
TRUE = {0: 3e-6, 1: 4e-6 - 2e-6j, 2: 0.8e-6j, 3: 0.3e-6}


def recorded(step: float, noise: float, seed: int, sizes: tuple[float, ...] = (1.0,)) -> tuple[Recording, list]:
    """Return runs of one probe behind a converter, each with the motion TRUE times a size, and their harmonics."""
    random = np.random.default_rng(seed)
    time = np.arange(COUNT) / RATE
    wave = sum((2 if k else 1) * np.real(c * np.exp(1j * k * SPEED * time)) for k, c in TRUE.items())
    runs = []
    for k, size in enumerate(sizes):
        readings = size * wave + noise * random.standard_normal(COUNT)
        readings = step * np.round(readings / step) if step else readings
        values = {"x": readings, "angle": SPEED * time}
        runs.append(Run(f"run{k}", "a.csv", time, values, SPEED, None, {}, "identify", Place("a"), RATE))
    channels = {
        "x": Channel("x", "rotor.displacement", "x", None, None, "m"),
        "angle": Channel("angle", "clock.theta", None, None, None, "rad"),
    }
    recording = Recording("bench", "", Path(), channels, tuple(runs))
    return recording, harmonics_of(recording)


def missed(fit, size: float = 1.0) -> float:
    """Return the distance of harmonics from the truth, in variances."""
    true = size * np.array([TRUE.get(int(k), 0.0) for k in fit.orders], complex)[:, None]
    e = real_vector(fit.values - true)
    return float(e @ np.linalg.solve(fit.covariance, e))


@given(st.floats(1e-9, 1.0), st.integers(3, 60), st.floats(-1.0, 1.0), st.integers(0, 2**32 - 1))
def test_the_step_of_readings_is_found(step, levels, offset, seed):
    """Any levels of which two are neighbours, written with nine digits."""
    random = np.random.default_rng(seed)
    counts = np.concatenate([[0, 1], random.integers(-levels, levels, 500)])
    readings = np.array([float(f"{value:.9g}") for value in step * (counts + offset)])
    found = step_of(readings)
    assert found is not None
    assert found.size == pytest.approx(step, rel=1e-6)


@pytest.mark.parametrize(
    "readings", [np.random.default_rng(0).standard_normal(1000), np.zeros(9), np.array([0.0, 1.0])]
)
def test_readings_without_steps_have_none(readings):
    assert step_of(readings) is None


def test_slopes_are_those_of_the_log_likelihood():
    """Far out, too, where both ends have no probability to speak of."""
    upper, lower = np.array([0.3, 9.0, -7.0, 60.0, 0.01]), np.array([-0.2, 8.5, -7.5, 59.0, -0.01])
    h = 1e-6
    a, b, _ = interval_slopes(upper, lower)
    by_upper = (interval_slopes(upper + h, lower)[2] - interval_slopes(upper - h, lower)[2]) / (2 * h)
    by_lower = (interval_slopes(upper, lower + h)[2] - interval_slopes(upper, lower - h)[2]) / (2 * h)
    np.testing.assert_allclose(a, by_upper, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(-b, by_lower, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    ("share", "seeds"), [*(pytest.param(s, 12, marks=pytest.mark.slow) for s in (0.02, 0.04, 0.1, 0.3, 0.6)), (0.1, 4)]
)
@pytest.mark.slow
def test_harmonics_behind_a_converter_are_found_with_their_covariance(share, seeds):
    """Noise of a fiftieth of a step to more than half of one: misses are chi-squared, plain harmonics' are not."""
    step, plain, entered, equations = 2e-7, 0.0, 0.0, 0
    for seed in range(seeds):
        recording, runs = recorded(step, share * step, seed)
        steps = {"rotor.displacement[1]": step_of(recording.runs[0].values["x"])}
        without = without_steps(recording, runs, steps)
        [found] = harmonics_of(without)
        plain += missed(runs[0].fit)
        entered += missed(found.fit)
        equations += 2 * len(found.fit.orders) - 1
    assert chi2.ppf(0.001, equations) < entered < chi2.ppf(0.999, equations)
    if share < 0.3:
        assert plain > 2 * entered


@pytest.mark.parametrize(
    ("share", "seeds"), [(0.005, 2), *(pytest.param(s, 6, marks=pytest.mark.slow) for s in (0.005, 0.01, 0.015))]
)
def test_with_less_noise_than_can_be_told_intervals_are_wide(share, seeds):
    step, total, equations = 2e-7, 0.0, 0
    for seed in range(seeds):
        recording, runs = recorded(step, share * step, seed)
        without = without_steps(recording, runs, {"rotor.displacement[1]": step_of(recording.runs[0].values["x"])})
        [found] = harmonics_of(without)
        total += missed(found.fit)
        equations += 2 * len(found.fit.orders) - 1
    assert 0.2 * equations < total < chi2.ppf(0.999, equations)  # it is no merit to know nothing


@pytest.mark.parametrize(
    ("share", "seeds"),
    [pytest.param(share, 6, marks=pytest.mark.slow) for share in (0.005, 0.02, 0.04, 0.06)] + [(0.2, 1)],
)
@pytest.mark.slow
def test_small_motions_beside_large_ones_tell_what_they_tell(share, seeds):
    """Of a run that moves by few steps few samples tell the noise: it is that of the others. 100 steps to half of one.

    A likelihood with few edges is no parabola: a run may miss by twice its variance (5 to 10 steps: 1.5 times).
    """
    step, sizes = 2e-7, (1.0, 0.2, 0.1, 0.05, 0.02, 0.005)
    total, equations = np.zeros(len(sizes)), 0
    for seed in range(seeds):
        recording, runs = recorded(step, share * step, seed, sizes)
        found = harmonics_of(without_steps(recording, runs, {"rotor.displacement[1]": Step(step, 0.0)}))
        total += [missed(item.fit, size) for size, item in zip(sizes, found, strict=True)]
        equations += 2 * len(found[0].fit.orders) - 1
    assert (total < 2 * equations).all()
    assert total[0] > 0.2 * equations  # it is no merit to know nothing


@pytest.mark.slow
def test_only_steps_that_change_harmonics_are_seen():
    steps = find_steps(*recorded(4e-7, 2e-8, 1))
    assert list(steps) == ["rotor.displacement[1]"]
    assert steps["rotor.displacement[1]"].size == pytest.approx(4e-7, rel=1e-6)
    assert steps["rotor.displacement[1]"].seen > 10
    assert find_steps(*recorded(2e-9, 2e-8, 1)) == {}  # a converter of 16 bit
    assert find_steps(*recorded(0.0, 2e-8, 1)) == {}
    assert find_steps(*recorded(3e-8, 2e-8, 1)) == {}  # half a step of noise hides it
