"""Settled motion from the time domain only: scipy's Dormand-Prince and shooting over one period (chord method)."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from rotorsim.model.compiled import Model


def settled_by_shooting(model: Model, speed: float, n: int = 128, turns: int = 1) -> np.ndarray:
    """Return the Fourier coefficients 0..n/2 of every state of the periodic motion, (n/2+1, n_x)."""
    p, z = model.parameter_vector({"speed": speed}), model.z0(model.p0)
    period = turns * 2 * np.pi / speed

    given = ca.DM(z), ca.DM(p)

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        return np.asarray(model.rhs(t, ca.DM(x), *given).toarray().ravel())

    def turn(x: np.ndarray, times: np.ndarray | None = None) -> np.ndarray:
        found = solve_ivp(rates, (0, period), x, "DOP853", times, rtol=1e-11, atol=1e-15, max_step=period / 64)
        return np.asarray(found.y.T)

    x = model.x0(p)
    slope, last = np.empty((model.n_x, model.n_x)), np.inf
    for _ in range(50):
        end = turn(x)[-1]
        if last > 0.5:  # seldom: it costs as much as all tries between
            for k in range(model.n_x):
                moved = x.copy()
                step = 1e-4 * max(abs(x[k]), abs(end[k]), 1e-6)  # far above the tolerance of the integration
                moved[k] += step
                slope[:, k] = (turn(moved)[-1] - end) / step
        change = np.linalg.solve(slope - np.eye(model.n_x), x - end)
        x = x + change
        now = float(np.max(np.abs(change) / (np.abs(x) + 1e-12)))
        if now < 1e-8:
            break
        last = now
    else:
        raise AssertionError(f"shooting did not converge: the last change was {now:.2g} of the state")
    times = np.arange(n) * period / n
    return np.asarray(np.fft.rfft(turn(x, times), axis=0) / n)
