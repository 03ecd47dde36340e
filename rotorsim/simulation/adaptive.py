"""Adaptive integration by scipy, stopped and restarted at zero crossings and at sample hits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from rotorsim.diagram.solver import ADAPTIVE, SOLVER_METHODS
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.called import raise_failure
from rotorsim.model.compiled import Model
from rotorsim.model.instance import Instance
from rotorsim.simulation.failure import Verdict, diverged_inside, failed_inside, growth, interrupted
from rotorsim.simulation.switching import SwitchingInstance

IMPLICIT = {"radau", "bdf", "lsoda"}
MOST_EVENTS = 1_000_000
AT = 1e-9  # of a step of the diagram: how close to an event is at it
LARGEST_STATE = (
    1e100  # of a state: products of two with any coefficient are numbers, which methods of variable step rely on
)


def run_adaptive(
    model: Model,
    instance: Instance,
    method: str,
    n_steps: int,
    h: float,
    every: int,
    progress: Callable[[float], None] | None,
) -> tuple[np.ndarray, np.ndarray, Verdict, dict[str, Any]]:
    """Integrate adaptively; rows are recorded on the same grid as a fixed-step run.

    Zero crossings that blocks declare are located to rounding and the integration restarts behind them,
    so that a kink or a jump never lies inside a step. Raises RotorsimError for an unknown method.
    """
    if method not in ADAPTIVE:
        known = ", ".join(SOLVER_METHODS)
        raise RotorsimError(Problem(what=f"unknown method '{method}'", subject="solver.method", hint=f"one of {known}"))
    solver = model.diagram.solver
    p, end = instance.p, n_steps * h  # type: ignore[attr-defined]
    crossing = [_limit(), *_events(model, p, instance)]
    switching = instance if isinstance(instance, SwitchingInstance) else None
    if switching is not None:
        crossing += switching.crossings()
        crossing += switching.completions(tuple(crossing))
    options: dict[str, Any] = {"method": ADAPTIVE[method], "rtol": solver.rtol, "atol": solver.atol}
    if switching is not None and switching.stepwise:
        options["max_step"] = h  # what is told of every step has to be told as often as with fixed ones
    if method in IMPLICIT:
        options["jac"] = lambda t, x: _finite(_sound(np.array(model.jacobian(t, x, instance.z, p))), t, model)
    grid = np.arange(n_steps // every + 1) * every * h
    rows = np.empty((len(grid), instance.n_y))
    counters = {"steps": 0, "evaluations": 0, "events": 0, "jacobians": 0}
    t, filled, verdict = 0.0, 0, Verdict()
    x = np.array(instance.x)

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        return _sound(instance.derivative(t, x))

    try:
        instance.start(0.0)
        x = np.array(instance.x)
        while t < end:
            stop = min(instance.next_hit(), end)
            if switching is not None:
                stop = min(stop, switching.next_time)
            part = solve_ivp(slope, (t, stop), x, events=crossing, dense_output=True, **options)
            counters["steps"] += len(part.t) - 1
            counters["evaluations"] += part.nfev
            counters["jacobians"] += part.njev
            reached = float(part.t[-1])
            while filled < len(grid) and grid[filled] < reached - AT * h:  # at an event is behind it
                rows[filled] = _sound(instance.record(grid[filled], part.sol(grid[filled])))
                filled += 1
            outgrown = part.status == 1 and len(part.t_events[0]) > 0
            if outgrown or part.status < 0 or not np.isfinite(part.y[:, -1]).all():
                verdict = Verdict("diverged", _failure(model, instance, part, reached))
                break
            x, t = np.array(part.y[:, -1]), reached
            if part.status == 1:  # step over the crossing: far enough to be behind it, too little to matter
                counters["events"] += 1
                beyond = AT * h
                x, t = x + beyond * instance.derivative(t + beyond, x), t + beyond
                if counters["events"] > MOST_EVENTS:
                    verdict = Verdict("diverged", f"more than {MOST_EVENTS} zero crossings until t = {t:.6g} s")
                    break
            elif t < end:
                instance.x[:] = x
                instance.sample(t)
            if switching is not None:
                x = switching.carry_out_due(t, x, h)
            if progress is not None:
                progress(t / end)
    except KeyboardInterrupt:
        verdict = interrupted(t)
    except RotorsimError as error:
        verdict = diverged_inside(model, instance, error, t, None)
    instance.x[:] = x
    if verdict.status == "finished" and filled == len(grid) - 1:
        try:
            rows[filled] = _sound(instance.record(grid[filled], x))
            filled += 1
        except RotorsimError as error:
            verdict = failed_inside(error, t)
    return grid[:filled], rows[:filled], verdict, counters


def _sound(values: np.ndarray) -> np.ndarray:
    """Return values, unless a part has failed while they were computed."""
    raise_failure()
    return values


def _finite(jacobian: np.ndarray, t: float, model: Model) -> np.ndarray:
    """Return a Jacobian, which implicit methods need to be finite."""
    if not np.isfinite(jacobian).all():
        block = model.block_of_state(int(np.argwhere(~np.isfinite(jacobian))[0][0]))
        what = f"the derivatives of its equations by the states are not finite at t = {t:.6g} s"
        raise RotorsimError(Problem(what, block, hint="rk4, dop853 and rk45 do without them"), exit_code=1)
    return jacobian


def _limit() -> Callable[[float, np.ndarray], float]:
    """Return the event that a state has become too large for the method, which would fail or never end beyond it."""

    def room(t: float, x: np.ndarray) -> float:
        return 1.0 - float(np.abs(x).max(initial=0.0)) / LARGEST_STATE

    room.terminal = True  # type: ignore[attr-defined]
    return room


def _events(model: Model, p: np.ndarray, instance: Instance) -> list[Callable[[float, np.ndarray], float]]:
    trace = model.trace
    if trace.events.numel() == 0:
        return []
    function = ca.Function("events", [trace.t, trace.x, trace.z, trace.p], [ca.densify(trace.events)])
    memo: dict[str, Any] = {}

    def evaluate(k: int, t: float, x: np.ndarray) -> float:
        key = (t, x.tobytes())
        if memo.get("key") != key:
            memo["key"], memo["value"] = key, np.array(function(t, x, instance.z, p)).ravel()
        return float(memo["value"][k])

    found: list[Any] = []
    for k in range(trace.events.numel()):

        def crossing(t: float, x: np.ndarray, k: int = k) -> float:
            return evaluate(k, t, x)

        crossing.terminal = True  # type: ignore[attr-defined]
        found.append(crossing)
    return found


def _failure(model: Model, instance: Instance, part: Any, reached: float) -> str:
    last = np.abs(part.y[:, -1])
    worst = int(np.nanargmax(np.where(np.isfinite(last), last, np.inf))) if len(last) else 0
    state = next((n for n, s in model.states.items() if s.part.start <= worst < s.part.stop), "")
    block = model.block_of_state(worst)
    why, _ = growth(model, instance, None)
    said = f" ({part.message.rstrip('.')})" if part.status < 0 else ""
    return f"diverged at t = {reached:.6g} s: state '{state}' of block '{block}'{why}{said}"
