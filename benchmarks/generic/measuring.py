"""The recorder: white and coloured noise, mains, steps of converters."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10, pi

import numpy as np

from benchmarks.generic.laws import log_uniform
from benchmarks.generic.native import Array

WHITE = (0.003, 0.01)  # of half the range of a channel, log-uniform
LEAST_RATE = 150.0  # Hz: below, a recorder filters the mains away


@dataclass(frozen=True)
class Recorder:
    """Errors of one channel: rms of white and coloured noise, corner [Hz], amplitude and frequency of mains, step."""

    white: float
    coloured: float
    corner: float
    mains: float
    mains_frequency: float
    step: float

    @property
    def floor(self) -> float:
        """Return the rms of all of them."""
        return float(np.sqrt(self.white**2 + self.coloured**2 + self.mains**2 / 2 + self.step**2 / 12))


def draw(half_range: float, rate: float, rng: np.random.Generator) -> Recorder:
    """Return a recorder for a channel of this range."""
    white = half_range * log_uniform(rng, *WHITE)
    coloured, mains, step = rng.uniform(0.1, 0.5) * white, rng.uniform(0.0, 0.6) * white, rng.uniform(0.2, 0.7) * white
    corner = rate * log_uniform(rng, 0.003, 0.03)
    frequency = 50.0 + rng.uniform(-0.02, 0.02)
    decade = 10.0 ** floor(log10(step))
    step = max(size for size in (1.0, 2.0, 5.0) if size * decade <= step * (1 + 1e-9)) * decade
    return Recorder(white, coloured, corner, mains if rate > LEAST_RATE else 0.0, frequency, step)


def read(signal: Array, recorder: Recorder, rate: float, rng: np.random.Generator) -> Array:
    """Return what is recorded of a signal."""
    from scipy.signal import lfilter

    n, warm = len(signal), 2000
    pole = float(np.exp(-2 * pi * recorder.corner / rate))
    coloured = lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(n + warm))[warm:]
    t = np.arange(n) / rate
    mains = recorder.mains * np.sin(2 * pi * recorder.mains_frequency * t + rng.uniform(-pi, pi))
    value = signal + recorder.white * rng.standard_normal(n) + recorder.coloured * coloured + mains
    digits = max(0, -floor(log10(recorder.step)))
    return np.asarray(np.round(recorder.step * np.round(value / recorder.step), digits))
