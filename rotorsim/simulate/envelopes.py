"""Run-ups: the Hilbert envelope of a signal against the speed, and the resonances in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.simulate.result import Result

__all__ = ["Resonance", "RunUp", "envelope", "resonance_peaks", "run_up"]

SPEED = "clock.speed"
REACH = 0.15  # of the speed where a sub-resonance is expected, to both sides


@dataclass(frozen=True)
class Resonance:
    """A peak of the envelope: order k of the excitation that meets it, speed [rad/s], peak (0-peak)."""

    order: int
    speed: float
    peak: float


@dataclass(frozen=True)
class RunUp:
    """Envelope of a run-up: speed (n,) [rad/s], envelope (n,); resonance speed [rad/s] and peak of the largest."""

    signal: str
    unit: str
    speed: np.ndarray
    samples: np.ndarray
    envelope: np.ndarray
    resonance: float
    peak: float

    def resonances(self, orders: Sequence[int] = (1, 2, 3)) -> tuple[Resonance, ...]:
        """Return the largest peak (order 1), and those near 1/k of its speed, met by harmonic k of the speed.

        Orders without a peak of their own are left out: there the envelope only rises towards an end of the
        searched speeds.
        """
        found = []
        for order in orders:
            if order == 1:
                found.append(Resonance(1, self.resonance, self.peak))
                continue
            expected = self.resonance / order
            start, stop = np.searchsorted(self.speed, (expected * (1 - REACH), expected * (1 + REACH)))
            if start == 0 or stop - start < 8:
                continue
            best = int(start + np.argmax(self.envelope[start:stop]))
            if abs(self.speed[best] / expected - 1) < 0.8 * REACH:
                found.append(Resonance(int(order), float(self.speed[best]), float(self.envelope[best])))
        return tuple(found)


def envelope(samples: np.ndarray) -> np.ndarray:
    """Return the Hilbert envelope |x + i H[x]| of a real signal, shape (n,)."""
    from scipy.signal import hilbert

    return np.asarray(np.abs(hilbert(samples)))


def run_up(result: Result, signal: str, *, speed: str = SPEED, edge: float = 0.02) -> RunUp:
    """Return the Hilbert envelope of one axis of a run-up against the speed, and its resonance.

    signal: a scalar signal such as ``rotor.displacement[1]``. The mean is taken out before; a share
    ``edge`` of both ends, where the transform of a finite record is wrong, is not searched.
    Source: thesis section 2.6 (Figure 2-11). Raises RotorsimError when the speed does not rise.
    """
    samples = np.asarray(result[signal], float)
    if samples.ndim != 1:
        hint = (
            f"name one entry: '{signal}[1]'"
            if "[" not in signal
            else "name one entry, such as 'rotor.displacement[4,1]'"
        )
        raise RotorsimError(Problem("not a scalar signal", signal, hint=hint))
    if not np.isfinite(samples).all():
        at = result.time[np.flatnonzero(~np.isfinite(samples))[0]]
        raise RotorsimError(Problem(f"not finite from t = {at:g} s on", signal, hint=result.message), exit_code=1)
    if len(samples) < 16:
        raise RotorsimError(Problem(f"only {len(samples)} samples", signal, hint="a longer run-up"))
    speeds = np.asarray(result[speed], float)
    if not (np.diff(speeds) >= 0).all() or speeds[-1] <= speeds[0]:
        raise RotorsimError(Problem("the speed does not rise", speed, hint="set clock.profile to ramp"))
    curve = envelope(samples - samples.mean())
    margin = int(len(samples) * edge)
    best = margin + int(np.argmax(curve[margin : len(curve) - margin]))
    return RunUp(signal, result.unit(signal), speeds, samples, curve, float(speeds[best]), float(curve[best]))


def resonance_peaks(
    result: Result, signal: str, *, speed: str = SPEED, orders: Sequence[int] = (1, 2, 3)
) -> tuple[Resonance, ...]:
    """Return the resonances of a run-up, read from its Hilbert envelope: the main one and those at 1/2, 1/3 of it.

    Source: thesis section 2.6: "the 1x resonance ..., the 1/2x and 1/3x resonances". Raises RotorsimError as `run_up`.
    """
    return run_up(result, signal, speed=speed).resonances(orders)
