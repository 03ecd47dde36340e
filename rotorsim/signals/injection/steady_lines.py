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
MOST_TRIED = 100
CLEAN = 4.0  # times the mean power of the noise, that a window of 25 lines has without a steady line, at most
LEFT_OVER = 0.01  # of what stood out: a line whose frequency wanders, but a line
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
            amplitude, _ = _fit(spectra, shape[around[0]], around, places)
            spectra = replace(spectra, Y=spectra.Y - np.outer(shape, amplitude))
    return spectra


def without_lines(spectra: Spectra, highest: float) -> tuple[Spectra, list[SteadyLine], np.ndarray]:
    """Return spectra without steady lines up to a frequency [Hz], these, the strongest first, and where some is left.

    A line stands out of what the response, fitted around it, leaves at it; its frequency is where it explains most. It
    is one only if it leaves noise, or next to nothing of what stood out: near a narrow resonance the fit errs by more
    than noise, but not in the shape of a line. (K,): lines of the spectrum where more than noise is left of one.
    """
    half = least_half(spectra.U.shape[1])
    last = min(int(highest / spectra.step), len(spectra.U) - half - 2)
    found: list[SteadyLine] = []
    rest = np.zeros(len(spectra.U), bool)
    every = np.arange(half + 1, last + 1)
    every = every[spectra.excited[every].any(axis=1)]
    if len(every) < 2 * LINES_AROUND:
        return spectra, found, rest
    left = _left(spectra, every, half)
    level = median_filter(left, (LINES_AROUND, 1), mode="reflect") / np.log(2)
    size = median_filter(np.abs(spectra.Y[every]) ** 2, (LINES_AROUND, 1), mode="reflect")
    level = np.maximum(np.maximum(level, FAINT * size), 1e-300)
    for _ in range(MOST_TRIED):
        ratio = left / level
        k, c = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        if ratio[k, c] < THRESHOLD:
            break
        around, places = windows(spectra, every[k : k + 1] * spectra.step, 2 * half)
        frequency = _frequency(spectra, int(every[k]), around, places)
        shape = _line(spectra, frequency, np.arange(len(spectra.U)))
        amplitude, after = _fit(spectra, shape[around[0]], around, places)
        before = _fit(spectra, None, around, places)[1]
        is_clean = after[c] < CLEAN * level[k, c]
        near = slice(max(k - 4 * half, 0), k + 4 * half + 1)
        if is_clean or after[c] < LEFT_OVER * before[c]:
            spectra = replace(spectra, Y=spectra.Y - np.outer(shape, amplitude))
            found.append(SteadyLine(frequency, tuple((2 * np.abs(amplitude)).tolist())))
            left[near] = np.where(left[near] > 0, _left(spectra, every[near], half), 0.0)
        if not is_clean:
            rest[around[0]] |= after[c] < LEFT_OVER * before[c]
            left[np.abs(every - every[k]) <= half] = 0.0  # is not looked at again
    return spectra, found, rest


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
    weight = np.sum(np.abs(spectra.Y[around[0]]) ** 2, axis=0)
    weight[weight == 0] = 1.0

    def remaining(offset: float) -> float:
        shape = _line(spectra, (line + offset) * spectra.step, around[0])
        return float(np.sum(_fit(spectra, shape, around, places)[1] / weight))

    trial = np.linspace(-1, 1, 21)
    best = float(trial[int(np.argmin([remaining(float(one)) for one in trial]))])
    found = minimize_scalar(remaining, bounds=(best - 0.1, best + 0.1), method="bounded", options={"xatol": 1e-6})
    return float((line + found.x) * spectra.step)


def _fit(
    spectra: Spectra, shape: np.ndarray | None, around: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return amplitudes (q,) of a line of a shape (w,), fitted beside the response, and the mean power left (q,)."""
    A = design(spectra.U[around], places, None if shape is None else shape[None, :, None])[0]
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    Y = spectra.Y[around[0]]
    a, *_ = np.linalg.lstsq(A / size, Y, rcond=1e-10)
    left = Y - A / size @ a
    return a[-1] / size[-1], np.sum(np.abs(left) ** 2, axis=0) / (len(A) - A.shape[1])
