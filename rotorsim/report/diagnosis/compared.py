"""The diagrams of a diagnosis beside what was measured: harmonics, samples in time, or resonances."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from matplotlib.figure import Figure

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.conclusions import Diagnosis
from rotorsim.diagnosis.evidence.harmonic import Source
from rotorsim.diagnosis.evidence.resonance.fitting import ModalSource
from rotorsim.diagnosis.evidence.scoring import Held, predict
from rotorsim.diagnosis.evidence.waveform.data import TimeRun, read_run
from rotorsim.diagnosis.evidence.waveform.search import TimeSearch
from rotorsim.diagnosis.evidence.waveform.source import TimeSource
from rotorsim.diagnosis.evidence.waveform.views import WHOLE, views_of
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording
from rotorsim.report.comparison.harmonics import Comparison, PredictedRuns, predicted_runs
from rotorsim.report.comparison.samples import SampleComparison, Trace
from rotorsim.report.figures.orbits import orbits_figure
from rotorsim.report.figures.spectra import residuals_figure, spectra_figure
from rotorsim.report.figures.speed_curves import speed_curves_figure
from rotorsim.report.figures.traces import traces_figure
from rotorsim.report.style import BLUE, RED, Look

__all__ = ["Compared", "Drawn", "OfHarmonics", "OfResonances", "OfSamples", "before_and_after_figure", "compared"]

GIVEN = Look("diagram as given", RED, "s", "--", 8.5)
REPAIRED = Look("repaired diagram", BLUE, "o", "-", 7.0)
HELD, FITTED = "hold-out runs", "fitted runs"
SPECTRA = (
    "Full spectra: what noise alone would give is grey; a residual (cross) below it is explained. Small marks, where "
    "there are any: asynchronous lines, at kX + nu."
)
ORBITS = "Motion that is synchronous with the shaft, over one turn; the arrow shows its direction."
CURVES = (
    "Amplitude and phase against shaft angle zero over speed, for each set of settings; thin lines: beyond the "
    "hold-out speeds."
)


class Drawn(NamedTuple):
    """A figure with its name and caption; None where there is nothing to show."""

    name: str
    figure: Figure | None
    caption: str


class Measured(Protocol):
    """What the report asks of the evidence of a diagnosis, whatever its kind."""

    @property
    def recording(self) -> Recording:
        """The recording that was fitted."""

    @property
    def recorded(self) -> list[str]:
        """The flat names of the recorded signals."""

    def load(self, document: Mapping[str, Any]) -> Diagram:
        """Return the diagram of a document. Raises RotorsimError."""


class Compared(Protocol):
    """Both diagrams beside what was measured, as the evidence of a diagnosis allows it."""

    @property
    def source(self) -> Measured:
        """What was measured."""

    @property
    def speeds(self) -> Sequence[float]:
        """The speeds of the fitted runs [rad/s]; none of a machine that does not turn."""

    def figures(self) -> Iterator[Drawn]:
        """Return figures of both diagrams beside hold-out runs, beside fitted ones without any."""

    def residuals(self) -> Drawn | None:
        """Return the figure of residuals in units of independent noise; None where it is not independent."""


def compared(found: Diagnosis) -> Compared:
    """Return what a diagnosis compares; the only place that asks of which kind its evidence is."""
    source: Any = found.source
    if isinstance(source, TimeSource):
        return OfSamples(found, source)
    return OfResonances(source) if isinstance(source, ModalSource) else OfHarmonics(found, source)


def before_and_after_figure(found: Diagnosis) -> Figure:
    """Return both diagrams beside hold-out runs (fitted ones without any): over speed, or in time.

    Raises RotorsimError where there is nothing to draw.
    """
    figures = {drawn.name: drawn.figure for drawn in compared(found).figures() if drawn.figure is not None}
    for name in ("speed_curves", *figures):
        if name in figures:
            return figures[name]
    hint = "a recording of a turning shaft, or in time, of a diagram that can be simulated"
    raise RotorsimError(Problem("nothing of this diagnosis can be drawn beside its recording", hint=hint))


def is_unchanged(found: Diagnosis) -> bool:
    """Return whether the diagram stayed as it was given."""
    return not found.effects and found.after is found.before


def looks_of(found: Diagnosis) -> tuple[Look, ...]:
    """Return how the diagram as given and the repaired one are called and drawn; one where nothing was changed."""
    if is_unchanged(found):
        return (replace(REPAIRED, label=GIVEN.label),)
    return GIVEN, replace(REPAIRED, label="nearest model") if found.verdict == "outside_catalogue" else REPAIRED


def _documents(found: Diagnosis) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    return values_in(found.before.document, found.before.values), found.document


# -- harmonics of a turning shaft --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OfHarmonics:
    """Diagrams beside harmonics of a turning shaft."""

    found: Diagnosis
    source: Source

    @property
    def speeds(self) -> Sequence[float]:
        """The speeds of the fitted runs [rad/s]."""
        return [item.fit.speed for item in self.source.harmonics]

    @cached_property
    def fitted(self) -> Comparison | None:
        """Both diagrams beside the runs that they were fitted to; None where neither has a settled motion."""
        parts = [self.source] if self.found.readings is None else [self.found.readings[0], self.source]
        return self._beside([Held(part.recording, part.harmonics) for part in parts], FITTED)

    @cached_property
    def held(self) -> Comparison | None:
        """Both diagrams beside the hold-out runs, the larger set of two; None without any."""
        sets = [self.found.held] if self.found.readings is None else [self.found.readings[1], self.found.held]
        parts = [max(some, key=lambda part: len(part.harmonics)) for some in sets if some]
        return self._beside(parts, HELD) if parts and parts[-1].harmonics else None

    def _beside(self, parts: Sequence[Held], of: str) -> Comparison | None:
        """Return both diagrams beside runs: as they are, or the first beside readings, where converters were found."""
        items = zip(looks_of(self.found), _documents(self.found), (parts[0], parts[-1]), strict=False)
        both = ((look, self._predicted(document, part)) for look, document, part in items)
        diagrams = tuple((look, runs) for look, runs in both if runs is not None)
        return Comparison(diagrams, of) if diagrams else None

    def _predicted(self, document: Mapping[str, Any], part: Held) -> PredictedRuns | None:
        try:
            with one_thread():
                prediction = predict(document, self.source, part)
        except (RotorsimError, ValueError, np.linalg.LinAlgError):
            return None
        experiment, Y = prediction.experiment, prediction.evaluation.Y
        return predicted_runs(experiment, experiment.theta0, Y) if np.isfinite(Y).any() else None

    def figures(self) -> Iterator[Drawn]:
        """Return spectra, orbits and curves over speed, beside hold-out runs or else fitted ones."""
        shown = self.held or self.fitted
        if shown is not None:
            yield Drawn("spectra", spectra_figure(shown), SPECTRA)
            yield Drawn("orbits", orbits_figure(shown), ORBITS)
            fitted = None if self.held is None else self.fitted
            yield Drawn("speed_curves", speed_curves_figure(shown, fitted), CURVES)

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

    found: Diagnosis
    source: TimeSource
    speeds: Sequence[float] = ()

    def figures(self) -> Iterator[Drawn]:
        """Return signals in time."""
        caption = "The stretch that the diagram as given explains least."
        yield Drawn("traces", traces_figure(self.comparison()), caption)

    def residuals(self) -> None:
        """Return nothing."""

    def comparison(self) -> SampleComparison:
        """Return both diagrams beside the signals of hold-out runs, of fitted ones without any."""
        source, held = self.source, self._held()
        runs, looks = held or source.runs, looks_of(self.found)
        units = {name: source.recording.channels[column].unit for name, column in source.channels.columns.items()}
        simulated = [
            _simulated(document, source, runs) for _, document in zip(looks, _documents(self.found), strict=False)
        ]
        traces = tuple(
            Trace(
                run.id,
                name,
                units.get(name, ""),
                run.start + run.dt * np.arange(run.size),
                run.values[name],
                tuple(None if one is None else one[r][:, c] for one in simulated),
            )
            for r, run in enumerate(runs)
            for c, name in enumerate(source.channels.outputs)
        )
        return SampleComparison(looks, traces, HELD if held else FITTED)

    def _held(self) -> Sequence[TimeRun]:
        if not self.found.held:
            return ()
        first, *others = self.found.held
        wanted = [*first.recording.select("hold_out"), *(run for part in others for run in part.recording.runs)]
        try:
            diagram = self.source.load(self.found.before.document)
            return [read_run(diagram, run, self.source.channels) for run in wanted]
        except RotorsimError:
            return ()


def _simulated(document: Mapping[str, Any], source: TimeSource, runs: Sequence[TimeRun]) -> list[np.ndarray] | None:
    """Return the outputs of a diagram in every run, (N, c), with the states at the first samples at their best."""
    try:
        view = views_of(source.load(document), source.channels)[0]
        weights = np.array([1 / source.variance[WHOLE, name] for name in view.outputs])
        with one_thread():
            search = TimeSearch([view], runs, [[weights] * len(runs)], least=source.least, hold="theta")
            evaluation = search.minimise(search.first())[1]
    except (RotorsimError, ValueError, KeyError, np.linalg.LinAlgError):
        return None
    if not np.isfinite(evaluation.cost):
        return None
    order = [view.outputs.index(name) for name in source.channels.outputs]
    return [
        (run.measured(view.outputs) - errors)[:, order] for run, errors in zip(runs, evaluation.errors[0], strict=True)
    ]


# -- resonances --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OfResonances:
    """Recorded resonances: nothing is drawn of them."""

    source: ModalSource
    speeds: Sequence[float] = ()

    def figures(self) -> Iterator[Drawn]:
        """Return nothing."""
        return iter(())

    def residuals(self) -> None:
        """Return nothing."""
