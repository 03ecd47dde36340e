"""Noise that grows towards low frequencies: white and flicker noise in one density, from the power of a residual."""

from __future__ import annotations

import numpy as np

__all__ = ["colour_of", "density", "of_mean"]

STEEPNESS = (0.25, 3.0)  # of the slope: below it is white to the eye, above it is a drift
GROWTH = 1.08  # from one bin of lines to the next
ROUNDS, HALVINGS = 12, 6
ENOUGH = 0.01  # of minus the logarithm of the likelihood: a step that gains less is the last
OUTLIER = 12.0  # times the density, once in e^12 = 160 000 lines of noise: a line, that no density is taken from
SHARE_OF_WHITE = 1e-9
SESSION = 1000  # lengths of a run that its mean wanders in: some twenty minutes of runs of a second
_BELOW = np.geomspace(1.0 / SESSION, 1.0, 241)
_BEYOND = np.linspace(1.0, 41.0, 2001)


def density(colour: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return S(j) = a + b j^-c at lines j >= 1 (n,) of the spectrum (whole periods in the run), (n, C).

    colour (C, 3): a, b, c of every channel.
    """
    a, b, c = colour.T
    return np.asarray(a + b * np.power.outer(np.maximum(line, 1.0), -c).reshape(len(line), len(b)))


def of_mean(colour: np.ndarray) -> np.ndarray:
    """Return what white noise (C,) would make the mean over a run as uncertain: n times its variance.

    2 int sinc(j)^2 S(j) dj, from the lowest frequency of a SESSION on. Below the first line of the run nothing was
    measured: there the density goes on as 1 / j, whose octaves hold the same power.
    """
    a, b, c = colour.T
    total = np.zeros(len(b))
    for grid, steep in ((_BELOW, np.ones_like(c)), (_BEYOND, c)):
        values = 2 * np.sinc(grid)[:, None] ** 2 * np.power.outer(grid, -steep)
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


def _of_channel(power: np.ndarray, line: np.ndarray) -> np.ndarray:
    white = float(power.mean()) if len(power) else 0.0
    if not white > 0 or len(power) < 16:
        return np.array([white, 0.0, 1.0])
    place = np.floor(np.log(line) / np.log(GROWTH)).astype(int)
    starts = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
    count = np.diff(np.append(starts, len(line))).astype(float)
    p, j = np.add.reduceat(power, starts) / count / white, np.exp(np.add.reduceat(np.log(line), starts) / count)

    def cost(x: np.ndarray) -> float:
        S = np.exp(x[0]) + np.exp(x[1]) * j ** -x[2]
        return float((count * (np.log(S) + p / S)).sum())

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
    if 2 * (alone - least) < 2 * np.log(len(power)):
        return np.array([white, 0.0, 1.0])
    return np.array([white * np.exp(x[0]), white * np.exp(x[1]), x[2]])
