"""Recordings behind the converters that a diagram has: compared is what goes into them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem
from rotorsim.recordings.recording import Recording
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.quantisation import Step, readings_of, step_of, without_steps
from rotorsim.units import format_quantity

__all__ = ["is_entry", "stated_steps", "through_converters"]

SAME = 1e-3  # of a step, within which readings show the one that is stated


def stated_steps(diagram: Diagram, recording: Recording) -> tuple[dict[str, Step], list[Problem]]:
    """Return the steps of the converters of a diagram by flat names of signals, as far as readings show them.

    With warnings of those that they do not show.
    """
    found: dict[str, Step] = {}
    problems = []
    for said, meant in diagram.measured.items():
        fault = diagram.converter(meant.block)
        keys = fault.fixed if fault else {}
        for name in (channel.name for channel in recording.channels.values() if keys):
            if not is_entry(name, str(said)):
                continue
            key = next(iter(keys))
            stated = float(np.min(diagram.nodes[meant.block].values[key]))
            shown = step_of(readings_of(recording, name))
            if shown is not None and abs(shown.size - stated) <= SAME * stated:
                found[name] = shown
                continue
            what = f"readings of {name} do not have the step of {format_quantity(stated, 'm')} that is stated"
            hint = "state the step of the converter that made this recording, or leave it out"
            problems.append(Problem(what, f"{meant.block}.{key}", hint=hint, severity="warning"))
    return found, problems


def through_converters(recording: Recording, steps: Mapping[str, Step]) -> Recording:
    """Return a recording with the signals that went into converters of these steps, by flat name."""
    known = {channel.name for channel in recording.channels.values()}
    here = {name: step for name, step in steps.items() if name in known}
    return without_steps(recording, harmonics_of(recording), here) if here else recording


def is_entry(name: str, signal: str) -> bool:
    """Return whether a flat name is an entry of a signal ("rotor.displacement[3,1]" of "rotor.displacement[3]")."""
    return name == signal or name.startswith((f"{signal}[", f"{signal.removesuffix(']')},"))
