"""Runs of a recording as samples in time: settings, instants, and what to do where samples are missing.

Simulations go from instant to instant, so that jitter costs nothing. An output that is missing is not compared. An
input that is missing is bridged where that is good (`rotorsim.identification.waveform.recorded.gaps`); elsewhere the
run is cut, and what follows begins with states of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.recorded.data import SMOOTH_KIND, STABLE_STEP, Channels, SampledRun
from rotorsim.identification.waveform.recorded.gaps import bridged, even_time, with_lost_rows
from rotorsim.recordings.orders import OrderRun
from rotorsim.recordings.recording import Run
from rotorsim.signals.dropped_samples import dropped_samples

LEAST_PART = 20  # of a part of a run between gaps: fewer say little beside the unknown states that they begin with


def read_runs(diagram: Diagram, runs: Sequence[Run], channels: Channels) -> tuple[SampledRun, ...]:
    """Return the samples of runs, those cut into parts where an input is unknown.

    Raises RotorsimError for settings that are not numbers, time that does not rise, and runs that nothing is known of.
    """
    read: list[tuple[SampledRun, ...]] = []
    problems: list[Problem] = []
    for run in runs:
        try:
            read.append(_read(diagram, run, channels))
        except RotorsimError as error:
            problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return tuple(chain(*read))


def notes_of(runs: Sequence[SampledRun]) -> list[Problem]:
    """Return what of the recording is not used or was filled in, as warnings, each once."""
    return list(dict.fromkeys(note for run in runs for note in run.notes))


def marked(channels: Channels, runs: Sequence[SampledRun]) -> Channels:
    """Return channels without outputs that no run measured, and which of the others miss samples in some run.

    Where a shaft turns as recorded, structures are simulated up to modes that are followed from sample to sample.
    """
    there = {name: [np.isfinite(run.values[name]) for run in runs] for name in channels.outputs}
    measured = tuple(name for name, known in there.items() if any(some.any() for some in known))
    gaps = (name for name in measured if not all(some.all() for some in there[name]))
    turns = SMOOTH_KIND in channels.kinds.values()
    longest = max((float(np.diff(run.time).max()) for run in runs), default=np.inf)
    return replace(channels, outputs=measured, gappy=frozenset(gaps), fastest=STABLE_STEP / longest if turns else None)


def _read(diagram: Diagram, run: Run, channels: Channels) -> tuple[SampledRun, ...]:
    settings, problems = settings_of(diagram, run)
    time = np.asarray(run.time)
    if len(time) < 2 or not np.isfinite(time).all() or not (np.diff(time) > 0).all():
        problems.append(Problem("its time does not rise from sample to sample", f"run {run.id}", run.place))
    known = {name: run.values[c] for name, c in channels.columns.items() if c in run.values}
    known = {name: values for name, values in known.items() if np.isfinite(values).any()}
    for name in channels.inputs:
        stated = settings.get(f"{name.partition('[')[0].rpartition('.')[0]}.value")
        if name not in known and stated is not None and np.ndim(stated) == 0:
            known[name] = np.full(len(time), float(stated))
        elif name not in known:
            block = name.rpartition(".")[0]
            what = f"'{channels.columns[name]}', which drives the diagram, was not measured"
            hint = f'if it was constant, say so: "set": {{"{block}.value": 0}}'
            problems.append(Problem(what, f"run {run.id}", run.place, hint))
    if not any(name in known for name in channels.outputs):
        what = "nothing was measured that the diagram could be compared with"
        problems.append(Problem(what, f"run {run.id}", run.place))
    if problems:
        raise RotorsimError(*problems)
    even = even_time(time)
    instants, recorded = (even, np.ones(len(time), bool)) if even is not None else with_lost_rows(time)
    even = even_time(instants)
    values = {name: np.full(len(instants), np.nan) for name in channels.columns}
    for name, samples in known.items():
        values[name][recorded] = np.where(np.isfinite(samples), samples, np.nan)
    instants = instants if even is None else even
    notes = _without_dropped(run, values, channels) if SMOOTH_KIND in channels.kinds.values() else []
    whole = SampledRun(run.id, values, channels.kinds, instants, settings, floating=channels.floating)
    first, *others = _in_parts(whole, run, channels, recorded)
    return replace(first, notes=(*first.notes, *notes)), *others


def _without_dropped(run: Run, values: dict[str, np.ndarray], channels: Channels) -> list[Problem]:
    """Take out, in place, samples that repeat the one before in all outputs, and return notes on them.

    Of a shaft that turns: a plant at rest repeats itself.
    """
    measured = [name for name in channels.outputs if np.isfinite(values[name]).any()]
    y = np.nan_to_num(np.stack([values[name] for name in measured], axis=1))
    dropped = dropped_samples(y, np.zeros_like(y))
    for name, lost in zip(measured, dropped.T, strict=True):
        values[name] = np.where(lost, np.nan, values[name])
    count = int(dropped.any(axis=1).sum())
    what = f"{count} of {len(run.time)} samples repeat the one before in all channels, and are not compared"
    return [_note(run, what, "the recorder dropped them")] if count else []


def settings_of(diagram: Diagram, run: Run | OrderRun) -> tuple[dict[str, Any], list[Problem]]:
    """Return the settings of a run as numbers, and what is wrong with them."""
    blocks = ((name, node.block.parameters) for name, node in diagram.nodes.items())
    units: Mapping[str, Any] = {
        **{f"{name}.{key}": declared.unit for name, parameters in blocks for key, declared in parameters.items()},
        **diagram.parameter_units,
    }
    settings: dict[str, Any] = {}
    problems: list[Problem] = []
    for name, value in run.settings.items():
        try:
            settings[name] = numeric(value, units.get(name))
        except ValueProblem as problem:
            problems.append(Problem(problem.what, f"run {run.id}: set {name}", run.place, problem.hint))
    return settings, problems


def _in_parts(whole: SampledRun, run: Run, channels: Channels, recorded: np.ndarray) -> Iterator[SampledRun]:
    """Yield the parts of a run in which all inputs are known, the first with notes on all."""
    notes = list(_missing_outputs(run, channels))
    values = dict(whole.values)
    for name in channels.inputs:
        filled = bridged(whole.time, values[name], channels.kinds[name])
        values[name] = filled.values
        if filled.filled:
            share = 100 * filled.error / max(float(np.nanstd(values[name])), 1e-300)
            what = f"{filled.filled} missing samples of {channels.columns[name]} are filled in"
            notes.append(_note(run, f"{what}: good to {share:.2g} % of its standard deviation, as other samples are"))
        if whole.steps is not None and channels.kinds[name] == "band_limited":
            what = f"{channels.columns[name]} goes between uneven samples on a cubic spline, not band-limited"
            notes.append(_note(run, what, "even samples carry all that lies below half the sample rate"))
    whole = replace(whole, values=values)
    known = np.isfinite([values[name] for name in channels.inputs]).all(axis=0) | np.zeros(whole.size, bool)
    edges = np.diff(np.concatenate([[0], known.astype(int), [0]]))
    parts = []
    for first, last in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True):
        used = np.flatnonzero(whole.counted[first:last])
        if len(used):
            parts.append(slice(int(first + used[0]), int(first + used[-1]) + 1))
    alone = len(parts) == 1
    kept = parts if alone else [part for part in parts if part.stop - part.start >= LEAST_PART]
    inside = np.zeros(whole.size, bool)
    for part in kept:
        inside[part] = True
    lost = int((whole.counted & recorded & ~inside).sum())
    if not alone:
        gaps = f"{len(parts) - 1} gap{'s' * (len(parts) > 2)}"
        what = f"is cut at {gaps} of what drives it, and begins anew behind each"
        notes.append(_note(run, what))
    if lost:
        what = f"{lost} of {len(run.time)} samples are not used, for what drives the diagram is not known there"
        notes.append(_note(run, what))
    if not kept:
        hint = f"stretches of {LEAST_PART} samples in which all inputs were recorded are needed"
        raise RotorsimError(Problem("what drives the diagram is hardly ever known", f"run {run.id}", run.place, hint))
    for k, part in enumerate(kept):
        name = run.id if alone else f"{run.id} from {whole.time[part.start]:.6g} s"
        yield replace(whole.part(part), id=name, notes=tuple(notes) if k == 0 else ())


def _missing_outputs(run: Run, channels: Channels) -> Iterator[Problem]:
    """Yield warnings about outputs that are not there."""
    for name in channels.outputs:
        column = channels.columns[name]
        if column not in run.values:
            yield _note(run, f"{column} was not measured in this run, and is not compared")
            continue
        missing = int((~np.isfinite(run.values[column])).sum())
        if missing:
            yield _note(run, f"{missing} of {len(run.time)} samples of {column} are missing, and are not compared")


def _note(run: Run, what: str, hint: str = "") -> Problem:
    return Problem(what, f"run {run.id}", run.place, hint, "warning", "missing_samples")
