"""Noise that grows towards low frequencies: white and flicker noise in one density, from the power of a residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import spherical_jn
from scipy.stats import chi2

__all__ = ["Bands", "bands_of", "colour_of", "common_colour", "density", "of_mean"]

STEEPNESS = (0.25, 3.0)  # of the slope: below it is white to the eye, above it is a drift
GROWTH = 1.08  # from one bin of lines to the next
ROUNDS, HALVINGS = 12, 6
ENOUGH = 0.01  # of minus the logarithm of the likelihood: a step that gains less is the last
OUTLIER = 12.0  # times the density, once in e^12 = 160 000 lines of noise: a line, that no density is taken from
SHARE_OF_WHITE = 1e-9
SESSION = 1000  # lengths of a run that its mean wanders in: some twenty minutes of runs of a second
UNLIKE = 1e-3  # probability that noise of one colour differs so much in one run from that in the others
LEVELS = 3  # times that the level of each run and their colour are found in turn
_BELOW = np.geomspace(1.0 / SESSION, 1.0, 241)
_BEYOND = np.linspace(1.0, 41.0, 2001)


@dataclass(frozen=True, eq=False)
class Bands:
    """Mean power (B, C) of noise in bands of lines: count (B,) lines about frequency (B,) [Hz] each."""

    count: np.ndarray
    frequency: np.ndarray
    power: np.ndarray


def density(colour: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return S(j) = a + b j^-c at lines j >= 1 (n,) of the spectrum (whole periods in the run), (n, C).

    colour (C, 3): a, b, c of every channel.
    """
    a, b, c = colour.T
    return np.asarray(a + b * np.power.outer(np.maximum(line, 1.0), -c).reshape(len(line), len(b)))


def of_mean(colour: np.ndarray, degree: int = 0) -> np.ndarray:
    """Return what white noise (C,) would make the mean over a run as uncertain: n times its variance.

    2 int sinc(j)^2 S(j) dj, from the lowest frequency of a SESSION on. Below the first line of the run nothing was
    measured: there the density goes on as 1 / j, whose octaves hold the same power. degree: of the Legendre coefficient
    of time over the run that is asked for in place of the mean, (2 d + 1) j_d(pi j)^2 in place of sinc(j)^2.
    """
    a, b, c = colour.T
    total = np.zeros(len(b))
    for grid, steep in ((_BELOW, np.ones_like(c)), (_BEYOND, c)):
        window = (2 * degree + 1) * spherical_jn(degree, np.pi * grid) ** 2
        values = 2 * window[:, None] * np.power.outer(grid, -steep)
        total += ((values[1:] + values[:-1]) / 2 * np.diff(grid)[:, None]).sum(axis=0)
    return np.asarray(a + b * total)


