"""Amplitudes of sinusoids as figures and tables show them: 0-peak, peak-peak or rms, by choice."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import numpy as np

from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.units import AMPLITUDE_KINDS

_SHOWN: ContextVar[str] = ContextVar("amplitude", default="0-peak")


@contextmanager
def amplitudes(shown: str) -> Iterator[None]:
    """Show amplitudes as "0-peak", "peak-peak" (twice that) or "rms" (0-peak over sqrt 2) in figures and tables.

    What is computed and what files hold does not change: SI, 0-peak. Raises RotorsimError for another word.
    """
    if shown not in AMPLITUDE_KINDS:
        raise RotorsimError(Problem(f"'{shown}' is no way to show amplitudes", hint=near_miss(shown, AMPLITUDE_KINDS)))
    token = _SHOWN.set(shown)
    try:
        yield
    finally:
        _SHOWN.reset(token)


def shown_amplitudes() -> str:
    """Return how amplitudes are shown: a word of `AMPLITUDE_KINDS`."""
    return _SHOWN.get()


def from_peak(values: Any, orders: Any = 1) -> np.ndarray:
    """Return 0-peak amplitudes as they are shown; a mean, of order 0, is no amplitude and stays."""
    return np.asarray(values) * np.where(np.asarray(orders) == 0, 1.0, AMPLITUDE_KINDS[_SHOWN.get()])


def of_amplitude(unit: str) -> str:
    """Return a unit with what amplitudes are shown in it: ``um, peak-peak``."""
    return f"{unit}, {_SHOWN.get()}"
