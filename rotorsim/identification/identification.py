"""From a diagram and a recording to parameters with intervals, verdicts and the next experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorsim.criteria import CRITERIA, Z90
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.advice import Advice, advise
from rotorsim.identification.fitted import fit_harmonics
from rotorsim.identification.harmonic.coordinates import stretched
from rotorsim.identification.harmonic.estimate import Estimate, Search, estimate
from rotorsim.identification.harmonic.experiment import open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.harmonic.profile import joint_factor, linear_intervals, profile_intervals
from rotorsim.identification.harmonic.regression import THESIS_ORDERS, open_regression
from rotorsim.identification.harmonic.scatter import scatter_of, with_covariance
from rotorsim.identification.held import contradictions_of, is_contradicted, settings_of, with_contradictions
from rotorsim.identification.in_orders import identify_orders
from rotorsim.identification.in_time import identify_in_time
from rotorsim.identification.meshes import on_fine_meshes
from rotorsim.identification.result import Identification, Identified, sentences
from rotorsim.identification.verdict import judge
from rotorsim.identification.waveform.recorded.along_angle import is_in_time
from rotorsim.jobs.threads import one_thread
from rotorsim.linear.linearisation import refuse_sampled
from rotorsim.measure.checks import check_signals
from rotorsim.model.heard import said
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import Recording, Run
from rotorsim.signals.converters import before_converters, stated_steps, through_converters
from rotorsim.signals.harmonics import RunHarmonics, contradictions, harmonics_of
from rotorsim.signals.pickup import find_mains, pickup_warnings, with_pickups

ESTIMATORS = ("likelihood", "regression")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class HarmonicIdentification(Identification):
    """What harmonics of a turning shaft say; goodness: probability of the misfit, None for the regression."""

    goodness: float | None
    runs: tuple[RunHarmonics, ...] = ()

    _beside = "rotorsim.report.identification.harmonics:harmonic_figures"

    @property
    def run_ids(self) -> list[str]:
        """The runs that were identified from."""
        return [item.run.id for item in self.runs]

    def misfit_data(self) -> dict[str, Any]:
        """Return how large the residual is, in the form of identification.json."""
        return {"excess_variance": self.excess, "goodness": self.goodness}


@said
def identify(
    diagram: Diagram,
    recording: Recording | OrderRecording,
    *,
    method: str = "likelihood",
    given: Sequence[str] = (),
    free: Sequence[Free] | None = None,
    runs: Sequence[Run] | None = None,
    orders: Sequence[int] = THESIS_ORDERS,
    reduction: str = "exact",
    precision: float = CRITERIA.precision,
    profile: bool = True,
    hold_out: Recording | OrderRecording | None = None,
    harmonics: Sequence[RunHarmonics] | None = None,
) -> Identification:
    """Estimate the free parameters of a diagram from the runs of a recording.

    Compared are harmonics where a shaft turns at steady speeds, else samples in time (`is_in_time` tells which); of a
    recording of orders, orders of a run-up (`identify_orders`). method: "likelihood" (errors in all measured signals,
    bounds, priors; intervals from the profile of the likelihood; in time: output error), or "regression" (the thesis'
    least squares, eq. (2.64)-(2.66), (3.47), (4.34), (5.18)). given: ports taken as measured inputs with their noise,
    so that what makes them need not be right. Meshes are refined as far as the recording shows it, and a warning says
    so; by the likelihood. precision: half width of the 90 % interval, as part of the value, that
    counts as identified. hold_out: further runs that are only scored. orders, reduction: of the regression.

    Raises RotorsimError for recordings with errors, channels or settings that the diagram does not have, runs
    without phase reference, diagrams that are not linear in their states.
    """
    if method not in ESTIMATORS:
        raise RotorsimError(Problem(f"no method '{method}'", hint=f"one of {', '.join(ESTIMATORS)}"))
    if isinstance(recording, OrderRecording):
        if isinstance(hold_out, Recording):
            raise RotorsimError(Problem("orders and samples cannot be compared", hold_out.name))
        if runs is not None or harmonics is not None:
            hint = 'mark them by "use" in recording.json'
            raise RotorsimError(Problem("of orders, runs cannot be chosen here", recording.name, hint=hint))
        return identify_orders(
            diagram, recording, method=method, given=given, free=free, precision=precision, hold_out=hold_out
        )
    if isinstance(hold_out, OrderRecording):
        raise RotorsimError(Problem("orders and samples cannot be compared", hold_out.name))
    warnings = [*_checked(recording), *([] if hold_out is None else _checked(hold_out))]
    if harmonics is None and is_in_time(diagram, recording):
        return identify_in_time(
            diagram,
            recording,
            method=method,
            given=given,
            free=free,
            runs=runs,
            precision=precision,
            hold_out=hold_out,
            warnings=warnings,
        )
    sha256, (steps, unseen) = diagram.sha256, stated_steps(diagram, recording)
    diagram, warnings = before_converters(diagram), [*warnings, *unseen]
    if steps and harmonics is None:
        recording = through_converters(recording, steps)
        hold_out = None if hold_out is None else through_converters(hold_out, steps)
        wanted_runs = None if runs is None else {run.id for run in runs}
        runs = runs if wanted_runs is None else [run for run in recording.runs if run.id in wanted_runs]
    wanted = diagram.free if free is None else tuple(free)
    diagram = replace(diagram, free=wanted)
    chosen = tuple(recording.select("identify") if runs is None else runs)
    with one_thread():  # many small matrices: threads cost more than they save
        found = tuple(harmonics_of(recording, chosen) if harmonics is None else harmonics)
        warnings += contradictions(found)

        def opened_with(diagram: Diagram) -> Likelihood:
            experiment = open_experiment(diagram, recording, runs=chosen, given=given, harmonics=found)
            if not given:
                refuse_sampled(experiment.model, "identification with the loop closed")
            return Likelihood(experiment)

        regression, refined = None, list[str]()
        if method == "regression":
            regression = open_regression(
                diagram, recording, runs=chosen, free=free, orders=orders, reduction=reduction, harmonics=found
            )
            search = Search(regression)
            result = estimate(search)
        else:
            fitted, refined = on_fine_meshes(diagram, fit_harmonics(diagram, opened_with))
            diagram, search, result = fitted.diagram, fitted.search, fitted.estimate
        if method == "likelihood" and harmonics is None and not result.adequate:
            without, picked = with_pickups(recording, found, find_mains(recording, found))
            if picked:
                found = without
                fitted, further = on_fine_meshes(diagram, fit_harmonics(diagram, opened_with))
                diagram, search, result = fitted.diagram, fitted.search, fitted.estimate
                told = {note.partition(":")[0] for note in further}
                refined = [*(note for note in refined if note.partition(":")[0] not in told), *further]
                treated = "it is fitted beside the harmonics"
                warnings += pickup_warnings(picked, recording, "is asynchronous", treated)
        warnings += [Problem(note, severity="warning") for note in refined]
        contradicted = [] if regression is not None else contradictions_of(diagram, fitted, settings_of(chosen))
        adequate = method == "regression" or result.adequate
        widen = 1.0 if adequate else result.widening
        covariance = result.covariance * widen**2
        if regression is not None:
            scatter = scatter_of(regression, search, result)
            covariance, adequate = scatter.covariance, scatter.adequate
            result = with_covariance(result, covariance)
            intervals = _about(result, np.sqrt(np.diag(covariance)), scatter.bias)
        elif profile:
            intervals = profile_intervals(search, result, widen)
        else:
            intervals = _stretched(result, linear_intervals(search, result), widen)
        verdicts = judge(result, intervals, precision=precision, widen=widen if method == "likelihood" else 1.0)
        left = [item.name for item, verdict in zip(result.free, verdicts, strict=True) if not verdict.identifiable]
        advice: list[Advice] = []
        experiment = search.likelihood.experiment
        if left and method == "likelihood" and experiment.motion.is_linear:
            advice = advise(experiment, result, left, precision)
        used = given if method == "likelihood" else tuple(dict.fromkeys(n.partition("[")[0] for n in experiment.given))
        fit, floor = _scores(diagram, recording, found, hold_out, result, used)
    kept = {item.name for item in result.free}
    warnings += [
        Problem("is left out: no block follows it", f"identify.{item.name}", severity="warning")
        for item in wanted
        if item.name not in kept
    ]
    std = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.nan_to_num(covariance / np.outer(std, std))
    if method == "likelihood":
        reach = np.abs(intervals - result.theta[:, None]).max(axis=1) / Z90
        std = np.where(result.at_bound, reach, np.where(result.undetermined, np.inf, std))
    joint = _stretched(result, intervals, joint_factor(correlation))
    parameters = {
        item.name: Identified(
            item.name,
            float(result.theta[j]),
            float(std[j]),
            (float(intervals[j, 0]), float(intervals[j, 1])),
            (max(float(joint[j, 0]), item.low), min(float(joint[j, 1]), item.high)),
            item.unit,
            verdicts[j],
            bool(result.at_bound[j]),
        )
        for j, item in enumerate(result.free)
    }
    goodness = result.goodness if method == "likelihood" else None
    excess = result.excess if method == "likelihood" else None
    return HarmonicIdentification(
        method=method,
        parameters=parameters,
        correlation=correlation,
        fit=fit,
        noise_floor=floor,
        goodness=goodness,
        excess=excess,
        adequate=adequate and not is_contradicted(contradicted),
        statement=with_contradictions(_statement(method, parameters, adequate, result, advice), contradicted, adequate),
        advice=tuple(advice),
        warnings=(*warnings, *contradicted),
        diagram=diagram,
        sha256=sha256,
        runs=found,
        settings={"given": list(used), "orders": list(orders), "reduction": reduction, "precision": precision},
        free=result.free,
    )


def _checked(recording: Recording) -> list[Problem]:
    """Return the warnings about a recording. Raises RotorsimError with its errors: the data are at fault."""
    problems = [*recording.warnings, *check_signals(recording)]
    if any(problem.severity == "error" for problem in problems):
        raise RotorsimError(*problems, exit_code=1)
    return problems


def _stretched(result: Estimate, intervals: np.ndarray, by: float) -> np.ndarray:
    """Return intervals (m, 2) about the estimate made wider or narrower, within the physical bounds."""
    every = zip(result.free, result.theta.tolist(), intervals.tolist(), strict=True)
    ends = np.array([[stretched(item, value, end, by) for end in own] for item, value, own in every])
    return np.asarray(np.clip(ends, result.coordinates.low[:, None], result.coordinates.high[:, None]))


def _about(result: Estimate, std: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Return intervals (m, 2) about the estimate, on the side of a bias wide enough to hold the unbiased value."""
    low = result.theta - Z90 * std - np.maximum(bias, 0)
    high = result.theta + Z90 * std - np.minimum(bias, 0)
    return np.column_stack([low, high])


