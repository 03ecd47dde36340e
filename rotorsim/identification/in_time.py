"""From a diagram and samples in time to parameters: output error, with robust intervals and the next experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.diagram.resolve.settings import with_finer_mesh
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.identification.advice import Advice
from rotorsim.identification.advice_in_time import TRIED, advise_in_time
from rotorsim.identification.held import Estimated, contradictions_of, is_contradicted, settings_of, with_contradictions
from rotorsim.identification.meshes import on_fine_meshes
from rotorsim.identification.result import Identification, Identified, identified, sentences
from rotorsim.identification.verdict import judge
from rotorsim.identification.waveform.differences import by_differences
from rotorsim.identification.waveform.driven.equations import clock_ports
from rotorsim.identification.waveform.errors import errors_of
from rotorsim.identification.waveform.estimate import TimeEstimate, time_estimate
from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.late_pulses import OnTime, held_on_time, on_time
from rotorsim.identification.waveform.noise import weights_of
from rotorsim.identification.waveform.noise_model import SIMULATION_DIVERGES, NoiseModel, noise_model
from rotorsim.identification.waveform.recorded.along_angle import (
    along_angle,
    turns_as_recorded,
    unused_channels,
    with_reaction,
)
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun, channels_of, chosen_runs
from rotorsim.identification.waveform.recorded.reading import marked, notes_of, read_runs
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import WHOLE_DIAGRAM, subsystems_of
from rotorsim.jobs.threads import one_thread, own_cores, threads
from rotorsim.recordings.recording import Recording, Run

TURNING = ("missing_channel", "no_phase_reference")  # codes of findings that matter only of a shaft that turns


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """A run beside the identified diagram: simulated {output: (N,)}, SI; use: "identify" or "hold_out"."""

    run: SampledRun
    use: str
    simulated: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class TimeIdentification(Identification):
    """What samples in time say; units: of the outputs, as they were recorded."""

    runs: tuple[SimulatedRun, ...] = ()
    units: Mapping[str, str]

    _beside = "rotorsim.report.identification.samples:sample_figures"

    @property
    def run_ids(self) -> list[str]:
        """The runs that were identified from, in parts where what drives them is not known throughout."""
        return [item.run.id for item in self.runs if item.use == "identify"]

    def misfit_data(self) -> dict[str, Any]:
        """Return how large the residual is, in the form of identification.json."""
        return {"excess_variance": self.excess}


def identify_in_time(
    diagram: Diagram,
    recording: Recording,
    *,
    method: str,
    given: Sequence[str],
    free: Sequence[Free] | None,
    runs: Sequence[Run] | None,
    precision: float,
    hold_out: Recording | None,
    warnings: Sequence[Problem],
) -> TimeIdentification:
    """Estimate the free parameters of a diagram from samples in time, by output error; see `identify`.

    Raises RotorsimError for another method, measured inputs, channels, units or settings that the diagram does not
    have, nothing that is free, and where the diagram diverges when it is driven as recorded.
    """
    wanted = diagram.free if free is None else tuple(free)
    _refuse(diagram, method, given, wanted)
    names = None if runs is None else {run.id for run in runs}
    as_given = diagram
    turns = turns_as_recorded(diagram, recording)
    if turns:
        diagram = with_reaction(diagram)
        warnings = [*warnings, *diagram.warnings[len(as_given.warnings) :]]
    warnings = [*warnings, *unused_channels(diagram, recording)]
    made, recording = recording, along_angle(diagram, recording)
    held = [(made, recording.select("hold_out"))]
    held += [] if hold_out is None else [(hold_out, along_angle(diagram, hold_out).runs)]
    channels = channels_of(diagram, recording)
    chosen = chosen_runs(recording) if names is None else [run for run in recording.runs if run.id in names]
    sampled = read_runs(diagram, chosen, channels)
    channels = marked(channels, sampled)
    diagram = replace(diagram, free=wanted)
    with one_thread(), threads(own_cores()):
        timed = on_time(diagram, channels, sampled, made)
        estimate = _estimated(diagram, channels, timed, timed.noise.near)
        fitted = _Fitted(diagram, channels, timed, estimate)
        fitted, refined = on_fine_meshes(diagram, fitted)
        diagram, timed, estimate = fitted.diagram, fitted.timed, fitted.widened
        contradicted = contradictions_of(diagram, fitted, settings_of(chosen))
        sampled, noise = timed.runs, timed.noise
        held_out = held_on_time(diagram, channels, held, timed)
        verdicts = judge(estimate, estimate.intervals, precision=precision)
        left = [item.name for item, one in zip(estimate.free, verdicts, strict=True) if not one.identifiable]
        advice = advise_in_time(estimate, noise, channels, left, precision) if left else []
        scored = _held(estimate, channels, held_out, noise)
    variance = {name: noise.variance[WHOLE_DIAGRAM, name] for name in channels.outputs}
    errors = errors_of(estimate.search, [(estimate.evaluation, [slice(None)] * len(sampled))])
    fit = {"identify": errors.nrmse if errors else {}}
    notes = [*(one for one in warnings if turns or one.code not in TURNING), *notes_of([*sampled, *held_out])]
    notes += [*(Problem(note, severity="warning") for note in refined), *contradicted]
    if scored is not None:
        search, evaluation = scored
        held_errors = errors_of(search, [(evaluation, [slice(None)] * len(held_out))])
        if held_errors is None:
            notes.append(Problem(f"{SIMULATION_DIVERGES} in the hold-out runs", diagram.name, severity="warning"))
        else:
            fit["hold_out"] = held_errors.nrmse
    kept = {item.name for item in estimate.free}
    notes += [
        Problem("is left out: no block follows it", f"identify.{item.name}", severity="warning")
        for item in wanted
        if item.name not in kept
    ]
    parameters, correlation = identified(estimate, verdicts)
    return TimeIdentification(
        method=method,
        parameters=parameters,
        correlation=correlation,
        fit=fit,
        noise_floor=errors.floor(variance) if errors else {},
        excess=estimate.excess,
        adequate=estimate.adequate and not is_contradicted(contradicted),
        statement=with_contradictions(_statement(parameters, estimate, advice), contradicted, estimate.adequate),
        advice=tuple(advice),
        warnings=tuple(notes),
        diagram=diagram,
        sha256=as_given.sha256,
        settings={"precision": precision, "steps_between_samples": estimate.evaluation.sub},
        free=estimate.free,
        runs=(
            *_simulated(estimate.search, estimate.evaluation, "identify"),
            *(_simulated(*scored, "hold_out") if scored is not None else ()),
        ),
        units={name: recording.channels[channels.columns[name]].unit for name in channels.outputs},
    )


def _refuse(diagram: Diagram, method: str, given: Sequence[str], wanted: Sequence[Free]) -> None:
    """Raise RotorsimError for what makes no sense in time."""
    problems = []
    if method != "likelihood":
        what = f"method '{method}' is of harmonics at steady speeds, and nothing turns so here"
        problems.append(Problem(what, diagram.name, hint="--method likelihood: in time it is output error"))
    if given:
        what = f"{', '.join(given)} cannot be taken as measured in time"
        hint = "put a block 'recorded' in the place of what makes it, and let the channel name that block"
        problems.append(Problem(what, diagram.name, hint=hint))
    if not wanted:
        hint = 'add "identify": {"block.parameter": {}, ...} to the diagram'
        problems.append(Problem("no free parameters", diagram.name, Place(diagram.file), hint))
    if problems:
        raise RotorsimError(*problems)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A diagram fitted to runs."""

    diagram: Diagram
    channels: Channels
    timed: OnTime
    estimate: TimeEstimate

    def change(self, block: str, parts: int) -> float:
        """Return the square of what a finer mesh changes in the whitened prediction."""
        search, diagram = self.estimate.search, with_finer_mesh(self.diagram, block, parts)
        finer = replace(search, systems=subsystems_of(diagram, self.channels))
        return search.change(self.estimate.evaluation, finer)

    def finer(self, block: str, parts: int) -> _Fitted:
        """Return the fit with a finer mesh, from where this one ended. Raises RotorsimError.

        Hum and the time by which pulses are late, found beside the coarser mesh, stay.
        """
        diagram, near = with_finer_mesh(self.diagram, block, parts), replace(self.timed.noise, starts={})
        noise = noise_model(diagram, self.channels, self.timed.runs, near)
        timed = replace(self.timed, noise=noise)
        estimate = _estimated(diagram, self.channels, timed, noise.near)
        return replace(self, diagram=diagram, timed=timed, estimate=estimate)

    def worse_by(self, other: _Fitted) -> float:
        """Return how much more another fit leaves, weighted as here."""
        search = self.estimate.search
        return search.squares(other.estimate.evaluation) - search.squares(self.estimate.evaluation)

    def freed(self, more: Sequence[Free] = ()) -> Estimated:
        """Return what is estimated with more parameters free, from where this fit ended. Raises RotorsimError."""
        found = self.widened
        if more:
            near = dict(zip((item.name for item in found.free), found.theta.tolist(), strict=True))
            diagram = replace(self.diagram, free=(*self.diagram.free, *more))
            found = self._wider(_estimated(diagram, self.channels, self.timed, near))
        return Estimated(found.free, found.theta, found.std, found.at_bound, found.misfit)

    @cached_property
    def widened(self) -> TimeEstimate:
        """The estimate with what is not known of pulses and of the angle."""
        return self._wider(self.estimate)

    def _wider(self, found: TimeEstimate) -> TimeEstimate:
        return replace(found, robust=found.robust + self.timed.angle.covariance(found.search, found.evaluation))


