"""What a recorded signal means where a converter stands behind it: what goes into the converter is compared.

`through_converters` does it to a recording: signals are replaced by what went into converters of known steps.
`before_converters` does the same to a diagram, whose steps have no slope: recordings of it then mean the same signals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.errors import Problem
from rotorsim.fault import Fault, Steps
from rotorsim.recordings.recording import Recording
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.quantisation import Step, readings_of, step_of, without_steps
from rotorsim.units import format_quantity

STEP_TOLERANCE = 1e-3  # of a step, within which readings show the one that is stated


def stated_steps(diagram: Diagram, recording: Recording) -> tuple[dict[str, Step], list[Problem]]:
    """Return the steps of the converters of a diagram by flat names of signals, as far as readings show them.

    With warnings of those that they do not show.
    """
    shown: dict[str, Step] = {}
    problems = []
    for said, meant in diagram.measured.items():
        fault = _converter(diagram, meant.block)
        keys = fault.fixed if fault else {}
        for name in (channel.name for channel in recording.channels.values() if keys):
            if not is_entry(name, str(said)):
                continue
            key = next(iter(keys))
            stated = float(np.min(diagram.nodes[meant.block].values[key]))
            step = step_of(readings_of(recording, name))
            if step is not None and abs(step.size - stated) <= STEP_TOLERANCE * stated:
                shown[name] = step
                continue
            what = f"readings of {name} do not have the step of {format_quantity(stated, 'm')} that is stated"
            hint = "state the step of the converter that made this recording, or leave it out"
            problems.append(Problem(what, f"{meant.block}.{key}", hint=hint, severity="warning"))
    return shown, problems


def through_converters(recording: Recording, steps: Mapping[str, Step]) -> Recording:
    """Return a recording with the signals that went into converters of these steps, by flat name."""
    known = {channel.name for channel in recording.channels.values()}
    here = {name: step for name, step in steps.items() if name in known}
    return without_steps(recording, harmonics_of(recording), here) if here else recording


def before_converters(diagram: Diagram) -> Diagram:
    """Return a diagram of which recordings mean what goes into its converters."""
    measured = {}
    for said, end in diagram.measured.items():
        passed: set[str] = set()
        while end.block not in passed and (before := _entering(diagram, end)) is not None:
            passed.add(end.block)
            end = before
        measured[said] = end
    return diagram if measured == diagram.measured else replace(diagram, measured=measured)


def _entering(diagram: Diagram, end: Endpoint) -> Endpoint | None:
    """Return the signal that a converter reads, None where ``end`` is no reading of one."""
    fault = _converter(diagram, end.block)
    ports = [key for key, output in fault.through.items() if output == end.port] if fault else []
    for wire in diagram.wires:
        at = wire.target
        if at.block == end.block and at.port in ports and end.index[: len(at.index)] == at.index:
            return Endpoint(wire.source.block, wire.source.port, (*wire.source.index, *end.index[len(at.index) :]))
    return None


def _converter(diagram: Diagram, block: str) -> Fault | None:
    """Return the declaration that makes a block a converter of readings (`rotorsim.fault.Steps`), if it is one."""
    held = diagram.nodes[block].block
    faults: tuple[Fault, ...] = held.faults
    for fault in faults:
        chosen = fault.options.items() <= vars(held.option).items()
        if chosen and any(isinstance(item, Steps) for item in fault.fixed.values()):
            return fault
    return None


def is_entry(name: str, signal: str) -> bool:
    """Return whether a flat name is an entry of a signal ("rotor.displacement[3,1]" of "rotor.displacement[3]")."""
    return name == signal or name.startswith((f"{signal}[", f"{signal.removesuffix(']')},"))
