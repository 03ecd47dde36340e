"""A diagram driven as a run of a recording was: by the inputs and the shaft angle that were recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.driven.equations import DrivenEquations, driven_equations
from rotorsim.identification.waveform.driven.simulation import Simulation
from rotorsim.identification.waveform.errors import Errors, errors_of
from rotorsim.identification.waveform.noise import variance_scale
from rotorsim.identification.waveform.noise_model import SIMULATION_DIVERGES, refined
from rotorsim.identification.waveform.recorded.along_angle import along_angle, turns_as_recorded, with_reaction
from rotorsim.identification.waveform.recorded.data import RATE_PREFIX, Channels, SampledRun, channels_of
from rotorsim.identification.waveform.recorded.reading import marked, notes_of, read_runs
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.jobs.threads import one_thread
from rotorsim.linear import linearisation as linear
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.recordings.recording import Recording, Run
from rotorsim.simulation.result import Result

RUN_STARTS = ("estimated", "diagram")
MEASURED_PREFIX = "measured."  # before the names of measured signals in a result


@dataclass(frozen=True, eq=False)
class AsRecorded:
    """A diagram beside a run, and its errors.

    result: simulated signals by flat name, and what was measured of them as "measured." and the name, SI. outputs:
    those that were measured; units: of these, as recorded. starts: states at the first sample of each part of the run.
    sub: steps between samples.
    """

    run: str
    result: Result
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    errors: Errors
    starts: Mapping[str, float]
    sub: int
    warnings: tuple[Problem, ...] = field(default=())


def simulate_as_recorded(
    diagram: Diagram,
    recording: Recording,
    run: str | None = None,
    *,
    start: str = "estimated",
    record: Sequence[str] = (),
) -> AsRecorded:
    """Simulate a diagram driven by what a run recorded: inputs, settings, and the angle of a shaft that turns.

    run: its id; default the first. start: "estimated" (the states at the first sample that leave least), or "diagram"
    (as it says). record: further signals of the result, beside those that were measured and the diagram records.
    Raises RotorsimError for runs, channels, signals and settings that are not there, sampled blocks, a shaft whose
    angle nothing tells, and simulations that diverge.
    """
    if start not in RUN_STARTS:
        raise RotorsimError(Problem(f"no start '{start}'", hint=f"one of {', '.join(RUN_STARTS)}"))
    chosen = recording.run(run)
    given = diagram
    if turns_as_recorded(diagram, recording):
        diagram = with_reaction(diagram)
    recording = along_angle(diagram, recording, [chosen])
    channels = channels_of(diagram, recording)
    parts = read_runs(diagram, [recording.run(chosen.id)], channels)
    channels = marked(channels, parts)
    further = _further(compile_diagram(diagram), channels, [*map(str, diagram.record), *record])
    parts = tuple(_with_more(part, further) for part in parts)
    outputs = [*channels.outputs, *further]
    equations = driven_equations(diagram, outputs, channels.inputs, (), fastest=channels.fastest)
    with one_thread():
        search = OutputErrorSearch(
            (Simulation(equations),), parts, {}, hold="theta" if start == RUN_STARTS[0] else "starts"
        )
        scale = variance_scale(search)
        search = replace(search, weights={signal: 1 / value for signal, value in scale.items()})
        search, evaluation = refined(search, search.minimise(_first(search, start)), scale)
        if not np.isfinite(evaluation.cost):
            hint = "is the loop stable? are signs and units of what drives it right?"
            what = f"{SIMULATION_DIVERGES} when it is driven as run {chosen.id} was"
            raise RotorsimError(Problem(what, diagram.name, hint=hint), exit_code=1)
        simulated = [
            search.simulated(evaluation.unknowns, 0, r, evaluation.sub, sensitivities=False)[0]
            for r in range(len(parts))
        ]
    errors = errors_of(search, [(evaluation, [slice(None)] * len(parts))])
    assert errors is not None
    size = len(channels.outputs)
    return AsRecorded(
        chosen.id,
        _result(equations, parts, np.concatenate(simulated), channels.outputs, (diagram.name, recording.name, chosen)),
        channels.outputs,
        {name: recording.channels[channels.columns[name]].unit for name in channels.outputs},
        Errors(channels.outputs, errors.squares[:size], errors.totals[:size], errors.samples[:size]),
        {state: float(x) for (_, state, r), x in search.starts(evaluation.unknowns).items() if r == 0},
        evaluation.sub,
        (*recording.warnings, *diagram.warnings[len(given.warnings) :], *notes_of(parts)),
    )


def _first(search: OutputErrorSearch, start: str) -> np.ndarray:
    """Return the states at the first samples: as the diagram has them, or for a search, measured ones as measured."""
    equations = search.systems[0].equations
    stated = [equations.model.x0(p)[equations.kept] for p in search.p]
    return search.first() if start == RUN_STARTS[0] else np.concatenate(stated)


# -- signals -----------------------------------------------------------------------------------------------------------


def _further(model: Model, channels: Channels, names: Sequence[str]) -> list[str]:
    """Return the flat names of signals to be recorded that nobody measured.

    Raises RotorsimError for signals that the diagram does not have.
    """
    wanted: list[str] = []
    problems: list[Problem] = []
    for name in names:
        try:
            wanted += linear.flat_names(model, name)
        except RotorsimError as error:
            problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    known = {*channels.outputs, *channels.inputs}
    return [name for name in dict.fromkeys(wanted) if name not in known]


def _with_more(part: SampledRun, names: Sequence[str]) -> SampledRun:
    """Return a run with room for signals that were not measured."""
    return replace(part, values={**part.values, **{name: np.full(part.size, np.nan) for name in names}})


def _result(
    equations: DrivenEquations,
    parts: Sequence[SampledRun],
    simulated: np.ndarray,
    measured: Sequence[str],
    what: tuple[str, str, Run],
) -> Result:
    """Return simulated and measured signals of all parts of a run."""
    diagram, recording, run = what
    signals = dict(zip(equations.outputs, simulated.T, strict=True))
    given = [name for name in equations.inputs if not name.startswith(RATE_PREFIX)]
    for prefix, names in (("", given), (MEASURED_PREFIX, measured)):
        signals |= {prefix + name: np.concatenate([part.values[name] for part in parts]) for name in names}
    units = {}
    for name in signals:
        port = equations.model.diagram.as_measured(name.removeprefix(MEASURED_PREFIX)).partition("[")[0]
        signal = equations.model.signals.get(port)
        units[name] = "" if signal is None or signal.unit is None else signal.unit
    provenance = {"diagram": diagram, "recording": recording, "run": run.id, "file": run.file}
    return Result(np.concatenate([part.time for part in parts]), signals, units, provenance=provenance)
