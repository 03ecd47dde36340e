"""Noise that grows towards low frequencies: white and flicker noise in one density, from the power of a residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import spherical_jn
from scipy.stats import chi2

from rotorsim.signals.noise.whitening import FALSE_ALARM

STEEPNESS = (0.25, 3.0)  # of the power law: below it is white to the eye, above it is a drift
GROWTH = 1.08  # from one bin of lines to the next
ENOUGH = 0.01  # of minus the logarithm of the likelihood: a step that gains less is the last
OUTLIER = 12.0  # times the density, once in e^12 = 160 000 lines of noise: a line, that no density is taken from
SHARE_OF_WHITE = 1e-9
SESSION = 1000  # lengths of a run that its mean wanders in: some twenty minutes of runs of a second
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


def variance_of_mean(colour: np.ndarray, degree: int = 0) -> np.ndarray:
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
    laws = np.zeros((power.shape[1], 3))
    for channel, p in enumerate(power.T):
        kept = np.ones(len(p), bool)
        for _ in range(3):
            white = p[kept].sum() / max(kept.sum(), 1)
            told = kept.sum() >= 16 and white > 0
            laws[channel] = _law_of(*_in_bands(p[kept], line[kept])) if told else (white, 0.0, 1.0)
            standing = p <= OUTLIER * _at(laws[channel], line)
            if (standing == kept).all() or standing.sum() < len(p) // 2:
                break
            kept = standing
    return laws


def bands_of(power: np.ndarray, line: np.ndarray, duration: float, colour: np.ndarray) -> Bands:
    """Return the bands of power (n, C) at lines (n,) of a run [s], those that stand out left at what is about them.

    colour (C, 3): of it, see `colour_of`.
    """
    level = density(colour, line)
    count, middle, mean = _in_bands(np.where(power <= OUTLIER * level, power, level), line)
    return Bands(count, middle / duration, mean)


def common_colour(bands: Sequence[Bands | None], durations: Sequence[float]) -> list[np.ndarray | None]:
    """Return for runs of one channel the colour (3,) of noise that is the same in all but for its level.

    bands: (B, 1) of each run of so many seconds. Few lines of a run with few turns are not harmonics, and say little of
    noise at low frequencies; that of the instrument is the same in all runs. None for those that are not alike.
    """
    longest = max(durations, default=1.0)
    parts = {r: (b.count, b.frequency * longest, b.power[:, 0]) for r, b in enumerate(bands) if b is not None}
    colours: list[np.ndarray | None] = [None] * len(bands)
    while len(parts) > 1:
        level = np.array([np.average(p[len(p) // 2 :], weights=n[len(p) // 2 :]) for n, _, p in parts.values()])
        if not (level > 0).all():
            return colours
        count, line, power = (np.concatenate(each) for each in zip(*parts.values(), strict=True))
        run = np.repeat(np.arange(len(parts)), [len(n) for n, _, _ in parts.values()])
        for _ in range(3):
            law = _law_of(count, line, power / level[run])
            shapes = [_at(law, j) for _, j, _ in parts.values()]
            level = np.array(
                [np.average(p / S, weights=n) for (n, _, p), S in zip(parts.values(), shapes, strict=True)]
            )
        more = [
            2 * (_cost(a * S, n, p) - _cost(_at(_law_of(n, j, p), j), n, p))
            for (n, j, p), S, a in zip(parts.values(), shapes, level, strict=True)
        ]
        if max(more) <= chi2.isf(FALSE_ALARM / len(parts), 2):
            for r, a in zip(parts, level, strict=True):
                colours[r] = np.array([a * law[0], a * law[1] * (longest / durations[r]) ** -law[2], law[2]])
            break
        del parts[list(parts)[int(np.argmax(more))]]
    return colours


def _at(law: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return the density (n,) of one channel at lines (n,)."""
    return np.asarray(density(law[None], line)[:, 0])


def _cost(S: np.ndarray, count: np.ndarray, power: np.ndarray) -> float:
    """Return minus the logarithm of Whittle's likelihood."""
    return float((count * (np.log(S) + power / S)).sum())


def _in_bands(power: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return count (B,), mean place (B,) and mean power (B, ...) of lines (n,) in bands, each GROWTH times as wide."""
    place = np.floor(np.log(line) / np.log(GROWTH)).astype(int)
    starts = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
    count = np.diff(np.append(starts, len(line))).astype(float)
    mean = (np.add.reduceat(power, starts, axis=0).T / count).T
    return count, np.exp(np.add.reduceat(np.log(line), starts) / count), mean


def _law_of(count: np.ndarray, j: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return a, b, c (3,) from the mean power p (B,) of count (B,) lines about lines j (B,)."""
    white = float(np.average(p, weights=count))
    p = p / white

    def cost(x: np.ndarray) -> float:
        return _cost(np.exp(x[0]) + np.exp(x[1]) * j ** -x[2], count, p)

    upper = float(np.average(p[len(p) // 2 :], weights=count[len(p) // 2 :]))
    lowest = max(float(np.average(p[:8] * j[:8], weights=count[:8])) - upper, 1e-3)
    x = np.array([np.log(max(upper, 1e-6)), np.log(lowest), 1.0])
    least = cost(x)
    for _ in range(12):
        flicker = np.exp(x[1]) * j ** -x[2]
        S = np.exp(x[0]) + flicker
        J = np.column_stack([np.exp(x[0]) / S, flicker / S, -flicker * np.log(j) / S])
        gradient, hessian = J.T @ (count * (1 - p / S)), (J * count[:, None]).T @ J
        step = -np.linalg.solve(hessian + 1e-9 * np.trace(hessian) * np.eye(3), gradient)
        step *= min(1.0, 2.0 / max(float(np.abs(step).max()), 1e-300))
        for _ in range(6):
            new = x + step
            new[0], new[2] = max(new[0], np.log(SHARE_OF_WHITE)), np.clip(new[2], *STEEPNESS)
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
