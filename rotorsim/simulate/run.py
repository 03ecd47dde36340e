"""Simulate a diagram: classical Runge-Kutta of fixed step, or an adaptive method with events."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from rotorsim.compile import Model, compile_diagram
from rotorsim.compile.instance import Instance, make_instance
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.simulate.failure import describe_failure
from rotorsim.simulate.result import Result, make_result

__all__ = ["simulate"]

LARGEST_RECORD = 8e9  # bytes
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
    names, parts allowed ("rotor.displacement[3]"). record_every: keep every n-th step. initial: x (n_x,).
    progress: called with the fraction done. A run that diverges or is interrupted returns what was
    computed, with status "diverged" or "stopped". Raises RotorsimError for wrong arguments.
    """
    model = diagram if isinstance(diagram, Model) else compile_diagram(diagram)
    solver = model.diagram.solver
    chosen = (method or solver.method).lower()
    h = solver.step if step is None else float(step)
    end = solver.stop if stop is None else float(stop)
    every = solver.record_every if record_every is None else int(record_every)
    names = model.record_names(record)
    _check(h, end, every)
    p = model.parameter_vector(parameters)
    begun = clock.process_time()
    instance = make_instance(model, names, p, use_compiler=use_compiler)
    prepared = clock.process_time()
    if initial is not None:
        instance.x[:] = initial
    n_steps = max(math.ceil(end / h - 1e-9), 1)  # a stop between two steps is covered
    size = (n_steps // every + 1) * (instance.n_y + 1) * 8
    if size > LARGEST_RECORD:
        raise RotorsimError(
            Problem(
                what=f"the recorded signals would take {size / 1e9:.0f} GB",
                subject="record",
                hint=f"record every n-th step (record_every >= {int(size / LARGEST_RECORD) + 1}) or fewer signals",
            )
        )
    if chosen == "rk4":
        outcome = _run_rk4(model, instance, n_steps, h, every, progress)
    else:
        from rotorsim.simulate.adaptive import run_adaptive

        outcome = run_adaptive(model, instance, chosen, n_steps, h, every, progress)
    time, rows, status, message, counters = outcome
    counters["compile_cpu_seconds"] = prepared - begun
    counters["run_cpu_seconds"] = clock.process_time() - prepared
    return make_result(
        model, names, time, rows, status, message, counters, method=chosen, step=h, path=instance.path, p=p
    )


def _check(h: float, end: float, every: int) -> None:
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
    if not problems and end / h > 1e10:
        problems.append(Problem(what=f"{end / h:.0e} steps; at most 1e10", subject="solver.step", hint="a larger step"))
    if problems:
        raise RotorsimError(*problems)


Outcome = tuple[np.ndarray, np.ndarray, str, str, dict[str, Any]]


def _run_rk4(
    model: Model, instance: Instance, n_steps: int, h: float, every: int, progress: Progress | None
) -> Outcome:
    rows = np.empty((n_steps // every + 1, instance.n_y))
    n, chunk, status, message = 0, n_steps if progress is None else 1000, "finished", ""
    chunk = min(chunk, 10_000_000)
    try:
        instance.start(0.0)
        while n < n_steps:
            saved = instance.save()
            first = n
            until = min(n + chunk, n_steps)
            begun = clock.perf_counter()
            n = instance.run(n, until, 0.0, h, every, rows[-(-n // every) :])
            if not np.isfinite(instance.x).all():
                instance.restore(saved)
                n = first
                n, message = describe_failure(model, instance, first, until, h, every, rows)
                status = "diverged"
                break
            elapsed = clock.perf_counter() - begun
            if progress is not None:
                progress(n / n_steps)
                chunk = int(chunk * min(max(0.1 / max(elapsed, 1e-6), 0.5), 10.0)) + 1
    except KeyboardInterrupt:
        status, message = "stopped", f"interrupted at t = {n * h:.6g} s; what was computed until then is kept"
    if status == "finished" and n_steps % every == 0:
        rows[n_steps // every] = instance.record(n_steps * h, instance.x)
        kept = n_steps // every + 1
    else:
        kept = -(-n // every)
    time = np.arange(kept) * every * h
    counters = {"steps": n, "evaluations": 4 * n}
    return time, rows[:kept], status, message, counters
