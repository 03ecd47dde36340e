"""How runs that went side by side ended.

What is decided for all together is that a run is fine, or that a linear machine is unstable. Whatever looks otherwise
is left open: such a run is simulated once more by itself, and what `simulate` says of it holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from rotorsim.linear.linearisation import jacobians
from rotorsim.linear.stability import growing, step_factor
from rotorsim.model.compiled import Model
from rotorsim.model.input_limits import input_limits
from rotorsim.model.lanes import Reduced
from rotorsim.simulation.ensemble.reductions import LARGEST, LEAST, SQUARES, TOO_STEEP, Moments
from rotorsim.simulation.ensemble.shared import Setup
from rotorsim.simulation.run import LARGEST_RESIDUAL
from rotorsim.simulation.validity import LARGEST_ERROR, WHOLE_NUMBER, growth_of, mean_jacobian, relative_to

SURELY_FINE = 0.9  # of LARGEST_ERROR, as the rms is that of all rows here, not of every few


@dataclass(frozen=True, eq=False)
class Reached:
    """What n runs have reached: what was kept; which went to their end within all bounds (n,); rms of the error of
    every column by the step in every stretch that was repeated, (stretches, n_y, n); states at the end (n_x, n).
    """

    kept: Reduced
    sound: np.ndarray
    errors: np.ndarray
    x: np.ndarray

    def first(self, n: int) -> Reached:
        """Return the first n runs."""
        return Reached(self.kept.part(slice(n)), self.sound[:n], self.errors[..., :n], self.x[:, :n])


def joined_runs(parts: Sequence[Reached]) -> Reached:
    """Return the runs of several groups together."""
    return Reached(
        Reduced.joined([part.kept for part in parts]),
        np.concatenate([part.sound for part in parts]),
        np.concatenate([part.errors for part in parts], axis=-1),
        np.concatenate([part.x for part in parts], axis=1),
    )


def verdicts(
    setup: Setup, reached: Reached, p: np.ndarray, steps: np.ndarray
) -> tuple[list[str], list[str], np.ndarray]:
    """Return status, message and error of the step (n,) of runs with parameters p (n, n_p) and steps [s] (n,).

    The status is empty where it is left open.
    """
    model, columns, n = setup.model, setup.wanted.columns, len(p)
    moments = Moments(reached.kept.moments, setup.wanted.reduction.ends)
    whole = moments.between(0, setup.wanted.rows.n)
    largest = np.maximum(np.abs(whole[LEAST]), np.abs(whole[LARGEST]))
    fine = reached.sound & np.isfinite(whole[SQUARES]).all(axis=0)
    fine &= (largest[columns.residuals] <= LARGEST_RESIDUAL).all(axis=0)
    fine &= ~_beyond_limits(setup, largest, p)
    error = _step_errors(setup, reached.errors, whole[SQUARES])
    fine &= error <= SURELY_FINE * LARGEST_ERROR
    rates, unstable = _growth(setup, moments, setup.n_steps * steps), {}
    if model.n_z:
        fine &= rates <= 0
    else:
        poles, A = _poles(model, reached.x, p, setup.n_steps * steps)
        for k in np.flatnonzero(fine & (poles.real > 0).any(axis=1)).tolist():
            grows = growing(A[k])
            if grows and model.linear:
                unstable[k] = f"the machine is unstable: {grows.describe(model)}"
            fine[k] = not grows
        if model.linear:
            q = steps[:, None] * poles
            fine &= ~((step_factor(q) > 1 + WHOLE_NUMBER) & (q.real < 0)).any(axis=1)
        else:
            fine &= rates <= 0
    status = ["finished" if fine[k] else "unstable" if k in unstable else "" for k in range(n)]
    steep = setup.wanted.too_steep(reached.kept)
    return status, [unstable.get(k, TOO_STEEP if steep[k] else "") for k in range(n)], error


def _beyond_limits(setup: Setup, largest: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return which runs have an input beyond what its block holds for, by the largest magnitudes (n_y, n)."""
    model, beyond = setup.model, np.zeros(len(p), bool)
    if not setup.limited:
        return beyond
    for k, values in enumerate(p):
        for item in input_limits(model.diagram, {name: values[part] for name, part in model.parameters.items()}):
            part, _ = setup.wanted.columns.signals[str(item.source)]
            beyond[k] |= bool((largest[part, k] >= item.limit).any())
    return beyond


def _step_errors(setup: Setup, errors: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Return the largest relative error of a signal by the step, (n,), NaN where one is not known."""
    parts = [part for part, _ in setup.wanted.columns.signals.values()]
    if not parts:
        return np.zeros(errors.shape[-1])
    names, rows = tuple(setup.wanted.columns.signals), setup.wanted.rows.n
    wrong = np.array([np.sqrt(np.square(errors[:, part]).sum(axis=1)).max(axis=0) for part in parts])  # (signals, n)
    rms = np.array([np.sqrt(squares[part].sum(axis=0) / rows) for part in parts])
    found = relative_to(setup.model, names, wrong, rms).max(axis=0)
    found[~np.isfinite(wrong).all(axis=0)] = np.nan
    return np.asarray(found)


def _growth(setup: Setup, moments: Moments, end: np.ndarray) -> np.ndarray:
    """Return how fast the motion of each run still grows at its end [1/s]."""
    ends = setup.wanted.rows.growth_ends
    if ends[1] - ends[0] < 4:
        return np.zeros(len(end))
    parts = np.array([moments.between(*both)[:, _moving(setup)] for both in pairwise(ends)])
    seconds = (ends[1] - ends[0]) * setup.every / setup.n_steps * end
    return np.asarray(growth_of(parts[:, LARGEST] - parts[:, LEAST], seconds))


def _moving(setup: Setup) -> np.ndarray:
    """Return the columns of signals that depend on states: an angle grows as the shaft turns."""
    trace, signals = setup.model.trace, setup.wanted.columns.signals
    states = ca.vertcat(trace.x, trace.z)
    moving = [part for name, (part, _) in signals.items() if ca.depends_on(setup.model.expression(name), states)]
    return np.array([k for part in moving for k in range(part.start, part.stop)], int)


def _poles(model: Model, x: np.ndarray, p: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues (n, n_x) by which runs are judged, and their matrices (n, n_x, n_x)."""
    n = len(p)
    if model.linear:
        A = jacobians(model)["A"](np.zeros((1, n)), np.zeros((model.n_x, n)), np.zeros((0, n)), p.T)
    else:
        A = np.array([mean_jacobian(model, *values) for values in zip(p, end, x.T, strict=True)])
    A = np.asarray(A).reshape(n, model.n_x, model.n_x)
    found = np.full((n, model.n_x), np.nan, complex)
    known = np.isfinite(A).all(axis=(1, 2))
    found[known] = np.linalg.eigvals(A[known])
    return found, A
