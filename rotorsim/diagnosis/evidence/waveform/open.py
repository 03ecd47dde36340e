"""Recordings in time as evidence: the base fit, the flexible model, what it leaves, and how that scatters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.base_fit import base_fit, first_free
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate, is_astray
from rotorsim.diagnosis.evidence.opened import Opened
from rotorsim.diagnosis.evidence.waveform.evidence import WaveformEvidence
from rotorsim.diagnosis.evidence.waveform.turning import TurningEvidence
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.identification.waveform.late_pulses import held_on_time, on_time
from rotorsim.identification.waveform.parts import parts_of
from rotorsim.identification.waveform.recorded.along_angle import (
    along_angle,
    turns_as_recorded,
    unused_channels,
    with_reaction,
)
from rotorsim.identification.waveform.recorded.data import channels_of, chosen_runs
from rotorsim.identification.waveform.recorded.reading import marked, notes_of, read_runs
from rotorsim.recordings.recording import Recording


def open_waveforms(
    diagram: Diagram,
    recording: Recording,
    hold_out: Recording | None,
    catalogue: Catalogue,
    warnings: Sequence[Problem],
) -> Opened:
    """Return the samples of a recording as evidence, and the fit of the diagram as given."""
    given = diagram
    if turns_as_recorded(diagram, recording):
        diagram = with_reaction(diagram)
    evidence = waveform_evidence(diagram, recording, hold_out, trust_blocks=catalogue.trust)
    base, refined = base_fit(diagram, evidence)
    given_types = {name: block["type"] for name, block in base.document["blocks"].items()}
    evidence = replace(evidence, given=given_types, smoothed=catalogue.smoothed)
    base, held = nearer(evidence, base)
    evidence = evidence.where_it_shows(base)
    notes = notes_of([*evidence.runs, *evidence.held])
    notes += [*unused_channels(diagram, recording), *diagram.warnings[len(given.warnings) :]]
    notes += [Problem(note, severity="warning") for note in (*refined, *held)]
    return Opened(evidence, base, base, evidence, catalogue, held_out=bool(evidence.held), warnings=[*warnings, *notes])


def nearer(evidence: WaveformEvidence, base: Fit) -> tuple[Fit, list[str]]:
    """Return the fit of a diagram as given, within `near_stated` times what was stated where it went astray in vain.

    For want of what is missing a parameter may leave all sizes (a heater that warms up at once), and the data are not
    explained. Beside such values no law shows what it explains. Where much more is left near what was stated, that is
    wrong, and the fit stays. With what is said of it.
    """
    pairs = [*zip(base.free, base.theta.tolist(), strict=True)]
    sized = [(item, value) for item, value in pairs if item.value and item.unit != ANGLE_UNIT]
    astray = [(item.name, value) for item, value in sized if is_astray(item, value, (item.scale, abs(item.value)))]
    if base.failure or is_adequate(base) or not astray:
        return base, []
    limits = {}
    for item, _ in sized:
        low, high = sorted((item.value / CRITERIA.near_stated, item.value * CRITERIA.near_stated))
        limits[item.name] = max(low, item.low), min(high, item.high)
    near = evidence.within(values_in(base.document, {item.name: item.value for item in base.free}), limits)
    if near.failure or near.misfit > CRITERIA.near_misfit * base.misfit:
        return base, []
    went = ", ".join(f"{name} to {value:.3g}" for name, value in astray)
    times = f"{CRITERIA.near_stated:g} times what is stated, and a tenth"
    return replace(near, document=base.document), [f"fitted as given, {went}: held within {times}"]


def waveform_evidence(
    diagram: Diagram, recording: Recording, hold_out: Recording | None = None, *, trust_blocks: bool = False
) -> WaveformEvidence:
    """Return the runs to identify from, ready to be fitted to, and those that are only scored.

    Raises RotorsimError with all that does not fit, and where the diagram diverges when it is driven as recorded.
    """
    turns = turns_as_recorded(diagram, recording)
    made, recording = recording, along_angle(diagram, recording)
    held = [(made, recording.select("hold_out"))]
    held += [] if hold_out is None else [(hold_out, along_angle(diagram, hold_out).runs)]
    channels = channels_of(diagram, recording)
    runs = read_runs(diagram, chosen_runs(recording), channels)
    channels = marked(channels, runs)
    timed = on_time(diagram, channels, runs, made)
    runs, noise = timed.runs, timed.noise
    held_out = held_on_time(diagram, channels, held, timed)
    parts, part_starts = parts_of(diagram, channels, runs, noise) if turns else ((), {})
    kind = partial(TurningEvidence, angle=timed.angle) if turns else WaveformEvidence
    return kind(
        channels=channels,
        folder=diagram.folder,
        trust_blocks=trust_blocks,
        recording=recording,
        runs=runs,
        variance=noise.variance,
        rows=noise.rows,
        stretches=noise.stretches,
        allowed=noise.allowed,
        by_force=noise.by_force,
        unjudged=noise.unjudged,
        least=noise.least,
        starts=noise.starts,
        sizes=noise.sizes,
        old=first_free(diagram),
        held=held_out,
        parts=parts,
        part_starts=part_starts,
        near=noise.near,
        stated={item.name: item.value for item in diagram.free},
    )
