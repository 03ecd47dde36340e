"""Say whether a finished run can be believed: is the machine unstable, and was the step small enough?

1. Equations that are linear with constant coefficients: the poles of A decide, exactly.
2. Coefficients that change with time only: A averaged over a turn, confirmed by the Floquet multipliers.
3. Nonlinear or sampled diagrams: a growing pole alone says nothing, since the motion may settle on a bounded one
   (rub, a saturated actuator). Unstable is a run that still grows at its end, at the rate of a growing pole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.linear.linearisation import functions, speed_of
from rotorsim.linear.stability import Growing, growing, largest_stable_step, rounded_down, step_factor
from rotorsim.model.compiled import Model
from rotorsim.model.instance import Instance

__all__ = ["LARGEST_ERROR", "Stretch", "growth_rate", "judge", "loose_tolerance", "step_error", "stretches_of"]

LARGEST_ERROR = 0.01  # of the rms of a signal: what a run may be wrong by without a word
STRETCH = (200, 20_000)  # steps of which the error is estimated, at the start and at the end
SHARE = 100  # and this part of the run: two stretches of three times as many steps are 6 % of its work
MOST_HALVINGS = 8  # of the step, in search of one that would do
SAFETY = 0.9  # of the step that the order of the method says
GROWS = 1.05  # from one eighth of a run to the next, three times: it is still growing
INSTANTS = 64  # over which a Jacobian that changes is averaged
MOST_SAMPLED = 64  # shortest sample periods in the one in which all samplers return
BETWEEN = 0.3819660112501051  # of the time between two hits
WHOLE = 1e-9  # relative: numbers this close to a whole one are whole


@dataclass
class Stretch:
    """Steps first..last-1 of a fixed-step run, and the state of the instance before them."""

    first: int
    last: int
    saved: Any


@dataclass
class Verdict:
    """status: "finished", "unstable" or "diverged"; message: the reason, or advice; error: of the step, relative."""

    status: str = "finished"
    message: str = ""
    error: float | None = None
    counters: dict[str, Any] = field(default_factory=dict)


def stretches_of(n_steps: int) -> list[tuple[int, int]]:
    """Return the first and last step of the stretches at the start and at the end; one where they meet."""
    length = min(max(n_steps // SHARE, STRETCH[0]), STRETCH[1])
    return [(0, n_steps)] if 2 * length >= n_steps else [(0, length), (n_steps - length, n_steps)]


def judge(
    model: Model,
    instance: Instance,
    names: tuple[str, ...],
    time: np.ndarray,
    rows: np.ndarray,
    end: float,
    h: float | None,
    stretches: list[Stretch],
) -> Verdict:
    """Return what is to be said of a run to ``end`` [s]; h: step [s] of RK4, None for a method that controls its error.

    rows (n, n_y): what was recorded. The state of the instance is that of the end, and is lost.
    """
    x_end, z_end, saved = np.array(instance.x), np.array(instance.z), instance.save()
    p = instance.p  # type: ignore[attr-defined]
    rate = growth_rate(time, rows)
    error, worst = (None, "") if h is None else step_error(model, instance, names, rows, h, stretches)
    if model.n_z:
        return _sampled(model, instance, saved, x_end, z_end, end, h, rate, error, worst, names, rows, stretches)
    A = _mean_jacobian(model, p, x_end, end)
    found = growing(A)
    if found and model.linear:
        return Verdict("unstable", f"the machine is unstable: {found.describe(model)}", error)
    if not model.linear and (found or rate > 0):
        text = _changing(model, p, x_end, end, found, rate)
        if text:
            return Verdict("unstable", text, error)
    if h is not None:
        poles = np.linalg.eigvals(A) if np.isfinite(A).all() else np.zeros(0)
        steady = poles[poles.real < 0]
        beyond = bool((step_factor(h * steady) > 1 + WHOLE).any())
        limit = largest_stable_step(poles) if beyond else np.inf
        if beyond and (model.linear or (error or 0.0) >= 1.0):
            what = f"the step {h:.3g} s is too large: RK4 is stable here up to {rounded_down(limit):.3g} s"
            if model.linear and not np.any(x_end):  # nothing moved: nothing could grow
                return Verdict("finished", what, error)
            return Verdict("diverged", what, error)
    return _told(model, instance, names, rows, h, stretches, error, worst)


def _told(
    model: Model,
    instance: Instance,
    names: tuple[str, ...],
    rows: np.ndarray,
    h: float | None,
    stretches: list[Stretch],
    error: float | None,
    worst: str,
) -> Verdict:
    """Return a finished run, with advice where the error of its step is too large."""
    if h is None or error is None or error <= LARGEST_ERROR:
        return Verdict(error=error)
    enough = _step_that_would_do(model, instance, names, rows, h, stretches)
    what = f"the step {h:.3g} s is too large: '{worst}' is wrong by about {_size(error)} its rms"
    if enough is None:
        text = f"{what}, and no step down to {h / 2**MOST_HALVINGS:.2g} s brings it below 1 %"
    else:
        text = f"{what}; a step of {enough:.2g} s would do"
    return Verdict(message=text, error=error)


def _size(share: float) -> str:
    return f"{100 * share:.2g} % of" if share < 1 else f"{share:.2g} times"


def loose_tolerance(model: Model, signals: Mapping[str, np.ndarray], atol: float) -> str:
    """Return which recorded signal the absolute tolerance of an adaptive method leaves to chance; empty where none.

    It is an error of a state in one step: above LARGEST_ERROR of a signal that moves, nothing keeps that right.
    signals: (n, entries); those below WHOLE of another one of their unit are rounding.
    """
    peaks = {name: float(np.abs(values).max(initial=0.0)) for name, values in signals.items()}
    units = {name: model.select(name)[0].unit or "" for name in signals}
    least = {unit: WHOLE * max(peaks[name] for name in peaks if units[name] == unit) for unit in units.values()}
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
    last = rows[len(rows) - 4 * m :].reshape(4, m, -1)
    with np.errstate(all="ignore"):
        sizes = last.max(axis=1) - last.min(axis=1)
        ratio = (sizes[1:] / sizes[:-1]).min(axis=0, initial=np.inf)
        kept = ratio[np.isfinite(ratio)]
    largest = float(kept.max(initial=0.0))
    return float(np.log(largest) / (m * (time[1] - time[0]))) if largest > GROWS else 0.0


def _mean_jacobian(model: Model, p: np.ndarray, x: np.ndarray, end: float) -> np.ndarray:
    """Return d(dx/dt)/dx at a state; where it depends on time, its mean over the last turn."""
    jacobian = functions(model).state_matrix()
    times = np.array([end])
    if ca.depends_on(model.jacobian_expression, model.trace.t):
        speed = speed_of(model, p)
        turn = min(2 * np.pi / abs(speed), end) if speed else end / 50
        times = end - turn * np.arange(INSTANTS) / INSTANTS
    with np.errstate(all="ignore"):
        return np.asarray(jacobian(times[None, :], x, model.z0(p), p).mean(axis=0))


def _changing(model: Model, p: np.ndarray, x: np.ndarray, end: float, found: Growing, rate: float) -> str:
    """Return why a run with a changing Jacobian is unstable, or nothing."""
    nonlinear = bool(ca.depends_on(model.jacobian_expression, model.trace.x))
    steady = _returns(model, p, x, end)
    if not nonlinear and steady:
        from rotorsim.settled.equations import Equations
        from rotorsim.settled.floquet import STABLE, largest_multiplier

        equations = Equations(model, (), (), p[None], every_state=True).whole
        largest = largest_multiplier(equations, abs(speed_of(model, p) or 0.0), p, np.zeros((1, model.n_x)))
        if largest <= STABLE:
            return ""
        pole = f": {found.describe(model)}" if found else ", parametric resonance"
        return f"the machine is unstable{pole}; its motion grows {largest:.6g} times a turn"
    if found and rate >= 0.5 * float(found.poles[0].real):
        return f"the machine is unstable: {found.describe(model)}"
    if rate > 0 and (steady or not ca.depends_on(model.trace.xdot, model.trace.t)):
        rest = growing(_mean_jacobian(model, p, model.x0(p), end))
        if rest:
            return f"the machine is unstable about its initial position: {rest.describe(model)}; its motion still grows"
    return ""


def _returns(model: Model, p: np.ndarray, x: np.ndarray, end: float) -> bool:
    """Return whether dx/dt is the same one turn earlier: the speed is constant."""
    speed = speed_of(model, p)
    if not speed or not ca.depends_on(model.trace.xdot, model.trace.t):
        return False
    turn = 2 * np.pi / abs(speed)
    times = end + turn * np.array([0.13, 0.38, 0.71])
    x = np.where(np.isfinite(x), x, 0.0) / max(float(np.abs(x).max(initial=0.0)), 1.0)
    now, then = (np.array([model.rhs(t, x, model.z0(p), p) for t in at]) for at in (times, times + turn))
    return bool((np.abs(then - now) <= 1e-7 * np.abs(now).max(initial=0.0)).all())


# -- sampled diagrams --------------------------------------------------------------------------------------------------


def _sampled(
    model: Model,
    instance: Instance,
    saved: Any,
    x: np.ndarray,
    z: np.ndarray,
    end: float,
    h: float | None,
    rate: float,
    error: float | None,
    worst: str,
    names: tuple[str, ...],
    rows: np.ndarray,
    stretches: list[Stretch],
) -> Verdict:
    """Judge a diagram with sampled blocks: by the transition over the period in which all its samplers return."""
    if rate > 0:
        step = h or end
        period = _common_period(model, instance)
        if period is not None:
            growth = _transition_rate(model, instance, saved, x, z, period, min(step, period / 4))
            if growth >= 0.5 * rate:
                text = f"the machine with its sampled blocks is unstable: its motion grows at {rate:.4g} 1/s"
                return Verdict("unstable", text, error)
            if h is not None and (error or 0.0) >= 1.0:
                text = f"the step {h:.3g} s is too large: the motion grows at {rate:.4g} 1/s"
                return Verdict("diverged", text, error)
    return _told(model, instance, names, rows, h, stretches, error, worst)


def _common_period(model: Model, instance: Instance) -> float | None:
    """Return the period [s] after which all samplers hit together, None where it is long or there is none."""
    p = instance.p  # type: ignore[attr-defined]
    periods = np.array([float(p[sampler.period]) for sampler in model.trace.samplers])
    if not len(periods):
        return None
    for k in range(1, MOST_SAMPLED + 1):
        ratio = k * periods.min() / periods
        if (np.abs(ratio - np.round(ratio)) <= WHOLE * ratio).all() and (np.round(ratio) >= 1).all():
            return float(k * periods.min())
    return None


def _transition_rate(
    model: Model, instance: Instance, saved: Any, x: np.ndarray, z: np.ndarray, period: float, step: float
) -> float:
    """Return ln|mu| / T [1/s] of the largest eigenvalue mu of the map of (x, z) over one common period T.

    Every state is moved by a thousandth of the largest of its kind; the steps are short, so that this is the machine.
    """
    steps = max(int(np.ceil(period / step)), 4)
    width = period / steps
    rows = np.empty((steps + 1, instance.n_y))
    size = np.concatenate([np.full(len(part), max(float(np.abs(part).max(initial=0.0)), 1e-9)) for part in (x, z)])
    at = np.concatenate([x, z])
    begin = BETWEEN * period / MOST_SAMPLED  # between two hits: every one of the period comes once

    def after(state: np.ndarray) -> np.ndarray:
        instance.restore(saved)
        instance.x[:], instance.z[:] = state[: len(x)], state[len(x) :]
        instance.start(begin)
        instance.run(0, steps, begin, width, steps + 1, rows)
        return np.concatenate([instance.x, instance.z])

    base = after(at)
    moves = 1e-3 * np.diag(size)
    matrix = np.array([(after(at + move) - base) / move.max() for move in moves]).T
    if not np.isfinite(matrix).all():
        return 0.0
    largest = float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))
    return float(np.log(largest) / period) if largest > 0 else -np.inf


# -- the error of the step ---------------------------------------------------------------------------------------------


def step_error(
    model: Model, instance: Instance, names: tuple[str, ...], rows: np.ndarray, h: float, stretches: list[Stretch]
) -> tuple[float, str]:
    """Return the largest error of a recorded signal, relative to its rms in the run, and the signal.

    Short stretches are repeated at half the step, from the same states: of a method of order 4 the difference is
    15/16 of the error. Source: Hairer, Norsett & Wanner, Solving ODEs I, sec. II.4 (extrapolation).
    """
    return _largest([_errors(model, instance, names, rows, h, stretch, 1) for stretch in stretches], names)


def _largest(errors: list[np.ndarray], names: tuple[str, ...]) -> tuple[float, str]:
    worst = np.max(errors, axis=0, initial=0.0) if errors and len(names) else np.zeros(0)
    return (float(worst.max()), names[int(np.argmax(worst))]) if len(worst) else (0.0, "")


def _errors(
    model: Model, instance: Instance, names: tuple[str, ...], rows: np.ndarray, h: float, stretch: Stretch, parts: int
) -> np.ndarray:
    """Return the relative error of every signal with a step of h / parts, shape (signals,)."""
    one, two = (_repeated(instance, h, stretch, k) for k in (parts, 2 * parts))
    columns = sum(int(np.prod(model.shape_of(name), dtype=int)) for name in names)
    with np.errstate(all="ignore"):
        difference = np.sqrt(np.mean((one - two)[:, :columns] ** 2, axis=0)) * 16 / 15
        few = rows[:: max(len(rows) // 10_000, 1), :columns]
        size = np.sqrt(np.mean(few**2, axis=0)) if len(few) else np.zeros(columns)
    wrong, rms, at = [], [], 0
    for name in names:
        part = slice(at, at + int(np.prod(model.shape_of(name), dtype=int)))
        at = part.stop
        wrong.append(float(np.linalg.norm(difference[part])))
        rms.append(float(np.linalg.norm(size[part])))
    units = [model.select(name)[0].unit for name in names]
    floor = [max(r for r, unit in zip(rms, units, strict=True) if unit == own) * WHOLE for own in units]
    return np.array(
        [
            w / max(r, least) if max(r, least) > 0 and np.isfinite(w) and np.isfinite(r) else 0.0
            for w, r, least in zip(wrong, rms, floor, strict=True)
        ]
    )


def _repeated(instance: Instance, h: float, stretch: Stretch, parts: int) -> np.ndarray:
    instance.restore(stretch.saved)
    made = np.empty((stretch.last - stretch.first, instance.n_y))
    instance.run(stretch.first * parts, stretch.last * parts, 0.0, h / parts, parts, made)
    return made


def _step_that_would_do(
    model: Model, instance: Instance, names: tuple[str, ...], rows: np.ndarray, h: float, stretches: list[Stretch]
) -> float | None:
    """Return a step [s] whose error was found to be below 1 %, or scaled from one that was; None where none is."""
    parts = 2
    for _ in range(MOST_HALVINGS):
        error, _ = _largest([_errors(model, instance, names, rows, h, stretch, parts) for stretch in stretches], names)
        if error <= LARGEST_ERROR:
            grown = SAFETY * (LARGEST_ERROR / error) ** 0.25 if error > 0 else 2.0
            step = h / parts * min(max(grown, 1.0), 1.9)
            return rounded_down(step, 2)
        parts *= 2
    return None
