"""Order vectors of run-ups and coast-downs by the Vold-Kalman filter: envelopes of orders and steady lines together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import tau

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import resample_poly

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import OrderRecording, OrderRun
from rotorsim.recordings.recording import Recording, Run
from rotorsim.signals.orders.extraction import Positions, order_channels
from rotorsim.signals.orders.vold_kalman import NARROWEST, vold_kalman
from rotorsim.signals.turning import is_run_up, turning

KEPT_IN_PERIOD = 5.0  # of the highest order, that are kept
EVEN_STEPS = 1e-3  # relative: samples whose distances differ by more are not equally spaced


@dataclass(frozen=True)
class Passband:
    """Width of the filter, -3 dB, both sides together: a share of an order (of the shaft's frequency), or in Hz."""

    share: float = 0.0
    hertz: float = 0.0

    def at(self, speed: np.ndarray) -> np.ndarray:
        """Return it in Hz at speeds [rad/s]."""
        return np.asarray(self.share * np.abs(speed) / tau + self.hertz)


def filtered_recording(
    recording: Recording,
    orders: Sequence[int],
    passband: Passband,
    lines: Sequence[float] = (),
    runs: Sequence[Run] | None = None,
) -> tuple[OrderRecording, list[Positions]]:
    """Return order vectors of runs whose speed changes, a row a turn, by the Vold-Kalman filter; and mean positions.

    lines [Hz]: steady ones that are tracked along, so that orders that cross them are told apart. A row is the mean of
    the envelope over its turn, 0-peak, its phase a lead against the mark, the shaft's own way round. Rows within a few
    reciprocal bandwidths are one measurement: nothing of their noise is in their differences.
    Raises RotorsimError where nothing tells the angle, without a run-up, for samples that are not equally spaced, and
    as `vold_kalman`.
    """
    orders = sorted({1, *orders})
    measured, channels = order_channels(recording, orders)
    chosen = [run for run in recording.runs if is_run_up(recording, run)] if runs is None else list(runs)
    if not chosen:
        hint = "rotorsim spectrum shows harmonics of runs at one speed"
        raise RotorsimError(Problem("no run changes its speed", recording.name, hint=hint), exit_code=1)
    found = [_filtered(recording, run, [*measured], orders, passband, lines) for run in chosen]
    named = recording.name, recording.source, recording.folder, channels
    warnings = tuple(one for *_, said in found for one in said)
    tracked = OrderRecording(*named, tuple(run for run, *_ in found), warnings=warnings)
    return tracked, [at for _, at, _ in found]


def _filtered(
    recording: Recording,
    run: Run,
    columns: Sequence[str],
    orders: Sequence[int],
    passband: Passband,
    lines: Sequence[float],
) -> tuple[OrderRun, Positions, list[Problem]]:
    shaft = turning(recording, run)
    known = np.isfinite(shaft.theta)
    time, theta, speed = run.time[known], shaft.theta[known], np.abs(shaft.speed[known])
    sign = -1.0 if theta[-1] < theta[0] else 1.0
    steps = np.diff(time)
    step = float(time[-1] - time[0]) / len(steps)
    if np.abs(steps - step).max() > EVEN_STEPS * step:
        hint = "resample it, or leave --filter out"
        raise RotorsimError(Problem("its samples are not equally spaced", f"run {run.id}", run.place, hint))
    columns = [column for column in columns if column in run.values]
    y = np.stack([run.values[column][known] for column in columns], axis=1)
    highest = max(max(orders) * float(speed.max()) / tau, *lines, 0.0)
    if highest * 2 * step >= 1:
        what = f"samples of {1 / step:.5g} Hz do not show {highest:.4g} Hz"
        raise RotorsimError(Problem(what, f"run {run.id}", run.place, "fewer orders, or lower lines"))
    turned = sign * theta
    marks = tau * np.arange(np.ceil(turned[0] / tau), np.floor(turned[-1] / tau) + 1)
    ends = np.interp(marks, turned, time)
    edges = np.searchsorted(turned, marks)
    sums = np.add.reduceat(y[: edges[-1]], edges[:-1]) / np.diff(edges)[:, None]
    fewer = int(1 / (KEPT_IN_PERIOD * highest * step))
    if fewer > 1 and passband.at(speed).min() * step < 10 * NARROWEST and np.isfinite(y).all():
        y = resample_poly(y, 1, fewer, axis=0, window=("kaiser", 10.0), padtype="line")
        time, turned, speed, step = time[::fewer], turned[::fewer], speed[::fewer], step * fewer
    angles = np.stack([*(order * turned for order in orders), *(tau * f * (time - time[0]) for f in lines)])
    least = NARROWEST / step if passband.share else 0.0  # what rounding allows: near rest a share of an order is less
    wider = passband.at(speed) < least
    widths = np.tile(np.maximum(passband.at(speed), least), (len(angles), 1))
    envelopes = vold_kalman(y - np.nanmean(y, axis=0), angles, widths, step)
    means = np.diff(CubicSpline(turned, envelopes, axis=1).antiderivative()(marks), axis=1) / tau
    own = OrderRun(
        id=run.id,
        file=run.file,
        speed=tau / np.diff(ends),
        vectors={
            f"{column} {order}X": means[k, :, c] for c, column in enumerate(columns) for k, order in enumerate(orders)
        },
        time=(ends[1:] + ends[:-1]) / 2,
        turns=1,
        settings=run.settings,
        use=run.use,
        place=run.place,
        sense=int(sign),
    )
    said = []
    if wider.any():
        what = (
            f"below {speed[wider].max() * 60 / tau:.3g} rpm the filter is {least:.3g} Hz wide, not a share of an order"
        )
        said.append(Problem(what, f"run {run.id}", severity="warning"))
    return own, Positions(run.id, own.speed, {column: sums[:, c] for c, column in enumerate(columns)}), said
