"""Order vectors of sampled run-ups and coast-downs, turn by turn against the pulses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import pi

import numpy as np
from scipy.interpolate import CubicSpline, interp1d
from scipy.signal import savgol_filter

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import LEAST_ORDER_ROWS, OrderChannel, OrderRecording, OrderRun
from rotorsim.recordings.recording import ANGLE, TACHO, Channel, Recording, Run
from rotorsim.signals.pickup import mains_lines
from rotorsim.signals.shaft_angle import run_up_in_words
from rotorsim.signals.turning import TURN_ROUNDING, turning
from rotorsim.units import conversion

ORDERS_BESIDE = 8  # further orders that are fitted along, so that they do not leak into those wanted
SAMPLES_OF_UNKNOWN = 1.5  # of a row, for each of its unknowns
LEAK_PASSES = 6  # of what leaks, each leaves half or less
CHANGES = 0.1  # of the highest speed, from which a run is no steady one, whatever its speed in the end
SMOOTH_ROWS = 7  # over which a parabola follows an envelope, as sixth differences between rows do, but no line
_TURN = 2 * pi


@dataclass(frozen=True, eq=False)
class Positions:
    """Mean of every channel over the turns of each row, column -> (n,), SI: where the shaft is in its bearing."""

    run: str
    speed: np.ndarray
    mean: dict[str, np.ndarray]


def order_channels(recording: Recording, orders: Sequence[int]) -> tuple[dict[str, Channel], dict[str, OrderChannel]]:
    """Return the channels of a recording that are no angle, and those of their order vectors, both by name."""
    measured = {column: one for column, one in recording.channels.items() if one.signal not in (ANGLE, TACHO)}
    vectors = {
        f"{column} {order}X": OrderChannel(**{**vars(channel), "coupling": "dc"}, order=order)
        for column, channel in measured.items()
        for order in orders
    }
    return measured, vectors


def tracked_recording(
    recording: Recording, orders: Sequence[int], turns: int = 1, runs: Sequence[Run] | None = None
) -> tuple[OrderRecording, list[Positions]]:
    """Return order vectors of the runs whose speed changes, and the mean positions; a row for every ``turns`` turns.

    y = sum_k Re Y_k exp(i k theta), with the orders wanted and others beside them, by least squares row by row. What
    grows within a turn leaks into other orders: envelopes are therefore smooth curves through the rows, and what they
    leave is taken row by row once more. Y_k is the mean of the envelope over the row, 0-peak, its phase a lead against
    the mark, the shaft's own way round. 1X is always tracked: it tells what may leak into others. Lines of the mains
    are taken out, and warned of. runs: those that are wanted (default: all that are run-ups or coast-downs).
    Raises RotorsimError for runs at one speed, of which nothing tells the angle, or with too few samples a turn.
    Source: A. Brandt, Noise and Vibration Analysis (2011), ch. 12 (order tracking).
    """
    orders = sorted({1, *orders})
    measured, channels = order_channels(recording, orders)
    found: list[OrderRun] = []
    positions: list[Positions] = []
    problems: list[Problem] = []
    warnings: list[Problem] = []
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
            own, at, lines = _tracked(run, shaft.theta, [*measured], orders, turns)
        except RotorsimError as error:
            problems += error.problems
            continue
        found.append(own)
        positions.append(at)
        warnings += [_warning(line, sizes, measured, run) for line, sizes in lines.items()]
    if problems:
        raise RotorsimError(*problems, exit_code=1)
    if not found:
        hint = "rotorsim spectrum shows harmonics of runs at one speed"
        raise RotorsimError(Problem("no run changes its speed", recording.name, hint=hint), exit_code=1)
    tracked = OrderRecording(recording.name, recording.source, recording.folder, channels, tuple(found))
    return replace(tracked, warnings=tuple(warnings)), positions


def _warning(line: float, sizes: Mapping[str, float], channels: Mapping[str, Channel], run: Run) -> Problem:
    """Return what is to be said of a line of the mains [Hz] with 0-peak sizes by column."""
    units = {column: channels[column].unit for column in sizes}
    said = ", ".join(f"{size / conversion(units[c], None):.2g} {units[c]} in {c}" for c, size in sizes.items())
    what = f"mains hum of {line:.1f} Hz is taken out of the orders: {said}, 0-peak"
    return Problem(what, f"run {run.id}", severity="warning")


def _tracked(
    run: Run, theta: np.ndarray, columns: Sequence[str], orders: Sequence[int], turns: int
) -> tuple[OrderRun, Positions, dict[float, dict[str, float]]]:
    """Return the rows of one run, whole turns from mark to mark, in the shaft's own sense, and lines of the mains."""
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
    rows = _Rows(turned[part], edges - edges[0], marks, min(max(orders) + ORDERS_BESIDE, most))
    means, lines = _without_mains(rows, time[part], y)
    named = {f"{column} {order}X": means[:, order, c] for c, column in enumerate(columns) for order in orders}
    middles = (ends[1:] + ends[:-1]) / 2
    own = OrderRun(run.id, run.file, speed, named, middles, turns, run.settings, run.use, run.place, int(sign))
    positions = Positions(run.id, speed, {column: means[:, 0, c].real for c, column in enumerate(columns)})
    return own, positions, {line: dict(zip(columns, sizes.tolist(), strict=True)) for line, sizes in lines.items()}


