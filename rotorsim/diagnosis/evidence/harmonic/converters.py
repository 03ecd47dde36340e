"""Converters that a diagram lacks and whose steps the readings show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.diagnosis.evidence.opened import Converter
from rotorsim.errors import Problem
from rotorsim.signals.converters import STEP_TOLERANCE, is_entry
from rotorsim.signals.quantisation import find_steps, readings_of, step_of
from rotorsim.units import format_quantity


def find_converters(document: Mapping[str, Any], runs: HarmonicRuns, catalogue: Catalogue) -> list[Converter]:
    """Return the converters whose steps change the recorded harmonics, one put in after another."""
    seen = find_steps(runs.recording, runs.harmonics)
    found: list[Converter] = []
    while seen:
        for item in catalogue.candidates(runs.load(document), runs.recorded):
            behind = {name for name in runs.recorded if any(is_entry(name, said) for said in item.measured)}
            if item.from_steps and behind & seen.keys():
                break
        else:
            break
        best = max((seen[name] for name in behind & seen.keys()), key=lambda step: step.seen)
        steps, warnings = {}, []
        for name in sorted(behind):  # one converter has them all
            step = seen.get(name) or step_of(readings_of(runs.recording, name))
            if step is not None and abs(step.size - best.size) <= STEP_TOLERANCE * best.size:
                steps[name] = step
            else:
                what = f"does not have the step that the readings beside it have, {format_quantity(best.size, 'm')}"
                warnings.append(Problem(what, name, severity="warning"))
        document = item.document(document, dict.fromkeys(item.from_steps, best.size))
        found.append(Converter(item, document, steps, tuple(warnings)))
        seen = {name: step for name, step in seen.items() if name not in behind}
    return found
