"""Simulate a diagram: classical Runge-Kutta of fixed step, or an adaptive method with events."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.called import forget_failures, raise_failure
from rotorsim.model.compiled import Model, model_for_runs
from rotorsim.model.input_limits import input_limits, passed_limit
from rotorsim.model.instance import Instance, make_instance, sound
from rotorsim.simulation.failure import Verdict, describe_failure, diverged_inside, interrupted
from rotorsim.simulation.result import Result, cut
from rotorsim.simulation.switching import SwitchingInstance, carrying_out_events
from rotorsim.simulation.validity import Run, Stretch, judge, loose_tolerance, stretches_of

LARGEST_RESIDUAL = 1e-9  # of algebraic loops
LARGEST_RECORD = 1e9  # bytes; summing up and writing takes two to three times as much for a while
COUPLED_RUN = "rotorsim.cosim.coupled_run"  # a room above this one: imported where parts hide their equations
UNKNOWN_ERROR = "the error of the step was not estimated: a part changes at events and cannot save its state"
Progress = Callable[[float], None]


def simulate(
    diagram: Diagram | Model,
    *,
    parameters: Mapping[str, Any] | None = None,
    stop: float | None = None,
    step: float | None = None,
    method: str | None = None,
    record: Iterable[str] | None = None,
    record_every: int | None = None,
    initial: np.ndarray | None = None,
    progress: Progress | None = None,
    use_compiler: bool = True,
) -> Result:
    """Simulate from t = 0 to ``stop`` [s] and return the recorded signals.

    parameters: by name ("speed", "controller.KP"), SI or texts with a unit ("1800 rpm"). method: "rk4" (fixed
    step, default) or "dop853", "rk45", "radau", "bdf", "lsoda" (adaptive, zero crossings located). record: signal
    names, parts allowed ("rotor.displacement[3]"). record_every: keep every n-th step. initial: x (n_x,), or with
    the states z of sampled blocks behind, before their hit at t = 0 (n_x + n_z,).
    progress: called with the fraction done. A run of an unstable machine, one that diverges (a state is not
    finite any more, or the step is beyond the stability limit of RK4) and one that is interrupted return what
    was computed, with status "unstable", "diverged" or "stopped"; a step that makes a recorded signal wrong by
    more than 1 % is said in the message. Raises RotorsimError for wrong arguments.
    """
    model = model_for_runs(diagram)
    if model.hidden:
        coupled = import_module(COUPLED_RUN).simulate_coupled
        given: dict[str, Any] = {"parameters": parameters, "stop": stop, "step": step, "method": method}
        given |= {"record": record, "record_every": record_every, "initial": initial, "progress": progress}
        result: Result = coupled(model, use_compiler=use_compiler, **given)
        return result
    solver = model.diagram.solver
    chosen = (method or solver.method).lower()
    h = solver.step if step is None else float(step)
    end = solver.stop if stop is None else float(stop)
    every = solver.record_every if record_every is None else int(record_every)
    names = model.record_names(record)
    check_times(h, end, every)
    p = model.parameter_vector(parameters)
    limits = input_limits(model.diagram, {name: p[part] for name, part in model.parameters.items()})
    watched = (*names, *dict.fromkeys(str(item.source) for item in limits if str(item.source) not in names))
    begun = clock.process_time()
    forget_failures()
    instance = make_instance(model, watched, p, use_compiler=use_compiler)
    prepared = clock.process_time()
    if initial is not None:
        states = np.asarray(initial, float)
        if states.shape not in ((model.n_x,), (model.n_x + model.n_z,)):
            whole = f", or {model.n_x + model.n_z} with those of its sampled blocks behind" if model.n_z else ""
            what = f"states of shape {states.shape}: the diagram has {model.n_x}{whole}"
            raise RotorsimError(Problem(what, "initial"))
        instance.x[:] = states[: model.n_x]
        if len(states) > model.n_x:
            instance.z[:] = states[model.n_x :]
    n_steps = max(math.ceil(end / h - 1e-9), 1)  # a stop between two steps is covered
    if every > n_steps:
        what = f"every {every:.6g}th step of {n_steps} is recorded: nothing but the start"
        raise RotorsimError(
            Problem(what=what, subject="solver.record_every", hint=f"at most {n_steps}, or a longer run")
        )
    size = (n_steps // every + 1) * (instance.n_y + 1) * 8
    if size > LARGEST_RECORD:
        raise RotorsimError(
            Problem(
                what=f"the recorded signals of {n_steps} steps would take {size / 1e9:.3g} GB, at most 1 GB",
                subject="record",
                hint=f"a 'record_every' of {math.ceil(every * size / LARGEST_RECORD)} or more "
                "(--set solver.record_every=...), fewer signals, or a shorter run",
            )
        )
    with carrying_out_events(model, instance, p) as at_work:
        stretches: list[Stretch] = []
        if chosen == "rk4":
            outcome = _run_rk4(model, at_work, n_steps, h, every, progress, stretches)
        else:
            from rotorsim.simulation.adaptive import run_adaptive

            outcome = run_adaptive(model, at_work, chosen, n_steps, h, every, progress)
        time, rows, verdict, counters = outcome
        counters["compile_cpu_seconds"] = prepared - begun
        if isinstance(at_work, SwitchingInstance):
            counters["part_events"] = at_work.events
        ran = clock.process_time()
        counters["run_cpu_seconds"] = ran - prepared
        signals, residuals = cut(rows, {name: model.shape_of(name) for name in watched})
        lost = isinstance(at_work, SwitchingInstance) and not at_work.can_go_back
        if lost:
            stretches.clear()
        if verdict.status == "finished":
            run = Run(model, at_work, watched, time, rows, n_steps * h, h if chosen == "rk4" else None, stretches)
            try:
                verdict = judge(run)
            except RotorsimError as error:
                verdict = replace(verdict, message=f"it was not checked: {error.problems[0].what}")
            if lost and chosen == "rk4" and not verdict.message:
                verdict = replace(verdict, message=UNKNOWN_ERROR)
    if verdict.status == "finished":
        if verdict.error is not None:
            counters["step_error"] = verdict.error
        broken = passed_limit(limits, time, signals) or _no_number(time, signals)
        if broken:
            verdict = Verdict("diverged", broken)
        elif not verdict.message and chosen != "rk4":
            verdict = Verdict(message=loose_tolerance(model, signals, solver.atol))
        counters["check_cpu_seconds"] = clock.process_time() - ran
    if residuals.shape[1]:
        counters["loop_residual"] = largest = float(np.abs(residuals).max(initial=0.0))
        if largest > LARGEST_RESIDUAL and verdict.status == "finished":
            what = f"an algebraic loop did not converge: largest residual {largest:.2g}"
            verdict = Verdict("diverged", what, cause="loop")
    return Result(
        time,
        {name: signals[name] for name in names},
        {name: model.select(name)[0].unit or "" for name in names},
        verdict.status,
        verdict.message,
        counters,
        {**provenance_of(model, p), "method": chosen, "step": h, "path": instance.path},
        verdict.cause,
    )


def _no_number(time: np.ndarray, signals: Mapping[str, np.ndarray]) -> str:
    """Return which recorded signal is no number somewhere, though all states are, and since when; empty where none."""
    for name, values in signals.items():
        with np.errstate(all="ignore"):
            if np.isfinite(values.sum()):  # one pass: looking at each takes as long as a third of a run
                continue
        finite = np.isfinite(values.reshape(len(time), -1)).all(axis=1)
        if not finite.all():
            first = float(time[int(np.argmin(finite))])
            rows = f"{int((~finite).sum())} of {len(time)} rows"
            return f"'{name}' is not a finite number in {rows}, first at t = {first:.6g} s"
    return ""


def provenance_of(model: Model, p: np.ndarray) -> dict[str, Any]:
    """Return what was run with parameters p (n_p,).

    ``parameters`` are the diagram's in force; ``parameters_changed`` those given to the run, by block; ``without`` the
    blocks that were left out. There is no date: the same run gives the same result.
    """
    from rotorsim import __version__

    diagram = model.diagram
    values = {name: np.ravel(value) for name, value in diagram.parameters.items()}
    values |= {name: p[parts[0]] for name, parts in model.references.items() if parts}
    changed = {name: p[part] for name, part in model.parameters.items() if (p[part] != model.p0[part]).any()}
    return {
        "rotorsim": __version__,
        "diagram": diagram.name,
        "file": diagram.file,
        "document_sha256": diagram.sha256,
        "parameters": {name: _plain(value) for name, value in values.items()},
        "parameters_changed": {name: _plain(value) for name, value in changed.items()},
        "without": without(diagram),
    }


def _plain(values: np.ndarray) -> Any:
    return float(values[0]) if values.size == 1 else values.tolist()


def without(diagram: Diagram) -> list[str]:
    """Return the blocks of the document (sub-diagrams as a whole) that the diagram was loaded without."""
    there = {name.partition("/")[0] for name in diagram.nodes}
    whole = [str(name) for name in diagram.document.get("blocks", {}) if name not in there]
    return [*whole, *sorted(name for name in diagram.removed if name.partition("/")[0] in there)]


def check_times(h: float, end: float, every: int) -> None:
    """Raise RotorsimError for a step [s], a stop time [s] or a decimation that make no run."""
    problems = []
    if not (np.isfinite(h) and h > 0):
        hint = "a fraction of the shortest period, such as 1e-4 s"
        problems.append(Problem(what=f"the step must be positive, got {h:g} s", subject="solver.step", hint=hint))
    if not (np.isfinite(end) and end > 0):
        hint = "runs begin at t = 0"
        what = f"the stop time must be positive, got {end:g} s"
        problems.append(Problem(what=what, subject="solver.stop", hint=hint))
    if every < 1:
        hint = "1 records every step"
        problems.append(Problem(what=f"must be at least 1, got {every}", subject="solver.record_every", hint=hint))
    if not problems and end < h * (1 - 1e-9):
        what = f"step {h:g} s is longer than stop {end:g} s"
        problems.append(Problem(what=what, subject="solver", hint="choose a smaller step"))
    if not problems and end / h > 1e10:
        problems.append(Problem(what=f"{end / h:.0e} steps; at most 1e10", subject="solver.step", hint="a larger step"))
    if problems:
        raise RotorsimError(*problems)


Outcome = tuple[np.ndarray, np.ndarray, Verdict, dict[str, Any]]


def _run_rk4(
    model: Model,
    instance: Instance,
    n_steps: int,
    h: float,
    every: int,
    progress: Progress | None,
    stretches: list[Stretch],
) -> Outcome:
    """Take the steps; ``stretches`` receives the states from which parts of them can be repeated."""
    ahead = stretches_of(n_steps)
    rows = np.empty((n_steps // every + 1, instance.n_y))
    n = first = until = 0
    chunk, verdict = n_steps if progress is None else 1000, Verdict()
    chunk = min(chunk, 10_000_000)
    try:
        instance.start(0.0)
        while n < n_steps:
            saved = instance.save()
            first = n
            if ahead and n == ahead[0][0]:
                stretches.append(Stretch(*ahead.pop(0), saved))
            until = min(n + chunk, n_steps, *(start for start, _ in ahead))
            begun = clock.perf_counter()
            n = instance.run(n, until, 0.0, h, every, rows[-(-n // every) :])
            raise_failure()
            if not sound(instance.x):
                instance.restore(saved)
                n = first
                n, verdict = describe_failure(model, instance, first, until, h, every, rows)
                break
            elapsed = clock.perf_counter() - begun
            if progress is not None:
                progress(n / n_steps)
                chunk = int(chunk * min(max(0.1 / max(elapsed, 1e-6), 0.5), 10.0)) + 1
        if verdict.status == "finished" and n_steps % every == 0:
            rows[n_steps // every] = instance.record(n_steps * h, instance.x)
            raise_failure()
    except KeyboardInterrupt:
        n = _sound_until(rows, first, n, every)
        verdict = interrupted(n * h)
    except RotorsimError as error:  # in a step of the stretch that was run last
        at = int((getattr(error, "time", None) or 0.0) / h + 1e-9)
        n = _sound_until(rows, first, min(max(at, first), until), every)
        verdict = diverged_inside(model, instance, error, n * h, h)
    kept = n_steps // every + 1 if verdict.status == "finished" and n_steps % every == 0 else -(-n // every)
    time = np.arange(kept) * every * h
    counters = {"steps": n, "evaluations": 4 * n}
    return time, rows[:kept], verdict, counters


def _sound_until(rows: np.ndarray, first: int, n: int, every: int) -> int:
    """Return the step up to which rows are numbers, between a first one and n."""
    at = -(-first // every)
    bad = np.flatnonzero(~np.isfinite(rows[at : -(-n // every)]).all(axis=1))
    return min(n, (at + int(bad[0])) * every) if bad.size else n
