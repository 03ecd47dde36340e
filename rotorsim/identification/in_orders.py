"""From a diagram and order vectors over the speed to parameters: output error of the order-tracked simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.diagram.resolve.settings import with_finer_mesh
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.identification.held import Estimated, contradictions_of, is_contradicted, settings_of, with_contradictions
from rotorsim.identification.meshes import on_fine_meshes
from rotorsim.identification.result import Identification, identified, sentences
from rotorsim.identification.verdict import judge
from rotorsim.identification.waveform.estimate import TimeEstimate, time_estimate
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.noise import INVERTED, REWEIGHTED, independent_stretches
from rotorsim.identification.waveform.noise_model import SIMULATION_DIVERGES, NoiseModel
from rotorsim.identification.waveform.order_tracking import (
    SAMPLES_OF_PERIOD,
    OrderSearch,
    TrackedOrders,
    order_noise,
    order_search,
    tracked_orders,
    vectors_of,
)
from rotorsim.identification.waveform.search import SIMULATION_SUBSTEPS
from rotorsim.jobs.threads import one_thread, own_cores, threads
from rotorsim.recordings.orders import OrderRecording, OrderRun
from rotorsim.signals.orders.rows import slowness


@dataclass(frozen=True, eq=False)
class ComparedOrders:
    """A run beside the identified diagram: channel in words -> measured and simulated vectors (n,), complex, SI."""

    run: OrderRun
    use: str
    measured: Mapping[str, np.ndarray]
    simulated: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class SlowRoll:
    """The constant vector of a channel (SI, 0-peak, lead) with the standard deviation of its parts."""

    vector: complex
    std: float


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class OrderIdentification(Identification):
    """What order vectors over the speed say. slow_roll: of each channel, where it is in the data.

    noise: standard deviation of the real parts of each channel, as differences between rows show it.
    """

    runs: tuple[ComparedOrders, ...] = ()
    slow_roll: Mapping[str, SlowRoll]
    noise: Mapping[str, float]
    units: Mapping[str, str]

    _beside = "rotorsim.report.identification.orders:order_figures"

    @property
    def run_ids(self) -> list[str]:
        """The runs that were identified from."""
        return [item.run.id for item in self.runs if item.use == "identify"]

    def misfit_data(self) -> dict[str, Any]:
        """Return how large the residual is, in the form of identification.json."""
        slow_roll = {
            name: {"amplitude": abs(one.vector), "phase": float(np.angle(one.vector)), "std": one.std}
            for name, one in self.slow_roll.items()
        }
        return {"excess_variance": self.excess, "slow_roll": slow_roll, "noise": dict(self.noise)}


def identify_orders(
    diagram: Diagram,
    recording: OrderRecording,
    *,
    method: str = "likelihood",
    given: Sequence[str] = (),
    free: Sequence[Free] | None = None,
    precision: float = CRITERIA.precision,
    hold_out: OrderRecording | None = None,
) -> OrderIdentification:
    """Estimate the free parameters of a diagram from order vectors over the speed; see `identify`.

    The diagram is simulated along the angle of each run, its orders are extracted as they were of the machine, and
    the squares of the differences are minimised by Levenberg and Marquardt with exact sensitivities. Where slow roll
    is in the data, a constant vector of each channel is fitted along.

    Raises RotorsimError for channels that the diagram does not have, no run to identify from, nothing free, and where
    the diagram diverges.
    """
    wanted, sha256 = diagram.free if free is None else tuple(free), diagram.sha256
    _refuse(diagram, recording, method, given, wanted)
    diagram = replace(diagram, free=wanted)
    with one_thread(), threads(own_cores()):
        fitted, refined = on_fine_meshes(diagram, _fitted(diagram, recording, wanted))
        contradicted = contradictions_of(fitted.diagram, fitted, settings_of(recording.select("identify")))
        diagram, search, estimate, variance = fitted.diagram, fitted.search, fitted.estimate, fitted.variance
        evaluation, labels = estimate.evaluation, fitted.labels
        held = [(recording, recording.select("hold_out"))]
        held += [] if hold_out is None else [(hold_out, hold_out.runs)]
        compared = [compared_orders(search, evaluation, "identify")]
        for source, runs in held:
            if runs:
                other = order_search(tracked_orders(diagram, source, runs, wanted), variance)
                at = other.evaluate(evaluation.unknowns, other.substeps(evaluation.unknowns), sensitivities=False)
                compared.append(compared_orders(other, at, "hold_out"))
    verdicts = judge(estimate, estimate.intervals, precision=precision)
    parameters, correlation = identified(estimate, verdicts)
    fit: dict[str, dict[str, float]] = {}
    for use in ("identify", "hold_out"):
        items = [item for group in compared for item in group if item.use == use]
        if items:
            fit[use] = order_errors(items, labels)
    kept = {item.name for item in estimate.free}
    notes = [*recording.warnings, *([] if hold_out is None else hold_out.warnings)]
    notes += [*(Problem(note, severity="warning") for note in refined), *contradicted]
    notes += [
        Problem("is left out: no block follows it", f"identify.{item.name}", severity="warning")
        for item in wanted
        if item.name not in kept
    ]
    noise = {label: float(np.sqrt(variance["", label])) for label in labels}
    return OrderIdentification(
        method=method,
        parameters=parameters,
        correlation=correlation,
        fit=fit,
        noise_floor=_floor(compared[0], variance),
        excess=estimate.excess,
        adequate=estimate.adequate and not is_contradicted(contradicted),
        statement=with_contradictions(_statement(parameters, estimate), contradicted, estimate.adequate),
        advice=(),
        warnings=tuple(notes),
        diagram=diagram,
        sha256=sha256,
        settings={"precision": precision, "steps_between_samples": evaluation.sub},
        free=estimate.free,
        runs=tuple(item for group in compared for item in group),
        slow_roll=_slow_roll(search, estimate),
        noise=noise,
        units={channel.label: channel.unit for channel in fitted.tracked.channels},
    )


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A diagram fitted to the runs to identify from; variance: of the noise that it was weighed by."""

    diagram: Diagram
    recording: OrderRecording
    wanted: tuple[Free, ...]
    tracked: TrackedOrders
    variance: dict[tuple[str, str], float]
    search: OrderSearch
    estimate: TimeEstimate

    @property
    def labels(self) -> tuple[str, ...]:
        """What was measured, in words."""
        return self.tracked.labels

    def change(self, block: str, parts: int) -> float:
        """Return the square of what a finer mesh changes in the whitened prediction. Raises RotorsimError."""
        diagram = with_finer_mesh(self.diagram, block, parts)
        runs = self.recording.select("identify")
        finer = order_search(tracked_orders(diagram, self.recording, runs, self.wanted), self.variance)
        refuse_fast(finer, finer.first())
        return self.search.change(self.estimate.evaluation, finer)

    def finer(self, block: str, parts: int) -> _Fitted:
        """Return the fit with a finer mesh, from where this one ended. Raises RotorsimError."""
        diagram = with_finer_mesh(self.diagram, block, parts)
        return _fitted(diagram, self.recording, self.wanted, self.estimate.evaluation.unknowns)

    def worse_by(self, other: _Fitted) -> float:
        """Return how much more another fit leaves, weighted as here."""
        return self.search.squares(other.estimate.evaluation) - self.search.squares(self.estimate.evaluation)

    def freed(self, more: Sequence[Free] = ()) -> Estimated:
        """Return what is estimated with more parameters free, from where this fit ended. Raises RotorsimError."""
        found = self.estimate
        if more:
            parts = found.evaluation.unknowns
            start = np.concatenate([parts[: found.m], [item.value for item in more], parts[found.m :]])
            found = _fitted(self.diagram, self.recording, (*self.wanted, *more), start).estimate
        return Estimated(found.free, found.theta, found.std, found.at_bound, found.misfit)


