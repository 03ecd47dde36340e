"""Recordings of a shaft whose speed changes as evidence: compared in time, along the recorded angle."""

from __future__ import annotations

from dataclasses import dataclass

from rotorsim.diagnosis.evidence.evidence import Terms
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.waveform.evidence import WaveformEvidence

TURNING_TERMS = Terms(
    left_out="stretches left out one by one", predicted="stretches left out", more_runs="runs through other speeds"
)


@dataclass(frozen=True, eq=False)
class TurningEvidence(WaveformEvidence):
    """Runs of a shaft that turns, driven by its recorded angle: long ones, so that only promising laws are fitted."""

    terms = TURNING_TERMS
    costly = True

    def bounds(self, fit: Fit, better: Fit | None = None) -> None:
        """Return None: nothing is known of places but by the sensitivities of each law."""
