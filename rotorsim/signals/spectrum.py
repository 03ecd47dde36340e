"""Spectra of two-axis signals: full spectrum with phase compensation, and harmonics of the shaft angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import tau

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.recording import ANGLE
from rotorsim.simulation.result import Result
from rotorsim.units import AMPLITUDE_KINDS

DEFAULT_ORDERS = (0, 1, 2, 3, 5, 7, -1, -3, -5)  # thesis Table 2-2
LEAST_SAMPLES = 2 * max(DEFAULT_ORDERS)  # a turn: with fewer the highest of them appears as a lower one


@dataclass(frozen=True)
class FullSpectrum:
    """Two-sided complex amplitudes: frequency (n,) [Hz], ascending; amplitude (n,) complex, 0-peak.

    Positive frequencies are forward whirl, negative ones backward. running: shaft frequency [Hz], None if not
    known. phase_shift (n,) [rad], -pi..pi: what was subtracted from the phase of every line (thesis Table 2-3,
    "reference signal"); None without compensation.
    """

    signal: str
    unit: str
    frequency: np.ndarray
    amplitude: np.ndarray
    running: float | None = None
    phase_shift: np.ndarray | None = None

    def harmonics(self, orders: Sequence[float] = DEFAULT_ORDERS) -> Harmonics:
        """Return the lines at multiples of the running frequency, picked by index as in thesis Table 2-3.

        Raises RotorsimError when the running frequency is not known or its multiples lie between two lines.
        """
        if not self.running:
            hint = "give full_spectrum an angle or a reference"
            raise RotorsimError(Problem("the running frequency is not known", self.signal, hint=hint))
        lines = float(self.frequency[1] - self.frequency[0])
        places = np.asarray(orders, float) * self.running / lines + np.flatnonzero(self.frequency == 0)[0]
        beside = int(np.argmax(np.abs(places - np.round(places))))
        if abs(places[beside] - np.round(places[beside])) > 0.05:  # leakage of half a percent
            what = f"order {orders[beside]:g} lies between two lines of the spectrum"
            hint = "take a window of whole turns (last_turns), or harmonics(), which needs none"
            raise RotorsimError(Problem(what, self.signal, hint=hint))
        if places.min() < -0.5 or places.max() > len(self.frequency) - 0.5:
            top = float(self.frequency[-1]) / abs(self.running)
            what = f"order {max(orders, key=abs):g} is above half the sampling frequency (order {top:.3g})"
            raise RotorsimError(Problem(what, self.signal, hint="record more often"))
        values = self.amplitude[np.round(places).astype(int)]
        total = float(np.sum(np.abs(self.amplitude) ** 2))
        left = max(total - float(np.sum(np.abs(values) ** 2)), 0.0)  # Parseval
        return Harmonics(self.signal, self.unit, _orders(orders), values, np.sqrt(left / total) if total else 0.0)


@dataclass(frozen=True)
class Harmonics:
    """Complex harmonics R_k of r = x + i y about the shaft angle: orders (m,), values (m,), 0-peak.

    residual: its rms, as a share of the rms of the signal.
    """

    signal: str
    unit: str
    orders: tuple[float, ...]
    values: np.ndarray
    residual: float

    def __getitem__(self, order: float) -> complex:
        """Return R_k of one order. Raises RotorsimError when it is not there."""
        if order not in self.orders:
            hint = f"there are {', '.join(f'{k:g}' for k in self.orders)}"
            raise RotorsimError(Problem(f"no harmonic of order {order:g}", self.signal, hint=hint))
        return complex(self.values[self.orders.index(order)])

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Return the signal that they make up at shaft angles (n,): sum over k of R_k e^{i k theta}."""
        return np.asarray(np.exp(1j * np.outer(theta, self.orders)) @ self.values)

    def table(self, shown: str = "0-peak") -> str:
        """Return the table of amplitudes and phases as text, as thesis Table 2-2; the mean, of order 0, stays.

        shown: "0-peak", "peak-peak" or "rms".
        """
        scale, unit = (1e6, "um") if self.unit == "m" else (1.0, self.unit or "1")
        lines = [f"{self.signal}", f"{'order':>6}  {f'amplitude [{unit}, {shown}]':>26}  {'phase [deg]':>12}"]
        for order, value in zip(self.orders, self.values, strict=True):
            size = abs(value) * scale * (AMPLITUDE_KINDS[shown] if order else 1.0)
            lines.append(f"{order:>6g}  {size:>26.6g}  {np.degrees(np.angle(value)):>12.2f}")
        return "\n".join(lines)


