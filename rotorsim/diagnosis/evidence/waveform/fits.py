"""Fits of diagrams to samples in time: the search for what is free, from the starts of a law to all samples."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from operator import attrgetter
from typing import Any, Self

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import LONGEST, SAMPLED
from rotorsim.diagnosis.evidence.fit import FAILURES, Effort, Fit, Starts, failed_fit
from rotorsim.diagnosis.evidence.waveform.first_order import FirstOrder, Sensitivities
from rotorsim.diagnosis.evidence.waveform.runs import SampledRuns
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.differences import by_differences
from rotorsim.identification.waveform.evaluation import Evaluation, Label
from rotorsim.identification.waveform.noise import (
    Stretch,
    Variance,
    goodness_left_out,
    products_of,
    robust_covariance,
    weights_of,
    whitened,
)
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.identification.waveform.search import MOST_SIMULATIONS, OutputErrorSearch
from rotorsim.identification.waveform.shooting import is_lost, shot
from rotorsim.identification.waveform.starting import started
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.model.heard import surviving

FIRST_STEPS = 4  # from each start, before the best is followed
SHORT = 8192  # samples of all runs, from their beginning, on which a start is chosen and followed
# times the mean square of their residual, of what follows: there acts what they do not show; white noise of 900 and 750
# independent samples (of 2000 in all, as SHORT parts 15000) scatters by sqrt(2/900 + 2/750) = 7 %, a third of that
LATER = 1.2
SHOT_SUBSTEPS = 4  # times the steps that the diagram needs: of what is faster, parts of runs are not fitted one by one
CARRIED_ON = 25  # evaluations on all samples of run-ups: what data determine takes no more (`MOST_SIMULATIONS`)
LAST_STEPS = 12  # on all samples after that
FEW_STEPS = 3  # on all samples, until it is known which fits are worth more
PROMISED_PARTS = 2  # of long runs what laws promise is judged on every second part
FOLLOWED = 3  # starts of a law on parts of such runs: those that promise most
REFINED_EVALUATIONS = 4  # for one that is asked for: they are cheap
KEPT_MOTIONS = 4  # documents whose motions are kept: as given and repaired, of two measures of the noise
DIVERGES, SENSITIVITIES_DIVERGE = "the simulation diverges", "the sensitivities of the simulation diverge"


@dataclass(frozen=True, eq=False)
class WaveformFits(SampledRuns):
    """Runs in time, driven by their recorded inputs, to which diagrams are fitted.

    sizes: largest magnitude of every signal, recorded or simulated. variance: what counts as noise. rows:
    independent samples. stretches: into which the runs are divided. allowed (B,): what an adequate model may leave
    of each when it is left out. by_force: whether noise is what a diagram with a flexible force leaves. least:
    steps between samples; steps_of_laws: of diagrams with blocks of a type that needs more. given: types of the
    blocks of the diagram as given; smoothed: types whose laws are approximated. starts: states at the first
    samples. old: names of the parameters that were free at first. held: hold-out runs. parts: of long runs, at all
    speeds, on which starts are chosen and followed; part_starts: their states at first samples. near, stated:
    parameters of the diagram that leave least, and as it was given. beginning: of the runs, as many samples of all
    on which starts are chosen and followed where there are no parts.
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
    stated: Mapping[str, float] = field(default_factory=dict)
    beginning: int = SHORT
    steps_of_laws: Mapping[str, int] = field(default_factory=dict)
    given: Mapping[str, str] = field(default_factory=dict)
    smoothed: frozenset[str] = frozenset()

    def largest(self) -> Mapping[str, float]:
        """Return the largest magnitude of signals by flat name, the length of the longest run, and its longest step."""
        length = max(float(np.ptp(run.time)) for run in self.runs)
        step = max(run.dt if run.steps is None else float(run.steps.max()) for run in self.runs)
        return {**self.sizes, LONGEST: length, SAMPLED: step}

    def search(self, document: Mapping[str, Any]) -> OutputErrorSearch:
        """Return the search for the free parameters of a document; laws go on beyond where they are defined.

        Raises RotorsimError.
        """
        diagram = self.load(document)
        systems = subsystems_of(diagram, self.channels)
        if [signal for system in systems for signal in system.signals] != list(self.variance):
            what = "its controllers can no longer be told from the rest by what was measured"
            raise RotorsimError(Problem(what, diagram.name))
        weights = weights_of(self.variance, self.runs, self.rows)
        return OutputErrorSearch(systems, self.runs, weights, self.steps(document)).unlimited

    def simulation(self, document: Mapping[str, Any], runs: Sequence[SampledRun]) -> OutputErrorSearch:
        """Return a document as it is beside some runs, of which only the starts are searched. Raises RotorsimError."""
        systems = subsystems_of(self.load(document), self.channels)[:1]
        weights = {signal: 1 / value for signal, value in self.variance.items()}
        return OutputErrorSearch(systems, runs, weights, self.steps(document), hold="theta").unlimited

    def steps(self, document: Mapping[str, Any]) -> int:
        """Return the steps between samples that a document needs, at least."""
        types = {block["type"] for block in document["blocks"].values()}
        return max(self.least, *(steps for law, steps in self.steps_of_laws.items() if law in types), 1)

    def in_steps(self, document: Mapping[str, Any], steps: int) -> Self:
        """Return these in which a document has so many steps: its laws, or, where there are none, all documents.

        With one of the laws that are approximated all of these, so that none is judged by coarser steps than a rival.
        """
        laws = {block["type"] for name, block in document["blocks"].items() if block["type"] != self.given.get(name)}
        if not laws:
            return replace(self, least=steps)
        laws |= self.smoothed if laws & self.smoothed else set()
        return replace(self, steps_of_laws={**self.steps_of_laws, **dict.fromkeys(laws, steps)})

    def beside(self, document: Mapping[str, Any], runs: Sequence[SampledRun]) -> tuple[OutputErrorSearch, Evaluation]:
        """Return a document as it is beside runs, from the starts that leave least. Raises RotorsimError."""
        motions = _motions(self, json.dumps(document, default=lambda value: value.tolist()))
        found = [motions.beside(run) for run in runs]
        m = motions.search.m
        unknowns = np.concatenate([found[0].unknowns[:m], *(one.unknowns[m:] for one in found)])
        residuals = [[one.residuals[0][0] for one in found if one.residuals]]
        steps, cost = max(one.sub for one in found), sum(one.cost for one in found)
        return replace(motions.search, runs=runs), Evaluation(unknowns, steps, cost, residuals)

    def within(self, document: Mapping[str, Any], limits: Mapping[str, tuple[float, float]]) -> Fit:
        """Return the fit of a document from what it states, some parameters within limits of their own."""
        try:
            search = replace(self.search(document), within=limits)
            return self._summary(document, search, search.minimise(self.first_point(search)))
        except FAILURES as error:
            return failed_fit(document, error)

    def simulated(self, document: Mapping[str, Any], runs: Sequence[SampledRun]) -> list[np.ndarray] | None:
        """Return the outputs of a document as it is in every run, (N, c), from the best starts; None if it diverges."""
        try:
            search, evaluation = self.beside(document, runs)
        except (*FAILURES, KeyError):
            return None
        if not np.isfinite(evaluation.cost):
            return None
        outputs = search.systems[0].equations.outputs
        order = [outputs.index(name) for name in self.channels.outputs]
        pairs = zip(search.measured[0], evaluation.residuals[0], strict=True)
        return [(measured - residual)[:, order] for measured, residual in pairs]

    def _fit(self, document: Mapping[str, Any], starts: Starts, effort: Effort) -> Fit:
        """Follow the best of each group on the beginning of the runs, then the best of these on all samples.

        One that is only carried on, on all samples at once.
        """
        limit = MOST_SIMULATIONS if effort.most is None else REFINED_EVALUATIONS * effort.most
        last = LAST_STEPS if effort.most is None else FEW_STEPS
        search = self.search(document)
        if [*starts] == [[{}]]:
            most = (effort.most or CARRIED_ON) if self.parts else limit
            return self._summary(document, search, search.minimise(self.first_point(search), most))
        short, first = self._short(search)
        groups = starts or [[{}, self.near]]
        groups = [[start for group in groups for start in group]] if self.parts else groups
        tried = [self._followed(short, first, group) for group in groups]
        begun = [min(group, key=attrgetter("cost")) for group in tried if group]
        if not begun:
            return Fit(document, failure=DIVERGES)
        longer = sum(run.size for run in search.runs) / sum(run.size for run in short.runs)
        if not self.parts and longer * min(one.cost for one in begun) > effort.beyond:
            point = min(begun, key=attrgetter("cost")).unknowns
            return self._summary(document, search, search.evaluate(point, search.substeps(point)))
        ends = [short.minimise(one.unknowns, limit) for one in begun]
        stated = starts[0][0] if starts and starts[0] else {}
        if stated and effort.lost and not self.parts and is_lost(short, min(ends, key=attrgetter("cost"))):
            point = short.stated(first, stated)
            if short.substeps(point) <= SHOT_SUBSTEPS * short.least:
                ends.append(short.minimise(shot(short, point), limit))
        start = min(ends, key=attrgetter("cost")).unknowns
        if self.parts:
            start = np.concatenate([start[: search.m], search.first(self.starts)[search.m :]])
        return self._summary(document, search, search.minimise(start, limit if short is search else last))

    def _short(self, search: OutputErrorSearch, every: int = 1) -> tuple[OutputErrorSearch, np.ndarray]:
        """Return a search on less of the runs, and its unknowns as the diagram states them; every: so many parts."""
        if not self.parts:
            return search.shortened(self.beginning), self.first_point(search)
        parts = self.parts[::every]
        starts = {(name, state, r // every): x for (name, state, r), x in self.part_starts.items() if r % every == 0}
        short = replace(search, runs=parts, weights=weights_of(self.variance, parts, self.rows))
        return short, short.first(starts)

    def first_point(self, search: OutputErrorSearch, fit: Fit | None = None) -> np.ndarray:
        """Return the unknowns that a diagram states, states at first samples as of its fit, as first found or measured.

        Those of a diagram that lacks much may be far from any motion of the repaired one.
        """
        if fit is not None and len(fit.starts):
            return np.concatenate([search.first()[: search.m], fit.starts])
        return _cheaper(search, search.first(self.starts), search.first())

    def _beginning(self, fit: Fit) -> int:
        """Return SHORT, or all samples where a fit leaves more of those that come later.

        A step or a drift late in the runs, or what acts at the end of a sweep, shows nowhere else.
        """
        total = sum(run.size for run in self.runs)
        if total <= SHORT or self.parts or fit.failure:
            return SHORT
        ends = [run.size * SHORT / total for run in self.runs]
        later = np.array([(first + last) / 2 >= ends[r] for r, first, last in self.stretches])
        sizes = np.array([last - first for _, first, last in self.stretches])
        if not later.any() or later.all():
            return SHORT
        square = [fit.run_misfit[which].sum() / sizes[which].sum() for which in (~later, later)]
        return total if square[1] > LATER * square[0] else SHORT

    def _held(self, document: Mapping[str, Any]) -> OutputErrorSearch:
        """Return the search on the beginning of the runs for the starts of the whole diagram alone."""
        whole = replace(self.search(document), hold="theta")
        return replace(whole, systems=whole.systems[:1]).shortened(self.beginning)

    def promise(self, document: Mapping[str, Any], starts: Starts) -> float:
        """Return the misfit after FIRST_STEPS steps from the best start, per sample as on all samples."""
        try:
            short, first = self._short(self.search(document), PROMISED_PARTS)
            if self.parts:
                every = [start for group in starts for start in group]
                return self._first_order(short, first, every)[0].promise
            tried = self._followed(short, first, starts[0] if starts else [])
        except FAILURES:
            return np.inf
        return min((evaluation.cost for evaluation in tried), default=np.inf)

    @cached_property
    def _sensitivities(self) -> list[Sensitivities]:
        """The last of a diagram from which a law is absent, for the laws that follow."""
        return []

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process gets: equations cannot be sent."""
        return {key: value for key, value in vars(self).items() if key != "_sensitivities"}

    def _first_order(
        self, short: OutputErrorSearch, first: np.ndarray, starts: Sequence[Mapping[str, float]]
    ) -> tuple[FirstOrder, list[Mapping[str, float]]]:
        """Return what the starts of an effect promise by first-order sensitivities, and those of the diagram, too."""
        own = [start for start in starts if not self.old & start.keys()]
        others = [start for start in starts if self.old & start.keys()]
        return FirstOrder(short, first, own, self.old, self._sensitivities), others

    def residual(self, document: Mapping[str, Any]) -> np.ndarray | None:
        """Return the weighted residual of a diagram as it is, starts of runs at their best; None where it diverges."""
        try:
            search = replace(self.search(document), hold="theta")
        except FAILURES:
            return None
        evaluation = search.minimise(self.first_point(search))
        found = np.isfinite(evaluation.cost)
        return np.concatenate(whitened(search, evaluation, self.stretches)) if found else None

    def _followed(
        self, short: OutputErrorSearch, first: np.ndarray, group: Sequence[Mapping[str, float]]
    ) -> list[Evaluation]:
        """Return where a few steps lead from each start of a group; on parts of runs from those that promise most.

        There also from the first of those that name parameters of the diagram, with the best values of the effect; from
        these as they are where there are no others.
        """
        if self.parts:
            promised, others = self._first_order(short, first, group)
            points = promised.points(FOLLOWED)
            if points:
                points += [
                    short.stated(points[0], {k: v for k, v in start.items() if k in self.old}) for start in others[:1]
                ]
            else:  # one that is known to be near
                points = [short.stated(first, start) for start in others[:FOLLOWED]]
        else:
            measured = short.first()[short.m :]  # states at first samples, where that is better

            def begun(start: Mapping[str, float]) -> np.ndarray | None:
                point = started(short, first, start, self.old)
                other = None if point is None else np.concatenate([point[: short.m], measured])
                return point if point is None or other is None else _cheaper(short, point, other)

            points = [point for point in surviving(begun, group) if point is not None]
        distinct = [*{point.tobytes(): point for point in points}.values()]
        ends = [*surviving(lambda point: short.minimise(point, FIRST_STEPS), distinct)]
        return [evaluation for evaluation in ends if np.isfinite(evaluation.cost)]

    def _summary(self, document: Mapping[str, Any], search: OutputErrorSearch, evaluation: Evaluation) -> Fit:
        """Return a fit from the end of a search."""
        if not np.isfinite(evaluation.reached().cost):
            return Fit(document, failure=DIVERGES)
        if search.limited and not self.parts:
            evaluation = by_differences(search, evaluation)
        m, count = search.m, len(search.free)
        at_bound = search.at_bound(evaluation.unknowns)
        with np.errstate(over="ignore", invalid="ignore"):
            products = products_of(search, evaluation, self.stretches)
            covariance = robust_covariance(evaluation.information, products, ~at_bound, self.rows)
        if not np.isfinite(covariance).all():
            return Fit(document, failure=SENSITIVITIES_DIVERGE)
        loo = products.of(np.flatnonzero(~at_bound[:m])).left_out()
        return Fit(
            document=document,
            free=search.free,
            theta=evaluation.unknowns[:count],
            covariance=covariance[:count, :count],
            at_bound=at_bound[:count],
            misfit=float(products.squares.sum()),
            rows=self.rows,
            run_misfit=products.squares,
            left_out=loo,
            goodness=goodness_left_out(loo, self.allowed),
            starts=evaluation.unknowns[m:],
        )


@dataclass(frozen=True, eq=False)
class _Motions:
    """A document as it is beside single runs: scores, remarks and figures ask for the same."""

    search: OutputErrorSearch
    known: dict[SampledRun, Evaluation] = field(default_factory=dict)

    def beside(self, run: SampledRun) -> Evaluation:
        """Return the motion beside a run, from the start that leaves least."""
        if run not in self.known:
            search = replace(self.search, runs=[run])
            self.known[run] = replace(search.minimise(search.first()), jacobians=())
        return self.known[run]


@lru_cache(maxsize=KEPT_MOTIONS)
def _motions(fits: WaveformFits, document: str) -> _Motions:
    return _Motions(fits.simulation(json.loads(document), []))


def _cheaper(search: OutputErrorSearch, point: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return that of two points which costs less, the first of equal ones."""
    costs = [search.evaluate(x, search.substeps(x), sensitivities=False).cost for x in (point, other)]
    return other if costs[1] < costs[0] else point
