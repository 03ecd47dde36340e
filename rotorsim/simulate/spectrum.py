"""Spectra of two-axis signals: full spectrum, harmonics of the shaft angle, envelope of a run-up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.simulate.result import Result

__all__ = [
    "DEFAULT_ORDERS", "FullSpectrum", "Harmonics", "RunUp", "envelope", "full_spectrum", "harmonics", "last_turns",
    "run_up",
]  # fmt: skip

DEFAULT_ORDERS = (0, 1, 2, 3, 5, 7, -1, -3, -5)  # thesis Table 2-2


@dataclass(frozen=True)
class FullSpectrum:
    """Two-sided complex amplitudes: frequency (n,) [Hz], ascending; amplitude (n,) complex, 0-peak.

    Positive frequencies are forward whirl, negative ones backward.
    """

    signal: str
    unit: str
    frequency: np.ndarray
    amplitude: np.ndarray


@dataclass(frozen=True)
class Harmonics:
    """Complex harmonics R_k of r = x + i y about the shaft angle: orders (m,), values (m,), 0-peak.

    residual: rms of what they leave over, as a share of the rms of the signal.
    """

    signal: str
    unit: str
    orders: tuple[int, ...]
    values: np.ndarray
    residual: float

    def __getitem__(self, order: int) -> complex:
        """Return R_k of one order."""
        return complex(self.values[self.orders.index(order)])

    def table(self) -> str:
        """Return the table of amplitudes and phases as text, as thesis Table 2-2."""
        scale, unit = (1e6, "um") if self.unit == "m" else (1.0, self.unit or "1")
        lines = [f"{self.signal}", f"{'order':>6}  {f'amplitude [{unit}, 0-peak]':>26}  {'phase [deg]':>12}"]
        for order, value in zip(self.orders, self.values, strict=True):
            lines.append(f"{order:>6}  {abs(value) * scale:>26.6g}  {np.degrees(np.angle(value)):>12.2f}")
        return "\n".join(lines)


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


def _window(result: Result, window: tuple[float, float] | None) -> slice:
    if window is None:
        return slice(0, len(result.time))
    inside = np.flatnonzero((result.time >= window[0] - 1e-12) & (result.time < window[1] - 1e-12))
    if len(inside) < 4:
        what = f"window {window[0]:g}..{window[1]:g} s holds {len(inside)} samples"
        raise RotorsimError(
            Problem(what, "window", hint=f"the result covers {result.time[0]:g}..{result.time[-1]:g} s")
        )
    return slice(int(inside[0]), int(inside[-1]) + 1)


def last_turns(result: Result, angle: str = "clock.theta", share: float = 0.2) -> tuple[float, float]:
    """Return the window of the last whole turns in the last share of a run (at least one turn) [s]."""
    theta, time = result[angle], result.time
    step = time[1] - time[0]
    end = len(theta) - 1
    turns = max(np.floor((theta[end] - theta[int(end * (1 - share))]) / (2 * np.pi) + 1e-9), 1.0)
    start = int(np.searchsorted(theta, theta[end] - turns * 2 * np.pi - 1e-9))
    return float(time[start]), float(time[start] + (end - start) * step)


def full_spectrum(
    result: Result, signal: str, *, window: tuple[float, float] | None = None, angle: str | None = "clock.theta"
) -> FullSpectrum:
    """Return the full spectrum of a two-axis signal: the FFT of x + i y, both signs of frequency.

    The FFT counts phase from the start of the window; multiplication by e^{-i k theta_0}, with theta_0 the
    shaft angle there and k = frequency / running frequency, counts it from theta = 0: the phase compensation
    of thesis eq. (2.46)-(2.51). angle: recorded shaft angle, or None for no compensation.
    """
    part = _window(result, window)
    r = result.complex(signal)[part]
    time = result.time[part]
    n, step = len(r), float(time[1] - time[0])
    amplitude = np.fft.fftshift(np.fft.fft(r)) / n
    frequency = np.fft.fftshift(np.fft.fftfreq(n, step))
    if angle is not None:
        theta = result[angle][part]
        running = (theta[-1] - theta[0]) / (time[-1] - time[0]) / (2 * np.pi)
        if running > 0:
            amplitude = amplitude * np.exp(-1j * frequency / running * theta[0])
    return FullSpectrum(signal, _unit(result, signal), frequency, amplitude)


def harmonics(
    result: Result,
    signal: str,
    orders: Sequence[int] = DEFAULT_ORDERS,
    *,
    angle: str = "clock.theta",
    window: tuple[float, float] | None = None,
) -> Harmonics:
    """Fit r = sum over k of R_k e^{i k theta} by least squares, for any window and a drifting speed.

    thesis eq. (2.37)-(2.45); with complex data the transpose there must be the conjugate transpose.
    """
    part = _window(result, window)
    r, theta = result.complex(signal)[part], result[angle][part]
    basis = np.exp(1j * np.outer(theta, np.asarray(orders)))
    values, *_ = np.linalg.lstsq(basis, r, rcond=None)
    rms = float(np.sqrt(np.mean(np.abs(r) ** 2)))
    left = float(np.sqrt(np.mean(np.abs(r - basis @ values) ** 2)))
    return Harmonics(signal, _unit(result, signal), tuple(int(k) for k in orders), values, left / rms if rms else 0.0)


def envelope(samples: np.ndarray) -> np.ndarray:
    """Return the Hilbert envelope |x + i H[x]| of a real signal, shape (n,)."""
    from scipy.signal import hilbert

    return np.asarray(np.abs(hilbert(samples)))


def run_up(result: Result, signal: str, *, speed: str = "clock.speed", edge: float = 0.02) -> RunUp:
    """Return the Hilbert envelope of one axis of a run-up against the speed, and its resonance.

    signal: a scalar signal such as ``rotor.displacement[1]``. The mean is taken out before; a share
    ``edge`` of both ends, where the transform of a finite record is wrong, is not searched.
    Source: thesis section 2.7 (Figure 2-11).
    """
    samples = np.asarray(result[signal], float)
    if samples.ndim != 1:
        hint = (
            f"name one entry: '{signal}[1]'"
            if "[" not in signal
            else "name one entry, such as 'rotor.displacement[4,1]'"
        )
        raise RotorsimError(Problem("not a scalar signal", signal, hint=hint))
    speeds = np.asarray(result[speed], float)
    if not (np.diff(speeds) >= 0).all() or speeds[-1] <= speeds[0]:
        raise RotorsimError(Problem("the speed does not rise", speed, hint="set clock.profile to ramp"))
    curve = envelope(samples - samples.mean())
    margin = int(len(samples) * edge)
    best = margin + int(np.argmax(curve[margin : len(curve) - margin]))
    return RunUp(signal, _unit(result, signal), speeds, samples, curve, float(speeds[best]), float(curve[best]))


def _unit(result: Result, signal: str) -> str:
    """Return the unit of a signal, of the recorded part that it is a part of, or of the whole port."""
    parts = signal.rstrip("]").replace("[", ",").split(",")
    for kept in range(len(parts), 0, -1):
        inside = ",".join(parts[1:kept])
        name = f"{parts[0]}[{inside}]" if inside else parts[0]
        if name in result.units:
            return result.units[name]
    return ""
