"""The diagnosis of recordings in time: the same steps as for a shaft, on the errors of simulated runs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from threadpoolctl import threadpool_limits

from rotorsim.diagnose import diagnosis as steps
from rotorsim.diagnose.base import base_fit
from rotorsim.diagnose.fitting import Fit, Source
from rotorsim.diagnose.naming import Named, name_missing, values_in
from rotorsim.diagnose.scoring import Held
from rotorsim.diagnose.time_data import TimeRun, read_run
from rotorsim.diagnose.time_reference import judged_by, open_time_source
from rotorsim.diagnose.time_scoring import TimeScore, left_out_in_time, score_in_time
from rotorsim.diagnose.time_source import TimeSource
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.registry import Registry
from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.recording import Recording
from rotorsim.units import format_quantity

__all__ = ["diagnose_in_time"]

SURPASSED = 0.5  # of the variance that the flexible model leaves: a fit that leaves less takes its place


def diagnose_in_time(
    diagram: Diagram,
    recording: Recording,
    *,
    hold_out: Recording | None = None,
    physics: Collection[str] | None = None,
    warnings: Sequence[Problem] = (),
    trust_blocks: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> steps.Diagnosis:
    """Return what a diagram lacks to explain a recording that is no settled motion of a shaft.

    See `rotorsim.diagnose.diagnosis.diagnose`; what noise is, and what is adequate: `rotorsim.diagnose.time_source`.
    Raises RotorsimError for recordings that do not fit the diagram.
    """
    registry = _registry(diagram, trust_blocks)
    with threadpool_limits(1, "blas"):
        source = open_time_source(diagram, recording, trust_blocks=trust_blocks)
        held = _held(diagram, source, recording, hold_out)
        base, refined = base_fit(diagram, cast(Source, source))
    if base.failure:
        raise RotorsimError(Problem(base.failure, diagram.name))
    options: dict[str, Any] = {
        "registry": registry, "physics": physics, "workers": workers, "scheduler": scheduler, "progress": progress,
    }  # fmt: skip
    named = name_missing(base, cast(Source, source), **options)
    if named.chosen and _surpasses(named.fit):
        with threadpool_limits(1, "blas"):
            source = judged_by(source, named.fit)
            base = source.fit(base.document, [[base.values]])
        named = name_missing(base, cast(Source, source), **options)
    effects = tuple(steps._effect(item, found) for item, found in zip(named.chosen, named.rounds, strict=False))
    with threadpool_limits(1, "blas"):
        after, before = _with_shapes(named, source), named.base
        if named.chosen and _surpasses(after):  # what it leaves is the better measure of the noise
            source = judged_by(source, after)
            after, before = (source.fit(fit.document, [[fit.values]]) for fit in (after, before))
        documents = [values_in(fit.document, fit.values) for fit in (before, after)]
        scores = [score_in_time(d, source, held) if held else left_out_in_time(d, source) for d in documents]
    effects = tuple(replace(item, candidate=replace(item.candidate, fit=after)) for item in effects)
    verdict = steps._verdict(named, effects)
    found = steps.Diagnosis(
        verdict=verdict,
        effects=effects,
        places=steps._places(named, effects),
        rejected=steps._rejected(named, effects),
        before=before,
        after=after,
        document=documents[1],
        score_before=scores[0],
        score_after=scores[1],
        next_experiment="",
        statement="",
        named=named,
        warnings=(*warnings, *(Problem(note, severity="warning") for note in refined)),
        detectable=steps._detectable(named) if verdict == "consistent" else {},
        source=cast(Source, source),
        held=tuple(Held(part, ()) for part in (recording, hold_out) if part is not None) if held else (),
    )
    from rotorsim.diagnose.wording import next_experiment, statement

    found = replace(found, next_experiment=next_experiment(found))
    said = statement(found).replace("runs left out one by one", "stretches left out one by one")
    text = " ".join([said, *_errors(source, found, held), *_controllers(source, found)])
    return replace(found, statement=text)


def _surpasses(fit: Fit) -> bool:
    return fit.misfit < SURPASSED * fit.freedom


def _registry(diagram: Diagram, trust_blocks: bool) -> Registry:
    folders = diagram.document.get("block_folders", []) if trust_blocks and diagram.file else []
    return Registry([Path(diagram.file).parent / name for name in folders])


def _held(
    diagram: Diagram, source: TimeSource, recording: Recording, hold_out: Recording | None
) -> tuple[TimeRun, ...]:  # fmt: skip
    runs = [*recording.select("hold_out"), *(hold_out.runs if hold_out is not None else ())]
    return tuple(read_run(diagram, run, source.channels) for run in runs)


def _with_shapes(named: Named, source: TimeSource) -> Fit:
    """Return the fit with what the faults state once (the width of a step) free as well, if that explains more."""
    document = {**named.fit.document, "identify": dict(named.fit.document.get("identify", {}))}
    fixed = [f"{item.insertion.name}.{key}" for item in named.chosen for key in item.insertion.fault.fixed]
    if not fixed:
        return named.fit
    document = values_in(document, named.fit.values)
    document["identify"] = {**document["identify"], **{name: {} for name in fixed}}
    found = source.fit(document, [[{}]])
    better = not found.failure and found.criterion < named.fit.criterion
    return found if better and not found.at_bound[-len(fixed) :].any() else named.fit


def _errors(source: TimeSource, found: steps.Diagnosis, held: Sequence[TimeRun]) -> list[str]:
    """Return what the errors are in the units of the signals."""
    before, after = (score for score in (found.score_before, found.score_after) if isinstance(score, TimeScore))
    units = {name: source.recording.channels[column].unit for name, column in source.channels.columns.items()}
    where = "Held-out runs" if held else "Stretches left out"
    text = []
    for name, value in before.rms.items():
        later = after.rms.get(name)
        plain = "" if units[name] in ("", "1") else units[name]
        after_text = f", {format_quantity(later, plain)} after" if later is not None and found.effects else ""
        text.append(f"{name} {format_quantity(value, plain)} rms{after_text}")
    return [f"{where}, error of the simulation: {'; '.join(text)}."] if text else []


def _controllers(source: TimeSource, found: steps.Diagnosis) -> list[str]:
    """Return how well controllers follow from what was measured of the motion, without the rest of the loop."""
    text = []
    for (view, name), value in source.variance.items():
        if view:
            signal = np.concatenate([run.values[name] for run in source.runs])
            share = 100 * np.sqrt(value) / signal.std()
            text.append(
                f"{name} follows from the measured motion by the law of {view} to {share:.2g} %, whatever moves."
            )
    return text
