"""States that nothing returns, and the poles at zero that they make: free bodies, integrators without feedback."""

from __future__ import annotations

import numpy as np

from rotorsim.linear.state_space import reached
from rotorsim.model.compiled import Model

SINGULAR_STATES = 1e-14  # reciprocal condition number below which a group of states is taken to have a pole at zero

NO_SHIFT = 1e-8  # cosine between what may shift and what stays, below which nothing says by how much


def drifting_states(
    A: np.ndarray, pattern: np.ndarray | None = None, about: float = 0.0
) -> tuple[list[int], list[int]]:
    """Return the states with a pole at zero of their own, and all states that these drive.

    A: (n, n) or (m, n, n). The states are grouped into strongly coupled sets (a set is driven by others
    or not); a set whose own matrix is singular has no mean of its own: a free integrator, a free body. pattern (n, n):
    which state drives which, default: by A. about: as in `eigenvectors`.
    """
    stack = A.reshape(-1, *A.shape[-2:])
    pattern = np.any(stack != 0, axis=0) if pattern is None else pattern
    n = len(pattern)
    if n == 0:
        return [], []
    from scipy.linalg import matrix_balance  # as long to load as a short run takes
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    count, group = connected_components(csr_array(pattern), directed=True, connection="strong")
    seeds: list[int] = []
    for k in range(count):
        members = np.flatnonzero(group == k)
        own = stack[0][np.ix_(members, members)]
        if len(members) == 1:
            singular = not np.any(stack[:, members[0], members[0]])
        else:
            balanced = matrix_balance(own, separate=False)[0]
            size = np.abs(balanced + about * np.eye(len(balanced))).max(axis=1, keepdims=True)
            singular = is_singular(balanced / size)
        if singular:
            seeds += members.tolist()
    return sorted(seeds), np.flatnonzero(reached(pattern, np.isin(np.arange(n), seeds))).tolist()


def is_singular(A: np.ndarray) -> bool:
    """Return whether the reciprocal condition number of A (n, n) is below `SINGULAR_STATES`.

    It is at least 1 / (|A|_F |A^-1|_F), which is a third of the work of singular values and decides but for matrices
    whose inverse rounding spoils.
    """
    try:
        bound = np.linalg.norm(A) * np.linalg.norm(np.linalg.inv(A))
    except np.linalg.LinAlgError:
        return True
    if bound < 1e-3 / SINGULAR_STATES:
        return False
    values = np.linalg.svd(A, compute_uv=False)
    return bool(values[-1] <= SINGULAR_STATES * values[0])


def drifting_entries(model: Model, A: np.ndarray) -> list[str]:
    """Return the states with a pole at zero of their own; a state of which all entries have one stands for them."""
    seeds = np.isin(np.arange(len(A)), drifting_states(A)[0])
    named, first = [], 0
    for state in model.states.values():
        own = seeds[first : first + int(np.prod(state.shape, dtype=int))].reshape(state.shape)
        first += own.size
        indices = [",".join(str(i + 1) for i in index) for index in np.argwhere(own)]
        named += [state.name] if own.all() else [f"{state.name}[{index}]" for index in indices]
    return named


def shifts(A: np.ndarray, about: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return bases (n, k) of the null spaces of A (n, n): of A N = 0, and of W' A = 0, orthonormal but for units.

    A motion shifted by N c is a motion as well; W' x is what a motion does not change but by what drives it. about: as
    in `eigenvectors`.
    """
    from scipy.linalg import matrix_balance, svd  # as in `eigenvectors`

    if not len(A):
        return A, A
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    size = np.abs(balanced + about * np.eye(len(A))).max(axis=1)
    size[size == 0] = 1.0
    left, sizes, right = svd(balanced / size[:, None])
    k = int((sizes <= SINGULAR_STATES * sizes[0]).sum())
    kept = np.linalg.qr(left[:, len(A) - k :] / size[:, None])[0]
    return right[len(A) - k :].T * scale[:, None], kept / scale[:, None]


def shift_of(y: np.ndarray, N: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Return N c (n,), of `shifts`, with W' N c = y; without what a free body would need, of which nothing tells it."""
    left, cosines, right = np.linalg.svd(W.T @ N)
    told = cosines > NO_SHIFT
    return np.asarray(N @ (right[told].T @ (left[:, told].T @ y / cosines[told])))


def eigenvectors(A: np.ndarray, about: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the eigenvalues (n,) of A (n, n), and left and right vectors (n, r) of the first r, which are not zero.

    A free body has a double eigenvalue at zero, which rounding e takes apart to +-sqrt(e), a mode of its own. With an
    orthonormal basis [R K] of which K spans the null space, A is [[R'AR, 0], [K'AR, 0]]: the others are those of R'AR,
    which is singular in turn where the zero was a multiple one. The last n - r are zero. A is what a matrix is beyond
    ``about`` times the unit matrix, whose entries have been rounded with that.

    Source: V. N. Kublanovskaya, USSR Comput. Math. Math. Phys. 6 (1966) 1-14 (staircase form).
    """
    from scipy.linalg import eig, matrix_balance, svd  # as long to load as a short run takes

    n = len(A)
    if n == 0:
        return np.zeros(0, complex), np.zeros((0, 0), complex), np.zeros((0, 0), complex)
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    size = np.abs(balanced + about * np.eye(n)).max(axis=1, keepdims=True)
    rows = balanced / np.where(size > 0, size, 1.0)
    zeros = 0
    if is_singular(rows):
        _, sizes, basis = svd(rows)
        zeros = int((sizes <= SINGULAR_STATES * sizes[0]).sum())
    if not zeros:
        values, left, right = eig(balanced, left=True, right=True)
        return values, left / scale[:, None], right * scale[:, None]
    R, K = basis[: n - zeros].T, basis[n - zeros :].T
    values, left, right = eigenvectors(R.T @ balanced @ R, about)
    r = left.shape[1]
    moved = R @ right
    moved = moved + K @ (K.T @ balanced @ moved) / values[:r]
    return np.concatenate([values, np.zeros(zeros)]), R @ left / scale[:, None], moved * scale[:, None]
