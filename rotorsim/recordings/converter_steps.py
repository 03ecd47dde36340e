"""Steps of a converter that the readings themselves show, and the signal that went into it.

With more noise than steps the readings are the signal and a little more noise. With less, their harmonics are wrong by
parts of a step, and differently at every amplitude. The readings r still say between which bounds each sample was,
r - q/2 < y + e < r + q/2 with Gaussian noise e, so that harmonics of y and the noise follow by maximum likelihood
(interval-censored regression; Tobin, Econometrica 26 (1958) 24-36).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr
from threadpoolctl import threadpool_limits

from rotorsim.recordings.harmonic_fit import harmonic_basis, real_vector
from rotorsim.recordings.harmonics import RunHarmonics, harmonics_of
from rotorsim.recordings.noise import Line
from rotorsim.recordings.recording import Recording, Run

__all__ = ["Step", "find_steps", "step_of", "without_steps"]

SEEN = 10.0  # standard deviations by which steps must change the harmonics of all runs
UNEVEN = 0.02  # of a step, by which readings may miss their level: they are written with few digits
KNOWN = 1e-6  # of a step, to which it is known at best: no converter is better calibrated
FINE = 1.0  # standard deviations of what harmonics leave over: finer steps are noise
RESOLUTION = 1e-6  # of a signal's rms, that harmonics cannot be trusted to
SIMULATED = 4  # recordings by which the covariance is proved
MOST, CLOSE = 60, 1e-10  # iterations; gain of the log likelihood of a sample at which they end
ROOT = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True)
class Step:
    """The step of a converter [SI] with its standard deviation. seen: standard deviations that it is seen by."""

    size: float
    std: float
    seen: float = 0.0


def find_steps(recording: Recording, runs: Sequence[RunHarmonics]) -> dict[str, Step]:
    """Return the steps of channels, by flat name, whose harmonics they change by more than noise does."""
    coarse: dict[str, Step] = {}
    for c, name in enumerate(runs[0].fit.names if runs else ()):
        column = _column(recording, name)
        if not all(column in item.run.values for item in runs):
            continue
        step = step_of(np.concatenate([item.run.values[column] for item in runs]))
        left = min(float(item.fit.residual[item.fit.names.index(name)]) for item in runs)
        if step is not None and step.size > FINE * left:
            coarse[runs[0].fit.names[c]] = step
    if not coarse:
        return {}
    entered = without_steps(recording, runs, coarse)
    taken = {item.run.id for item in runs}
    again = harmonics_of(entered, [run for run in entered.runs if run.id in taken])
    found = {}
    for name, step in coarse.items():
        seen = float(np.sqrt(sum(_changed(old, new, name) for old, new in zip(runs, again, strict=True))))
        if seen > SEEN:
            found[name] = replace(step, seen=seen)
    return found


def step_of(readings: np.ndarray) -> Step | None:
    """Return the step of which all readings (n,) are whole multiples but for an offset; None if they have none."""
    levels = np.unique(readings)
    if len(levels) < 3 or not np.isfinite(levels).all():
        return None
    gaps = np.diff(levels)
    size = float(gaps[gaps > UNEVEN * np.median(gaps)].min())
    for _ in range(2):  # the first is good to a few digits, and multiples add up
        near = np.cumsum(np.concatenate([[0.0], np.round(gaps / size)]))
        middle, counted = levels - levels.mean(), near - near.mean()
        size = float(middle @ counted / (counted @ counted))
    missed = middle - size * counted
    if not size > 0 or np.abs(missed).max() > UNEVEN * size:
        return None
    spread = float(missed @ missed) / max(len(levels) - 2, 1) / float(counted @ counted)
    return Step(size, max(float(np.sqrt(spread)), KNOWN * size))


def without_steps(recording: Recording, runs: Sequence[RunHarmonics], steps: Mapping[str, Step]) -> Recording:
    """Return a recording with signals as they went into converters of known steps, in the runs given.

    Of each sample there is what the harmonics make of it and what its reading adds to that: the score of the likelihood
    over the mean information, so that least squares give the harmonics of greatest likelihood. Near the edge of a step
    a reading tells much, amid a step little: the information of each goes along as its weight.
    """
    known = {item.run.id: item for item in runs}
    new = []
    with threadpool_limits(1, "blas"):
        for run in recording.runs:
            if run.id in known:
                entered = _without(recording, known[run.id], (), steps)
                lines = harmonics_of(recording, [entered])[0].fit.lines  # those of the readings may be their steps
                run = _without(recording, known[run.id], lines, steps) if lines else entered
            new.append(run)
    return replace(recording, runs=tuple(new))


def _without(recording: Recording, item: RunHarmonics, lines: Sequence[Line], steps: Mapping[str, Step]) -> Run:
    """Return a run with the signals that went into its converters, which move by harmonics and these lines."""
    run, columns = item.run, _columns(item, lines)
    values, weights = dict(run.values), dict(run.weights)
    for name, step in steps.items():
        column = _column(recording, name)
        if column in values:
            values[column], weights[column] = _entered(np.asarray(values[column]), columns, step.size)
    return replace(run, values=values, weights=weights)


def _column(recording: Recording, name: str) -> str:
    return next(column for column, channel in recording.channels.items() if channel.name == name)


def _columns(item: RunHarmonics, lines: Sequence[Line]) -> np.ndarray:
    """Return the columns (n, m) of all that moves: harmonics, drift, and lines beside them."""
    orders = int(item.fit.orders[-1])
    columns = [harmonic_basis(item.run.id, item.run.time, item.angle.theta, orders=orders).columns]
    for line in lines:
        phase = 2 * np.pi * line.frequency * item.run.time
        columns.append(np.column_stack([np.cos(phase), np.sin(phase)]))
    return np.column_stack(columns)


def _entered(readings: np.ndarray, columns: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what went into a converter (n,), by the likeliest motion of these columns, and its information (n,).

    With few samples near edges the likelihood is no parabola: the information is divided by what simulated readings of
    the same motion miss it by.
    """
    q, _ = np.linalg.qr(columns / np.sqrt(np.mean(columns**2, axis=0)))
    q *= np.sqrt(len(readings))
    z = readings / step  # in steps
    found = _likeliest(z, q)
    motion, noise, score, told = _told(z, q, found)
    random, missed = np.random.default_rng(0), []
    for _ in range(SIMULATED):
        again = np.round(motion + noise * random.standard_normal(len(z)))
        moved, _, _, weights = _told(again, q, _likeliest(again, q, found))
        missed.append(float(weights @ (moved - motion) ** 2) / q.shape[1])
    signal = motion + score / told.mean()
    return np.asarray(step * signal), np.asarray(told / max(1.0, float(np.mean(missed))) / step**2)


