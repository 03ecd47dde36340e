"""How a run ended; where and why one diverged."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rotorsim.errors import RotorsimError
from rotorsim.linear.stability import growing, largest_stable_step, rounded_down, step_factor
from rotorsim.model.compiled import Model
from rotorsim.model.instance import Instance, sound

AT_VALUES = {"value", "discard", "error"}  # how a part fails where it gets values that it cannot take
OUTGROWN = 1e6  # by the growth of a pole since the start: what was small beside the motion meant is far beyond it


@dataclass(frozen=True)
class Verdict:
    """How a run ended: status, message and cause as in `Result`; error: of the step, relative."""

    status: str = "finished"
    message: str = ""
    error: float | None = None
    cause: str = ""


def interrupted(t: float) -> Verdict:
    """Return that a run was stopped at a time [s]."""
    return Verdict("stopped", f"interrupted at t = {t:.6g} s; what was computed until then is kept")


def failed_inside(error: RotorsimError, t: float) -> Verdict:
    """Return that a part whose equations are elsewhere has failed before a time [s]."""
    problem = error.problems[0]
    what = ": ".join(part for part in (problem.subject, problem.what) if part)
    hint = f"\n\nhint: {problem.hint}" if problem.hint else ""
    return Verdict("stopped", f"{what}; what was computed until t = {t:.6g} s is kept{hint}", cause="part")


def diverged_inside(model: Model, instance: Instance, error: RotorsimError, t: float, h: float | None) -> Verdict:
    """Return that a part has failed at values before a time [s], and why, where the motion has grown until there.

    h: of fixed steps [s].
    """
    failed = failed_inside(error, t)
    if getattr(error, "kind", "") not in AT_VALUES:
        return failed
    why, cause = growth(model, instance, h, until=t)
    if "grows" not in why:
        return failed
    problem = error.problems[0]
    return Verdict("diverged", f"diverged at t = {t:.6g} s: {problem.subject}{why} ({problem.what})", cause=cause)


def describe_failure(
    model: Model, instance: Instance, first: int, until: int, h: float, every: int, rows: np.ndarray
) -> tuple[int, Verdict]:
    """Repeat a stretch that ended non-finite; return the first bad step and why, with time and block."""
    start = instance.save()
    reached = instance.run(first, until, 0.0, h, every, rows[-(-first // every) :])
    instance.restore(start)
    n = instance.run(first, max(first, reached - 9), 0.0, h, every, rows[-(-first // every) :])
    before = instance.x.copy()
    while n < reached:
        n = instance.run(n, n + 1, 0.0, h, every, rows[-(-n // every) :])
        if not sound(instance.x):
            break
        before = instance.x.copy()
    bad = np.flatnonzero(~np.isfinite(instance.x))
    bad = bad if len(bad) else np.arange(len(before))
    worst = int(bad[np.argmax(np.abs(before[bad]))]) if len(bad) else 0
    state = next(name for name, signal in model.states.items() if signal.part.start <= worst < signal.part.stop)
    why, cause = growth(model, instance, h)
    what = f"diverged at t = {n * h:.6g} s: state '{state}' of block '{model.block_of_state(worst)}'{why}"
    return n, Verdict("diverged", what, cause=cause)


def growth(model: Model, instance: Instance, h: float | None, until: float | None = None) -> tuple[str, str]:
    """Tell instability of the system from a step that is too large, by the Jacobian at the start: words, cause.

    until: the time [s] by which the motion must have grown by `OUTGROWN`; None: that is known.
    """
    z = np.asarray(instance.z)
    p = instance.p  # type: ignore[attr-defined]
    jacobian = np.array(model.jacobian(0.0, model.x0(p), z, p))
    if model.n_z or not np.isfinite(jacobian).all():
        return " is not finite any more", ""
    least = -np.inf if until is None else math.log(OUTGROWN)
    poles = growing(jacobian)
    if poles and (until is None or poles.poles[0].real * until >= least):
        return f" grows without bound: the system is unstable ({poles.describe(model)})", ""
    values = np.linalg.eigvals(jacobian)
    stable = rounded_down(largest_stable_step(values))
    if h is not None and stable < h and (until is None or math.log(step_factor(h * values).max()) * until / h >= least):
        why = f" grows without bound: the step {h:.3g} s is too large, RK4 is stable here up to {stable:.3g} s"
        return why, "step"
    return " is not finite any more", ""
