"""Linear parts of a diagram seen from where something else acts on them, however many states they have.

With x' = A_0 x + U w, w the few rows of x' - A_0 x that anything but A_0 moves, the states that matter (those that
w or the outputs depend on) are x_N = P w,  P_k = E_N^T (i k W - A_0)^-1 U.  What parameters or nonlinear laws change
is all in w = D x_N + forcing: x_N = P (1 - D P)^-1 forcing, of the size of the ports and exact at every order.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from rotorsim.settled.resolvent import DynamicStiffness, Resolvent

FACTORS_KEPT = 64 << 20  # bytes of factors
RANK = 1e-10  # of the largest, for directions in units of the rows of A

_kept: OrderedDict[tuple[bytes, bytes, bytes], DynamicStiffness] = OrderedDict()


@dataclass(frozen=True, eq=False)
class Ports:
    """rows (r,) of x' that carry w, columns (n',): N. within: A_0 there, (R, r, n'). P: (R, K+1, n', r).

    slow: of each run, dx_N by the means of its slow states, (n', s), as A_0 has it.
    """

    rows: np.ndarray
    columns: np.ndarray
    within: np.ndarray
    P: np.ndarray
    slow: list[np.ndarray]

    def closed(self, change: np.ndarray) -> Resolvent:
        """Return P (1 - D P)^-1 (R, K+1, n', r) for D (R, r, n'), the change of A."""
        P = self.P
        loop = np.eye(P.shape[3]) - change[:, None] @ P
        gain = np.linalg.solve(loop.swapaxes(2, 3), P.swapaxes(2, 3)).swapaxes(2, 3)
        return Resolvent(gain, [own + (gain[r, 0] @ (change[r] @ own)).real for r, own in enumerate(self.slow)])


def open_ports(
    A: np.ndarray,
    s: np.ndarray,
    slow: Sequence[np.ndarray],
    columns: np.ndarray,
    moved: Sequence[np.ndarray],
    changed: Sequence[np.ndarray] = (),
) -> Ports:
    """Return the ports of x' = A x + U w at s (R, K+1), order 0 first, A (R, n, n).

    slow: of each run, the states that rest at order 0. columns: states that must be seen. moved: (n, N), samples of
    what w makes of x': they span U.
    """
    unit = np.abs(A).max(axis=(0, 2))
    rows, U = _spanned(moved, changed, np.where(unit > 0, unit, 1.0))
    seen = np.unique(np.concatenate([columns, *slow]).astype(int))
    P = np.zeros((*s.shape, len(seen), len(rows)), complex)
    effects = []
    for r, states in enumerate(slow):
        stiffness = _stiffness_of(A[r], s[r], states)
        P[r] = stiffness.solve(np.repeat(U[None], s.shape[1], 0))[:, seen]
        effect = stiffness.solve(A[r][None][:, :, states])[0].real
        effect[states, np.arange(len(states))] = 1.0
        effects.append(effect[seen])
    return Ports(rows, seen, A[:, rows[:, None], seen], P, effects)


def _stiffness_of(A: np.ndarray, s: np.ndarray, states: np.ndarray) -> DynamicStiffness:
    """Return the dynamic stiffness (K+1) of a run whose slow states rest at order 0.

    Those of the last runs are kept: most fault candidates do not change A where their fit begins.
    """
    key = A.tobytes(), s.tobytes(), states.tobytes()
    found = _kept.pop(key, None) or DynamicStiffness.of(A, s, states)
    _kept[key] = found
    while len(_kept) * found.size > FACTORS_KEPT:
        _kept.popitem(last=False)
    return found


def _spanned(
    moved: Sequence[np.ndarray], changed: Sequence[np.ndarray], unit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows (r,) and U (n, r) so that every column is U times its entries in these rows; unit (n,): of each."""
    columns = [_normalised(group / unit[:, None], 0.0) for group in moved]
    columns += [_normalised(group / unit[:, None], 1.0) for group in changed]
    triangle, order = scipy.linalg.qr(np.hstack(columns).T, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    rank = int((diagonal > RANK * diagonal.max(initial=0.0)).sum())
    others = scipy.linalg.solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:]) if rank else np.zeros((0, 0))
    U = np.zeros((len(unit), rank))
    rows, rest = order[:rank], order[rank:]
    U[rows, np.arange(rank)] = 1.0
    U[rest] = others.T * unit[rest, None] / unit[rows] if rank else 0.0
    return rows, U


def _normalised(group: np.ndarray, least: float) -> np.ndarray:
    """Return the finite columns that are not zero in units of their largest entry, or of ``least`` if that is more."""
    group = group[:, np.isfinite(group).all(axis=0) & np.any(group, axis=0)]
    return np.asarray(group / np.maximum(np.abs(group).max(axis=0, initial=0.0), least))
