"""Adaptive integration by scipy, stopped and restarted at zero crossings and at sample hits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import scipy.integrate
from scipy.integrate import OdeSolver, solve_ivp

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
    options: dict[str, Any] = {"rtol": solver.rtol, "atol": solver.atol}
    if switching is not None and switching.stepwise:
        options["max_step"] = h  # what is told of every step has to be told as often as with fixed ones
    if method in IMPLICIT:
        options["jac"] = lambda t, x: _finite(_sound(np.array(model.jacobian(t, x, instance.z, p))), t, model)
    grid = np.arange(n_steps // every + 1) * every * h

    def tell(t: float) -> None:
        if progress is not None:
            progress(t / end)

    kept = _Rows(instance, grid, AT * h)
    options["method"] = _kept_by(kept, tell, getattr(scipy.integrate, ADAPTIVE[method]))
    counters = {"steps": 0, "evaluations": 0, "events": 0, "jacobians": 0}
    t, verdict = 0.0, Verdict()
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
            kept.begin(t, x)
            part = solve_ivp(slope, (t, stop), x, events=crossing, dense_output=True, **options)
            counters["steps"] += len(part.t) - 1
            counters["evaluations"] += part.nfev
            counters["jacobians"] += part.njev
            reached = float(part.t[-1])
            kept.fill(reached, part.sol)
            outgrown = part.status == 1 and len(part.t_events[0]) > 0
            if outgrown or part.status < 0 or not np.isfinite(part.y[:, -1]).all():
                verdict = Verdict("diverged", _failure(model, instance, part, reached))
                break
            x, t = np.array(part.y[:, -1]), reached
            kept.begin(t, x)
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
            tell(t)
    except KeyboardInterrupt:
        t, x = kept.last
        verdict = interrupted(t)
    except RotorsimError as error:
        t, x = kept.last
        verdict = diverged_inside(model, instance, error, t, None)
    instance.x[:] = x
    if verdict.status == "finished" and kept.count == len(grid) - 1:
        try:
            kept.add(x)
        except RotorsimError as error:
            verdict = failed_inside(error, t)
    return grid[: kept.count], kept.rows[: kept.count], verdict, counters


class _Rows:
    """The rows that are recorded, at times (n,) of a grid, as far as steps have been completed.

    last: time and states where the last step began that is known to be one.
    """

    def __init__(self, instance: Instance, grid: np.ndarray, near: float) -> None:
        self.instance, self.grid, self.near = instance, grid, near
        self.rows = np.empty((len(grid), instance.n_y))
        self.count = 0
        self.last: tuple[float, np.ndarray] = (0.0, np.array(instance.x))

    def begin(self, t: float, x: np.ndarray) -> None:
        """Go on from states at a time."""
        self.last = t, np.array(x)

    def fill(self, until: float, motion: Callable[[float], np.ndarray]) -> None:
        """Record a motion until a time; what is nearer to it is left to what begins there, as behind an event."""
        while self.count < len(self.grid) and self.grid[self.count] < until - self.near:
            at = self.grid[self.count]
            self.rows[self.count] = _sound(self.instance.record(at, motion(at)))
            self.count += 1

    def add(self, x: np.ndarray) -> None:
        """Record states at the next time of the grid."""
        self.rows[self.count] = _sound(self.instance.record(self.grid[self.count], x))
        self.count += 1


def _kept_by(kept: _Rows, tell: Callable[[float], None], method: type[OdeSolver]) -> type[OdeSolver]:
    """Return a method that records each step when the next one begins, and tells its time: no event lies in it.

    Where a part fails, or Ctrl-C ends the run, all steps before are kept.
    """

    class Recorded(method):  # type: ignore[misc]
        motion: Any = None

        def step(self) -> str | None:
            if self.motion is not None:
                kept.fill(self.t, self.motion)
                kept.begin(self.t, self.y)
                tell(self.t)
            self.motion = None
            said: str | None = super().step()
            if self.status != "failed":
                self.motion = super().dense_output()
            return said

        def dense_output(self) -> Any:
            return self.motion

    return Recorded


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
