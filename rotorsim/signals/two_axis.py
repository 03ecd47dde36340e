"""Harmonics of two-axis signals by method: forward and backward, how certain, and what they leave over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import ANGLE
from rotorsim.signals.harmonic_fit import HarmonicFit, Samples, fit_harmonics
from rotorsim.signals.spectrum import DEFAULT_ORDERS, Harmonics, full_spectrum, harmonics, reconstruction_error
from rotorsim.simulation.result import Result

__all__ = ["METHODS", "TwoAxis", "WhirlLine", "two_axis_harmonics", "two_axis_names", "whole_turns"]

METHODS = ("least-squares", "fft", "regression")
REFERENCE = "reference.measured"
TURN = 2 * np.pi


@dataclass(frozen=True)
class WhirlLine:
    """A spectral line that does not follow the shaft: frequency [Hz], amplitudes of both whirls, 0-peak."""

    frequency: float
    order: float
    forward: float
    backward: float


@dataclass(frozen=True, eq=False)
class TwoAxis:
    """Harmonics of x + i y about the shaft angle, ascending orders (m,).

    amplitude90 (m,), phase90 (m,) [rad]: half widths of 90 % intervals; significant (m,): False where noise alone
    makes as much more often than once in a thousand times; None where the method has no statistics. error: rms of
    what they leave over / rms of the signal, for x and y. window: (t0, t1) [s], t1 not included.
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
    found: list[str] = []
    for name, array in result.signals.items():
        if array.ndim == 2 and array.shape[1] == 2 and _measured(array):
            found.append(name)
        elif array.ndim == 3 and array.shape[2] == 2:
            found += [f"{name}[{k + 1}]" for k in range(array.shape[1]) if _measured(array[:, k])]
    return found


def _measured(pair: np.ndarray) -> bool:
    return bool((~np.isnan(pair)).any(axis=0).all())