def angle_of(result: Result) -> str | None:
    """Return the recorded shaft angle: ``clock.theta``, else the only signal named ``theta``, else None."""
    if ANGLE in result:
        return ANGLE
    found = [name for name in result.signals if name.endswith(".theta")]
    return found[0] if len(found) == 1 else None


def _orders(orders: Sequence[float]) -> tuple[float, ...]:
    return tuple(int(k) if float(k).is_integer() else float(k) for k in orders)


def samples_in(result: Result, window: tuple[float, float] | None) -> slice:
    """Return the samples t0 <= t < t1 of a window (default: all). Raises RotorsimError for fewer than 4."""
    time = result.time
    start, stop = window or (-np.inf, np.inf)
    inside = np.flatnonzero((time >= start - 1e-12) & (time < stop - 1e-12))
    if len(inside) < 4:
        what = f"window {start:g}..{stop:g} s holds {len(inside)} samples" if window else f"only {len(time)} samples"
        hint = f"the run covers {time[0]:g}..{time[-1]:g} s" if len(time) else "the run is empty"
        raise RotorsimError(Problem(what, hint=hint))
    return slice(int(inside[0]), int(inside[-1]) + 1)


def one_row(result: Result, signal: str, part: slice) -> np.ndarray:
    """Return samples (n,) of x + i y of one node. Raises RotorsimError for a signal of several."""
    r = result.complex(signal)[part]
    if r.ndim != 1:
        hint = f"name one of its {r.shape[1]} rows: '{signal}[1]'"
        raise RotorsimError(Problem("has several nodes", signal, hint=hint))
    return r


def finite(values: np.ndarray, result: Result, signal: str, part: slice = slice(None)) -> np.ndarray:
    """Return samples (n,) of part of a signal. Raises RotorsimError where one of them is not finite."""
    if not np.isfinite(values).all():
        at = result.time[part][np.argmin(np.isfinite(values))]
        raise RotorsimError(Problem(f"not finite from t = {at:g} s on", signal, hint=result.message), exit_code=1)
    return values


def few_samples(result: Result, angle: str = ANGLE) -> float | None:
    """Return how many samples there are in a turn where these are fewer than LEAST_SAMPLES, else None."""
    turns = abs(float(result[angle][-1] - result[angle][0])) / tau
    few = len(result.time) - 1 < LEAST_SAMPLES * turns * (1 - 1e-9)
    return (len(result.time) - 1) / turns if few else None


def last_turns(result: Result, angle: str = ANGLE, share: float = 0.2) -> tuple[float, float]:
    """Return the window of the last whole turns in the last share of a run (at least one turn) [s]."""
    time = result.time
    if len(time) < 4:
        raise RotorsimError(Problem(f"only {len(time)} samples", "window", hint="a longer run"))
    theta = result[angle] * (1 if result[angle][-1] >= result[angle][0] else -1)  # also a shaft that turns back
    step = time[1] - time[0]
    end = len(theta) - 1
    turns = max(np.floor((theta[end] - theta[int(end * (1 - share))]) / tau + 1e-9), 1.0)
    start = int(np.searchsorted(theta, theta[end] - turns * tau - 1e-9))
    return float(time[start]), float(time[start] + (end - start) * step)


