"""What the sensors of a shaft that turns add to its motion: hum and drift, fitted beside it in every run.

At steady speeds a line is told from harmonics by its frequency (`rotorsim.signals.pickup`). Where the speed changes,
motion passes each frequency in a moment, and a line is what stands out of its neighbourhood in the spectrum of the
residual. Sine and cosine are free in each channel and run, and so is a drift that grows from the first sample on:
residuals and sensitivities are taken beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem
from rotorsim.identification.waveform.noise_model import NoiseModel
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.signals.pickup import mains_lines

DRIFT_PARTS = 16  # of a run, whose means scatter: slow noise makes them scatter more


def with_sensor_errors(
    diagram: Diagram, channels: Channels, runs: Sequence[SampledRun], noise: NoiseModel, *, known: bool = True
) -> tuple[SampledRun, ...]:
    """Return runs with the lines of the mains and the drift that their residual shows, and notes on them.

    known: whether the runs are those of the noise, with its starts.
    """
    [whole, *_] = subsystems_of(diagram, channels)
    weights = {signal: 1 / value for signal, value in noise.variance.items()}
    search = OutputErrorSearch((whole,), runs, weights, noise.least, hold="theta")
    start = search.first(noise.starts if known else None)
    start[: search.m] = noise.theta
    here = search.evaluate(start, search.substeps(start), sensitivities=False) if known else search.minimise(start)
    if not np.isfinite(here.cost):
        return tuple(runs)
    pairs = zip(runs, here.residuals[0], strict=True)
    names = whole.equations.outputs
    return tuple(with_drift(_with_lines(run, np.nan_to_num(left), names), left, names) for run, left in pairs)


def _with_lines(run: SampledRun, residual: np.ndarray, names: Sequence[str]) -> SampledRun:
    if run.steps is not None or not residual.any():
        return run
    found = mains_lines(residual, run.dt)
    if not found:
        return run
    with_lines = replace(run, lines=tuple(found))
    basis = with_lines.nuisances
    assert basis is not None
    amplitude = np.sqrt(2 * ((basis.T @ residual) ** 2).sum(axis=0) / run.size)
    largest = int(np.argmax(amplitude / np.sqrt((residual**2).mean(axis=0) + 1e-300)))
    what = f"mains hum of {' and '.join(f'{line:.2f}' for line in found)} Hz is fitted beside the motion"
    what += f": {amplitude[largest]:.2g} in {names[largest]} (SI, 0-peak)"
    note = Problem(what, f"run {run.id}", severity="warning", code="mains_hum")
    return replace(with_lines, notes=(*run.notes, note))


def with_drift(run: SampledRun, residual: np.ndarray, names: Sequence[str]) -> SampledRun:
    """Return a run whose residual (N, c) drifts with a drift, where means of its parts do not scatter by as much."""
    parts = np.array_split(np.arange(run.size), DRIFT_PARTS)
    if run.size < DRIFT_PARTS or not all(np.isfinite(residual[part]).any(axis=0).all() for part in parts):
        return run
    means = np.stack([np.nanmean(residual[part], axis=0) for part in parts])
    time = np.array([run.time[part].mean() for part in parts])
    since = time - time.mean()
    slope = since @ means / (since @ since)
    left = means - means.mean(axis=0) - np.outer(since, slope)
    freedom = DRIFT_PARTS - 2
    std = np.sqrt((left**2).sum(axis=0) / freedom / (since @ since))
    chance = 2 * student.sf(np.abs(slope) / np.maximum(std, np.finfo(float).tiny), freedom)
    if chance.min() >= CRITERIA.drift:
        return run
    most = int(np.argmin(chance))
    size = slope[most] * (run.time[-1] - run.start)
    what = f"a drift is fitted beside the motion: {size:.2g} in {names[most]} (SI, over the run)"
    note = Problem(what, f"run {run.id}", severity="warning", code="sensor_drift")
    return replace(run, drift_since=run.start, notes=(*run.notes, note))
