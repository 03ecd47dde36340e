"""Say whether a finished run can be believed: is the machine unstable, and was the step small enough?

1. Equations that are linear with constant coefficients: the poles of A decide, exactly.
2. Coefficients that change with time only: A averaged over a turn, confirmed by the Floquet multipliers.
3. Nonlinear or sampled diagrams: a growing pole alone says nothing, since the motion may settle on a bounded one
   (rub, a saturated actuator). Unstable is a run that still grows at its end, at the rate of a growing pole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.linear.linearisation import jacobians, speed_of
from rotorsim.linear.stability import Growing, growing, largest_stable_step, rounded_down, step_factor
from rotorsim.model.called import raise_failure
from rotorsim.model.compiled import Model
from rotorsim.model.instance import Instance
from rotorsim.simulation.failure import Verdict
from rotorsim.simulation.result import cut

LARGEST_ERROR = 0.01  # of the rms of a signal: what a run may be wrong by without a word
STRETCH = (200, 20_000)  # steps of which the error is estimated, at the start and at the end
RUN_DIVISOR = 100  # and this part of the run: two stretches of three times as many steps are 6 % of its work
MOST_HALVINGS = 8  # of the step, in search of one that would do
SAFETY = 0.9  # of the step that the order of the method says
GROWS = 1.05  # from one eighth of a run to the next, three times: it is still growing
JACOBIAN_INSTANTS = 64  # over which a Jacobian that changes is averaged
MOST_SAMPLED = 64  # shortest sample periods in the one in which all samplers return
BETWEEN = 0.3819660112501051  # of the time between two hits
WHOLE_NUMBER = 1e-9  # relative: numbers this close to a whole one are whole


@dataclass(frozen=True, eq=False)
class Stretch:
    """Steps first..last-1 of a fixed-step run, and the state of the instance before them."""

    first: int
    last: int
    saved: Any

    def repeated(self, instance: Instance, h: float, parts: int) -> np.ndarray:
        """Return the rows of the stretch with steps of h / parts."""
        instance.restore(self.saved)
        rows = np.empty((self.last - self.first, instance.n_y))
        instance.run(self.first * parts, self.last * parts, 0.0, h / parts, parts, rows)
        raise_failure()
        return rows


@dataclass(frozen=True, eq=False)
class Run:
    """A run from t = 0 to ``end`` [s], whose instance stands at its end.

    time (n,), rows (n, n_y): what was recorded, first the signals ``names``. h: step [s] of RK4, None for a method
    that controls its error. stretches: parts of a fixed-step run that can be repeated.
    """

    model: Model
    instance: Instance
    names: tuple[str, ...]
    time: np.ndarray
    rows: np.ndarray
    end: float
    h: float | None
    stretches: Sequence[Stretch]

    @property
    def p(self) -> np.ndarray:
        """The parameters of the run, (n_p,)."""
        return np.asarray(self.instance.p)  # type: ignore[attr-defined]


def stretches_of(n_steps: int) -> list[tuple[int, int]]:
    """Return the first and last step of the stretches at the start and at the end; one where they meet."""
    length = min(max(n_steps // RUN_DIVISOR, STRETCH[0]), STRETCH[1])
    return [(0, n_steps)] if 2 * length >= n_steps else [(0, length), (n_steps - length, n_steps)]


def judge(run: Run) -> Verdict:
    """Return what is to be said of a run; the state of its instance is lost."""
    model, h, at_end = run.model, run.h, run.instance.save()
    x, z = np.array(run.instance.x), np.array(run.instance.z)
    rate = growth_rate(run.time, run.rows)
    error, worst = _step_error(run)
    if model.n_z:
        return _sampled(run, at_end, x, z, rate, error) or _finished(run, error, worst)
    A = mean_jacobian(model, run.p, run.end, x)
    poles = growing(A)
    why = f"the machine is unstable: {poles.describe(model)}" if poles and model.linear else ""
    if not model.linear and (poles or rate > 0):
        why = _changing(run, x, poles, rate)
    if why:
        return Verdict("unstable", why, error)
    if h is not None:
        values = np.linalg.eigvals(A) if np.isfinite(A).all() else np.zeros(0)
        beyond = (step_factor(h * values[values.real < 0]) > 1 + WHOLE_NUMBER).any()
        if beyond and (model.linear or (error or 0.0) >= 1.0):
            limit = rounded_down(largest_stable_step(values))
            what = f"the step {h:.3g} s is too large: RK4 is stable here up to {limit:.3g} s"
            still = model.linear and not np.any(x)  # nothing moved: nothing could grow
            return Verdict("finished" if still else "diverged", what, error, "step")
    return _finished(run, error, worst)


def _finished(run: Run, error: float | None, worst: str) -> Verdict:
    """Return that a run has finished, with advice where the error of its step is too large."""
    if run.h is None or error is None or error <= LARGEST_ERROR:
        return Verdict(error=error)
    enough = _step_that_would_do(run, run.h)
    size = f"{100 * error:.2g} % of" if error < 1 else f"{error:.2g} times"
    what = f"the step {run.h:.3g} s is too large: '{worst}' is wrong by about {size} its rms"
    if enough is None:
        text = f"{what}, and no step down to {run.h / 2**MOST_HALVINGS:.2g} s brings it below 1 %"
    else:
        text = f"{what}; a step of {enough:.2g} s would do"
    return Verdict(message=text, error=error, cause="step")


def loose_tolerance(model: Model, signals: Mapping[str, np.ndarray], atol: float) -> str:
    """Return which recorded signal the absolute tolerance of an adaptive method leaves to chance; empty where none.

    It is an error of a state in one step: above LARGEST_ERROR of a signal that moves, nothing keeps that right.
    signals: (n, entries); those below WHOLE_NUMBER of another one of their unit are rounding.
    """
    peaks = {name: float(np.abs(values).max(initial=0.0)) for name, values in signals.items()}
    units = {name: model.select(name)[0].unit or "" for name in signals}
    least = {unit: WHOLE_NUMBER * max(peaks[name] for name in peaks if units[name] == unit) for unit in units.values()}
    told = {name: peak for name, peak in peaks.items() if least[units[name]] < peak < atol / LARGEST_ERROR}
    if not told:
        return ""
    name = min(told, key=lambda key: told[key])
    unit = units[name]
    return (
        f"the absolute tolerance {atol:.3g} is more than 1 % of '{name}', whose peak is {told[name]:.3g} {unit}: "
        f"nothing keeps its error small; a solver.atol of {1e-7 * told[name]:.0e} would"
    )


# -- does it grow? -----------------------------------------------------------------------------------------------------


def growth_rate(time: np.ndarray, rows: np.ndarray) -> float:
    """Return how fast the motion still grows at its end [1/s], 0 where it does not.

    The range (peak to peak) of a signal grows from each of the last four eighths of the run to the next.
    """
    m = len(rows) // 8
    if m < 4:
        return 0.0
    last = np.ascontiguousarray(rows[len(rows) - 4 * m :].T).reshape(-1, 4, m)  # ten times as fast as across rows
    with np.errstate(all="ignore"):
        sizes = (last.max(axis=2) - last.min(axis=2)).T
    return float(growth_of(sizes, m * (time[1] - time[0])))


def growth_of(sizes: np.ndarray, seconds: Any) -> Any:
    """Return how fast signals grow [1/s] whose ranges (eighths, n_y, ...) are known in eighths [s] of runs (...)."""
    with np.errstate(all="ignore"):
        ratio = (sizes[1:] / sizes[:-1]).min(axis=0, initial=np.inf)
        largest = np.where(np.isfinite(ratio), ratio, 0.0).max(axis=0, initial=0.0)
        return np.where(largest > GROWS, np.log(largest) / seconds, 0.0)


def mean_jacobian(model: Model, p: np.ndarray, end: float, x: np.ndarray) -> np.ndarray:
    """Return d(dx/dt)/dx at a state; where it depends on time, its mean over the last turn before ``end`` [s]."""
    times = np.array([end])
    if ca.depends_on(model.jacobian_expression, model.trace.t):
        speed = speed_of(model, p)
        turn = min(2 * np.pi / abs(speed), end) if speed else end / 50
        times = end - turn * np.arange(JACOBIAN_INSTANTS) / JACOBIAN_INSTANTS
    with np.errstate(all="ignore"):
        return np.asarray(jacobians(model)["A"](times[None, :], x, model.z0(p), p).mean(axis=0))


def _changing(run: Run, x: np.ndarray, poles: Growing, rate: float) -> str:
    """Return why a run with a changing Jacobian is unstable, or nothing."""
    model, p = run.model, run.p
    steady = _returns(run, x)
    if not ca.depends_on(model.jacobian_expression, model.trace.x) and steady:
        from rotorsim.settled.equations import Equations  # as long to load as a short run takes
        from rotorsim.settled.floquet import STABLE_MULTIPLIER, largest_multiplier

        equations = Equations(model, (), (), p[None], every_state=True).whole
        largest = largest_multiplier(equations, abs(speed_of(model, p) or 0.0), p, np.zeros((1, model.n_x)))
        if largest <= STABLE_MULTIPLIER:
            return ""
        pole = f": {poles.describe(model)}" if poles else ", parametric resonance"
        return f"the machine is unstable{pole}; its motion grows {largest:.6g} times a turn"
    if poles and rate >= 0.5 * float(poles.poles[0].real):
        return f"the machine is unstable: {poles.describe(model)}"
    if rate > 0 and (steady or not ca.depends_on(model.trace.xdot, model.trace.t)):
        rest = growing(mean_jacobian(model, p, run.end, model.x0(p)))
        if rest:
            return f"the machine is unstable about its initial position: {rest.describe(model)}; its motion still grows"
    return ""


def _returns(run: Run, x: np.ndarray) -> bool:
    """Return whether dx/dt is the same one turn later: the speed is constant."""
    model, p = run.model, run.p
    speed = speed_of(model, p)
    if not speed or not ca.depends_on(model.trace.xdot, model.trace.t):
        return False
    turn = 2 * np.pi / abs(speed)
    times = run.end + turn * np.array([0.13, 0.38, 0.71])
    x = np.where(np.isfinite(x), x, 0.0) / max(float(np.abs(x).max(initial=0.0)), 1.0)
    now, then = (np.array([model.rhs(t, x, model.z0(p), p) for t in at]) for at in (times, times + turn))
    return bool((np.abs(then - now) <= 1e-7 * np.abs(now).max(initial=0.0)).all())


# -- sampled diagrams --------------------------------------------------------------------------------------------------


def _sampled(run: Run, at_end: Any, x: np.ndarray, z: np.ndarray, rate: float, error: float | None) -> Verdict | None:
    """Return why a diagram with sampled blocks grows: by the map over the period in which all its samplers return."""
    period = _common_period(run) if rate > 0 else None
    if period is None:
        return None
    if _transition_rate(run, at_end, x, z, period, min(run.h or run.end, period / 4)) >= 0.5 * rate:
        text = f"the machine with its sampled blocks is unstable: its motion grows at {rate:.4g} 1/s"
        return Verdict("unstable", text, error, "sampled")
    if run.h is not None and (error or 0.0) >= 1.0:
        text = f"the step {run.h:.3g} s is too large: the motion grows at {rate:.4g} 1/s"
        return Verdict("diverged", text, error, "step")
    return None


def _common_period(run: Run) -> float | None:
    """Return the period [s] after which all samplers hit together, None where it is long or there is none."""
    periods = np.array([float(run.p[sampler.period]) for sampler in run.model.trace.samplers])
    shortest = periods.min(initial=np.inf)
    for k in range(1, MOST_SAMPLED + 1 if len(periods) else 0):
        ratio = k * shortest / periods
        if (np.abs(ratio - np.round(ratio)) <= WHOLE_NUMBER * ratio).all() and (np.round(ratio) >= 1).all():
            return float(k * shortest)
    return None


def _transition_rate(run: Run, at_end: Any, x: np.ndarray, z: np.ndarray, period: float, step: float) -> float:
    """Return ln|mu| / T [1/s] of the largest eigenvalue mu of the map of (x, z) over one common period T.

    Every state is moved by a thousandth of the largest of its kind; the steps are short, so that this is the machine.
    """
    instance = run.instance
    steps = max(int(np.ceil(period / step)), 4)
    rows = np.empty((steps + 1, instance.n_y))
    begin = BETWEEN * period / MOST_SAMPLED  # between two hits: every one of the period comes once

    def after(state: np.ndarray) -> np.ndarray:
        instance.restore(at_end)
        instance.x[:], instance.z[:] = state[: len(x)], state[len(x) :]
        instance.start(begin)
        instance.run(0, steps, begin, period / steps, steps + 1, rows)
        raise_failure()
        return np.concatenate([instance.x, instance.z])

    at = np.concatenate([x, z])
    base = after(at)
    moves = [1e-3 * max(float(np.abs(part).max(initial=0.0)), 1e-9) for part in (x, z) for _ in part]
    matrix = np.array([(after(at + row) - base) / row.max() for row in np.diag(moves)]).T
    if not np.isfinite(matrix).all():
        return 0.0
    largest = float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))
    return float(np.log(largest) / period) if largest > 0 else -np.inf


# -- the error of the step ---------------------------------------------------------------------------------------------


def _step_error(run: Run, parts: int = 1) -> tuple[float | None, str]:
    """Return the largest error of a signal with steps of h / parts, relative to its rms in the run, and the signal.

    Short stretches are repeated at half the step, from the same states: of a method of order 4 the difference is
    15/16 of the error. Source: Hairer, Norsett & Wanner, Solving ODEs I, sec. II.4 (extrapolation).
    """
    if run.h is None or not run.stretches:
        return None, ""
    if not run.names:
        return 0.0, ""
    errors = np.max([_errors(run, run.h, stretch, parts) for stretch in run.stretches], axis=0)
    return float(errors.max()), run.names[int(np.argmax(errors))]


def _errors(run: Run, h: float, stretch: Stretch, parts: int) -> np.ndarray:
    """Return the relative error of every signal with a step of h / parts, shape (signals,)."""
    shapes = {name: run.model.shape_of(name) for name in run.names}
    few = run.rows[:: max(len(run.rows) // 10_000, 1)]
    with np.errstate(all="ignore"):
        change = stretch.repeated(run.instance, h, parts) - stretch.repeated(run.instance, h, 2 * parts)
    wrong = cut(change * 16 / 15, shapes)[0]
    moved = cut(few if len(few) else np.zeros((1, run.rows.shape[1])), shapes)[0]
    return relative_errors(run.model, run.names, [wrong[n] for n in run.names], [moved[n] for n in run.names])


def relative_errors(
    model: Model, names: Sequence[str], wrong: Sequence[np.ndarray], signals: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the rms of the errors of signals (n, *shape) over the rms of the signals, (signals,).

    One that is rounding beside another of its unit is measured by that one.
    """
    with np.errstate(all="ignore"):
        errors, rms = (
            np.array([np.linalg.norm(one) / np.sqrt(len(one)) for one in arrays]) for arrays in (wrong, signals)
        )
    return relative_to(model, names, errors, rms)


def relative_to(model: Model, names: Sequence[str], errors: np.ndarray, rms: np.ndarray) -> np.ndarray:
    """Return the rms of errors over those of signals, (signals, ...), as `relative_errors`."""
    units = np.array([model.select(name)[0].unit or "" for name in names])
    size = np.maximum(rms, np.array([WHOLE_NUMBER * np.max(rms[units == unit], axis=0) for unit in units]))
    usable = (size > 0) & np.isfinite(errors) & np.isfinite(rms)
    return np.asarray(np.divide(errors, size, out=np.zeros(np.shape(errors)), where=usable))


def _step_that_would_do(run: Run, h: float) -> float | None:
    """Return a step [s] whose error was below 1 %, or scaled from one that was; None where none is."""
    for parts in 2 ** np.arange(1, MOST_HALVINGS + 1):
        error = _step_error(run, int(parts))[0] or 0.0
        if error <= LARGEST_ERROR:
            grown = SAFETY * (LARGEST_ERROR / error) ** 0.25 if error > 0 else 2.0
            return rounded_down(h / parts * min(max(grown, 1.0), 1.9), 2)
    return None
