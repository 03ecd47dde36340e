"""What drives the runs: steps, multisines, chirps, random courses; every run begins at rest."""

from __future__ import annotations

from math import ceil, floor, log10

import numpy as np

from benchmarks.generic.native import Array
from benchmarks.generic.plants import Input, Plant

KINDS = ("steps", "multisine", "chirp", "random")
REST = 0.01  # of a run, before the excitation begins
DIGITS = 4  # of the amplitude: recorded inputs are rounded, and act as they are recorded


def course(kind: str, samples: int, rate: float, top: float, rng: np.random.Generator) -> Array:
    """Return a course between -1 and 1 whose power lies below the frequency top [Hz]."""
    t = np.arange(samples) / rate
    if kind == "steps":
        dwell = rng.uniform(0.7, 4.0, size=ceil(samples * top / rate) + 2) / top
        levels = rng.uniform(-1.0, 1.0, size=len(dwell))
        levels[:2] = rng.permutation([0.9, -0.9])  # large ones too, in every run
        return np.asarray(levels[np.searchsorted(np.cumsum(dwell), t)])
    if kind == "multisine":
        lines = np.unique(np.round(np.geomspace(max(top / 60.0, rate / samples), top, 30) * samples / rate))
        phases = rng.uniform(-np.pi, np.pi, size=len(lines))
        weights = lines**-0.3
        w = 2 * np.pi * rate / samples * lines
        found = weights @ np.sin(np.outer(w, t) + phases[:, None])
    elif kind == "chirp":
        low = top / 40.0
        growth = np.log(top / low) / t[-1]
        found = np.sin(2 * np.pi * low / growth * np.expm1(growth * t) + rng.uniform(-np.pi, np.pi))
    else:
        from scipy.signal import butter, sosfilt

        found = sosfilt(butter(2, min(top, 0.4 * rate), fs=rate, output="sos"), rng.standard_normal(samples + 500))
        found = found[500:]
    return np.asarray(found / np.abs(found).max())


def drive(plant: Plant, kind: str, samples: int, size: float, rng: np.random.Generator) -> Array:
    """Return the inputs of a run, samples x inputs: the first as kind says, others slowly about their means."""
    columns = []
    for k, item in enumerate(plant.inputs):
        values = course(kind if k == 0 else "multisine", samples, plant.rate, item.top, rng)
        values = item.mean + (size if k == 0 else 1.0) * item.amplitude * values
        values[: ceil(REST * samples)] = item.rest
        columns.append(rounded(item, values))
    return np.column_stack(columns)


def rounded(item: Input, values: Array) -> Array:
    """Return values in the digits in which an input is recorded."""
    return np.asarray(np.round(values, DIGITS - floor(log10(item.amplitude))))
