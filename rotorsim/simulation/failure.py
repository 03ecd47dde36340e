"""Say where and why a fixed-step run diverged."""

from __future__ import annotations

import numpy as np

from rotorsim.linear.stability import growing, largest_stable_step, rounded_down
from rotorsim.model.compiled import Model
from rotorsim.model.instance import Instance


def describe_failure(
    model: Model, instance: Instance, first: int, until: int, h: float, every: int, rows: np.ndarray
) -> tuple[int, str]:
    """Repeat a stretch that ended non-finite; return the first bad step and a message with time, block and cure."""
    start = instance.save()
    reached = instance.run(first, until, 0.0, h, every, rows[-(-first // every) :])
    instance.restore(start)
    n = instance.run(first, max(first, reached - 9), 0.0, h, every, rows[-(-first // every) :])
    before = instance.x.copy()
    while n < reached:
        n = instance.run(n, n + 1, 0.0, h, every, rows[-(-n // every) :])
        if not np.isfinite(instance.x).all():
            break
        before = instance.x.copy()
    bad = np.flatnonzero(~np.isfinite(instance.x))
    worst = int(bad[np.argmax(np.abs(before[bad]))]) if len(bad) else 0
    state = next(name for name, signal in model.states.items() if signal.part.start <= worst < signal.part.stop)
    why = cause(model, instance, h)
    return n, f"diverged at t = {n * h:.6g} s: state '{state}' of block '{model.block_of_state(worst)}'{why}"


def cause(model: Model, instance: Instance, h: float | None) -> str:
    """Tell instability of the system from a step that is too large, by the Jacobian at the start."""
    z = np.asarray(instance.z)
    p = instance.p  # type: ignore[attr-defined]
    jacobian = np.array(model.jacobian(0.0, model.x0(p), z, p))
    if model.n_z or not np.isfinite(jacobian).all():
        return " is not finite any more"
    found = growing(jacobian)
    if found:
        return f" grows without bound: the system is unstable ({found.describe(model)})"
    stable = rounded_down(largest_stable_step(np.linalg.eigvals(jacobian)))
    if h is not None and stable < h:
        return f" grows without bound: the step {h:.3g} s is too large, RK4 is stable here up to {stable:.3g} s"
    return " is not finite any more"
