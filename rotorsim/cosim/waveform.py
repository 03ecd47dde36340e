"""Waveform relaxation: the whole run is repeated until the signals exchanged agree.

For FMUs that cannot take a step back. Each participant runs alone from start to end with the waveforms that the others
gave last; between communication points these are cubic splines, or held where they are sampled. On a finite time it
converges for every coupling through states (Lelarasmee, Ruehli & Sangiovanni-Vincentelli, IEEE Trans. CAD 1 (1982)
131-145).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from rotorsim.cosim.coupling import Coupling
from rotorsim.errors import Problem, RotorsimError

__all__ = ["relaxed"]

SWEEPS = 60


def relaxed(
    coupling: Coupling, step: float, end: float, tolerance: float, progress: Callable[[float], None] | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, int]]:
    """Return times (n,), outputs (n, n_y) and work of the run whose waveforms agree within ``tolerance``.

    Raises RotorsimError when they do not after SWEEPS repetitions.
    """
    count = max(1, round(end / step))
    times = np.linspace(0.0, end, count + 1)
    width = end / count
    y = np.zeros((count + 1, coupling.L.shape[1]))
    first = coupling.u0.copy()
    for begin in ("initialise", "start"):
        for participant, part in zip(coupling.participants, coupling.u_parts, strict=True):
            getattr(participant, begin)(0.0, first[part])
        first, y[0] = coupling.consistent(0.0, first)
    y[:] = y[0]
    u = y @ coupling.L.T + coupling.u0
    before = np.inf
    for sweep in range(SWEEPS):
        last = u.copy()
        held = y @ coupling.held_wires.T  # from each point to the next
        moving = u - held
        for k in coupling.order:
            participant, part, out = coupling.participants[k], coupling.u_parts[k], coupling.y_parts[k]
            wave = CubicSpline(times, moving[:, part]) if count > 1 and part.stop > part.start else None
            participant.initialise(0.0, u[0, part])
            participant.start(0.0, u[0, part])
            y[0, out] = participant.output(0.0, u[0, part])
            for i in range(count):
                t = times[i]
                history = _Piece(wave, t, held[i, part]) if wave is not None else _Held(u[i, part])
                y[i + 1, out] = participant.step(t, width, history)
            u = y @ coupling.L.T + coupling.u0
        if not np.isfinite(u).all():
            break
        scale = np.maximum(np.abs(u).max(axis=0), 1e-300)
        change = float((np.abs(u - last) / scale).max(initial=0.0))
        if progress is not None:
            progress(min(0.99, (sweep + 1) / 12))
        if change <= tolerance or (change < 1e-6 and change > 0.9 * before):  # to the noise of the FMUs' own solvers
            sizes = {"steps": count, "participant_steps": (sweep + 1) * count * len(coupling.participants)}
            return times, y, {**sizes, "iterations": sweep + 1}
        before = change
    hint = "a shorter run, or participants that can step back (master iterative)"
    raise RotorsimError(
        Problem(f"the waveforms do not agree after {SWEEPS} runs", "waveform master", hint=hint), exit_code=1
    )


class _Piece:
    """The part of a waveform that begins at t, and what is held beside it."""

    def __init__(self, wave: CubicSpline, t: float, held: np.ndarray) -> None:
        self.wave, self.t, self.held = wave, t, held

    def __call__(self, tau: float) -> np.ndarray:
        return np.asarray(self.wave(self.t + tau) + self.held)


class _Held:
    def __init__(self, value: np.ndarray) -> None:
        self.value = value

    def __call__(self, tau: float) -> np.ndarray:
        return self.value
