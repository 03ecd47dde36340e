"""A recording opened beside a diagram."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.harmonic.converters import Converter
from rotorsim.errors import Problem

__all__ = ["Opened"]


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
