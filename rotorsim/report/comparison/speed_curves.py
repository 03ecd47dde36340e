"""The settled motion of a diagram over speed, between and beside the runs that were measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorsim.identification.harmonic.whitening import harmonics_of_time
from rotorsim.jobs.threads import one_thread
from rotorsim.report.comparison.harmonics import PredictedRuns, Signal
from rotorsim.report.style import ZERO_SHARE

SPEEDS, STEP, REFINEMENTS = 121, 0.2, 4  # of a curve: first points; change between two that is refined
UNSEEN = 0.1  # of the noise of the best run: a line at its tenth adds 0.5 % to what is measured
AGREES = 0.05  # of the largest order: how far a curve may be from the motion in a run
BATCH = 64  # speeds solved at a time


def speed_curve(
    runs: PredictedRuns, group: str, signal: Signal, orders: np.ndarray, reach: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return ascending speeds (n,) [rad/s] over the range of all runs, and the harmonics (n, orders) there.

    reach (k,): further speeds [rad/s] that it extends to. nan where the diagram is not stable and so never settles, and
    where it is rounding or far below the noise. None where the diagram needs measured inputs, which nobody knows
    between the runs; and where the motion that it settles to over speed is not the one that it has in the runs (a
    nonlinear diagram may have several).
    """
    members, every = runs.groups[group], runs.speeds
    range_ = speed_range(runs, group)
    if runs.experiment.given or range_ is None:
        return None
    side = np.concatenate([range_, [] if reach is None else reach])
    side = np.abs(side[np.sign(side) == np.sign(range_[0])])
    grid = np.linspace(side.min(), side.max(), SPEEDS) * np.sign(range_[0])
    own = [r for r in members if np.sign(every[r]) == np.sign(range_[0])]
    speeds = np.unique(np.concatenate([grid, range_, every[own]]))
    with one_thread():  # many small matrices
        values = settled_harmonics(runs, members[0], speeds, signal, orders)
        for _ in range(REFINEMENTS):
            size = np.maximum(np.abs(values), 1e-3 * np.nan_to_num(np.abs(values)).max(axis=0) + 1e-300)
            change = (np.abs(np.diff(values, axis=0)) / np.minimum(size[1:], size[:-1])).max(axis=1)
            where = np.flatnonzero(change > STEP)
            if not len(where):
                break
            between = (speeds[where] + speeds[where + 1]) / 2
            values = np.insert(values, where + 1, settled_harmonics(runs, members[0], between, signal, orders), axis=0)
            speeds = np.insert(speeds, where + 1, between)
    if not meets(runs, own, signal, orders, speeds, values):
        return None
    noise = min(float(runs.measured(r, signal).noise.min()) for r in range(len(every)))
    least = max(ZERO_SHARE * float(np.nanmax(np.abs(values), initial=0.0)), UNSEEN * noise)
    return speeds, np.where(np.abs(values) > least, values, np.nan)


def speed_range(runs: PredictedRuns, group: str) -> np.ndarray | None:
    """Return the lowest and the highest speed (2,) [rad/s] of a curve over all runs that turn as those of a group do.

    A little beyond the runs; None where all turn equally fast.
    """
    every = runs.speeds
    side = np.abs(every[np.sign(every) == np.sign(every[runs.groups[group][0]])])
    if np.ptp(side) == 0:
        return None
    margin = 0.03 * np.ptp(side)
    ends = np.array([max(side.min() - margin, 0.5 * side.min()), side.max() + margin])
    return np.asarray(ends * np.sign(every[runs.groups[group][0]]))


def meets(
    runs: PredictedRuns,
    members: Sequence[int],
    signal: Signal,
    orders: np.ndarray,
    speeds: np.ndarray,
    values: np.ndarray,
) -> bool:
    """Return whether a curve over speed goes through the motion that the diagram has in some runs."""
    alternating = orders != 0  # means may not have settled
    columns = np.searchsorted(runs.orders(signal), orders[alternating])
    for r in members:
        there = runs.prediction(r, signal)[columns]
        apart = np.abs(values[np.argmin(np.abs(speeds - runs.speeds[r])), alternating] - there)
        if np.isfinite(apart).all() and (apart > AGREES * np.abs(there).max(initial=0.0)).any():
            return False
    return True


def settled_harmonics(
    runs: PredictedRuns, r: int, speeds: np.ndarray, signal: Signal, orders: np.ndarray
) -> np.ndarray:
    """Return the harmonics (n, orders) of a diagram with the settings of run r at speeds (n,) of one sign."""
    experiment, K = runs.experiment, int(np.abs(orders).max())
    parts = []
    for some in np.array_split(speeds, -(-len(speeds) // BATCH)):
        p = np.repeat(experiment.p[r][None], len(some), axis=0)
        moved = np.array([experiment.model.parameter_vector({"speed": speed}) for speed in some])
        p[:, runs.follows_speed] = moved[:, runs.follows_speed]
        Y = _moved(runs, r, p, some, K)
        parts.append(signal.combined(harmonics_of_time(Y, some[0]), experiment.predicted, orders))
    return np.concatenate(parts)


def _moved(runs: PredictedRuns, r: int, p: np.ndarray, speeds: np.ndarray, K: int) -> np.ndarray:
    """Return harmonics of time (n, K+1, c) at speeds, from the nearest run with the settings of r; nan if unstable."""
    base = runs.experiment.motion
    beside = None if base.beside is None else base.beside.at(speeds)
    K_there = K if beside is None else beside.K  # of asynchronous forces alone, all orders at once
    motion = base.elsewhere(p, speeds, K_there, r, beside)
    members = np.array(runs.groups[runs.group_of(r)])
    motion.begin_from(base, members[np.argmin(np.abs(runs.speeds[members][:, None] - speeds), axis=0)], runs.theta)
    Y: np.ndarray = motion.predict(runs.theta).Y[:, : K + 1]
    linear = motion.linear()
    if linear is not None:
        A = linear.response(runs.theta, 0, forced=False).A
        Y[np.linalg.eigvals(A).real.max(axis=1) > 1e-6 * np.abs(A).max() ** 0.5] = np.nan
    return Y
