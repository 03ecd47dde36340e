"""What a diagnosis in time says beside the statement: errors in the units of the signals, controllers, units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorsim.diagnosis.conclude.conclusions import Diagnosis
from rotorsim.diagnosis.evidence.waveform.data import TimeRun
from rotorsim.diagnosis.evidence.waveform.scoring import TimeScore
from rotorsim.diagnosis.evidence.waveform.source import TimeSource
from rotorsim.diagnosis.search.trials import MODEL_ERROR
from rotorsim.diagram.diagram import Diagram, Endpoint, Port
from rotorsim.errors import Problem
from rotorsim.units import compatible, format_quantity

__all__ = ["errors_in_words", "in_terms", "of_what_rests", "units_in_words", "what_controllers_obey", "what_is_left"]

TURNING = ("missing_channel", "no_phase_reference")  # codes of findings that matter only of a shaft that turns


def of_what_rests(warnings: Sequence[Problem]) -> tuple[Problem, ...]:
    """Return the warnings without those that matter only of a shaft that turns."""
    return tuple(problem for problem in warnings if problem.code not in TURNING)


def in_terms(found: Diagnosis, terms: Mapping[str, str]) -> Diagnosis:
    """Return a diagnosis whose words name things as they are in time: {name for a shaft: name here}."""

    def said(text: str) -> str:
        for old, new in terms.items():
            text = text.replace(old, new)
        return text

    rejected = tuple((name, said(why)) for name, why in found.rejected)
    return replace(
        found, statement=said(found.statement), next_experiment=said(found.next_experiment), rejected=rejected
    )


def what_is_left(found: Diagnosis) -> list[str]:
    """Return what the repaired diagram leaves beyond noise, where that is small beside what was missing."""
    left = found.after.misfit / found.after.freedom
    if found.verdict != "missing_physics" or left <= MODEL_ERROR:
        return []
    text = f"The repaired diagram leaves {left:.3g} times the variance of the noise: what else there is, is small "
    return [text + "beside this, and a diagnosis of the repaired diagram looks for it."]


def errors_in_words(source: TimeSource, found: Diagnosis, held: Sequence[TimeRun]) -> list[str]:
    """Return what the errors are in the units of the signals."""
    before, after = (score for score in (found.score_before, found.score_after) if isinstance(score, TimeScore))
    units = {name: source.recording.channels[column].unit for name, column in source.channels.columns.items()}
    where = "Held-out runs" if held else "Stretches left out"
    text = []
    for name, value in before.rms.items():
        later = after.rms.get(name)
        plain = "" if units[name] in ("", "1") else units[name]
        after_text = f", {format_quantity(later, plain, 3)} after" if later is not None and found.effects else ""
        text.append(f"{name} {format_quantity(value, plain, 3)} rms{after_text}")
    return [f"{where}, error of the simulation: {'; '.join(text)}."] if text else []


def what_controllers_obey(source: TimeSource) -> list[str]:
    """Return how well controllers follow from what was measured of the motion, without the rest of the loop."""
    text = []
    for (view, name), value in source.variance.items():
        if view:
            signal = np.concatenate([run.values[name] for run in source.runs])
            share = 100 * np.sqrt(value) / signal.std()
            text.append(
                f"{name} follows from the measured motion by the law of {view} to {share:.2g} %, whatever moves."
            )
    return text


def units_in_words(source: TimeSource, found: Diagnosis) -> list[str]:
    """Return which recorded units stand for those of a machine that an inserted block declares."""
    diagram = source.load(found.after.document)
    text = []
    for effect in found.effects:
        name = effect.candidate.insertion.name
        stands: dict[str, tuple[str, str]] = {}
        for port, signal in _neighbours(diagram, name):
            for column in (c for n, c in source.channels.columns.items() if n.partition("[")[0] == signal):
                unit = source.recording.channels[column].unit
                if port.unit and compatible(unit, port.unit) not in ("same", "scaled"):
                    stands[port.unit] = unit, signal
        if stands:
            each = " and ".join(
                f"{unit} stands for the {other} of {signal}" for unit, (other, signal) in stands.items()
            )
            text.append(f"{name} has the units of a machine: {each}.")
    return text


def _neighbours(diagram: Diagram, name: str) -> Iterator[tuple[Port, str]]:
    """Yield each port of a block with the signals that it takes, or that act where its output acts."""
    for wire in diagram.wires:
        if wire.target.block == name:
            yield diagram.nodes[name].inputs[wire.target.port], _port(wire.source)
        elif wire.source.block == name:
            for other in diagram.wires:
                if other.target == wire.target and other.source.block != name:
                    yield diagram.nodes[name].outputs[wire.source.port], _port(other.source)


def _port(end: Endpoint) -> str:
    return f"{end.block}.{end.port}"
