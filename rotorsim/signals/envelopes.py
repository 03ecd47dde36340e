"""Run-ups: peaks of the turns and orders of a signal against the speed, and the resonances in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import tau

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.signals.spectrum import finite
from rotorsim.simulation.result import Result

SPEED_SIGNAL = "clock.speed"
SWEEP_ORDERS = (1, 2, 3)
WINDOW_TURNS = 3  # turns that an order is fitted over, with a Hann window: orders one apart do not leak into each other
PEAK_PROMINENCE = (
    0.2  # prominence over height: an unbalance response of damping ratio 0.45 peaks 1.25 above its limit 1
)
LEAKAGE = 0.02  # of the peak of the turn: below, an order may be leakage of a larger one (0.002 at 50 rad/s^2)


@dataclass(frozen=True)
class Resonance:
    """A local maximum of an order of the motion over the speed: order k, speed [rad/s], amplitude |R_k| (0-peak)."""

    order: int
    speed: float
    peak: float


@dataclass(frozen=True)
class RunUp:
    """A run-up turn by turn.

    speed, samples (n,): as they were recorded, [rad/s] and SI less the mean of the turn. speeds, peaks, spans, rms
    (turns,): speed in the middle of each turn, largest |x|, max x - min x and rms in it. orders: k -> |R_k| (turns,),
    0-peak; NaN where a window of some turns does not fit. largest: number of the largest turn after the
    start transient; ``rises``: it is among the last three, so that the resonance lies beyond.
    """

    signal: str
    unit: str
    speed: np.ndarray
    samples: np.ndarray
    speeds: np.ndarray
    peaks: np.ndarray
    spans: np.ndarray
    rms: np.ndarray
    orders: Mapping[int, np.ndarray]
    largest: int
    rises: bool

    @property
    def resonance(self) -> float:
        """Speed of the largest turn [rad/s]."""
        return float(self.speeds[self.largest])

    @property
    def peak(self) -> float:
        """Largest |x| in the largest turn."""
        return float(self.peaks[self.largest])

    def sizes(self, shown: str) -> np.ndarray:
        """Return the size of each turn as amplitudes are shown, (turns,): "0-peak", "peak-peak" or "rms"."""
        return {"0-peak": self.peaks, "peak-peak": self.spans, "rms": self.rms}[shown]

    def resonances(self) -> tuple[Resonance, ...]:
        """Return the largest resonance of every order that has one: a maximum that rises out of its flanks."""
        from scipy.signal import find_peaks

        largest = []
        for order, curve in self.orders.items():
            inside = np.flatnonzero(np.isfinite(curve))
            inside = inside[_transient(curve[inside]) :]
            at, _ = find_peaks(curve[inside], prominence=PEAK_PROMINENCE * np.nanmax(curve, initial=0.0))
            at = inside[at]
            at = at[curve[at] > LEAKAGE * self.peaks[at]]
            if len(at):
                best = int(at[np.argmax(curve[at])])
                largest.append(Resonance(order, float(self.speeds[best]), float(curve[best])))
        return tuple(largest)


def envelope(samples: np.ndarray) -> np.ndarray:
    """Return the Hilbert envelope |x + i H[x]| of a real signal, shape (n,).

    It is a line where one order is in the signal; the sum of several makes a band of it.
    """
    from scipy.signal import hilbert

    return np.asarray(np.abs(hilbert(samples)))


def run_up(result: Result, signal: str, *, speed: str = SPEED_SIGNAL, orders: Sequence[int] = SWEEP_ORDERS) -> RunUp:
    """Return one axis of a run-up turn by turn: peak of each turn, and its orders |R_k|, k > 0.

    x = sum over k of Re(R_k e^{i k theta}), fitted over three turns with a Hann window about the mean of the turn; the
    angle is the recorded one, else the integral of the speed. signal: a scalar one such as ``rotor.displacement[1]``.
    The start transient is not searched for a resonance: the turns until the peaks have fallen to their first minimum.
    Raises RotorsimError when the speed does not rise, and for too few turns or samples in a turn.
    """
    samples = finite(result.column(signal), result, signal)
    if len(samples) < 16:
        raise RotorsimError(Problem(f"only {len(samples)} samples", signal, hint="a longer run-up"))
    speeds = np.asarray(result[speed], float)
    if not (np.diff(speeds) >= 0).all() or speeds[-1] <= speeds[0]:
        raise RotorsimError(Problem("the speed does not rise", speed, hint="set clock.profile to ramp"))
    theta = _angle(result, speed, speeds)
    turns = int((theta[-1] - theta[0]) / (tau))
    if turns < 2 * WINDOW_TURNS:
        raise RotorsimError(Problem(f"only {turns} turns", speed, hint="a longer run-up"))
    starts = np.searchsorted(theta - theta[0], tau * np.arange(turns + 1))
    counts = np.diff(starts)
    if counts.min() < 4 * max(orders):
        what, hint = f"only {counts.min()} samples in a turn", "record more often (record_every), or fewer orders"
        raise RotorsimError(Problem(what, signal, hint=hint))
    means = np.add.reduceat(samples, starts[:-1])
    means[-1] -= samples[starts[-1] :].sum()
    middles = (starts[:-1] + starts[1:]) // 2
    about = samples - np.interp(np.arange(len(samples)), middles, means / counts)
    inside = [about[a:b] for a, b in pairwise(starts)]
    peaks = np.array([np.abs(turn).max() for turn in inside])
    begin = _transient(peaks)
    best = begin + int(np.argmax(peaks[begin:]))
    return RunUp(
        signal,
        result.unit(signal),
        speeds,
        about,
        speeds[middles],
        peaks,
        np.array([np.ptp(turn) for turn in inside]),
        np.array([np.sqrt(np.mean(turn**2)) for turn in inside]),
        {int(k): _order(about, theta, starts, int(k)) for k in orders},
        best,
        best >= turns - WINDOW_TURNS,
    )


def _angle(result: Result, speed: str, speeds: np.ndarray) -> np.ndarray:
    """Return the shaft angle (n,) [rad]: as recorded beside the speed, else the integral of the speed."""
    recorded = f"{speed.rpartition('.')[0]}.theta"
    if recorded in result and (np.diff(result[recorded]) >= 0).all():
        return np.asarray(result[recorded], float)
    return np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(result.time))])


def _transient(peaks: np.ndarray) -> int:
    """Return the number of the turn at which what decays from the start has fallen to its first minimum."""
    if len(peaks) < 3 or peaks[0] < peaks[: max(3, len(peaks) // 10)].max():
        return 0
    rising = np.flatnonzero(np.diff(peaks) > 0)
    return int(rising[0]) if len(rising) else 0


def _order(samples: np.ndarray, theta: np.ndarray, starts: np.ndarray, order: int) -> np.ndarray:
    """Return |R_k| in the middle of each turn, (turns,): 2 int w x e^{-i k theta} dtheta / int w dtheta."""
    from scipy.integrate import trapezoid  # np.trapezoid is of numpy 2; slow to load

    out = np.full(len(starts) - 1, np.nan)
    for turn in range(WINDOW_TURNS // 2, len(out) - WINDOW_TURNS // 2):
        first = turn - WINDOW_TURNS // 2
        part = slice(starts[first], starts[first + WINDOW_TURNS] + 1)
        angle = theta[part]
        weight = 0.5 - 0.5 * np.cos((angle - theta[0] - tau * first) / WINDOW_TURNS)
        value = trapezoid(weight * samples[part] * np.exp(-1j * order * angle), angle)
        out[turn] = 2 * abs(value) / trapezoid(weight, angle)
    return out


def resonance_peaks(
    result: Result, signal: str, *, speed: str = SPEED_SIGNAL, orders: Sequence[int] = SWEEP_ORDERS
) -> tuple[Resonance, ...]:
    """Return the resonances of a run-up, each a maximum of an order of the motion over the speed.

    Source: thesis section 2.6: "the 1x resonance ..., the 1/2x and 1/3x resonances". Raises RotorsimError as `run_up`.
    """
    return run_up(result, signal, speed=speed, orders=orders).resonances()
