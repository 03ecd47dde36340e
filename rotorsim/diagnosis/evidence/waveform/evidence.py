"""Evidence of samples in time: runs that a diagram is driven through, compared with its simulation.

What counts as noise, and what is adequate: `rotorsim.identification.waveform.noise`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import isclose
from operator import attrgetter
from typing import Any, Self

import numpy as np

from rotorsim.criteria import CRITERIA, Z90
from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot
from rotorsim.diagnosis.catalogue.values import value_at, values_in
from rotorsim.diagnosis.evidence.change import Change
from rotorsim.diagnosis.evidence.evidence import Defaults, Score, Terms
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit, is_adequate, reason_of
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass
from rotorsim.diagnosis.evidence.waveform.fits import WaveformFits
from rotorsim.diagnosis.evidence.waveform.laws import LawBounds
from rotorsim.diagnosis.evidence.waveform.missing import Linearised, missing_signal
from rotorsim.diagnosis.evidence.waveform.scoring import held_score, left_out_score
from rotorsim.diagnosis.evidence.waveform.separation import Hypothesis, SensorNoise, best_change, sensors_of
from rotorsim.diagnosis.evidence.waveform.units import stand_ins
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.advice_in_time import SMALL_NOISE
from rotorsim.identification.waveform.evaluation import Evaluation, Label
from rotorsim.identification.waveform.linearised import linearised, places_of, simulated_signals, simulated_states
from rotorsim.identification.waveform.noise import Noise, left_over, reweighted, unpredicted, variance_scale, weights_of
from rotorsim.identification.waveform.noise_model import refined
from rotorsim.identification.waveform.search import REFIT_EVALUATIONS, SIMULATION_SUBSTEPS, OutputErrorSearch
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM

SHORTER = 4  # times is a law approximated more nearly at once: errors, of first order at jumps, fall as that rises
TRACKED = 2  # times that a nonlinear diagram is linearised anew, about the motion that was measured

WAVEFORM_TERMS = Terms(
    left_out="stretches left out one by one",
    predicted="stretches left out",
    searched="no amplitude of its inputs, further sensor or repeated run",
    turns=False,
)


@dataclass(frozen=True, eq=False)
class WaveformEvidence(WaveformFits, Defaults):
    """Runs in time as evidence."""

    independent = False

    @property
    def terms(self) -> Terms:
        """How statements name it; more runs are those with other amplitudes of its inputs."""
        inputs = " and ".join(self.channels.inputs) or "what drives it"
        more_runs = f"runs with {inputs} at 0.5 and at 2 times the amplitude"
        return replace(WAVEFORM_TERMS, more_runs=more_runs, driven=f"with {inputs} so large")

    def recalibrated(self, fit: Fit) -> WaveformEvidence | None:
        """Return the evidence whose noise is what is not predictable beside a fit; None where it is much the same.

        Its steps are those that the fit needs.
        """
        if self.by_force and fit.misfit >= CRITERIA.surpassed * fit.freedom:
            return None
        beside = _beside(self, fit)
        if beside is None:
            return None
        beginning = max(self._beginning(fit), self.beginning)
        if self.by_force:
            noise, most = left_over(*beside, self.stretches), CRITERIA.no_worse**2
        else:
            noise, most = _unpredicted(self, fit), CRITERIA.model_error
            ratio = [value / self.variance[signal] for signal, value in noise.variance.items()]
            alike = min(ratio) >= 1 / CRITERIA.slight and max(ratio) <= CRITERIA.slight
            if alike and beside[0].least == self.steps(fit.document) and beginning == self.beginning:
                return None
        changed = self.in_steps(fit.document, beside[0].least)
        left = most * noise.left
        return replace(changed, variance=noise.variance, rows=noise.rows, allowed=left, beginning=beginning)

    def where_it_shows(self, fit: Fit) -> Self:
        """Return the evidence that looks at all of the runs where their beginning does not show what a fit leaves."""
        return replace(self, beginning=self._beginning(fit))

    def structure(self, fit: Fit) -> float:
        """Return the share of what a fit leaves that a black box predicts, 0 where that may be chance."""
        return 0.0 if fit.failure or _beside(self, fit) is None else _unpredicted(self, fit).structure

    def unexplained(self, fit: Fit) -> float:
        """Return that share; 0, too, where noise is what a flexible force leaves: it explains details of any law."""
        return 0.0 if self.by_force else self.structure(fit)

    def at(self, fit: Fit) -> Fit:
        """Return a fit to the evidence before recalibration as this one judges it, at the same parameters."""
        search = replace(self.search(values_in(fit.document, fit.values)), hold="theta")
        evaluation = search.minimise(self.first_point(search, fit))
        return replace(self._summary(fit.document, search, evaluation), free=fit.free, seconds=fit.seconds)

    def bounds(self, fit: Fit, better: Fit | None = None) -> LawBounds | None:
        """Return what the laws of signals promise beside a fit; None where its diagram has no scalar signals.

        Beside parameters as fitted or as stated: of these, where a free signal explains more. A fit without what is
        missing may have gone anywhere; better: beside the parameters and starts of one that explains more.
        """
        document = values_in(fit.document, fit.values)
        if better is not None:
            return self._bounds_beside(document, better)
        points = ({},) if is_adequate(fit) else ({}, self.stated)
        found: list[LawBounds] = []
        for moved in points:
            here = self._linearised(values_in(document, moved))
            found += [] if here is None else [self._law_bounds(here.about_the_motion(TRACKED), moved)]
        return min(found, key=attrgetter("deviance"), default=None)

    def _bounds_beside(self, document: Mapping[str, Any], better: Fit) -> LawBounds | None:
        """Return what laws promise beside the parameters of a fit that explains more, and about its motion."""
        moved = {name: value for name, value in better.values.items() if name in document.get("identify", {})}
        search, evaluation, starts = self._starts(values_in(better.document, better.values))
        here = self._linearised(values_in(document, moved), starts)
        if here is None or not np.isfinite(evaluation.cost):
            return None
        readings = {"measured": document["measured"]} if "measured" in document else {}  # a further one is no motion
        unread = {key: value for key, value in better.document.items() if key != "measured"}
        right = self.load({**unread, **readings})
        if not all(run.constant for run in here.runs):
            here = here.about(simulated_states(right, search, evaluation))
        ports = [*dict.fromkeys(place.port for place in here.places)]
        column = [ports.index(place.port) for place in here.places]
        motion = [values[:, column] for values in simulated_signals(right, search, evaluation, ports)]
        return self._law_bounds(here, moved, motion)

    def _starts(self, document: Mapping[str, Any]) -> tuple[OutputErrorSearch, Evaluation, dict[Label, float]]:
        """Return the search of a document, its evaluation, and where the runs begin best."""
        search = self._held(document)
        evaluation = search.minimise(self.first_point(search), REFIT_EVALUATIONS)
        return search, evaluation, search.starts(evaluation.unknowns)

    def _law_bounds(
        self, here: Linearised, moved: Mapping[str, float], motion: Sequence[np.ndarray] | None = None
    ) -> LawBounds:
        """Return what laws promise along linearised runs; moved: what is not as fitted; motion: if known."""
        variance, sampled = here.noise**2, here.sampled
        weight = self.rows / sum(run.size for run in sampled) / len(self.variance)  # as if these samples were all
        roots = np.sqrt(weight / variance)
        return LawBounds(
            here.runs, sampled, here.places, here.unknown(), moved, roots, self.largest(), self.load, motion
        )

    def _linearised(
        self, document: Mapping[str, Any], starts: Mapping[Label, float] | None = None
    ) -> Linearised | None:
        """Return a document along the beginning of the runs; None where it diverges, or no signal is one number.

        starts: where the runs begin (default: where they fit best).
        """
        diagram, search = self.load(document), self._held(document)
        places = places_of(diagram, self.channels.outputs)
        if starts is None:
            evaluation = search.minimise(self.first_point(search))
        else:
            first = search.first(starts)
            evaluation = search.evaluate(first, search.substeps(first))
        if not places or not np.isfinite(evaluation.cost):
            return None
        runs = linearised(diagram, search, evaluation, places)
        variance = [self.variance[WHOLE_DIAGRAM, name] for name in search.systems[0].equations.outputs]
        return Linearised(diagram, search, evaluation, places, runs, np.sqrt(variance))

    def missing_signal(
        self, without: Fit, after: Fit, effect: Insertion | None, spot: Spot, classes: Sequence[PlaceClass]
    ) -> MissingSignal | None:
        """Return the signal that a diagram without an effect lacks at a place, as all outputs show it.

        Beside an effect the other parameters are those of the repaired diagram, so that the signal is what its law
        stands for; without one, or where the diagram diverges so, they are free.
        """
        try:
            if effect is not None:
                document = values_in(after.document, after.values)
                search, evaluation, starts = self._starts(document)
                beside = values_in(without.document, {**without.values, **after.values})
                here = self._linearised(beside, starts)
                if here is not None and not all(run.constant for run in here.runs):
                    here = self._linearised(beside)
                if here is not None and np.isfinite(evaluation.cost):
                    unread = {key: value for key, value in document.items() if key != "measured"}
                    repaired = self.load(unread), search, evaluation  # signals are those before any reading
                    return missing_signal(here, repaired, effect, spot, classes, self._unit_of(here.diagram))
            here = self._linearised(values_in(without.document, without.values))
            if here is None:
                return None
            return missing_signal(here, None, effect, spot, classes, self._unit_of(here.diagram))
        except FAILURES:
            return None

    def separation(self, first: Fit, second: Fit) -> Change | None:
        """Return the amplitude, sensor or repeated run that separates two hypotheses most; see `best_change`."""
        documents = [values_in(fit.document, fit.values) for fit in (first, second)]
        diagrams = [self.load(document) for document in documents]
        outputs = self.channels.outputs
        signals = [*outputs, *sensors_of(diagrams, self.sizes, self.recorded)]
        pair = []
        for fit, document, diagram in zip((first, second), documents, diagrams, strict=True):
            search = self._held(document)
            evaluation = search.minimise(self.first_point(search), REFIT_EVALUATIONS)
            pair.append(Hypothesis.of(fit, diagram, search, evaluation, signals))
        of_sample = weights_of(self.variance, self.runs, self.rows)
        longer = sum(run.size for run in self.runs) / sum(run.size for run in pair[0].whole.runs)  # than what is shown
        weights = longer * np.array([of_sample[WHOLE_DIAGRAM, name] for name in outputs])
        largest = np.array([self.sizes.get(name, np.inf) for name in outputs])
        variance = np.array([self.variance[WHOLE_DIAGRAM, name] for name in outputs])
        spread = [np.nanstd(np.concatenate([run.values[name] for run in self.runs])) for name in outputs]
        part = max(float(np.median(np.sqrt(variance) / spread)), SMALL_NOISE)
        noise = SensorNoise(part, float(np.median(weights * variance)) / part**2)
        return best_change((pair[0], pair[1]), self.channels.inputs, signals, weights, largest, noise)

    def _unit_of(self, diagram: Diagram) -> Callable[[str], str | None]:
        """Return what tells the unit of a signal: as recorded, or as its port or one behind it declares; else None."""
        nodes = diagram.nodes
        taken = {str(wire.source): nodes[wire.target.block].inputs[wire.target.port].unit for wire in diagram.wires}
        own = {str(port): port.unit for node in nodes.values() for port in node.outputs.values() if port.unit}
        declared = {**taken, **own}
        recorded = {name: unit or "1" for name, unit in self.units.items()}
        return lambda name: recorded.get(name) or declared.get(name) or ("s" if name == "time" else None)

    def score(self, fit: Fit) -> Score:
        """Return the errors of a fit on hold-out runs, or on stretches left out one by one."""
        document = values_in(fit.document, fit.values)
        try:
            if self.held:
                return held_score(*self.beside(document, self.held), self.variance, self.units)
            search = self.search(document)
            return left_out_score(search, self.first_point(search, fit), self.variance, self.units)
        except FAILURES as error:
            return Score({"": float("nan")}, {}, reason=reason_of(error))

    @property
    def units(self) -> dict[str, str]:
        """The recorded unit of every signal, empty for pure numbers."""
        units = {name: self.recording.channels[column].unit for name, column in self.channels.columns.items()}
        return {name: "" if unit == "1" else unit for name, unit in units.items()}

    def finished(self, fit: Fit, chosen: Sequence[Insertion]) -> Fit:
        """Return the fit with what the faults state once (the width of a step) free as well, if that explains more.

        What the data then leave open (the width of a step between two samples) stays as found; as stated, where it
        leaves open what was known (the time of such a step).
        """
        fixed = [name for item in chosen for name in item.stated_once]
        if not fixed:
            return fit
        document = values_in(fit.document, fit.values)
        document["identify"] = {**document.get("identify", {}), **{name: {} for name in fixed}}
        freed = self.fit(document, [[{}]])
        open_ones = _open(freed) & {*fixed}
        if open_ones:
            document = values_in(freed.document, freed.values)
            document["identify"] = {k: v for k, v in document["identify"].items() if k not in open_ones}
            freed = self.fit(document, [[{}]])
        better = not freed.failure and freed.criterion < fit.criterion
        ended = {item.name for item, end in zip(freed.free, freed.at_bound, strict=True) if end}
        return freed if better and not ended & {*fixed} and _open(freed) <= _open(fit) else fit

    def sharpened(self, fit: Fit, chosen: Sequence[Insertion]) -> tuple[WaveformEvidence, Fit]:
        """Return the fit with shorter times by which its laws are approximated, until that no longer shows.

        While the misfit falls by more than 1, which is what one parameter makes that is off by one standard deviation;
        as it is, where shorter ones explain less. With the evidence that has enough steps between samples for them.
        """
        names, evidence = [name for item in chosen for name in item.smoothed], self
        while names and (steps := SHORTER * evidence.steps(fit.document)) <= SIMULATION_SUBSTEPS:
            before = values_in(fit.document, fit.values)
            times = {name: value_at(before, name) / SHORTER for name in names}
            finer = evidence.in_steps(fit.document, steps)
            sharper = finer.fit(values_in(before, times), [[{}]])
            if sharper.failure or sharper.misfit > fit.misfit + 1:
                break
            shows, evidence, fit = sharper.misfit < fit.misfit - 1, finer, sharper
            if not shows:
                break
        return evidence, fit

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return how well controllers follow from measured motion alone, what is too small to be looked for, and more.

        That is structure that is left, runs in which laws are taken beyond where they are defined, and units that stand
        for others in the blocks that are put in.
        """
        measured = {name: np.concatenate([run.values[name] for run in self.runs]) for name in self.channels.outputs}
        text = [
            f"{name} follows from the measured motion by the law of {controller} to "
            f"{100 * np.sqrt(value) / measured[name].std():.2g} %."
            for (controller, name), value in self.variance.items()
            if controller
        ]
        if not inserted and (limited := self._limited_by_resolution(after)):
            part, names = f"{100 * CRITERIA.resolution:g} % of the rms", ", ".join(limited)
            text.append(f"Of {names} {part} counts as noise: smaller effects are not looked for.")
        share = self.unexplained(after) if inserted else 0.0
        if share:
            text.append(f"What the repaired diagram leaves is not noise: {100 * share:.2g} % of it can be predicted.")
        if lost := self._undefined(after):
            text.append(
                f"In {', '.join(lost)} it takes the root or the logarithm of a number below zero, as of a tank that "
                "runs empty. Here it is that of zero; a run of the diagram stops there: put a max with 0 in front."
            )
        units = {name.partition("[")[0]: self.recording.channels[c].unit for name, c in self.channels.columns.items()}
        return [*text, *stand_ins(self.load(after.document), inserted, units)]

    def _limited_by_resolution(self, fit: Fit) -> list[str]:
        """Return the outputs of which ``Criteria.resolution`` counts as noise: less than that is left of them."""
        scale = variance_scale(self.search(values_in(fit.document, fit.values)))
        least = {name: CRITERIA.resolution**2 * scale[WHOLE_DIAGRAM, name] for name in self.channels.outputs}
        noise = {name: self.variance[WHOLE_DIAGRAM, name] for name in least}
        return [name for name, floor in least.items() if isclose(noise[name], floor)]

    def _undefined(self, fit: Fit) -> list[str]:
        """Return the runs, hold-out too, that a fitted diagram gets through only as laws go on where they end."""
        runs = (*self.runs, *self.held)
        document = values_in(fit.document, fit.values)
        if not self.simulation(document, runs).continued:
            return []
        search, found = self.beside(document, runs)
        as_given = replace(search, continued=False)
        outputs = (as_given.simulated(found.unknowns, 0, r, found.sub, False)[0] for r in range(len(runs)))
        return [run.id for run, y in zip(runs, outputs, strict=True) if not np.isfinite(y).all()]


def _open(fit: Fit) -> set[str]:
    """Return the parameters whose 90 % interval holds zero."""
    return {name for j, (name, value) in enumerate(fit.values.items()) if abs(value) <= Z90 * fit.std(j)}


@lru_cache(maxsize=2)  # of each fit it is asked for the noise, for the verdict and for the report
def _beside(evidence: WaveformEvidence, fit: Fit) -> tuple[OutputErrorSearch, Evaluation] | None:
    """Return the search and the evaluation of a fit, whose weights follow what it leaves; None if it diverges."""
    search = evidence.search(values_in(fit.document, fit.values))
    search, evaluation = reweighted(search, evidence.first_point(search, fit))
    if not np.isfinite(evaluation.cost):
        return None
    if evidence.parts:
        return search, evaluation
    return refined(search, evaluation, variance_scale(search))  # what was missing may be faster than the rest


@lru_cache(maxsize=2)
def _unpredicted(evidence: WaveformEvidence, fit: Fit) -> Noise:
    """Return what no black box predicts beside a fit that does not diverge."""
    beside = _beside(evidence, fit)
    assert beside is not None
    return unpredicted(evidence.load(values_in(fit.document, fit.values)), *beside, evidence.stretches)
