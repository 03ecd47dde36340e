"""Simulate many runs of one diagram, which differ in parameters and initial states."""

from __future__ import annotations

import base64
import hashlib
import json
import time as clock
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.jobs import Jobs, run_jobs
from rotorsim.jobs.threads import one_thread
from rotorsim.model.compiled import Model, model_for_runs
from rotorsim.model.load import load
from rotorsim.simulation.ensemble.batch import REFUSED, Outcome, Runner, Values, joined
from rotorsim.simulation.ensemble.reductions import DEFAULT, Rows, Wanted
from rotorsim.simulation.ensemble.result import Ensemble
from rotorsim.simulation.ensemble.setup import Given, Varied, make_setup, varied_values
from rotorsim.simulation.ensemble.shared import Setup, recorded_columns
from rotorsim.simulation.run import provenance_of, without

STEPS_OF_A_JOB = 2.5e7  # steps times states: about 0.2 s, what an interrupted ensemble loses of each worker
STEPS_HERE = 3e8  # in this process: others take as long to start
GROUP = 8  # runs of a job are whole groups of so many, whatever the lanes of this processor
MOST_GROUPS = 32
_RUNNERS: dict[str, Runner] = {}  # of this process, by what decides them; the last few
_KEPT_RUNNERS = 4


def simulate_many(
    diagram: Diagram | Model,
    parameters: Mapping[str, Any] | None = None,
    *,
    stop: float | None = None,
    step: float | None = None,
    turns: float | None = None,
    reduce: Iterable[str] = DEFAULT,
    window: tuple[float, float] | None = None,
    record: Iterable[str] | None = None,
    record_every: int | None = None,
    method: str | None = None,
    initial: np.ndarray | None = None,
    angle: str | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    jobs: Jobs | None = None,
    store: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
    use_compiler: bool = True,
) -> Ensemble:
    """Simulate n runs and return what is kept of each; runs go side by side in the lanes of vectors, over all workers.

    parameters: name -> (n,) or (n, *shape) values in SI, or n texts with a unit; one value is that of all runs.
    stop, step [s], record, record_every, method: as in `simulate`. turns: instead of stop, how many turns of the shaft
    every run takes, at its constant speed; its step is then the largest part of a turn that is not above ``step`` in
    any run. reduce: kinds of `KINDS`, "harmonics=3" with a number. window: (from, to) [s], or in turns with ``turns``;
    default: the second half. initial: x (n_x,) or (n, n_x). angle: signal of the shaft angle (default: that of the
    clock of this name, or of the only one). scheduler, workers, store, progress: as in `run_jobs`; with a store an
    interrupted ensemble resumes. jobs: instead of scheduler and workers, processes that are kept (`local_workers`).

    Every run is what `simulate` gives for it, to the last bit, on whatever lane, worker or cluster. A run that diverges
    or is unstable is reported in ``status`` and ``message`` and stops no other. Raises RotorsimError for wrong
    arguments, and for what changes the equations (options, wires).
    """
    begun = clock.process_time()
    how = Jobs(workers, scheduler, progress) if jobs is None else replace(jobs, progress=progress)
    model = model_for_runs(diagram)
    varied = varied_values(model, parameters or {}, initial)
    given = Given(stop, step, turns, reduce, window, record, record_every, method, angle, use_compiler)
    setup, steps = make_setup(model, varied, given)
    runner = Runner(setup)
    starts = None if initial is None else np.broadcast_to(np.asarray(initial, float), (varied.n, model.n_x))
    work = setup.n_steps * max(model.n_x, 1)
    here = STEPS_OF_A_JOB if how.pool else STEPS_HERE
    if store is None and how.scheduler in (None, "synchronous") and work * varied.n <= here:
        with one_thread():
            outcome = runner.run(_runs(_argument(varied, steps, starts, slice(None))), progress)
    else:
        size = GROUP * min(max(int(STEPS_OF_A_JOB / work / GROUP), 1), MOST_GROUPS)
        parts = [slice(first, first + size) for first in range(0, varied.n, size)]
        arguments = [_argument(varied, steps, starts, part) for part in parts]
        text = _text(setup)
        _keep(text, runner)
        key = hashlib.sha256(text.encode()).hexdigest()
        answers = run_jobs(partial(_job, text), arguments, jobs=how, store=store, key=key)
        outcome = joined([_unpacked(answer) for answer in answers])
    _refuse_all(outcome)
    rows = setup.wanted.rows
    return Ensemble(
        varied.values,
        outcome.values,
        np.array(outcome.status),
        tuple(outcome.message),
        outcome.step_error,
        {name: model.select(name)[0].unit or "" for name in setup.names} | dict(varied.units),
        {name: model.shape_of(name) for name in setup.names},
        np.array([rows.window[0], rows.window[1] - 1]) * setup.every * steps[:, None],
        setup.n_steps * steps,
        steps,
        {
            "runs": varied.n,
            "steps": setup.n_steps,
            "rows": rows.n,
            "alone": outcome.alone,
            "cpu_seconds": clock.process_time() - begun,
        },
        {**provenance_of(model, model.p0), "varied": list(varied.values), "method": setup.method, "path": runner.path},
    )


