"""The frequency at which the search for a line begins."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from rotorsim.diagnosis.catalogue.insertion import DOMINANT, SAMPLED, starts_of
from rotorsim.diagnosis.evidence.waveform.dominant_line import dominant_frequency
from rotorsim.fault import Dominant, Fault

DT, SIZES = 0.02, (1500, 1200)


def noisy(seed: int, frequency: float, amplitude: float) -> list[np.ndarray]:
    """Runs of two signals with a line in one: resonant noise at 3 rad/s that is ten times as large, a drift, white."""
    random, parts = np.random.default_rng(seed), []
    pole = 0.995 * np.exp(3.0j * DT)
    for size in SIZES:
        t = np.arange(size) * DT
        coloured = lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], random.normal(size=size))
        coloured *= 10 * amplitude / coloured.std()
        line = amplitude * np.sin(frequency * t + random.uniform(0, 6))
        parts.append(np.column_stack([coloured + 0.3 * random.normal(size=size) + t, line + random.normal(size=size)]))
    return parts


@pytest.mark.parametrize("frequency", [1.7, 23.4, 140.0])
def test_a_search_for_a_line_begins_within_a_quarter_of_a_cycle_over_the_run(frequency):
    found = dominant_frequency(noisy(1, frequency, 2.0), DT)
    assert abs(found - frequency) * SIZES[0] * DT < np.pi / 2


def test_samples_that_are_missing_do_not_hide_a_line():
    parts = noisy(2, 23.4, 2.0)
    parts[0][100:140] = np.nan
    assert abs(dominant_frequency(parts, DT) - 23.4) * SIZES[0] * DT < np.pi / 2


def test_a_frequency_begins_at_the_line_or_far_from_both_ends():
    fault = Fault(physics="hum", enters="signal", free={"frequency": (Dominant(),)})
    insertion = type("Insertion", (), {"fault": fault})
    assert starts_of(insertion, {DOMINANT: 23.4, SAMPLED: DT}) == [{"frequency": 23.4}]
    assert starts_of(insertion, {SAMPLED: DT}) == [{"frequency": pytest.approx(3.0)}]