def whole_turns(result: Result, window: tuple[float, float] | None = None, angle: str = ANGLE) -> tuple[float, float]:
    """Return the window of whole turns at the end of a window (default: of all), t1 not included [s].

    Of the upper half of the possible numbers of turns, it is the one that takes nearest to a whole number of samples:
    what the window lacks of whole turns leaks from line to line.
    Raises RotorsimError for less than one turn.
    """
    first, last = _samples(result, window)
    time = result.time
    theta = result[angle][first:last]
    theta = np.maximum.accumulate(theta if theta[-1] >= theta[0] else -theta)
    step = float(time[last - 1] - time[first]) / (last - first - 1)
    end = theta[-1] + (theta[-1] - theta[0]) / (len(theta) - 1)
    most = int(np.floor((end - theta[0]) / TURN + 1e-9))
    if most < 1:
        what = f"only {(end - theta[0]) / TURN:.3g} turns of the shaft in {time[first]:g}..{time[last - 1]:g} s"
        raise RotorsimError(Problem(what, hint="harmonics need at least one turn"))
    turns = np.arange(most, most // 2, -1)
    starts = np.interp(end - TURN * turns, theta, np.arange(len(theta)))
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
    drift and lines that do not follow the shaft; "fft", lines of the FFT over whole turns, phases by a multi-harmonic
    reference made of the angle (thesis (2.46)-(2.51)); "regression", least squares on the given orders alone
    (thesis (2.37)-(2.45), with the conjugate transpose). orders: of the latter two. angle_std: of angle zero [rad].
    use_mean: False leaves out order 0, for signals whose mean means nothing.

    Raises RotorsimError for unknown methods, signals that are not finite, windows that are too short.
    """
    if method not in METHODS:
        raise RotorsimError(Problem(f"unknown method '{method}'", signal, hint=f"one of {', '.join(METHODS)}"))
    first, last = _samples(result, window)
    if not use_mean:
        result = _centred(result, signal, slice(first, last))
    step = float(result.time[last - 1] - result.time[first]) / max(last - first - 1, 1)
    span = (float(result.time[first]), float(result.time[last - 1]) + 0.5 * step)
    if method == "least-squares":
        fitted = _least_squares(result, signal, span, slice(first, last), angle, angle_std)
        return fitted if use_mean else _without_mean(fitted)
    if method == "regression":
        found = harmonics(result, signal, sorted(orders), angle=angle, window=span)
    else:
        span = whole_turns(result, span, angle)
        found = _by_fft(result, signal, sorted(orders), span, angle)
    error = reconstruction_error(result, found, angle=angle, window=span)
    picked = TwoAxis(method, found, error, span, _turns(result, span, angle))
    return picked if use_mean else _without_mean(picked)


def _without_mean(found: TwoAxis) -> TwoAxis:
    """Return harmonics without order 0; what they leave over is counted with it."""
    keep = np.array(found.harmonics.orders) != 0
    orders = tuple(k for k in found.harmonics.orders if k)
    return replace(
        found,
        harmonics=replace(found.harmonics, orders=orders, values=found.harmonics.values[keep]),
        amplitude90=_kept(found.amplitude90, keep),
        phase90=_kept(found.phase90, keep),
        significant=_kept(found.significant, keep),
    )


def _kept(values: np.ndarray | None, keep: np.ndarray) -> np.ndarray | None:
    return None if values is None else values[keep]


def _samples(result: Result, window: tuple[float, float] | None) -> tuple[int, int]:
    """Return the first sample in t0 <= t < t1 and the one after the last."""
    time = result.time
    start, stop = window or (-np.inf, np.inf)
    inside = np.flatnonzero((time >= start - 1e-12) & (time < stop - 1e-12))
    if len(inside) < 4:
        what = f"window {start:g}..{stop:g} s holds {len(inside)} samples" if window else f"only {len(time)} samples"
        hint = f"the run covers {time[0]:g}..{time[-1]:g} s" if len(time) else "the run is empty"
        raise RotorsimError(Problem(what, hint=hint))
    return int(inside[0]), int(inside[-1]) + 1


def _turns(result: Result, span: tuple[float, float], angle: str) -> float:
    first, last = _samples(result, span)
    theta = result[angle]
    return float(abs(theta[last - 1] - theta[first])) / TURN * (last - first) / (last - first - 1)


def _centred(result: Result, signal: str, part: slice) -> Result:
    values = result[signal]
    return replace(result, signals={**result.signals, signal: values - values[part].mean(axis=0)})


def _by_fft(result: Result, signal: str, orders: Sequence[int], span: tuple[float, float], angle: str) -> Harmonics:
    theta = result[angle]
    wave = np.exp(1j * np.outer(theta, orders))
    reference = np.stack([wave.real, wave.imag], axis=-1)
    known = replace(result, signals={**result.signals, REFERENCE: reference})
    spectrum = full_spectrum(known, signal, window=span, angle=None, reference=REFERENCE)
    sign = 1 if theta[-1] > theta[0] else -1  # the spectrum takes the shaft to turn forward
    found = spectrum.harmonics([sign * k for k in orders])
    return replace(found, orders=tuple(orders))


def _least_squares(
    result: Result, signal: str, span: tuple[float, float], part: slice, angle: str, angle_std: float
) -> TwoAxis:
    r = result.complex(signal)
    if r.ndim != 1:
        hint = f"name one of its {r.shape[1]} rows: '{signal}[1]'"
        raise RotorsimError(Problem("has several nodes", signal, hint=hint))
    r, time, theta = r[part], result.time[part], result[angle][part]
    x, y = f"{signal}: x", f"{signal}: y"
    run = str(result.provenance.get("run") or result.provenance.get("diagram") or "")
    with one_thread():  # small matrices: threads cost more than they save
        fit = fit_harmonics(Samples(run, time, theta, {x: r.real, y: r.imag}, angle_std=angle_std))
        both = fit.two_axis(x, y)
        orders = sorted(both)
        values = np.array([both[k] for k in orders])
        spread = np.array([_covariance(fit, k) for k in orders])
    size = np.abs(values)
    along = np.stack([values.real, values.imag], -1) / np.where(size > 0, size, 1.0)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], -1)
    reach = float(student.ppf(0.95, fit.noise.freedom))
    radial, turned = (reach * np.sqrt(np.einsum("ki,kij,kj->k", u, spread, u)) for u in (along, across))
    parts = np.stack([values.real, values.imag], -1)
    distance = np.einsum("ki,ki->k", parts, np.linalg.solve(spread, parts[..., None])[..., 0])
    left = r - (fit.at(theta) @ np.array([1, 1j]))
    total = float(np.mean(np.abs(r) ** 2))
    share = float(np.sqrt(np.mean(np.abs(left) ** 2) / total)) if total else 0.0
    found = Harmonics(signal, result.unit(signal), tuple(orders), values, share)
    phase = np.minimum(np.divide(turned, size, out=np.full(len(size), np.inf), where=size > 0), np.pi)
    error = reconstruction_error(result, found, angle=angle, window=span)
    return TwoAxis(
        "least-squares",
        found,
        error,
        span,
        fit.turns,
        radial,
        phase,
        distance > chi2.isf(1e-3, 2),
        _lines(fit, time, left),
    )


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
    waves = np.exp(1j * TURN * np.outer(time, [line.frequency for line in lines]))
    basis = np.column_stack([waves, waves.conj(), np.vander(u, 3)])
    sizes = np.abs(np.linalg.lstsq(basis, left, rcond=None)[0])
    n = len(lines)
    return tuple(
        WhirlLine(line.frequency, line.order, float(sizes[k]), float(sizes[n + k])) for k, line in enumerate(lines)
    )
