"""Harmonics of two-axis signals by method: forward and backward, their uncertainty, and the reconstruction error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import tau

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import ANGLE
from rotorsim.signals.harmonic_fit import HarmonicFit, Samples, fit_harmonics
from rotorsim.signals.noise.whitening import FALSE_ALARM
from rotorsim.signals.spectrum import (
    DEFAULT_ORDERS,
    Harmonics,
    full_spectrum,
    harmonics,
    one_row,
    reconstruction_error,
    samples_in,
)
from rotorsim.simulation.result import Result

SPECTRUM_METHODS = ("least-squares", "fft", "regression")
REFERENCE = "reference.measured"


@dataclass(frozen=True)
class WhirlLine:
    """An asynchronous line: frequency [Hz], amplitudes of both whirls, 0-peak."""

    frequency: float
    order: float
    forward: float
    backward: float


@dataclass(frozen=True, eq=False)
class TwoAxis:
    """Harmonics of x + i y about the shaft angle, ascending orders (m,).

    amplitude90 (m,), phase90 (m,) [rad]: half widths of 90 % intervals; significant (m,): False where noise alone
    makes as much more often than once in a thousand times; None where the method has no statistics. error: rms of
    the residual / rms of the signal, for x and y. window: (t0, t1) [s], t1 not included.
    """

    method: str
    harmonics: Harmonics
    error: np.ndarray
    window: tuple[float, float]
    turns: float
    amplitude90: np.ndarray | None = None
    phase90: np.ndarray | None = None
    significant: np.ndarray | None = None
    lines: tuple[WhirlLine, ...] = ()


def two_axis_names(result: Result) -> list[str]:
    """Return the signals [x, y] of a result of which both axes were measured, nodes by number."""
    names: list[str] = []
    for name, array in result.signals.items():
        if array.ndim == 2 and array.shape[1] == 2 and _measured(array):
            names.append(name)
        elif array.ndim == 3 and array.shape[2] == 2:
            names += [f"{name}[{k + 1}]" for k in range(array.shape[1]) if _measured(array[:, k])]
    return names


def _measured(pair: np.ndarray) -> bool:
    return bool((~np.isnan(pair)).any(axis=0).all())


def whole_turns(result: Result, window: tuple[float, float] | None = None, angle: str = ANGLE) -> tuple[float, float]:
    """Return the window of whole turns at the end of a window (default: of all), t1 not included [s].

    Of the upper half of the possible numbers of turns, it is the one that takes nearest to a whole number of samples:
    what the window lacks of whole turns leaks from line to line.
    Raises RotorsimError for less than one turn.
    """
    part = samples_in(result, window)
    first, last, time = part.start, part.stop, result.time
    theta = result[angle][part]
    theta = np.maximum.accumulate(theta if theta[-1] >= theta[0] else -theta)
    step = float(time[last - 1] - time[first]) / (last - first - 1)
    end = theta[-1] + (theta[-1] - theta[0]) / (len(theta) - 1)
    most = int(np.floor((end - theta[0]) / tau + 1e-9))
    if most < 1:
        what = f"only {(end - theta[0]) / tau:.3g} turns of the shaft in {time[first]:g}..{time[last - 1]:g} s"
        raise RotorsimError(Problem(what, hint="harmonics need at least one turn"))
    turns = np.arange(most, most // 2, -1)
    starts = np.interp(end - tau * turns, theta, np.arange(len(theta)))
    apart = np.round(np.abs(starts - np.round(starts)), 6)
    start = first + round(float(starts[np.argmin(apart)]))
    return float(time[start]), float(time[last - 1]) + 0.5 * step


def two_axis_harmonics(
    result: Result,
    signal: str,
    method: str = "least-squares",
    *,
    window: tuple[float, float] | None = None,
    angle: str = ANGLE,
    orders: Sequence[int] = DEFAULT_ORDERS,
    angle_std: float = 0.0,
    use_mean: bool = True,
) -> TwoAxis:
    """Return the harmonics R_k of r = x + i y = sum over k of R_k e^{i k theta}.

    method: "least-squares", every order that the samples carry, at most 16, with its covariance, beside a slow
    drift and asynchronous lines; "fft", lines of the FFT over whole turns, phases by a multi-harmonic
    reference made of the angle (thesis (2.46)-(2.51)); "regression", least squares on the given orders alone
    (thesis (2.37)-(2.45), with the conjugate transpose). orders: of the latter two. angle_std: of angle zero [rad].
    use_mean: False leaves out order 0, for signals whose mean means nothing.

    Raises RotorsimError for unknown methods, signals that are not finite, windows that are too short.
    """
    if method not in SPECTRUM_METHODS:
        raise RotorsimError(Problem(f"unknown method '{method}'", signal, hint=f"one of {', '.join(SPECTRUM_METHODS)}"))
    part = samples_in(result, window)
    if not use_mean:
        centred = result[signal] - result[signal][part].mean(axis=0)
        result = replace(result, signals={**result.signals, signal: centred})
    time = result.time[part]
    span = (float(time[0]), float(time[-1]) + 0.5 * float(time[-1] - time[0]) / (len(time) - 1))
    if method == "least-squares":
        return _least_squares(result, signal, span, angle, angle_std, use_mean)
    if method == "regression":
        fitted = harmonics(result, signal, sorted(orders), angle=angle, window=span)
    else:
        span = whole_turns(result, span, angle)
        fitted = _by_fft(result, signal, sorted(orders), span, angle)
    error = reconstruction_error(result, fitted, angle=angle, window=span)
    theta = result[angle][samples_in(result, span)]
    turns = float(abs(theta[-1] - theta[0])) / tau * len(theta) / (len(theta) - 1)
    return TwoAxis(
        method, _picked(fitted, np.array(fitted.orders) != 0) if not use_mean else fitted, error, span, turns
    )


def _picked(fitted: Harmonics, keep: np.ndarray) -> Harmonics:
    """Return some of the harmonics; the residual is that of all."""
    orders = tuple(order for order, kept in zip(fitted.orders, keep, strict=True) if kept)
    return replace(fitted, orders=orders, values=fitted.values[keep])


def _by_fft(result: Result, signal: str, orders: Sequence[int], span: tuple[float, float], angle: str) -> Harmonics:
    theta = result[angle]
    wave = np.exp(1j * np.outer(theta, orders))
    reference = np.stack([wave.real, wave.imag], axis=-1)
    known = replace(result, signals={**result.signals, REFERENCE: reference})
    spectrum = full_spectrum(known, signal, window=span, angle=None, reference=REFERENCE)
    sign = 1 if theta[-1] > theta[0] else -1  # the spectrum takes the shaft to turn forward
    return replace(spectrum.harmonics([sign * k for k in orders]), orders=tuple(orders))


def _least_squares(
    result: Result, signal: str, span: tuple[float, float], angle: str, angle_std: float, use_mean: bool
) -> TwoAxis:
    part = samples_in(result, span)
    r, time, theta = one_row(result, signal, part), result.time[part], result[angle][part]
    x, y = f"{signal}: x", f"{signal}: y"
    run = str(result.provenance.get("run") or result.provenance.get("diagram") or "")
    with one_thread():  # small matrices: threads cost more than they save
        fit = fit_harmonics(Samples(run, time, theta, {x: r.real, y: r.imag}, angle_std=angle_std))
        both = fit.two_axis(x, y)
        orders = sorted(both)
        spread = np.array([_covariance(fit, k) for k in orders])
    values = np.array([both[k] for k in orders])
    size, parts = np.abs(values), np.stack([values.real, values.imag], -1)
    along = parts / np.where(size > 0, size, 1.0)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], -1)
    reach = float(student.ppf(0.95, fit.noise.freedom))
    radial, turned = (reach * np.sqrt(np.einsum("ki,kij,kj->k", u, spread, u)) for u in (along, across))
    phase = np.minimum(np.divide(turned, size, out=np.full(len(size), np.inf), where=size > 0), np.pi)
    distance = np.einsum("ki,ki->k", parts, np.linalg.solve(spread, parts[..., None])[..., 0])
    significant = distance > chi2.isf(FALSE_ALARM, 2)
    residual = r - (fit.at(theta) @ np.array([1, 1j]))
    total = float(np.mean(np.abs(r) ** 2))
    share = float(np.sqrt(np.mean(np.abs(residual) ** 2) / total)) if total else 0.0
    fitted = Harmonics(signal, result.unit(signal), tuple(orders), values, share)
    error = reconstruction_error(result, fitted, angle=angle, window=span)
    keep = np.array(orders) != 0 if not use_mean else np.ones(len(orders), bool)
    statistics = (radial[keep], phase[keep], significant[keep], _lines(fit, time, residual))
    return TwoAxis("least-squares", _picked(fitted, keep), error, span, fit.turns, *statistics)


def _covariance(fit: HarmonicFit, order: int) -> np.ndarray:
    """Return the covariance (2, 2) of the real and imaginary part of R_order of x + i y."""
    k = abs(order)
    if k == 0:
        return fit.covariance[:2, :2]
    sign = 1 if order > 0 else -1
    at = slice(4 * k - 2, 4 * k + 2)  # real x, real y, imag x, imag y
    rows = np.array([[1.0, 0.0, 0.0, -sign], [0.0, 1.0, sign, 0.0]])
    return np.asarray(rows @ fit.covariance[at, at] @ rows.T)


def _lines(fit: HarmonicFit, time: np.ndarray, left: np.ndarray) -> tuple[WhirlLine, ...]:
    """Return the lines of a fit, each split into forward and backward whirl, by frequency."""
    if not fit.lines:
        return ()
    lines = sorted(fit.lines, key=lambda line: line.frequency)
    u = (time - time.mean()) / float(np.ptp(time))
    waves = np.exp(1j * tau * np.outer(time, [line.frequency for line in lines]))
    sizes = np.abs(np.linalg.lstsq(np.column_stack([waves, waves.conj(), np.vander(u, 3)]), left, rcond=None)[0])
    n = len(lines)
    return tuple(
        WhirlLine(line.frequency, line.order, float(sizes[k]), float(sizes[n + k])) for k, line in enumerate(lines)
    )
