"""Least squares of a structure: residuals over the noise floor, Levenberg-Marquardt with numerical derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.generic.native import Array

Model = Callable[[Array], Sequence[Array] | None]  # parameters to what each run records; None: diverged
STEP = 1e-5
DONE = 1e-6  # relative change of the cost that ends the iteration


def chi(simulated: Sequence[Array], measured: Sequence[Array], floors: Array) -> float:
    """Return the rms over channels and samples of the residual over the noise floor."""
    squares = np.mean([((s - m) ** 2).mean(axis=0) for s, m in zip(simulated, measured, strict=True)], axis=0)
    return float(np.sqrt((squares / floors**2).mean()))


def fit(model: Model, measured: Sequence[Array], floors: Array, start: Array, most: int = 25) -> tuple[Array, float]:
    """Return the parameters that fit best from a start, and their chi (inf: the start diverges).

    Parameters are scaled by the caller so that a change of 1 is large.
    """

    def residual(theta: Array) -> Array | None:
        found = model(theta)
        if found is None:
            return None
        count = sum(m.size for m in measured)
        parts = [((s - m) / floors).ravel() for s, m in zip(found, measured, strict=True)]
        return np.asarray(np.concatenate(parts) / np.sqrt(count))

    theta = np.array(start, float)
    r = residual(theta)
    if r is None:
        return theta, float("inf")
    cost, damping = float(r @ r), 1e-4
    for _ in range(most):
        columns = []
        for k in range(len(theta)):
            moved = residual(theta + STEP * (np.arange(len(theta)) == k))
            columns.append((moved - r) / STEP if moved is not None else np.zeros_like(r))
        J = np.column_stack(columns) if columns else np.zeros((len(r), 0))
        H, g = J.T @ J, J.T @ r
        scale = np.maximum(np.diag(H), 1e-12 * max(np.diag(H).max(initial=0.0), 1e-300))
        before = cost
        while damping < 1e8:
            step = -np.linalg.solve(H + damping * np.diag(scale), g)
            step *= min(1.0, 0.5 / max(np.abs(step).max(initial=0.0), 1e-300))
            trial = residual(theta + step)
            if trial is not None and float(trial @ trial) < cost:
                theta, r, cost = theta + step, trial, float(trial @ trial)
                damping = max(damping / 10, 1e-10)
                break
            damping *= 10
        if before - cost <= DONE * before:
            break
    return theta, float(np.sqrt(cost))