def colour_of(power: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return a, b, c (C, 3) of the density S(j) = a + b j^-c that makes power (n, C) at lines j (n,) most likely.

    Whittle's likelihood: minus its logarithm is sum log S + power / S. Lines that stand out are left out. b is zero
    where white noise alone is as likely by the Bayesian information criterion.
    """
    found = np.zeros((power.shape[1], 3))
    for channel, p in enumerate(power.T):
        kept = np.ones(len(p), bool)
        for _ in range(3):
            found[channel] = _of_channel(p[kept], line[kept])
            standing = p <= OUTLIER * density(found[channel : channel + 1], line)[:, 0]
            if (standing == kept).all() or standing.sum() < len(p) // 2:
                break
            kept = standing
    return found


def bands_of(power: np.ndarray, line: np.ndarray, duration: float) -> Bands:
    """Return the bands of power (n, C) at lines (n,) of a run [s], those that stand out left at what is about them."""
    level = density(colour_of(power, line), line)
    starts, count = _starts(line)
    mean = np.add.reduceat(np.where(power <= OUTLIER * level, power, level), starts, axis=0) / count[:, None]
    return Bands(count, np.exp(np.add.reduceat(np.log(line), starts) / count) / duration, mean)


def common_colour(bands: Sequence[Bands | None], durations: Sequence[float]) -> list[np.ndarray | None]:
    """Return for runs of one channel the colour (3,) of noise that is the same in all but for its level.

    bands: (B, 1) of each run of so many seconds. Few lines of a run with few turns are not harmonics, and say little of
    noise at low frequencies; that of the instrument is the same in all runs. None for those that are not alike.
    """
    alike = [r for r, item in enumerate(bands) if item is not None]
    longest = max(durations, default=1.0)
    found: list[np.ndarray | None] = [None] * len(bands)
    while len(alike) > 1:
        parts = [_in_lines(item, longest) for item in (bands[r] for r in alike) if item is not None]
        level = np.array([np.average(p[len(p) // 2 :], weights=n[len(p) // 2 :]) for n, _, p in parts])
        if not (level > 0).all():
            return found
        count, line = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        for _ in range(LEVELS):
            law = _of_bands(count, line, np.concatenate([p / a for (_, _, p), a in zip(parts, level, strict=True)]))
            shapes = [_density(law, j) for _, j, _ in parts]
            level = np.array([np.average(p / S, weights=n) for (n, _, p), S in zip(parts, shapes, strict=True)])
        more = [
            2 * (_cost(a * S, n, p) - _cost(_density(_of_bands(n, j, p), j), n, p))
            for (n, j, p), S, a in zip(parts, shapes, level, strict=True)
        ]
        worst = int(np.argmax(more))
        if more[worst] <= chi2.isf(UNLIKE / len(alike), 2):
            for r, a in zip(alike, level, strict=True):
                found[r] = np.array([a * law[0], a * law[1] * (longest / durations[r]) ** -law[2], law[2]])
            break
        del alike[worst]
    return found


def _in_lines(bands: Bands, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return bands.count, bands.frequency * duration, bands.power[:, 0]


def _density(law: np.ndarray, line: np.ndarray) -> np.ndarray:
    return np.asarray(law[0] + law[1] * line ** -law[2])


def _cost(S: np.ndarray, count: np.ndarray, power: np.ndarray) -> float:
    """Return minus the logarithm of Whittle's likelihood."""
    return float((count * (np.log(S) + power / S)).sum())


def _starts(line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where bands of lines (n,) start, each GROWTH times the width of the one before, and how many they hold."""
    place = np.floor(np.log(line) / np.log(GROWTH)).astype(int)
    starts = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
    return starts, np.diff(np.append(starts, len(line))).astype(float)


def _of_channel(power: np.ndarray, line: np.ndarray) -> np.ndarray:
    if len(power) < 16 or not power.mean() > 0:
        return np.array([float(power.mean()) if len(power) else 0.0, 0.0, 1.0])
    starts, count = _starts(line)
    mean = np.exp(np.add.reduceat(np.log(line), starts) / count)
    return _of_bands(count, mean, np.add.reduceat(power, starts) / count)


def _of_bands(count: np.ndarray, j: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return a, b, c (3,) from the mean power p (B,) of count (B,) lines about lines j (B,)."""
    white = float(np.average(p, weights=count))
    p = p / white

    def cost(x: np.ndarray) -> float:
        return _cost(np.exp(x[0]) + np.exp(x[1]) * j ** -x[2], count, p)

    upper = float(np.average(p[len(p) // 2 :], weights=count[len(p) // 2 :]))
    lowest = max(float(np.average(p[:8] * j[:8], weights=count[:8])) - upper, 1e-3)
    x = np.array([np.log(max(upper, 1e-6)), np.log(lowest), 1.0])
    least = cost(x)
    for _ in range(ROUNDS):
        slope = np.exp(x[1]) * j ** -x[2]
        S = np.exp(x[0]) + slope
        J = np.column_stack([np.exp(x[0]) / S, slope / S, -slope * np.log(j) / S])
        gradient, bend = J.T @ (count * (1 - p / S)), (J * count[:, None]).T @ J
        step = -np.linalg.lstsq(bend + 1e-9 * np.trace(bend) * np.eye(3), gradient, rcond=None)[0]
        step *= min(1.0, 2.0 / max(float(np.abs(step).max()), 1e-300))
        for _ in range(HALVINGS):
            new = x + step
            new[0] = max(new[0], np.log(SHARE_OF_WHITE))
            new[2] = np.clip(new[2], *STEEPNESS)
            value = cost(new)
            if value < least:
                break
            step = step / 2
        else:
            break
        gained, x, least = least - value, new, value
        if gained < ENOUGH:
            break
    alone = float(count.sum())  # of white noise at its best: S = 1
    if 2 * (alone - least) < 2 * np.log(count.sum()):
        return np.array([white, 0.0, 1.0])
    return np.array([white * np.exp(x[0]), white * np.exp(x[1]), x[2]])