def _fitted(
    diagram: Diagram, recording: OrderRecording, wanted: tuple[Free, ...], start: np.ndarray | None = None
) -> _Fitted:
    """Return the estimate from a start, the diagram as it is by default. Raises RotorsimError."""
    tracked = tracked_orders(diagram, recording, recording.select("identify"), wanted)
    variance = order_noise(tracked, CRITERIA.resolution)
    search = order_search(tracked, variance)
    if not search.free:
        what = "what was measured depends on none of the free parameters"
        raise RotorsimError(Problem(what, diagram.name, Place(diagram.file), "measure a signal behind them"))
    start = search.first() if start is None else start
    refuse_fast(search, start)
    evaluation = search.minimise(start).reached()
    refuse_diverged(diagram, evaluation)
    variance, search, evaluation = order_judged(search, evaluation, variance)
    estimate = order_estimate(search, evaluation, variance)
    return _Fitted(diagram, recording, wanted, tracked, variance, search, estimate)


def refuse_fast(search: OrderSearch, unknowns: np.ndarray) -> None:
    """Raise RotorsimError for modes that would take too many steps."""
    if search.needed(unknowns) > SIMULATION_SUBSTEPS:
        what = f"has modes too fast for {SIMULATION_SUBSTEPS} steps between samples, {SAMPLES_OF_PERIOD} a turn"
        hint = "leave out what is far above the speed: a beam by its first modes, as rk4_first_mode is of rk4"
        raise RotorsimError(Problem(what, search.systems[0].equations.model.diagram.name, hint=hint))


