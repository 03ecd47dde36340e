"""Modes that have no time to settle within a run, and the states that stand for them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.sparse.linalg import ArpackError, eigs

from rotorsim.model.compiled import Model

ANY, SETTLED, FRESH = 0, 1, 2  # what the mean of a slow state is, see `means_of`

LAW = "fault"  # category of blocks that stand for a law, not for a machine

ALL_MODES = 90  # states up to which all modes take less time: 4 ms for 82, with the cube of n; those near zero 5.6 ms
SLOW_DECAY = 5.0  # a mode that decays by less than e^-5 over the window may still move the mean
SHIFTED_DECAY = 1e3  # times the bound, to where modes are moved that are known
NEAREST_MODES = 8  # modes nearest to zero that are looked at first
CACHED_MATRICES = 64  # matrices whose slow states are known: many faults do not change them
CONDITION = 1e6  # of their left and right vectors, up to which they are used


def means_of(model: Model) -> np.ndarray:
    """Return what is known of the mean of every state where it has no time to settle, (n_x,).

    ANY: it may be anything, after a start at any time. SETTLED: it is where it comes to rest: a state of a law (a
    filter that stands for its loss or its lag); with a free mean in every run a law would explain each by itself,
    whatever its size. FRESH: it has come as far as since the start of the run.
    """
    means = np.full(model.n_x, ANY)
    for name, signal in model.states.items():
        block, _, key = name.rpartition(".")
        kind = model.diagram.nodes[block].block
        if kind.category == LAW:
            means[signal.part] = SETTLED
        if kind.states[key].fresh:
            means[signal.part] = FRESH
    return means


def slow_states(A: np.ndarray, window: float, means: np.ndarray | None = None) -> np.ndarray:
    """Return one state for each mode that is slow against the window: those that take part in them most.

    Their mean may be anything after a start at any time; a free integrator has no mean at all. means: of each state
    (n,), see `means_of`: those that are taken as settled are left out, those that start with the run are always in.
    """
    slow = _slow_states(np.ascontiguousarray(A, float).tobytes(), len(A), window)
    if means is None:
        return slow.copy()
    return np.union1d(slow[means[slow] != SETTLED], np.flatnonzero(means == FRESH))


@lru_cache(maxsize=CACHED_MATRICES)
def _slow_states(matrix: bytes, n: int, window: float) -> np.ndarray:
    A = np.frombuffer(matrix).reshape(n, n)
    bound = SLOW_DECAY / window
    vectors = _modes_near_zero(A, bound) if len(A) > ALL_MODES else None
    if vectors is None:
        values, right = np.linalg.eig(A)
        slow = np.abs(values) < bound
        vectors = right[:, slow], np.linalg.pinv(right)[slow].T if slow.any() else right[:, slow]
    share = np.abs(vectors[0] * vectors[1]).sum(axis=1)
    return np.sort(np.argsort(-share, kind="stable")[: vectors[0].shape[1]])


def _modes_near_zero(A: np.ndarray, bound: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return right and left eigenvectors (n, s) of |eigenvalue| < bound, or None where they cannot be separated.

    One Krylov space holds one mode only of those of equal eigenvalue (two axes alike): the modes that are known are
    moved away, and the others searched again.
    """
    right = left = np.zeros((len(A), 0), complex)
    while True:
        more = _some_modes_near_zero(A + SHIFTED_DECAY * bound * (right @ left.T).real, bound)
        if more is None or not more[0].shape[1]:
            return more and (right, left)
        right, left = (np.hstack(pair) for pair in zip((right, left), more, strict=True))


def _some_modes_near_zero(A: np.ndarray, bound: float) -> tuple[np.ndarray, np.ndarray] | None:
    n = len(A)
    try:
        inverse = np.linalg.inv(A - bound * np.eye(n))
    except np.linalg.LinAlgError:  # a mode is there
        return None
    pairs = []
    for matrix in (inverse, np.ascontiguousarray(inverse.T)):
        try:
            inverted, vectors = eigs(matrix, k=NEAREST_MODES, v0=np.ones(n))
        except ArpackError:
            return None
        values = bound + 1 / inverted
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
