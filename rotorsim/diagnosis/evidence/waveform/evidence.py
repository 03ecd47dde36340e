"""Evidence of samples in time: runs that a diagram is driven through, compared with its simulation.

What counts as noise, and what is adequate: `rotorsim.identification.waveform.noise`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Defaults, Score, Terms
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit, Starts, reason_of
from rotorsim.diagnosis.evidence.waveform.laws import LawBounds
from rotorsim.diagnosis.evidence.waveform.runs import SampledRuns
from rotorsim.diagnosis.evidence.waveform.scoring import held_score, left_out_score
from rotorsim.diagram.diagram import Diagram, Port
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.left_out import left_out
from rotorsim.identification.waveform.data import SampledRun
from rotorsim.identification.waveform.linearised import linearised, places_of
from rotorsim.identification.waveform.noise import (
    Noise,
    Stretch,
    Variance,
    block_misfit,
    goodness_left_out,
    left_over,
    reweighted,
    robust_covariance,
    stacked,
    unpredicted,
    weights_of,
)
from rotorsim.identification.waveform.search import MOST_SIMULATIONS, Evaluation, Label, OutputErrorSearch
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM, subsystems_of
from rotorsim.identification.waveform.unknown_input import UnknownInputs
from rotorsim.units import compatible

FIRST_STEPS = 4  # from each start, before the best is followed
SHORT = 8192  # samples of all runs on which a start is chosen and followed
LAST_STEPS = 12  # on all samples after that
FEW_STEPS = 3  # on all samples, of runs that are long, until it is known which fits are worth more
FOLLOWED, MOST_STARTS = 3, 9  # starts of a law that are followed and tried, on parts of such runs
REFINED_EVALUATIONS = 4  # for one that is asked for: they are cheap
WAVEFORM_TERMS = Terms(
    left_out="stretches left out one by one",
    predicted="stretches left out",
    more_runs="runs at more amplitudes and frequencies of what drives it",
    another="another input, or a sensor elsewhere",
    turns=False,
)
TURNING_TERMS = Terms(
    left_out="stretches left out one by one", predicted="stretches left out", more_runs="runs through other speeds"
)
DIVERGES = "the simulation diverges"


@dataclass(frozen=True, eq=False)
class WaveformEvidence(SampledRuns, Defaults):
    """Runs in time, driven by their recorded inputs.

    sizes: largest magnitude of every signal, recorded or simulated. variance: what counts as noise. rows: independent
    samples. stretches: into which the runs are divided. allowed (B,): what an adequate model may leave of each when it
    is left out. by_force: whether noise is what a diagram with a flexible force leaves. least: steps between samples.
    starts: states at the first samples. old: names of the parameters that were free at first. held: hold-out runs.
    parts: of long runs, at all speeds, on which starts are chosen and followed; part_starts: their states at first
    samples. near: parameters of the diagram that leave least.
    """

    variance: Variance
    rows: int
    stretches: tuple[Stretch, ...]
    allowed: np.ndarray
    by_force: bool
    least: int
    starts: Mapping[Label, float]
    old: frozenset[str]
    held: tuple[SampledRun, ...]
    unjudged: str = ""
    parts: tuple[SampledRun, ...] = ()
    part_starts: Mapping[Label, float] = field(default_factory=dict)
    near: Mapping[str, float] = field(default_factory=dict)

    terms = WAVEFORM_TERMS
    independent = False

    def search(self, document: Mapping[str, Any]) -> OutputErrorSearch:
        """Return the search for the free parameters of a document. Raises RotorsimError."""
        diagram = self.load(document)
        systems = subsystems_of(diagram, self.channels)
        if [signal for system in systems for signal in system.signals] != list(self.variance):
            what = "its controllers can no longer be told from the rest by what was measured"
            raise RotorsimError(Problem(what, diagram.name))
        return OutputErrorSearch(systems, self.runs, weights_of(self.variance, self.runs, self.rows), self.least)

    def simulation(self, document: Mapping[str, Any], runs: Sequence[SampledRun]) -> OutputErrorSearch:
        """Return a document as it is beside some runs, of which only the starts are searched. Raises RotorsimError."""
        systems = subsystems_of(self.load(document), self.channels)[:1]
        weights = {signal: 1 / value for signal, value in self.variance.items()}
        return OutputErrorSearch(systems, runs, weights, self.least, hold="theta")

    def simulated(self, document: Mapping[str, Any], runs: Sequence[SampledRun]) -> list[np.ndarray] | None:
        """Return the outputs of a document as it is in every run, (N, c), from the best starts; None if it diverges."""
        try:
            search = self.simulation(document, runs)
            evaluation = search.minimise(search.first())
        except (*FAILURES, KeyError):
            return None
        if not np.isfinite(evaluation.cost):
            return None
        outputs = search.systems[0].equations.outputs
        order = [outputs.index(name) for name in self.channels.outputs]
        pairs = zip(search.measured[0], evaluation.residuals[0], strict=True)
        return [(measured - residual)[:, order] for measured, residual in pairs]

    def _fit(self, document: Mapping[str, Any], starts: Starts, most: int | None) -> Fit:
        """Follow the best of each group on the beginning of the runs, then the best of these on all samples."""
        limit = MOST_SIMULATIONS if most is None else REFINED_EVALUATIONS * most
        search = self.search(document)
        short, first = self._short(search)
        tried = [self._followed(short, first, group) for group in starts or [[{}, self.near]]]
        ends = [short.minimise(min(group, key=attrgetter("cost")).unknowns, limit) for group in tried if group]
        if not ends:
            return Fit(document, failure=DIVERGES)
        start = min(ends, key=attrgetter("cost")).unknowns
        last = limit if short is search else min(limit, LAST_STEPS)
        if self.parts:
            start = np.concatenate([start[: search.m], search.first(self.starts)[search.m :]])
            last = LAST_STEPS if most is None else FEW_STEPS
        return self._summary(document, search, search.minimise(start, last))

    def _short(self, search: OutputErrorSearch) -> tuple[OutputErrorSearch, np.ndarray]:
        """Return a search on less of the runs, and its unknowns as the diagram states them."""
        if not self.parts:
            return search.shortened(SHORT), search.first(self.starts)
        weights = weights_of(self.variance, self.parts, self.rows)
        short = replace(search, runs=self.parts, weights=weights)
        return short, short.first(self.part_starts)

    def recalibrated(self, fit: Fit) -> WaveformEvidence | None:
        """Return the evidence whose noise is what is not predictable beside a fit; None where it is much the same."""
        if self.by_force and fit.misfit >= CRITERIA.surpassed * fit.freedom:
            return None
        beside = self._beside(fit)
        if beside is None:
            return None
        if self.by_force:
            noise = left_over(*beside, self.stretches)
            return replace(self, variance=noise.variance, rows=noise.rows, allowed=CRITERIA.no_worse**2 * noise.left)
        noise = self._unpredicted(fit, *beside)
        ratio = [value / self.variance[signal] for signal, value in noise.variance.items()]
        if min(ratio) >= 1 / CRITERIA.slight and max(ratio) <= CRITERIA.slight:
            return None
        return replace(self, variance=noise.variance, rows=noise.rows, allowed=CRITERIA.model_error * noise.left)

    def _beside(self, fit: Fit) -> tuple[OutputErrorSearch, Evaluation] | None:
        """Return the search and the evaluation of a fit, whose weights follow what it leaves; None if it diverges."""
        search = self.search(values_in(fit.document, fit.values))
        search, evaluation = reweighted(search, search.first(self.starts))
        return (search, evaluation) if np.isfinite(evaluation.cost) else None

    def _unpredicted(self, fit: Fit, search: OutputErrorSearch, evaluation: Evaluation) -> Noise:
        """Return what no black box predicts beside a fit."""
        return unpredicted(self.load(values_in(fit.document, fit.values)), search, evaluation, self.stretches)

    def structure(self, fit: Fit) -> float:
        """Return the share of what a fit leaves that a black box predicts, 0 where that may be chance."""
        beside = None if fit.failure else self._beside(fit)
        return 0.0 if beside is None else self._unpredicted(fit, *beside).structure

    def at(self, fit: Fit) -> Fit:
        """Return a fit to the evidence before recalibration as this one judges it, at the same parameters."""
        search = replace(self.search(values_in(fit.document, fit.values)), hold="theta")
        evaluation = search.minimise(search.first(self.starts))
        return replace(self._summary(fit.document, search, evaluation), seconds=fit.seconds)

    def bounds(self, fit: Fit) -> LawBounds | None:
        """Return what the laws of signals promise beside a fit; None where its diagram has no scalar signals."""
        document = values_in(fit.document, fit.values)
        diagram, whole = self.load(document), replace(self.search(document), hold="theta")
        whole = replace(whole, systems=whole.systems[:1]).shortened(SHORT)
        places = places_of(diagram, self.channels.outputs)
        evaluation = whole.minimise(whole.first(self.starts))
        if not places or not np.isfinite(evaluation.cost):
            return None
        runs = linearised(diagram, whole, evaluation, places)
        variance = np.array([self.variance[WHOLE_DIAGRAM, name] for name in whole.systems[0].equations.outputs])
        weight = self.rows / sum(run.size for run in whole.runs) / len(self.variance)  # as if these samples were all
        unknown = UnknownInputs(runs, np.sqrt(variance))
        return LawBounds(runs, whole.runs, places, unknown, np.sqrt(weight / variance), self.sizes, self.load)

    def promise(self, document: Mapping[str, Any], starts: Starts) -> float:
        """Return the misfit after FIRST_STEPS steps from the best start, per sample as on all samples."""
        group = starts[0] if starts else []
        try:
            short, first = self._short(self.search(document))
            if self.parts:
                return self._by_tangent(short, first, group)
            tried = self._followed(short, first, group)
        except FAILURES:
            return np.inf
        return min((evaluation.cost for evaluation in tried), default=np.inf)

    def _by_tangent(self, short: OutputErrorSearch, first: np.ndarray, group: Sequence[Mapping[str, float]]) -> float:
        """Return the misfit that the sensitivities at the best start promise: c - g^T H^-1 g."""
        some = group[:: -(-len(group) // FOLLOWED) or 1]
        points = [point for start in some if (point := short.started(first, start, self.old)) is not None]
        if not points:
            return np.inf
        sub = short.substeps(first)
        costs = [short.evaluate(point, sub, sensitivities=False).cost for point in points]
        here = short.evaluate(points[int(np.argmin(costs))], sub)
        if not np.isfinite(here.cost):
            return np.inf
        scale = np.sqrt(np.where(np.diag(here.information) > 0, np.diag(here.information), 1.0))
        g = here.gradient / scale
        return here.cost - float(g @ np.linalg.lstsq(here.information / np.outer(scale, scale), g, rcond=1e-12)[0])

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the weighted residual of a diagram as it is, starts of runs at their best; None where it diverges."""
        try:
            search = replace(self.search(document), hold="theta")
        except FAILURES:
            return None
        evaluation = search.minimise(search.first(self.starts))
        return stacked(search, evaluation, self.stretches)[0] if np.isfinite(evaluation.cost) else None

    def _followed(
        self, short: OutputErrorSearch, first: np.ndarray, group: Sequence[Mapping[str, float]]
    ) -> list[Evaluation]:
        """Return where a few steps lead from each start of a group; of many on parts of runs, from the best."""
        some = group[:: -(-len(group) // MOST_STARTS) or 1] if self.parts else group
        points = (short.started(first, start, self.old) for start in some)
        distinct = [*{point.tobytes(): point for point in points if point is not None}.values()]
        if self.parts and len(distinct) > FOLLOWED:
            costs = [short.evaluate(point, short.substeps(point), sensitivities=False).cost for point in distinct]
            distinct = [distinct[k] for k in np.argsort(costs)[:FOLLOWED]]
        ends = [short.minimise(point, FIRST_STEPS) for point in distinct]
        return [evaluation for evaluation in ends if np.isfinite(evaluation.cost)]

    def _summary(self, document: Mapping[str, Any], search: OutputErrorSearch, evaluation: Evaluation) -> Fit:
        """Return a fit from the end of a search."""
        if not np.isfinite(evaluation.cost):
            return Fit(document, failure=DIVERGES)
        m, count = search.m, len(search.free)
        residual, J, sizes = stacked(search, evaluation, self.stretches)
        at_bound = search.at_bound(evaluation.unknowns)
        loo = left_out(residual, J[:, :m][:, ~at_bound[:m]], sizes)
        energies = block_misfit(search, evaluation, self.stretches)
        covariance = robust_covariance(evaluation.information, residual, J, sizes, ~at_bound, self.rows)
        return Fit(
            document=document,
            free=search.free,
            theta=evaluation.unknowns[:count],
            covariance=covariance[:count, :count],
            at_bound=at_bound[:count],
            misfit=float(energies.sum()),
            rows=self.rows,
            run_misfit=energies,
            left_out=loo,
            goodness=goodness_left_out(loo, self.allowed),
        )

    def score(self, fit: Fit) -> Score:
        """Return the errors of a fit on hold-out runs, or on stretches left out one by one."""
        document = values_in(fit.document, fit.values)
        try:
            if self.held:
                return held_score(self.simulation(document, self.held), self.variance, self.units)
            search = self.search(document)
            return left_out_score(search, search.first(self.starts), self.variance, self.units)
        except FAILURES as error:
            return Score({"": float("nan")}, {}, reason=reason_of(error))

    @property
    def units(self) -> dict[str, str]:
        """The recorded unit of every signal, empty for pure numbers."""
        units = {name: self.recording.channels[column].unit for name, column in self.channels.columns.items()}
        return {name: "" if unit == "1" else unit for name, unit in units.items()}

    def finished(self, fit: Fit, chosen: Sequence[Insertion]) -> Fit:
        """Return the fit with what the faults state once (the width of a step) free as well, if that explains more."""
        fixed = [f"{item.name}.{key}" for item in chosen for key in item.fault.fixed]
        if not fixed:
            return fit
        document = values_in(fit.document, fit.values)
        document["identify"] = {**document.get("identify", {}), **{name: {} for name in fixed}}
        freed = self.fit(document, [[{}]])
        better = not freed.failure and freed.criterion < fit.criterion
        return freed if better and not freed.at_bound[-len(fixed) :].any() else fit

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return how well controllers follow from measured motion alone, structure that is left, and units.

        Which units stand for others is said of the blocks that are put in.
        """
        measured = {name: np.concatenate([run.values[name] for run in self.runs]) for name in self.channels.outputs}
        text = [
            f"{name} follows from the measured motion by the law of {controller} to "
            f"{100 * np.sqrt(value) / measured[name].std():.2g} %."
            for (controller, name), value in self.variance.items()
            if controller
        ]
        share = 0.0 if self.by_force or not inserted else self.structure(after)
        if share:
            text.append(f"What the repaired diagram leaves is not noise: {100 * share:.2g} % of it can be predicted.")
        units = {name.partition("[")[0]: self.recording.channels[c].unit for name, c in self.channels.columns.items()}
        diagram = self.load(after.document)
        for block in inserted:
            stands = {
                port.unit: f"{port.unit} stands for the {units[signal]} of {signal}"
                for port, signal in _neighbours(diagram, block)
                if port.unit and signal in units and compatible(units[signal], port.unit) not in ("same", "scaled")
            }
            text += [f"{block} has the units of a machine: {' and '.join(stands.values())}."] if stands else []
        return text


@dataclass(frozen=True, eq=False)
class TurningEvidence(WaveformEvidence):
    """Runs of a shaft that turns, driven by its recorded angle: long ones, so that only promising laws are fitted."""

    terms = TURNING_TERMS
    costly = True

    def bounds(self, fit: Fit) -> None:
        """Return None: nothing is known of places but by the sensitivities of each law."""


def _neighbours(diagram: Diagram, name: str) -> list[tuple[Port, str]]:
    """Return each port of a block with the signals that it takes, or that act where its output acts."""
    nodes, wires = diagram.nodes, diagram.wires
    taken = [(nodes[name].inputs[wire.target.port], wire.source) for wire in wires if wire.target.block == name]
    own = [wire for wire in wires if wire.source.block == name]
    beside = [(wire, other.source) for wire in own for other in wires if other.target == wire.target]
    acting = [(nodes[name].outputs[wire.source.port], end) for wire, end in beside if end.block != name]
    return [(port, f"{end.block}.{end.port}") for port, end in taken + acting]
