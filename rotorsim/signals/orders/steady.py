"""Order vectors over the speed from runs at constant speeds: each run is one row, settled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import OrderChannel, OrderRecording, OrderRun
from rotorsim.recordings.recording import Recording, Run
from rotorsim.signals.harmonics import RunHarmonics, harmonics_of
from rotorsim.signals.orders.extraction import Positions, order_channels
from rotorsim.signals.turning import NO_ANGLE

LEAST_SPEEDS = 8  # a mode has four unknowns, what lies far from it six


def steady_recording(
    recording: Recording, orders: Sequence[int], runs: Sequence[Run] | None = None
) -> tuple[OrderRecording, list[Positions]]:
    """Return order vectors of runs at constant speeds as one table for each setting and use, and the mean positions.

    A vector is 2 R_k of the harmonics of its run, y = sum R_k exp(i k theta), fitted against the angle with their
    covariance (`harmonics_of`), the shaft's own way round. Rows ascend with the speed.
    Raises RotorsimError for run-ups, runs of which nothing tells the angle, and fewer than 8 speeds of a setting.
    """
    orders = sorted({1, *orders})
    measured, channels = order_channels(recording, orders)
    fitted = harmonics_of(recording, runs, orders=max(orders) if max(orders) > 16 else None)
    blind = [one.run for one in fitted if not one.angle.phase_known]
    if blind:
        what = "its shaft angle was not recorded"
        raise RotorsimError(*(Problem(what, f"run {run.id}", run.place, NO_ANGLE) for run in blind))
    groups: dict[tuple[object, ...], list[RunHarmonics]] = {}
    for one in fitted:
        settings = tuple(sorted((name, str(value)) for name, value in one.run.settings.items()))
        groups.setdefault((settings, one.run.use, np.sign(one.angle.speed)), []).append(one)
    tables, positions, problems = [], [], []
    for k, own in enumerate(groups.values(), 1):
        own.sort(key=lambda one: abs(one.fit.speed))
        name = "steady" if len(groups) == 1 else f"steady{k}"
        if len({round(abs(one.fit.speed), 6) for one in own}) < LEAST_SPEEDS:
            there = ", ".join(one.run.id for one in own)
            what = f"{len(own)} runs at constant speeds ({there}): {LEAST_SPEEDS} speeds of one setting are needed"
            problems.append(
                Problem(what, recording.name, hint="rotorsim spectrum shows harmonics of runs at one speed")
            )
            continue
        tables.append(_table(name, own, channels))
        speed = np.array([abs(one.fit.speed) for one in own])
        means = {
            column: np.array([_value(one, channel.name, 0)[0].real for one in own])
            for column, channel in measured.items()
        }
        positions.append(Positions(name, speed, means))
    if problems:
        raise RotorsimError(*problems, exit_code=1)
    return OrderRecording(recording.name, recording.source, recording.folder, channels, tuple(tables)), positions


def _table(name: str, own: Sequence[RunHarmonics], channels: dict[str, OrderChannel]) -> OrderRun:
    sense = -1 if own[0].angle.speed < 0 else 1
    vectors, noise = {}, {}
    for column, channel in channels.items():
        found = [_value(one, channel.name, channel.order) for one in own]
        values = 2 * np.array([value for value, _ in found])
        vectors[column] = values.conj() if sense < 0 else values
        noise[column] = 4 * float(np.nanmedian([variance for _, variance in found]))
    return OrderRun(
        id=name,
        file="",
        speed=np.array([abs(one.fit.speed) for one in own]),
        vectors=vectors,
        time=None,
        turns=1,
        settings=own[0].run.settings,
        use=own[0].run.use,
        place=own[0].run.place,
        sense=sense,
        noise=noise,
    )


def _value(one: RunHarmonics, name: str, order: int) -> tuple[complex, float]:
    """Return R_k of a channel and the variance of its real part; NaN where the run has not as many orders."""
    fit = one.fit
    if name not in fit.names or order >= len(fit.orders):
        return complex(np.nan), np.nan
    c = fit.names.index(name)
    if order == 0:
        return complex(fit.values[0, c]), float(fit.covariance[c, c])
    places = [(2 * order - 1) * len(fit.names) + c, 2 * order * len(fit.names) + c]
    return complex(fit.values[order, c]), float(np.diag(fit.covariance)[places].mean())