def _estimated(diagram: Diagram, channels: Channels, timed: OnTime, near: Mapping[str, float]) -> TimeEstimate:
    """Return the estimate of what is free in a diagram, from values ``near`` by name."""
    noise = timed.noise
    weights = weights_of(noise.variance, timed.runs, noise.rows)
    search = OutputErrorSearch(subsystems_of(diagram, channels), timed.runs, weights, noise.least)
    _refuse_unseen(search, diagram)
    found = search.minimise(search.stated(search.first(noise.starts), near)).reached()
    if search.limited and not clock_ports(diagram):
        found = by_differences(search, found)
    return time_estimate(search, found, noise)


def _refuse_unseen(search: OutputErrorSearch, diagram: Diagram) -> None:
    """Raise RotorsimError where nothing that is measured depends on any free parameter."""
    if not search.free:
        what = "what was measured depends on none of the free parameters"
        raise RotorsimError(Problem(what, diagram.name, Place(diagram.file), "measure a signal behind them"))


def simulation_of(
    estimate: TimeEstimate, runs: Sequence[SampledRun], noise: NoiseModel
) -> tuple[OutputErrorSearch, Evaluation]:
    """Return the identified diagram beside further runs, of which only the starts are searched."""
    weights = {signal: 1 / value for signal, value in noise.variance.items()}
    search = OutputErrorSearch(estimate.search.systems[:1], runs, weights, noise.least, hold="theta")
    start = search.first()
    start[: search.m] = estimate.theta
    return search, search.minimise(start)


