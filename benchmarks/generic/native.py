"""Compile integrate.c with the equations and effects, and simulate runs with it."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HERE = Path(__file__).resolve().parent
NUMBERS = 6  # of an effect, as in effects.c
MOST_EFFECTS = 3


class _Effect(ctypes.Structure):
    _fields_ = [
        *[(name, ctypes.c_int64) for name in ("law", "place", "other", "state")],
        ("p", ctypes.c_double * NUMBERS),
    ]


class _Run(ctypes.Structure):
    _fields_ = [
        *[
            (name, ctypes.c_int64)
            for name in (
                *("plant", "states", "inputs", "outputs", "places", "effects", "samples", "substeps", "all_states"),
            )
        ],
        ("rate", ctypes.c_double),
        *[
            (name, ctypes.c_void_p)
            for name in ("parameters", "initial", "u", "series", "linear", "effect", "y", "taps")
        ],
    ]


@dataclass(frozen=True)
class Acting:
    """An effect as the integrator sees it: numbers of law and places, its own states, its parameters in order."""

    law: int
    place: int
    other: int
    states: int
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class System:
    """What is simulated: number of the plant, its sizes, values of its parameters, start, effects."""

    plant: int
    outputs: int
    places: int
    parameters: tuple[float, ...]
    initial: tuple[float, ...]
    linear: tuple[bool, ...]
    effects: tuple[Acting, ...] = ()
    series: Array | None = field(default=None, compare=False)


@cache
def _library() -> Any:
    """Compile and load.

    Raises:
        RuntimeError: there is no C compiler
    """
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if not compiler:
        raise RuntimeError("no C compiler; hint: install cc, gcc or clang")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "generic.so"
        flags = ["-std=gnu99", "-O2", "-ffp-contract=off", "-fPIC", "-shared"]
        subprocess.run([compiler, *flags, "-o", str(target), str(HERE / "integrate.c"), "-lm"], check=True)
        simulate = ctypes.CDLL(str(target)).simulate
    simulate.restype, simulate.argtypes = ctypes.c_int64, [ctypes.c_void_p]
    return simulate


def simulate(
    system: System, inputs: Array, rate: float, substeps: int, taps: bool = False
) -> tuple[Array | None, Array | None]:
    """Return what is recorded, samples x channels, and the signals at all places; None for outputs that diverged.

    inputs: samples x inputs, held or linear between the samples; rate: of the samples [Hz].
    """
    u = np.ascontiguousarray(inputs, float)
    samples = len(u)
    effects = (_Effect * max(len(system.effects), 1))()
    state = len(system.initial)
    for k, acting in enumerate(system.effects):
        numbers = (*acting.numbers, *[0.0] * (NUMBERS - len(acting.numbers)))
        effects[k] = _Effect(acting.law, acting.place, acting.other, state, (ctypes.c_double * NUMBERS)(*numbers))
        state += acting.states
    y = np.empty((samples, system.outputs))
    seen = np.empty((samples, system.places)) if taps else None
    held = [np.array(values, float) for values in (system.parameters, system.initial)]
    linear = np.array(system.linear, np.int64)
    series = np.ascontiguousarray(system.series if system.series is not None else np.zeros(samples))
    run = _Run(
        *(system.plant, len(system.initial), u.shape[1], system.outputs, system.places, len(system.effects)),
        *(samples, substeps, state, rate),
        *(a.ctypes.data for a in (*held, u, series, linear)),
        *(ctypes.addressof(effects), y.ctypes.data, seen.ctypes.data if seen is not None else None),
    )
    done = _library()(ctypes.byref(run))
    return (y, seen) if done == samples else (None, None)


def simulate_all(
    system: System, runs: Sequence[Array], rate: float, substeps: int, series: Sequence[Array] | None = None
) -> list[Array] | None:
    """Return what is recorded of each run; None where one diverged."""
    out = []
    for k, inputs in enumerate(runs):
        own = system if series is None else _with_series(system, series[k])
        y, _ = simulate(own, inputs, rate, substeps)
        if y is None:
            return None
        out.append(y)
    return out


def _with_series(system: System, series: Array) -> System:
    return System(**{name: getattr(system, name) for name in system.__dataclass_fields__} | {"series": series})
