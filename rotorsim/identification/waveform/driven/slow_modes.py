"""Modes of a structure that are too fast to be simulated between samples follow their forces at once.

q'' = a(t, q, q', ...) has modes of K = -da/dq. Of those slower than a limit q and q' stay states; of the others, with
right and left vectors R, L and eigenvalues W^2, the flexibility stays: R q_f, q_f = W^-2 L a, good to (w / W)^2 of what
it adds at a frequency w. The states are displacements and velocities at as many places, and keep their names.

Source: R. R. Craig, A. J. Kurdila, Fundamentals of Structural Dynamics (2006), sec. 11.4 (mode acceleration);
J. O'Callahan et al., Proc. IMAC 7 (1989) 29-37 (SEREP).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import qr, schur

from rotorsim.model.linearity import jacobian, pattern
from rotorsim.model.matrix_function import MatrixFunction


@dataclass(frozen=True, eq=False)
class Structure:
    """Equations dx/dt = f, y = g with all modes, f (n,), g (c,) of t, x (n,), v, p; and which of them stay.

    rates: dv/dt, zero where it is not known. kept (r,): the states that stay. whole (n, r): all of them by those.
    onto (r, n): the rates of those by the rates of all. q, rate: displacements and velocities of the structure.
    flexible (q, q): displacements that the fast modes add to accelerations without them.
    """

    arguments: tuple[Any, Any, Any, Any]
    f: Any
    g: Any
    rates: Any
    kept: np.ndarray
    whole: np.ndarray
    onto: np.ndarray
    q: list[int]
    rate: list[int]
    flexible: np.ndarray

    def reduced(self) -> tuple[Any, Any, Any]:
        """Return the states that stay, z (r,), and f (r,) and g (c,) of them."""
        t, x, v, _ = self.arguments
        z = ca.SX.sym("x", len(self.kept))
        shown = ca.SX(ca.sparsify(self.whole)) @ z
        pushed = ca.SX(self.flexible) @ ca.substitute(self.f[self.rate], x, shown)
        shown[self.q] += pushed
        out = ca.SX(ca.sparsify(self.onto)) @ ca.substitute(self.f, x, shown)
        shown[self.rate] += ca.jtimes(pushed, z, out) + ca.jtimes(pushed, v, self.rates) + ca.jtimes(pushed, t, 1)
        return z, out, ca.substitute(self.g, x, shown)


def structure_of(
    arguments: tuple[Any, Any, Any, Any], f: Any, g: Any, p0: np.ndarray, rates: Any, limit: float
) -> Structure | None:
    """Return equations with the states that stay without modes faster than a limit [rad/s], None where there are none.

    arguments: t, x (n,), v, p. f (n,), g (c,): expressions of these. p0: values at which the modes are those of K.
    rates: dv/dt, zero where it is not known.
    """
    t, x, v, p = arguments
    places = _pairs(f, x)
    if not places:
        return None
    n, q, rate = x.numel(), [k for k, _ in places], [j for _, j in places]
    matrix = MatrixFunction([t, x, v, p], jacobian(f[rate], x[q]))
    K = -matrix(0.0, np.zeros(n), np.zeros(v.numel()), p0)[0]
    _, first, count = schur(K, sort=lambda re, im: np.hypot(re, im) < limit**2)
    _, second, rest = schur(K, sort=lambda re, im: np.hypot(re, im) >= limit**2)
    if count + rest != len(q) or not rest:
        return None
    right = first[:, :count], second[:, :rest]
    left = np.linalg.inv(np.hstack(right))
    masters = np.sort(qr(right[0].T, pivoting=True)[2][:count])
    shape = right[0] @ np.linalg.inv(right[0][masters])  # of all places by those that stay
    flexible = right[1] @ np.linalg.inv(left[count:] @ K @ right[1]) @ left[count:]
    others = [k for k in range(n) if k not in {*q, *rate}]
    kept = np.array(sorted([*others, *(q[k] for k in masters), *(rate[k] for k in masters)]))
    whole, onto = np.zeros((n, len(kept))), np.zeros((len(kept), n))
    for own in (q, rate):
        every, stay = np.array(own), np.searchsorted(kept, [own[k] for k in masters])
        whole[np.ix_(every, stay)], onto[np.ix_(stay, every)] = shape, right[0][masters] @ left[:count]
    stay = np.searchsorted(kept, others)
    whole[others, stay] = onto[stay, others] = 1.0
    return Structure(arguments, f, g, rates, kept, whole, onto, q, rate, flexible)


def _pairs(f: Any, x: Any) -> list[tuple[int, int]]:
    """Return pairs of states of which the second is the rate of the first, and has a rate that is no state."""
    rows, columns = pattern(f, x).get_triplet()
    counts = np.bincount(rows, minlength=x.numel())
    alone = sorted((k, j) for k, j in zip(rows, columns, strict=True) if counts[k] == 1)
    found = [(k, j) for k, j in alone if (f[k] - x[j]).is_zero()]
    integrated = {k for k, _ in found}
    return [(k, j) for k, j in found if j not in integrated]