def refuse_diverged(diagram: Diagram, evaluation: Evaluation) -> None:
    """Raise RotorsimError where a search found nothing finite."""
    if not np.isfinite(evaluation.cost):
        hint = "is the loop stable? are signs and units right? start from values nearer to the machine's"
        what = f"{SIMULATION_DIVERGES} along the angle that was recorded"
        raise RotorsimError(Problem(what, diagram.name, hint=hint), exit_code=1)


def _refuse(
    diagram: Diagram, recording: OrderRecording, method: str, given: Sequence[str], wanted: Sequence[Free]
) -> None:
    """Raise RotorsimError for what makes no sense of orders over the speed."""
    problems = []
    if method != "likelihood":
        what = f"method '{method}' is of steady runs: these are orders over a speed that changes"
        problems.append(Problem(what, diagram.name, hint="--method likelihood: an order-tracked simulation"))
    if given:
        what = f"{', '.join(given)} cannot be taken as measured: orders are no samples"
        problems.append(Problem(what, diagram.name))
    if not wanted:
        hint = 'add "identify": {"block.parameter": {}, ...} to the diagram'
        problems.append(Problem("no free parameters", diagram.name, Place(diagram.file), hint))
    if not recording.select("identify"):
        hint = '"use": "identify" marks the runs that parameters are taken from'
        problems.append(Problem("no run to identify from", recording.name, hint=hint))
    if problems:
        raise RotorsimError(*problems)


def order_judged(
    search: OrderSearch, evaluation: Evaluation, variance: dict[tuple[str, str], float]
) -> tuple[dict[tuple[str, str], float], OrderSearch, Evaluation]:
    """Return the noise as what a fit leaves shows it, where that is less, and the fit that this weighs.

    Rows that are too far apart for a resonance to be smooth else make noise of it, beside which anything is explained.
    """
    tracked = search.tracked
    assert tracked is not None
    for _ in range(REWEIGHTED):
        seen = order_noise(tracked, CRITERIA.resolution, vectors_of(search, evaluation))
        less = {signal: min(value, seen[signal]) for signal, value in variance.items()}
        if all(less[signal] > value / CRITERIA.model_error for signal, value in variance.items()):
            break
        variance = less
        search = replace(search, weights={signal: 1 / value for signal, value in variance.items()})
        evaluation = search.minimise(evaluation.unknowns)
    return variance, search, evaluation


