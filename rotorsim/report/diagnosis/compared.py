"""The diagrams of a diagnosis beside what was measured: harmonics, samples in time, order vectors, or resonances."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.evidence.fit import FAILURES
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.diagnosis.evidence.harmonic.scoring import predict
from rotorsim.diagnosis.evidence.orders.evidence import OrderEvidence
from rotorsim.diagnosis.evidence.resonance.evidence import ResonanceEvidence
from rotorsim.diagnosis.evidence.waveform.evidence import WaveformEvidence
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.jobs.threads import one_thread
from rotorsim.report.comparison.harmonics import Comparison, PredictedRuns, predicted_runs
from rotorsim.report.comparison.samples import SampleComparison, Trace
from rotorsim.report.figures.bode import Curve, bode_figure, residual_rows_figure
from rotorsim.report.figures.orbits import orbits_figure
from rotorsim.report.figures.samples import beside_figure, residuals_in_time_figure
from rotorsim.report.figures.spectra import residuals_figure, spectra_figure
from rotorsim.report.figures.speed_curves import speed_curves_figure
from rotorsim.report.page import Drawn
from rotorsim.report.style import BLUE, RED, Look

GIVEN = Look("diagram as given", RED, "s", "--", 8.5)
REPAIRED = Look("repaired diagram", BLUE, "o", "-", 7.0)
HELD, FITTED = "hold-out runs", "fitted runs"
SHOWN_HARMONICS = ("spectra", "orbits", "speed_curves")
Diagrams = Sequence[tuple[Look, Mapping[str, Any]]]  # the diagram as given, then the repaired one where it differs
SPECTRA = (
    "Full spectra: what noise alone would give is grey; a residual (cross) below it is explained. Small marks, where "
    "there are any: asynchronous lines, at kX + nu."
)
ORBITS = "Motion that is synchronous with the shaft, over one turn; the arrow shows its direction."
CURVES = (
    "Amplitude and phase against shaft angle zero over speed, for each set of settings; thin lines: beyond the "
    "hold-out speeds."
)
TRACES = "Each signal in the run that the diagram as given explains least, and there its worst stretch."
RESIDUALS = (
    "Measured less simulated, and its autocorrelation; that of white noise stays within the band at 95 % of the lags. "
    "Noise of a recorder may be coloured: the verdict asks what of the residual can be predicted."
)
BODE = (
    "Amplitude and phase lag of order vectors over the speed, and what each diagram leaves; slow roll is in "
    "the simulated ones where it was fitted along."
)
ROWS_TITLE = (
    "What is left of each row in standard deviations of the noise, and how alike rows are that lie some rows apart: "
    "noise stays within the band."
)


class Compared(Protocol):
    """Both diagrams beside what was measured, as the evidence of a diagnosis allows it."""

    @property
    def speeds(self) -> Sequence[float]:
        """The speeds of the fitted runs [rad/s]; none of a machine that does not turn."""

    @property
    def parts(self) -> Sequence[Compared]:
        """Itself in parts, whose figures are drawn apart."""

    def figures(self) -> Iterator[Drawn]:
        """Return figures of both diagrams beside hold-out runs, beside fitted ones without any."""

    def residuals(self) -> Drawn | None:
        """Return the figure of residuals of the fitted runs; None where there is nothing to show."""


def before_and_after_figure(diagnosis: Diagnosis) -> Figure:
    """Return both diagrams beside hold-out runs (fitted ones without any): over speed, or in time.

    Raises RotorsimError where there is nothing to draw.
    """
    figures = {drawn.name: drawn.figure for drawn in compared(diagnosis).figures() if drawn.figure is not None}
    for name in ("speed_curves", *figures):
        if name in figures:
            return figures[name]
    hint = "a recording of a turning shaft, or in time, of a diagram that can be simulated"
    raise RotorsimError(Problem("nothing of this diagnosis can be drawn beside its recording", hint=hint))


def is_unchanged(diagnosis: Diagnosis) -> bool:
    """Return whether the diagram stayed as it was given."""
    return not diagnosis.effects and diagnosis.after is diagnosis.before


def looks_of(diagnosis: Diagnosis) -> tuple[Look, ...]:
    """Return how the diagram as given and the repaired one are called and drawn; one where nothing was changed."""
    if is_unchanged(diagnosis):
        return (replace(REPAIRED, label=GIVEN.label),)
    return GIVEN, replace(REPAIRED, label="nearest model") if diagnosis.verdict == "outside_catalogue" else REPAIRED


def _diagrams(diagnosis: Diagnosis) -> Diagrams:
    given = values_in(diagnosis.before.document, diagnosis.before.values)
    return tuple(zip(looks_of(diagnosis), (given, diagnosis.document), strict=False))


# -- harmonics of a turning shaft --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OfHarmonics:
    """Diagrams beside harmonics of a turning shaft."""

    diagrams: Diagrams
    evidence: HarmonicEvidence
    given: HarmonicEvidence  # with the readings as they are, without converters that the diagram lacks
    shown: Collection[str] = SHOWN_HARMONICS

    @property
    def speeds(self) -> Sequence[float]:
        """The speeds of the fitted runs [rad/s]."""
        return [item.fit.speed for item in self.evidence.harmonics]

    @property
    def parts(self) -> Sequence[OfHarmonics]:
        """Harmonics of the runs, and curves over speed, which take as long."""
        return [replace(self, shown=some) for some in (SHOWN_HARMONICS[:2], SHOWN_HARMONICS[2:])]

    @cached_property
    def fitted(self) -> Comparison | None:
        """Both diagrams beside the runs that they were fitted to; None where neither has a settled motion."""
        return self._beside((self.given, self.evidence), FITTED)

    @cached_property
    def held(self) -> Comparison | None:
        """Both diagrams beside the hold-out runs, the larger set of two; None without any."""
        sets = [evidence.parts for evidence in (self.given, self.evidence)]
        parts = [max(some, key=lambda part: len(part.harmonics)) for some in sets if some]
        return self._beside((parts[0], parts[-1]), HELD) if parts else None

    def _beside(self, parts: tuple[HarmonicRuns, HarmonicRuns], of: str) -> Comparison | None:
        """Return both diagrams beside runs: the first beside readings as they are, where converters were found."""
        pairs = zip(self.diagrams, parts, strict=False)
        both = ((look, self._predicted(document, part)) for (look, document), part in pairs)
        diagrams = tuple((look, runs) for look, runs in both if runs is not None)
        return Comparison(diagrams, of) if diagrams else None

    def _predicted(self, document: Mapping[str, Any], part: HarmonicRuns) -> PredictedRuns | None:
        try:
            with one_thread():
                prediction = predict(document, part)
        except FAILURES:
            return None
        experiment, Y = prediction.experiment, prediction.evaluation.Y
        return predicted_runs(experiment, experiment.theta0, Y) if np.isfinite(Y).any() else None

    def figures(self) -> Iterator[Drawn]:
        """Return spectra, orbits and curves over speed, beside hold-out runs or else fitted ones."""
        beside = self.held or self.fitted
        if beside is None:
            return
        if "spectra" in self.shown:
            yield Drawn("spectra", spectra_figure(beside), SPECTRA)
        if "orbits" in self.shown:
            yield Drawn("orbits", orbits_figure(beside), ORBITS)
        if "speed_curves" in self.shown:
            fitted = None if self.held is None else self.fitted
            yield Drawn("speed_curves", speed_curves_figure(beside, fitted), CURVES)

    def residuals(self) -> Drawn | None:
        """Return the residuals of all harmonics of the fitted runs."""
        if self.fitted is None:
            return None
        caption = "White is what noise alone makes; 2 is exceeded in 2 % of cases."
        return Drawn("residuals", residuals_figure(self.fitted), caption)


# -- samples in time ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OfSamples:
    """Diagrams beside samples in time; each sample is not independent of the one before."""

    diagrams: Diagrams
    evidence: WaveformEvidence
    given: WaveformEvidence
    speeds: Sequence[float] = ()

    @property
    def parts(self) -> Sequence[OfSamples]:
        """Itself: all figures are of the same simulated motion."""
        return [self]

    def figures(self) -> Iterator[Drawn]:
        """Return signals in time, each in the run that the diagram as given explains least."""
        runs, of = (self.evidence.held, HELD) if self.evidence.held else (self.evidence.runs, FITTED)
        yield Drawn("traces", beside_figure(self.beside(runs, f"Signals in time, {of}").worst_runs()), TRACES)

    def residuals(self) -> Drawn:
        """Return the residuals of the fitted runs, with their autocorrelation."""
        drawn = residuals_in_time_figure(self.beside(self.evidence.runs, f"Residuals, {FITTED}"))
        return Drawn("residuals", drawn, RESIDUALS)

    def beside(self, runs: Sequence[SampledRun], title: str) -> SampleComparison:
        """Return both diagrams beside the signals of some runs."""
        evidence = self.evidence
        with one_thread():
            simulated = [evidence.simulated(document, runs) for _, document in self.diagrams]
        traces = tuple(
            Trace(
                run.id,
                name,
                evidence.units[name],
                run.time,
                run.values[name],
                tuple(None if one is None else one[r][:, c] for one in simulated),
            )
            for r, run in enumerate(runs)
            for c, name in enumerate(evidence.channels.outputs)
        )
        return SampleComparison(tuple(look for look, _ in self.diagrams), traces, title)


# -- order vectors over the speed --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OfOrders:
    """Diagrams beside order vectors over the speed."""

    diagrams: Diagrams
    evidence: OrderEvidence
    given: OrderEvidence
    speeds: Sequence[float] = ()

    @property
    def parts(self) -> Sequence[OfOrders]:
        """Itself: all figures are of the same simulated motion."""
        return [self]

    def figures(self) -> Iterator[Drawn]:
        """Return a Bode plot of every run and channel."""
        evidence = self.evidence
        of = HELD if evidence.held else FITTED
        with one_thread():
            simulated = [(look, evidence.vectors(document)) for look, document in self.diagrams]
        for r, (run, columns) in enumerate(evidence.shown):
            for c, (column, channel) in enumerate(columns.items()):
                noise = evidence.noise[channel.label]
                curves = [
                    Curve(look.label, run.speed, vectors[r][:, c], look.line, look.colour)
                    for look, vectors in simulated
                    if vectors is not None
                ]
                measured = Curve("measured", run.speed, run.vectors[column])
                title = f"{channel.label}, run {run.id}, {of}"
                yield Drawn(
                    f"orders_{run.id}_{c + 1}", bode_figure(measured, curves, title, channel.unit, noise.std), BODE
                )

    def residuals(self) -> Drawn | None:
        """Return what is left of the rows of the first channel in the longest fitted run, and its autocorrelation."""
        evidence = self.evidence
        r = max(range(len(evidence.runs)), key=lambda k: len(evidence.runs[k].speed))
        with one_thread():
            left = [(look, evidence.left_over(document)) for look, document in self.diagrams]
        rows = [
            Curve(look.label, evidence.runs[r].speed, parts[r][:, 0], look.line, look.colour)
            for look, parts in left
            if parts is not None
        ]
        if not rows:
            return None
        title = f"Residual of {next(iter(evidence.noise))}, run {evidence.runs[r].id}, {FITTED}"
        return Drawn("residuals", residual_rows_figure(rows, title), ROWS_TITLE)


# -- resonances --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OfResonances:
    """Recorded resonances: nothing is drawn of them."""

    diagrams: Diagrams
    evidence: ResonanceEvidence
    given: ResonanceEvidence
    speeds: Sequence[float] = ()

    @property
    def parts(self) -> Sequence[OfResonances]:
        """None."""
        return []

    def figures(self) -> Iterator[Drawn]:
        """Return nothing."""
        return iter(())

    def residuals(self) -> None:
        """Return nothing."""


_BY_EVIDENCE: Mapping[type[Any], Callable[[Diagrams, Any, Any], Compared]] = {
    HarmonicEvidence: OfHarmonics,
    WaveformEvidence: OfSamples,
    OrderEvidence: OfOrders,
    ResonanceEvidence: OfResonances,
}


def compared(diagnosis: Diagnosis) -> Compared:
    """Return the comparison that the evidence of a diagnosis allows."""
    of = next(_BY_EVIDENCE[kind] for kind in type(diagnosis.evidence).__mro__ if kind in _BY_EVIDENCE)
    return of(_diagrams(diagnosis), diagnosis.evidence, diagnosis.given)
