"""Quantisation steps that the readings of a converter themselves show, and the signal that went into it.

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
from scipy.stats import chi2

from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording
from rotorsim.signals.covariance import real_vector
from rotorsim.signals.harmonic_basis import harmonic_basis
from rotorsim.signals.harmonic_fit import RESOLUTION
from rotorsim.signals.harmonics import RunHarmonics, harmonics_of
from rotorsim.signals.noise.lines import Line

CHANGED = 10.0  # distance, in standard deviations of the noise, by which steps must change the harmonics of all runs
UNEVEN = 0.02  # of a step, by which readings may miss their level: they are written with few digits
KNOWN = 1e-6  # of a step, to which it is known at best: no converter is better calibrated
TELLING = 3.0  # times as many samples that tell something as the motion takes: less tell nothing of the noise
BARELY = 1 / 3  # of a step: standard deviation of harmonics of which the readings tell no more
SIMULATED = 4  # recordings by which the covariance is widened
TAILS = 0.999  # probability of a miss that is still taken for one of a parabola
LINE_GAIN = 15.0  # logarithm of the likelihood that a line adds which is there
FEW, DITHERED = 3.0, 0.1  # steps that a run must move by to be told, unless noise of so many steps dithers it
LEAST_NOISE = 0.02  # of a step: with less, few samples tell anything, and their likelihood is a box and no parabola
ZERO_INFORMATION = 1e-12  # of the information of a sample at an edge
ROOT = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True)
class Step:
    """The quantisation step of a converter [SI] with its standard deviation.

    seen: distance of all harmonics with it from those without it, in standard deviations of the noise.
    """

    size: float
    std: float
    seen: float = 0.0


def find_steps(recording: Recording, runs: Sequence[RunHarmonics]) -> dict[str, Step]:
    """Return the steps of channels, by flat name, whose harmonics they change by more than noise does."""
    coarse: dict[str, Step] = {}
    for name in dict.fromkeys(name for item in runs for name in item.fit.names):
        least = min(item.fit.residual[item.fit.names.index(name)] for item in runs if name in item.fit.names)
        step = step_of(readings_of(recording, name))
        if step is not None and step.size > least:
            coarse[name] = step
    if not coarse:
        return {}
    entered = without_steps(recording, runs, coarse)
    taken = {item.run.id for item in runs}
    pairs = list(zip(runs, harmonics_of(entered, [run for run in entered.runs if run.id in taken]), strict=True))
    seen = {
        name: float(np.sqrt(sum(_changed(old, new, name) for old, new in pairs if name in old.fit.names)))
        for name in coarse
    }
    return {name: replace(step, seen=seen[name]) for name, step in coarse.items() if seen[name] > CHANGED}


def readings_of(recording: Recording, name: str) -> np.ndarray:
    """Return the samples of a signal in all runs that have it, one after another (n,)."""
    column = recording.column(name) or ""
    return np.concatenate([np.zeros(0), *(run.values[column] for run in recording.runs if column in run.values)])


def step_of(readings: np.ndarray) -> Step | None:
    """Return the quantisation step of which all readings (n,) are whole multiples but for an offset, or None."""
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
    a reading tells much, amid a step little: the information of each goes along as its weight. The noise of a channel
    is that of the runs that tell it.
    """
    new = {item.run.id: item.run for item in runs}
    with one_thread():
        for name, step in steps.items():
            column = recording.column(name) or ""
            here = [item for item in runs if column in item.run.values]
            plain = [_readings(item, column, step.size) for item in here]
            noise = _noise(plain)
            for item, readings in zip(here, plain, strict=True):
                signal = readings.signal(readings.likeliest(noise))
                alone = replace(item.run, values={**item.run.values, column: signal})
                lines = harmonics_of(recording, [alone])[0].fit.lines  # those of the readings may be their steps
                signal, weight = _with_lines(readings, item, column, lines, noise).entered(noise)
                run = new[item.run.id]
                values, weights = {**run.values, column: signal}, {**run.weights, column: weight}
                new[item.run.id] = replace(run, values=values, weights=weights)
    return replace(recording, runs=tuple(new.get(run.id, run) for run in recording.runs))


def _noise(readings: Sequence[_Readings]) -> float:
    """Return the noise of a channel in steps, from the runs in which enough samples tell it; LEAST_NOISE: none does."""
    total, weight = 0.0, 0.0
    for item in readings:
        x = item.likeliest()
        told = item.told(x)[2]
        telling, taken = float(told.sum() / x[-1] ** 2), item.columns.shape[1]
        if telling > TELLING * taken:  # the motion takes as many of these samples as it has columns
            total += telling / x[-1] ** 2
            weight += telling - taken
    return max(float(np.sqrt(total / weight)), LEAST_NOISE) if weight else LEAST_NOISE


