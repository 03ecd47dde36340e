"""Simulated measurements: one run of a diagram per speed and set of gains, settled or not, with noise or without."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import as_model
from rotorsim.linear.modes.eigenmodes import require_speed
from rotorsim.model.compiled import Model
from rotorsim.recordings.recording import ANGLE
from rotorsim.settled.continuation import Settings, Setup, orbits
from rotorsim.settled.periodic import settled_start, start_of
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

NOISE_KINDS = ("white", "thesis", "uniform")
_TOLERANCE = 1e-10  # of the harmonics left out of a settled state
_ENDS = 1e-9  # of a step: rounding of the ends of a window


@dataclass(frozen=True)
class Noise:
    """Noise on every channel. level: share. kind: see `with_noise`. seed: of the random numbers."""

    level: float
    kind: str = "white"
    seed: int = 1


def measure(
    model: Model,
    signals: Sequence[str],
    angle: str | None,
    *,
    window: tuple[float, float],
    rate: float | None = None,
    speed: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    settle: bool = False,
    closed: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Result:
    """Return signals [SI] and ``clock.theta`` of a run of a diagram, inside a window (t0, t1) [s].

    angle: the signal that becomes ``clock.theta``. rate [Hz]: of the samples, default as the diagram records.
    speed [rad/s] and other parameters: default the diagram's own. settle: begin in the settled motion, not at rest.
    closed: a sample at the end of the window belongs to it.
    Raises RotorsimError, with exit code 1 for a run that diverges.
    """
    given = {**(parameters or {}), **({} if speed is None else {"speed": speed})}
    step, every = steps_of(model, rate)
    if every * step > window[1] * (1 + _ENDS):
        raise _too_short(model, window, int(window[0] <= 0.0), step * every)
    result = simulate(
        model,
        parameters=given,
        stop=window[1],
        step=step,
        record=tuple(dict.fromkeys([*signals, *([angle] if angle else [])])),
        record_every=every,
        initial=settled_state(model, given) if settle else None,
        progress=progress,
    )
    if result.status != "finished":
        where = model.diagram.name + (f" at {given['speed'] * 30 / math.pi:.6g} rpm" if "speed" in given else "")
        raise RotorsimError(Problem(result.message, where), exit_code=130 if result.status == "stopped" else 1)
    slack = _ENDS * step * every
    first = int(np.searchsorted(result.time, window[0] - slack))
    part = slice(first, int(np.searchsorted(result.time, window[1] + (slack if closed else -slack))))
    if part.stop - part.start < 2:
        raise _too_short(model, window, max(part.stop - part.start, 0), step * every)
    kept = {(ANGLE if name == angle else name): array[part] for name, array in result.signals.items()}
    units = {(ANGLE if name == angle else name): unit for name, unit in result.units.items()}
    return replace(result, time=result.time[part], signals=kept, units=units)


def _too_short(model: Model, window: tuple[float, float], count: int, period: float) -> RotorsimError:
    what = f"window {window[0]:g}..{window[1]:g} s holds {count} sample{'s' * (count != 1)} of {period:g} s"
    return RotorsimError(Problem(what, model.diagram.name, hint="a longer window, or a higher rate"))


def steps_of(model: Model, rate: float | None) -> tuple[float, int]:
    """Return the step [s], not longer than the diagram's, and how many of them make a sample at a rate [Hz]."""
    solver = model.diagram.solver
    if rate is None:
        return solver.step, solver.record_every
    every = max(math.ceil(1.0 / (rate * solver.step) * (1 - 1e-12)), 1)
    return 1.0 / (rate * every), every


def settled_state(model: Model, parameters: Mapping[str, float] | None = None) -> np.ndarray:
    """Return the states at t = 0 of the settled periodic motion with these parameters (see `settled_start`).

    States that nothing returns begin as `start_of` says. Raises RotorsimError, with exit code 1 where there is no
    stable settled motion.
    """
    model = as_model(model)
    require_speed(model, "a settled start")
    p = model.parameter_vector(parameters or {})[None]
    setup = Setup(model)
    base = p[0, setup.speed_entries][:1]
    where = f"{model.diagram.name} at {base[0] * 30 / math.pi:.6g} rpm"
    if not base[0] > 0:
        raise RotorsimError(Problem("a settled start needs a speed above zero", where))
    if model.n_z:
        return settled_start(model, parameters=parameters)
    motion = orbits(setup, base, p, Settings(harmonics=None, tolerance=_TOLERANCE, stability=True))
    if motion.status[0] != "settled":
        raise RotorsimError(Problem(f"no settled start: {motion.status[0]}", where), exit_code=1)
    return start_of(model, motion, p[0], parameters)


def noisy(result: Result, noise: Noise, run: int = 0) -> Result:
    """Return a result with noise on every signal but the shaft angle; every run and channel has numbers of its own."""
    generator = np.random.default_rng([noise.seed, run])
    signals = {
        name: array if name == ANGLE else with_noise(array, noise.kind, noise.level, generator)
        for name, array in result.signals.items()
    }
    return replace(result, signals=signals)


def with_noise(
    r: np.ndarray, kind: str, level: float, random: np.random.Generator, rms: np.ndarray | None = None
) -> np.ndarray:
    """Return samples (n, ...) of channels with noise of a kind; every sample and channel has a number of its own.

    "white": r + level rms(r - mean r) n, n ~ N(0, 1); ``rms`` where it is known. "thesis": r (1 + (n - 0.5) level),
    eq. (2.67), as its text says; it also makes r smaller by level / 2. "uniform": the same with n uniform from 0 to 1,
    as its printed figures look: they are not smaller.
    """
    if kind == "white":
        return np.asarray(r + random.standard_normal(r.shape) * (level * (r.std(axis=0) if rms is None else rms)))
    draw = random.standard_normal(r.shape) if kind == "thesis" else random.random(r.shape)
    return np.asarray(r * (1 + (draw - 0.5) * level))
