"""Order vectors of a diagram that turns as the runs of a recording did, nothing of it fitted but slow roll."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.identification.as_recorded import simulate_as_recorded
from rotorsim.identification.in_orders import (
    ComparedOrders,
    compared_orders,
    order_errors,
    refuse_diverged,
    refuse_fast,
)
from rotorsim.identification.waveform.order_tracking import order_noise, order_search, tracked_orders
from rotorsim.jobs.threads import one_thread
from rotorsim.measure.order_vectors import OrderVectors
from rotorsim.model.load import load
from rotorsim.recordings.orders import OrderRecording, OrderRun
from rotorsim.settled.periodic import periodic
from rotorsim.signals.orders.extraction import tracked_recording

Vectors = dict[str, np.ndarray]  # of channels, (n,)


@dataclass(frozen=True)
class OrdersBeside:
    """A diagram as it is beside a run of orders: error of each channel as a share (nrmse) and rms, SI."""

    compared: ComparedOrders
    nrmse: Mapping[str, float]
    rms: Mapping[str, float]
    noise: Mapping[str, float]
    slow_roll: Mapping[str, complex]
    units: Mapping[str, str]


def orders_beside(diagram: Diagram, recording: OrderRecording, run: str | None = None) -> OrdersBeside:
    """Simulate a diagram as it is along a run of orders, extract them, and compare; slow roll is fitted along.

    run: its id; default the first. Raises RotorsimError for what the diagram does not have, and where it diverges.
    """
    known = {one.id: one for one in recording.runs}
    if run is not None and run not in known:
        raise RotorsimError(Problem(f"no run '{run}'", recording.name, hint=near_miss(run, known)))
    with one_thread():
        tracked = tracked_orders(diagram, recording, [recording.runs[0] if run is None else known[run]], ())
        variance = order_noise(tracked, CRITERIA.resolution)
        search = order_search(tracked, variance)
        start = search.first()
        refuse_fast(search, start)
        evaluation = search.minimise(start) if search.constants else search.evaluate(start, search.substeps(start))
        refuse_diverged(diagram, evaluation)
        [compared] = compared_orders(search, evaluation, "identify")
    values, labels = evaluation.unknowns, tracked.labels
    rms = {
        label: float(np.sqrt(np.nanmean(np.abs(compared.measured[label] - compared.simulated[label]) ** 2)))
        for label in labels
    }
    return OrdersBeside(
        compared,
        order_errors([compared], labels),
        rms,
        {label: float(np.sqrt(variance["", label])) for label in labels},
        {label: complex(values[2 * c], values[2 * c + 1]) for c, label in enumerate(labels) if search.constants},
        {channel.label: channel.unit for channel in tracked.channels},
    )


def simulated_vectors(
    diagram: str, given: OrderVectors, orders: Sequence[int], turns: int = 1, *, trust_blocks: bool = False
) -> dict[str, Vectors]:
    """Return the vectors of a diagram along each run, by channel: run -> channel -> (n,).

    Along the samples or the speeds of a run-up; at runs of constant speed those of the settled motion there.
    """
    runs = given.orders.runs
    if runs[0].noise is not None:
        return {run.id: _at_speeds(diagram, trust_blocks, given.orders, run) for run in runs}
    along = _along_table if given.sampled is None else _along_samples
    return along(load(diagram, trust_blocks=trust_blocks), given, orders, turns)


def _at_speeds(diagram: str, trust_blocks: bool, recording: OrderRecording, run: OrderRun) -> Vectors:
    """Return the orders of the settled motion of a diagram at the speeds and settings of a table."""
    if run.sense < 0:
        raise RotorsimError(Problem("a shaft that turns the other way round has no settled motion beside it", run.id))
    loaded = load(diagram, set=run.settings, trust_blocks=trust_blocks)
    names = list(dict.fromkeys(loaded.as_measured(one.name) for one in recording.channels.values()))
    motion = periodic(loaded, speeds=run.speed, signals=names)
    return {
        column: 2 * motion.harmonic(loaded.as_measured(one.name), one.order)
        if one.order <= motion.orders[-1]
        else np.zeros(len(run.speed), complex)
        for column, one in recording.channels.items()
    }


def _along_samples(loaded: Diagram, given: OrderVectors, orders: Sequence[int], turns: int) -> dict[str, Vectors]:
    """Return the orders of a diagram that turns as each run did, tracked as those of the run."""
    assert given.sampled is not None
    recording, found = given.sampled, {}
    for run in recording.runs:
        if run.id not in {own.id for own in given.orders.runs}:
            continue
        result = simulate_as_recorded(loaded, recording, run.id).result
        there = np.searchsorted(run.time, result.time - np.diff(run.time).min() / 2)  # times of parts are rounded
        values = {}
        for column, channel in recording.channels.items():
            values[column] = run.values[column]
            if channel.name in result.signals:
                values[column] = np.full(len(run.time), np.nan)
                values[column][there] = result[channel.name]
        own = replace(recording, runs=(replace(run, values=values),))
        found[run.id] = dict(tracked_recording(own, orders, turns)[0].runs[0].vectors)
    return found


def _along_table(loaded: Diagram, given: OrderVectors, orders: Sequence[int], turns: int) -> dict[str, Vectors]:
    """Return the orders of a diagram along the speeds of a table."""
    recording = given.orders
    labels = {one.label: name for name, one in recording.channels.items()}
    alone = replace(recording, slow_roll=False)  # nothing of the recording is fitted along
    found = {}
    for run in recording.runs:
        beside = orders_beside(loaded, alone, run.id).compared.simulated
        found[run.id] = {labels[label]: vectors for label, vectors in beside.items() if label in labels}
    return found