@dataclass(frozen=True, eq=False)
class _Readings:
    """The readings of a channel in one run.

    z: in steps (n,). columns (n, m) of all that moves: harmonics, drift and lines beside them; squares have mean one.
    """

    z: np.ndarray
    columns: np.ndarray
    step: float

    def entered(self, noise: float) -> tuple[np.ndarray, np.ndarray]:
        """Return what went into the converter (n,) with noise of a known size in steps, and its information (n,).

        Where the likelihood is no parabola, the information is divided by what simulated readings of the same motion
        miss it by: by the most where that is no chance, as it has heavy tails. Where hardly any sample tells something,
        or all tell of the same edges, harmonics are those of the readings, to a part of a step.
        """
        x, m = self.likeliest(noise), self.columns.shape[1]
        motion, _, told = self.told(x)
        one_edge = noise < DITHERED and float(np.ptp(motion)) < FEW
        if one_edge or told.sum() * noise**2 < TELLING * m:
            every = np.full(len(motion), 0.5 / len(motion) / (BARELY * self.step) ** 2)
            return self.step * self.z, every
        random, missed = np.random.default_rng(0), []
        for _ in range(SIMULATED):
            again = replace(self, z=np.round(motion + noise * random.standard_normal(len(motion))))
            moved, _, weights = again.told(again.likeliest(noise, x))
            missed.append(float(weights @ (moved - motion) ** 2) / m)
        wide = max(missed) if max(missed) > chi2.ppf(TAILS, m) / m else max(1.0, float(np.mean(missed)))
        return self.signal(x), told / wide / self.step**2

    def signal(self, x: np.ndarray) -> np.ndarray:
        """Return the motion and what each reading adds to it, (n,) SI."""
        motion, score, told = self.told(x)
        return np.asarray(self.step * (motion + score / told.mean()))

    def told(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the motion (n,), score and information of each reading: derivatives of the log likelihood by it."""
        inverse = float(x[-1])
        upper, lower = self.ends(x)
        a, b, _ = interval_slopes(upper, lower)
        told = (upper * a + (a - b) ** 2 - lower * b) * inverse**2
        return self.columns @ x[:-1] / inverse, (b - a) * inverse, np.maximum(told, ZERO_INFORMATION * inverse**2)

    def ends(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of each reading about the motion, in standard deviations of the noise."""
        motion = self.columns @ x[:-1]
        return x[-1] * (self.z + 0.5) - motion, x[-1] * (self.z - 0.5) - motion

    def log_likelihood(self, x: np.ndarray) -> float:
        return float(interval_slopes(*self.ends(x))[2].sum())

    def likeliest(self, noise: float = 0.0, start: np.ndarray | None = None) -> np.ndarray:
        """Return factors c / sigma and 1 / sigma (m + 1,) of greatest likelihood, by Newton: it is concave in these.

        noise: sigma in steps, where it is known.
        """
        z, columns = self.z, self.columns
        if start is None:
            first = columns.T @ z / len(z)
            variance = float(np.mean((z - columns @ first) ** 2)) - 1 / 12
            start = np.append(first, 1.0) / (noise or np.sqrt(max(variance, 0.01)))
        x, ends, value = start, np.column_stack([z + 0.5, z - 0.5]), self.log_likelihood(start)
        free = slice(len(x) - 1 if noise else len(x))
        for _ in range(60):
            upper, lower = self.ends(x)
            a, b, _ = interval_slopes(upper, lower)
            gradient = np.append(-columns.T @ (a - b), a @ ends[:, 0] - b @ ends[:, 1])
            uu, ul, ll = -upper * a - a**2, a * b, lower * b - b**2
            by_end = np.column_stack([uu * ends[:, 0] + ul * ends[:, 1], ul * ends[:, 0] + ll * ends[:, 1]])
            cross = -columns.T @ by_end.sum(axis=1, keepdims=True)
            inner = columns.T @ (columns * (uu + 2 * ul + ll)[:, None])
            hessian = np.block([[inner, cross], [cross.T, np.sum(by_end * ends)]])
            step = np.zeros(len(x))
            step[free] = np.linalg.lstsq(hessian[free, free], -gradient[free], rcond=1e-12)[0]
            length, gained = 1.0, -np.inf
            while length > 1e-6 and not gained >= 0:
                trial = x + length * step
                gained = self.log_likelihood(trial) - value if trial[-1] > 0 else -np.inf
                length /= 2
            if not gained >= 0:
                break
            x, value = trial, value + gained
            if gained < 1e-10 * len(z):
                break
        return x


def _readings(item: RunHarmonics, column: str, step: float, lines: Sequence[Line] = ()) -> _Readings:
    """Return the readings of a run, of a motion with further lines."""
    time, orders = item.run.time, int(item.fit.orders[-1])
    basis = harmonic_basis(item.run.id, time, item.angle.theta, orders=orders)
    every = basis.with_lines(time, (line.frequency for line in lines)).columns
    q, _ = np.linalg.qr(every / np.sqrt(np.mean(every**2, axis=0)))
    return _Readings(np.asarray(item.run.values[column]) / step, q * np.sqrt(len(time)), step)


def _with_lines(readings: _Readings, item: RunHarmonics, column: str, lines: Sequence[Line], noise: float) -> _Readings:
    """Return readings with the lines that they show, one by one: pseudo-noise of steps has false ones."""
    best = readings
    kept: list[Line] = []
    value = best.log_likelihood(best.likeliest(noise))
    for line in sorted(lines, key=lambda line: -max(line.amplitude)):
        more = _readings(item, column, readings.step, [*kept, line])
        gained = more.log_likelihood(more.likeliest(noise)) - value
        if gained < LINE_GAIN:
            break
        best, value = more, value + gained
        kept.append(line)
    return best


def interval_slopes(upper: np.ndarray, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
