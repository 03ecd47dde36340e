"""A run of a diagram with parts that hide their equations: co-simulated by the default master, with its coupling error.

`rotorsim.simulation.run.simulate` hands such diagrams over; `rotorsim.cosim.cosimulation` is for choosing masters.
"""

from __future__ import annotations

import time as clock
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.cosim.cut import with_values
from rotorsim.diagram.diagram import Endpoint
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import flat_names
from rotorsim.linear.stability import rounded_down
from rotorsim.model.compiled import Model
from rotorsim.simulation.result import Result, cut
from rotorsim.simulation.run import Progress, check_times, provenance_of
from rotorsim.simulation.validity import LARGEST_ERROR, SAFETY, relative_errors

MASTER = "gauss_seidel"
SHARE = 1 / 3  # of the work: a run with half the step takes twice as long


def simulate_coupled(
    model: Model,
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
    """Return the result that `simulate` returns, of a model with parts that hide their equations.

    Signals are exchanged at the diagram's steps, inputs held in between (Gauss-Seidel), which is a method of first
    order: twice the difference to a run with half the step is the error that is told. method: of the states of FMUs for
    Model Exchange. Raises RotorsimError, also where the coupling must diverge.
    """
    solver = model.diagram.solver
    h, end = solver.step if step is None else float(step), solver.stop if stop is None else float(stop)
    every = solver.record_every if record_every is None else int(record_every)
    check_times(h, end, every)
    if initial is not None:
        hint = "without --settle; rotorsim periodic settles such a diagram"
        raise RotorsimError(Problem("its states are hidden: none can be given", ", ".join(model.hidden), hint=hint))
    names, p = model.record_names(record), model.parameter_vector(parameters)
    n_steps = max(round(np.ceil(end / h - 1e-9)), 1)
    begun = clock.process_time()
    chosen = (method or solver.method).lower()
    settings: dict[str, Any] = {"stop": n_steps * h, "method": chosen, "use_compiler": use_compiler}
    whole = coupling_of(model, names, p, step=h, check=True, progress=_part(progress, 0.0, SHARE), **settings)
    time, signals = _on_grid(model, whole, names, h, every)
    ran = clock.process_time()
    counters = {**whole.counters, "run_cpu_seconds": ran - begun}
    status, message, cause = whole.status, whole.message, "" if whole.status == "finished" else "part"
    if status == "finished":
        finer = coupling_of(model, names, p, step=h / 2, progress=_part(progress, SHARE, 1.0), **settings)
        if finer.status == "finished":
            _, others = _on_grid(model, finer, names, h, every)
            errors = relative_errors(
                model, names, [2 * (signals[n] - others[n]) for n in names], list(signals.values())
            )
            worst = int(np.argmax(errors)) if names else 0
            counters["step_error"] = error = float(errors[worst]) if names else 0.0
            if error > LARGEST_ERROR:
                message, cause = _advice(h, names[worst], error), "coupling"
        else:
            message = f"the error of the coupling was not estimated: with half the step, {finer.message}"
        counters["check_cpu_seconds"] = clock.process_time() - ran
    if chosen != "rk4" and status == "finished":
        message = "; ".join(
            filter(None, (message, f"{chosen} is for states of FMUs alone: other blocks take RK4 steps"))
        )
    coupling = {key: value for key, value in whole.provenance.items() if key != "communication_step"}
    how = "inputs held" if coupling["order"] == 0 else f"inputs of order {coupling['order']}"
    path = f"co-simulated with {', '.join(model.hidden)}: {MASTER}, {how}"
    return Result(
        time,
        signals,
        {name: model.select(name)[0].unit or "" for name in names},
        status,
        message,
        counters,
        {**provenance_of(model, p), "method": "communication", "step": h, "path": path, "coupling": coupling},
        cause,
    )


def _advice(h: float, name: str, error: float) -> str:
    size = f"{100 * error:.2g} % of" if error < 1 else f"{error:.2g} times"
    enough = rounded_down(SAFETY * h * LARGEST_ERROR / error, 2)
    return (
        f"the communication step {h:.3g} s is too large: '{name}' is wrong by about {size} its rms; "
        f"a step of {enough:.2g} s would do"
    )


def _part(progress: Progress | None, start: float, end: float) -> Progress | None:
    """Return what tells the progress of a part of the work."""
    return None if progress is None else lambda share: progress(start + (end - start) * share)


def coupling_of(
    model: Model,
    names: Iterable[str],
    p: np.ndarray,
    *,
    step: float,
    stop: float,
    method: str = "rk4",
    check: bool = False,
    progress: Progress | None = None,
    use_compiler: bool = True,
) -> Result:
    """Return the co-simulation by the default master with parameters p (n_p,) that records the ports of signals."""
    ports = dict.fromkeys(model.select(name)[0].name for name in names)
    recorded = tuple(Endpoint(block, port) for block, _, port in (name.rpartition(".") for name in ports))
    diagram = replace(with_values(model, p), record=recorded)
    settings: dict[str, Any] = {"master": MASTER, "solver": method, "check": check, "progress": progress}
    return cosimulate_diagram(diagram, step=step, stop=stop, use_compiler=use_compiler, **settings)


def rows_of(model: Model, result: Result, names: Iterable[str], times: np.ndarray, h: float) -> np.ndarray:
    """Return the entries of signals at times that are communication points, (n, entries); h: the step."""
    at = np.clip(np.searchsorted(result.time, times - 1e-9 * h), 0, len(result.time) - 1)
    columns = [result[flat][at] for name in names for flat in flat_names(model, name)]
    return np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))


def _on_grid(
    model: Model, result: Result, names: Sequence[str], h: float, every: int
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the times and signals that are recorded: sample hits are communication points as well, and left out."""
    grid = np.arange(int(np.floor(result.time[-1] / h + 1e-9)) // every + 1) * every * h
    rows = rows_of(model, result, names, grid, h)
    return grid, cut(rows, {name: model.shape_of(name) for name in names})[0]
