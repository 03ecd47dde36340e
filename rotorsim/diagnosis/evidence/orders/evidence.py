"""Evidence of order vectors over the speed: run-ups and coast-downs, compared with their order-tracked simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from scipy.stats import chi2

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.change import Change
from rotorsim.diagnosis.evidence.evidence import HeldScore, Terms
from rotorsim.diagnosis.evidence.fit import FAILURES, TO_THE_END, Effort, Fit, Starts, failed_fit, reason_of
from rotorsim.diagnosis.evidence.orders.fitting import covariance_of, fitted, promised, summary
from rotorsim.diagnosis.evidence.orders.noise import RowNoise, WhitenedSearch, noise_beside, plain, whitened_search
from rotorsim.diagnosis.evidence.orders.scoring import held_score, left_out_score, unpredicted
from rotorsim.diagnosis.evidence.orders.separation import best_change
from rotorsim.diagnosis.evidence.orders.whiteness import whiteness_of
from rotorsim.diagnosis.evidence.validated import Validated
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.noise import whitened
from rotorsim.identification.waveform.order_tracking import TrackedOrders, tracked_orders, vectors_of
from rotorsim.model.load import load
from rotorsim.recordings.orders import OrderChannel, OrderRecording, OrderRun
from rotorsim.units import conversion

LEAST_SPAN = 1.1  # highest speed of all rows, of the lowest: below, they are all at one speed
VAGUE = 0.5  # standard deviation of a parameter of the diagram, of its value: nothing is known of it
MEMORY_CHANGED = 0.1  # of the memory of noise, that asks for another weighing

ORDER_TERMS = Terms(
    noise="the noise from row to row",
    left_out="stretches of speed left out one by one",
    predicted="stretches left out",
    more_runs="run-ups through other speeds and at other accelerations, with a second probe at right angles",
    searched="no other speed, acceleration, probe or order",
)


@dataclass(frozen=True, eq=False)
class OrderEvidence(Validated):
    """Order vectors of the runs to identify from, and of hold-out runs, recording by recording.

    noise: of each channel. old: names of the parameters that were free at first. sizes: largest magnitude of signals.
    doubts: why something that is missing may not show, each with what would show it.
    """

    recording: OrderRecording
    runs: tuple[OrderRun, ...]
    folder: str | None
    trust_blocks: bool
    recorded: tuple[str, ...]
    noise: Mapping[str, RowNoise]
    old: frozenset[str]
    held: tuple[tuple[OrderRecording, tuple[OrderRun, ...]], ...] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)
    doubts: Mapping[str, str] = field(default_factory=dict)

    @property
    def unjudged(self) -> str:
        """Why something that is missing may not show; empty: it would."""
        return "; ".join(self.doubts)

    @property
    def terms(self) -> Terms:
        """How statements name it."""
        return ORDER_TERMS

    @property
    def alike(self) -> bool:
        """Whether all rows are at one speed."""
        every = np.concatenate([run.speed for run in self.runs])
        settings = {str(sorted(run.settings.items())) for run in self.runs}
        return bool(every.max() < LEAST_SPAN * every.min()) and len(settings) == 1

    def load(self, document: Mapping[str, Any]) -> Diagram:
        """Return the diagram of a document. Raises RotorsimError."""
        return load(document, folder=Path(self.folder) if self.folder else None, trust_blocks=self.trust_blocks)

    def largest(self) -> Mapping[str, float]:
        """Return the largest magnitude of signals by flat name, recorded or simulated."""
        return self.sizes

    # -- fits ----------------------------------------------------------------------------------------------------------

    def tracked(self, document: Mapping[str, Any]) -> TrackedOrders:
        """Return the runs beside a document. Raises RotorsimError."""
        diagram = self.load(document)
        return tracked_orders(diagram, self.recording, self.runs, diagram.free)

    def search(self, document: Mapping[str, Any]) -> WhitenedSearch:
        """Return the search for the free parameters of a document. Raises RotorsimError."""
        return whitened_search(self.tracked(document), self.noise)

    def as_it_is(self, document: Mapping[str, Any]) -> tuple[WhitenedSearch, Evaluation]:
        """Return a document as it is beside the runs, slow roll at its best. Raises RotorsimError."""
        search = self.search(document)
        evaluation = replace(search, hold="theta").minimise(search.first())
        return search, evaluation

    def fit(self, document: Mapping[str, Any], starts: Starts, effort: Effort = TO_THE_END) -> Fit:
        """Return the best fit of a diagram from those starts that promise most; see `fitted`."""
        began = process_time()
        try:
            fit = fitted(document, self.search(document), self.noise, starts, effort, self.old)
        except FAILURES as error:
            fit = failed_fit(document, error)
        return replace(fit, seconds=process_time() - began)

    def promise(self, document: Mapping[str, Any], starts: Starts) -> float:
        """Return the misfit that the sensitivities at the best start promise."""
        try:
            return promised(self.search(document), starts, self.old)
        except FAILURES:
            return np.inf

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the whitened residual of a diagram as it is, None where it diverges."""
        try:
            search, evaluation = self.as_it_is(document)
        except FAILURES:
            return None
        if not np.isfinite(evaluation.cost):
            return None
        runs = [(r, 0, len(y)) for r, y in enumerate(search.measured[0])]
        return np.concatenate(whitened(search, evaluation, runs))

    # -- noise ---------------------------------------------------------------------------------------------------------

    def recalibrated(self, fit: Fit) -> OrderEvidence | None:
        """Return the evidence with the noise beside a fit; None where it is much the same."""
        search, evaluation = self.as_it_is(values_in(fit.document, fit.values))
        if not np.isfinite(evaluation.cost):
            return None
        noise = noise_beside(search, evaluation)
        ratios = [one.variance / self.noise[label].variance for label, one in noise.items()]
        memory = [abs(one.memory - self.noise[label].memory) for label, one in noise.items()]
        rows = [one.rows / self.noise[label].rows for label, one in noise.items()]
        alike = all(1 / CRITERIA.slight <= ratio <= CRITERIA.slight for ratio in (*ratios, *rows))
        return None if alike and max(memory) <= MEMORY_CHANGED else replace(self, noise=noise)

    def at(self, fit: Fit) -> Fit:
        """Return a fit to the evidence before recalibration as this one judges it, at the same parameters."""
        search, evaluation = self.as_it_is(values_in(fit.document, fit.values))
        return replace(summary(fit.document, search, evaluation, self.noise), seconds=fit.seconds)

    def structure(self, fit: Fit) -> float:
        """Return the share of what a fit leaves that one row tells of another, 0 where that may be chance or is small.

        As part of the variance of the noise: what is below it, as the errors of a simulation are, is none.
        """
        if fit.failure:
            return 0.0
        _, evaluation = self.as_it_is(values_in(fit.document, fit.values))
        found = 0.0
        for c, label in enumerate(self.noise):
            left = [part[:, 2 * c] + 1j * part[:, 2 * c + 1] for part in evaluation.residuals[0]]
            probability, share = whiteness_of(left)
            square = np.nanmean(np.concatenate([np.abs(part) ** 2 for part in left])) / 2
            large = share * square > (CRITERIA.model_error - 1) * self.noise[label].variance
            if probability < CRITERIA.not_explained and large:
                found = max(found, share)
        return found

    # -- validation ----------------------------------------------------------------------------------------------------

    def scored(self, document: Mapping[str, Any]) -> HeldScore:
        """Return the score of a document on hold-out runs, or on stretches of speed left out."""
        try:
            search, at = self.as_it_is(document)
            if not self.held:
                return left_out_score(search, at, self.noise)
            return held_score(search, self.held_tracks(document), at, self.noise)
        except FAILURES as error:
            return unpredicted(reason_of(error))

    def held_tracks(self, document: Mapping[str, Any]) -> list[TrackedOrders]:
        """Return hold-out runs beside a document. Raises RotorsimError."""
        diagram = self.load(document)
        return [tracked_orders(diagram, recording, runs, diagram.free) for recording, runs in self.held]

    def runs_of(self, fit: Fit) -> Sequence[tuple[float, float]] | None:
        """Return misfit and equations of each hold-out run, or of each stretch when it is predicted from the others."""
        found = self.score(fit)
        return found.runs or None

    def least(self, item: Insertion, without: Fit) -> None:
        """Return None: no free vectors at a place are looked for."""

    def is_force(self, fit: Fit) -> bool:
        """Return False: a small residual is not asked whether a force makes it."""
        return False

    def residual_place(self, base: Fit, after: Fit) -> None:
        """Return None: no place is looked for without a law."""

    # -- words ---------------------------------------------------------------------------------------------------------

    def separation(self, first: Fit, second: Fit) -> Change | None:
        """Return the further run-up, probe or order that separates two hypotheses most; see `best_change`."""
        diagrams = [self.load(values_in(fit.document, fit.values)) for fit in (first, second)]
        return best_change((first, second), diagrams, self.recording, self.runs, self.noise)

    @property
    def shown(self) -> list[tuple[OrderRun, Mapping[str, OrderChannel]]]:
        """The hold-out runs, without any the fitted ones, each with its columns in one order of channels."""
        sets = self.held or ((self.recording, self.runs),)
        return [(run, recording.channels) for recording, runs in sets for run in runs]

    def vectors(self, document: Mapping[str, Any]) -> list[np.ndarray] | None:
        """Return the order vectors of a document as it is in the runs that are shown, (n, c); None if it diverges."""
        try:
            _, at = self.as_it_is(document)
            tracks = self.held_tracks(document) if self.held else [self.tracked(document)]
            searches = [plain(whitened_search(tracked, self.noise)) for tracked in tracks]
        except FAILURES:
            return None
        found = [one for other in searches for one in vectors_of(other, at)]
        return found if all(np.isfinite(one).all() for one in found) else None

    def left_over(self, document: Mapping[str, Any]) -> list[np.ndarray] | None:
        """Return what a document as it is leaves of each fitted run, whitened, (n, c); None if it diverges."""
        try:
            _, at = self.as_it_is(document)
        except FAILURES:
            return None
        if not np.isfinite(at.cost):
            return None
        deviation = np.sqrt([one.variance for one in self.noise.values()])
        return [(part[:, ::2] + 1j * part[:, 1::2]) / deviation for part in at.residuals[0]]

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return what counts as noise, slow roll, and what these channels do not show whatever the diagram is."""
        channels = [*self.recording.channels.values()]
        keeps = {
            label: f", of which a row keeps {one.memory:.2g} of the one before" if one.memory else ""
            for label, one in self.noise.items()
        }
        said = [
            f"{_in_unit(self.noise[one.label].std, one.unit)} in a part of {one.label}{keeps[one.label]}"
            for one in channels
        ]
        across = _across(channels)
        text = [] if not across or (across in self.doubts and not inserted) else [f"{across[0].upper()}{across[1:]}."]
        if all(one.order == 1 for one in channels):
            text.append("Of orders other than 1X nothing was measured.")
        return [f"Noise: {'; '.join(said)}.", *self._slow_roll(after), *text]

    def _slow_roll(self, fit: Fit) -> list[str]:
        """Return how large the constant vectors of the channels are, where they are in the data."""
        if not self.recording.slow_roll or fit.failure:
            return []
        search, at = self.as_it_is(values_in(fit.document, fit.values))
        std = np.sqrt(np.diag(covariance_of(search, at)))[search.m :]
        parts = at.unknowns[search.m :]
        said = []
        for c, channel in enumerate(self.recording.channels.values()):
            vector, off = complex(parts[2 * c], parts[2 * c + 1]), float(std[2 * c : 2 * c + 2].max())
            if abs(vector) > CRITERIA.significant * off:
                size, angle = _in_unit(abs(vector), channel.unit), np.degrees(np.angle(vector))
                said.append(f"{size} at {angle:.0f} deg of {channel.label}")
        if not said:
            return []
        return [f"Slow roll was fitted along: {', '.join(said)}: run-out, or a bow, which it would take up."]

    def open_questions(self) -> str:
        """Return what would let a diagram be judged that these rows cannot judge."""
        return "; ".join(f"{wanted}: {why}" for why, wanted in self.doubts.items())


def _in_unit(value: float, unit: str) -> str:
    """Return an SI value in a recorded unit."""
    return f"{value / conversion(unit, None):.2g} {unit}"


def _across(channels: Sequence[OrderChannel]) -> str:
    """Return what probes along one axis do not show; empty where every probe has one across."""
    axes = {(one.signal, one.node, one.axis) for one in channels}
    alone = [
        one.name
        for one in channels
        if one.axis and (one.signal, one.node, {"x": "y", "y": "x"}.get(one.axis)) not in axes
    ]
    names = ", ".join(dict.fromkeys(alone))
    return f"across {names} nothing was measured, and planes that differ, or whirl, show only in part" if alone else ""


def doubts_of(evidence: OrderEvidence, base: Fit) -> dict[str, str]:
    """Return why something that is missing may not show beside a fit, each with what would show it.

    Few rows: a law of `Criteria.law_parameters` makes the misfit fall by its chi-squared quantile by chance, and a
    share s of the noise in n real numbers by n s: as many are needed that the share beyond `Criteria.slight` shows.
    Loose parameters stand for what is missing; so do free ones for what one probe sees of planes that differ.
    """
    found = {}
    share = 1 - 1 / CRITERIA.slight
    least = int(np.ceil(chi2.isf(CRITERIA.false_alarm, CRITERIA.law_parameters) / share / 2))
    tracked = evidence.tracked(base.document)
    for c, label in enumerate(tracked.labels):
        every = np.concatenate([track.vectors[:, c] for track in tracked.tracks])
        count = int(np.isfinite(every).sum())
        if count < least:
            why = f"{count} rows of {label} are too few to tell structure from noise: {least} are needed"
            found[why] = "rows at every turn, from slow roll to beyond a critical speed"
    loose = [
        item.name
        for j, item in enumerate(base.free)
        if item.unit != ANGLE_UNIT and item.prior_std is None and base.std(j) > VAGUE * abs(base.theta[j])
    ]
    if loose:
        verb = "is" if len(loose) == 1 else "are"
        why = f"{', '.join(loose)} {verb} not determined, and may stand for what is missing"
        found[why] = "rows at every turn through a critical speed, or those parameters as known"
    across = _across([*evidence.recording.channels.values()])
    if across:
        found[across] = "a second probe at right angles"
    return found