def full_spectrum(
    result: Result,
    signal: str,
    *,
    window: tuple[float, float] | None = None,
    angle: str | None = ANGLE,
    reference: str | None = None,
) -> FullSpectrum:
    """Return the full spectrum of a two-axis signal: the FFT of x + i y, both signs of frequency.

    The FFT counts phase from the start of the window; the phase compensation of thesis eq. (2.46)-(2.51)
    counts it from theta = 0. Either with the recorded shaft ``angle`` (None: no compensation): line k = frequency /
    running frequency is turned by -k theta_0, with theta_0 the angle at the start of the window. Or with the
    recorded multi-harmonic ``reference`` (n, harmonics, 2) of eq. (2.48): its FFT has phase phi_i at harmonic i,
    which is subtracted there; lines between are turned in proportion to the first harmonic.

    Raises RotorsimError for signals without two axes, samples that are not equally spaced, or a short window.
    """
    part = samples_in(result, window)
    r = finite(one_row(result, signal, part), result, signal, part)
    n, steps = len(r), np.diff(result.time[part])
    if np.ptp(steps) > 1e-6 * abs(steps[0]):
        hint = "harmonics() fits signals that are sampled at any times"
        raise RotorsimError(Problem("the samples are not equally spaced", "time", hint=hint))
    step = float(result.time[part][-1] - result.time[part][0]) / (n - 1)
    amplitude = np.fft.fftshift(np.fft.fft(r)) / n
    frequency = np.fft.fftshift(np.fft.fftfreq(n, step))
    running: float | None = None
    shift: np.ndarray | None = None
    if reference is not None:
        running, shift = _reference_shift(result, reference, part, frequency)
    elif angle is not None:
        theta = result[angle][part]
        running = float((theta[-1] - theta[0]) / ((n - 1) * step) / tau) or None
        shift = None if running is None else frequency / running * theta[0]
    if shift is not None:
        amplitude = amplitude * np.exp(-1j * shift)
        shift = np.angle(np.exp(1j * shift))
    return FullSpectrum(signal, result.unit(signal), frequency, amplitude, running, shift)


def _reference_shift(result: Result, name: str, part: slice, frequency: np.ndarray) -> tuple[float, np.ndarray]:
    """Return running frequency [Hz] and phase of every line [rad] from a multi-harmonic reference."""
    s = result.complex(name)[part].reshape(len(frequency), -1)
    lines = np.fft.fftshift(np.fft.fft(s, axis=0), axes=0)
    at = np.argmax(np.abs(lines), axis=0)
    phase = np.angle(lines[at, np.arange(s.shape[1])])
    own = np.where(frequency[at] > 0, frequency[at], np.inf)
    first, running = int(np.argmin(own)), float(own.min())
    if running == np.inf:
        hint = "it needs harmonic 1, and a window of at least one turn"
        raise RotorsimError(Problem("has no forward harmonic", name, hint=hint))
    shift = frequency / running * phase[first]
    shift[at] = phase
    return running, shift


def harmonics(
    result: Result,
    signal: str,
    orders: Sequence[float] = DEFAULT_ORDERS,
    *,
    angle: str = ANGLE,
    window: tuple[float, float] | None = None,
) -> Harmonics:
    """Fit r = sum over k of R_k e^{i k theta} by least squares, for any window and a drifting speed.

    thesis eq. (2.37)-(2.45); with complex data the transpose there must be the conjugate transpose.
    orders: any, also fractions (1/2 of a rub). Raises RotorsimError when the window cannot separate them.
    """
    part = samples_in(result, window)
    r = finite(one_row(result, signal, part), result, signal, part)
    theta = finite(result[angle][part], result, angle, part)
    basis = np.exp(1j * np.outer(theta, np.asarray(orders, float)))
    values, _, rank, _ = np.linalg.lstsq(basis, r, rcond=None)
    if rank < len(orders):
        turns = float(np.ptp(theta)) / tau
        what = f"{len(orders)} harmonics cannot be separated in {turns:.3g} turns ({len(r)} samples)"
        raise RotorsimError(Problem(what, signal, hint="a longer window, or fewer and different orders"))
    left, rms = (float(np.sqrt(np.mean(np.abs(z) ** 2))) for z in (r - basis @ values, r))
    return Harmonics(signal, result.unit(signal), _orders(orders), values, left / rms if rms else 0.0)


def reconstruction_error(
    result: Result, harmonics: Harmonics, *, angle: str = ANGLE, window: tuple[float, float] | None = None
) -> np.ndarray:
    """Return how far harmonics are from their signal, for x and y: rms of the difference / rms, shape (2,).

    Source: thesis section 2.5, below Tables 2-2 and 2-3.
    """
    part = samples_in(result, window)
    r = finite(one_row(result, harmonics.signal, part), result, harmonics.signal, part)
    residual = r - harmonics.at(result[angle][part])
    error, rms = (np.sqrt([np.mean(z.real**2), np.mean(z.imag**2)]) for z in (residual, r))
    return np.asarray(np.divide(error, rms, out=np.zeros(2), where=rms > 0))
