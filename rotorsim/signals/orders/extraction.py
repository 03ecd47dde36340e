"""Order vectors of sampled run-ups and coast-downs, turn by turn against the pulses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np
from scipy.interpolate import CubicSpline, interp1d

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import LEAST_ORDER_ROWS, OrderChannel, OrderRecording, OrderRun
from rotorsim.recordings.recording import ANGLE, TACHO, Recording, Run
from rotorsim.signals.shaft_angle import run_up_in_words
from rotorsim.signals.turning import turning

ORDERS_BESIDE = 8  # further orders that are fitted along, so that they do not leak into those wanted
SAMPLES_OF_UNKNOWN = 1.5  # of a row, for each of its unknowns
LEAK_PASSES = 6  # of what leaks, each leaves half or less
CHANGES = 0.1  # of the highest speed, from which a run is no steady one, whatever its speed in the end
TURN_ROUNDING = 1e-9  # of a turn
_TURN = 2 * pi


@dataclass(frozen=True, eq=False)
class Positions:
    """Mean of every channel over the turns of each row, column -> (n,), SI: where the shaft is in its bearing."""

    run: str
    speed: np.ndarray
    mean: dict[str, np.ndarray]


def tracked_recording(
    recording: Recording, orders: Sequence[int], turns: int = 1, runs: Sequence[Run] | None = None
) -> tuple[OrderRecording, list[Positions]]:
    """Return order vectors of the runs whose speed changes, and the mean positions; a row for every ``turns`` turns.

    y = sum_k Re Y_k exp(i k theta), with the orders wanted and others beside them, by least squares row by row. What
    grows within a turn leaks into other orders: envelopes are therefore smooth curves through the rows, and what they
    leave is taken row by row once more. Y_k is the mean of the envelope over the row, 0-peak, its phase a lead against
    the mark, the shaft's own way round. 1X is always tracked: it tells what may leak into others. runs: those that are
    wanted (default: all that are run-ups or coast-downs).
    Raises RotorsimError for runs at one speed, of which nothing tells the angle, or with too few samples a turn.
    Source: A. Brandt, Noise and Vibration Analysis (2011), ch. 12 (order tracking).
    """
    orders = sorted({1, *orders})
    measured = {column: one for column, one in recording.channels.items() if one.signal not in (ANGLE, TACHO)}
    channels = {
        f"{column} {order}X": OrderChannel(**{**vars(channel), "coupling": "dc"}, order=order)
        for column, channel in measured.items()
        for order in orders
    }
    found: list[OrderRun] = []
    positions: list[Positions] = []
    problems: list[Problem] = []
    wanted = runs is not None
    for run in recording.runs if runs is None else runs:
        try:
            shaft = turning(recording, run)
            good = np.isfinite(shaft.theta)
            speed = np.abs(shaft.speed[good])
            changes = np.ptp(speed) > CHANGES * speed.max() or run_up_in_words(run.time[good], shaft.theta[good])
            if not changes:
                if wanted:
                    hint = "rotorsim spectrum shows the harmonics of a run at one speed"
                    problems.append(Problem("its speed does not change", f"run {run.id}", run.place, hint))
                continue
            own, at = _tracked(run, shaft.theta, [*measured], orders, turns)
        except RotorsimError as error:
            problems += error.problems
            continue
        found.append(own)
        positions.append(at)
    if problems:
        raise RotorsimError(*problems, exit_code=1)
    if not found:
        hint = "rotorsim spectrum shows harmonics of runs at one speed"
        raise RotorsimError(Problem("no run changes its speed", recording.name, hint=hint), exit_code=1)
    return OrderRecording(recording.name, recording.source, recording.folder, channels, tuple(found)), positions


def _tracked(
    run: Run, theta: np.ndarray, columns: Sequence[str], orders: Sequence[int], turns: int
) -> tuple[OrderRun, Positions]:
    """Return the rows of one run, whole turns from mark to mark, in the shaft's own sense."""
    known = np.isfinite(theta)
    sign = -1.0 if theta[known][-1] < theta[known][0] else 1.0
    time, turned = run.time[known], sign * theta[known]
    length = _TURN * turns
    first, last = np.ceil(turned[0] / _TURN - TURN_ROUNDING), np.floor(turned[-1] / _TURN + TURN_ROUNDING)
    marks = _TURN * (first + turns * np.arange(max(int((last - first) // turns), 0) + 1))
    if len(marks) <= LEAST_ORDER_ROWS:
        what = f"{len(marks) - 1} rows of {counted_turns(turns)}: {LEAST_ORDER_ROWS} are needed"
        raise RotorsimError(Problem(what, f"run {run.id}", run.place, "fewer turns a row, or a longer run"))
    ends = np.interp(marks, turned, time)
    speed = length / np.diff(ends)
    edges = np.searchsorted(time, ends)
    fewest = int(np.argmin(np.diff(edges)))
    most = int((np.diff(edges)[fewest] / SAMPLES_OF_UNKNOWN - 1) / 2)
    if most < max(orders):
        what = f"{np.diff(edges)[fewest]} samples a row at {speed[fewest] * 30 / pi:.4g} rpm are too few for"
        hint = "fewer orders, or more turns a row"
        raise RotorsimError(Problem(f"{what} {max(orders)}X", f"run {run.id}", run.place, hint))
    part = slice(edges[0], edges[-1])
    columns = [column for column in columns if column in run.values]
    y = np.stack([run.values[column][known][part] for column in columns], axis=1)
    fitted = min(max(orders) + ORDERS_BESIDE, most)
    means = _row_means(turned[part], y, edges - edges[0], marks, fitted)
    named = {f"{column} {order}X": means[:, order, c] for c, column in enumerate(columns) for order in orders}
    middles = (ends[1:] + ends[:-1]) / 2
    own = OrderRun(run.id, run.file, speed, named, middles, turns, run.settings, run.use, run.place, int(sign))
    return own, Positions(run.id, speed, {column: means[:, 0, c].real for c, column in enumerate(columns)})


def _row_means(turned: np.ndarray, y: np.ndarray, edges: np.ndarray, marks: np.ndarray, highest: int) -> np.ndarray:
    """Return the means of the envelopes of orders 0 to ``highest`` over each row, (n, highest + 1, c) complex.

    y (N, c) at angles (N,), rows from ``edges`` (n + 1,). NaN where a row of a channel lacks a sample.
    """
    n, c = len(marks) - 1, y.shape[1]
    lost = np.add.reduceat(~np.isfinite(y), edges[:-1]) > 0
    e = np.where(np.isfinite(y), y, 0.0)
    waves = np.exp(1j * turned[:, None] * np.arange(highest + 1))
    middles = (marks[1:] + marks[:-1]) / 2
    inverses = []
    for a, b in pairwise(edges):
        basis = np.hstack([waves[a:b].real, -waves[a:b, 1:].imag])
        inverses.append(np.linalg.pinv(basis))
    envelopes = np.zeros((n, highest + 1, c), complex)
    for _ in range(LEAK_PASSES):
        for k, ((a, b), inverse) in enumerate(zip(pairwise(edges), inverses, strict=True)):
            parts = inverse @ e[a:b]
            envelopes[k] += parts[: highest + 1]
            envelopes[k, 1:] += 1j * parts[highest + 1 :]
        for channel in np.flatnonzero(lost.any(axis=0)):
            good = ~lost[:, channel]
            if good.sum() > 1:
                envelopes[:, :, channel] = interp1d(
                    middles[good], envelopes[good, :, channel], axis=0, bounds_error=False, fill_value="extrapolate"
                )(middles)
        curve = CubicSpline(middles, envelopes)
        e = np.where(np.isfinite(y), y - np.einsum("nk,nkc->nc", waves, curve(turned)).real, 0.0)
    whole = curve.antiderivative()
    means = np.diff(whole(marks), axis=0) / np.diff(marks)[:, None, None]
    means[np.broadcast_to(lost[:, None, :], means.shape)] = np.nan
    return np.asarray(means)


def counted_turns(turns: int) -> str:
    """Return ``1 turn`` or ``4 turns``."""
    return f"{turns} turn{'s' * (turns > 1)}"
