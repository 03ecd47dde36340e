"""Slow roll: what probes show of a shaft that turns too slowly to move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import OrderRecording


def without_slow_roll(recording: OrderRecording, low: float, high: float) -> OrderRecording:
    """Return a recording without the mean vector that each channel of each run has between two speeds [rad/s].

    Raises RotorsimError for runs without rows there, and for a recording of which it was subtracted already.
    """
    if not recording.slow_roll:
        raise RotorsimError(Problem("slow roll was subtracted already", recording.name))
    runs, problems = [], []
    for run in recording.runs:
        there = (run.speed >= low) & (run.speed <= high)
        if not there.any():
            ends = f"{run.speed.min() * 30 / np.pi:.4g} to {run.speed.max() * 30 / np.pi:.4g} rpm"
            what = f"no row between {low * 30 / np.pi:.4g} and {high * 30 / np.pi:.4g} rpm: slow roll is not known"
            problems.append(Problem(what, f"run {run.id}", run.place, f"the run covers {ends}"))
            continue
        vectors = {}
        for name, values in run.vectors.items():
            own = values[there]
            known = own[np.isfinite(own)]
            vectors[name] = values - (known.mean() if len(known) else np.nan)
        runs.append(replace(run, vectors=vectors))
    if problems:
        raise RotorsimError(*problems, exit_code=1)
    return replace(recording, runs=tuple(runs), slow_roll=False)