def order_estimate(search: OrderSearch, evaluation: Evaluation, variance: dict[tuple[str, str], float]) -> TimeEstimate:
    """Return the estimate, its covariance by the scatter of stretches of rows.

    An adequate model leaves of stretches that are left out what the noise would: a misfit of one a number. No variance
    is less than noise of the residual's size and slowness would give: where a few stretches at resonance say most,
    their scatter alone is too small as often as not.
    """
    counts = [np.isfinite(measured) for measured in search.measured[0]]
    stretches = independent_stretches([own.any(axis=1) for own in counts])
    allowed = np.array([counts[r][a:b].sum() for r, a, b in stretches], dtype=float)
    rows = int(sum(own.sum() for own in counts))
    noise = NoiseModel(
        variance=variance,
        rows=rows,
        stretches=stretches,
        allowed=CRITERIA.model_error * allowed,
        by_force=False,
        unjudged="",
        least=search.least,
        starts={},
        theta=evaluation.unknowns[: search.m],
        near={},
        sizes={},
    )
    estimate = time_estimate(search, evaluation, noise)
    searched = ~search.at_bound(evaluation.unknowns)
    white = np.zeros(len(searched))
    information = evaluation.information[np.ix_(searched, searched)]
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=INVERTED, hermitian=True)
    slow = slowness([column for e in evaluation.residuals[0] for column in e.T])
    white[searched] = max(estimate.excess, 1.0) * slow * np.diag(inverse) / size**2
    robust = np.diag(estimate.robust)
    wider = np.sqrt(np.maximum(white / np.where(robust > 0, robust, np.inf), 1.0))
    return replace(estimate, robust=estimate.robust * np.outer(wider, wider))


def _slow_roll(search: OrderSearch, estimate: TimeEstimate) -> dict[str, SlowRoll]:
    """Return the constant vectors of the channels."""
    if not search.constants:
        return {}
    values, m = estimate.evaluation.unknowns[search.m :], search.m
    std = np.sqrt(np.maximum(np.diag(estimate.robust)[m:], 0.0))
    labels = search.tracked.labels if search.tracked is not None else ()
    return {
        label: SlowRoll(complex(values[2 * c], values[2 * c + 1]), float(std[2 * c : 2 * c + 2].max()))
        for c, label in enumerate(labels)
    }


def compared_orders(search: OrderSearch, evaluation: Evaluation, use: str) -> list[ComparedOrders]:
    """Return the runs beside what is simulated of them."""
    tracked = search.tracked
    assert isinstance(tracked, TrackedOrders)
    return [
        ComparedOrders(
            track.source,
            use,
            dict(zip(tracked.labels, track.vectors.T, strict=True)),
            dict(zip(tracked.labels, simulated.T, strict=True)),
        )
        for track, simulated in zip(tracked.tracks, vectors_of(search, evaluation), strict=True)
    ]


def order_errors(items: Sequence[ComparedOrders], labels: Sequence[str]) -> dict[str, float]:
    """Return sqrt(sum |Y - Y_model|^2 / sum |Y - mean|^2) of every channel."""
    found = {}
    for label in labels:
        y = np.concatenate([item.measured[label] for item in items])
        off = y - np.concatenate([item.simulated[label] for item in items])
        total = float(np.nansum(np.abs(y - np.nanmean(y)) ** 2))
        if total > 0:
            found[label] = float(np.sqrt(np.nansum(np.abs(off) ** 2) / total))
    return found


def _floor(items: Sequence[ComparedOrders], variance: Mapping[tuple[str, str], float]) -> dict[str, float]:
    """Return the same error that noise alone makes."""
    found = {}
    for (_, label), value in variance.items():
        y = np.concatenate([item.measured[label] for item in items])
        total = float(np.nansum(np.abs(y - np.nanmean(y)) ** 2))
        if total > 0:
            found[label] = float(np.sqrt(2 * value * np.isfinite(y).sum() / total))
    return found


def _statement(parameters: Mapping[str, Any], estimate: TimeEstimate) -> str:
    """Return what was found in plain words."""
    parts = sentences(parameters, (), "")
    if estimate.adequate:
        return " ".join(parts)
    wrong = (
        f"The model does not explain the data: the residual has {estimate.excess:.3g} times the variance of the noise "
        "between rows, so something is missing in it, or the search began too far away; the intervals are those of the "
        "residual's own scatter, and hold only if what is missing does not matter to a parameter."
    )
    return " ".join([wrong, *parts])
