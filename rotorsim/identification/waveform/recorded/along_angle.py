"""Runs of a shaft that turns, as samples in time: its recorded angle drives the diagram in the place of a clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorsim.diagram.diagram import Diagram, Endpoint, Wire
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.driven.equations import clock_ports
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.recordings.recording import ANGLE, TACHO, Channel, Recording, Run
from rotorsim.signals.shaft_angle import pulses_of
from rotorsim.signals.turning import is_run_up, turning

ANGLE_UNITS = {"theta": "rad", "speed": "rad/s", "acceleration": "rad/s^2"}  # of what a clock gives and an angle tells


def turns_as_recorded(diagram: Diagram, recording: Recording) -> bool:
    """Return whether a shaft turns: where its angle or pulses were recorded, or a wire begins at a clock."""
    measured = {channel.signal for channel in recording.channels.values()} & {ANGLE, TACHO}
    return bool(measured or diagram.turns or any(run.tacho is not None for run in recording.runs))


def changes_speed(recording: Recording) -> bool:
    """Return whether the speed of a shaft changes within any run, so that all runs are compared in time."""
    return any(is_run_up(recording, run) for run in recording.runs)


def is_in_time(diagram: Diagram, recording: Recording) -> bool:
    """Return whether a recording is compared sample by sample: no shaft turns, or one that changes its speed does."""
    return not turns_as_recorded(diagram, recording) or changes_speed(recording)


def with_reaction(diagram: Diagram) -> Diagram:
    """Return a diagram whose unbalances feel the angular acceleration of the shaft that its clock turns.

    Wired are inputs "acceleration" that a block may go without and whose "theta" is the clock's; warnings say so.
    """
    taken = {(wire.target.block, wire.target.port) for wire in diagram.wires} | diagram.cut
    added: list[tuple[Endpoint, Endpoint]] = []
    for wire in diagram.wires:
        clock, block = diagram.nodes[wire.source.block], diagram.nodes[wire.target.block]
        turned = clock.block.category == "clock" and wire.source.port == wire.target.port == "theta"
        if turned and {"acceleration"} <= clock.outputs.keys() & block.inputs.keys():
            ends = Endpoint(clock.name, "acceleration"), Endpoint(block.name, "acceleration")
            if (block.name, "acceleration") not in taken and ends[1] not in (end for _, end in added):
                added.append(ends)
    if not added:
        return diagram
    document = {**diagram.document, "wires": [*diagram.document["wires"], *([str(a), str(b)] for a, b in added)]}
    what = f"{' and '.join(str(b) for _, b in added)} is wired to {added[0][0]}: the speed changes in these runs"
    note = Problem(what, diagram.name, severity="warning")
    wires = (*diagram.wires, *(Wire(a, b) for a, b in added))
    return replace(diagram, wires=wires, document=document, warnings=(*diagram.warnings, note))


def along_angle(diagram: Diagram, recording: Recording, runs: Sequence[Run] | None = None) -> Recording:
    """Return a recording in which a shaft turns with what its clock gives as channels; any other as it is.

    They take the place of channels of the angle and of pulses. runs: those that are asked for; default all.
    Raises RotorsimError where the diagram has not one clock, or nothing tells the angle of a run.
    """
    if not turns_as_recorded(diagram, recording):
        return recording
    clocks = [name for name, node in diagram.nodes.items() if node.block.category == "clock"]
    problems: list[Problem] = []
    if len(clocks) != 1:
        what = f"has {len(clocks) or 'no'} clock{'s' * (len(clocks) > 1)}: which one turns as recorded is not known"
        problems.append(Problem(what, diagram.name, hint="one block 'clock' gives the angle of the shaft"))
    ports = [port for port in clock_ports(diagram) if port.partition(".")[0] in clocks[:1]]
    given = {port: Channel(port, port, None, None, None, ANGLE_UNITS[port.rpartition(".")[2]]) for port in ports}
    kept = {
        column: channel
        for column, channel in recording.channels.items()
        if channel.signal not in (ANGLE, TACHO, *ports) and column not in given
    }
    turned = []
    for run in recording.runs if runs is None else runs:
        try:
            shaft = turning(recording, run)
        except RotorsimError as error:
            problems += error.problems
            continue
        own = {port: np.asarray(getattr(shaft, port.rpartition(".")[2])) for port in ports}
        turned.append(replace(run, values={**{c: v for c, v in run.values.items() if c in kept}, **own}))
    if problems:
        raise RotorsimError(*problems)
    return replace(recording, channels={**kept, **given}, runs=tuple(turned))


def unused_channels(diagram: Diagram, recording: Recording) -> list[Problem]:
    """Return warnings about measured speeds and accelerations of a shaft, for which those of its angle are taken."""
    if not turns_as_recorded(diagram, recording):
        return []
    ports = {port for port in clock_ports(diagram) if not port.endswith(".theta")}
    what = "is not used: the speed of the shaft is taken from its angle"
    return [
        Problem(what, f"channel {column}", channel.place, "leave the channel out, or the angle", "warning", "unused")
        for column, channel in recording.channels.items()
        if channel.signal in ports
    ]


def lateness(recording: Recording) -> float:
    """Return the standard deviation of the time by which all pulses of a recording are late [s]: sampled ones are."""
    return max((pulses_of(recording, run)[2] for run in recording.runs), default=0.0)


def turned_later(run: SampledRun, diagram: Diagram, late: float) -> SampledRun:
    """Return a run whose shaft is where it is a time [s] later: theta + late W, W + late W'."""
    values = dict(run.values)
    for port in clock_ports(diagram):
        clock, _, name = port.rpartition(".")
        rate = {"theta": f"{clock}.speed", "speed": f"{clock}.acceleration"}.get(name, "")
        if port in values and rate in values:
            values[port] = run.values[port] + late * run.values[rate]
    return replace(run, values=values)
