"""Time stamps and samples as instruments deliver them: rounded stamps, jitter, lost rows, numbers that are missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorsim.criteria import CRITERIA

EVEN_SAMPLES = 1e-4  # of a sample period: jitter of the time column that counts as none
LOST_ROWS = 1.5  # of the usual step: a longer one lost rows
STAMP_DIGITS = 12  # of a time stamp [s] behind the point, at most
STAMP_ROUNDING = 1e-6  # of the last digit: rounding of binary numbers


def even_time(time: np.ndarray) -> np.ndarray | None:
    """Return even instants (n,) where stamps differ by no more than EVEN_SAMPLES, or their last digit; else None."""
    n = len(time)
    dt = float(time[-1] - time[0]) / (n - 1)
    even = time[0] + dt * np.arange(n)
    off = time - even
    if np.abs(off).max() <= EVEN_SAMPLES * dt:
        return np.asarray(even)
    line = np.polynomial.Polynomial.fit(np.arange(n), off, 1)(np.arange(n))
    rounding = float(np.abs(off - line).max())  # half a digit about the true line, less than one about that which fits
    return np.asarray(even + line) if rounding <= _last_digit(time) else None


def _last_digit(time: np.ndarray) -> float:
    """Return the step of the last decimal that any of some stamps has, zero where they have more than STAMP_DIGITS."""
    for digits in range(STAMP_DIGITS + 1):
        scaled = time * 10.0**digits
        if np.abs(scaled - np.round(scaled)).max() <= max(STAMP_ROUNDING, 4e-16 * np.abs(scaled).max()):
            return float(10.0**-digits)
    return 0.0


def with_lost_rows(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return instants (N,) with those of lost rows put in, and which of them were recorded, (N,).

    A step longer than LOST_ROWS times the usual one is divided into as many as fit.
    """
    steps = np.diff(time)
    usual = float(np.median(steps))
    parts = np.where(steps > LOST_ROWS * usual, np.round(steps / usual), 1).astype(int)
    first = np.repeat(np.arange(len(steps)), parts)
    within = np.arange(len(first)) - np.repeat(np.cumsum(parts) - parts, parts)
    filled = time[first] + steps[first] * within / parts[first]
    return np.append(filled, time[-1]), np.append(within == 0, True)


@dataclass(frozen=True, eq=False)
class Bridged:
    """An input with its missing samples filled in: values (N,), NaN where it is unknown all the same.

    filled: how many samples. error: what is expected of them, rms.
    """

    values: np.ndarray
    filled: int
    error: float


def bridged(time: np.ndarray, values: np.ndarray, kind: str) -> Bridged:
    """Return an input with gaps bridged as long as that changes it by no more than `Criteria.resolution` of its rms.

    What a gap of w samples costs is what the same curve misses where nothing is missing, on the average: the cubic
    through two samples on each side, or, of a signal of kind "hold" if that is better, the last value. A held signal
    that is the same on both sides is taken not to have changed. The most expensive gaps stay open.
    """
    missing = np.isnan(values)
    if not missing.any() or missing.all():
        return Bridged(values, 0, 0.0)
    known = np.flatnonzero(~missing)
    edges = np.diff(np.concatenate([[0], missing.astype(int), [0]]))
    gaps = zip(np.flatnonzero(edges > 0).tolist(), np.flatnonzero(edges < 0).tolist(), strict=True)
    inner = [(a, b) for a, b in gaps if known[0] < a and b <= known[-1]]
    curves = {w: _curve(time, values, w, kind) for w in {b - a for a, b in inner}}
    out, spent, filled = values.copy(), 0.0, 0
    scale = float(np.nansum((values - np.nanmean(values)) ** 2))
    costs = []
    for a, b in inner:
        same = kind == "hold" and values[a - 1] == values[b]
        costs.append(0.0 if same else (b - a) * curves[b - a][1] ** 2)
    for cost, (a, b) in sorted(zip(costs, inner, strict=True)):
        if spent + cost > CRITERIA.resolution**2 * scale:
            break
        spent += cost
        filled += int(b - a)
        held = values[a - 1] == values[b] or curves[b - a][0] == "hold"
        out[a:b] = values[a - 1] if kind == "hold" and held else _cubic(time, values, a, b)
    return Bridged(out, filled, float(np.sqrt(spent / max(filled, 1))))


def _neighbours(values: np.ndarray, a: int, b: int) -> list[int]:
    """Return the samples through which a gap [a, b) is bridged: the nearest two on each side if they are there."""
    wanted = [a - 2, a - 1, b, b + 1]
    return [k for k in wanted if 0 <= k < len(values) and np.isfinite(values[k])]


def _cubic(time: np.ndarray, values: np.ndarray, a: int, b: int) -> np.ndarray:
    """Return the polynomial through the neighbours of a gap [a, b) at its instants."""
    at, out = _neighbours(values, a, b), np.zeros(b - a)
    for k in at:
        others = [j for j in at if j != k]
        weights = np.prod([(time[a:b] - time[j]) / (time[k] - time[j]) for j in others], axis=0)
        out += values[k] * weights
    return out


def _curve(time: np.ndarray, values: np.ndarray, width: int, kind: str) -> tuple[str, float]:
    """Return the curve that bridges gaps of a width best, and the rms of its error in their middle.

    It is infinite where no stretch is long enough to tell.
    """
    n, middle = len(values), (width - 1) // 2
    first = np.arange(2, n - width - 1)
    around = np.array([first - 2, first - 1, first + width, first + width + 1])
    at = first + middle
    whole = np.isfinite(values[around]).all(axis=0) & np.isfinite(values[at])
    if not whole.any():
        return "cubic", np.inf
    around, at = around[:, whole], at[whole]
    t, y, s = time[around], values[around], time[at]
    predicted = sum(
        y[k] * np.prod([(s - t[j]) / (t[k] - t[j]) for j in range(4) if j != k], axis=0) for k in range(len(y))
    )
    errors = {"cubic": float(np.sqrt(np.mean((predicted - values[at]) ** 2)))}
    if kind == "hold":
        errors["hold"] = float(np.sqrt(np.mean((y[1] - values[at]) ** 2)))
    best = min(errors, key=lambda name: errors[name])
    return best, errors[best]
