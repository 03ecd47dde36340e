"""Runs as their shaft turned: by how much pulses were late, and what the motion tells of the angle between them.

A sampled pulse is stamped at the first sample that sees it, at the last one before, or about it: of all pulses of a
recording the same. The angle is theta + late W then, which no phase can stand for where the speed W changes. How errors
of the angle are fitted beside the parameters: `rotorsim.identification.waveform.open_angle`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.driven.equations import clock_ports
from rotorsim.identification.waveform.evaluation import Evaluation, Label
from rotorsim.identification.waveform.noise import weights_of
from rotorsim.identification.waveform.noise_model import NoiseModel, noise_model
from rotorsim.identification.waveform.open_angle import OpenAngle, open_angle, with_estimated_angle
from rotorsim.identification.waveform.recorded.along_angle import lateness, turned_later
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun
from rotorsim.identification.waveform.recorded.reading import read_runs
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.sensors import with_sensor_errors
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.recordings.recording import Recording, Run


@dataclass(frozen=True, eq=False)
class OnTime:
    """Runs whose angle is right by the time that pulses were late (shift [s]), and what is noise in them.

    angle: what is not known of it. Hum and drift of sensors are fitted beside them, where the shaft turns.
    """

    runs: tuple[SampledRun, ...]
    noise: NoiseModel
    angle: OpenAngle
    shift: float = 0.0


def on_time(diagram: Diagram, channels: Channels, runs: Sequence[SampledRun], recording: Recording) -> OnTime:
    """Return runs as their shaft turned; recording: as it was made, with its pulses.

    Raises RotorsimError where the diagram diverges when it is driven as recorded.
    """
    noise, turns = noise_model(diagram, channels, runs), _turn(diagram, channels)
    if turns:
        runs = with_sensor_errors(diagram, channels, runs, noise)
        noise = noise_model(diagram, channels, runs, noise) if any(run.nuisances is not None for run in runs) else noise
    angle = open_angle(diagram, recording, runs, lateness(recording)) if turns else OpenAngle(diagram)
    if not angle.errors or not angle.shows(runs, noise.variance):
        return OnTime(tuple(runs), noise, angle)
    systems = subsystems_of(diagram, channels)
    weights = weights_of(noise.variance, runs, noise.rows)

    def fitted(turned: Sequence[SampledRun]) -> tuple[OutputErrorSearch, Evaluation]:
        return _fitted(OutputErrorSearch(systems, turned, weights, noise.least), noise, noise.starts)

    turned, angle, shift = with_estimated_angle(angle, runs, fitted)
    return OnTime(turned, noise_model(diagram, channels, turned, noise), angle, shift)


def held_on_time(
    diagram: Diagram, channels: Channels, held: Iterable[tuple[Recording, Sequence[Run]]], timed: OnTime
) -> tuple[SampledRun, ...]:
    """Return runs that are held out as their shaft turned, beside the parameters as they are known.

    held: recordings as they were made, and their runs along its angle.
    """
    noise = timed.noise
    found: list[SampledRun] = []
    for recording, chosen in held:
        runs: Sequence[SampledRun] = read_runs(diagram, chosen, channels)
        if runs and _turn(diagram, channels):
            runs = [turned_later(run, diagram, timed.shift) for run in runs]
            runs = with_sensor_errors(diagram, channels, runs, noise, known=False)
            runs = _with_angle(diagram, channels, runs, recording, noise)
        found += runs
    return tuple(found)


def _with_angle(
    diagram: Diagram, channels: Channels, runs: Sequence[SampledRun], recording: Recording, noise: NoiseModel
) -> Sequence[SampledRun]:
    """Return held-out runs with the angle that their motion tells."""
    angle = open_angle(diagram, recording, runs)
    if not angle.errors or not angle.shows(runs, noise.variance):
        return runs
    [whole, *_] = subsystems_of(diagram, channels)
    weights = {signal: 1 / value for signal, value in noise.variance.items()}

    def fitted(turned: Sequence[SampledRun]) -> tuple[OutputErrorSearch, Evaluation]:
        return _fitted(OutputErrorSearch((whole,), turned, weights, noise.least, hold="theta"), noise)

    return with_estimated_angle(angle, runs, fitted)[0]


def _fitted(
    search: OutputErrorSearch, noise: NoiseModel, starts: Mapping[Label, float] | None = None
) -> tuple[OutputErrorSearch, Evaluation]:
    """Return a search and its end, from the parameters as they are known."""
    start = search.first(starts)
    start[: search.m] = noise.theta
    return search, search.minimise(start)


def _turn(diagram: Diagram, channels: Channels) -> bool:
    """Return whether a shaft turns as recorded."""
    return bool({*clock_ports(diagram)} & {*channels.inputs})
