"""What contradicts what a recording says of itself: signals that are not what they are called, runs that differ."""

from __future__ import annotations

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.signals.injection.columns import NO_NOISE, Column

AGREES = 0.05  # by which the recorded test signal may be of another size, or 5 % of a period late, before it is said
DIFFERS = 0.02  # of the test signal: V1 - V2 is another one
COMPARED = 0.01  # standard deviation of (V1 - V2) / E where it is compared
NO_SIGNAL, TWICE = 0.3, 1.7  # |S| at the top of the band, below and above which V1 and V2 are not what they are called
TOP = 0.8  # of the highest frequency measured: what is above is the top of the band


def scaled(name: str, column: Column, hz: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Return what is to be said of V1 - V2 beside the recorded test signal, and by how much S is in doubt (n,).

    (V1 - V2) / E is a gain and a delay of the recorded E, which cancel. What else it is, is of V1 or V2: they are not
    sampled at once, or not scaled or filtered alike. Raises RotorsimError where it is the opposite.
    """
    doubt = np.zeros(len(hz))
    told = np.isfinite(column.scale) & (column.scale_std < COMPARED * np.abs(column.scale))
    told &= np.isfinite(column.S).any(axis=1)
    if told.sum() < 10:
        return [], doubt
    f, scale = hz[told], column.scale[told]
    gain = complex(np.median(scale.real), np.median(scale.imag))
    what = f"'after' - 'before' at {name}"
    if np.median(scale[: len(scale) // 4 + 1].real) < 0:
        hint = "'before' is without the test signal, 'after' is the sum; if its sign differs, leave 'test' out"
        raise RotorsimError(Problem(f"{what} is {gain.real:.3g} times the test signal", hint=hint), exit_code=1)
    angle = np.unwrap(np.angle(scale))
    delay = -float(np.polynomial.polynomial.polyfit(f, angle, 1)[1]) / (2 * np.pi)
    turned = scale * np.exp(2j * np.pi * f * delay)
    size = float(np.median(np.abs(scale)))
    model = size * np.exp(1j * np.angle(np.median(turned.real) + 1j * np.median(turned.imag)))
    off = np.abs(turned / model - 1)
    noise = NO_NOISE * column.scale_std[told] / np.abs(scale)
    doubt[told] = np.where(off > np.maximum(noise, DIFFERS), off, 0.0)
    said = []
    if (doubt > 0).sum() > 0.01 * told.sum():
        k = int(np.argmax(doubt))
        said.append(
            f"{what} differs from the test signal by up to {100 * doubt[k]:.2g} %, at {hz[k]:.4g} Hz: are these "
            "channels sampled at once, and scaled and filtered alike?"
        )
    elif abs(size - 1) > AGREES or abs(delay) * f[-1] > AGREES:
        late = (
            f", {1e3 * abs(delay):.3g} ms {'earlier' if delay < 0 else 'later'}" if abs(delay) * f[-1] > AGREES else ""
        )
        said.append(f"{what} is {size:.3g} times the test signal{late}: S is from 'before' and 'after' alone")
    return said, doubt


def exchanged(name: str, column: Column, i: int, hz: np.ndarray, highest: float) -> list[str]:
    """Return that S is nothing like 1 at the top of the band, where every loop has fallen, if so.

    Of a band that ends below a quarter of what the standard judges it says nothing.
    """
    measured = column.measured(i)
    if not measured.any() or (top := hz[measured][-1]) < highest / 4:
        return []
    size = float(np.median(np.abs(column.S[measured & (hz > TOP * top), i])))
    if NO_SIGNAL < size < TWICE:
        return []
    hint = "are 'before' and 'after' what they are called?"
    return [f"'{name}': |S| is {size:.2g} at the highest frequencies, where it is 1 of a loop that has fallen: {hint}"]


def apart(name: str, column: Column, hz: np.ndarray) -> list[str]:
    """Return that runs contradict each other, if they do at more than one frequency in a hundred."""
    there = column.apart > 0
    if there.sum() <= 0.01 * np.isfinite(column.S).any(axis=1).sum():
        return []
    k = int(np.argmax(column.apart))
    what = f"'{name}': its runs differ by up to {100 * column.apart[k]:.2g} % of S, at {hz[k]:.4g} Hz"
    return [f"{what}: another setting, or another amplitude? --run takes one of them"]
