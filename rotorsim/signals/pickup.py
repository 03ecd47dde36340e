"""Mains hum and other pick-up of a fixed frequency: found in all runs together, fitted along with the harmonics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import tau

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording
from rotorsim.signals.asynchronous import MISSES, Asynchronous, fitted_frequency, spectra_of
from rotorsim.signals.harmonic_fit import fit_harmonics
from rotorsim.signals.harmonics import RunHarmonics, contradictions, harmonics_of, samples_of, with_one_noise
from rotorsim.signals.noise.lines import log_chance
from rotorsim.signals.noise.whitening import FALSE_ALARM
from rotorsim.units import conversion

MAINS = (50.0, 60.0)  # Hz
GRID_DRIFT = 0.01  # of it, either way: EN 50160 for interconnected grids
HIGHEST = 20  # rectifiers and saturated cores make them
AS_GOOD = 0.99  # of the best score: as good
LARGEST_RUN = 200_000  # samples of a run: fitting harmonics takes 1.4 kB for each, which a check is not to cost
PICKUP_STEP = 0.25  # of the resolution of the longest run
LINE_PERIODS = 20.0  # of hum in a run: in fewer, it is not told from motion that passes
HUM_MULTIPLES = (1, 2, 3, 4, 5, 6)  # rectifiers make those of two and six
HUM_PADDING = 4  # bins in the resolution of a run
BESIDE_NEAR, BESIDE_FAR = 2, 12  # times the resolution: between, the spectrum beside a line is looked at
LEAST_POWER = 20.0  # times the power there, mean of all channels: noise makes as much once in e^20 looks at one channel
HIGHEST_HUM = 0.45  # of the sample rate


@dataclass(frozen=True)
class Pickup:
    """Pick-up: a line of fixed frequency [Hz] that is no motion. amplitude: 0-peak by channel, rms over runs.

    near: runs in which it is within the resolution of an order, and that order.
    """

    frequency: float
    amplitude: dict[str, float]
    near: tuple[tuple[str, int], ...] = ()


def find_mains(recording: Recording, runs: Sequence[RunHarmonics]) -> list[float]:
    """Return the frequencies [Hz] at which all runs together show the mains or its multiples, ascending; or none.

    Power of all runs at m f, chi-squared without a line, with f about 50 and 60 Hz: the grid's to one in a hundred.
    """
    with one_thread():
        spectra = spectra_of(recording, runs)
        if not spectra:
            return []
        finest = PICKUP_STEP * min(4 * item.step for item in spectra)
        m = np.arange(1, HIGHEST + 1)
        candidates: list[tuple[float, np.ndarray]] = []
        for mains in MAINS:
            reach = np.arange(0.0, GRID_DRIFT * mains, finest / HIGHEST)
            grid = np.concatenate([mains - reach[:0:-1], mains + reach])
            chance = log_chance(spectra, [np.multiply.outer(m, grid)] * len(spectra))
            looked = 2 * HIGHEST * max(2 * GRID_DRIFT * mains * HIGHEST / finest * PICKUP_STEP, 1.0)
            significant = chance < np.log(FALSE_ALARM / looked)
            score = np.where(significant, chance, 0.0).sum(axis=0)
            best = int(np.median(np.flatnonzero(score <= AS_GOOD * score.min())))  # near strong lines all are alike
            if score[best] < 0:
                candidates.append((float(score[best]), m[significant[:, best]] * grid[best]))
        if not candidates:
            return []
        lines = min(candidates, key=lambda item: item[0])[1]
        return [_refined(recording, runs, float(at)) for at in lines]


def _refined(recording: Recording, runs: Sequence[RunHarmonics], frequency: float) -> float:
    """Return the frequency near a first one that holds most power in all runs."""
    close = MISSES / max(float(np.ptp(item.run.time)) for item in runs)
    for _ in range(4):  # each looks within half the resolution
        before = frequency
        frequency = fitted_frequency(Asynchronous(tau * before, 0.0, False, (0,)), recording, runs)[1].value / tau
        if abs(frequency - before) < close:
            break
    return frequency


def with_pickups(
    recording: Recording, runs: Sequence[RunHarmonics], frequencies: Sequence[float]
) -> tuple[tuple[RunHarmonics, ...], list[Pickup]]:
    """Return runs with lines of fixed frequencies [Hz] fitted along, free in each channel and run, and their sizes.

    Where a line is within the resolution of an order, the two are one: that order is as uncertain as the line is large
    in the other runs.
    """
    if not frequencies:
        return tuple(runs), []
    with one_thread():
        fitted = [_refitted(recording, item, frequencies, {}) for item in runs]
        names = list(dict.fromkeys(name for item in fitted for name in item.fit.names))
        pickups = []
        for frequency in frequencies:
            told = [item for item in fitted if frequency in item.fit.pickups]
            near = tuple(
                (item.fit.run, _order(item, frequency)) for item in fitted if frequency not in item.fit.pickups
            )
            pickups.append(Pickup(frequency, {name: _size(told, frequency, name) for name in names}, near))
        hums = [_hum(item, pickups) for item in fitted]
        again = [
            item if len(item.fit.pickups) == len(frequencies) else _refitted(recording, item, frequencies, hum)
            for item, hum in zip(fitted, hums, strict=True)
        ]
    return tuple(with_one_noise(again)), pickups


def _order(item: RunHarmonics, frequency: float) -> int:
    """Return the order of the speed that is nearest to a frequency [Hz]."""
    return round(frequency * tau / abs(item.fit.speed))


def _size(runs: Sequence[RunHarmonics], frequency: float, name: str) -> float:
    """Return the 0-peak amplitude of a line in a channel, rms over runs; zero where noise alone may make it.

    What noise alone makes of it is taken off.
    """
    squares, noise = [], []
    for item in runs:
        if name in item.fit.names:
            c = item.fit.names.index(name)
            amplitude, gram = item.fit.pickups[frequency]
            squares.append(float(np.abs(amplitude[c]) ** 2))
            at_order = item.fit.noise.at_order(min(_order(item, frequency), int(item.fit.orders[-1])))
            noise.append(float(gram * at_order[c, c].real))
    if not squares or 2 * np.sum(np.divide(squares, np.maximum(noise, 1e-300))) < chi2.isf(
        FALSE_ALARM, 2 * len(squares)
    ):
        return 0.0
    return float(np.sqrt(max(float(np.mean(squares) - np.mean(noise)), 0.0)))


def _hum(item: RunHarmonics, pickups: Sequence[Pickup]) -> dict[int, np.ndarray]:
    """Return the variance (C,) that lines near an order add to its real and imaginary part, A/2 e^{i phi} each."""
    fit = item.fit
    hum: dict[int, np.ndarray] = {}
    for pickup in pickups:
        order = _order(item, pickup.frequency)
        if pickup.frequency not in fit.pickups and order < len(fit.orders):
            share = np.sinc((pickup.frequency - order * abs(fit.speed) / tau) * float(np.ptp(item.run.time)))
            variance = np.array([(pickup.amplitude[name] * share) ** 2 / 8 for name in fit.names])
            hum[order] = hum.get(order, 0.0) + variance
    return hum


def _refitted(
    recording: Recording, item: RunHarmonics, frequencies: Sequence[float], hum: Mapping[int, np.ndarray]
) -> RunHarmonics:
    fit = fit_harmonics(
        samples_of(recording, item.run, item.angle, item.lost),
        orders=int(item.fit.orders[-1]),
        pickups=frequencies,
        hum=hum,
    )
    return replace(item, fit=fit)


def mains_lines(residual: np.ndarray, dt: float) -> tuple[float, ...]:
    """Return the frequencies [Hz] of lines of the mains that stand out of their neighbourhood in a residual (N, c).

    Of a shaft whose speed changes: motion passes each frequency in a moment.
    """
    size = len(residual)
    length = next_fast_len(HUM_PADDING * size, real=True)
    power = np.abs(rfft(residual, length, axis=0)) ** 2 / size
    step = 1 / (length * dt)
    near, far = BESIDE_NEAR * HUM_PADDING, BESIDE_FAR * HUM_PADDING
    found: list[float] = []
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
        line = float(minimize_scalar(less, bounds=bracket, method="bounded", options={"xatol": 1e-3 * step}).x)
        if all(abs(line - other) * dt * size > BESIDE_NEAR for other in found):
            found.append(line)
    return tuple(found)


def check_harmonics(recording: Recording) -> list[Problem]:
    """Return warnings of what harmonics show: pulses that they contradict, and lines of the mains in some channel.

    Of recordings of which all runs have harmonics, and none more than LARGEST_RUN samples.
    """
    if any(len(run.time) > LARGEST_RUN for run in recording.runs):
        return []
    try:
        runs = harmonics_of(recording)
    except RotorsimError:  # no turning shaft, a run-up, what `check_signals` says
        return []
    lines = with_pickups(recording, runs, find_mains(recording, runs))[1]
    treated = "picked up from the mains, or a force"
    return [*contradictions(runs), *pickup_warnings(lines, recording, "is asynchronous", treated)]


def pickup_warnings(pickups: Sequence[Pickup], recording: Recording, kind: str, treated: str) -> list[Problem]:
    """Return what is to be said of lines of fixed frequency: their sizes in the channels that show them.

    kind: what is known of them, treated: what is made of them, in words.
    """
    units = {channel.name: channel.unit for channel in recording.channels.values()}
    warnings = []
    for item in pickups:
        sizes = ", ".join(
            f"{size / conversion(units[name], None):.2g} {units[name]} in {name}"
            for name, size in item.amplitude.items()
            if size > 0
        )
        what = f"a line of {item.frequency:.2f} Hz {kind}: {sizes}: {treated}"
        warnings.append(Problem(what, recording.name, severity="warning"))
        for run, order in item.near:
            near = f"{item.frequency:.2f} Hz is not told from order {order} here: that order counts less"
            warnings.append(Problem(near, f"run {run}", severity="warning"))
    return warnings
