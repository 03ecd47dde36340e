"""Evidence of a turning shaft: harmonics about the measured angle, compared with the settled motion of a diagram."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.change import Change
from rotorsim.diagnosis.evidence.evidence import HeldScore, Unknown
from rotorsim.diagnosis.evidence.fit import FAILURES, TO_THE_END, Effort, Fit, Starts
from rotorsim.diagnosis.evidence.harmonic.bounds import LowerBounds, open_bounds
from rotorsim.diagnosis.evidence.harmonic.drifts import unexplained_drift
from rotorsim.diagnosis.evidence.harmonic.fitting import fit_document, promise_of, without_drift
from rotorsim.diagnosis.evidence.harmonic.force import unknown_force
from rotorsim.diagnosis.evidence.harmonic.laws import LawsBeside
from rotorsim.diagnosis.evidence.harmonic.residual import is_force, residual_place
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns, has_mesh
from rotorsim.diagnosis.evidence.harmonic.scoring import held_score, left_out_score, predict, standardised
from rotorsim.diagnosis.evidence.harmonic.separation import best_change
from rotorsim.diagnosis.evidence.validated import Validated
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.recordings.recording import Recording
from rotorsim.signals.harmonics import RunHarmonics


@dataclass(frozen=True, eq=False)
class HarmonicEvidence(HarmonicRuns, Validated):
    """Harmonics of the runs to identify from, and of hold-out runs, recording by recording."""

    held: tuple[tuple[Recording, tuple[RunHarmonics, ...]], ...] = ()

    @property
    def line(self) -> tuple[float, float] | None:
        """The asynchronous frequency and its standard deviation [rad/s], where there is one."""
        return None if self.second is None else (self.second.value, self.second.std)

    @property
    def parts(self) -> tuple[HarmonicRuns, ...]:
        """The hold-out runs, recording by recording."""
        return tuple(replace(self, recording=recording, harmonics=runs, held=()) for recording, runs in self.held)

    def fit(self, document: Mapping[str, Any], starts: Starts, effort: Effort = TO_THE_END) -> Fit:
        """Return the best fit of a diagram; see `fit_document`."""
        most, linear_only, beyond = effort.most, effort.linear_only, effort.beyond
        return fit_document(document, self, starts, most=most, linear_only=linear_only, beyond=beyond)

    def promise(self, document: Mapping[str, Any], starts: Starts) -> float:
        """Return the misfit that one step from the best start promises; see `promise_of`."""
        return promise_of(document, self, starts)

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the whitened residual of a diagram as it is, or None where it has none."""
        try:
            experiment = self.open(self.load(document))
            return Likelihood(experiment).evaluate(experiment.theta0).residual
        except FAILURES:
            return None

    def refines_meshes(self, document: Mapping[str, Any]) -> bool:
        """Return whether a block of the diagram is a mesh, which is never exact."""
        return has_mesh(self.load(document))

    def bounds(self, fit: Fit, better: Fit | None = None) -> LowerBounds | None:
        """Return lower bounds of the misfit for every place, see `open_bounds`; none of laws, beside a better fit."""
        return open_bounds(fit, self) if better is None else None

    def laws(self, fit: Fit) -> LawsBeside:
        """Return what laws beside a fit leave by linear theory about its motion."""
        return LawsBeside(self, fit)

    def separation(self, first: Fit, second: Fit) -> Change | None:
        """Return the speed or gain that separates two hypotheses most; see `best_change`."""
        return best_change(first, second, self)

    def at(self, fit: Fit) -> Fit:
        """Return a fit to harmonics and the drift of 1X as harmonics alone judge it, at the same parameters."""
        return without_drift(fit, self)

    def with_drift(self, variance: float = 1.0) -> HarmonicEvidence:
        """Return the evidence with how 1X drifts within the runs."""
        return replace(self, drifting=variance)

    def unknown_force(self, document: Mapping[str, Any], spot: Spot) -> Unknown:
        """Return orders, exponents, work and lines of the force that explains the residual best."""
        return unknown_force(document, self, spot)

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return whether 1X drifts within a run more than noise and what is put in have it drift."""
        return [said for said in [unexplained_drift(after, self)] if said]

    # -- validation ----------------------------------------------------------------------------------------------------

    def scored(self, document: Mapping[str, Any]) -> HeldScore:
        """Return the score of a document on hold-out runs, or on runs left out one by one."""
        return held_score(document, self, self.parts) if self.held else left_out_score(document, self)

    def runs_of(self, fit: Fit) -> Sequence[tuple[float, float]] | None:
        """Return misfit and equations of each hold-out run, or of each run when it is predicted from the others."""
        if self.held:
            return self.score(fit).runs
        try:
            runs = standardised(predict(values_in(fit.document, fit.values), self))
        except FAILURES:
            runs = None
        if runs is None and len(fit.left_out):  # as it was when it was fitted
            return [(float(misfit), fit.rows / len(fit.left_out)) for misfit in fit.left_out]
        return runs

    def least(self, item: Insertion, without: Fit) -> list[tuple[float, float]] | None:
        """Return misfit and equations of each run with free harmonics at the place of an insertion."""
        pairs: list[tuple[float, float]] = []
        for part in self.parts or (self,):
            bounds = open_bounds(without, part)
            runs = None if bounds is None else bounds.least(item)
            if runs is None:
                return None
            pairs += runs
        return pairs

    def is_force(self, fit: Fit) -> bool:
        """Return whether free harmonics of a force at one place explain the residual of a linear diagram."""
        return is_force(fit, self)

    def residual_place(self, base: Fit, after: Fit) -> Mapping[str, Any] | None:
        """Return where the residual of a fit acts most likely, and its size there; see `residual_place`."""
        return residual_place(base, after, self)
