"""Evidence of samples in time: runs that a diagram is driven through, compared with its simulation.

What counts as noise, and what is adequate: `rotorsim.diagnosis.evidence.waveform.noise`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np
from scipy.stats import t as student

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Defaults, Score, Terms
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit, Starts, left_out, reason_of
from rotorsim.diagnosis.evidence.waveform.data import SampledRuns, TimeRun
from rotorsim.diagnosis.evidence.waveform.noise import (
    Stretch,
    Variance,
    block_misfit,
    independent,
    misfits_left_out,
    reweighted,
    stacked,
    variances,
    weights_of,
)
from rotorsim.diagnosis.evidence.waveform.scoring import held_score, left_out_score
from rotorsim.diagnosis.evidence.waveform.search import MOST_EVALUATIONS, Evaluation, Point, TimeSearch
from rotorsim.diagnosis.evidence.waveform.views import WHOLE, views_of
from rotorsim.diagram.diagram import Diagram, Endpoint, Port
from rotorsim.units import compatible

__all__ = ["WaveformEvidence"]

FIRST_STEPS = 4  # from each start, before the best is followed
SHORT = 8192  # samples of all runs on which a start is chosen and followed
LAST_STEPS = 12  # on all samples after that
LINEAR_EVALUATIONS = 4  # for one that is asked for: they are cheap
INVERTED = 1e-13  # smallest eigenvalue of the scaled information, of the largest, that counts
TERMS = Terms(
    left_out="stretches left out one by one",
    predicted="stretches left out",
    more_runs="runs at more amplitudes and frequencies of what drives it",
    another="another input, or a sensor elsewhere",
    turns=False,
)
DIVERGES = "the simulation diverges"


@dataclass(frozen=True, eq=False)
class WaveformEvidence(SampledRuns, Defaults):
    """Runs in time, driven by their recorded inputs.

    sizes: largest magnitude of every signal, recorded or simulated. rows: independent samples. stretches: into which
    the runs are divided. allowed (B,): what an adequate model may leave of each when it is left out. least: steps
    between samples. starts: "view:state" -> value at the start of each run. old: names of the parameters that were free
    at first. held: hold-out runs.
    """

    views: tuple[str, ...]
    variance: Variance
    rows: int
    stretches: tuple[Stretch, ...]
    allowed: np.ndarray
    least: int
    starts: Mapping[str, Sequence[float]]
    old: frozenset[str]
    held: tuple[TimeRun, ...]

    terms = TERMS
    independent = False

    def search(self, document: Mapping[str, Any]) -> TimeSearch:
        """Return the search for the free parameters of a document. Raises RotorsimError."""
        views = views_of(self.load(document), self.channels, expected=self.views)
        weights = weights_of(views, self.runs, self.variance, self.rows)
        return TimeSearch(views, self.runs, weights, least=self.least)

    def simulation(self, document: Mapping[str, Any], runs: Sequence[TimeRun]) -> TimeSearch:
        """Return a document as it is beside some runs, of which only the starts are searched. Raises RotorsimError."""
        view = views_of(self.load(document), self.channels)[0]
        weights = np.array([1 / self.variance[WHOLE, name] for name in view.outputs])
        return TimeSearch([view], runs, [[weights] * len(runs)], least=self.least, hold="theta")

    def simulated(self, document: Mapping[str, Any], runs: Sequence[TimeRun]) -> list[np.ndarray] | None:
        """Return the outputs of a document as it is in every run, (N, c), from the best starts; None if it diverges."""
        try:
            search = self.simulation(document, runs)
            evaluation = search.minimise(search.first())[1]
        except (*FAILURES, KeyError):
            return None
        if not np.isfinite(evaluation.cost):
            return None
        outputs = search.views[0].outputs
        order = [outputs.index(name) for name in self.channels.outputs]
        pairs = zip(runs, evaluation.errors[0], strict=True)
        return [(run.measured(outputs) - errors)[:, order] for run, errors in pairs]

    def fit(
        self, document: Mapping[str, Any], starts: Starts, *, most: int | None = None, linear_only: bool = False
    ) -> Fit:
        """Return the best fit of a diagram from the best of each group of starts {free parameter: SI value}.

        What a start does not name begins as written. most: a limit of evaluations, times LINEAR_EVALUATIONS.
        linear_only is not heeded: a nonlinear diagram costs no more.
        """
        began = process_time()
        limit = MOST_EVALUATIONS if most is None else LINEAR_EVALUATIONS * most
        try:
            search = self.search(document)
            found = self._best(search, starts, limit)
        except FAILURES as error:
            return Fit(document, failure=reason_of(error), seconds=process_time() - began)
        if found is None:
            return Fit(document, failure=DIVERGES, seconds=process_time() - began)
        return self._summary(document, search, *found, process_time() - began)

    def recalibrated(self, fit: Fit) -> WaveformEvidence | None:
        """Return the evidence whose noise is what a fit leaves, for one that leaves less than the flexible model."""
        if fit.misfit >= CRITERIA.surpassed * fit.freedom:
            return None
        search = self.search(values_in(fit.document, fit.values))
        _, found = reweighted(search, search.first(self.starts))
        rows = independent(block_misfit(search, found, self.stretches), self.stretches)
        new = replace(self, variance=variances(search, found), rows=rows)
        search.weights = weights_of(search.views, self.runs, new.variance, rows)
        return replace(new, allowed=CRITERIA.no_worse**2 * misfits_left_out(search, found, self.stretches))

    def at(self, fit: Fit) -> Fit:
        """Return a fit to the evidence before recalibration as this one judges it, at the same parameters."""
        search = self.search(values_in(fit.document, fit.values))
        search.hold = "theta"
        point, found = search.minimise(search.first(self.starts))
        return self._summary(fit.document, search, point, found, fit.seconds)

    def promise(self, document: Mapping[str, Any], starts: Starts) -> float:
        """Return the misfit after FIRST_STEPS steps from the best start, per sample as on all samples."""
        try:
            search = self.search(document)
            tried = self._followed(search, search.shortened(SHORT), starts[:1])
        except FAILURES:
            return np.inf
        return min((found.cost for _, found in tried), default=np.inf)

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the weighted errors of a diagram as it is, starts of runs at their best; None where it diverges."""
        try:
            search = self.search(document)
        except FAILURES:
            return None
        search.hold = "theta"
        found = search.minimise(search.first(self.starts))[1]
        return stacked(search, found, self.stretches)[0] if np.isfinite(found.cost) else None

    def _best(self, search: TimeSearch, groups: Starts, most: int) -> tuple[Point, Evaluation] | None:
        short = search.shortened(SHORT)
        ends = []
        for group in groups or [[{}]]:
            tried = self._followed(search, short, [group])
            if tried:
                ends.append(short.minimise(min(tried, key=_cost)[0], most))
        if not ends:
            return None
        point = min(ends, key=_cost)[0]
        return search.minimise(point, most if short is search else min(most, LAST_STEPS))

    def _followed(self, search: TimeSearch, short: TimeSearch, groups: Starts) -> list[tuple[Point, Evaluation]]:
        """Return where a few steps lead from each start on the beginning of the runs."""
        first = search.first(self.starts)
        tried: list[tuple[Point, Evaluation]] = []
        seen: set[bytes] = set()
        for start in (start for group in groups for start in group):
            point = short.started(first, start, self.old)
            if point is None or point.theta.tobytes() in seen:
                continue
            seen.add(point.theta.tobytes())
            found = short.minimise(point, FIRST_STEPS)
            if np.isfinite(found[1].cost):
                tried.append(found)
        return tried

    def _summary(
        self, document: Mapping[str, Any], search: TimeSearch, point: Point, found: Evaluation, seconds: float
    ) -> Fit:
        """Return a fit from the end of a search."""
        if not np.isfinite(found.cost):
            return Fit(document, failure=DIVERGES, seconds=seconds)
        m, free = search.m, search.free
        energies = block_misfit(search, found, self.stretches)
        rows, J, sizes = stacked(search, found, self.stretches)
        held = search.at_bound(point)
        loo = left_out(rows, J[:, :m][:, ~held], sizes)
        return Fit(
            document=document,
            free=free,
            theta=point.theta[: len(free)],
            covariance=self._covariance(found, rows, J, sizes, held)[: len(free), : len(free)],
            at_bound=held[: len(free)],
            misfit=float(energies.sum()),
            rows=self.rows,
            run_misfit=energies,
            left_out=loo,
            goodness=self._goodness(loo),
            seconds=seconds,
        )

    def _covariance(
        self, found: Evaluation, rows: np.ndarray, J: np.ndarray, sizes: Sequence[int], held: np.ndarray
    ) -> np.ndarray:
        """Return H^-1 (sum_b g_b g_b^T) H^-1 B / (B - 1) of all unknowns, g_b = J_b^T r_b; held parameters are known.

        Where a model leaves less than the resolution, H^-1 of what is missing to that is added.
        """
        ends = np.cumsum(sizes)
        scores = np.array([J[end - n : end].T @ rows[end - n : end] for end, n in zip(ends, sizes, strict=True)])
        scale = np.sqrt(np.diag(found.information))
        scale = np.where(scale > 0, scale, 1.0)
        fixed = np.zeros(len(scale), bool)
        fixed[: len(held)] = held
        H = found.information / np.outer(scale, scale)
        H[fixed], H[:, fixed] = 0.0, 0.0
        values, vectors = np.linalg.eigh(H)
        kept = np.maximum(values, INVERTED * values[-1])
        inverse = (vectors / kept) @ vectors.T / np.outer(scale, scale)
        inverse[fixed], inverse[:, fixed] = 0.0, 0.0
        count = len(sizes)
        robust = inverse @ (scores.T @ scores) @ inverse * (count / max(count - 1, 1))
        below = max(1 - float(rows @ rows) / self.rows, 0.0)
        weak = values <= INVERTED * values[-1]  # directions that the data say nothing about
        weak &= np.abs(vectors[fixed]).sum(axis=0) < 0.5
        unknown = (vectors[:, weak] / kept[weak]) @ vectors[:, weak].T / np.outer(scale, scale)
        return np.asarray(robust + below * inverse + unknown)

    def _goodness(self, left: np.ndarray) -> float:
        """Return the probability of such misfits of stretches left out (B,) if a model is adequate."""
        ratio = np.log(np.maximum(left, 1e-300) / np.maximum(self.allowed, 1e-300))
        spread = float(ratio.std(ddof=1)) / np.sqrt(len(ratio)) if len(ratio) > 1 else 0.0
        if spread <= 1e-12:
            return float(ratio.mean() <= 1e-9)
        return float(student.sf(float(ratio.mean()) / spread, len(ratio) - 1))

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
        found = self.fit(document, [[{}]])
        better = not found.failure and found.criterion < fit.criterion
        return found if better and not found.at_bound[-len(fixed) :].any() else fit

    def remarks(self, before: Fit, after: Fit, inserted: Sequence[str]) -> list[str]:
        """Return how well controllers follow from measured motion alone, and which units stand for others."""
        text = []
        for (view, name), value in self.variance.items():
            if view:
                share = 100 * np.sqrt(value) / np.concatenate([run.values[name] for run in self.runs]).std()
                text.append(f"{name} follows from the measured motion by the law of {view} to {share:.2g} %.")
        diagram = self.load(after.document)
        for block in inserted:
            stands: dict[str, tuple[str, str]] = {}
            for port, signal in _neighbours(diagram, block):
                for column in (c for n, c in self.channels.columns.items() if n.partition("[")[0] == signal):
                    unit = self.recording.channels[column].unit
                    if port.unit and compatible(unit, port.unit) not in ("same", "scaled"):
                        stands[port.unit] = unit, signal
            if stands:
                each = " and ".join(f"{unit} stands for the {other} of {at}" for other, (unit, at) in stands.items())
                text.append(f"{block} has the units of a machine: {each}.")
        return text


def _neighbours(diagram: Diagram, name: str) -> Iterator[tuple[Port, str]]:
    """Yield each port of a block with the signals that it takes, or that act where its output acts."""

    def port(end: Endpoint) -> str:
        return f"{end.block}.{end.port}"

    for wire in diagram.wires:
        if wire.target.block == name:
            yield diagram.nodes[name].inputs[wire.target.port], port(wire.source)
        elif wire.source.block == name:
            for other in diagram.wires:
                if other.target == wire.target and other.source.block != name:
                    yield diagram.nodes[name].outputs[wire.source.port], port(other.source)


def _cost(end: tuple[Point, Evaluation]) -> float:
    return end[1].cost
