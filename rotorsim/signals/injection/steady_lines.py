"""Lines that no test signal makes, in the spectra of a loop: orders of the shaft, mains hum, other steady motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar

from rotorsim.signals.injection.local_polynomial import Spectra, design, least_half, windows

THRESHOLD = 30.0  # times the mean power of the noise: noise is as large at one line in e^30
LINES_AROUND = 101  # lines of the spectrum, whose median is the level of the noise
FAINT = 1e-6  # of the power of a spectrum around it: what is less changes no response by 0.001
MOST_STEADY_LINES = 50
WITHIN = 0.01  # of the largest part of a line: further out it is smooth, and a transient


@dataclass(frozen=True)
class SteadyLine:
    """A line: frequency [Hz], amplitudes (q,) 0-peak of the outputs."""

    frequency: float
    amplitude: tuple[float, ...]


def without_shapes(spectra: Spectra, shapes: Sequence[np.ndarray]) -> Spectra:
    """Return spectra without lines of known shapes (K,), each fitted beside the response around its largest part."""
    for shape in shapes:
        at = int(np.argmax(np.abs(shape)))
        wide = np.flatnonzero(np.abs(shape) > WITHIN * np.abs(shape[at]))
        half = max(2 * least_half(spectra.U.shape[1]), int(np.abs(wide - at).max()))
        if 2 * half + 1 < len(spectra.U) - 1:
            around, places = windows(spectra, np.array([at * spectra.step]), half)
            spectra, _ = _without(spectra, shape, around, places)
    return spectra


def without_lines(spectra: Spectra, highest: float) -> tuple[Spectra, list[SteadyLine]]:
    """Return spectra without steady lines up to a frequency [Hz], and these; the strongest first.

    A line stands out of what the response, fitted around it, leaves at it. Its frequency is where it explains most.
    """
    half = least_half(spectra.U.shape[1])
    last = min(int(highest / spectra.step), len(spectra.U) - half - 2)
    found: list[SteadyLine] = []
    every = np.arange(half + 1, last + 1)
    every = every[spectra.excited()[every].any(axis=1)]
    if len(every) < 2 * LINES_AROUND:
        return spectra, found
    left = _left(spectra, every, half)
    level = median_filter(left, (LINES_AROUND, 1), mode="reflect") / np.log(2)
    size = median_filter(np.abs(spectra.Y[every]) ** 2, (LINES_AROUND, 1), mode="reflect")
    level = np.maximum(np.maximum(level, FAINT * size), 1e-300)
    while len(found) < MOST_STEADY_LINES:
        ratio = (left / level).max(axis=1)
        k = int(np.argmax(ratio))
        if ratio[k] < THRESHOLD:
            break
        around, places = windows(spectra, every[k : k + 1] * spectra.step, 2 * half)
        frequency = _frequency(spectra, int(every[k]), around, places)
        shape = _line(spectra, frequency, np.arange(len(spectra.U)))
        spectra, amplitude = _without(spectra, shape, around, places)
        found.append(SteadyLine(frequency, tuple((2 * np.abs(amplitude)).tolist())))
        near = slice(max(k - 4 * half, 0), k + 4 * half + 1)
        left[near] = _left(spectra, every[near], half)
    return spectra, found


def _left(spectra: Spectra, lines: np.ndarray, half: int) -> np.ndarray:
    """Return the power (n, q) that the response, fitted around each line, leaves at it."""
    around, places = windows(spectra, lines * spectra.step, half)
    parts = np.array_split(np.arange(len(lines)), 1 + around.size * spectra.U.shape[1] // 200_000)
    return np.concatenate([_left_at(spectra, around[part], places[part], half) for part in parts])


def _left_at(spectra: Spectra, around: np.ndarray, places: np.ndarray, half: int) -> np.ndarray:
    A = design(spectra.U[around], places)
    size = np.linalg.norm(A, axis=1, keepdims=True)
    Q, _ = np.linalg.qr(A / np.where(size > 0, size, 1.0))
    Y = spectra.Y[around]
    left = Y - Q @ (Q.conj().swapaxes(1, 2) @ Y)
    kept = 1 - np.sum(np.abs(Q[:, half]) ** 2, axis=1)  # of noise at the centre
    return np.asarray(np.abs(left[:, half]) ** 2 / np.maximum(kept, 0.05)[:, None])


def _line(spectra: Spectra, frequency: float, lines: np.ndarray) -> np.ndarray:
    """Return the DFT of exp(i 2 pi f t) at lines of the spectrum, scaled as the spectra are; see `Spectra.of`."""
    turns = frequency / spectra.step - lines
    with np.errstate(invalid="ignore", divide="ignore"):
        shape = np.expm1(2j * np.pi * turns) / np.expm1(2j * np.pi * turns / spectra.n)
    return np.asarray(np.where(np.abs(turns) < 1e-9, spectra.n, shape) / np.sqrt(spectra.n))


def _frequency(spectra: Spectra, line: int, around: np.ndarray, places: np.ndarray) -> float:
    """Return the frequency [Hz] near a line of the spectrum at which a steady motion leaves least in a window."""

    def remaining(offset: float) -> float:
        return _fit(spectra, _line(spectra, (line + offset) * spectra.step, around[0]), around, places)[1]

    trial = np.linspace(-1, 1, 21)
    best = float(trial[int(np.argmin([remaining(float(one)) for one in trial]))])
    found = minimize_scalar(remaining, bounds=(best - 0.1, best + 0.1), method="bounded", options={"xatol": 1e-6})
    return float((line + found.x) * spectra.step)


def _fit(spectra: Spectra, shape: np.ndarray, around: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the amplitudes (q,) of a line of a shape (w,), fitted beside the response, and the power that is left."""
    A = design(spectra.U[around], places, shape[None, :, None])[0]
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    Y = spectra.Y[around[0]]
    weight = np.linalg.norm(Y, axis=0)
    a, *_ = np.linalg.lstsq(A / size, Y, rcond=1e-10)
    left = (Y - A / size @ a) / np.where(weight > 0, weight, 1.0)
    return a[-1] / size[-1], float(np.sum(np.abs(left) ** 2))


def _without(spectra: Spectra, shape: np.ndarray, around: np.ndarray, places: np.ndarray) -> tuple[Spectra, np.ndarray]:
    amplitude, _ = _fit(spectra, shape[around[0]], around, places)
    return replace(spectra, Y=spectra.Y - np.outer(shape, amplitude)), amplitude