def _refuse_all(outcome: Outcome) -> None:
    """Raise RotorsimError where every run was refused; where some were, these have stopped."""
    refused = [k for k, status in enumerate(outcome.status) if status == REFUSED]
    if refused and len(refused) == len(outcome.status):
        what, _, hint = outcome.message[0].partition("\n\nhint: ")
        raise RotorsimError(Problem(what, hint=hint))
    for k in refused:
        outcome.status[k] = "stopped"


# -- jobs --------------------------------------------------------------------------------------------------------------


def _argument(varied: Varied, steps: np.ndarray, starts: np.ndarray | None, part: slice) -> dict[str, Any]:
    """Return what tells the runs of one job apart, as plain data."""
    return {
        "parameters": {name: values[part] for name, values in varied.given.items()},
        "steps": steps[part].tolist(),
        "initial": None if starts is None else starts[part].tolist(),
    }


def _runs(argument: Mapping[str, Any]) -> list[Values]:
    return [
        Values(
            {name: values[k] for name, values in argument["parameters"].items()},
            step,
            None if argument["initial"] is None else np.array(argument["initial"][k]),
        )
        for k, step in enumerate(argument["steps"])
    ]


def _text(setup: Setup) -> str:
    """Return all that decides the runs of an ensemble but their own values, as JSON."""
    diagram, wanted = setup.model.diagram, setup.wanted
    loaded = {"folder": diagram.folder, "without": without(diagram), "trust_blocks": diagram.trusted}
    shared = {key: value for key, value in vars(setup).items() if key not in ("model", "wanted")}
    kept = {"kinds": wanted.kinds, "rows": [wanted.rows.n, *wanted.rows.window], "points": wanted.points}
    kept |= {"watched": [*wanted.columns.signals]}
    plain = {"document": diagram.document, "load": loaded, "setup": shared, "wanted": kept}
    return json.dumps(plain | {"code": _code(setup.model)}, default=str)


def _code(model: Model) -> list[str]:
    """Return what changes with files that a document only names: sub-diagrams, blocks of the user, FMUs."""
    from rotorsim import __version__

    trace, blocks = model.trace, [node.block for node in model.diagram.nodes.values()]
    fmus = [Path(str(block.option.file)) for block in blocks if block.opaque]
    if fmus:
        parts = [file.read_bytes() for file in fmus if file.is_file()]
    else:
        arguments = [trace.t, trace.x, trace.z, trace.p, trace.v, trace.w, trace.hit]
        results = [trace.xdot, trace.z_next, *trace.signals.values(), trace.x0, trace.z0]
        parts = [str(ca.Function("all", arguments, results).serialize()).encode()]
    return [__version__, *(hashlib.sha256(part).hexdigest() for part in (model.p0.tobytes(), *parts))]


def _runner_of(text: str) -> Runner:
    """Return what runs an ensemble in this process, made anew where another process has sent it."""
    if text in _RUNNERS:
        return _RUNNERS[text]
    plain = json.loads(text)
    model = model_for_runs(load(plain["document"], **plain["load"]))
    shared, kept = plain["setup"], plain["wanted"]
    names = tuple(shared.pop("names"))
    columns = recorded_columns(model, tuple(kept["watched"]), shared["angle"], "radius" in kept["kinds"])[1]
    n, *window = kept["rows"]
    wanted = Wanted(kept["kinds"], Rows(n, (window[0], window[1])), columns, names, kept["points"])
    return _keep(text, Runner(Setup(model, names, wanted=wanted, **shared)))


def _keep(text: str, runner: Runner) -> Runner:
    while len(_RUNNERS) >= _KEPT_RUNNERS:
        _RUNNERS.pop(next(iter(_RUNNERS)))
    _RUNNERS[text] = runner
    return runner


def _job(text: str, argument: Mapping[str, Any]) -> dict[str, Any]:
    """Perform the runs of one job; return how they ended as plain data, arrays as texts."""
    with one_thread():
        outcome = _runner_of(text).run(_runs(argument))
    return {
        "status": outcome.status,
        "message": outcome.message,
        "step_error": _packed(outcome.step_error),
        "values": {kind: {name: _packed(a) for name, a in of.items()} for kind, of in outcome.values.items()},
        "alone": outcome.alone,
    }


def _unpacked(answer: Mapping[str, Any]) -> Outcome:
    values = {kind: {name: _array(text) for name, text in of.items()} for kind, of in answer["values"].items()}
    return Outcome(answer["status"], answer["message"], _array(answer["step_error"]), values, answer["alone"])


def _packed(array: np.ndarray) -> list[Any]:
    """Return an array as its type, shape and bytes: short, and exact."""
    return [array.dtype.str, list(array.shape), base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()]


def _array(packed: Sequence[Any]) -> np.ndarray:
    kind, shape, text = packed
    return np.frombuffer(base64.b64decode(text), kind).reshape(shape)
