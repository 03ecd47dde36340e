"""Linear parts of a diagram seen from where something else acts on them, however many states they have.

With x' = A_0 x + U w, w the few rows of x' - A_0 x that anything but A_0 moves, the states that matter (those that
w or the outputs depend on) are x_N = P w,  P_k = E_N^T (i k W - A_0)^-1 U.  What parameters or nonlinear laws change
is all in w = D x_N + forcing: x_N = P (1 - D P)^-1 forcing, of the size of the ports and exact at every order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg
from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

from rotorsim.model.compiled import Model

__all__ = ["ANY", "DENSE", "FRESH", "SETTLED", "Ports", "means_of", "open_ports", "slow_states"]

ANY, SETTLED, FRESH = 0, 1, 2  # what the mean of a slow state is, see `means_of`

LAW = "fault"  # category of blocks that stand for a law, not for a machine

DENSE = 24  # states up to which matrices of all states are as fast
SLOW = 5.0  # a mode that decays by less than e^-5 over the window may still move the mean
RANK = 1e-10  # of the largest, for directions in units of the rows of A
FAR = 1e3  # times the bound, to where modes are moved that are known
FEW = 8  # modes nearest to zero that are looked at first
KEPT = 64  # matrices whose slow states are known: many faults do not change them
CONDITION = 1e6  # of their left and right vectors, up to which they are used


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

    def closed(self, change: np.ndarray) -> np.ndarray:
        """Return P (1 - D P)^-1 (R, K+1, n', r) for D (R, r, n')."""
        P = self.P
        loop = np.eye(P.shape[3]) - change[:, None] @ P
        return np.asarray(np.linalg.solve(loop.swapaxes(2, 3), P.swapaxes(2, 3)).swapaxes(2, 3))


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
    R, n = A.shape[:2]
    unit = np.abs(A).max(axis=(0, 2))
    rows, U = _spanned(moved, changed, np.where(unit > 0, unit, 1.0))
    seen = np.unique(np.concatenate([columns, *slow]).astype(int))
    P = np.zeros((R, s.shape[1], len(seen), len(rows)), complex)
    effects = []
    for r in range(R):
        matrices = s[r][:, None, None] * np.eye(n) - A[r]
        states = slow[r]
        matrices[0][states, :] = 0.0
        matrices[0][:, states] = 0.0
        matrices[0][states, states] = 1.0
        right = U.astype(complex)
        P[r] = np.linalg.solve(matrices, np.broadcast_to(right, (len(matrices), *right.shape)))[:, seen]
        effect = np.zeros((n, len(states)))
        if len(states):
            still = U.copy()
            still[states] = 0.0
            P[r, 0] = np.linalg.solve(matrices[0], still)[seen]
            driven = A[r][:, states].copy()
            driven[states] = 0.0
            effect = np.linalg.solve(matrices[0].real, driven)
            effect[states, np.arange(len(states))] = 1.0
        effects.append(effect[seen])
    return Ports(rows, seen, A[:, rows[:, None], seen], P, effects)


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


def means_of(model: Model) -> np.ndarray:
    """Return what is known of the mean of every state where it has no time to settle, (n_x,).

    ANY: it may be anything, after a start at any time. SETTLED: it is where it comes to rest: a state of a law (a
    filter that stands for its loss or its lag); with a free mean in every run a law would explain each by itself,
    whatever its size. FRESH: it has come as far as since the start of the run.
    """
    found = np.full(model.n_x, ANY)
    for name, signal in model.states.items():
        block, _, key = name.rpartition(".")
        kind = model.diagram.nodes[block].block
        if kind.category == LAW:
            found[signal.part] = SETTLED
        if kind.states[key].fresh:
            found[signal.part] = FRESH
    return found


def slow_states(A: np.ndarray, window: float, means: np.ndarray | None = None) -> np.ndarray:
    """Return one state for each mode that is slow against the window: those that take part in them most.

    Their mean may be anything after a start at any time; a free integrator has no mean at all. means: of each state
    (n,), see `means_of`: those that are taken as settled are left out, those that start with the run are always in.
    """
    found = _slow_states(np.ascontiguousarray(A, float).tobytes(), len(A), window)
    if means is None:
        return found.copy()
    return np.union1d(found[means[found] != SETTLED], np.flatnonzero(means == FRESH))


@lru_cache(maxsize=KEPT)
def _slow_states(matrix: bytes, n: int, window: float) -> np.ndarray:
    A = np.frombuffer(matrix).reshape(n, n)
    bound = SLOW / window
    found = _modes_near_zero(A, bound) if len(A) > DENSE else None
    if found is None:
        values, right = np.linalg.eig(A)
        slow = np.abs(values) < bound
        if not slow.any():
            return np.zeros(0, int)
        found = right[:, slow], np.linalg.pinv(right)[slow].T
    right, left = found
    if not right.shape[1]:
        return np.zeros(0, int)
    share = np.abs(right * left).sum(axis=1)
    return np.sort(np.argsort(-share, kind="stable")[: right.shape[1]])


def _modes_near_zero(A: np.ndarray, bound: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return right and left eigenvectors (n, s) of |eigenvalue| < bound, or None where they cannot be told.

    One Krylov space holds one mode only of those of equal eigenvalue (two axes alike): what was found is moved away,
    and the rest searched again.
    """
    rest = A
    right = left = np.zeros((len(A), 0), complex)
    while True:
        found = _some_modes_near_zero(rest, bound)
        if found is None or not found[0].shape[1]:
            return found and (right, left)
        right, left = (np.hstack(pair) for pair in zip((right, left), found, strict=True))
        rest = rest + FAR * bound * (found[0] @ found[1].T).real


def _some_modes_near_zero(A: np.ndarray, bound: float) -> tuple[np.ndarray, np.ndarray] | None:
    n = len(A)
    factor = scipy.linalg.lu_factor(A - bound * np.eye(n), check_finite=False)
    pairs = []
    for side in (0, 1):
        inverse = LinearOperator(
            (n, n), matvec=lambda b, side=side: scipy.linalg.lu_solve(factor, b, side, check_finite=False), dtype=float
        )
        try:
            found, vectors = eigs(inverse, k=FEW, v0=np.ones(n))
        except ArpackError:
            return None
        values = bound + 1 / found
        if (np.abs(values - bound) < 2 * bound).all():
            return None  # there are more
        pairs.append(vectors[:, np.abs(values) < bound])
    right, left = pairs
    if right.shape != left.shape:
        return None
    together = left.T @ right  # modes of equal frequency come in any combination
    if right.shape[1] and np.linalg.cond(together) > CONDITION:
        return None
    return right, left @ np.linalg.inv(together).T