def _without_mains(rows: _Rows, time: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, dict[float, np.ndarray]]:
    """Return the means of the envelopes without lines of the mains, and those: frequency [Hz] -> 0-peak (c,).

    Within a turn the orders explain most of a line, each row as it needs: it shows in what envelopes that are smooth
    over rows leave. Its size is what explains, of the line and of its derivative by the frequency, what orders leave.
    """
    means, left = rows.means(y)
    dt = float(time[-1] - time[0]) / (len(time) - 1)
    smooth = savgol_filter(means.view(float), SMOOTH_ROWS, 2, axis=0).view(complex)
    lines = mains_lines(rows.evened(rows.left(y, smooth)), dt)
    sizes = {}
    if lines:
        middle = (time[0] + time[-1]) / 2
        waves = np.exp(np.multiply.outer(time - middle, 2j * pi * np.array(lines)))
        columns = np.hstack([waves.real, -waves.imag])
        columns = np.hstack([columns, columns * (time - middle)[:, None]])
        own, beside = rows.means(columns)
        factors = np.empty((columns.shape[1], y.shape[1]))
        for c in range(y.shape[1]):
            good = np.isfinite(left[:, c])
            factors[:, c] = np.linalg.lstsq(beside[good], left[good, c], rcond=None)[0]
        means = means - own @ factors
        sizes = dict(zip(lines, np.hypot(*np.split(factors[: 2 * len(lines)], 2)), strict=True))
    means[np.broadcast_to(rows.lost(y)[:, None, :], means.shape)] = np.nan
    return means, sizes


class _Rows:
    """Rows of samples at angles turned (N,), from ``edges`` (n + 1,), and the orders 0 to ``highest`` in them."""

    def __init__(self, turned: np.ndarray, edges: np.ndarray, marks: np.ndarray, highest: int) -> None:
        self.parts = [*pairwise(edges)]
        self.turned, self.edges, self.marks, self.highest = turned, edges, marks, highest
        self.middles = (marks[1:] + marks[:-1]) / 2
        self.waves = np.exp(1j * turned[:, None] * np.arange(highest + 1))
        bases = [np.hstack([self.waves[a:b].real, -self.waves[a:b, 1:].imag]) for a, b in self.parts]
        self.inverses = [np.linalg.pinv(basis) for basis in bases]

    def lost(self, y: np.ndarray) -> np.ndarray:
        """Return which rows lack a sample of a channel, (n, c)."""
        return np.asarray(np.add.reduceat(~np.isfinite(y), self.edges[:-1]) > 0)

    def left(self, y: np.ndarray, envelopes: np.ndarray) -> np.ndarray:
        """Return what the smooth curves through envelopes (n, highest + 1, c) leave of y (N, c)."""
        waves = np.einsum("nk,nkc->nc", self.waves, CubicSpline(self.middles, envelopes)(self.turned))
        return np.asarray(y - waves.real)

    def evened(self, left: np.ndarray) -> np.ndarray:
        """Return samples (N, c) over their rms in each row, so that rows near a resonance say no more than others."""
        known = np.nan_to_num(left)
        squares = np.add.reduceat(known**2, self.edges[:-1]) / np.diff(self.edges)[:, None]
        return np.asarray(known / np.sqrt(np.maximum(np.repeat(squares, np.diff(self.edges), axis=0), 1e-300)))

    def means(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the means of the envelopes over each row, (n, highest + 1, c) complex, and what is left of y (N, c).

        Rows in which samples are missing are interpolated.
        """
        lost = self.lost(y)
        envelopes = np.zeros((len(self.parts), self.highest + 1, y.shape[1]), complex)
        left = y
        for _ in range(LEAK_PASSES):
            e = np.where(np.isfinite(left), left, 0.0)
            for k, ((a, b), inverse) in enumerate(zip(self.parts, self.inverses, strict=True)):
                found = inverse @ e[a:b]
                envelopes[k] += found[: self.highest + 1]
                envelopes[k, 1:] += 1j * found[self.highest + 1 :]
            for c in np.flatnonzero(lost.any(axis=0)):
                good = ~lost[:, c]
                if good.sum() > 1:
                    envelopes[:, :, c] = interp1d(
                        self.middles[good], envelopes[good, :, c], axis=0, bounds_error=False, fill_value="extrapolate"
                    )(self.middles)
            left = self.left(y, envelopes)
        whole = CubicSpline(self.middles, envelopes).antiderivative()
        return np.diff(whole(self.marks), axis=0) / np.diff(self.marks)[:, None, None], left


def counted_turns(turns: int) -> str:
    """Return ``1 turn`` or ``4 turns``."""
    return f"{turns} turn{'s' * (turns > 1)}"
