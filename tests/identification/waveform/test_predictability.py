"""What is predictable is no noise, and noise is not predictable, whatever its colour."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from rotorsim.identification.waveform.predictability import predictability

RUNS, SAMPLES = 3, 1000
POLES = np.array([0.9, 0.95 * np.exp(0.1j), 0.95 * np.exp(-0.1j)])


def inputs(seed: int) -> list[np.ndarray]:
    random = np.random.default_rng(seed)
    return [np.repeat(random.normal(size=(SAMPLES // 10, 2)), 10, axis=0) for _ in range(RUNS)]


def coloured(seed: int, pole: float) -> list[np.ndarray]:
    random = np.random.default_rng(seed)
    whites = [random.normal(size=(SAMPLES + 500, 1)) for _ in range(RUNS)]
    return [np.sqrt(1 - pole**2) * lfilter([1], [1, -pole], white, axis=0)[500:] for white in whites]


@pytest.mark.parametrize(
    "pole", [pytest.param(0.0, marks=pytest.mark.slow), 0.7, pytest.param(0.97, marks=pytest.mark.slow)]
)
def test_noise_of_any_colour_is_not_structured(pole):
    """At 1 % of false alarms two of sixty are to be expected at most (probability of three: 2 %)."""
    alarms = [predictability(coloured(seed, pole), inputs(seed + 100), POLES).structure for seed in range(20)]
    assert sum(alarms) <= 1


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("law", [lambda u: u, lambda u: u**3 / 4, np.abs, lambda u: np.clip(u, -0.5, 0.5)])
def test_what_depends_on_an_input_is_predicted(law, share):
    """A filtered law of an input that makes up a share of the variance, in white noise."""
    signals = inputs(1)
    motion = [lfilter([0.1], [1, -0.9], law(part[:, :1]) - law(part[:, :1]).mean(), axis=0) for part in signals]
    size = np.concatenate(motion).std()
    random = np.random.default_rng(2)
    noise = [random.normal(size=part.shape) for part in motion]
    residuals = [np.sqrt(share) * m / size + np.sqrt(1 - share) * n for m, n in zip(motion, noise, strict=True)]
    judged = predictability(residuals, signals, POLES)
    assert judged.structure
    assert judged.share[0] == pytest.approx(share, abs=0.06)
    rest = np.concatenate(judged.rest)
    assert rest.std() ** 2 == pytest.approx(1 - share, abs=0.08)


def test_a_delayed_input_is_predicted_though_no_filter_is_a_delay():
    signals = inputs(3)
    random = np.random.default_rng(4)
    residuals = [np.roll(part[:, 1:], 7, axis=0) + random.normal(size=(SAMPLES, 1)) for part in signals]
    judged = predictability(residuals, signals, POLES)
    assert judged.structure
    assert judged.share[0] > 0.3


def test_a_drift_of_one_channel_alone_is_not_predicted():
    """It is for the sensor to answer for, not for the physics."""
    drift = np.linspace(0, 10, SAMPLES)[:, None]
    judged = predictability([drift + part for part in coloured(5, 0.0)], inputs(6), POLES)
    assert not judged.structure
