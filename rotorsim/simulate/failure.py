"""Say where and why a fixed-step run diverged."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from rotorsim.compile import Model
from rotorsim.compile.instance import Instance

__all__ = ["describe_failure", "largest_stable_step"]


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
    cause = _cause(model, instance, h)
    return n, f"diverged at t = {n * h:.6g} s: state '{state}' of block '{model.block_of_state(worst)}'{cause}"


def _cause(model: Model, instance: Instance, h: float) -> str:
    """Tell instability of the system from a step that is too large, by the Jacobian at the start."""
    z = np.asarray(instance.z)
    jacobian = np.array(model.jacobian(0.0, model.x0(instance.p), z, instance.p))  # type: ignore[attr-defined]
    if not np.isfinite(jacobian).all():
        return " is not finite any more"
    values = np.linalg.eigvals(jacobian)
    growth = float(values.real.max())
    stable = largest_stable_step(values)
    if growth > 1e-9 * max(1.0, float(np.abs(values).max())):
        return f" grows without bound: the system is unstable (a pole at {growth:.4g} 1/s)"
    if stable < h:
        return f" grows without bound: the step {h:.3g} s is too large, RK4 is stable here up to {stable:.3g} s"
    return " is not finite any more"


def largest_stable_step(eigenvalues: np.ndarray) -> float:
    """Return the largest step [s] for which classical RK4 is stable, |R(h lambda)| <= 1 for every lambda.

    R(q) = 1 + q + q^2/2 + q^3/6 + q^4/24. Source: Hairer & Wanner, Solving ODEs II, sec. IV.2.
    """
    damped = eigenvalues[eigenvalues.real < 0]
    if not len(damped):
        return float("inf")

    def stable(h: float) -> bool:
        q = h * damped
        return bool((np.abs(1 + q * (1 + q / 2 * (1 + q / 3 * (1 + q / 4)))) <= 1 + 1e-12).all())

    steps = np.geomspace(1e-3, 10.0, 400) / np.abs(damped).max()
    low, high = next(((a, b) for a, b in pairwise(steps) if not stable(b)), (steps[-1], steps[-1]))
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)