def _told(
    z: np.ndarray, columns: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:  # fmt: skip
    """Return motion (n,), noise, and of each reading the slope and the bend of the log likelihood by the motion."""
    inverse = float(x[-1])
    motion = columns @ (x[:-1] / inverse)
    upper, lower = inverse * (z + 0.5 - motion), inverse * (z - 0.5 - motion)
    a, b, _ = _slopes(upper, lower)
    told = np.maximum((upper * a + a**2 - 2 * a * b - lower * b + b**2) * inverse**2, 0.0)
    return motion, 1 / inverse, (b - a) * inverse, told


def _likeliest(z: np.ndarray, columns: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Return factors c / sigma and 1 / sigma (m + 1,) of greatest likelihood, by Newton: it is concave in these.

    z: readings in steps (n,). columns (n, m) with squares of mean one.
    """
    if start is None:
        first = columns.T @ z / len(z)
        left = float(np.mean((z - columns @ first) ** 2))
        start = np.append(first, 1.0) / np.sqrt(max(left - 1 / 12, 0.01))
    x = start
    value = _log_likelihood(x, z, columns)
    for _ in range(MOST):
        upper = x[-1] * (z + 0.5) - columns @ x[:-1]
        lower = x[-1] * (z - 0.5) - columns @ x[:-1]
        a, b, _ = _slopes(upper, lower)
        ends = np.column_stack([z + 0.5, z - 0.5])
        gradient = np.append(-columns.T @ (a - b), a @ ends[:, 0] - b @ ends[:, 1])
        uu, ul, ll = -upper * a - a**2, a * b, lower * b - b**2
        by_end = np.column_stack([uu * ends[:, 0] + ul * ends[:, 1], ul * ends[:, 0] + ll * ends[:, 1]])
        cross = -columns.T @ by_end.sum(axis=1)
        hessian = np.empty((len(x), len(x)))
        hessian[:-1, :-1] = columns.T @ (columns * (uu + 2 * ul + ll)[:, None])
        hessian[:-1, -1] = hessian[-1, :-1] = cross
        hessian[-1, -1] = float(np.sum(by_end * ends))
        step = np.linalg.lstsq(hessian, -gradient, rcond=1e-14)[0]
        length = 1.0
        while length > 1e-6:
            trial = x + length * step
            better = _log_likelihood(trial, z, columns) if trial[-1] > 0 else -np.inf
            if better >= value:
                break
            length /= 2
        else:
            break
        gained, x, value = better - value, trial, better
        if gained < CLOSE * len(z):
            break
    return x


def _log_likelihood(x: np.ndarray, z: np.ndarray, columns: np.ndarray) -> float:
    motion = columns @ x[:-1]
    return float(_slopes(x[-1] * (z + 0.5) - motion, x[-1] * (z - 0.5) - motion)[2].sum())


def _slopes(upper: np.ndarray, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return phi(upper) / P, phi(lower) / P and log P, with P = Phi(upper) - Phi(lower), far out too."""
    turned = lower > 0
    u, v = np.where(turned, -lower, upper), np.where(turned, -upper, lower)
    log_u, log_v = log_ndtr(u), log_ndtr(v)
    log_p = log_u + np.log1p(-np.exp(np.minimum(log_v - log_u, -1e-300)))
    return np.exp(-0.5 * upper**2 - ROOT - log_p), np.exp(-0.5 * lower**2 - ROOT - log_p), log_p


def _changed(old: RunHarmonics, new: RunHarmonics, name: str) -> float:
    """Return the square of the change of a channel's harmonics in one run, in variances of their noise."""
    column = np.array([old.fit.names.index(name)])
    change = real_vector((new.fit.values - old.fit.values)[:, column])
    covariance = old.fit.covariance_at(column, range(len(old.fit.orders)), RESOLUTION)
    return float(change @ np.linalg.solve(covariance, change))
