"""Recordings of a shaft whose speed changes as evidence: compared in time, along the recorded angle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Terms
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.waveform.evidence import WaveformEvidence
from rotorsim.identification.waveform.noise import Variance
from rotorsim.identification.waveform.open_angle import OpenAngle

TURNING_TERMS = Terms(
    left_out="stretches left out one by one", predicted="stretches left out", more_runs="runs through other speeds"
)


@dataclass(frozen=True, eq=False)
class TurningEvidence(WaveformEvidence):
    """Runs of a shaft that turns, driven by its recorded angle: long ones, so that only promising laws are fitted.

    angle: what is not known of it; None where it was recorded.
    """

    angle: OpenAngle | None = None

    terms = TURNING_TERMS
    costly = True

    @property
    def weighed_by(self) -> Variance:
        """The variance of the noise of each signal."""
        return self.variance

    def widened(self, fit: Fit) -> Fit:
        """Return a fit whose covariance holds what pulses leave open of the angle, too."""
        if fit.failure or self.angle is None:
            return fit
        search = self.search(values_in(fit.document, fit.values))
        point = np.concatenate([search.first()[: search.m], fit.starts])
        open_ = self.angle.covariance(search, search.evaluate(point, search.substeps(point)))
        count = len(fit.theta)
        return replace(fit, covariance=fit.covariance + open_[:count, :count])

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process gets, which widens nothing."""
        return {**super().__getstate__(), "angle": None}

    def bounds(self, fit: Fit, better: Fit | None = None) -> None:
        """Return None: nothing is known of places but by the sensitivities of each law."""
