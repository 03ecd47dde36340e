"""Waveform relaxation: the whole run is repeated until the signals exchanged agree.

For FMUs that cannot take a step back. Each participant runs alone from start to end with the waveforms that the others
gave last; between communication points these are cubic splines, or held where they are sampled. On a finite time it
converges for every coupling through states (Lelarasmee, Ruehli & Sangiovanni-Vincentelli, IEEE Trans. CAD 1 (1982)
131-145).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from rotorsim.cosim.inputs import Held
from rotorsim.cosim.masters.master import Master, Schedule, Trajectory
from rotorsim.errors import Problem, RotorsimError

SWEEPS = 60


class Waveform(Master):
    """Repeats the run with the waveforms found last, one participant after the other."""

    name = "waveform"
    in_steps = False

    @property
    def order(self) -> int:
        return 0

    def run(self, schedule: Schedule, first: np.ndarray) -> Trajectory:
        coupling = self.coupling
        count = max(1, round(schedule.end / schedule.step))
        times, width = np.linspace(0.0, schedule.end, count + 1), schedule.end / count
        y = np.tile(first, (count + 1, 1))
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
                for i, t in enumerate(times[:-1]):
                    history = _Piece(wave, t, held[i, part]) if wave is not None else Held(u[i, part])
                    y[i + 1, out] = participant.step(t, width, history)
                u = y @ coupling.L.T + coupling.u0
            if not np.isfinite(u).all():
                break
            scale = np.maximum(np.abs(u).max(axis=0), 1e-300)
            change = float((np.abs(u - last) / scale).max(initial=0.0))
            schedule.report(min(0.99, (sweep + 1) / 12))
            if change <= self.tolerance or (change < 1e-6 and change > 0.9 * before):  # the noise of the FMUs' solvers
                work = (sweep + 1) * count * len(coupling.participants)
                self.counters |= {"steps": count, "participant_steps": work, "iterations": sweep + 1}
                return Trajectory(times, y)
            before = change
        hint = "a shorter run, or participants that can step back (master iterative)"
        what = f"the waveforms do not agree after {SWEEPS} runs"
        raise RotorsimError(Problem(what, "waveform master", hint=hint), exit_code=1)


class _Piece:
    """The part of a waveform that begins at t, and what is held beside it."""

    is_held = False

    def __init__(self, wave: CubicSpline, t: float, held: np.ndarray) -> None:
        self.wave, self.t, self.held = wave, t, held

    def __call__(self, tau: float) -> np.ndarray:
        return np.asarray(self.wave(self.t + tau) + self.held)
