"""Whether the periodic motion of a diagram is one that a machine settles to, run by run."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from rotorsim.criteria import CRITERIA
from rotorsim.identification.experiment import Experiment
from rotorsim.settled.linear_motion import Motion
from rotorsim.settled.motion import NonlinearMotion

__all__ = ["growth", "unsettled"]


def unsettled(experiment: Experiment) -> list[int]:
    """Return the runs whose motion, as given, would grow by more than ``growth`` over their windows."""
    rates = growth(experiment, experiment.theta0)
    windows = np.broadcast_to(experiment.motion.windows, rates.shape)
    return np.flatnonzero(rates * windows > CRITERIA.growth).tolist()


def growth(experiment: Experiment, theta: np.ndarray) -> np.ndarray:
    """Return the largest growth rate [1/s] of a disturbance of the motion of every run, (R,).

    Linear: the largest real part of an eigenvalue of A. Nonlinear, about the motion that was found last: ln |mu| / T of
    the largest Floquet multiplier mu, of the product over one turn of exp(J dt) (trapezoidal rule in J).
    Source: Nayfeh & Balachandran, Applied Nonlinear Dynamics (1995), ch. 3.
    """
    motion = experiment.motion
    if isinstance(motion, Motion):
        A = motion.response(theta, forced=False).A
        return np.asarray(np.linalg.eigvals(A).real.max(axis=1, initial=-np.inf))
    return _floquet(motion, theta)


def _floquet(motion: NonlinearMotion, theta: np.ndarray) -> np.ndarray:
    equations, R = motion.equations, len(motion.p)
    if motion.last is None or motion.ports is None or not equations.n:
        return np.full(R, -np.inf)
    moved = motion._samples(motion.last)  # of the states that enter nonlinearly
    x = np.zeros((R, motion.count, equations.n))
    x[:, :, np.asarray(motion.ports.columns)[motion.inner.S]] = moved
    p, many = np.repeat(motion.p, motion.count, 0).T, np.repeat(theta[None], R * motion.count, 0).T
    J = equations.whole.J(motion.times.reshape(1, -1), x.reshape(-1, equations.n).T, p, many)
    J = J.reshape(R, motion.count, equations.n, equations.n)
    period = 2 * np.pi / np.abs(motion.speeds)
    out = np.full(R, -np.inf)
    for r in range(R):
        if not np.isfinite(J[r]).all():
            continue
        steps = scipy.linalg.expm((J[r] + np.roll(J[r], -1, axis=0)) / 2 * period[r] / motion.count)
        whole, scale = np.eye(equations.n), 0.0
        for step in steps:
            whole = step @ whole
            size = np.abs(whole).max()
            whole, scale = whole / size, scale + float(np.log(size))
        largest = np.abs(np.linalg.eigvals(whole)).max()
        out[r] = (float(np.log(max(largest, 1e-300))) + scale) / period[r]
    return out
