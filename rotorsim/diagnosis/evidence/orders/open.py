"""Recordings of orders over the speed as evidence: the base fit, and what beside it counts as noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import LONGEST, RATE, SAMPLED
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.base_fit import base_fit, first_free
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.opened import Opened
from rotorsim.diagnosis.evidence.orders.evidence import OrderEvidence, doubts_of
from rotorsim.diagnosis.evidence.orders.noise import white_noise
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.order_tracking import largest_of, tracked_orders
from rotorsim.recordings.orders import OrderRecording

REWEIGHED = 3  # times that the base fit and its noise follow one another


def open_orders(
    diagram: Diagram,
    recording: OrderRecording,
    hold_out: OrderRecording | None,
    catalogue: Catalogue,
    warnings: Sequence[Problem],
) -> Opened:
    """Return order vectors as evidence, and the fit of the diagram as given.

    Raises RotorsimError for channels that the diagram does not have, a diagram without one clock, no run to identify
    from, and where the diagram diverges.
    """
    evidence = _evidence(diagram, recording, hold_out, catalogue.trust)
    base, refined = base_fit(diagram, evidence)
    for _ in range(REWEIGHED):
        other = None if base.failure else evidence.recalibrated(base)
        if other is None:
            break
        evidence = other
        base = evidence.fit(base.document, [[base.values]])
    if not base.failure:
        evidence = replace(evidence, sizes=_sizes(evidence, base), doubts=doubts_of(evidence, base))
    notes = [Problem(note, severity="warning") for note in refined]
    return Opened(evidence, base, base, evidence, catalogue, bool(evidence.held), [*warnings, *notes])


def _evidence(
    diagram: Diagram, recording: OrderRecording, hold_out: OrderRecording | None, trust_blocks: bool
) -> OrderEvidence:
    runs = recording.select("identify")
    if not runs:
        hint = '"use": "identify" marks the runs that parameters are taken from'
        raise RotorsimError(Problem("no run to identify from", recording.name, hint=hint))
    tracked = tracked_orders(diagram, recording, runs, diagram.free)
    held = [(recording, recording.select("hold_out"))]
    held += [] if hold_out is None else [(_in_order(recording, hold_out), hold_out.runs)]
    some = tuple((one, own) for one, own in held if own)
    for one, own in some:
        tracked_orders(diagram, one, own, diagram.free)  # what is wrong with them is said before any work
    return OrderEvidence(
        recording=recording,
        runs=runs,
        folder=diagram.folder,
        trust_blocks=trust_blocks,
        recorded=tuple(dict.fromkeys(channel.name for channel in recording.channels.values())),
        noise=white_noise(tracked),
        old=first_free(diagram),
        held=some,
    )


def _in_order(recording: OrderRecording, hold_out: OrderRecording) -> OrderRecording:
    """Return a hold-out recording with the channels of another, in its order. Raises RotorsimError where it cannot."""
    by_label = {channel.label: column for column, channel in hold_out.channels.items()}
    missing = [channel.label for channel in recording.channels.values() if channel.label not in by_label]
    if missing:
        what = f"has no {', '.join(missing)}, which the diagram is fitted to"
        raise RotorsimError(Problem(what, hold_out.name, hint="hold-out runs need the channels of the recording"))
    if hold_out.slow_roll != recording.slow_roll:
        hint = 'give both with "slow_roll": "included", or both with "subtracted"'
        raise RotorsimError(Problem("its slow roll is not treated as that of the recording", hold_out.name, hint=hint))
    columns = [by_label[channel.label] for channel in recording.channels.values()]
    return replace(hold_out, channels={column: hold_out.channels[column] for column in columns})


def _sizes(evidence: OrderEvidence, base: Fit) -> dict[str, float]:
    """Return the largest magnitude of signals, simulated or as recorded, and how long runs and their samples are.

    Rates are those of lines at the highest speed.
    """
    document = values_in(base.document, base.values)
    tracked = evidence.tracked(document)
    found = largest_of(tracked, evidence.load(document))
    for track in tracked.tracks:
        for c, channel in enumerate(tracked.channels):
            size = np.abs(track.vectors[:, c])
            if np.isfinite(size).any():
                found[channel.name] = max(found.get(channel.name, 0.0), float(np.nanmax(size)))
    times = [track.run.time[track.first[0] :] for track in tracked.tracks]
    longest, step = max(float(np.ptp(time)) for time in times), max(float(np.diff(time).max()) for time in times)
    fastest = max(float(np.abs(track.source.speed).max()) for track in tracked.tracks)
    rates = {f"{RATE} {name}": fastest * size for name, size in found.items()}
    return {**found, **rates, LONGEST: longest, SAMPLED: step}