def _held(
    estimate: TimeEstimate, channels: Channels, runs: Sequence[SampledRun], noise: NoiseModel
) -> tuple[OutputErrorSearch, Evaluation] | None:
    return simulation_of(estimate, runs, noise) if runs else None


def _simulated(search: OutputErrorSearch, evaluation: Evaluation, use: str) -> list[SimulatedRun]:
    """Return the outputs of the whole diagram in every run, where it does not diverge."""
    outputs = search.systems[0].equations.outputs
    found = []
    for r, run in enumerate(search.runs):
        y, _ = search.simulated(evaluation.unknowns, 0, r, evaluation.sub, sensitivities=False)
        found.append(SimulatedRun(run, use, dict(zip(outputs, y.T, strict=True))))
    return found


def _statement(parameters: Mapping[str, Identified], estimate: TimeEstimate, advice: Sequence[Advice]) -> str:
    """Return what was found in plain words."""
    parts = sentences(parameters, advice, TRIED)
    if estimate.adequate:
        return " ".join(parts)
    wrong = (
        f"The model does not explain the data: the residual has {estimate.excess:.3g} times the variance of what "
        "cannot be predicted of it, so something is missing in it; the intervals hold only if what is missing does "
        "not matter to a parameter. 'rotorsim diagnose' looks for it."
    )
    return " ".join([wrong, *parts])
