"""A recording opened beside a diagram, with converters that the readings show and the diagram lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.errors import Problem
from rotorsim.signals.quantisation import Step


@dataclass(frozen=True, eq=False)
class Converter:
    """A converter that a diagram lacks: where it is put in, the document with it, the step of every channel behind it.

    warnings: of channels that do not have the step that is told.
    """

    insertion: Insertion
    document: Mapping[str, Any]
    steps: Mapping[str, Step]
    warnings: tuple[Problem, ...] = ()

    @property
    def step(self) -> Step:
        """The step of the channel that shows it best."""
        return max(self.steps.values(), key=lambda step: step.seen)


@dataclass(frozen=True, eq=False)
class Opened:
    """Evidence and the fit of the diagram to it (base), the fault candidates to try, and warnings.

    screened: candidates that are not tried at every place, and why. converters: that the readings show and the diagram
    lacks; before, given: the fit of the diagram without them, and the evidence with the readings as they are.
    """

    evidence: Evidence
    base: Fit
    before: Fit
    given: Evidence
    catalogue: Catalogue
    held_out: bool
    warnings: Sequence[Problem]
    screened: Sequence[tuple[str, str]] = ()
    converters: Sequence[Converter] = ()
