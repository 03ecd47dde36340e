"""The further run-up that separates two hypotheses most: other speeds, another acceleration, a probe, or an order.

Both fitted diagrams are simulated through it as through the runs on record, with the noise of these; see `Contrast`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from rotorsim.diagnosis.evidence.change import Change, best_of, change_of
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit
from rotorsim.diagnosis.evidence.orders.noise import RowNoise
from rotorsim.diagnosis.evidence.waveform.separation import Contrast
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.order_tracking import order_search, tracked_orders
from rotorsim.recordings.orders import OrderChannel, OrderRecording, OrderRun

SLOWER, FASTER = 0.5, 1.25  # times the lowest and the highest speed on record
ACCELERATIONS = (0.5, -1.0)  # times that on record; negative: the other way
MOST_ROWS_RUN = 300  # of a run that is proposed
LARGEST_VECTOR = 2.0  # times the largest on record: what exceeds it is not proposed
RPM = np.pi / 30

Proposal = tuple[str, dict[str, OrderChannel], OrderRun]


def best_change(
    fits: tuple[Fit, Fit],
    diagrams: Sequence[Diagram],
    recording: OrderRecording,
    runs: Sequence[OrderRun],
    noise: Mapping[str, RowNoise],
) -> Change | None:
    """Return the further run that separates two fitted diagrams most, or None if none does."""
    found = []
    for words, channels, run in _proposals(recording, runs):
        try:
            found.append(_separated(words, replace(recording, channels=channels), run, fits, diagrams, runs, noise))
        except FAILURES:  # a channel that the diagram does not have
            continue
    return best_of(found)


def _proposals(recording: OrderRecording, runs: Sequence[OrderRun]) -> Iterator[Proposal]:
    """Yield runs in words, with their channels: a run again, with more recorded, and through other speeds."""
    run, channels = max(runs, key=lambda one: len(one.speed)), dict(recording.channels)
    yield f"run {run.id} again", channels, run
    for name, channel in recording.channels.items():
        other = {"x": "y", "y": "x"}.get(channel.axis or "")
        taken = {(one.signal, one.node, one.axis, one.order) for one in channels.values()}
        if other and (channel.signal, channel.node, other, channel.order) not in taken:
            beside = replace(channel, axis=other)
            yield (
                f"run {run.id} again with {beside.name} recorded as well",
                {**channels, f"{name} {other}": beside},
                run,
            )
        if (channel.signal, channel.node, channel.axis, 2) not in taken:
            double = replace(channel, order=2)
            yield f"run {run.id} again with {double.label} recorded as well", {**channels, f"{name} 2X": double}, run
    low, high = run.speed.min(), run.speed.max()
    rate = _rate(run)
    for first, last, factor in (
        *((low, high, factor) for factor in ACCELERATIONS),
        (SLOWER * low, high, 1.0),
        (low, FASTER * high, 1.0),
    ):
        made = _ramp(run, first, last, factor * rate)
        if made is not None:
            ends = (
                f"{first / RPM:.4g} to {last / RPM:.4g}"
                if factor * rate > 0
                else f"{last / RPM:.4g} to {first / RPM:.4g}"
            )
            yield f"a run from {ends} rpm at {abs(factor * rate) / RPM:.3g} rpm/s", channels, made


def _rate(run: OrderRun) -> float:
    """Return the acceleration of a run [rad/s^2], from its first row to its last."""
    time = np.cumsum(2 * np.pi * run.turns / run.speed) if run.time is None else run.time
    return float((run.speed[-1] - run.speed[0]) / (time[-1] - time[0]))


def _ramp(run: OrderRun, low: float, high: float, rate: float) -> OrderRun | None:
    """Return a run between two speeds at a constant acceleration, in rows of as many turns; None if too long."""
    if not rate:
        return None
    first, last = (low, high) if rate > 0 else (high, low)
    rows = int((last**2 - first**2) / (2 * rate) / (2 * np.pi * run.turns))
    if not 2 <= rows <= MOST_ROWS_RUN:
        return None
    ends = np.sqrt(first**2 + 2 * rate * 2 * np.pi * run.turns * np.arange(rows + 1))
    nothing = {name: np.zeros(rows, complex) for name in run.vectors}
    return replace(run, speed=(ends[1:] + ends[:-1]) / 2, time=None, vectors=nothing)


def _separated(
    words: str,
    recording: OrderRecording,
    run: OrderRun,
    fits: tuple[Fit, Fit],
    diagrams: Sequence[Diagram],
    given: Sequence[OrderRun],
    noise: Mapping[str, RowNoise],
) -> Change | None:
    """Return how far apart a run puts two fitted diagrams; None if it tells nothing, or moves too far."""
    vectors = {name: run.vectors.get(name, np.zeros(len(run.speed), complex)) for name in recording.channels}
    vectors = {name: np.where(np.isfinite(one), one, 0.0) for name, one in vectors.items()}
    run = replace(run, vectors=vectors)
    level = max(one.variance / (1 - one.memory) ** 2 for one in noise.values())  # of a mean over many rows
    known = {label: one.variance / (1 - one.memory) ** 2 for label, one in noise.items()}
    largest = max(float(np.nanmax(np.abs(one))) for own in given for one in own.vectors.values())
    found = []
    for fit, diagram in zip(fits, diagrams, strict=True):
        tracked = tracked_orders(diagram, recording, [run], diagram.free)
        variance = {("", label): known.get(label, level) for label in tracked.labels}
        search = order_search(tracked, variance)
        start = search.first()
        y, by = search.simulated(start, 0, 0, search.substeps(start))
        if not (np.isfinite(y).all() and np.isfinite(by).all()) or np.abs(y).max() > LARGEST_VECTOR * largest:
            return None
        names = [item.name for item in fit.free]
        own = [names.index(item.name) for item in search.free]
        covariance = fit.covariance[np.ix_(own, own)]
        loose = ~np.isfinite(np.diag(covariance))
        covariance[loose] = covariance[:, loose] = 0.0
        values, modes = np.linalg.eigh(covariance)
        root = modes * np.sqrt(np.maximum(values, 0.0))
        unknown = np.append(loose, np.ones(by.shape[2] - search.m, bool))
        found.append((y, by[:, :, : search.m] @ root, by[:, :, unknown]))
    weights = np.repeat([1 / np.sqrt(variance["", label]) for label in tracked.labels], 2)
    contrast = Contrast.of(found, weights)
    return change_of(words, partial(contrast.separation, range(len(weights))))
