"""Converters whose steps the readings show: put into the diagram, and taken out of the recordings."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from rotorsim.diagnose.finder import insertions
from rotorsim.diagnose.fitting import Source
from rotorsim.diagnose.insertion import Insertion
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.registry import Registry
from rotorsim.fault import Steps
from rotorsim.recordings.converter_steps import Step, find_steps, without_steps
from rotorsim.recordings.harmonics import harmonics_of
from rotorsim.recordings.recording import Recording

__all__ = ["Converter", "find_converters", "stated_steps", "through_converters"]


@dataclass(frozen=True, eq=False)
class Converter:
    """A converter that a diagram lacks: where it is put in, the step of every channel behind it, and the document."""

    insertion: Insertion
    steps: Mapping[str, Step]
    document: Mapping[str, Any]

    @property
    def step(self) -> Step:
        """The step of the channel that shows it best."""
        return max(self.steps.values(), key=lambda step: step.seen)


def find_converters(
    document: Mapping[str, Any], source: Source, registry: Registry, physics: Collection[str] | None
) -> list[Converter]:  # fmt: skip
    """Return the converters whose steps change the recorded harmonics, one put in after another."""
    left = find_steps(source.recording, source.harmonics)
    found: list[Converter] = []
    while left:
        for item in insertions(source.load(document), source.recorded, registry):
            behind = {name: step for name, step in left.items() if any(_is_entry(name, said) for said in item.measured)}
            if item.from_steps and behind and (physics is None or item.physics in physics):
                break
        else:
            break
        size = max(behind.values(), key=lambda step: step.seen).size
        document = item.document(document, dict.fromkeys(item.from_steps, size))
        found.append(Converter(item, behind, document))
        left = {name: step for name, step in left.items() if name not in behind}
    return found


def stated_steps(diagram: Diagram, recording: Recording) -> dict[str, Step]:
    """Return the steps of converters that a diagram has, by the flat names of the recorded signals behind them."""
    found = {}
    for said, meant in diagram.measured.items():
        node = diagram.nodes[meant.block]
        keys = [key for fault in node.block.faults for key, item in fault.fixed.items() if isinstance(item, Steps)]
        for channel in recording.channels.values() if keys else ():
            if _is_entry(channel.name, str(said)):
                found[channel.name] = Step(float(node.values[keys[0]]), 0.0)
    return found


def through_converters(recording: Recording, steps: Mapping[str, Step]) -> Recording:
    """Return a recording with the signals that went into converters."""
    known = {channel.name for channel in recording.channels.values()}
    here = {name: step for name, step in steps.items() if name in known}
    return without_steps(recording, harmonics_of(recording), here) if here else recording


def _is_entry(name: str, signal: str) -> bool:
    """Return whether a flat name is an entry of a signal ("rotor.displacement[3,1]" of "rotor.displacement[3]")."""
    return name == signal or name.startswith((f"{signal}[", f"{signal.removesuffix(']')},"))
