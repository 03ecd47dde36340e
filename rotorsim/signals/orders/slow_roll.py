"""Slow roll: what probes show of a shaft that turns too slowly to move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import OrderRecording

MOVES_FROM = 4.0  # standard deviations


def without_slow_roll(recording: OrderRecording, low: float, high: float) -> OrderRecording:
    """Return a recording without the mean vector that each channel of each run has between two speeds [rad/s].

    A vector that changes there by more than itself is warned of: it is motion, which slow roll is not. Raises
    RotorsimError for runs without rows there, and for a recording of which it was subtracted already.
    """
    if not recording.slow_roll:
        raise RotorsimError(Problem("slow roll was subtracted already", recording.name))
    runs, problems, warnings = [], [], []
    between = f"{low * 30 / np.pi:.4g} and {high * 30 / np.pi:.4g} rpm"
    for run in recording.runs:
        there = (run.speed >= low) & (run.speed <= high)
        if not there.any():
            ends = f"{run.speed.min() * 30 / np.pi:.4g} to {run.speed.max() * 30 / np.pi:.4g} rpm"
            what = f"no row between {between}: slow roll is not known"
            problems.append(Problem(what, f"run {run.id}", run.place, f"the run covers {ends}"))
            continue
        vectors = {}
        for name, values in run.vectors.items():
            own = values[there]
            known = own[np.isfinite(own)]
            vectors[name] = values - (known.mean() if len(known) else np.nan)
            if _moves(known):
                what = f"{name} changes by more than its mean between {between}"
                hint = "the shaft moves there: slow roll is at lower speeds"
                warnings.append(Problem(what, f"run {run.id}", run.place, hint, severity="warning"))
        runs.append(replace(run, vectors=vectors))
    if problems:
        raise RotorsimError(*problems, exit_code=1)
    return replace(recording, runs=tuple(runs), slow_roll=False, warnings=(*recording.warnings, *warnings))


def _moves(vectors: np.ndarray) -> bool:
    """Return whether vectors (n,) differ from their first to their last third by more than their mean, and noise.

    Noise: as the differences between rows show it, four standard deviations of what the means of the thirds differ by.
    """
    third = len(vectors) // 3
    if not third:
        return False
    noise = np.sqrt(np.mean(np.abs(np.diff(vectors)) ** 2) / third)
    change = abs(vectors[-third:].mean() - vectors[:third].mean())
    return bool(change > max(abs(vectors.mean()), MOVES_FROM * noise))