def _scores(
    diagram: Diagram,
    recording: Recording,
    found: Sequence[RunHarmonics],
    hold_out: Recording | None,
    result: Estimate,
    given: Sequence[str],
) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """Return NRMSE per signal of the runs identified from and of those held out, and the noise floor."""
    sets: list[tuple[str, Recording, Sequence[RunHarmonics]]] = [("identify", recording, found)]
    outside = recording.select("hold_out")
    if outside:
        sets.append(("hold_out", recording, harmonics_of(recording, outside)))
    if hold_out is not None:
        sets.append(("hold_out", hold_out, harmonics_of(hold_out)))
    squares: dict[str, dict[str, np.ndarray]] = {}
    for use, source, runs in sets:
        scored = open_experiment(
            diagram, source, runs=[item.run for item in runs], given=given, free=result.free, harmonics=runs
        )
        likelihood = Likelihood(scored)
        Y = likelihood.evaluate(result.theta).Y
        for r, item in enumerate(runs):
            columns = scored.columns[r][: len(scored.predicted)]
            difference = np.abs(Y[r] - likelihood.data[r][:, : len(scored.predicted)]) ** 2
            wrong = difference[0] * scored.use_mean[: len(scored.predicted)] + 2 * difference[1:].sum(axis=0)
            for c, name in enumerate(scored.predicted):
                port = name.partition("[")[0]
                left, total = item.fit.residual[columns[c]] ** 2, item.fit.rms[columns[c]] ** 2
                sums = squares.setdefault(use, {}).setdefault(port, np.zeros(3))
                sums += (left + wrong[c], left, total)
    fit = {
        use: {p: float(np.sqrt(s[0] / s[2])) for p, s in ports.items() if s[2] > 0} for use, ports in squares.items()
    }
    floor = {p: float(np.sqrt(s[1] / s[2])) for p, s in squares["identify"].items() if s[2] > 0}
    return fit, floor


def _statement(
    method: str, parameters: Mapping[str, Identified], adequate: bool, result: Estimate, advice: Sequence[Advice]
) -> str:
    """Return what was found in plain words."""
    tried = "gains, speeds, length or excitation" if method == "likelihood" else ""
    parts = sentences(parameters, advice, tried)
    if not adequate and method == "regression":
        parts.append(
            "The model does not explain the data: the residual of the equations is larger than noise can make; the "
            "intervals mean nothing. something is missing in it."
        )
    elif not adequate:
        parts.append(
            f"The model does not explain the data: the residual has {result.excess:.3g} times the variance of the "
            f"noise, so something is missing in it; the intervals are widened by {np.sqrt(result.excess):.2g}, and "
            "hold only if what is missing does not matter to a parameter."
        )
    return " ".join(parts if adequate else [parts[-1], *parts[:-1]])
