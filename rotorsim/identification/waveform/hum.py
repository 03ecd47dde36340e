"""Mains hum in the sensors of a shaft that turns: lines of fixed frequency, fitted beside the motion in every run.

At steady speeds a line is told from harmonics by its frequency (`rotorsim.signals.pickup`). Where the speed changes,
motion passes each frequency in a moment, and a line is what stands out of its neighbourhood in the spectrum of the
residual. Sine and cosine are free in each channel and run: residuals and sensitivities are taken beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import tau

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.optimize import minimize_scalar

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem
from rotorsim.identification.waveform.data import LINE_PERIODS, Channels, SampledRun
from rotorsim.identification.waveform.noise_model import NoiseModel
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.signals.pickup import GRID_DRIFT, MAINS

HUM_MULTIPLES = (1, 2, 3, 4, 5, 6)  # rectifiers make those of two and six
HUM_PADDING = 4  # bins in the resolution of a run
BESIDE_NEAR, BESIDE_FAR = 2, 12  # times the resolution: between, the spectrum beside a line is looked at
LEAST_POWER = 20.0  # times the power there, mean of all channels: noise makes as much once in e^20 looks at one channel
HIGHEST_HUM = 0.45  # of the sample rate


def with_mains_hum(
    diagram: Diagram, channels: Channels, runs: Sequence[SampledRun], noise: NoiseModel, *, known: bool = True
) -> tuple[SampledRun, ...]:
    """Return runs with the lines of the mains that their residual shows, and a note on them.

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
    return tuple(_with_lines(run, np.nan_to_num(left), whole.equations.outputs) for run, left in pairs)


def _with_lines(run: SampledRun, residual: np.ndarray, names: Sequence[str]) -> SampledRun:
    if run.steps is not None or not residual.any():
        return run
    found: list[float] = []
    for line in _lines(residual, run.dt):
        if all(abs(line - other) * run.dt * run.size > BESIDE_NEAR for other in found):
            found.append(line)
    if not found:
        return run
    with_lines = replace(run, lines=tuple(found))
    basis = with_lines.line_basis
    assert basis is not None
    amplitude = np.sqrt(2 * ((basis.T @ residual) ** 2).sum(axis=0) / run.size)
    largest = int(np.argmax(amplitude / np.sqrt((residual**2).mean(axis=0) + 1e-300)))
    what = f"mains hum of {' and '.join(f'{line:.2f}' for line in found)} Hz is fitted beside the motion"
    what += f": {amplitude[largest]:.2g} in {names[largest]} (SI, 0-peak)"
    note = Problem(what, f"run {run.id}", severity="warning", code="mains_hum")
    return replace(with_lines, notes=(*run.notes, note))


def _lines(residual: np.ndarray, dt: float) -> Iterator[float]:
    """Yield the frequencies [Hz] of lines of the mains in a residual (N, c)."""
    size = len(residual)
    length = next_fast_len(HUM_PADDING * size, real=True)
    power = np.abs(rfft(residual, length, axis=0)) ** 2 / size
    step = 1 / (length * dt)
    near, far = BESIDE_NEAR * HUM_PADDING, BESIDE_FAR * HUM_PADDING
    for frequency in (m * mains for mains in MAINS for m in HUM_MULTIPLES):
        first, last = int(frequency * (1 - GRID_DRIFT) / step), int(frequency * (1 + GRID_DRIFT) / step) + 1
        if (
            frequency * dt > HIGHEST_HUM
            or first < far
            or last + far >= len(power)
            or frequency * size * dt < LINE_PERIODS
        ):
            continue
        best = first + int(np.argmax(power[first:last].sum(axis=1) if len(power[first:last]) else 0))
        beside = np.concatenate([power[best - far : best - near], power[best + near : best + far]])
        level = np.median(beside, axis=0) / np.log(2)  # of an exponential distribution
        if float(np.mean(power[best] / np.maximum(level, 1e-300))) < LEAST_POWER:
            continue
        weight, time = 1 / np.maximum(level, 1e-300), dt * np.arange(size)

        def less(f: float, weight: np.ndarray = weight, time: np.ndarray = time) -> float:
            return -float((np.abs(np.exp(-1j * tau * f * time) @ residual) ** 2 * weight).sum())

        bracket = ((best - HUM_PADDING / 2) * step, (best + HUM_PADDING / 2) * step)
        yield float(minimize_scalar(less, bounds=bracket, method="bounded", options={"xatol": 1e-3 * step}).x)
